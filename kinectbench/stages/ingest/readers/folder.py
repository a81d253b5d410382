"""Plain folders: `depth/` and `color/` images with an intrinsics file, as Open3D and Redwood use them."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from kinectbench.core.errors import RecordingError
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.stamps import NS_PER_S, no_times
from kinectbench.core.trajectory.text_rows import parse_floats, text_rows
from kinectbench.core.trajectory.trajectory_file import read_given, read_trajectory, trajectory_from_matrices
from kinectbench.core.types import Float64
from kinectbench.core.untrusted import listed, printable
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.intrinsics import (
    Intrinsics,
    read_color_calibration,
    read_intrinsics_json,
    read_intrinsics_matrix,
    scale_warnings,
)
from kinectbench.stages.ingest.readers.pose_folder import read_pose_folder
from kinectbench.stages.ingest.recording import (
    FileRecording,
    FrameFiles,
    first_color_size,
    first_depth_size,
    first_file,
    mask_beside,
    visible,
)

DEPTH_SCALE = 1000.0
PNG = re.compile(r".+\.png", re.IGNORECASE | re.DOTALL)
COLOR_FOLDERS = ("color", "rgb", "image")
COLOR_SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})
MATRIX_FILES = ("intrinsics.txt", "intrinsic.txt", "camera-intrinsics.txt", "cam_K.txt")
JSON_FILES = ("intrinsics.json", "camera.json", "camera_intrinsic.json", "intrinsic.json")
# Longer numbers are stamps of an unknown unit, not frame numbers.
FRAME_NUMBER = re.compile(r"\d{1,9}")
# Redwood's scans: frame number and stamp in microseconds, which differs between depth and colour.
NUMBER_AND_STAMP = re.compile(r"(\d{1,9})-(\d{12})")
# Their PrimeSense camera, by the data set's own documents.
PRIMESENSE = Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)


class FolderRecording(FileRecording):
    """A folder with `depth/`, maybe `color/` (or rgb/, image/), intrinsics and maybe a trajectory.

    Redwood's file names, NUMBER-MICROSECONDS, give stamps. Others have none: a file name that is a number
    counts seconds, or else the order does.
    """

    format: ClassVar[str] = "folder"
    looks_for: ClassVar[str] = (
        "a folder with depth/*.png (and color/, masks/, intrinsics.json, trajectory.log or pose/)"
    )
    verified: ClassVar[str] = "folders and trajectories that Open3D reads alike"

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has a subfolder depth/ with PNG images."""
        depth = path / "depth"
        return depth.is_dir() and any(listed(depth, wanted=PNG.fullmatch))

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """List the images, pair them by name or else by order, and read intrinsics and trajectory."""
        depth = image_files(path / "depth", frozenset({".png"}))
        color = next(
            (image_files(path / name, COLOR_SUFFIXES) for name in COLOR_FOLDERS if (path / name).is_dir()), []
        )
        stamps_ns = stamps_of_names([file.stem for file in depth])
        partners = _partners(depth, color, path)
        order = sorted(range(len(depth)), key=lambda i: stamps_ns[i])
        files = tuple(
            FrameFiles(stamps_ns[i], depth[i], partners[i], mask_beside(depth[i], path)) for i in order
        )
        size_px = first_depth_size(files)
        camera_file = first_file(path / name for name in JSON_FILES)
        said, said_warnings = _read_intrinsics(path, camera_file, depth, size_px)
        intrinsics = said.overridden_by(settings)
        registered = intrinsics.color_registered
        trajectory, warnings, error = read_given(lambda: _read_trajectory(path, stamps_ns, files))
        return cls(
            path=path,
            places=files,
            camera=intrinsics.camera(size_px, path),
            depth_scale=intrinsics.depth_scale or DEPTH_SCALE,
            color_registered=first_color_size(files) == size_px if registered is None else registered,
            color_calibration=read_color_calibration(camera_file) if camera_file else None,
            given_trajectory=trajectory,
            trajectory_error=error,
            warnings=(*said_warnings, *scale_warnings(path, said.depth_scale, settings), *warnings),
        )


def image_files(folder: Path, suffixes: frozenset[str]) -> list[Path]:
    """The images of a folder in the order people count: 2 before 10."""
    files = (f for f in listed(folder) if f.suffix.lower() in suffixes and not f.name.startswith("."))
    return sorted(files, key=lambda file: (counting_key(file.stem), file.name))


