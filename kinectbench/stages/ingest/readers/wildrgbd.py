"""Scenes of WildRGB-D: rgb/, depth/ and masks/ as PNG, `metadata` (JSON), cam_poses.txt.

By the data set's page (github.com/wildrgbd/wildrgbd): depth is in mm; `metadata` has w, h and K with nine
column-major numbers; a line of cam_poses.txt has a frame's number and row-major 4x4 matrix, camera to world
in OpenCV's axes.
"""

from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from kinectbench.core import GivenPosesError, RecordingError
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.core.trajectory.text_rows import parse_floats, text_rows
from kinectbench.core.trajectory.trajectory_file import read_given, trajectory_from_matrices
from kinectbench.core.types import Float64
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.image_names import FRAME_NUMBER
from kinectbench.stages.ingest.intrinsics import intrinsics_of_keys
from kinectbench.stages.ingest.json_values import read_json_object
from kinectbench.stages.ingest.known_names import first_file, visible
from kinectbench.stages.ingest.recording import (
    FileRecording,
    FrameFiles,
    first_color_size,
    first_depth_size,
    without_color,
)

DEPTH_SCALE = 1000.0


class WildRgbdRecording(FileRecording):
    """One scene of WildRGB-D, with masks of its object; the stamp of a frame is its number in seconds."""

    format: ClassVar[str] = "wildrgbd"
    looks_for: ClassVar[str] = "a folder with depth/, metadata and cam_poses.txt or masks/ (rgb/)"

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has depth/, metadata, and poses or masks."""
        has_object_files = (path / "cam_poses.txt").is_file() or (path / "masks").is_dir()
        return has_object_files and (path / "metadata").is_file() and (path / "depth").is_dir()

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """List the depth images by number, with colour and mask of the same number."""
        depth_files = {
            int(f.stem): f for f in visible(path / "depth", "*.png") if FRAME_NUMBER.fullmatch(f.stem)
        }
        if not depth_files:
            raise RecordingError(
                f"{path / 'depth'}: holds no image 00000.png; copy the scene again", what="no-depth"
            )
        files = tuple(
            FrameFiles(
                number * NS_PER_S,
                depth_files[number],
                first_file(path / "rgb" / f"{depth_files[number].stem}{end}" for end in (".png", ".jpg")),
                first_file([path / "masks" / depth_files[number].name]),
            )
            for number in sorted(depth_files)
        )
        size_px = first_depth_size(files)
        said = read_json_object(path / "metadata", "K, w, h")
        needed = {key: said.get(key) or "" for key in ("K", "w", "h")}
        intrinsics = intrinsics_of_keys(needed, path / "metadata").overridden_by(settings)
        trajectory, warnings, error = read_given(lambda: _read_poses(path, sorted(depth_files)))
        return cls(
            path=path,
            places=files,
            camera=intrinsics.camera(size_px, path),
            depth_scale=intrinsics.depth_scale or DEPTH_SCALE,
            color_registered=first_color_size(files) == size_px,
            given_trajectory=trajectory,
            trajectory_error=error,
            warnings=(*without_color(path, files), *warnings),
        )


def _read_poses(path: Path, numbers: list[int]) -> tuple[GivenTrajectory | None, list[str]]:
    """Return the trajectory of the frames with these numbers, and warnings.

    The trajectory is camera to world. It is None if there is no file or no usable pose.
    """
    file = path / "cam_poses.txt"
    if not file.is_file():
        return None, []
    matrices: dict[int, Float64] = {}
    for where, row in text_rows(file):
        values = parse_floats(row.split(), where)
        if len(values) != 17 or not 0 <= values[0] < 10**9 or values[0] % 1:
            raise GivenPosesError(f"{where}: is not a frame's number and the 16 numbers of its pose")
        matrices.setdefault(int(values[0]), np.array(values[1:]).reshape(4, 4))
    alone = len(matrices.keys() - set(numbers))
    warnings = [f"{file}: {alone} poses are of frames without depth, and were left out"] if alone else []
    stamps_ns = [number * NS_PER_S for number in numbers]
    trajectory, lost = trajectory_from_matrices(stamps_ns, [matrices.get(n) for n in numbers], str(path))
    return trajectory, [*warnings, *lost]
