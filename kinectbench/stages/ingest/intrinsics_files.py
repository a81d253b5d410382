"""Find intrinsics in files beside the images; for messages, name files that only look like intrinsics."""

import math
import re
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

from kinectbench.core import IntrinsicsError, RecordingError, listed_paths, printable
from kinectbench.core.trajectory.text_rows import parse_floats, read_text
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.depth_units import scale_of_keys, yaml_scale
from kinectbench.stages.ingest.intrinsics import (
    HELD,
    MATRIX_SHAPES,
    NEEDED,
    NICE_SLAM,
    Intrinsics,
    gives_intrinsics,
    intrinsics_of_keys,
    of_matrix_numbers,
    pinhole,
    read_color_calibration,
    read_intrinsics_json,
    read_intrinsics_matrix,
)
from kinectbench.stages.ingest.intrinsics_words import intrinsics_in_words, intrinsics_in_xml
from kinectbench.stages.ingest.intrinsics_yaml import intrinsics_in_yaml
from kinectbench.stages.ingest.json_values import read_json_object
from kinectbench.stages.ingest.known_names import (
    REPLICA_FOLDER,
    first_named,
    in_any_case,
    in_order,
    is_like_poses,
    visible,
)
from kinectbench.stages.ingest.named_matrices import named_matrices

JSON_FILES = (
    "intrinsics.json",
    "camera.json",
    "camera_intrinsic.json",
    "intrinsic.json",
    "cam_K.json",
    NICE_SLAM,
)
MATRIX_FILES = ("intrinsics.txt", "intrinsic.txt", "camera-intrinsics.txt", "cam_K.txt")
# Files of these names with other content are ignored. ETH3D's calibration.txt has fx fy cx cy.
LOOSE_FILES = ("K.txt", "calibration.txt", "camera_intrinsics.txt", "camera.txt")
# Cameras as OpenCV and ROS write them; RTAB-Map exports a file for each image.
YAML_FOLDERS, YAML_NAMES = ("", "calib"), "*.y*ml"
# Limit in bytes of a camera's file, which has a few kB; and how many files to read of many, as of RTAB-Map.
YAML_BYTES, MOST_YAML = 64 << 10, 200
# Files that may state a unit, and how many to read at most (chosen by hand): some programs write one for each
# image.
UNIT_NAMES, MOST_UNIT_FILES = re.compile(r"(?!\.).+\.(?:json|ya?ml)", re.IGNORECASE), 20
# Units per metre of 16-bit depth, 10 to 0.01 mm, that are believed of a file without intrinsics.
LEAST_UNITS, MOST_UNITS = 100.0, 100_000.0
# Names of files that may contain intrinsics in an unsupported layout.
LIKE_INTRINSICS = re.compile(
    r"(?=.*(?:intrin|intr[._-]|calib|camera|cam[._-]?k|cam.*info|(?<![a-z])cam[._-]?\d*\.|info\.txt|realsense"
    r"|^k\.)).+\.(?:json|txt|ya?ml|xml|np[yz]|ini|toml|csv|mat)",
    re.IGNORECASE,
)
# nerfstudio's file; names of each frame's files; and where COLMAP writes its first model.
TRANSFORMS, NUMBER, COLMAP = "transforms.json", re.compile(r"\d+"), ("sparse/0", "colmap/sparse/0")
# Other files are there once for each frame if so many have one name but for the numbers (chosen by hand).
DATA, LEAST_OF_FRAMES = re.compile(r"(?!.*readme).+\.(?:json|txt|mat|ya?ml|xml|pincam)", re.IGNORECASE), 5
OTHER_DATA = re.compile(r"(?:masks?|confidence|poses?|extrinsics?|labels?|annotations?)/", re.IGNORECASE)
TEXTS = frozenset({".txt", ".yaml", ".yml", ".xml", ".ini", ".toml"})
# The pinhole matrix in a camera's file of MVSNet's data, behind its pose.
MVSNET = re.compile(r"^intrinsic\s+((?:[-+.\deE]{1,30}\s+){9})", re.MULTILINE)
# Largest number of names in a message, and of entries of a folder to look at.
MOST_NAMED, LOOKED_AT = 4, 20_000
# Side of the largest image, pixels, of a camera whose file states none: the limit of JPEG.
MOST_SIDE_PX = 65_535
# Cameras with a shorter focal length in pixels are not shown: a 2-D transform has 1 there (chosen by hand).
LEAST_SHOWN_PX = 10.0


