"""Intrinsics in files beside the images: which files are read, and which only look like such."""

import re
from collections.abc import Callable
from contextlib import suppress
from itertools import islice
from pathlib import Path

import numpy as np

from kinectbench.core.errors import RecordingError
from kinectbench.core.trajectory.text_rows import read_text
from kinectbench.core.untrusted import listed, printable
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.intrinsics import (
    NEEDED,
    Intrinsics,
    pinhole,
    read_intrinsics_json,
    read_intrinsics_matrix,
)
from kinectbench.stages.ingest.recording import first_file, visible

JSON_FILES = ("intrinsics.json", "camera.json", "camera_intrinsic.json", "intrinsic.json", "cam_K.json")
MATRIX_FILES = ("intrinsics.txt", "intrinsic.txt", "camera-intrinsics.txt", "cam_K.txt")
# These may hold something else by other programs, and then say nothing. ETH3D's calibration.txt: fx fy cx cy.
LOOSE_FILES = ("K.txt", "calibration.txt", "camera_intrinsics.txt", "camera.txt")
# As OpenCV and ROS write cameras; RTAB-Map exports one of each image.
YAML_FOLDERS, YAML_NAMES = ("", "calib"), "*.y*ml"
YAML_BYTES, MOST_YAML = 64 << 10, 200
YAML_MATRIX = re.compile(r"^camera_matrix:(?:.*\n){1,8}?[ \t]+data:[ \t]*\[([^\]]{,2000})\]", re.MULTILINE)
YAML_SIZE = re.compile(r"^image_(width|height):\s*(\d{1,6})\s*$", re.MULTILINE)
YAML_DISTORTION = re.compile(
    r"^distortion_coefficients:(?:.*\n){1,8}?[ \t]+data:[ \t]*\[([^\]]{,2000})\]", re.MULTILINE
)
# Names of files that may hold intrinsics in a layout that is not read.
LIKE_INTRINSICS = re.compile(
    r"(?=.*(?:intrin|calib|camera|cam_?k|^k\.)).+\.(?:json|txt|ya?ml|xml|np[yz]|ini|toml|csv|mat)",
    re.IGNORECASE,
)
MOST_NAMED, LOOKED_AT = 4, 20_000


def find_intrinsics(path: Path, settings: CameraSettings) -> tuple[Intrinsics, Path | None]:
    """What the files of a recording's folder say of its depth camera; and the JSON file among them, or None.

    Where a person gives all that they would say, the others are not read: they may be of other cameras.

    Raises:
        RecordingError: the file does not hold what its name says.
    """
    camera_file = first_file(path / name for name in JSON_FILES)
    if camera_file is not None:
        return read_intrinsics_json(camera_file), camera_file
    matrix_file = first_file(path / name for name in MATRIX_FILES)
    if matrix_file is not None:
        return read_intrinsics_matrix(matrix_file), None
    if all(getattr(settings, key) is not None for key in NEEDED):
        return Intrinsics(), None
    for file in (path / name for name in LOOSE_FILES):
        with suppress(RecordingError):
            if file.is_file():
                return read_intrinsics_matrix(file), None
    files = [file for folder in YAML_FOLDERS for file in visible(path / folder, YAML_NAMES)]
    return _of_yaml(sorted(files)), None


def named_like_intrinsics(path: Path) -> str:
    """What a message says of files in a folder that look like intrinsics; "" if there are none."""
    return names_like(path, LIKE_INTRINSICS.fullmatch, "it may stand in")


def names_like(path: Path, wanted: Callable[[str], object], how: str) -> str:
    """What a message says of files in a folder and those in it whose names are `wanted`; "" if none are.

    Args:
        path: the recording; a file has none.
        wanted: says of a name whether it may be one.
        how: words before the names.
    """
    if not path.is_dir():
        return ""
    children = sorted(islice(listed(path), LOOKED_AT))
    folders = [child for child in children if child.is_dir() and not child.name.startswith(".")]
    below = (file for folder in folders for file in islice(listed(folder), LOOKED_AT))
    found = (file for file in (*children, *below) if file.is_file() and wanted(file.name))
    names = [str(file.relative_to(path)) for file in islice(found, MOST_NAMED)]
    return f"; {how} {printable(', '.join(names))}" if names else ""


def _of_yaml(files: list[Path]) -> Intrinsics:
    """The camera that all of some YAML files say, of very many the first."""
    found: tuple[Path, Intrinsics] | None = None
    for file in files[:MOST_YAML]:
        said = _read_yaml(file)
        if said is None:
            continue
        if found is not None and said != found[1]:
            raise RecordingError(
                f"{file}: has another camera than {found[0]}; a recording must keep one: correct them, or "
                "give fx, fy, cx, cy under `camera:`"
            )
        found = found or (file, said)
    return Intrinsics() if found is None else found[1]


def _read_yaml(file: Path) -> Intrinsics | None:
    """The pinhole camera of a YAML file of OpenCV's or ROS's; None if it holds none."""
    text = read_text(file, YAML_BYTES)
    matrix = YAML_MATRIX.search(text)
    if matrix is None:
        return None
    numbers = _numbers(matrix[1], file)
    if len(numbers) != 9:
        raise RecordingError(f"{file}: 'camera_matrix' must hold nine numbers")
    sizes = {key: int(value) for key, value in YAML_SIZE.findall(text)}
    distortion = YAML_DISTORTION.search(text)
    distorted = distortion is not None and any(_numbers(distortion[1], file))
    note = f"{file}: its distortion is not taken away; if depth is not rectified, undistort it first"
    K = pinhole(np.array(numbers).reshape(3, 3), file)
    return Intrinsics(
        sizes.get("width"), sizes.get("height"), K.fx, K.fy, K.cx, K.cy, notes=(note,) if distorted else ()
    )


def _numbers(text: str, file: Path) -> list[float]:
    try:
        return [float(word) for word in text.replace(",", " ").split()]
    except ValueError as error:
        raise RecordingError(f"{file}: {error}") from error
