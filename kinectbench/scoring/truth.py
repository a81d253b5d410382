"""The truth of a pair as scoring reads it: three of the pair file's grids, still packed."""

import hashlib
import io
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.errors import ReleaseError
from kinectbench.core.voxels.pair_file import PACKED_SHAPES, Packed

GRIDS = ("full", "known", "seen")
LENGTHS = ("voxel_size_m", "surface_sigma_m")
Value = TypeVar("Value")


@dataclass(frozen=True)
class Truth:
    """Packed truth (see pair_file.py): each (256, 256, 32) uint8, C order.

    Attributes:
        full: the solid shape.
        known: where the truth is trusted.
        seen: what the input view saw.
        voxel_size_m: edge of a cell, metres.
        surface_sigma_m: standard deviation of the truth's surface, metres.
    """

    full: Packed
    known: Packed
    seen: Packed
    voxel_size_m: float = 1.0
    surface_sigma_m: float = 0.0

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
    content = _published(path, sha256)
    full, known, seen = _arrays(path, content, GRIDS, _grid)
    voxel_size_m, surface_sigma_m = _arrays(path, content, LENGTHS, _length)
    return Truth(full, known, seen, voxel_size_m, surface_sigma_m)


def read_voxel_size(path: Path, sha256: str) -> float:
    """Edge of a cell of the 256-grid of a published pair, metres.

    Raises:
        ReleaseError: the file is missing, or not the published one.
    """
    return _arrays(path, _published(path, sha256), LENGTHS[:1], _length)[0]


def read_grids(path: Path, sha256: str, names: Sequence[str]) -> list[Packed]:
    """Read some packed grids of a published pair file, in the order of `names`.

    Raises:
        ReleaseError: the file is missing, or not the published one.
    """
    return _arrays(path, _published(path, sha256), names, _grid)


def _published(path: Path, sha256: str) -> bytes:
    """The bytes of a pair file."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ReleaseError(
            f"{path}: cannot be read ({error.strerror}); download the release again"
        ) from error
    if hashlib.sha256(content).hexdigest() != sha256:
        raise ReleaseError(f"{path}: not the file that was published (SHA-256 differs); download it again")
    return content


def _arrays(
    path: Path, content: bytes, names: Sequence[str], convert: Callable[[str, NDArray[Any]], Value]
) -> list[Value]:
    """Some arrays of a pair file, each converted by `convert(name, array)`, which may raise ValueError."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            return [convert(name, archive[name]) for name in names]
    except (ValueError, KeyError, EOFError, OSError, zipfile.BadZipFile, zlib.error) as error:
        raise ReleaseError(f"{path}: not a pair file ({error}); was it published whole?") from error


def _grid(name: str, array: NDArray[Any]) -> Packed:
    if array.dtype != np.uint8 or array.shape != PACKED_SHAPES[name]:
        raise ValueError(f"'{name}' is {array.dtype}{array.shape}, not uint8{PACKED_SHAPES[name]}")
    return np.ascontiguousarray(array)


def _length(name: str, array: NDArray[Any]) -> float:
    if array.shape != () or array.dtype.kind != "f" or not 0 <= array < np.inf:
        raise ValueError(f"'{name}' is not a length in metres")
    return float(array)
