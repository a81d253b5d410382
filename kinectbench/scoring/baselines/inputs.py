"""The inputs of baselines: a pair without its truth, and the truth of the training split."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import ReleaseError
from kinectbench.core.artefacts.object import FloorFile
from kinectbench.core.voxels.pair_file import Packed, PairInput, unpack
from kinectbench.release.release import Release, Target
from kinectbench.scoring.counts import reduced
from kinectbench.scoring.truth import read_parts

MEAN_CELLS = 64
UP_IN_CAMERA = np.array([0.0, -1.0, 0.0])  # y is down in the image


@dataclass(frozen=True)
class TrainingTruth:
    """The truth of the training pairs of one category.

    Attributes:
        mean: (64, 64, 64) float32, the mean occupancy of the true shapes, in [0, 1].
        partials: (n, 64, 64, 8) uint8, the partial views of the n pairs, packed.
        files: (path of the pair file, its SHA-256) for each of the n pairs.
    """

    mean: NDArray[np.float32]
    partials: NDArray[np.uint8]
    files: tuple[tuple[Path, str], ...]


@dataclass(frozen=True)
class Inputs:
    """The inputs of a baseline.

    Attributes:
        pair: the pair without its truth.
        base_rate: share of occupied voxels in the category's truth, in [0, 1]; NaN if the truth is held back.
        up_grid: (3,) float64, the unit vector away from the floor, in grid axes.
        training: truth of the category's training pairs; None if there are no such pairs, or if no baseline
            needs them.
    """

    pair: PairInput
    base_rate: float
    up_grid: NDArray[np.float64]
    training: TrainingTruth | None

    @property
    def partial(self) -> NDArray[np.bool_]:
        """The partial view at full resolution: the pair's `partial_256`, unpacked, (256, 256, 256) bool."""
        return unpack(self.pair.partial_256)


def read_training(release: Release, category: str) -> TrainingTruth | None:
    """Read the truth of a category's training pairs; None if no such pair has public, solid truth.

    Raises:
        ReleaseError: a pair file is missing or changed.
    """
    targets = [target for target in release.open_split("train") if target.category == category]
    if not targets:
        return None
    files = tuple((release.pair_path(target), target.sha256) for target in targets)
    total = np.zeros((MEAN_CELLS,) * 3)
    partials: list[Packed] = []
    for path, sha256 in files:
        partial, full = read_parts(path, sha256, ("partial", "full"))
        total += reduced(unpack(full), MEAN_CELLS)
        partials.append(partial)
    return TrainingTruth((total / len(files)).astype(np.float32), np.stack(partials), files)


def up_in_grid(release: Release, target: Target, pair: PairInput) -> NDArray[np.float64]:
    """Return the up direction (3,) in grid axes: the floor's normal or, without a floor, up in the image.

    Raises:
        ReleaseError: the floor's plane has no normal.
    """
    floor = release.floor(target.recording)
    if floor is None:
        return UP_IN_CAMERA
    if not floor.plane_world[:3].any():
        where = release.folder / "objects" / target.recording / FloorFile.FILE
        raise ReleaseError(f"{where}: a plane without a normal; download the release again")
    up = np.linalg.inv(pair.T_world_grid[:3, :3]) @ floor.plane_world[:3]
    return np.asarray(up / np.linalg.norm(up), dtype=np.float64)
