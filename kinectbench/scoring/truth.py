"""The truth of a pair as scoring reads it: three of the pair file's grids, still packed."""

import hashlib
import io
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinectbench.errors import ReleaseError
from kinectbench.voxels.pair_file import PACKED_SHAPES, Packed

GRIDS = ("full", "known", "seen")


@dataclass(frozen=True)
class Truth:
    """Packed truth (see pair_file.py): each (256, 256, 32) uint8, C order.

    Attributes:
        full: the solid shape.
        known: where the truth is trusted.
        seen: what the input view saw.
    """

    full: Packed
    known: Packed
    seen: Packed

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
    return Truth(*read_grids(path, sha256, GRIDS))


def read_grids(path: Path, sha256: str, names: Sequence[str]) -> list[Packed]:
    """Read some packed grids of a published pair file, in the order of `names`.

    Raises:
        ReleaseError: the file is missing, or not the published one.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ReleaseError(
            f"{path}: cannot be read ({error.strerror}); download the release again"
        ) from error
    if hashlib.sha256(content).hexdigest() != sha256:
        raise ReleaseError(f"{path}: not the file that was published (SHA-256 differs); download it again")
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            grids = [np.ascontiguousarray(archive[name]) for name in names]
    except (ValueError, KeyError, EOFError, OSError, zipfile.BadZipFile, zlib.error) as error:
        raise ReleaseError(f"{path}: not a pair file ({error}); was it published whole?") from error
    for name, grid in zip(names, grids, strict=True):
        if grid.dtype != np.uint8 or grid.shape != PACKED_SHAPES[name]:
            raise ReleaseError(
                f"{path}: '{name}' is {grid.dtype}{grid.shape}, not uint8{PACKED_SHAPES[name]}"
            )
    return grids
