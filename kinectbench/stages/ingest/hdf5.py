"""Arrays of an untrusted HDF5 file: numbers alone, of a size that is known before they are read."""

import io
from collections.abc import Iterable
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.errors import RecordingError
from kinectbench.stages.ingest.images import DamagedImageError

# What an HDF5 file begins with (its file format specification, III.A).
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
# What h5py raises for damaged files: by its own documentation no more than OSError, KeyError and ValueError;
# RuntimeError where the library knows no more.
DAMAGED = (OSError, KeyError, ValueError, RuntimeError, TypeError)


def hdf5_arrays(
    data: bytes, name: str, keys: Iterable[str], most_values: int
) -> dict[str, NDArray[np.generic]]:
    """The arrays of an HDF5 file that are there, by key; what lies in other files is not followed.

    Args:
        data: the file.
        name: where it comes from, for messages.
        keys: of its root that are asked for.
        most_values: more numbers than that are refused in one array.

    Raises:
        DamagedImageError: it is damaged, or one of them is too large or holds no numbers.
        RecordingError: h5py is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise RecordingError(
            f"{name}: is an HDF5 file; install what reads it with `pip install 'kinectbench[ycb]'`",
            what="no-package",
        ) from error
    found: dict[str, NDArray[np.generic]] = {}
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            for key in keys:
                if file.get(key, getlink=True) is not None:
                    found[key] = _array(h5py, file, key, most_values)
    except DAMAGED as error:
        said = str(error).strip().splitlines() or [type(error).__name__]
        raise DamagedImageError(f"{name}: the HDF5 file is damaged ({said[0]})") from error
    return found


def _array(h5py: Any, file: Any, key: str, most_values: int) -> NDArray[np.generic]:
    """One array; ValueError: it is none that is read."""
    if not isinstance(file.get(key, getlink=True), h5py.HardLink):
        raise ValueError(f"'{key}' is a link")
    entry = file[key]
    if not isinstance(entry, h5py.Dataset) or entry.is_virtual or entry.external:
        raise ValueError(f"'{key}' is no array of this file")
    if entry.dtype.kind not in "fui" or entry.shape is None or prod(entry.shape) > most_values:
        raise ValueError(f"'{key}' is {entry.dtype} of shape {entry.shape}")
    return np.asarray(entry[()])
