"""Layers that several networks share: convolutions padded as TensorFlow's "SAME", and their initial values.

Layouts are torch's: (batch, channels, x, y, z).
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

KERNEL = 4


def same_padding(cells: int, stride: int) -> tuple[int, int]:
    """Cells before and after an axis for a kernel of 4, so that `ceil(cells / stride)` come out.

    Source: TensorFlow's "SAME" puts the odd one behind.
    """
    total = max((-(-cells // stride) - 1) * stride + KERNEL - cells, 0)
    return total // 2, total - total // 2


class SameConv(nn.Conv3d):
    """A convolution 4^3, padded as "SAME": (b, in, x, y, z) to (b, out, x / stride, …), rounded up."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        """Channels in and out, and the stride along each axis."""
        super().__init__(inputs, outputs, KERNEL, stride=stride)

    def forward(self, x: Tensor) -> Tensor:
        """Pad, then convolve."""
        sides = [same_padding(cells, self.stride[0]) for cells in reversed(x.shape[2:])]
        padded = functional.pad(x, [cells for side in sides for cells in side])
        return super().forward(padded)


class Doubling(nn.ConvTranspose3d):
    """A transposed convolution 4^3 of stride 2, "SAME": every side becomes twice as long."""

    def __init__(self, inputs: int, outputs: int, *, bias: bool = True) -> None:
        """Channels in and out."""
        super().__init__(inputs, outputs, KERNEL, stride=2, padding=1, bias=bias)


def xavier(network: nn.Module) -> None:
    """Weights after Glorot, uniform; biases 0, but for an LSTM's. Source: the 3D-RecGAN++ code."""
    with torch.no_grad():
        for name, values in network.named_parameters():
            if name.endswith("bias"):
                values.zero_()
            elif values.dim() > 1:
                nn.init.xavier_uniform_(values)


def narrowed(channels: int, divisor: int, least: int = 4) -> int:
    """Channels of a narrower network; at least 4, unless it had fewer before (own rule)."""
    return max(min(least, channels), channels // divisor)
