"""Folders exported by ScanNet's reader: depth/N.png, color/N.jpg, pose/N.txt and intrinsic/.

By ScanNet's SensReader: depth is in mm; a pose is camera to world, with minus infinity if the frame was lost;
`intrinsic_depth.txt` and `intrinsic_color.txt` are 4x4 pinhole matrices, and `extrinsic_*.txt` place each
camera in the rig. The smaller release (frames_25k) has `intrinsics_depth.txt` beside the folders.
"""

from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from kinectbench.core import RecordingError
from kinectbench.core.trajectory.text_rows import read_matrix
from kinectbench.core.trajectory.trajectory_file import read_given, rigid_or_none
from kinectbench.core.types import Float64
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.intrinsics import check_focal_lengths, read_intrinsics_matrix, rig_calibration
from kinectbench.stages.ingest.known_names import first_file
from kinectbench.stages.ingest.readers.folder import pair_files
from kinectbench.stages.ingest.readers.folder_images import color_images, in_folder
from kinectbench.stages.ingest.readers.pose_files import read_pose_folder
from kinectbench.stages.ingest.recording import COLOR_DELAY, FileRecording, first_color_size, first_depth_size

DEPTH_SCALE = 1000.0


class ScannetFolderRecording(FileRecording):
    """One exported scene of ScanNet; the stamp of a frame is its number in seconds."""

    format: ClassVar[str] = "scannet"
    uses: ClassVar[frozenset[str]] = COLOR_DELAY
    looks_for: ClassVar[str] = "a folder with depth/0.png and intrinsic/intrinsic_depth.txt (color/, pose/)"

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has depth/, and intrinsics under one of ScanNet's names."""
        return (path / "depth").is_dir() and _matrix_file(path, "depth") is not None

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """List the depth images, pair them with colour, and read the poses of the same name."""
        depth = in_folder(path / "depth", frozenset({".png"}))
        if not depth.files:
            raise RecordingError(
                f"{path / 'depth'}: holds no PNG image; export the scene again with depth", what="no-depth"
            )
        files, recorded, paired = pair_files(depth, color_images(path), settings, path)
        size_px = first_depth_size(files)
        file = _matrix_file(path, "depth")
        assert file is not None
        intrinsics = read_intrinsics_matrix(file)
        if settings.fx is None:
            check_focal_lengths(intrinsics, size_px, file)
        camera = intrinsics.overridden_by(settings).camera(size_px, path)
        color_px = first_color_size(files) or (0, 0)
        depth_to_rig = _read_extrinsic(path, "depth")
        calibration = None
        color_file = _matrix_file(path, "color")
        if color_file is not None and all(color_px):
            color = read_intrinsics_matrix(color_file)
            calibration = rig_calibration(color, color_px, _read_extrinsic(path, "color"), depth_to_rig, path)
        registered = color_px == size_px if calibration is None else calibration.lies_on(camera)
        place = rigid_or_none(depth_to_rig)
        trajectory, warnings, error = read_given(lambda: read_pose_folder(path, files, place))
        return cls(
            path=path,
            places=files,
            camera=camera,
            depth_scale=settings.depth_scale or DEPTH_SCALE,
            color_registered=registered,
            color_calibration=None if registered else calibration,
            recorded=recorded,
            given_trajectory=trajectory,
            trajectory_error=error,
            warnings=(*paired, *warnings),
        )


def _matrix_file(path: Path, camera: str) -> Path | None:
    """Return the file with the intrinsics of the camera "depth" or "color"; None if it is missing."""
    return first_file([path / "intrinsic" / f"intrinsic_{camera}.txt", path / f"intrinsics_{camera}.txt"])


def _read_extrinsic(path: Path, camera: str) -> Float64:
    """Read the pose (4, 4) of the camera "depth" or "color" in the rig, metres; the identity if missing."""
    file = path / "intrinsic" / f"extrinsic_{camera}.txt"
    return read_matrix(file, 4) if file.is_file() else np.eye(4)