def find_intrinsics(
    path: Path, settings: CameraSettings, usual_scale: float
) -> tuple[Intrinsics, Path | None]:
    """Find the intrinsics in the files of a recording's folder, and the unit of depth.

    If the file with the intrinsics states no unit, that of another file is taken, with a warning.

    Args:
        path: the folder.
        settings: intrinsics given by the user. If they are complete, files with ambiguous names are not read,
            because these may describe another camera.
        usual_scale: depth units per metre that are usual in the recording's format. If the other file states
            the same, there is no warning.

    Returns:
        The intrinsics as far as found, and the JSON file that they are from (None if from another file).

    Raises:
        RecordingError: a file does not contain what its name says, or YAML files have different cameras.
    """
    found, file = _camera_of_files(path, settings)
    # An fy of the settings replaces a negative one, and means that y points down.
    if settings.fy is None and found.fx is not None and found.fy is not None and found.fx > 0 > found.fy:
        found = _with_y_down(found, file)
    if found.depth_scale is not None or settings.depth_scale is not None:
        return found, file
    scale, notes = _scale_beside(path, usual_scale)
    return replace(found, depth_scale=scale, notes=(*found.notes, *notes)), file


def _with_y_down(found: Intrinsics, file: Path | None) -> Intrinsics:
    """Return intrinsics whose negative fy is made positive; the poses have another y axis then.

    ICL-NUIM (Handa et al., ICRA 2014) states fy = -480: its images are upright, but y points up in its poses.

    Raises:
        RecordingError: the JSON file of the intrinsics also states the pose of the colour camera.
    """
    assert found.fy is not None
    if file is not None and read_color_calibration(file) is not None:
        raise IntrinsicsError(
            f"{file}: 'T_color_depth' beside an fy of {found.fy:g} is ambiguous: write fy as {-found.fy:g}, "
            "and T_color_depth and the poses for cameras whose y axis points down"
        )
    return replace(found, fy=-found.fy, y_up=True)


def _scale_beside(path: Path, usual_scale: float) -> tuple[float | None, tuple[str, ...]]:
    """Return the depth units per metre that a folder's JSON and YAML files state, and warnings.

    If files contradict each other, none is used. Implausible values and files that cannot be read are
    ignored, because they belong to other programs.
    """
    by_file = dict[Path, float]()
    for file in sorted(listed_paths(path, wanted=UNIT_NAMES.fullmatch))[:MOST_UNIT_FILES]:
        scale = None
        with suppress(RecordingError, OSError):
            if file.suffix.lower() == ".json":
                stated = read_json_object(file, HELD, YAML_BYTES)
                scale, _ = scale_of_keys(stated, file, of_bop="cam_K" in stated)
            elif file.name != "benchmark.yaml":
                text = read_text(file, YAML_BYTES)
                scale, _ = yaml_scale(text, file, of_bop="cam_K" in text)
        if scale is not None and LEAST_UNITS <= scale <= MOST_UNITS:
            by_file[file] = scale
    if not by_file:
        return None, ()
    (file, scale), *_ = by_file.items()
    if len({f"{each:.6g}" for each in by_file.values()}) == 1:
        how = "is taken for 16-bit depth, as the file of intrinsics states none"
        note = f"{file}: says that 1 m is {scale:g} units, which {how}"
        return scale, () if math.isclose(scale, usual_scale) else (note,)
    said = " and ".join(f"{each:g} by {printable(name.name)}" for name, each in by_file.items())
    return None, (f"{path}: 1 m is {said} units of depth: none is taken: give `depth_scale`",)


def _camera_of_files(path: Path, settings: CameraSettings) -> tuple[Intrinsics, Path | None]:
    """Do as `find_intrinsics`, but without a unit of depth from a second file."""
    file = camera_file(path)
    if file is not None:
        by_json = file.suffix.lower() == ".json"
        intrinsics = read_intrinsics_json(file) if by_json else _read_text(file)
        others = passed_over(file, (*JSON_FILES, *MATRIX_FILES, *LOOSE_FILES))
        return replace(intrinsics, notes=(*intrinsics.notes, *others)), file if by_json else None
    if gives_intrinsics(settings):
        return Intrinsics(), None
    for file in in_order(path, LOOSE_FILES):
        with suppress(RecordingError):
            if file.is_file():
                return _read_text(file), None
    files = [file for folder in YAML_FOLDERS for file in visible(in_any_case(path, folder), YAML_NAMES)]
    return _of_yaml(sorted(files)), None


