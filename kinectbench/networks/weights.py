"""weights.npz: a network's values by name, float16, float32, float64 or int64; numpy can open it."""

import math
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import SettingsError, StorageError, open_plain, printable, replaced_file
from kinectbench.core.types import Arrays, FileArray
from kinectbench.core.voxels.npy import NpyError, NpyHeader, read_npy_header
from kinectbench.core.voxels.npz import NPY, UNREADABLE, open_npz

if TYPE_CHECKING:
    from torch.nn import Module

FILE = "weights.npz"
# Largest file: Varley's 1.72 GB is the largest network here.
MOST_BYTES = 4 << 30
KINDS = tuple(np.dtype(kind) for kind in (np.float16, np.float32, np.float64, np.int64))
OTHER_KIND = "what are no finite numbers in float16, float32, float64 or int64, low bytes first"
# Number of values read at a time: 8 MB of the widest kind.
SLAB_VALUES = 1 << 20
# Bytes of a value of the widest kind, and of an array's header.
WIDEST_BYTES, HEADER_BYTES = 8, 1 << 10

Shapes = Mapping[str, tuple[int, ...]]


def write_weights(arrays: Arrays, path: Path) -> None:
    """Write arrays by name, uncompressed and in the given order; the same values give the same bytes."""
    with replaced_file(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.external_attr = 0o644 << 16
            entry.file_size = array.nbytes + (1 << 10)
            with archive.open(entry, "w") as stream:
                np.lib.format.write_array(stream, np.asarray(array, order="C"), allow_pickle=False)


def read_weights(path: Path) -> Arrays:
    """Read the arrays of an untrusted file.

    Raises:
        StorageError: the file is missing, damaged, too large for any network, or no file of weights.
    """
    arrays = {
        name: np.empty(header.shape, header.dtype) for name, header in headers_of(path, MOST_BYTES).items()
    }
    for name, begin, values in _slabs(path, MOST_BYTES):
        arrays[name].reshape(-1)[begin : begin + len(values)] = values
    return arrays


def _slabs(path: Path, most_bytes: int) -> Iterator[tuple[str, int, NDArray[np.generic]]]:
    """Yield the values of a file in flat parts: (name of the array, index of the first value, values (n,)).

    In this way, the whole file is never in memory at once. It raises the errors of `read_weights`.
    """
    with _opened(path, most_bytes) as archive:
        for entry in archive.infolist():
            name = entry.filename.removesuffix(NPY)
            with archive.open(entry) as stream:
                header = read_npy_header(stream)
                total, width = math.prod(header.shape), header.dtype.itemsize
                if entry.file_size != header.data_offset + header.data_bytes:
                    raise NpyError("another length than it claims")
                for begin in range(0, total, SLAB_VALUES):
                    wanted = width * min(SLAB_VALUES, total - begin)
                    content = stream.read(wanted)
                    if len(content) < wanted:
                        raise NpyError("cut short")
                    values = np.frombuffer(bytearray(content), header.dtype)
                    _refuse(path, name, _problem(name, values))
                    yield name, begin, values
                stream.read(1)  # the end checks the archive's checksum


def headers_of(path: Path, most_bytes: int) -> dict[str, NpyHeader]:
    """Read the headers of a file's arrays, by name, without unpacking.

    Raises:
        StorageError: as in `read_weights`, or an array cannot be weights.
    """
    headers = dict[str, NpyHeader]()
    with _opened(path, most_bytes) as archive:
        for entry in archive.infolist():
            with archive.open(entry) as stream:
                header = read_npy_header(stream)
            name = entry.filename.removesuffix(NPY)
            if header.dtype not in KINDS:
                _refuse(path, name, OTHER_KIND)
            if header.fortran_order:
                _refuse(path, name, "its values column by column: store np.ascontiguousarray of it")
            headers[name] = header
    return headers


def _refuse(path: Path, name: str, problem: str) -> None:
    if problem:
        raise StorageError(f"{path}: '{printable(name)}' holds {problem}; get the file again")


@contextmanager
def _opened(path: Path, most_bytes: int) -> Iterator[zipfile.ZipFile]:
    """Open an npz of at most `most_bytes` unpacked; turn errors in the block into a one-line StorageError."""
    try:
        with open_plain(path) as file, open_npz(file, most_bytes) as archive:
            yield archive
    except FileNotFoundError:
        raise StorageError(f"{path}: missing; train the method again, or get its folder whole") from None
    except UNREADABLE as error:
        raise StorageError(f"{path}: cannot be read as weights ({error}); get the file again") from error


def _problem(name: str, array: FileArray) -> str:
    """Return, in a few words, why a network cannot have these values; "" if it can."""
    # A float64 may exceed float32. The comparison is also false for NaN.
    most = np.finfo(np.float32).max
    if not -most <= array.min() <= array.max() <= most:
        return "what are no finite numbers"
    return "negative variances" if name.endswith("running_var") and (array < 0).any() else ""


def shapes_of_network(network: "Module") -> dict[str, tuple[int, ...]]:
    """Return {name: shape} of a torch module's values, which may be on the device "meta"."""
    return {name: tuple(values.shape) for name, values in network.state_dict().items()}


def arrays_of_network(network: "Module") -> Arrays:
    """Return {name: values} of a torch module as numpy arrays."""
    return {name: values.detach().cpu().numpy() for name, values in network.state_dict().items()}


def check_values(network: "Module") -> None:
    """Refuse a network with values that a weights file cannot hold, such as NaN or another dtype.

    Raises:
        SettingsError: there is such a value; the message names it and says what is wrong.
    """
    import torch

    kinds = (torch.float16, torch.float32, torch.float64, torch.int64)
    for name, values in network.state_dict().items():
        plain = isinstance(values, torch.Tensor) and values.layout == torch.strided and values.dtype in kinds
        problem = OTHER_KIND if not plain else values.numel() and _problem(name, values.cpu().numpy())
        if problem:
            raise SettingsError(
                f"network: '{name}' holds {problem}, which weights cannot; a buffer that is made again needs "
                "register_buffer(…, persistent=False)"
            )


def set_weights(network: "Module", path: Path) -> None:
    """Load the values of a file whose headers are checked (`check_fit`) into a torch module, part by part.

    Raises:
        StorageError: as in `read_weights`.
    """
    import torch

    state = network.state_dict()
    with torch.no_grad():
        for name, begin, values in _slabs(path, bytes_of(shapes_of_network(network))):
            whole = state[name]
            if begin == 0:  # a convolution's memory may be ordered differently
                in_order = whole.is_contiguous()
                flat = whole.view(-1) if in_order else torch.empty(whole.numel(), dtype=whole.dtype)
            flat[begin : begin + len(values)] = torch.from_numpy(values)
            if not in_order and begin + len(values) == len(flat):
                whole.copy_(flat.view(whole.shape))


def bytes_of(shapes: Shapes) -> int:
    """Return the maximum unpacked size, bytes, of a file with values of the given {name: shape}."""
    return sum(WIDEST_BYTES * math.prod(shape) + HEADER_BYTES for shape in shapes.values())


def check_fit(wanted: Shapes, arrays: Mapping[str, NpyHeader], where: str) -> None:
    """Refuse arrays whose headers do not match the network.

    Raises:
        StorageError: a name or a shape does not fit; a line for each, at most 20, beginning with `where`.
    """
    if problems := list(_misfits(wanted, arrays)):
        raise StorageError(*(f"{where}: {problem}" for problem in problems[:20]))


def _misfits(wanted: Shapes, arrays: Mapping[str, NpyHeader]) -> Iterator[str]:
    """Yield a line for each array that is missing, of another shape, or not wanted."""
    for name, shape in wanted.items():
        if name not in arrays:
            yield f"'{name}' is missing"
        elif arrays[name].shape != shape:
            yield f"'{name}' is {arrays[name].shape} where the network has {shape}"
    for name in arrays:
        if name not in wanted:
            yield f"'{printable(name)}' is in no such network"
