"""The losses against their formulas, by hand and in numpy."""

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from kinectbench.networks.config import AdversarialSettings, LossSettings, MethodSettings
from kinectbench.networks.data import Batch
from kinectbench.networks.network import TruthBatch, reduced_partial
from kinectbench.networks.recgan import Discriminator, RecGAN, discriminator_loss
from kinectbench.networks.registry import make_network
from kinectbench.networks.steps import Learner, reconstruction_loss, voxel_losses

LOGITS = torch.tensor([-9.0, -2.0, 0.0, 1.5])
P = 1 / (1 + np.exp(-LOGITS.numpy().astype(np.float64)))


@pytest.mark.parametrize("truth", [0.0, 1.0])
def test_the_papers_loss(truth: float) -> None:
    target = torch.full_like(LOGITS, truth)
    found = voxel_losses(LOGITS, target, LossSettings(alpha=0.85))
    wanted = -0.85 * truth * np.log(P) - 0.15 * (1 - truth) * np.log(1 - P)
    np.testing.assert_allclose(found.numpy(), wanted, rtol=1e-5)


def test_below_the_floor_nothing_is_learnt() -> None:
    """As in the authors' code: p = max(p, 0.01) in both terms."""
    logits = LOGITS.clone().requires_grad_(True)
    settings = LossSettings(alpha=0.85, probability_floor=0.01)
    losses = voxel_losses(logits, torch.ones(4), settings)
    np.testing.assert_allclose(losses.detach().numpy(), -0.85 * np.log(np.maximum(P, 0.01) + 1e-8), rtol=1e-5)
    losses.sum().backward()
    assert logits.grad is not None
    assert logits.grad[0] == 0 and (logits.grad[1:] != 0).all()


def test_plain_cross_entropy_weighs_both_alike() -> None:
    target = torch.tensor([0.0, 1.0, 0.5, 0.0])
    found = voxel_losses(LOGITS, target, LossSettings(kind="cross-entropy"))
    y = target.numpy()
    np.testing.assert_allclose(found.numpy(), -y * np.log(P) - (1 - y) * np.log(1 - P), atol=1e-6)


def truth_of(unknown: slice | None) -> TruthBatch:
    full = torch.zeros(1, 1, 256, 256, 256, dtype=torch.bool)
    full[..., :128] = True
    if unknown is None:
        return TruthBatch(full, None)
    known = torch.ones_like(full)
    known[..., unknown] = False
    return TruthBatch(full, known)


def test_what_is_unknown_teaches_nothing() -> None:
    """A cell counts by its known share, and its target is the occupied share of that."""
    target, weight = truth_of(slice(124, 130)).at(64)
    assert weight[0, 0, 0, 0, 30:34].tolist() == [1.0, 0.0, 0.5, 1.0]
    assert target[0, 0, 0, 0, 30].item() == 1 and target[0, 0, 0, 0, 32].item() == 0
    logits = torch.zeros(1, 1, 64, 64, 64)
    wrong = logits.clone()
    wrong[..., 31] = -20  # says empty, where all is unknown
    settings = LossSettings(kind="cross-entropy")
    losses = [reconstruction_loss([(one, target, weight)], settings) for one in (logits, wrong)]
    assert losses[0].item() == pytest.approx(np.log(2), rel=1e-5) and losses[0] == losses[1]


def test_without_a_mask_every_voxel_counts() -> None:
    target, weight = truth_of(None).at(64)
    assert weight.shape == target.shape and (weight == 1).all()
    wrong = torch.zeros(1, 1, 64, 64, 64)
    wrong[..., 31] = -20
    settings = LossSettings(kind="cross-entropy")
    assert reconstruction_loss([(wrong, target, weight)], settings) > np.log(2) + 0.1


def test_the_truth_at_its_own_side_is_itself() -> None:
    truth = truth_of(slice(100, 110))
    target, weight = truth.at(256)
    assert truth.known is not None
    assert torch.equal(weight, truth.known.float())
    assert torch.equal(target * weight, (truth.full & truth.known).float())


@pytest.mark.parametrize("cells", [32, 40])
def test_a_reduced_cell_is_set_if_any_that_it_touches_is(cells: int) -> None:
    partial = torch.zeros(1, 1, 64, 64, 64)
    partial[0, 0, 9, 0, 63] = 1
    found = torch.nonzero(reduced_partial(partial, cells)[0, 0]).tolist()
    first, last = 9 * cells // 64, (10 * cells - 1) // 64
    assert found == [[i, 0, cells - 1] for i in range(first, last + 1)]


@pytest.mark.parametrize("penalty_on", ["mean", "sum"])
def test_the_penalty_is_on_the_gradient_by_the_shape(penalty_on: str) -> None:
    """Where truth and prediction are one, it is all of the loss."""
    torch.manual_seed(0)
    discriminator = Discriminator(8).double()
    partial = (torch.rand(1, 1, 64, 64, 64, dtype=torch.float64) > 0.9).double()
    real = (torch.rand(1, 1, 64, 64, 64, dtype=torch.float64) > 0.5).double()
    settings = AdversarialSettings.model_validate({"beta": 0.2, "penalty_on": penalty_on})
    found = discriminator_loss(discriminator, partial, real, real, settings, torch.Generator())
    # Truth and prediction are the same: nothing is told apart, and every mixture is the truth.
    features = discriminator(partial, real.requires_grad_(True))
    value = features.sum() if penalty_on == "sum" else features.mean()
    (slopes,) = torch.autograd.grad(value, real)
    assert found.item() == pytest.approx(10 * (slopes.norm().item() - 1) ** 2, rel=1e-4)


