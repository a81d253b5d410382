"""Reconstruction losses of voxels, with optional weights and masks."""

from collections.abc import Iterable

import torch
from torch import Tensor
from torch.nn import functional

from kinectbench.networks.config import LossSettings

# Keeps the logarithm finite, as the authors' code does.
TINY = 1e-8


def reconstruction_loss(parts: Iterable[tuple[Tensor, Tensor, Tensor]], settings: LossSettings) -> Tensor:
    """Return the sum, over the supervised outputs, of the mean loss per voxel, in nats: ().

    Args:
        parts: (logits, targets in [0, 1], weights) of each output, three tensors of one shape.
        settings: the chosen loss.
    """
    losses = [
        _mean(voxel_losses(logits.float(), target, settings), weight) for logits, target, weight in parts
    ]
    return torch.stack(losses).sum()


def voxel_losses(logits: Tensor, target: Tensor, settings: LossSettings) -> Tensor:
    """Return the loss of each voxel, in nats: cross-entropy, or the paper's weighted loss (its equation 3).

    The weighted loss is -alpha y log p - (1 - alpha) (1 - y) log(1 - p), with the target y and p =
    sigmoid(logit). If `settings.probability_floor` is not 0, as in the authors' code, smaller p are raised to
    it, so voxels with such a p have no gradient.
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
    """Return the weighted mean; a sum of weights below 1 counts as 1, so the mean is 0 if all are 0."""
    if weight.stride() == (0,) * weight.dim() or not weight.numel():  # an expanded scalar 1
        return losses.mean()
    return (losses * weight).sum() / weight.sum().clamp(min=1.0)
