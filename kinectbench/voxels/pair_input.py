"""The input of a pair without its truth: what a method may look at, and what a public part publishes."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.errors import PairError
from kinectbench.voxels.packed_npz import packed_npz_bytes
from kinectbench.voxels.pair_file import FORMAT_VERSION, Packed, pair_fault, stored_values


@dataclass(frozen=True)
class PairInput:
    """What a view gives; the attributes are those of `Pair`.

    Attributes:
        partial: (64, 64, 8) uint8, packed.
        partial_256: (256, 256, 32) uint8, packed.
        seen: (256, 256, 32) uint8, packed.
        T_world_grid: (4, 4) float64.
        T_world_camera: (4, 4) float64.
        K: (3, 3) float64, pixels.
        voxel_size_m: edge of a cell of the 256-grid, metres.
        framing: "object" or "view".
        partial_rule: "any" or "majority".
    """

    partial: Packed
    partial_256: Packed
    seen: Packed
    T_world_grid: NDArray[np.float64]
    T_world_camera: NDArray[np.float64]
    K: NDArray[np.float64]
    voxel_size_m: float
    framing: str
    partial_rule: str


INPUT_KEYS = tuple(field.name for field in fields(PairInput))
TRUTH_KEYS = ("full", "shell", "known", "surface_sigma_m")


def input_bytes(pair_input: PairInput) -> bytes:
    """Serialise an input as a compressed npz, the same bytes every time."""
    arrays: dict[str, NDArray[np.generic]] = {key: np.asarray(getattr(pair_input, key)) for key in INPUT_KEYS}
    arrays["format_version"] = np.asarray(FORMAT_VERSION)
    return packed_npz_bytes(arrays)


def read_input(path: Path) -> PairInput:
    """Read the input of a pair file, with or without its truth, and check every key, shape and dtype.

    Raises:
        PairError: the file is missing, damaged, or not a pair of a known format version.
    """
    return checked_input(stored_values(path), str(path))


def checked_input(values: Mapping[str, NDArray[Any]], where: str) -> PairInput:
    """The values of a pair file as an input; every key, shape and dtype is checked.

    Raises:
        PairError: a key is missing or wrong; the line begins with `where`.
    """
    missing = [key for key in INPUT_KEYS if key not in values]
    if missing:
        raise PairError(f"{where}: not a pair's input: the keys {', '.join(missing)} are missing")
    fault = pair_fault(values, INPUT_KEYS)
    if fault:
        raise PairError(f"{where}: {fault}")
    return _input(values)


def holds_truth(path: Path) -> bool:
    """Whether a pair file holds anything of the truth.

    Raises:
        PairError: the file is missing or damaged.
    """
    return any(key in TRUTH_KEYS for key in stored_values(path))


def _input(values: Mapping[str, Any]) -> PairInput:
    scalars = {key: values[key].item() for key in ("voxel_size_m", "framing", "partial_rule")}
    return PairInput(**{key: scalars.get(key, values[key]) for key in INPUT_KEYS})