def camera_file(path: Path) -> Path | None:
    """Return the file of intrinsics with a sure name, in a folder or beside NICE-SLAM's scene; or None."""
    of_scene = (path / REPLICA_FOLDER).is_dir()
    above = first_named(path.parent, (NICE_SLAM,)) if of_scene else None
    return first_named(path, (*JSON_FILES, *MATRIX_FILES)) or above


def _read_text(file: Path) -> Intrinsics:
    """Read a text with a pinhole matrix, with fx, fy, cx, cy, or with a value behind each name."""
    try:
        return read_intrinsics_matrix(file)
    except RecordingError:
        by_name = intrinsics_in_words(read_text(file, YAML_BYTES), file)
        if by_name is None:
            raise
        return by_name


def named_like_intrinsics(path: Path) -> str:
    """Return the end of an error message: files that may contain intrinsics; "" if there are none.

    If a file holds cameras, each under a name, they are printed as benchmark.yaml would take them.
    """
    files = _files_of_cameras(path)
    cameras = [each for _, inside in files for each in inside]
    if len(files) == MOST_NAMED and len({line for _, line in cameras}) == 1:  # one file for each frame
        cameras, files = cameras[:1], files[:1]
    if not cameras and (path / TRANSFORMS).is_file():
        return f"; {TRANSFORMS} may have them, and poses: write a depth_file_path into each of its frames"
    if not cameras:
        return names_like(path, LIKE_INTRINSICS.fullmatch, "they may stand in") or _of_each_frame(path)
    names = " and ".join(name for name, _ in cameras)
    lines = ", ".join(f"{name} as `{line}`" for name, line in cameras)
    which = "give that of depth, or that of colour if depth lies on colour's pixels"
    held = f"the camera {names}" if len(cameras) == 1 else f"cameras {names}"
    holding = [printable(str(file)) for file, inside in files if inside]
    hold = "holds" if len(holding) == 1 else "hold"
    return f"; {' and '.join(holding)} {hold} {held}: {which}: {lines}"


def holds_camera(path: Path) -> bool:
    """Whether a file in a folder holds a camera, of those that are named like intrinsics."""
    return any(cameras for _, cameras in _files_of_cameras(path))


def _files_of_cameras(path: Path) -> list[tuple[Path, list[tuple[str, str]]]]:
    """Return the files of a folder that are named like intrinsics, and the cameras inside each."""
    found = _files_like(path, LIKE_INTRINSICS.fullmatch) if path.is_dir() else []
    return [(file, _cameras_inside(path / file)) for file in found]


def _of_each_frame(path: Path) -> str:
    """Return the end of an error message: a file of each kind that seems to be there once for each frame."""
    kinds = dict[str, list[str]]()
    for file in map(str, _files_inside(path)):
        if DATA.fullmatch(file) and not (OTHER_DATA.match(file) or is_like_poses(file)):
            kinds.setdefault(NUMBER.sub("#", file), []).append(file)
    firsts = [names[0] for names in kinds.values() if len(names) >= LEAST_OF_FRAMES][:MOST_NAMED]
    how = "; they may stand in the files of each frame, such as"
    for first in firsts:
        for _, line in _cameras_inside(path / first)[:1]:
            return f"{how} {printable(first)}, which holds `{line}`"
    return f"{how} {printable(', '.join(firsts))}" if firsts else ""


def _cameras_inside(file: Path) -> list[tuple[str, str]]:
    """Return name and line for benchmark.yaml of cameras that a text, XML or JSON file holds, at most four.

    In JSON each may be an object under a name. Without a name, it is that of the file.
    """
    raw: dict[str, object] = {}
    with suppress(RecordingError, OSError):
        if file.suffix.lower() == ".json":
            raw = read_json_object(file, HELD, YAML_BYTES)
            raw = {file.stem: raw, **raw}
        elif file.suffix.lower() in TEXTS:
            raw = {file.stem: _in_text(file)}
    if file.suffix.lower() in TEXTS | {".npy"}:
        raw |= _under_titles(file)
    cameras = list[tuple[str, str]]()
    for name, value in raw.items():
        with suppress(RecordingError):  # of another kind, or no camera's numbers
            said = value if isinstance(value, Intrinsics) else Intrinsics()
            said = intrinsics_of_keys(value, file) if isinstance(value, dict) else said
            camera = said.camera((said.width or MOST_SIDE_PX, said.height or MOST_SIDE_PX), file)
            numbers = ", ".join(f"{key}: {getattr(camera, key):.7g}" for key in NEEDED)
            if min(camera.fx, camera.fy) > LEAST_SHOWN_PX:
                cameras.append((printable(name), f"camera: {{{numbers}}}"))
    return cameras[:MOST_NAMED]


