"""Read the truth of a pair for scoring: some grids of the pair file, still packed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from kinectbench.core import ReleaseError
from kinectbench.core.types import FileArray
from kinectbench.core.voxels.npz import UNREADABLE
from kinectbench.core.voxels.pair_file import NUMBERS, Packed, pair_parts
from kinectbench.release.published import published_bytes
from kinectbench.scoring.protocols import SOLID, Protocol

GRIDS = ("full", "known", "seen")


@dataclass(frozen=True)
class PackedTruth:
    """The truth of a pair. Its grids are packed (see pair_file.py): (256, 256, 32) uint8, C order.

    Attributes:
        full: the solid true shape.
        known: cells where the truth is trusted.
        seen: cells that the input view saw.
        voxel_size_m: edge of a cell, metres.
        surface_sigma_m: standard deviation of the truth's surface, metres; 0 if it is exact or not known.
        others: {name: grid} of the grids that only some protocols use: cells that count as not known, or
            another true shape.
    """

    full: Packed
    known: Packed
    seen: Packed
    voxel_size_m: float
    surface_sigma_m: float
    others: Mapping[str, Packed] = field(default_factory=dict)

    def flat(self) -> tuple[Packed, Packed, Packed]:
        """Return `full`, `known` and `seen`, each flattened to (256^3 / 8,) bytes."""
        return self.full.ravel(), self.known.ravel(), self.seen.ravel()

    def under(self, protocol: Protocol) -> "PackedTruth":
        """Return the truth that a protocol compares with: its own true shape and its own known cells."""
        of = self.distrusting(protocol.distrusts)
        return of if protocol.truth == SOLID else replace(of, full=of.others[protocol.truth])

    def distrusting(self, name: str | None) -> "PackedTruth":
        """Return the truth, with the cells of grid `name` removed from `known`; itself if it has none."""
        if name is None or not self.others[name].any():
            return self
        return replace(self, known=self.known & ~self.others[name])


def read_packed_truth(path: Path, sha256: str, others: Sequence[str] = ()) -> PackedTruth:
    """Read the truth of one pair of a release.

    Args:
        path: the pair file.
        sha256: the expected hash of the file.
        others: names of further grids to read (`further_grids`).

    Raises:
        ReleaseError: the file is missing, or differs from the published one.
    """
    names = (*GRIDS, *NUMBERS, *others)
    full, known, seen, voxel_size_m, surface_sigma_m, *more = read_parts(path, sha256, names)
    further = dict(zip(others, more, strict=True))
    return PackedTruth(full, known, seen, float(voxel_size_m), float(surface_sigma_m), further)


def read_voxel_size(path: Path, sha256: str) -> float:
    """Read the voxel size of a published pair: the edge of a cell of its 256-grid, metres.

    Raises:
        ReleaseError: the file is missing, or differs from the published one.
    """
    return float(read_parts(path, sha256, ("voxel_size_m",))[0])


def read_parts(path: Path, sha256: str, names: Sequence[str]) -> list[FileArray]:
    """Read only the named grids (packed) or lengths from a published pair file, in the order of `names`.

    Lengths are 0-d, float64, in metres.

    Raises:
        ReleaseError: the file is missing, or differs from the published one.
    """
    content = published_bytes(path, sha256)
    try:
        return pair_parts(content, names)
    except UNREADABLE as error:
        raise ReleaseError(f"{path}: not a pair file ({error}); was it published whole?") from error
