"""7-Scenes folders: `frame-XXXXXX.{color,depth}.png` and `.pose.txt`, in mm; or with ScanNet's info.txt."""

import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import IntrinsicsError, RecordingError, listed_paths, read_head
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.core.trajectory.text_rows import parse_floats, text_rows
from kinectbench.core.trajectory.trajectory_file import read_given, rigid_or_none, trajectory_from_matrices
from kinectbench.core.types import Float64
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.depth_files import decode_depth_file
from kinectbench.stages.ingest.intrinsics import (
    Intrinsics,
    check_focal_lengths,
    gives_intrinsics,
    read_intrinsics_matrix,
    rig_calibration,
    scale_warnings,
)
from kinectbench.stages.ingest.intrinsics_files import holds_camera, named_like_intrinsics
from kinectbench.stages.ingest.known_names import first_file, visible
from kinectbench.stages.ingest.readers.pose_files import named_poses, read_pose_matrix
from kinectbench.stages.ingest.recording import (
    ColorCalibration,
    Evidence,
    FileRecording,
    FrameFiles,
    first_color_size,
    first_depth_size,
    first_whole,
    read_image_file,
    without_color,
)

DEPTH_SCALE = 1000.0
INVALID = 65535
# Intrinsics beside the frames or in the folder above, depth's own first: in data sets of this layout
# (3DMatch, tsdf-fusion, the Amazon Picking Challenge), and in exports of ScanNet and BundleFusion.
MATRIX_FILES = (
    "camera-intrinsics.txt",
    "camera-intrinsics.depth.txt",
    "intrinsics.K.txt",
    "camera-intrinsics.color.txt",
    "intrinsics.txt",
)
FILES_ABOVE = MATRIX_FILES[:4]
INFO_FILES = ("_info.txt", "info.txt")
# The data set's intrinsics, for its image size.
KINECT = Intrinsics(640, 480, 585.0, 585.0, 320.0, 240.0)
COLOR_KINDS = ("color.png", "color.jpg", "color.jpeg")
# 3RScan's depth is PGM; RIO10's is rendered.
DEPTH_NAME = re.compile(r"frame-(\d{1,9})\.((?:rendered\.)?depth\.(?:png|pgm))")
# Key of depth's intrinsics in info.txt, as ScanNet's tools export it.
DEPTH_INTRINSIC = "calibrationDepthIntrinsic"


@dataclass(frozen=True)
class ScannetRig:
    """The calibration of depth and colour, from a file.

    Attributes:
        file: the file; the recording if no file states the calibration.
        depth: intrinsics of the depth camera.
        color: calibration of colour relative to depth, or None if missing.
        registered: whether colour is known to be registered to depth, whatever calibration the file states.
        T_rig_depth: (4, 4), depth camera to the rig, whose poses are recorded, metres.
    """

    file: Path
    depth: Intrinsics
    color: ColorCalibration | None = None
    registered: bool = False
    T_rig_depth: Float64 = field(default_factory=lambda: np.eye(4))


