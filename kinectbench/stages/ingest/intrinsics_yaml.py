"""Intrinsics in YAML, as OpenCV, ROS, Kalibr, ORB-SLAM and others write it; read without a parser of YAML."""

import re
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import Any

from kinectbench.core import IntrinsicsError, RecordingError
from kinectbench.core.trajectory.text_rows import parse_floats
from kinectbench.stages.ingest.depth_units import yaml_scale
from kinectbench.stages.ingest.intrinsics import NEEDED, Intrinsics, of_four_numbers, of_matrix_numbers
from kinectbench.stages.ingest.intrinsics_words import distortion_notes

YAML_MATRICES = ("camera_matrix", "cam_K", "intrinsic_matrix", "K", "k", "intrinsics")
# Other programs use these keys for other things: they count only with as many numbers as a camera has.
LOOSE_KEYS = frozenset({"K", "k", "intrinsics"})
YAML_DISTORTIONS = ("distortion_coefficients", "distortion_coeffs", "distortion", "dist_coeffs", "D", "d")
# ORB-SLAM's k1, k2, p1, p2.
YAML_POLYNOMIAL = re.compile(r"^[ \t]*Camera\d?\.[kp]\d[ \t]*:[ \t]*([-+.\deE]{1,30})", re.MULTILINE)
# ROS's camera_info: numbers of more digits are no image's size.
YAML_SIZE = re.compile(r"^image_(width|height):\s*(\d{1,6})\s*$", re.MULTILINE)
# Keys of focal lengths in ORB-SLAM (Camera.fx) and many other programs.
YAML_FOCAL = re.compile(
    r"^[ \t]*(?:Camera\d?\.)?(fx|fy|cx|cy)[ \t]*:[ \t]*([-+.\deE]{1,30})[ \t]*(?:#.*)?$", re.MULTILINE
)
# Keys that OpenCV and ROS write beside `data`.
OPENCV_KEYS, OPENCV_TAG = frozenset({"rows", "cols", "dt"}), "!!opencv-matrix"
# A key, and the number of lines after it to read: 4x4 numbers, one per line, after OpenCV's header lines.
YAML_KEY, YAML_LINES = re.compile(r"[ \t]*([A-Za-z_][\w.]*)[ \t]*:(.*)"), 24
# Characters that may stand between the numbers of a value.
YAML_SIGNS = re.compile(r"#.*|[\[\],]|(?<!\S)-(?=\s)")


def intrinsics_in_yaml(text: str, file: Path) -> Intrinsics | None:
    """Read the pinhole camera from a YAML text of OpenCV, ROS or others; None if it has none.

    Raises:
        RecordingError: a key repeats with other numbers, or is of no pinhole matrix.
    """
    values = _yaml_numbers(text, (*YAML_MATRICES, *YAML_DISTORTIONS), file)
    sizes: dict[str, Any] = {key: int(value) for key, value in YAML_SIZE.findall(text)}
    polynomial = (_number(word) for word in YAML_POLYNOMIAL.findall(text))
    distorted = any(polynomial) or any(any(values.get(key) or ()) for key in YAML_DISTORTIONS)
    sizes["depth_scale"], notes = yaml_scale(text, file, of_bop="cam_K" in values)
    sizes["notes"] = (*distortion_notes(file, distorted=distorted), *notes)
    for key in (key for key in YAML_MATRICES if key in values):
        numbers = values[key]
        if numbers is None:  # text: a file name, or another program's settings
            continue
        if len(numbers) == len(NEEDED):
            four = of_four_numbers(numbers, file)
            return replace(four, **sizes | {"notes": (*sizes["notes"], *four.notes)})
        if (K := of_matrix_numbers(numbers, file)) is not None:
            return replace(K, **sizes)
        if key not in LOOSE_KEYS or len(numbers) > len(NEEDED):
            raise IntrinsicsError(
                f"{file}: '{key}' holds {len(numbers)} numbers, not the nine of a pinhole matrix (or fx, fy, "
                "cx, cy): correct it, or give fx, fy, cx, cy under `camera:`"
            )
    by_key: dict[str, Any] = {}
    for key, word in YAML_FOCAL.findall(text):
        number = _number(word)
        if number is not None and by_key.setdefault(key, number) != number:
            raise _two_cameras(file, key)
    return Intrinsics(**by_key, **sizes) if all(key in by_key for key in NEEDED) else None


def _number(word: str) -> float | None:
    """Parse a number; return None if the word is not one."""
    try:
        return parse_floats([word], "")[0]
    except RecordingError:
        return None


def _two_cameras(file: Path, key: str) -> RecordingError:
    return IntrinsicsError(
        f"{file}: holds '{key}' more than once, with other numbers: which camera is that of depth? Keep it "
        "alone, or give fx, fy, cx, cy under `camera:`"
    )


def _yaml_numbers(text: str, wanted: Collection[str], file: Path) -> dict[str, list[float] | None]:
    """Read {key: numbers} of the wanted keys in a YAML text, from lists or from OpenCV's `data`.

    A value that does not consist of numbers alone is None.

    Raises:
        RecordingError: the key of a matrix repeats with other numbers.
    """
    lines, by_key = text.splitlines(), dict[str, list[float] | None]()
    for at, line in enumerate(lines):
        match = YAML_KEY.fullmatch(line)
        if match is None or match[1] not in wanted:
            continue
        parts = [match[2]]
        for below in lines[at + 1 : at + 1 + YAML_LINES]:
            key = YAML_KEY.fullmatch(below)
            if key is None and not below.startswith(("---", "...")):
                parts.append(below)
            elif key is not None and key[1] == "data":
                parts = [key[2]]
            elif key is None or key[1] not in OPENCV_KEYS:
                break
        words = " ".join(YAML_SIGNS.sub(" ", part) for part in parts).replace(OPENCV_TAG, " ").split()
        try:
            numbers: list[float] | None = parse_floats(words, "")
        except RecordingError:
            numbers = None
        before = by_key.setdefault(match[1], numbers)
        if None not in (before, numbers) and before != numbers and match[1] in YAML_MATRICES:
            raise _two_cameras(file, match[1])
    return by_key
