"""Load one submitted prediction. The file is untrusted: its header is checked before its values are read.

Packed predictions have probabilities in 8 bits: `levels`, and `codes`, which are indices into the levels. The
values that share a code are all on the same side of each threshold, so packing does not change the IoU at any
threshold. This holds for predictions at 256^3, which are counted without interpolation; coarser predictions
are not packed.
"""

import contextlib
import os
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import COPIED_BYTES, PredictionError, open_plain, printable, size_of
from kinectbench.core.artefacts.provenance import STEPS
from kinectbench.core.types import Arrays
from kinectbench.core.voxels.npy import NpyError, NpyHeader, read_npy
from kinectbench.core.voxels.npz import NPY, UNREADABLE, open_npz
from kinectbench.core.voxels.pair_file import FULL_CELLS
from kinectbench.core.voxels.resample import MAX_CELLS
from kinectbench.scoring.counts import CE_CLIP, THRESHOLDS, Prediction
from kinectbench.scoring.mesh_prediction import MAX_MESH_BYTES, MESHES, voxelised

# Arrays of these names mark a packed prediction.
CODES, LEVELS = "codes", "levels"
# Number of values of a byte.
MOST_LEVELS = 256
HALF_ONE = 0x3C00
# First number: levels between neighbouring thresholds. Second: beyond the outermost thresholds, the factor
# between the logits of successive bounds of levels. The demo's 16 views by `recae-small` take 6.3 MB per
# view, instead of 25.9 MB in float16; the cross-entropy changes by 0.05 %, at most by 0.1 %. On six of the
# views, with middles as levels, (4, 1.04) took 1.4 times the space and changed it by at most 0.02 %; (3,
# 1.15) took three quarters of the space and changed it by 0.25 %.
PARTS, GROWTH = 2, 1.08
# Weight of a value that does not occur, so that a level of only such values also lies among them.
UNUSED = 1e-9
OUTERMOST_LOGIT = float(np.log(THRESHOLDS[-1] / (1 - THRESHOLDS[-1])))


def packed(probability: NDArray[np.float16]) -> Arrays | None:
    """Pack a prediction into the arrays of its npz.

    A level is the mean of the values that share its code. With the middle of their range instead, the
    cross-entropy of a network that was trained for two steps, and predicted nearly the same value everywhere,
    changed by 2 %.

    Args:
        probability: (256, 256, 256), values in [0, 1].

    Returns:
        `levels` (m,) float16 ascending, m at most 256, and `codes` (256, 256, 256) uint8: a voxel's value is
        `levels[code]`. None if the prediction cannot be packed: its side is not 256, or a value is not in [0,
        1] (the reader reports such a value).
    """
    bits = probability.view(np.uint16) & 0x7FFF  # -0 is 0
    if probability.shape != (FULL_CELLS,) * 3 or bits.max() > HALF_ONE or probability.min() < 0:
        return None
    codes = _codes()
    # Plane by plane: counting needs eight bytes a voxel.
    counts = sum(np.bincount(plane.ravel(), minlength=len(codes)) for plane in bits)
    weights = np.maximum(counts, UNUSED)
    values = _values().astype(np.float64)
    levels = np.bincount(codes, weights * values) / np.bincount(codes, weights)
    return {LEVELS: levels.astype(np.float16), CODES: codes[bits]}


def unpacked(levels: NDArray[np.generic], codes: NDArray[np.uint8]) -> Prediction:
    """Return the values of a packed prediction, (n, n, n), in the dtype of `levels`; codes must be valid."""
    values: Prediction = np.take(levels, codes)
    return values


def _values() -> NDArray[np.float16]:
    """Return all float16 values from 0 to 1, ascending; so the index of a value is its bit pattern."""
    return np.arange(HALF_ONE + 1, dtype=np.uint16).view(np.float16)


