"""npz files with the same bytes for the same arrays, and readers that say what is wrong in one line."""

import io
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.errors import StorageError

# What numpy and zipfile raise for damaged files; an unknown compression is a NotImplementedError.
UNREADABLE = (
    OSError,
    ValueError,
    EOFError,
    KeyError,
    NotImplementedError,
    MemoryError,
    zipfile.BadZipFile,
    zlib.error,
)


def npz_bytes(arrays: Mapping[str, NDArray[Any]], level: int = 6) -> bytes:
    """Serialise named arrays as a compressed npz with fixed time stamps (np.savez writes the time of day).

    Args:
        arrays: name -> array, written in this order.
        level: of the deflate compression, 1 (fast) to 9.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=level) as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            payload = io.BytesIO()
            np.lib.format.write_array(payload, np.asarray(array, order="C"), allow_pickle=False)
            # An entry written by its ZipInfo does not take the archive's level.
            archive.writestr(entry, payload.getvalue(), compresslevel=level)
    return buffer.getvalue()


def load_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Read all arrays of an npz; no pickles.

    Raises:
        UNREADABLE: one of these exceptions, if the file is missing, damaged, or no npz.
    """
    # Opened here, because numpy leaves a damaged archive open.
    with path.open("rb") as file:
        return arrays_of(file)


def arrays_of(file: IO[bytes]) -> dict[str, NDArray[Any]]:
    """Read all arrays of an open npz; no pickles.

    Raises:
        UNREADABLE: one of these exceptions, if it is damaged or no npz.
    """
    archive = np.load(file, allow_pickle=False)
    if not isinstance(archive, np.lib.npyio.NpzFile):
        raise ValueError("it is a single array, not an npz")
    return {name: np.asarray(archive[name]) for name in archive.files}


def read_npz(path: Path) -> dict[str, NDArray[Any]]:
    """Read all arrays of an npz of a build.

    Raises:
        StorageError: missing or damaged.
    """
    try:
        return load_arrays(path)
    except UNREADABLE as error:
        raise StorageError(
            f"{path}: cannot be read ({error}); `kinectbench build --force` makes it again"
        ) from error
