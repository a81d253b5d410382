"""Every network: the sides of what it gives, one step on random data, and one pair learnt by heart."""

from typing import Any

import numpy as np
import pytest
import torch
from raising import raises
from slow import slow
from synthetic_release import synthetic_pair

from kinectbench.core.errors import PredictionError
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.networks import han_like
from kinectbench.networks.config import MethodSettings, NetworkName, NetworkSettings
from kinectbench.networks.data import Batch, as_tensor, bits_tensor
from kinectbench.networks.network import Network, TruthBatch
from kinectbench.networks.recae import RecAE
from kinectbench.networks.registry import NETWORKS, make_network
from kinectbench.networks.steps import Learner, StepError
from kinectbench.networks.validate import completed

ADVERSARIAL = {"beta": 0.8, "loss_scale": 100.0, "epsilon": "voxel", "penalty_on": "sum"}
# Hidden channels divided by, side of the generators' output, learning rate, most steps until it is learnt.
REDUCED: dict[NetworkName, tuple[int, int, float, int]] = {
    "3d-recgan++": (16, 64, 3e-3, 160),
    "3d-recae": (16, 64, 3e-3, 160),
    "3d-epn": (16, 256, 1e-2, 180),
    "varley": (32, 256, 1e-3, 45),
    "han-like": (8, 256, 5e-3, 280),
}


def config_of(kind: NetworkName, **training: Any) -> MethodSettings:
    divisor, cells, rate, _ = REDUCED[kind]
    return MethodSettings.model_validate(
        {
            "name": "reduced",
            "network": {"kind": kind, "channel_divisor": divisor, "output_cells": cells},
            "loss": {"kind": "cross-entropy"},
            "adversarial": ADVERSARIAL if kind == "3d-recgan++" else None,
            "training": {"learning_rate": rate, **training},
        }
    )


def random_batch(count: int = 2) -> Batch:
    generator = torch.Generator().manual_seed(0)
    partial = (torch.rand(count, 1, 64, 64, 64, generator=generator) > 0.95).float()
    full = torch.rand(count, 1, 256, 256, 256, generator=generator) > 0.9
    return Batch(partial, TruthBatch(full, None))


@pytest.mark.parametrize(
    ("kind", "precision"),
    [
        *((kind, "float32") for kind in NETWORKS),
        *((kind, "bfloat16") if kind == "varley" else slow(kind, "bfloat16") for kind in NETWORKS),
    ],
)
def test_one_step_moves_every_parameter(kind: NetworkName, precision: str) -> None:
    config = config_of(kind, precision=precision)
    network = make_network(config.network)
    before = {name: values.clone() for name, values in network.named_parameters()}
    losses = Learner(network, config, "cpu", (0, 1)).step(random_batch(), 0, 0)
    assert all(torch.isfinite(torch.tensor(value)) for value in losses.values())
    after = dict(network.named_parameters())
    assert all(torch.isfinite(values).all() for values in after.values())
    # Behind batch normalisation a bias does nothing.
    still = [name for name in before if torch.equal(before[name], after[name])]
    assert [name for name in still if not (kind == "3d-epn" and name.endswith("bias"))] == []


@pytest.mark.parametrize("kind", [kind if kind == "varley" else slow(kind) for kind in NETWORKS])
def test_one_pair_is_learnt_by_heart(kind: NetworkName, monkeypatch: pytest.MonkeyPatch) -> None:
    """IoU at the network's own side, where its truth is."""
    monkeypatch.setattr(han_like, "TAUGHT_PATCHES", 4)  # of eight: a step takes half the time
    config, steps = config_of(kind), REDUCED[kind][3]
    pair = synthetic_pair(3, "chair")
    partial = as_tensor(unpack(pair.partial)[None], "cpu")
    batch = Batch(partial, TruthBatch(bits_tensor(unpack(pair.full)[None], "cpu"), None))
    network = make_network(config.network)
    learner = Learner(network, config, "cpu", (0, 1))
    true = batch.truth.at(network.output_cells)[0] >= 0.5

    def iou() -> float:
        network.eval()
        with torch.inference_mode():
            predicted = network.completed(partial) > 0.5
        network.train()
        assert predicted.shape[-1] == network.output_cells
        return float((predicted & true).sum() / (predicted | true).sum())

    assert iou() < 0.5
    for number in range(steps):
        learner.step(batch, number, 0)
        if number % 4 == 3 and iou() >= 0.95:
            return
    pytest.fail(f"after {steps} steps: {iou():.3f}")


@pytest.mark.parametrize(("output_cells", "cells"), [(256, 128), slow(256, 64), (128, 32)])
def test_tiles_are_cut_from_the_whole(output_cells: Any, cells: int) -> None:
    """Of logits, targets and weights, wherever the tile lies: at a corner, a side, within."""
    network = make_network(NetworkSettings(kind="3d-recae", channel_divisor=16, output_cells=output_cells))
    assert isinstance(network, RecAE)
    batch = random_batch(4)
    truth = TruthBatch(batch.truth.full, torch.rand(batch.truth.full.shape) > 0.5)
    whole = next(network.taught(batch.partial, truth, torch.Generator()))
    found = next(network.taught_tiles(batch.partial, truth, torch.Generator().manual_seed(0), cells))
    drawn, count = torch.Generator().manual_seed(0), output_cells // cells
    for index in range(4):
        places = torch.randint(count, (3,), generator=drawn).tolist()
        box = tuple(slice(cells * place, cells * (place + 1)) for place in places)
        for part, of_whole in zip(found, whole, strict=True):
            assert torch.allclose(part[index, 0], of_whole[index, 0][box], atol=1e-5), (index, places)