class SevenScenesRecording(FileRecording):
    """One sequence of Microsoft 7-Scenes, or of another data set in its layout.

    The layout has no stamps: a frame's stamp is its number in seconds. Poses are 4x4 matrices, camera to
    world, and are replaced by the nearest rigid transforms.
    """

    format: ClassVar[str] = "7scenes"
    looks_for: ClassVar[str] = "a folder with frame-000000.depth.png (and .color.png, .pose.txt)"
    evidence: ClassVar[Evidence] = "recording"
    verified: ClassVar[str] = "150 frames of redkitchen (for research use)"

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder contains a frame-XXXXXX.depth.png or .pgm, or such a .rendered.depth file."""
        return path.is_dir() and any(listed_paths(path, wanted=DEPTH_NAME.fullmatch))

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """List the frames, with depth of one kind, and read their poses."""
        numbered, unread = _depth_of_one_kind(path)
        stamps_ns = [number * NS_PER_S for number in sorted(numbered)]
        depth = [numbered[number] for number in sorted(numbered)]
        files = tuple(
            FrameFiles(stamp_ns, file, first_file(_beside(file, kind) for kind in COLOR_KINDS))
            for stamp_ns, file in zip(stamps_ns, depth, strict=True)
        )
        size_px = first_depth_size(files)
        camera_file = _camera_file(path)
        rig, assumed = _read_rig(camera_file, first_color_size(files) or (0, 0), size_px), list[str]()
        if rig is None:
            rig, assumed = _default_rig(path, files, size_px, settings)
        elif settings.fx is None:
            check_focal_lengths(rig.depth, size_px, rig.file)
        T_rig_depth = rig.T_rig_depth
        trajectory, warnings, error = read_given(lambda: _read_poses(path, depth, stamps_ns, T_rig_depth))
        intrinsics = rig.depth.overridden_by(settings)
        camera = intrinsics.camera(size_px, rig.file, named_like_intrinsics)
        registered = rig.registered or (rig.color is not None and rig.color.lies_on(camera))
        return cls(
            path=path,
            places=files,
            camera=camera,
            depth_scale=intrinsics.depth_scale or DEPTH_SCALE,
            color_registered=registered,
            color_calibration=None if registered else rig.color,
            given_trajectory=trajectory,
            trajectory_error=error,
            warnings=(
                *unread,
                *without_color(path, files),
                *scale_warnings(path, rig.depth.depth_scale, settings),
                *assumed,
                *warnings,
            ),
        )

    @classmethod
    def files_beside(cls, path: Path) -> tuple[Path, ...]:
        """Return the file of intrinsics in the parent folder, if the folder itself has none; else ()."""
        file = _camera_file(path)
        return () if file is None or file.parent == path else (file,)

    def clean_depth(self, depth: NDArray[np.uint16], index: int) -> NDArray[np.uint16]:
        """Set 65535 (invalid) to 0."""
        return np.where(depth == INVALID, np.uint16(0), depth)


def names_beside(names: Iterable[str]) -> tuple[str, ...]:
    """Return the files to look for in the parent folder of a sequence that has the files `names`."""
    return FILES_ABOVE if any(map(DEPTH_NAME.fullmatch, names)) else ()


def _depth_of_one_kind(path: Path) -> tuple[dict[int, Path], tuple[str, ...]]:
    """Return {frame number: depth image}, all of one kind, and a warning on frames that have another alone.

    Measured depth comes before rendered depth, then the more frequent kind, then PNG.
    """
    kinds = dict[str, dict[int, Path]]()
    for file in sorted(listed_paths(path, wanted=DEPTH_NAME.fullmatch)):
        if match := DEPTH_NAME.fullmatch(file.name):
            kinds.setdefault(match[2], {})[int(match[1])] = file
    order = sorted(kinds, key=lambda kind: ("rendered" in kind, -len(kinds[kind]), "pgm" in kind))
    chosen = kinds[order[0]] if order else {}
    left = {number: file for kind in order for number, file in kinds[kind].items() if number not in chosen}
    if not left:
        return chosen, ()
    what = f"{len(left)} frames have depth of another kind than {order[0]}, such as {left[min(left)].name}"
    return chosen, (f"{path}: {what}, and are not read: keep one kind",)


def _camera_file(path: Path) -> Path | None:
    """Find the file of intrinsics in the folder or its parent (3DMatch, tsdf-fusion); None if none exists."""
    own = first_file(path / name for name in MATRIX_FILES)
    info = (file for file in (path / name for name in INFO_FILES) if is_info(file))
    return own or next(info, None) or first_file(path.parent / name for name in FILES_ABOVE)


def _read_rig(file: Path | None, color_px: tuple[int, int], size_px: tuple[int, int]) -> ScannetRig | None:
    """Read the cameras from the file; None if `file` is None."""
    if file is None:
        return None
    if file.name in INFO_FILES:
        return _read_info(file, color_px)
    # Depth to be used with colour's intrinsics has colour's pixels.
    return ScannetRig(
        file, read_intrinsics_matrix(file), registered="color" in file.name.lower() and color_px == size_px
    )


def _default_rig(
    path: Path, files: Sequence[FrameFiles], size_px: tuple[int, int], settings: CameraSettings
) -> tuple[ScannetRig, list[str]]:
    """Return the camera of 7-Scenes, a Kinect (without intrinsics if the image size differs), and warnings.

    The Kinect is assumed with a warning, unless the settings give intrinsics or this is 7-Scenes itself; it
    is not if another file holds a camera.
    """
    if size_px != (KINECT.width, KINECT.height) or holds_camera(path):
        return ScannetRig(path, Intrinsics()), []
    if gives_intrinsics(settings) or _marks_holes(files):
        return ScannetRig(path, KINECT), []
    return ScannetRig(path, KINECT), [
        f"{path}: has no intrinsics ({', '.join(MATRIX_FILES)}): those of 7-Scenes' Kinect are assumed "
        "(585, 585, 320, 240); if another camera recorded it, give its own under `camera:`"
    ]


def _read_poses(
    path: Path, depth: Sequence[Path], stamps_ns: Sequence[int], T_rig_depth: Float64
) -> tuple[GivenTrajectory | None, list[str]]:
    """Return the trajectory of the depth images from a file for each, or from one for all, and warnings."""
    poses = [_beside(file, "pose.txt") for file in depth]
    if not any(file.is_file() for file in poses):
        stems = [file.name.partition(".")[0] for file in depth]
        given, warnings = named_poses(path, visible(path, "*.json", "*.txt"), stamps_ns, stems)
        if given is not None:
            given = replace(given, T_world_camera=given.T_world_camera @ T_rig_depth)
        return given, warnings
    matrices = [read_pose_matrix(file, T_rig_depth) for file in poses]
    return trajectory_from_matrices(stamps_ns, matrices, str(path))


def _marks_holes(files: Sequence[FrameFiles]) -> bool:
    """Whether 65535 marks missing depth, as in 7-Scenes itself; not in other data sets in its layout."""

    def marked(frame: FrameFiles) -> bool:
        return bool((decode_depth_file(read_image_file(frame.depth), str(frame.depth)) == INVALID).any())

    with suppress(RecordingError):
        return first_whole(marked, files)
    return False


def _beside(depth: Path, kind: str) -> Path:
    """Return the file of a frame that ends in `kind`, such as "pose.txt", beside its depth image."""
    return depth.with_name(f"{depth.name.partition('.')[0]}.{kind}")


def is_info(file: Path) -> bool:
    """Whether the file is an info.txt that describes the cameras."""
    return file.is_file() and DEPTH_INTRINSIC.encode() in read_head(file)


def _read_info(file: Path, color_px: tuple[int, int]) -> ScannetRig:
    """Read info.txt: rows of `name = numbers`, matrices as 16 row-major numbers.

    Args:
        file: `info.txt` or `_info.txt`.
        color_px: width and height of the colour images; 0, 0 without colour.
    """
    rows = {}
    for where, row in text_rows(file):
        key, _, value = (part.strip() for part in row.partition("="))
        rows[key.removeprefix("m_")] = (where, value.split())
    K = _matrix(rows, DEPTH_INTRINSIC)
    if K is None:
        raise IntrinsicsError(
            f"{file}: has no row 'm_calibrationDepthIntrinsic = ' with the 16 numbers of a 4x4"
        )
    width, height, scale = (_number(rows, key) for key in ("depthWidth", "depthHeight", "depthShift"))
    if scale is not None and not scale > 0:
        raise IntrinsicsError(f"{file}: 'm_depthShift' must be above 0 (native units per metre)")
    depth = Intrinsics.of_matrix(K, scale)
    if width and height:
        depth = replace(depth, width=int(width), height=int(height))
    color_place, depth_place = (
        np.eye(4) if place is None else place
        for place in (_matrix(rows, f"calibration{name}Extrinsic") for name in ("Color", "Depth"))
    )
    T_rig_depth = rigid_or_none(depth_place)
    rig = ScannetRig(file, depth, T_rig_depth=np.eye(4) if T_rig_depth is None else T_rig_depth)
    K_color = _matrix(rows, "calibrationColorIntrinsic")
    if K_color is None:
        return rig
    color = Intrinsics.of_matrix(K_color)
    return replace(rig, color=rig_calibration(color, color_px, color_place, depth_place, file.parent))


def _matrix(rows: dict[str, tuple[str, list[str]]], key: str) -> Float64 | None:
    where, words = rows.get(key, ("", []))
    if not words:
        return None
    if len(words) != 16:
        raise IntrinsicsError(f"{where}: '{key}' holds {len(words)} numbers, not the 16 of a 4x4 matrix")
    return np.array(parse_floats(words, where)).reshape(4, 4)


def _number(rows: dict[str, tuple[str, list[str]]], key: str) -> float | None:
    where, words = rows.get(key, ("", []))
    value = parse_floats(words[:1], where) if words else []
    if value and not (np.isfinite(value[0]) and 0 <= value[0] < 1e6):
        raise IntrinsicsError(f"{where}: '{key}' is {value[0]:g}, which it cannot be")
    return value[0] if value else None
