"""The networks by name; they are imported when needed. To add one, write a file and a line in `NETWORKS`.

A user's own network needs no change here: its configuration states the path of its class.
"""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING

from kinectbench.core import KinectBenchError, SettingsError, printable
from kinectbench.networks.config import GENERATORS, NetworkName, NetworkSettings

if TYPE_CHECKING:
    from kinectbench.networks.network import Network

# Module and class of each network.
NETWORKS: Mapping[NetworkName, tuple[str, str]] = {
    "3d-recgan++": ("recgan", "RecGAN"),
    "3d-recae": ("recae", "RecAE"),
    "3d-epn": ("epn", "EPN"),
    "varley": ("varley", "Varley"),
    "han-like": ("han_like", "HanLike"),
}


def require_torch() -> None:
    """Raise an error if torch is not installed.

    Raises:
        KinectBenchError: torch is not installed; the message says how to install it.
    """
    try:
        import_module("torch")
    except ImportError:
        raise KinectBenchError(
            "train, predict and convert need PyTorch: pip install 'kinectbench[methods]'", what="no-package"
        ) from None


def make_network(settings: NetworkSettings, seed: int = 0, device: str = "cpu") -> "Network":
    """Make a network with its initial values, which depend only on the settings and the seed.

    On the device "meta" it has shapes without values.

    Raises:
        SettingsError: the user's own class is not found, or is no `Network`.
    """
    import torch

    from kinectbench.networks.recae import RecAE

    kind = _class_of(settings)
    sides = (settings.output_cells,) if settings.kind in GENERATORS else ()
    with torch.random.fork_rng(devices=[]), torch.device("meta" if device == "meta" else "cpu"):
        torch.manual_seed(seed)
        network = kind(settings.channel_divisor, *sides)
        if isinstance(network, RecAE) and settings.initial_weights == "he":
            network.start_by_he()
    if device == "meta":
        return network
    # With channels adjacent in memory, a training step on the CPU takes two thirds of the time, and a
    # prediction three quarters.
    for values in network.parameters():
        if values.dim() == 5:
            values.data = values.data.contiguous(memory_format=torch.channels_last_3d)
    return network.to(device)


def _class_of(settings: NetworkSettings) -> "Callable[..., Network]":
    """Return the class of a network; errors as in `make_network`."""
    if settings.kind == "own":
        return _own_class(settings.class_path or "")
    module, name = NETWORKS[settings.kind]
    network_class: Callable[..., Network] = getattr(import_module(f"kinectbench.networks.{module}"), name)
    return network_class


def _own_class(path: str) -> "Callable[..., Network]":
    """Return a class by its path `package.module:Class`; it must be a subclass of `Network`."""
    from kinectbench.networks.network import Network

    module, _, name = path.partition(":")
    try:
        attribute = getattr(import_module(module), name, None)
    except (Exception, SystemExit) as error:  # a module runs as it is imported
        why = printable(f"{type(error).__name__}: {error}")
        raise SettingsError(
            f"network.class_path {path}: cannot be imported ({why}); mend or install it, or name the "
            "folder it lies in by PYTHONPATH"
        ) from error
    if not (isinstance(attribute, type) and issubclass(attribute, Network)):
        raise SettingsError(
            f"network.class_path {path}: no class of that name there that is a subclass of "
            "kinectbench.networks.network.Network"
        )
    return attribute