def counting_key(stem: str) -> list[tuple[int, str]]:
    """What sorts names in the order people count: 2 before 10."""
    # A name may stand in an index, where it can have any length; Python refuses numbers of 4300 digits.
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d{1,18})", stem)]


def frame_key(stem: str) -> str:
    """What must agree for depth and colour to be one frame: the name, without leading zeros of a number."""
    redwood = NUMBER_AND_STAMP.fullmatch(stem)
    if redwood:
        return str(int(redwood[1]))
    return str(int(stem)) if FRAME_NUMBER.fullmatch(stem) else stem


def stamps_of_names(stems: Sequence[str]) -> list[int]:
    """Stamps in nanoseconds by Redwood's names; else a number counts seconds, or else the order does."""
    stamps = [NUMBER_AND_STAMP.fullmatch(stem) for stem in stems]
    if all(stamps):
        stamps_ns = [int(match[2]) * 1000 for match in stamps if match]
        if len(set(stamps_ns)) == len(stamps_ns) and not no_times(stamps_ns):
            return stamps_ns
    keys = [frame_key(stem) for stem in stems]
    numbered = all(FRAME_NUMBER.fullmatch(key) for key in keys) and len(set(keys)) == len(keys)
    return [(int(key) if numbered else index) * NS_PER_S for index, key in enumerate(keys)]


def _partners(depth: list[Path], color: list[Path], path: Path) -> list[Path | None]:
    """The colour image of each depth image: the same name, or the same place if no name agrees."""
    by_key = {frame_key(file.stem): file for file in color}
    partners = [by_key.get(frame_key(file.stem)) for file in depth]
    if not color or any(partners):
        return partners
    if len(color) != len(depth):
        raise RecordingError(
            f"{path}: {len(depth)} depth and {len(color)} colour images, and no names agree: give images of "
            "one frame the same name, or remove those that have no partner"
        )
    return list(color)


def _read_intrinsics(
    path: Path, camera_file: Path | None, depth: list[Path], size_px: tuple[int, int]
) -> tuple[Intrinsics, list[str]]:
    if camera_file:
        return read_intrinsics_json(camera_file), []
    matrix_file = first_file(path / name for name in MATRIX_FILES)
    if matrix_file:
        return read_intrinsics_matrix(matrix_file), []
    if NUMBER_AND_STAMP.fullmatch(depth[0].stem) and size_px == (PRIMESENSE.width, PRIMESENSE.height):
        return PRIMESENSE, [f"{path}: has no intrinsics; those of Redwood's PrimeSense camera are taken"]
    return Intrinsics(), []


def _read_trajectory(
    path: Path, stamps_ns: list[int], files: Sequence[FrameFiles]
) -> tuple[GivenTrajectory | None, list[str]]:
    if (path / "trajectory.txt").is_file():
        return read_trajectory(path / "trajectory.txt")
    logs = sorted(visible(path, "*.log"))
    file = path / "trajectory.log" if len(logs) != 1 else logs[0]
    if not file.is_file():
        return read_pose_folder(path, files)
    matrices = _read_log(file, len(stamps_ns))
    return trajectory_from_matrices(stamps_ns, matrices, str(file))


def _read_log(file: Path, frames: int) -> list[Float64]:
    """Redwood log, `i j k` and four matrix rows, camera to world: the matrix of the i-th frame, or NaN."""
    rows = text_rows(file)
    if len(rows) % 5:
        raise RecordingError(f"{file}: holds {len(rows)} rows, not a multiple of 5 ('i j k' and four rows)")
    matrices = [np.full((4, 4), np.nan)] * frames
    for start in range(0, len(rows), 5):
        where, head = rows[start]
        index = head.split()[0]
        if not FRAME_NUMBER.fullmatch(index) or int(index) >= frames:
            raise RecordingError(
                f"{where}: '{printable(head)}' does not name one of the {frames} frames (0-{frames - 1})"
            )
        values = [parse_floats(row.split(), row_where) for row_where, row in rows[start + 1 : start + 5]]
        if any(len(row) != 4 for row in values):
            raise RecordingError(f"{where}: the four rows after it are not four numbers each")
        matrices[int(index)] = np.array(values)
    return matrices