@cache
def _codes() -> NDArray[np.uint8]:
    """Return the code of each of `_values`, ascending; each code is that of the previous value, or 1 more."""
    exact = _values().astype(np.float64)
    clipped = np.clip(exact, CE_CLIP, 1 - CE_CLIP)
    logits = np.abs(np.log(clipped / (1 - clipped)))
    above = np.searchsorted(THRESHOLDS, exact)  # number of thresholds below each value
    is_between = (above > 0) & (above < len(THRESHOLDS))
    beyond = np.log(np.maximum(logits / OUTERMOST_LOGIT, 1)) / np.log(GROWTH)
    part = np.where(is_between, np.ceil(exact * STEPS * PARTS), np.floor(beyond))
    keys = np.stack([above, part, exact == 0, exact == 1])  # 0 and 1 have codes of their own
    is_new = np.append(False, (np.diff(keys) != 0).any(axis=0))
    return is_new.cumsum(dtype=np.uint8)


MAX_BYTES = 4 * MAX_CELLS**3 + 64 * 1024  # largest array, header, zip overhead
HALF_MINUS_ZERO = 0x8000
ACCEPTED = "save float16 or float32 in [0, 1], or bool"


@dataclass(frozen=True)
class Loaded:
    """A prediction and facts about its file.

    Attributes:
        prediction: (n, n, n), as `load_prediction` returns it.
        digest: `blake3:` with the hash of the prediction's file.
        outside_share: share of a mesh's volume that lies outside the grid and was cut off; 0 for grids.
    """

    prediction: Prediction
    digest: str
    outside_share: float


def load_prediction(path: Path, name: str | None = None, voxel_size_m: float | None = None) -> Prediction:
    """Load and check one prediction.

    Args:
        path: an .npy file, an .npz file with exactly one array or a packed prediction, or a .ply or .obj
            mesh.
        name: how error messages call the file; default: by its path.
        voxel_size_m: edge of a voxel of the pair, metres; needed only for a mesh.

    Returns:
        (n, n, n) bool, float16 or float32, 1 <= n <= 512, C order, native byte order, all values in [0, 1].
        uint8 values 0 and 1, packed bits and meshes are returned as bool, packed probabilities as their
        levels.

    Raises:
        PredictionError: the file is invalid; the message is one line.
    """
    with _named_errors(str(name or path)), open_plain(path) as file:
        return _loaded(file, path.suffix, voxel_size_m)[0]


def load_hashed(path: Path, name: str, voxel_size_m: float | None = None) -> Loaded:
    """Load a prediction as `load_prediction` does, and return it with facts about its file.

    The file is opened once and read twice, for the prediction and for the hash. It must not change meanwhile.

    Raises:
        PredictionError: as in `load_prediction`, or the file changed.
    """
    with _named_errors(name), open_plain(path) as file:
        before = _state(file)
        prediction, outside = _loaded(file, path.suffix, voxel_size_m)
        file.seek(0)
        digest = blake3_of(file)
        if _state(file) != before:
            raise PredictionError("changed while it was read; score it when it is written", what="changed")
        return Loaded(prediction, digest, outside)


@contextlib.contextmanager
def _named_errors(name: str) -> Iterator[None]:
    """Turn errors about a prediction's file into a PredictionError of one line that begins with `name`."""
    try:
        yield
    except PredictionError as error:
        raise PredictionError(f"{name}: {error}", what=error.what) from None
    except NpyError as error:
        raise PredictionError(f"{name}: {error}; write it with np.save or np.savez") from None
    except OSError as error:
        raise PredictionError(
            f"{name}: cannot be read ({error.strerror or error})", what="unreadable"
        ) from error
    except UNREADABLE as error:
        raise PredictionError(
            f"{name}: a damaged npz ({error}); write it again", what="unreadable"
        ) from error


