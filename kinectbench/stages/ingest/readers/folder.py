"""Plain folders: `depth/` and `color/` images with an intrinsics file, as Open3D and Redwood use them."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from kinectbench.core.errors import RecordingError
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.text_rows import parse_floats, text_rows
from kinectbench.core.trajectory.trajectory_file import read_given, read_trajectory, trajectory_from_matrices
from kinectbench.core.types import Float64
from kinectbench.core.untrusted import listed, printable
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.image_names import (
    FRAME_NUMBER,
    NUMBER_AND_STAMP,
    counting_key,
    stamps_of_names,
)
from kinectbench.stages.ingest.intrinsics import (
    Intrinsics,
    read_color_calibration,
    read_intrinsics_json,
    read_intrinsics_matrix,
    scale_warnings,
)
from kinectbench.stages.ingest.pairing import pair_images
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
# The PrimeSense camera of Redwood's scans, by the data set's own documents.
PRIMESENSE = Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)


class FolderRecording(FileRecording):
    """A folder with `depth/`, maybe `color/` (or rgb/, image/), intrinsics and maybe a trajectory.

    File names that hold time stamps give these, and pair colour with depth. Others have none: a file name
    that is a number counts seconds, or else the order does.
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
        """List the images, pair them by the times or numbers in their names, read camera and trajectory."""
        depth = image_files(path / "depth", frozenset({".png"}))
        files, recorded, paired = pair_files(depth, color_files(path), settings, path)
        files = tuple(replace(frame, mask=mask_beside(frame.depth, path)) for frame in files)
        stamps_ns = list(recorded[0])
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
            recorded=recorded,
            given_trajectory=trajectory,
            trajectory_error=error,
            warnings=(*paired, *said_warnings, *scale_warnings(path, said.depth_scale, settings), *warnings),
        )


def pair_files(
    depth: Sequence[Path], color: Sequence[Path], settings: CameraSettings, path: Path
) -> tuple[tuple[FrameFiles, ...], tuple[tuple[int, ...], tuple[int, ...]], tuple[str, ...]]:
    """The frames of two lists of images, which have names only; masks are left to the reader.

    Args:
        depth: in the order in which people count; `color` likewise.
        color: may be empty.
        settings: the delay of colour.
        path: the recording's folder.

    Returns:
        The frames by their stamps; the stamps of depth and of colour in the order of the lists, as
        `Recording.recorded` has them; and warnings.

    Raises:
        RecordingError: there is nothing to pair them by.
    """
    depth_stems, color_stems = ([file.stem for file in files] for files in (depth, color))
    partners, color_ns = pair_images(
        depth_stems, color_stems, delay_s=settings.color_delay_s, where=str(path)
    )
    stamps_ns = stamps_of_names(depth_stems)
    of_depth = [None if j is None else color[j] for j in partners.of_depth]
    order = sorted(range(len(depth)), key=stamps_ns.__getitem__)
    files = tuple(FrameFiles(stamps_ns[i], depth[i], of_depth[i]) for i in order)
    return files, (tuple(stamps_ns), color_ns), partners.warnings


def color_files(path: Path) -> list[Path]:
    """The colour images of a recording's folder, in the order people count; none if it has no such folder."""
    folders = (path / name for name in COLOR_FOLDERS)
    return next((image_files(folder, COLOR_SUFFIXES) for folder in folders if folder.is_dir()), [])


def image_files(folder: Path, suffixes: frozenset[str]) -> list[Path]:
    """The images of a folder in the order people count: 2 before 10."""
    files = (f for f in listed(folder) if f.suffix.lower() in suffixes and not f.name.startswith("."))
    return sorted(files, key=lambda file: (counting_key(file.stem), file.name))


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
