"""7-Scenes folders: `frame-XXXXXX.{color,depth}.png` and `.pose.txt`; depth in mm, not registered."""

import re
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.core.trajectory.text_rows import read_matrix
from kinectbench.core.trajectory.trajectory_file import read_given, trajectory_from_matrices
from kinectbench.core.types import Float64
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.intrinsics import Intrinsics, read_intrinsics_matrix
from kinectbench.stages.ingest.recording import (
    Evidence,
    FileRecording,
    FrameFiles,
    first_depth_size,
    first_file,
)

DEPTH_SCALE = 1000.0
INVALID = 65535
# The dataset's own intrinsics, for its own image size.
KINECT = Intrinsics(640, 480, 585.0, 585.0, 320.0, 240.0)
COLOR_KINDS = ("color.png", "color.jpg", "color.jpeg")
DEPTH_NAME = re.compile(r"frame-(\d{1,9})\.depth\.png")


class SevenScenesRecording(FileRecording):
    """One sequence of Microsoft 7-Scenes, or another in its layout.

    It has no stamps: a frame's number counts seconds. Its poses are 4x4, camera to world, and are
    projected onto the rigid transforms.
    """

    format: ClassVar[str] = "7scenes"
    looks_for: ClassVar[str] = "a folder with frame-000000.depth.png (and .color.png, .pose.txt)"
    evidence: ClassVar[Evidence] = "recording"
    verified: ClassVar[str] = "150 frames of redkitchen (for research use)"

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder holds a frame-XXXXXX.depth.png."""
        return path.is_dir() and any(DEPTH_NAME.fullmatch(file.name) for file in path.iterdir())

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """List the frames and read their poses."""
        numbered = {int(m[1]): f for f in path.iterdir() if (m := DEPTH_NAME.fullmatch(f.name))}
        stamps_ns = [number * NS_PER_S for number in sorted(numbered)]
        depth = [numbered[number] for number in sorted(numbered)]
        files = tuple(
            FrameFiles(stamp_ns, file, first_file(_beside(file, kind) for kind in COLOR_KINDS))
            for stamp_ns, file in zip(stamps_ns, depth, strict=True)
        )
        size_px = first_depth_size(files)
        trajectory, warnings, error = read_given(
            lambda: trajectory_from_matrices(stamps_ns, [_pose_beside(file) for file in depth], str(path))
        )
        matrix_file = path / "camera-intrinsics.txt"
        default = KINECT if size_px == (KINECT.width, KINECT.height) else Intrinsics()
        said = read_intrinsics_matrix(matrix_file) if matrix_file.is_file() else default
        intrinsics = said.overridden_by(settings)
        return cls(
            path=path,
            places=files,
            camera=intrinsics.camera(size_px, path),
            depth_scale=intrinsics.depth_scale or DEPTH_SCALE,
            color_registered=False,
            given_trajectory=trajectory,
            trajectory_error=error,
            warnings=tuple(warnings),
        )

    def clean_depth(self, depth: NDArray[np.uint16], index: int) -> NDArray[np.uint16]:
        """Turn 65535 (invalid) into 0."""
        return np.where(depth == INVALID, np.uint16(0), depth)


def _beside(depth: Path, kind: str) -> Path:
    """The file of another kind, such as "pose.txt", of the same frame."""
    return depth.with_name(f"{depth.name.removesuffix('depth.png')}{kind}")


def _pose_beside(depth: Path) -> Float64 | None:
    file = _beside(depth, "pose.txt")
    return read_matrix(file, 4) if file.is_file() else None
