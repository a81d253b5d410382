"""The networks have the parameters that the papers and the released code state."""

import pytest

from kinectbench.networks.config import NetworkName, NetworkSettings
from kinectbench.networks.network import Network
from kinectbench.networks.registry import NETWORKS, make_network


def shapes_of(kind: NetworkName, divisor: int = 1) -> Network:
    """Without values: the largest would take 1.7 GB."""
    return make_network(NetworkSettings(kind=kind, channel_divisor=divisor), device="meta")


def test_recgan_has_the_papers_167_million() -> None:
    from kinectbench.networks.recgan import RecGAN

    network = shapes_of("3d-recgan++")
    assert isinstance(network, RecGAN)
    generator = sum(values.numel() for values in network.generator_parameters())
    discriminator = sum(values.numel() for values in network.discriminator.parameters())
    assert (generator, discriminator) == (164_282_729, 2_794_488)
    assert network.parameter_count == 167_077_217


def test_every_layer_of_the_generator() -> None:
    """Weights and biases together, as the table in the authors' code gives them."""
    counts: dict[str, int] = {}
    for name, values in shapes_of("3d-recae").named_parameters():
        layer = name.rpartition(".")[0]
        counts[layer] = counts.get(layer, 0) + values.numel()
    assert list(counts.values()) == [
        *(4_160, 524_416, 2_097_408, 8_389_120),
        *(65_538_000, 65_568_768),
        *(16_777_472, 4_194_432, 1_048_640, 131_088, 8_712, 513),
    ]


def test_recae_is_the_generator_alone() -> None:
    assert shapes_of("3d-recae").parameter_count == 164_282_729


def test_epn_has_the_papers_52_million() -> None:
    """Of convolutions and full layers; batch normalisation has some more."""
    from torch import nn

    network = shapes_of("3d-epn")
    norms = [layer for layer in network.modules() if isinstance(layer, nn.BatchNorm3d)]
    of_norms = sum(values.numel() for norm in norms for values in norm.parameters())
    assert (network.parameter_count - of_norms, of_norms) == (52_447_201, 3_360)


def test_epn_normalises_and_begins_as_its_source() -> None:
    """Epsilon as in its `nnutil.lua`; values as Torch7's modules begin, which differ from PyTorch's."""
    from torch import nn

    network = make_network(NetworkSettings(kind="3d-epn", channel_divisor=8))
    norms = [layer for layer in network.modules() if isinstance(layer, nn.BatchNorm3d)]
    assert {norm.eps for norm in norms} == {1e-3} and len(norms) == 6
    assert all(
        norm.weight.min() >= 0 and norm.weight.max() <= 1 and norm.weight.std() > 0.1 for norm in norms
    )
    last = network.up[-1]
    bound = (last.in_channels * 4**3) ** -0.5
    assert 0.9 * bound < last.weight.abs().max() <= bound and 0 < last.bias.abs().max() <= bound


def test_varley_has_the_papers_430_million() -> None:
    """Without biases, as the paper seems to count."""
    network = shapes_of("varley")
    weights = sum(values.numel() for values in network.parameters() if values.dim() > 1)
    assert (weights, network.parameter_count) == (430_288_384, 430_357_576)


def test_han_like_has_as_many_as_the_paper_states() -> None:
    count = shapes_of("han-like").parameter_count
    assert count == 7_503_066
    assert count == pytest.approx(7.5e6, rel=0.02)


def test_the_small_network_has_two_and_a_half_million() -> None:
    assert shapes_of("3d-recae", 8).parameter_count == 2_574_771


def test_every_network_has_a_line() -> None:
    from typing import get_args

    assert set(NETWORKS) == set(get_args(NetworkName))


def test_first_values_depend_on_the_seed_alone() -> None:
    import torch

    settings = NetworkSettings(kind="3d-recae", channel_divisor=64, output_cells=64)
    torch.manual_seed(99)
    chance = torch.random.get_rng_state()
    one, other, third = (make_network(settings, seed).state_dict() for seed in (1, 1, 2))
    assert torch.equal(torch.random.get_rng_state(), chance)
    assert all(torch.equal(one[name], other[name]) for name in one)
    assert not torch.equal(one["down.0.weight"], third["down.0.weight"])


def test_weights_after_he_keep_the_signal_through_the_generator() -> None:
    """Random views give logits that differ as much as their own; after Glorot little is left of them."""
    import torch

    from kinectbench.networks.recae import FIRST_LOGIT

    made = {
        rule: make_network(
            NetworkSettings(kind="3d-recgan++", channel_divisor=16, output_cells=64, initial_weights=rule)
        )
        for rule in ("xavier", "he")
    }
    partial = torch.randn(1, 1, 64, 64, 64, generator=torch.Generator().manual_seed(0))
    with torch.inference_mode():
        logits = {rule: network(partial) for rule, network in made.items()}
    assert 1 / 6 < logits["he"].std() < 6
    assert logits["xavier"].std() < 0.1 * logits["he"].std()
    assert logits["he"].mean().item() == pytest.approx(FIRST_LOGIT, abs=1)
    same = [
        name
        for name, values in made["he"].state_dict().items()
        if torch.equal(values, made["xavier"].state_dict()[name])
    ]
    assert {name.split(".")[0] for name in same if name.endswith("weight")} == {"discriminator"}