def _loaded(file: IO[bytes], suffix: str, voxel_size_m: float | None) -> tuple[Prediction, float]:
    if suffix in MESHES:
        _checked_size(file, MAX_MESH_BYTES)
        if voxel_size_m is None:
            raise PredictionError("a mesh; it needs the voxel size of its pair")
        return voxelised(file, suffix, voxel_size_m)
    return _grid(file, suffix), 0.0


def _state(file: IO[bytes]) -> tuple[int, int, int]:
    """Return a file's size and times (modification, change); one of them changes if it is written."""
    state = os.fstat(file.fileno())
    return state.st_size, state.st_mtime_ns, state.st_ctime_ns


def blake3_of(content: IO[bytes] | bytes) -> str:
    """Return `blake3:` and the hash of bytes, or of a file from its current position on."""
    # SHA-256 of a 33 MB prediction would take longer than the rest of its scoring.
    from blake3 import blake3

    digest = blake3()
    if isinstance(content, bytes):
        digest.update(content)
    else:
        while chunk := content.read(COPIED_BYTES):
            digest.update(chunk)
    return f"blake3:{digest.hexdigest()}"


def checked(array: NDArray[np.generic], name: str) -> Prediction:
    """Check a prediction in memory; return it as `load_prediction` would. The array itself is not changed.

    Raises:
        PredictionError: the array is invalid; the message is one line that begins with `name`.
    """
    try:
        _check_claims(NpyHeader(array.dtype, array.shape, False, 0))
        order = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("="))
        return _checked(order)
    except PredictionError as error:
        raise PredictionError(f"{name}: {error}", what=error.what) from None


def _grid(file: IO[bytes], suffix: str) -> Prediction:
    size = _checked_size(file, MAX_BYTES)
    if suffix == ".npy":
        return _checked(read_npy(file, size, _check_claims))
    with open_npz(file, MAX_BYTES) as archive:
        entries = archive.infolist()
        if {entry.filename for entry in entries} == {CODES + NPY, LEVELS + NPY}:
            return _decoded(archive)
        names = [entry.filename.removesuffix(NPY) for entry in entries]
        if len(names) != 1 or names[0] in (CODES, LEVELS):
            held = printable(", ".join(names), 60) or "none"
            raise PredictionError(
                f"holds {len(names)} array{'s' * (len(names) != 1)} ({held}): it must hold exactly one "
                f"prediction, or {CODES} and {LEVELS}"
            )
        return _checked(_read(archive, entries[0].filename, _check_claims))


def _decoded(archive: zipfile.ZipFile) -> Prediction:
    """Read a packed prediction (see `packed_prediction`)."""
    levels = _checked(_read(archive, LEVELS + NPY, _check_levels))
    codes = _native(_read(archive, CODES + NPY, _check_codes)).view(np.uint8)
    if codes.max() >= len(levels):
        index = _first(codes >= len(levels))
        raise PredictionError(f"{codes[index]} in {CODES} at {index}: there are {len(levels)} {LEVELS}")
    return unpacked(levels, codes)


def _read(archive: zipfile.ZipFile, name: str, check: Callable[[NpyHeader], None]) -> NDArray[np.generic]:
    with archive.open(name) as stream:
        return read_npy(stream, archive.getinfo(name).file_size, check)


def _check_levels(header: NpyHeader) -> None:
    """Refuse a packed prediction unless `levels` is a list of 1 to 256 floats; only the header is read."""
    types = (np.float16, np.float32)
    is_list = len(header.shape) == 1 and 1 <= header.shape[0] <= MOST_LEVELS
    if not is_list or header.dtype.newbyteorder("=") not in types:
        raise PredictionError(f"{LEVELS} must be 1 to {MOST_LEVELS} of float16 or float32 in [0, 1]")


def _check_codes(header: NpyHeader) -> None:
    """Refuse a packed prediction unless `codes` is a cube of bytes; only the header is read."""
    shape = header.shape
    if header.dtype != np.uint8 or len(shape) != 3 or len(set(shape)) != 1 or not 1 <= shape[0] <= MAX_CELLS:
        raise PredictionError(f"{CODES} must be (n, n, n) uint8 with n from 1 to {MAX_CELLS}")


