"""Sequences of SUN3D: image/ and depth/NUMBER-MICROSECONDS, intrinsics.txt, extrinsics/DATE.txt.

By SUN3D's own reader: depth is in mm with rotated bits, on colour's pixels; the newest file in extrinsics/
has three rows of four numbers for each colour image, camera to world.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, NamedTuple, Self

import numpy as np

from kinectbench.core import RecordingError, listed_paths
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.stamps import first_by_stamp
from kinectbench.core.trajectory.text_rows import read_numbers
from kinectbench.core.trajectory.trajectory_file import read_given
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.image_names import NUMBER_AND_STAMP, stamps_of_names, times_of_names
from kinectbench.stages.ingest.intrinsics import check_focal_lengths, read_intrinsics_matrix
from kinectbench.stages.ingest.known_names import visible
from kinectbench.stages.ingest.pairing import pair_by_time
from kinectbench.stages.ingest.readers.folder_images import COLOR_SUFFIXES, in_folder
from kinectbench.stages.ingest.readers.pose_files import finite_trajectory
from kinectbench.stages.ingest.recording import COLOR_DELAY, FileRecording, FrameFiles, first_depth_size

DEPTH_SCALE = 1000.0
# Numbers of a pose in extrinsics/: three rows of a 4x4 matrix.
NUMBERS_A_POSE = 12


class Sun3dRecording(FileRecording):
    """One sequence of SUN3D; image names contain the stamps."""

    format: ClassVar[str] = "sun3d"
    uses: ClassVar[frozenset[str]] = COLOR_DELAY
    looks_for: ClassVar[str] = "a folder with image/, depth/0000001-000000000000.png and extrinsics/*.txt"
    often_rotated: ClassVar[bool] = True

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has image/, SUN3D's intrinsics.txt, and stamps in the names of depth images."""
        whole = (
            (path / "image").is_dir() and (path / "depth").is_dir() and (path / "intrinsics.txt").is_file()
        )
        return whole and any(NUMBER_AND_STAMP.fullmatch(file.stem) for file in listed_paths(path / "depth"))

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """Pair depth with colour by their stamps, and read the newest poses."""
        depth = _by_stamp(path / "depth", frozenset({".png"}))
        color = _by_stamp(path / "image", COLOR_SUFFIXES)
        if not depth.files:
            raise RecordingError(
                f"{path / 'depth'}: holds no PNG image; copy the sequence again", what="no-depth"
            )
        if color.files and depth.timed != color.timed:
            raise RecordingError(
                f"{path / ('image' if depth.timed else 'depth')}: its names hold no times, as those of the "
                "other folder do, or times that run back or mostly repeat; name both as SUN3D does, "
                "0000001-000000000000",
                what="unpaired",
            )
        order, repeated = first_by_stamp(depth.stamps_ns, str(path / "depth"), "images")
        color_order, color_repeated = first_by_stamp(color.stamps_ns, str(path / "image"), "images")
        partners = pair_by_time(
            [depth.stamps_ns[i] for i in order],
            [color.stamps_ns[j] for j in color_order],
            delay_s=settings.color_delay_s,
            where=str(path),
        )
        files = tuple(
            FrameFiles(
                depth.stamps_ns[i],
                depth.files[i],
                None if partner is None else color.files[color_order[partner]],
            )
            for i, partner in zip(order, partners.of_depth, strict=True)
        )
        size_px = first_depth_size(files)
        recorded = read_intrinsics_matrix(path / "intrinsics.txt")
        if settings.fx is None:
            check_focal_lengths(recorded, size_px, path / "intrinsics.txt")
        intrinsics = recorded.overridden_by(settings)
        trajectory, warnings, error = read_given(lambda: _read_poses(path, color.stamps_ns, depth.stamps_ns))
        return cls(
            path=path,
            places=files,
            camera=intrinsics.camera(size_px, path),
            depth_scale=intrinsics.depth_scale or DEPTH_SCALE,
            color_registered=any(file.color for file in files),
            recorded=(depth.stamps_ns, color.stamps_ns),
            given_trajectory=trajectory,
            trajectory_error=error,
            warnings=(*repeated, *color_repeated, *partners.warnings, *warnings),
        )


class _Stream(NamedTuple):
    """The images of a folder, sorted by stamp.

    Attributes:
        files: the images.
        stamps_ns: their stamps, nanoseconds; a few may repeat.
        timed: whether the stamps are times in the names; else they are counted.
    """

    files: tuple[Path, ...]
    stamps_ns: tuple[int, ...]
    timed: bool


def _by_stamp(folder: Path, suffixes: frozenset[str]) -> _Stream:
    """List the images of a folder by stamp."""
    files = in_folder(folder, suffixes).files
    stems = [file.stem for file in files]
    first: dict[str, str] = {}
    for stem in stems:
        first.setdefault(_stamp_text(stem), stem)
    times_ns = times_of_names(list(first.values())) if 2 * len(first) > len(stems) else None
    if times_ns is None:
        stamps_ns = stamps_of_names(stems)
    else:
        at = dict(zip(first, times_ns, strict=True))
        stamps_ns = [at[_stamp_text(stem)] for stem in stems]
    order = sorted(range(len(files)), key=stamps_ns.__getitem__)
    return _Stream(
        tuple(files[i] for i in order), tuple(stamps_ns[i] for i in order), timed=times_ns is not None
    )


def _stamp_text(stem: str) -> str:
    match = NUMBER_AND_STAMP.fullmatch(stem)
    return match[2] if match else stem


def _read_poses(
    path: Path, color_ns: Sequence[int], depth_ns: Sequence[int]
) -> tuple[GivenTrajectory | None, list[str]]:
    """Read the trajectory from the file last by name: a pose per colour image, or else per depth image.

    Returns:
        The trajectory (None if there is no file or no finite pose), and warnings.

    Raises:
        RecordingError: there are neither as many poses as colour images, nor as depth images.
    """
    files = sorted(visible(path / "extrinsics", "*.txt"))
    if not files:
        return None, []
    numbers = np.array(read_numbers(files[-1]))
    poses, remainder = divmod(len(numbers), NUMBERS_A_POSE)
    stamps_ns = color_ns if poses == len(color_ns) else depth_ns
    if remainder or poses != len(stamps_ns):
        raise RecordingError(
            f"{files[-1]}: holds {len(numbers)} numbers, not 12 for each of the {len(color_ns)} colour "
            f"(or {len(depth_ns)} depth) images",
            what="pose-count",
        )
    rows = numbers.reshape(poses, 3, 4)
    order, _ = first_by_stamp(stamps_ns, str(files[-1]), "poses")
    matrices = [np.vstack([rows[i], [0, 0, 0, 1]]) for i in order]
    return finite_trajectory([stamps_ns[i] for i in order], matrices, str(files[-1]))
