"""3D-RecGAN++: the generator of `recae.py`, trained with a conditional discriminator and gradient penalty.

Source: Yang et al., TPAMI 2018, section 3; layers and losses as in the authors' code,
Yang7879/3D-RecGAN-extended, `dis` and `build_graph` in main_3D-RecGAN++.py (MIT), reimplemented. Where paper
and code differ, the configuration selects one.
"""

import torch
from torch import Generator, Tensor, nn
from torch.nn import functional

from kinectbench.networks.config import AdversarialSettings
from kinectbench.networks.layers import SameConv, narrowed, xavier
from kinectbench.networks.recae import SLOPE, RecAE

CHANNELS = (8, 16, 32, 64, 128, 256)


class Discriminator(nn.Module):
    """The discriminator, 2,794,488 parameters: six convolutions of stride 2 and a sigmoid.

    The partial view (64^3) is reshaped, not resampled, to layers of n x n cells, and these are placed before
    the shape along z. So for shapes at 256^3, the discriminator's input is 256 x 256 x 260.
    """

    def __init__(self, divisor: int = 1) -> None:
        """Make the discriminator; hidden channels are divided by `divisor`."""
        super().__init__()
        channels = [narrowed(count, divisor) for count in CHANNELS]
        self.layers = nn.ModuleList(
            SameConv(a, b, stride=2) for a, b in zip([1, *channels], channels, strict=False)
        )
        xavier(self)

    def forward(self, partial: Tensor, shape: Tensor) -> Tensor:
        """Return features (b, f) in (0, 1) of partial views (b, 1, 64, 64, 64) and shapes (b, 1, n, n, n)."""
        cells = shape.shape[-1]
        x = torch.cat([partial.reshape(len(partial), 1, cells, cells, -1), shape], dim=4)
        for index, layer in enumerate(self.layers):
            x = layer(x)
            if index + 1 < len(self.layers):
                x = functional.leaky_relu(x, SLOPE)
        # In the order of the authors' vector, channels last; the mean does not depend on the order.
        return x.permute(0, 2, 3, 4, 1).flatten(1).float().sigmoid()


class RecGAN(RecAE):
    """The generator and its discriminator: 167,077,217 parameters in all, the paper's 167.1 M."""

    def __init__(self, divisor: int = 1, output_cells: int = 256) -> None:
        """Make both networks; arguments as in `RecAE`, but `divisor` also narrows the discriminator."""
        super().__init__(divisor, output_cells)
        self.discriminator = Discriminator(divisor)

    def generator_parameters(self) -> list[nn.Parameter]:
        """Return the generator's parameters."""
        return [values for name, values in self.named_parameters() if not name.startswith("discriminator.")]


def discriminator_loss(
    discriminator: Discriminator,
    partial: Tensor,
    fake: Tensor,
    real: Tensor,
    settings: AdversarialSettings,
    generator: Generator,
) -> Tensor:
    """Return WGAN-GP's loss of the discriminator, a scalar (equation 4 of the paper).

    Args:
        discriminator: the discriminator that is trained.
        partial: (b, 1, 64, 64, 64) partial views.
        fake: (b, 1, n, n, n) predicted probabilities, without gradients.
        real: (b, 1, n, n, n) the truth.
        settings: choices where the paper and its code differ.
        generator: source of the random numbers that mix `fake` and `real` for the gradient penalty.
    """
    count = len(fake) if settings.epsilon == "sample" else fake.shape
    epsilon = torch.rand(count, generator=generator, device=fake.device)
    if settings.epsilon == "sample":
        epsilon = epsilon.reshape(-1, 1, 1, 1, 1)
    mixed = (real + epsilon * (fake - real)).requires_grad_(True)
    features = discriminator(partial, mixed)
    value = features.sum() if settings.penalty_on == "sum" else features.mean(dim=1).sum()
    (slopes,) = torch.autograd.grad(value, mixed, create_graph=True)
    # The added constant is needed because the root has no gradient at 0: if the discriminator saturates, all
    # weights would become NaN.
    norms = (slopes.float().flatten(1).square().sum(dim=1) + 1e-12).sqrt()
    penalty = (norms - 1).square().mean()
    critic = discriminator(partial, fake).mean() - discriminator(partial, real).mean()
    return critic + settings.gradient_penalty * penalty