def _checked_size(file: IO[bytes], most: int) -> int:
    """Return the size of a file; refuse an empty or too large one."""
    size = size_of(file)
    if size > most:
        raise PredictionError(f"{size} bytes; {most} is the most accepted", what="too-large")
    if size == 0:
        raise PredictionError("the file is empty", what="empty")
    return size


def _check_claims(header: NpyHeader) -> None:
    """Refuse an array with a wrong shape or dtype in its header, before memory is allocated for it."""
    shape, dtype = header.shape, header.dtype
    if _is_packed(shape, dtype):
        return
    if len(shape) != 3 or len(set(shape)) != 1 or not 1 <= shape[0] <= MAX_CELLS:
        raise PredictionError(
            f"shape {printable(str(shape), 60)}: it must be (n, n, n) with n from 1 to {MAX_CELLS}, "
            "or bits (n, n, n / 8)"
        )
    if dtype.newbyteorder("=") not in (np.bool_, np.uint8, np.float16, np.float32):
        raise PredictionError(f"dtype {dtype.name} is not accepted: {ACCEPTED}")


def _is_packed(shape: tuple[int, ...], dtype: np.dtype[np.generic]) -> bool:
    """Return whether an array of this shape and dtype is a cube of bits, packed along its last axis."""
    bits = dtype == np.uint8 and len(shape) == 3 and 8 <= shape[0] <= MAX_CELLS
    return bits and shape[0] == shape[1] == 8 * shape[2]


def _checked(array: NDArray[np.generic]) -> Prediction:
    """Return the array in native byte order and C order; refuse values outside [0, 1]."""
    if _is_packed(array.shape, array.dtype):
        # If the file is in Fortran order, so are the unpacked bits.
        return np.ascontiguousarray(np.unpackbits(array.view(np.uint8), axis=-1)).view(np.bool_)
    array = _native(array)
    if array.dtype == np.float16:
        if array.view(np.uint16).max() > HALF_ONE:  # rare: a negative zero or a bad value
            bits = array.view(np.uint16)
            _refuse_first(array, (bits > HALF_ONE) & (bits != HALF_MINUS_ZERO))
        return array.view(np.float16)
    if array.dtype == np.float32:
        reals = array.view(np.float32)
        if not (reals.min() >= 0 and reals.max() <= 1):  # false for NaN too
            _refuse_first(array, ~((reals >= 0) & (reals <= 1)))
        return reals
    raw = array.view(np.uint8)
    if raw.max() > 1:
        index = _first(raw > 1)
        kind = "uint8 is accepted" if array.dtype == np.uint8 else "a bool is accepted"
        raise PredictionError(
            f"{raw[index]} at {index}: {kind} only as 0 and 1; {ACCEPTED}", what="bad-values"
        )
    return raw.view(np.bool_)


def _native(array: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return a cube in native byte order and C order; convert in place, as it may take half a gigabyte."""
    if not array.dtype.isnative:
        array = array.byteswap(inplace=True).view(array.dtype.newbyteorder("="))
    if not array.flags.c_contiguous:
        array = array.T  # C order, x and z exchanged
        for plane in np.moveaxis(array, 1, 0):
            plane[...] = plane.T.copy()
    return array


def _refuse_first(array: NDArray[np.generic], bad: NDArray[np.bool_]) -> None:
    """Raise an error if `bad` marks any value of the array; the error states the first such value."""
    if bad.any():
        index = _first(bad)
        raise PredictionError(f"{array[index]} at {index}: every value must be in [0, 1]", what="bad-values")


def _first(bad: NDArray[np.bool_]) -> tuple[int, ...]:
    return tuple(int(i) for i in np.unravel_index(int(bad.argmax()), bad.shape))
