"""weights.npz: a network's values by name, float32 or float16; plain numpy opens it."""

import math
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.errors import StorageError
from kinectbench.core.storage import replaced_file
from kinectbench.core.untrusted import printable
from kinectbench.core.voxels.npz import UNREADABLE, load_arrays

FILE = "weights.npz"
# Varley's 1.72 GB is the largest network here (own choice).
MOST_BYTES = 4 << 30
KINDS = tuple(np.dtype(kind) for kind in (np.float16, np.float32, np.float64, np.int64))
# Of a value in the widest of these; and of an array, its header.
WIDEST_BYTES, HEADER_BYTES = 8, 1 << 10

Arrays = Mapping[str, NDArray[Any]]
Shapes = Mapping[str, tuple[int, ...]]


def write_weights(arrays: Arrays, path: Path) -> None:
    """Write arrays by name, not compressed, one after another: the same bytes for the same values."""
    with replaced_file(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.external_attr = 0o644 << 16
            entry.file_size = array.nbytes + (1 << 10)
            with archive.open(entry, "w") as stream:
                np.lib.format.write_array(stream, np.asarray(array, order="C"), allow_pickle=False)


def read_weights(path: Path, shapes: Shapes | None = None) -> dict[str, NDArray[Any]]:
    """Read the arrays of a file that may come from anybody.

    Args:
        path: the file.
        shapes: of the network that they are for, by name: a file that unpacks to more than this takes in
            float64 is refused before it is unpacked. None: of whatever network.

    Raises:
        StorageError: it is missing, damaged, too large for the network, or no such file.
    """
    most = MOST_BYTES
    if shapes is not None:
        most = sum(WIDEST_BYTES * math.prod(shape) + HEADER_BYTES for shape in shapes.values())
    try:
        arrays = load_arrays(path, most)
    except FileNotFoundError:
        raise StorageError(f"{path}: missing; train the method again, or get its folder whole") from None
    except UNREADABLE as error:
        raise StorageError(f"{path}: cannot be read as weights ({error}); get the file again") from error
    for name, array in arrays.items():
        if problem := _problem(name, array):
            raise StorageError(f"{path}: '{printable(name)}' holds {problem}; get the file again")
    return arrays


def _problem(name: str, array: NDArray[Any]) -> str:
    """What no network can hold; "" if it can."""
    if array.dtype not in KINDS:
        return "what are no finite numbers in float16, float32, float64 or int64, low bytes first"
    # A float64 may be larger than what the network has.
    if not (np.abs(array) <= np.finfo(np.float32).max).all():
        return "what are no finite numbers"
    return "negative variances" if name.endswith("running_var") and (array < 0).any() else ""


def shapes_of_network(network: Any) -> dict[str, tuple[int, ...]]:
    """The shapes of a torch module's values by name; they may lie on "meta"."""
    return {name: tuple(values.shape) for name, values in network.state_dict().items()}


def arrays_of_network(network: Any) -> dict[str, NDArray[Any]]:
    """The values of a torch module by name, on the CPU."""
    return {name: values.detach().cpu().numpy() for name, values in network.state_dict().items()}


def set_weights(network: Any, arrays: Arrays, where: str) -> None:
    """Give a torch module its values.

    Raises:
        StorageError: a name or a shape does not fit; a line for each, that begins with `where`.
    """
    import torch

    check_fit(shapes_of_network(network), arrays, where)
    with torch.no_grad():
        for name, values in network.state_dict().items():
            values.copy_(torch.from_numpy(np.array(arrays[name])))


def check_fit(wanted: Shapes, arrays: Arrays, where: str) -> None:
    """Refuse arrays that are not those of a network.

    Raises:
        StorageError: a name or a shape does not fit; a line for each, that begins with `where`.
    """
    if problems := list(misfits(wanted, arrays)):
        raise StorageError(*(f"{where}: {problem}" for problem in problems[:20]))


def misfits(wanted: Shapes, arrays: Arrays) -> Iterator[str]:
    """Yield a line for each array that is missing, of another shape, or not wanted."""
    for name, shape in wanted.items():
        if name not in arrays:
            yield f"'{name}' is missing"
        elif arrays[name].shape != shape:
            yield f"'{name}' is {arrays[name].shape} where the network has {shape}"
    for name in arrays:
        if name not in wanted:
            yield f"'{printable(name)}' is in no such network"