class Squares(nn.Module):  # type: ignore[misc]  # torch is not looked into
    """Two features of a shape: the sum of its squares, and twice that; its gradient is known."""

    def forward(self, partial: Tensor, shape: Tensor) -> Tensor:
        del partial
        total = shape.square().flatten(1).sum(dim=1)
        return torch.stack([total, 2 * total], dim=1)


@pytest.mark.parametrize("epsilon", ["voxel", "sample"])
@pytest.mark.parametrize("weight", [0.0, 10.0])
def test_the_discriminators_loss_by_hand(epsilon: str, weight: float) -> None:
    """Mean of fake less mean of real, and the penalty at mixtures real + e (fake - real)."""
    real, fake = np.zeros((2, 1, 1, 1, 2)), np.zeros((2, 1, 1, 1, 2))
    real[:, 0, 0, 0] = [[1, 2], [0, 1]]
    fake[:, 0, 0, 0] = [[3.0, 1.0], [2.0, 0.5]]
    # Sums of squares: 10 and 4.25 of the fake, 5 and 1 of the real; a feature's mean is 1.5 of them.
    apart = 1.5 * ((10 + 4.25) - (5 + 1)) / 2
    shape = (2, 1, 1, 1, 2) if epsilon == "voxel" else (2,)
    e = torch.rand(shape, generator=torch.Generator().manual_seed(7)).numpy().astype(np.float64)
    mixed = real + (e if epsilon == "voxel" else e.reshape(2, 1, 1, 1, 1)) * (fake - real)
    norms = 3 * np.sqrt((mixed**2).reshape(2, -1).sum(axis=1))  # the gradient is 1.5 times 2 x
    wanted = apart + weight * ((norms - 1) ** 2).mean()
    settings = AdversarialSettings.model_validate(
        {"beta": 0.2, "gradient_penalty": weight, "epsilon": epsilon}
    )
    completed, given = torch.from_numpy(fake), torch.from_numpy(real)
    chance = torch.Generator().manual_seed(7)
    module: nn.Module = Squares()
    found = discriminator_loss(module, torch.zeros(2), completed, given, settings, chance)
    assert found.item() == pytest.approx(wanted, rel=1e-5)


def test_the_generator_learns_to_raise_what_the_discriminator_says() -> None:
    """With beta 0 nothing else teaches it; of what it makes then the discriminator, kept still, says more."""
    config = MethodSettings.model_validate(
        {
            "name": "a",
            "network": {"kind": "3d-recgan++", "channel_divisor": 32, "output_cells": 64},
            "adversarial": {"beta": 0.0, "learning_rate": 1e-12},
            "training": {"learning_rate": 1e-3},
        }
    )
    network = make_network(config.network)
    assert isinstance(network, RecGAN)
    partial = (torch.rand(1, 1, 64, 64, 64, generator=torch.Generator().manual_seed(0)) > 0.9).float()

    def said() -> float:
        with torch.inference_mode():
            return float(network.discriminator(partial, network.completed(partial)).mean().item())

    before = said()
    Learner(network, config, "cpu", (0, 1)).step(Batch(partial, truth_of(None)), 0, 0)
    assert said() > before


def test_what_is_known_in_part_tells_no_truth_from_a_prediction(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 64^3 and with every second layer unknown, truth and a right prediction are the same shape."""
    config = MethodSettings.model_validate(
        {
            "name": "a",
            "network": {"kind": "3d-recgan++", "channel_divisor": 32, "output_cells": 64},
            "adversarial": {"beta": 0.5},
        }
    )
    known = torch.ones(1, 1, 256, 256, 256, dtype=torch.bool)
    known[:, :, ::2] = False
    full = torch.zeros_like(known)
    full[..., :128] = True
    truth, network = TruthBatch(full, known), make_network(config.network)
    assert isinstance(network, RecGAN)
    target, weight = truth.at(64)
    right = torch.where(target > 0, 40.0, -40.0).requires_grad_(True)
    monkeypatch.setattr(network, "taught", lambda *_: iter([(right, target, weight)]))
    shown: list[tuple[Tensor, Tensor]] = []

    def look(module: nn.Module, partial: Tensor, fake: Tensor, real: Tensor, *more: object) -> Tensor:
        shown.append((fake, real))
        return module(partial, fake).mean()

    monkeypatch.setattr("kinectbench.networks.steps.discriminator_loss", look)
    Learner(network, config, "cpu", (0, 1)).step(Batch(torch.zeros(1, 1, 64, 64, 64), truth), 0, 0)
    ((fake, real),) = shown
    assert real.max() == 0.5 and torch.allclose(fake, real)