def test_tiles_move_every_parameter() -> None:
    config = MethodSettings.model_validate(
        {
            "name": "tiles",
            "network": {"kind": "3d-recae", "channel_divisor": 16},
            "loss": {"tile_cells": 128},
        }
    )
    network = make_network(config.network)
    before = {name: values.clone() for name, values in network.named_parameters()}
    Learner(network, config, "cpu", (0, 1)).step(random_batch(), 0, 0)
    assert not [name for name, values in network.named_parameters() if torch.equal(values, before[name])]


def test_the_same_step_gives_the_same_bits() -> None:
    config = config_of("3d-recgan++")
    found = []
    for _ in range(2):
        network = make_network(config.network)
        Learner(network, config, "cpu", (0, 1)).step(random_batch(1), 5, 0)
        found.append(network.state_dict())
    assert all(torch.equal(found[0][name], found[1][name]) for name in found[0])


def test_the_learning_rate_is_halved() -> None:
    config = config_of("3d-epn", halve_every_epochs=2)
    learner = Learner(make_network(config.network), config, "cpu", (0, 1))
    rates = []
    for epoch in (0, 1, 2, 5):
        learner.step(random_batch(1), epoch, epoch)
        rates.append(learner.optimisers[0].param_groups[0]["lr"])
    assert rates == [1e-2, 1e-2, 0.5e-2, 0.25e-2]


def test_the_learning_rate_falls_along_a_cosine() -> None:
    learner = Learner(
        make_network(config_of("3d-epn").network), config_of("3d-epn", schedule="cosine"), "cpu", (0, 1)
    )
    rates = []
    for share in (0.0, 0.5, 0.75):
        learner.step(random_batch(1), 0, 0, share)
        rates.append(learner.optimisers[0].param_groups[0]["lr"])
    assert rates == pytest.approx([1e-2, 0.5e-2, 1e-2 * (1 - 2**-0.5) / 2])


def test_a_loss_that_is_no_number_is_told() -> None:
    config = config_of("varley")
    network = make_network(config.network)
    with torch.no_grad():
        next(network.parameters()).fill_(float("nan"))
    with raises(StepError, "training.diverged"):
        Learner(network, config, "cpu", (0, 1)).step(random_batch(1), 0, 0)


def test_a_gradient_that_is_no_number_is_told() -> None:
    """The loss is a number, and the weights after the step are none."""
    config = config_of("3d-epn")
    network = make_network(config.network)
    next(network.parameters()).register_hook(lambda gradient: gradient * float("nan"))
    with raises(StepError, "training.diverged"):
        Learner(network, config, "cpu", (0, 1)).step(random_batch(1), 0, 0)


@pytest.mark.parametrize("value", [float("nan"), 2.0])
def test_an_output_that_is_no_probability_is_refused(value: float) -> None:
    class Wrong(Network):
        def completed(self, partial: torch.Tensor) -> torch.Tensor:
            return torch.full((1, 1, 64, 64, 64), value)

    network, partial = Wrong(input_cells=64, output_cells=64), np.zeros((64, 64, 64), bool)
    with raises(PredictionError, "prediction.bad-values", match=f"'reduced': {value} at"):
        completed(network, partial, config_of("3d-epn"), "cpu")


def test_patches_see_what_the_whole_grid_would_show() -> None:
    """The local network's inputs against the same resampling of the whole grid."""
    generator = torch.Generator().manual_seed(1)
    coarse = torch.rand(1, 32, 32, 32, generator=generator)
    partial = (torch.rand(1, 64, 64, 64, generator=generator) > 0.5).float()
    corners = torch.tensor([[0, 0, 0], [7, 3, 0], [2, 7, 7]])
    found = han_like.patch_inputs(coarse, partial, corners)
    whole = torch.nn.functional.interpolate(coarse[None], size=256, mode="trilinear", align_corners=False)[
        0, 0
    ]
    seen = partial[0].repeat_interleave(4, 0).repeat_interleave(4, 1).repeat_interleave(4, 2)
    for patch, (i, j, k) in zip(found, (corners * 32).tolist(), strict=True):
        box = (slice(i, i + 32), slice(j, j + 32), slice(k, k + 32))
        torch.testing.assert_close(patch[0], whole[box])
        assert torch.equal(patch[1], seen[box])


def test_depth_images_are_distances_from_six_sides() -> None:
    partial = torch.zeros(1, 1, 64, 64, 64)
    partial[0, 0, 10, 20, 30] = 1
    images = han_like.six_depth_images(partial)
    assert images.shape == (1, 6, 1, 64, 64)
    wanted = [10, 53, 20, 43, 30, 33]
    places = [(20, 30), (20, 30), (10, 30), (10, 30), (10, 20), (10, 20)]
    for image, distance, place in zip(images[0, :, 0], wanted, places, strict=True):
        assert image[place].item() == pytest.approx(distance / 64)
        assert (image == 1).sum() == 64 * 64 - 1
