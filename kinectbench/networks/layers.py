"""Layers that several networks share: convolutions padded like TensorFlow's "SAME", and initial values.

Tensors have torch's layout: (batch, channels, x, y, z).
"""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

KERNEL = 4


def _same_padding(cells: int, stride: int) -> tuple[int, int]:
    """Return the padding (before, after) along an axis, for a kernel of 4 and `ceil(cells / stride)` outputs.

    Source: TensorFlow's "SAME", which adds an odd cell after the data.
    """
    total = max((-(-cells // stride) - 1) * stride + KERNEL - cells, 0)
    return total // 2, total - total // 2


class SameConv(nn.Conv3d):
    """A convolution 4^3, padded like "SAME": (b, in, x, y, z) to (b, out, ceil(x / stride), …)."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__(inputs, outputs, KERNEL, stride=stride)

    def forward(self, x: Tensor) -> Tensor:
        """Pad, then convolve."""
        sides = [_same_padding(cells, self.stride[0]) for cells in reversed(x.shape[2:])]
        padded = functional.pad(x, [cells for side in sides for cells in side])
        return super().forward(padded)


class Doubling(nn.ConvTranspose3d):
    """A transposed convolution 4^3 of stride 2, padded like "SAME", which doubles every side."""

    def __init__(self, inputs: int, outputs: int, *, bias: bool = True) -> None:
        super().__init__(inputs, outputs, KERNEL, stride=2, padding=1, bias=bias)


def xavier(network: nn.Module) -> None:
    """Draw Glorot-uniform weights; zero the biases, except an LSTM's. Source: the 3D-RecGAN++ code."""
    with torch.no_grad():
        for name, values in network.named_parameters():
            if name.endswith("bias"):
                values.zero_()
            elif values.dim() > 1:
                nn.init.xavier_uniform_(values)


def he(network: nn.Module) -> None:
    """Draw He-normal weights, which keep the variance between layers. Biases are unchanged.

    Source: He et al., Delving Deep into Rectifiers, ICCV 2015. In a transposed convolution, only 1 / stride^3
    of the kernel reaches each output cell. Glorot's rule ignores this, so six such layers in a row weaken the
    signal by a factor of some hundred.
    """
    with torch.no_grad():
        for layer in network.modules():
            if isinstance(layer, nn.ConvTranspose3d):
                reaching = layer.in_channels * math.prod(layer.kernel_size) / math.prod(layer.stride)
            elif isinstance(layer, nn.Conv3d):
                reaching = layer.in_channels * math.prod(layer.kernel_size)
            elif isinstance(layer, nn.Linear):
                reaching = layer.in_features
            else:
                continue
            nn.init.normal_(layer.weight, std=math.sqrt(2 / reaching))


def narrowed(channels: int, divisor: int) -> int:
    """Return `channels` // `divisor`, but at least 4, or `channels` if that is below 4."""
    return max(min(4, channels), channels // divisor)
