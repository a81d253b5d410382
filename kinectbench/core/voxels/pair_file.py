"""The pair file: one npz that plain numpy opens. Boolean grids are bit-packed along the last axis.

A `Pair` holds a view and its truth; a `PairInput` is the same without the truth: the input of a method,
and the public part.
"""

import io
from collections.abc import Collection, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import PairError, read_plain
from kinectbench.core.geometry import Grid
from kinectbench.core.types import Arrays, Bools, FileArray, Float64
from kinectbench.core.voxels.npz import NPY, UNREADABLE, arrays_of, open_npz, packed_npz_bytes

FORMAT_VERSION, VERSION_KEY = 1, "format_version"
FULL_CELLS = 256
PARTIAL_CELLS = 64
BLOCK = FULL_CELLS // PARTIAL_CELLS
# Grids, matrices and texts of a pair, unpacked from its npz, are 14.7 MB; the file itself is smaller.
MAX_BYTES = 16 << 20
# Decimals of a pair's unknown share where a file states it, as of the other shares.
SHARE_DECIMALS = 4

Packed = NDArray[np.uint8]

PACKED_256 = ("partial_256", "full", "shell", "known", "seen", "interior", "said")
PACKED_SHAPES = {
    "partial": (PARTIAL_CELLS, PARTIAL_CELLS, PARTIAL_CELLS // 8),
    **dict.fromkeys(PACKED_256, (FULL_CELLS, FULL_CELLS, FULL_CELLS // 8)),
}
MATRIX_SIDES = {"T_world_grid": 4, "T_world_camera": 4, "K": 3}
NUMBERS = ("voxel_size_m", "surface_sigma_m")
TEXTS = ("framing", "partial_rule", "occupancy_rule")


@dataclass(frozen=True)
class Pair:
    """One single-view completion problem and its truth; the keys are described with the fields.

    Grid axes are the view's optical axes. Packed grids are uint8, (64, 64, 8) of `partial` and (256, 256, 32)
    of the others; matrices are float64. `occupancy_rule` states which cells of `full` are occupied.
    "winding": the centre is inside a closed mesh. "seeable": also where no camera could see it. "six-rays":
    the authors' rule for meshes that are not watertight. `interior` and `said` mark the cells of `known` that
    were not measured; they are None if that is not recorded, as in files of earlier versions.
    """

    partial: Packed = field(
        metadata={
            "description": "input: cells with the view's depth on the object, partial_256 reduced by "
            "partial_rule"
        }
    )
    partial_256: Packed = field(metadata={"description": "the same cells before reduction"})
    full: Packed = field(metadata={"description": "truth: cells of the solid shape"})
    shell: Packed = field(metadata={"description": "truth: surface cells of full"})
    known: Packed = field(metadata={"description": "cells where the truth is trusted"})
    seen: Packed = field(metadata={"description": "cells in the view's frustum and not behind its depth"})
    T_world_grid: Float64 = field(
        metadata={
            "description": "cell (i, j, k) of full has its centre at "
            "T_world_grid @ ((i+.5, j+.5, k+.5) * voxel_size_m)"
        }
    )
    T_world_camera: Float64 = field(metadata={"description": "pose of the view: camera to world, metres"})
    K: Float64 = field(metadata={"description": "intrinsics of the view, pixels; pixel centres are integers"})
    voxel_size_m: float = field(metadata={"description": "edge of a cell of the 256^3 grid, metres"})
    surface_sigma_m: float = field(
        metadata={
            "description": "standard deviation of the truth's surface, metres; 0 if it is exact or not known"
        }
    )
    framing: str = field(metadata={"description": "what the cube is fitted to: object or view"})
    partial_rule: str = field(
        metadata={
            "description": "when a block of 4x4x4 cells of partial_256 becomes one occupied cell: any or "
            "majority"
        }
    )
    occupancy_rule: str = field(
        default="winding",
        metadata={
            "description": "rule for cells of full: winding, seeable or six-rays; files without it: winding"
        },
    )
    interior: Packed | None = field(
        default=None,
        metadata={
            "description": "cells of known that were not measured: no line of sight reaches them; not in "
            "every file"
        },
    )
    said: Packed | None = field(
        default=None,
        metadata={
            "description": "cells of known that rest only on the word of who recorded the object; not in "
            "every file"
        },
    )

    @property
    def grid(self) -> Grid:
        """The grid of 256 cells a side, placed in the world."""
        return Grid((FULL_CELLS,) * 3, self.voxel_size_m, self.T_world_grid)

    @cached_property
    def unknown_share(self) -> float:
        """Share of the cells of `full` that are not `known`; 0 if `full` is empty."""
        return unknown_share(self.full, self.known)

    @property
    def visible_share(self) -> float:
        """Share of the cells of `shell`, the true surface, that the view saw; 1 if `shell` is empty."""
        return 1.0 - unknown_share(self.shell, self.seen)

    @property
    def stated_unknown_share(self) -> float:
        """`unknown_share`, rounded as targets.csv and other files state it."""
        return round(self.unknown_share, SHARE_DECIMALS)


@dataclass(frozen=True)
class PairInput:
    """The input of a pair, without its truth; the fields are those of `Pair`."""

    partial: Packed
    partial_256: Packed
    seen: Packed
    T_world_grid: Float64
    T_world_camera: Float64
    K: Float64
    voxel_size_m: float
    framing: str
    partial_rule: str

    @property
    def grid(self) -> Grid:
        """The grid of 256 cells a side, placed in the world."""
        return Grid((FULL_CELLS,) * 3, self.voxel_size_m, self.T_world_grid)


INPUT_KEYS = tuple(field.name for field in fields(PairInput))
OPTIONAL = tuple(field.name for field in fields(Pair) if field.default is None)
TRUTH_KEYS = ("full", "shell", "known", *OPTIONAL, "surface_sigma_m")

AnyPair = TypeVar("AnyPair", Pair, PairInput)


def unknown_share(full: Packed, known: Packed) -> float:
    """Return the share of the cells of a packed shape that are not known; 0 if the shape is empty."""
    cells = packed_count(full)
    return (cells - packed_count(full & known)) / cells if cells else 0.0


def packed_count(packed: Packed) -> int:
    """Count the set bits of a packed grid; it must be contiguous, with a multiple of 8 bytes."""
    return int(np.bitwise_count(packed.reshape(-1).view(np.uint64)).sum())


def pack(occupancy: Bools) -> Packed:
    """Pack booleans (..., n) into bytes (..., n / 8), most significant bit first."""
    return np.packbits(occupancy, axis=-1)


def unpack(packed: Packed) -> Bools:
    """Unpack bytes (..., n / 8) into booleans (..., n)."""
    return np.unpackbits(packed, axis=-1).view(np.bool_)


def pair_bytes(pair: Pair | PairInput) -> bytes:
    """Serialise a pair or an input as a compressed npz, the same bytes every time."""
    values = {f.name: getattr(pair, f.name) for f in fields(pair)}
    arrays = {name: np.asarray(value) for name, value in values.items() if value is not None}
    return packed_npz_bytes(arrays | {VERSION_KEY: np.asarray(FORMAT_VERSION)})


def read_pair(path: Path) -> Pair:
    """Read a pair file and check every key, shape and dtype.

    Raises:
        PairError: the file is missing, damaged, or not a pair of a known format version.
    """
    return _read(Pair, path)


def read_input(path: Path) -> PairInput:
    """Read the input of a pair file, with or without its truth, and check every key, shape and dtype.

    Raises:
        PairError: the file is missing, damaged, or not a pair of a known format version.
    """
    return _read(PairInput, path)


def _read(kind: type[AnyPair], path: Path) -> AnyPair:
    return checked_pair(kind, pair_values(pair_content(path), str(path)), str(path))


def pair_content(path: Path) -> bytes:
    """Return the bytes of a pair file, unchecked.

    Raises:
        PairError: it is missing, too large, or cannot be read.
    """
    try:
        return read_plain(path, MAX_BYTES)
    except OSError as error:
        raise PairError(f"{path}: cannot be read as a pair file ({error}); make it again") from error


def pair_values(content: bytes, where: str) -> Arrays:
    """Return {key: array} of an untrusted pair file; keys, shapes and dtypes are not checked.

    Raises:
        PairError: the file is damaged, or claims to hold more than a pair; the message begins with `where`.
    """
    try:
        return arrays_of(io.BytesIO(content), MAX_BYTES)
    except UNREADABLE as error:
        raise PairError(f"{where}: cannot be read as a pair file ({error}); make it again") from error


def pair_parts(content: bytes, names: Collection[str]) -> list[FileArray]:
    """Return some arrays of a pair file, checked, in the order of `names`; the others are not unpacked.

    A key that files of earlier versions lack has its default.

    Raises:
        UNREADABLE: one of these exceptions, if it is damaged, of another format version, or one of the arrays
            is missing or wrong.
    """
    values = arrays_of(io.BytesIO(content), MAX_BYTES, (VERSION_KEY, *names), _defaults(Pair))
    if fault := _version_fault(values):
        raise ValueError(fault)
    return [checked_parts(values, names)[name] for name in names]


def checked_parts(values: Arrays, names: Collection[str]) -> Arrays:
    """Check the shapes and dtypes of the arrays that `names` lists; return `values`, matrices as float64.

    Raises:
        ValueError: one of these arrays is wrong.
    """
    if fault := _fault_in(values, names):
        raise ValueError(fault)
    return {**values, **{name: as_float64(values[name]) for name in MATRIX_SIDES if name in names}}


def pair_keys(content: bytes) -> tuple[str, ...]:
    """Return the keys of a pair file, given its bytes; nothing is unpacked.

    Raises:
        UNREADABLE: one of these exceptions, if it is damaged.
    """
    with open_npz(io.BytesIO(content), MAX_BYTES) as archive:
        return tuple(name.removesuffix(NPY) for name in archive.namelist())


def keys_there(names: Sequence[str], content: bytes) -> list[str]:
    """Return `names` without those optional keys that the pair file (`content`) lacks.

    Raises:
        UNREADABLE: one of these exceptions, if it is damaged.
    """
    present = pair_keys(content) if set(OPTIONAL) & set(names) else ()
    return [name for name in names if name not in OPTIONAL or name in present]


def checked_pair(kind: type[AnyPair], values: Mapping[str, NDArray[np.generic]], where: str) -> AnyPair:
    """Make a pair or an input from the values of a pair file; every key, shape and dtype is checked.

    Raises:
        PairError: a key is missing or wrong, or the format version is another; the line begins with `where`.
    """
    values = _defaults(kind) | dict(values)
    names = [f.name for f in fields(kind) if f.name in values or f.name not in OPTIONAL]
    missing = [name for name in names if name not in values]
    if missing:
        what = "a pair file" if kind is Pair else "a pair's input"
        raise PairError(f"{where}: not {what}: the keys {', '.join(missing)} are missing")
    if fault := _version_fault(values) or _fault_in(values, names):
        raise PairError(f"{where}: {fault}")
    scalars = (*NUMBERS, *TEXTS)
    checked: dict[str, Any] = {n: values[n].item() if n in scalars else values[n] for n in names}
    checked |= {n: float(checked[n]) for n in NUMBERS if n in checked}
    checked |= {n: as_float64(values[n]) for n in MATRIX_SIDES if n in checked}
    return kind(**checked)


def as_float64(numbers: NDArray[np.generic]) -> Float64:
    """Return the real numbers of a file as float64 in the machine's byte order.

    A file may hold them as half, long double or with the bytes turned, which linear algebra does not take.
    """
    with np.errstate(over="ignore"):  # what float64 cannot hold becomes infinite
        return numbers.astype(np.float64, copy=False)


def _defaults(kind: type[Pair] | type[PairInput]) -> Arrays:
    """Return {key: default} of the keys that older files may lack, except the keys in `OPTIONAL`."""
    defaults = {f.name: f.default for f in fields(kind) if f.name not in OPTIONAL}
    return {name: np.asarray(value) for name, value in defaults.items() if value is not MISSING}


def _version_fault(values: Mapping[str, NDArray[np.generic]]) -> str | None:
    """Return the fault of a pair file's format version, in words; None if it has none."""
    version = values.get(VERSION_KEY, np.asarray(0))
    if version.shape != () or version.dtype.kind not in "iu" or version.item() != FORMAT_VERSION:
        return f"written in another format version; this package reads {FORMAT_VERSION}"
    return None


def _fault_in(values: Mapping[str, NDArray[np.generic]], names: Collection[str]) -> str | None:
    """Return the fault of the first bad array among `names`, in words; None if all are right."""
    for name, shape in PACKED_SHAPES.items():
        if name in names and (values[name].shape != shape or values[name].dtype != np.uint8):
            return f"'{name}' is {values[name].dtype}{values[name].shape}, not uint8{shape}"
    for name, side in MATRIX_SIDES.items():
        if name in names and not (values[name].shape == (side, side) and _invertible(values[name])):
            return f"'{name}' is not a finite {side}x{side} matrix with an inverse"
    for name in NUMBERS:
        if name in names and (
            values[name].shape != ()
            or not _finite(values[name])
            or values[name].item() < 0
            or (name == "voxel_size_m" and values[name].item() == 0)
        ):
            return f"'{name}' is not a length in metres"
    for name in TEXTS:
        if name in names and (values[name].shape != () or values[name].dtype.kind != "U"):
            return f"'{name}' is not a text"
    return None


def _invertible(matrix: NDArray[np.generic]) -> bool:
    with np.errstate(all="ignore"):
        return _finite(matrix) and bool(np.linalg.det(as_float64(matrix)) != 0)


def _finite(values: NDArray[np.generic]) -> bool:
    return values.dtype.kind in "fiu" and bool(np.isfinite(as_float64(values)).all())
