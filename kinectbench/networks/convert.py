"""Convert the checkpoint of 3D-RecGAN++'s authors to a method that `predict` can run, without TensorFlow."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import StorageError, printable, replaced_file, sha256_file
from kinectbench.core.artefacts.method import TrainingFile
from kinectbench.core.types import Float32
from kinectbench.networks.config import FOLDER, MethodSettings, read_config
from kinectbench.networks.recae import BOTTOM_CELLS, DECODER, ENCODER
from kinectbench.networks.recgan import CHANNELS
from kinectbench.networks.registry import make_network
from kinectbench.networks.run_folder import prepare_folder
from kinectbench.networks.tensor_bundle import StoredTensor, TensorBundle, open_bundle
from kinectbench.networks.trained import open_trained
from kinectbench.networks.weights import FILE, write_weights

# Name of the converted method, and the file of the packaged configuration that it follows.
NAME, CONFIG = "3d-recgan++-released", "3d-recgan++-code.yaml"
SUFFIX = ".index"
# Tensors of Adam's state and its steps, needed only to continue training.
OF_THE_OPTIMISER = ("/Adam", "/Adam_1", "beta1_power", "beta2_power", "beta1_power_1", "beta2_power_1")


@dataclass(frozen=True)
class Mapped:
    """How a tensor of the checkpoint is converted to a tensor of the network.

    Attributes:
        name: the tensor's name in the network.
        axes: order in which the axes of a convolution's tensor are taken (`numpy.transpose`); None for other
            tensors.
        rows: the axis that runs over cells and channels, in a fully connected layer or its bias; None for
            other tensors.
    """

    name: str
    axes: tuple[int, ...] | None = None
    rows: int | None = None

    def arranged(self, values: Float32) -> Float32:
        """Return the checkpoint's values with axes in the network's order."""
        if self.axes is not None:
            return np.ascontiguousarray(values.transpose(self.axes))
        if self.rows is not None:
            values = _channels_first(values, self.rows)
        return np.ascontiguousarray(values.T)  # no change for a vector

    def stored_shape(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        """Return the shape that a tensor has in the checkpoint, given its `shape` in the network."""
        if self.axes is not None:
            return tuple(shape[self.axes.index(axis)] for axis in range(len(shape)))
        return tuple(reversed(shape))


def _channels_first(values: Float32, axis: int) -> Float32:
    """Reorder an axis that runs over 4 x 4 x 4 cells and channels from channels-last to channels-first."""
    first = np.moveaxis(values, axis, 0)
    cells = first.reshape(*3 * (BOTTOM_CELLS,), -1, *first.shape[1:])
    return np.moveaxis(np.moveaxis(cells, 3, 0).reshape(first.shape), 0, axis)


@dataclass(frozen=True)
class Conversion:
    """The result of converting a checkpoint.

    Attributes:
        folder: the method's folder.
        tensors: number of converted tensors.
        generator, discriminator: numbers of parameter values of the two networks.
        optimiser: number of tensors of the optimiser, which are not needed.
        left_out: names and shapes of all other tensors of the checkpoint, which the network does not have.
    """

    folder: Path
    tensors: int
    generator: int
    discriminator: int
    optimiser: int
    left_out: tuple[str, ...]

    @property
    def lines(self) -> list[str]:
        """Return the lines to print: numbers of converted values, tensors left out, and the folder."""
        fitted = (
            f"{self.tensors} tensors fit: generator {self.generator:,}, discriminator {self.discriminator:,}"
        )
        left = [f"left out: {name}" for name in self.left_out]
        return [f"{fitted}; {self.optimiser} of the optimiser are not needed", *left, f"wrote {self.folder}"]


# For both kinds of convolution, the two channel axes are swapped and come first.
CHANNELS_FIRST = (4, 3, 0, 1, 2)


def mapping() -> dict[str, Mapped]:
    """Return {name of a tensor in the checkpoint: how it is converted}.

    The axes of a convolution are [x, y, z, in, out] in the checkpoint and [out, in, x, y, z] in the network.
    Those of a transposed convolution are [x, y, z, out, in] and [in, out, x, y, z].
    """
    mapped: dict[str, Mapped] = {}
    parts = [(f"aeu/e{k + 1}", f"down.{k}") for k in range(len(ENCODER))]
    parts += [(f"aeu/d{k + 1}", f"up.{k}") for k in range(len(DECODER))]
    parts += [("aeu/dlast", f"up.{len(DECODER)}")]
    parts += [(f"dis/d{k + 1}", f"discriminator.layers.{k}") for k in range(len(CHANNELS))]
    for theirs, ours in parts:
        mapped |= {
            f"{theirs}_w": Mapped(f"{ours}.weight", CHANNELS_FIRST),
            f"{theirs}_b": Mapped(f"{ours}.bias"),
        }
    return mapped | {
        "aeu/fc1_w": Mapped("to_vector.weight", rows=0),
        "aeu/fc1_b": Mapped("to_vector.bias"),
        "aeu/fc2_w": Mapped("from_vector.weight", rows=1),
        "aeu/fc2_b": Mapped("from_vector.bias", rows=0),
    }


def convert_recgan(model: Path, out: Path) -> Conversion:
    """Convert the checkpoint of 3D-RecGAN++'s authors, and write the method's folder.

    Args:
        model: a folder with `<name>.index` and `<name>.data-00000-of-00001`, or the path of the index.
        out: the method's folder.

    Raises:
        StorageError: there is no checkpoint, one of its files is missing or damaged, tensors do not fit (one
            line each), or the disk is full or read-only.
        SettingsError: `out` belongs to another training.
    """
    bundle = open_bundle(_find_index(model))
    config = fitting_config(bundle.tensors, bundle.index)
    shapes = {n: tuple(v.shape) for n, v in make_network(config.network, device="meta").state_dict().items()}
    names = mapping()
    problems = tensor_misfits(
        bundle.tensors, {name: to.stored_shape(shapes[to.name]) for name, to in names.items()}
    )
    if problems:
        raise StorageError(*(f"{bundle.index}: {problem}" for problem in problems))
    arrays = {to.name: to.arranged(bundle.read(name)) for name, to in names.items()}
    prepare_folder(out, config)
    write_weights({name: arrays[name] for name in shapes}, out / FILE)
    _write_training(bundle, arrays, config, out)
    open_trained(out)  # check that it is a readable method
    generator = sum(values.size for name, values in arrays.items() if not name.startswith("discriminator."))
    others = [name for name in bundle.tensors if name not in names]
    optimiser = [name for name in others if name.endswith(OF_THE_OPTIMISER)]
    left_out = tuple(
        f"{printable(n)} {bundle.tensors[n].shape}" for n in others if not n.endswith(OF_THE_OPTIMISER)
    )
    discriminator = sum(values.size for values in arrays.values()) - generator
    return Conversion(out, len(arrays), generator, discriminator, len(optimiser), left_out)


def _find_index(model: Path) -> Path:
    """Return a checkpoint's index: `model` itself if it ends in .index, else the only one in the folder."""
    if model.suffix == SUFFIX:
        return model
    if not model.is_dir():
        raise StorageError(f"{model}: no such folder; wanted one that holds a checkpoint")
    indices = sorted(model.glob(f"*{SUFFIX}"))
    if len(indices) != 1:
        what = f"{len(indices)} checkpoints" if indices else "no checkpoint"
        raise StorageError(
            f"{model}: {what} there; wanted one <name>{SUFFIX} with its <name>.data-00000-of-00001"
        )
    return indices[0]


