"""weights.npz: a network's values by name, float32 or float16; plain numpy opens it."""

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

Arrays = Mapping[str, NDArray[Any]]


def write_weights(arrays: Arrays, path: Path) -> None:
    """Write arrays by name, not compressed, one after another: the same bytes for the same values."""
    with replaced_file(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.external_attr = 0o644 << 16
            entry.file_size = array.nbytes + (1 << 10)
            with archive.open(entry, "w") as stream:
                np.lib.format.write_array(stream, np.asarray(array, order="C"), allow_pickle=False)


def read_weights(path: Path) -> dict[str, NDArray[Any]]:
    """Read the arrays of a file that may come from anybody.

    Raises:
        StorageError: it is missing, damaged, or no such file.
    """
    try:
        arrays = load_arrays(path, MOST_BYTES)
    except FileNotFoundError:
        raise StorageError(f"{path}: missing; train the method again, or get its folder whole") from None
    except UNREADABLE as error:
        raise StorageError(f"{path}: cannot be read as weights ({error}); get the file again") from error
    wrong = [
        name for name, array in arrays.items() if array.dtype.kind not in "fi" or not np.isfinite(array).all()
    ]
    if wrong:
        raise StorageError(
            f"{path}: '{printable(wrong[0])}' holds what are no finite numbers; get the file again"
        )
    return arrays


def arrays_of_network(network: Any) -> dict[str, NDArray[Any]]:
    """The values of a torch module by name, on the CPU."""
    return {name: values.detach().cpu().numpy() for name, values in network.state_dict().items()}


def set_weights(network: Any, arrays: Arrays, where: str) -> None:
    """Give a torch module its values.

    Raises:
        StorageError: a name or a shape does not fit; a line for each, that begins with `where`.
    """
    import torch

    state = network.state_dict()
    problems = list(misfits({name: tuple(values.shape) for name, values in state.items()}, arrays))
    if problems:
        raise StorageError(*(f"{where}: {problem}" for problem in problems[:20]))
    with torch.no_grad():
        for name, values in state.items():
            values.copy_(torch.from_numpy(np.array(arrays[name])))


def misfits(wanted: Mapping[str, tuple[int, ...]], arrays: Arrays) -> Iterator[str]:
    """Yield a line for each array that is missing, of another shape, or not wanted."""
    for name, shape in wanted.items():
        if name not in arrays:
            yield f"'{name}' is missing"
        elif arrays[name].shape != shape:
            yield f"'{name}' is {arrays[name].shape} where the network has {shape}"
    for name in arrays:
        if name not in wanted:
            yield f"'{printable(name)}' is in no such network"
