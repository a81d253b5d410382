"""The truth of a pair as scoring reads it: three of the pair file's grids, still packed."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from kinectbench.core.errors import ReleaseError
from kinectbench.core.voxels.npz import UNREADABLE
from kinectbench.core.voxels.pair_file import NUMBERS, Packed, pair_parts
from kinectbench.release.published import published_bytes

GRIDS = ("full", "known", "seen")


@dataclass(frozen=True)
class Truth:
    """Packed truth (see pair_file.py): each (256, 256, 32) uint8, C order.

    Attributes:
        full: the solid shape.
        known: where the truth is trusted.
        seen: what the input view saw.
        voxel_size_m: edge of a cell, metres.
        surface_sigma_m: standard deviation of the truth's surface, metres; 0 if it is exact or not known.
    """

    full: Packed
    known: Packed
    seen: Packed
    voxel_size_m: float
    surface_sigma_m: float

    def flat(self) -> tuple[Packed, Packed, Packed]:
        """`full`, `known` and `seen` as (v / 8,) bytes."""
        return self.full.ravel(), self.known.ravel(), self.seen.ravel()


def read_truth(path: Path, sha256: str) -> Truth:
    """Read the truth of one pair of a release.

    Args:
        path: the pair file.
        sha256: what its bytes must hash to.

    Raises:
        ReleaseError: the file is missing, or not the published one.
    """
    full, known, seen, voxel_size_m, surface_sigma_m = read_parts(path, sha256, (*GRIDS, *NUMBERS))
    return Truth(full, known, seen, float(voxel_size_m), float(surface_sigma_m))


def read_voxel_size(path: Path, sha256: str) -> float:
    """Edge of a cell of the 256-grid of a published pair, metres.

    Raises:
        ReleaseError: the file is missing, or not the published one.
    """
    return float(read_parts(path, sha256, ("voxel_size_m",))[0])


def read_parts(path: Path, sha256: str, names: Sequence[str]) -> list[NDArray[Any]]:
    """Read some packed grids or lengths of a published pair file, in the order of `names`, and no others.

    Lengths are 0-d, float64, in metres.

    Raises:
        ReleaseError: the file is missing, or not the published one.
    """
    content = published_bytes(path, sha256)
    try:
        return pair_parts(content, names)
    except UNREADABLE as error:
        raise ReleaseError(f"{path}: not a pair file ({error}); was it published whole?") from error
