"""Read a trained network from the folder of a training, or from the package by its name."""

from dataclasses import dataclass
from pathlib import Path

from kinectbench.core import SettingsError, listed, printable, sha256_file
from kinectbench.core.artefacts.method import TrainingFile
from kinectbench.networks.config import MethodSettings, packaged_configs, read_config
from kinectbench.networks.network import Network
from kinectbench.networks.recgan import RecGAN
from kinectbench.networks.registry import make_network
from kinectbench.networks.run_folder import CONFIG
from kinectbench.networks.weights import FILE, bytes_of, check_fit, headers_of, set_weights, shapes_of_network

# One folder for each network in the package, as `train` writes it, without its checkpoint.
FOLDER = Path(__file__).parent / "trained"


@dataclass(frozen=True)
class Trained:
    """A network with its weights.

    Attributes:
        config: the method's configuration.
        network: the network.
        weights_sha256: hash of weights.npz.
        training: content of training.json, which states how the weights were trained.
        device: torch's name of the device that the network is on.
    """

    config: MethodSettings
    network: Network
    weights_sha256: str
    training: TrainingFile
    device: str = "cpu"

    @property
    def running_parameters(self) -> int:
        """Number of parameters that predictions use, that is, without those of a discriminator."""
        if isinstance(self.network, RecGAN):
            return sum(values.numel() for values in self.network.generator_parameters())
        return self.network.parameter_count


def packaged_methods() -> tuple[str, ...]:
    """Return the names of the networks whose weights are in the package, sorted."""
    return tuple(sorted(path.parent.name for path in FOLDER.glob(f"*/{FILE}")))


def folder_of(name: str) -> Path:
    """Return the folder of a method, given its path or its name in the package.

    Raises:
        SettingsError: there is no such method, or both a folder and a method of the package have this name.
    """
    folder = Path(name)
    if name in packaged_methods():
        if (folder / CONFIG).is_file():
            raise SettingsError(f"{name}: both a packaged method and a folder; for the folder write ./{name}")
        return FOLDER / name
    if not (folder / CONFIG).is_file():
        if name in packaged_configs():
            raise SettingsError(
                f"{name}: a configuration of the package, which comes without weights; train it: "
                f"`kinectbench train {name} --data RELEASE --out FOLDER`, and predict with FOLDER",
                what="untrained",
            )
        known = packaged_methods()
        more = f", and no method of the package: {listed(known)}" if known else ""
        raise SettingsError(
            f"{printable(name)}: no folder of `kinectbench train` or `convert`{more}", what="untrained"
        )
    return folder


def open_trained(folder: Path, device: str = "cpu") -> Trained:
    """Read a trained network.

    Raises:
        SettingsError: the configuration is wrong.
        StorageError: the weights are missing, damaged, or of another network.
    """
    config = read_config(folder / CONFIG)
    training = TrainingFile.read(folder)
    path = folder / FILE
    shapes = shapes_of_network(make_network(config.network, device="meta"))
    # Checked before the network is made, which may be large.
    check_fit(shapes, headers_of(path, bytes_of(shapes)), str(path))
    network = make_network(config.network)
    set_weights(network, path)
    return Trained(config, network.to(device).eval(), sha256_file(path), training, device)