def fitting_config(tensors: Mapping[str, StoredTensor], index: Path) -> MethodSettings:
    """Return the network configuration whose first layer has the width of the checkpoint's.

    Raises:
        StorageError: the checkpoint is not of 3D-RecGAN++.
    """
    first = tensors.get("aeu/e1_w")
    channels = first.shape[-1] if first is not None and first.shape else 0
    if not 0 < channels <= ENCODER[0]:
        raise StorageError(f"{index}: no checkpoint of 3D-RecGAN++: 'aeu/e1_w' is missing or too wide")
    values = read_config(FOLDER / CONFIG).model_dump()
    values["name"] = NAME
    values["network"] |= {"channel_divisor": ENCODER[0] // channels, "axes": "recgan"}
    return MethodSettings.model_validate(values)


def tensor_misfits(tensors: Mapping[str, StoredTensor], wanted: Mapping[str, tuple[int, ...]]) -> list[str]:
    """Return a line for each tensor that is missing or of another shape than `wanted`, {name: shape}."""
    lines = []
    for name, shape in wanted.items():
        if name not in tensors:
            lines.append(f"'{name}' is missing")
        elif tensors[name].shape != shape:
            lines.append(f"'{name}' is {tensors[name].shape} where the network needs {shape}")
    return lines


def _write_training(
    bundle: TensorBundle, arrays: Mapping[str, NDArray[np.generic]], config: MethodSettings, out: Path
) -> None:
    file = TrainingFile(
        name=config.name,
        config_sha256=config.sha256,
        parameter_count=sum(values.size for values in arrays.values()),
        source=f"checkpoint of TensorFlow, {bundle.index.name} with SHA-256 {sha256_file(bundle.index)}",
    )
    with replaced_file(out / TrainingFile.FILE) as temporary:
        temporary.write_text(file.text(), encoding="utf-8")


# Converters by the name that the command takes.
CONVERTERS: Mapping[str, Callable[[Path, Path], Conversion]] = {"recgan": convert_recgan}
