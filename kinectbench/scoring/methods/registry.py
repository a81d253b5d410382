"""The networks by name, imported when one is made. A new one is a file and a line in `NETWORKS`."""

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING

from kinectbench.core.errors import KinectBenchError
from kinectbench.scoring.methods.config import GENERATORS, NetworkName, NetworkSettings

if TYPE_CHECKING:
    from kinectbench.scoring.methods.network import Network

# module and class
NETWORKS: Mapping[NetworkName, tuple[str, str]] = {
    "3d-recgan++": ("recgan", "RecGAN"),
    "3d-recae": ("recae", "RecAE"),
    "3d-epn": ("epn", "EPN"),
    "varley": ("varley", "Varley"),
    "han-like": ("han_like", "HanLike"),
}


def require_torch() -> None:
    """Refuse to go on without torch.

    Raises:
        KinectBenchError: it is not installed; the line says how it is.
    """
    try:
        import_module("torch")
    except ImportError:
        raise KinectBenchError(
            "train, predict and convert need PyTorch: pip install 'kinectbench[methods]'"
        ) from None


def make_network(settings: NetworkSettings, seed: int = 0, device: str = "cpu") -> "Network":
    """Make a network with its first values, which depend on the seed alone.

    Args:
        settings: which, and how large.
        seed: of the values.
        device: where they come to lie; "meta" gives shapes without values.
    """
    import torch

    from kinectbench.scoring.methods.recae import RecAE

    module, name = NETWORKS[settings.kind]
    kind = getattr(import_module(f"kinectbench.scoring.methods.{module}"), name)
    sides = (settings.output_cells,) if settings.kind in GENERATORS else ()
    with torch.random.fork_rng(devices=[]), torch.device("meta" if device == "meta" else "cpu"):
        torch.manual_seed(seed)
        network: Network = kind(settings.channel_divisor, *sides)
        if isinstance(network, RecAE) and settings.initial_weights == "he":
            network.start_by_he()
    if device == "meta":
        return network
    # Channels beside each other: a step on the CPU takes two thirds of the time, a view three quarters.
    for values in network.parameters():
        if values.dim() == 5:
            values.data = values.data.contiguous(memory_format=torch.channels_last_3d)
    return network.to(device)
