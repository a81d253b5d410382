"""One optimisation step of a network (and its discriminator, if any), and the reconstruction losses."""

import math
from collections.abc import Iterable, Iterator, Sequence

import torch
from torch import Generator, Tensor, nn
from torch.nn import functional
from torch.optim import Adam

from kinectbench.core import KinectBenchError
from kinectbench.networks.config import LossSettings, MethodSettings
from kinectbench.networks.data import Batch
from kinectbench.networks.distributed import average_buffers, average_gradients
from kinectbench.networks.network import Network
from kinectbench.networks.recae import RecAE
from kinectbench.networks.recgan import RecGAN, discriminator_loss

# Means of each step's losses, by name.
Losses = dict[str, float]
DIVERGED = "the loss or a weight is no number any more; choose a lower learning rate, and train again"


class StepError(KinectBenchError):
    """Raised when a training cannot continue."""

    kind, what = "training", "diverged"


class Learner:
    """A network with its optimisers. The random numbers of a step depend only on seed, step and process.

    Attributes:
        network: the network that is trained.
        optimisers: Adam for the network and, in 3d-recgan++, for its discriminator.
    """

    def __init__(self, network: Network, config: MethodSettings, device: str, part: tuple[int, int]) -> None:
        """Make the optimisers, before the first step; `part` is (rank, number of processes)."""
        self.network, self._config, self._device = network, config, device
        self._rank, self._size = part
        rate = config.training.learning_rate
        self.optimisers: Sequence[Adam]
        if isinstance(network, RecGAN):
            assert config.adversarial is not None
            mine, theirs = network.generator_parameters(), list(network.discriminator.parameters())
            self.optimisers = (Adam(mine, lr=rate), Adam(theirs, lr=config.adversarial.learning_rate))
        else:
            self.optimisers = (Adam(list(network.parameters()), lr=rate),)
        self._rates = [optimiser.param_groups[0]["lr"] for optimiser in self.optimisers]

    def step(self, batch: Batch, number: int, epoch: int, share: float = 0.0) -> Losses:
        """Learn from a batch; return the losses, each before its update: `loss`, and more in 3d-recgan++.

        Args:
            batch: the part of the batch for this process.
            number: number of the step, from 0.
            epoch: the current epoch; it determines the learning rate if this is halved every few epochs.
            share: finished share of the training, in [0, 1); it determines the learning rate if this follows
                a cosine.

        Raises:
            StepError: a loss or a weight is not finite.
        """
        self.network.train()
        for optimiser, rate in zip(self.optimisers, self._rates, strict=True):
            optimiser.param_groups[0]["lr"] = rate * self._rate_factor(epoch, share)
        generator = torch.Generator(self._device)
        generator.manual_seed(_mixed(self._config.training.seed, number, self._rank))
        if isinstance(self.network, RecGAN):
            return self._adversarial(self.network, batch, generator)
        with self._autocast():
            parts = list(self._taught(batch, generator))
        loss = reconstruction_loss(parts, self._config.loss)
        self._descend(loss, 0)
        return {"loss": loss.item()}

    def _rate_factor(self, epoch: int, share: float) -> float:
        training = self._config.training
        halved = 0.5 ** (epoch // training.halve_every_epochs) if training.halve_every_epochs else 1.0
        return halved * ((1 + math.cos(math.pi * share)) / 2 if training.schedule == "cosine" else 1.0)

    def _taught(self, batch: Batch, generator: Generator) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        cells = self._config.loss.tile_cells
        if cells:
            assert isinstance(self.network, RecAE)
            return self.network.taught_tiles(batch.partial, batch.truth, generator, cells)
        return self.network.taught(batch.partial, batch.truth, generator)

    def _adversarial(self, network: RecGAN, batch: Batch, generator: Generator) -> Losses:
        """Update the discriminator, then the generator; both use one prediction, made before the updates."""
        settings = self._config.adversarial
        assert settings is not None
        with self._autocast():
            (logits, target, weight) = next(network.taught(batch.partial, batch.truth, generator))
        # Unknown voxels are empty in both, and only the known part of a cell counts: nothing is learnt from
        # unknown ones.
        fake, real = logits.float().sigmoid() * weight, target * weight
        with self._autocast():
            critic_loss = discriminator_loss(
                network.discriminator, batch.partial, fake.detach(), real, settings, generator
            )
        self._descend(critic_loss, 1)
        rebuilt = reconstruction_loss([(logits, target, weight)], self._config.loss)
        with self._autocast():
            fooled = -network.discriminator(batch.partial, fake).mean()
        loss = settings.loss_scale * (settings.beta * rebuilt + (1 - settings.beta) * fooled)
        self._descend(loss, 0)
        return {"loss": loss.item(), "reconstruction": rebuilt.item(), "discriminator": critic_loss.item()}

    def _descend(self, loss: Tensor, index: int) -> None:
        """Update the parameters of one optimiser by the gradients of `loss`; discard other gradients."""
        if not torch.isfinite(loss):
            raise StepError(DIVERGED)
        optimiser = self.optimisers[index]
        self.network.zero_grad(set_to_none=True)
        loss.backward()
        parameters: list[nn.Parameter] = optimiser.param_groups[0]["params"]
        average_gradients(parameters, self._size)
        optimiser.step()
        average_buffers(self.network, self._size)
        if not all(torch.isfinite(values).all() for values in parameters):
            raise StepError(DIVERGED)

    def _autocast(self) -> torch.autocast:
        wanted = self._config.training.precision == "bfloat16"
        return torch.autocast(self._device.partition(":")[0], torch.bfloat16, enabled=wanted)


def _mixed(seed: int, step: int, rank: int) -> int:
    """Return a distinct seed (63 bits) for each step and process."""
    mixed = (seed * 1_000_003 + step) * 1_000_003 + rank
    return mixed & (2**63 - 1)


# Keeps the logarithm finite, as the authors' code does.
TINY = 1e-8


def reconstruction_loss(parts: Iterable[tuple[Tensor, Tensor, Tensor]], settings: LossSettings) -> Tensor:
    """Return the mean loss per voxel, in nats, summed over the outputs in `parts`: a scalar tensor.

    Args:
        parts: (logits, targets in [0, 1], weights) of each output; the three tensors have the same shape.
        settings: the chosen loss.
    """
    losses = [
        _mean(voxel_losses(logits.float(), target, settings), weight) for logits, target, weight in parts
    ]
    return torch.stack(losses).sum()


def voxel_losses(logits: Tensor, target: Tensor, settings: LossSettings) -> Tensor:
    """Return the loss of each voxel, in nats: cross-entropy, or the paper's weighted loss (its equation 3).

    The weighted loss is -alpha y log p - (1 - alpha) (1 - y) log(1 - p), with the target y and p =
    sigmoid(logit). If `settings.probability_floor` is not 0, smaller p are clamped to it, as in the
    authors' code; voxels with such a p have no gradient.
    """
    if settings.kind == "cross-entropy":
        return functional.binary_cross_entropy_with_logits(logits, target, reduction="none")
    if settings.probability_floor > 0:
        p = logits.sigmoid().clamp(min=settings.probability_floor)
        hit, miss = -(p + TINY).log(), -(1 - p + TINY).log()
    else:
        hit, miss = functional.softplus(-logits), functional.softplus(logits)
    return settings.alpha * target * hit + (1 - settings.alpha) * (1 - target) * miss


def _mean(losses: Tensor, weight: Tensor) -> Tensor:
    """Return the weighted mean; the sum of weights is taken as at least 1, so that weights of 0 give 0."""
    if weight.stride() == (0,) * weight.dim() or not weight.numel():  # an expanded scalar 1
        return losses.mean()
    return (losses * weight).sum() / weight.sum().clamp(min=1.0)