def _in_text(file: Path) -> Intrinsics | None:
    text = read_text(file, YAML_BYTES)
    said = intrinsics_in_yaml(text, file) or intrinsics_in_words(text, file) or intrinsics_in_xml(text, file)
    words = (MVSNET.search(text) or [text, text])[1].split()
    if said is not None or len(words) not in MATRIX_SHAPES:
        return said
    K = of_matrix_numbers(parse_floats(words, str(file)), file)
    # A pose without rotation looks like a pinhole matrix, too, but with its principal point at 0, 0.
    return K if K is not None and K.cx and K.cy else None


def _under_titles(file: Path) -> dict[str, object]:
    """Return each 3x3 pinhole matrix of a text, by the title above it, or of an array, by its name."""
    cameras = dict[str, object]()
    for names, K in named_matrices(file):
        with suppress(RecordingError):  # a rotation, for example
            if K.shape == (3, 3):
                cameras[" ".join(names)] = pinhole(K, file)
    return cameras


def names_like(path: Path, wanted: Callable[[str], object], how: str, *, by_folder: bool = False) -> str:
    """Return the end of an error message: names of files that `wanted` accepts; "" if there are none.

    A folder is searched with its direct subfolders; for a file, "" is returned. `how` are words before the
    names. With `by_folder`, the predicate gets names with their subfolder, such as pose/000000.npy.
    """
    names = list(map(str, _files_like(path, wanted, by_folder=by_folder))) if path.is_dir() else []
    return f"; {how} {printable(', '.join(names))}" if names else ""


def _files_like(path: Path, wanted: Callable[[str], object], *, by_folder: bool = False) -> list[Path]:
    """Return the paths inside a folder of at most four files; see `names_like`."""
    inside = _files_inside(path)
    return list(
        islice((file for file in inside if wanted(str(file) if by_folder else file.name)), MOST_NAMED)
    )


def _files_inside(path: Path) -> Iterator[Path]:
    """Yield the paths inside a folder of its files, and of those in its subfolders, sorted; COLMAP's last."""
    children = sorted(islice(listed_paths(path), LOOKED_AT))
    folders = [child for child in children if child.is_dir() and not child.name.startswith(".")]
    folders += [path / name for name in COLMAP if (path / name).is_dir()]
    below = (file for folder in folders for file in sorted(islice(listed_paths(folder), LOOKED_AT)))
    return (file.relative_to(path) for file in (*children, *below) if file.is_file())


def passed_over(read: Path, names: Collection[str]) -> tuple[str, ...]:
    """Return a warning that files with these `names` beside `read` were not read; () without such files."""
    files = (in_any_case(read.parent, name) for name in names)
    others = [file.name for file in files if file != read and file.is_file()]
    if not others:
        return ()
    return (f"{read}: is read, and not {printable(', '.join(others))} beside it; remove the wrong ones",)


def _of_yaml(files: list[Path]) -> Intrinsics:
    """Read the camera from YAML files, at most `MOST_YAML`; without values if no file has one.

    Raises:
        RecordingError: two files have different cameras.
    """
    first: tuple[Path, Intrinsics] | None = None
    for file in files[:MOST_YAML]:
        intrinsics = intrinsics_in_yaml(read_text(file, YAML_BYTES), file)
        if intrinsics is None:
            continue
        if first is not None and _differ(first[1], intrinsics):
            raise IntrinsicsError(
                f"{file}: has another camera or unit than {first[0]}; a recording must keep one: correct "
                "them, or give fx, fy, cx, cy under `camera:`"
            )
        if first is None or (first[1].depth_scale is None and intrinsics.depth_scale is not None):
            first = (file, intrinsics)
    return Intrinsics() if first is None else first[1]


def _differ(first: Intrinsics, second: Intrinsics) -> bool:
    """Whether two files have different cameras or units; a file without a unit contradicts none."""
    no_unit: dict[str, Any] = {"depth_scale": None} if None in (first.depth_scale, second.depth_scale) else {}
    return replace(first, notes=(), **no_unit) != replace(second, notes=(), **no_unit)
