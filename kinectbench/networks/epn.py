"""3D-EPN: from a partial view to occupancy at 32^3.

Source: Dai et al., Shape Completion using 3D-Encoder-Predictor CNNs and Shape Synthesis, CVPR 2017, without
its classification and its retrieval of shapes; layer sizes as in angeladai/cnncomplete, `epn-unet.lua` and
`nnutil.lua`, written here from their description. Like the 3D-RecGAN++ paper, this network uses occupancy
instead of distances: one channel in, one out, trained by cross-entropy.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from kinectbench.networks.layers import KERNEL, narrowed
from kinectbench.networks.network import Network

# As in epn-unet.lua: side of input and output, channels of the first layer (`nf`), slope of the leaky ReLU.
CELLS = 32
CHANNELS = 80
SLOPE = 0.2
# Epsilon of batch normalisation, as in nnutil.lua (`batchNormEps`); PyTorch's default is 1e-5.
EPSILON = 1e-3


class EPN(Network):
    """3D-EPN: 52,447,201 parameters, plus 3,360 of batch normalisation.

    It has four convolutions down to one cell, two fully connected layers, and four transposed convolutions
    with skip connections.
    """

    def __init__(self, divisor: int = 1) -> None:
        """Make the network; hidden channels are divided by `divisor`."""
        super().__init__(input_cells=CELLS, output_cells=CELLS)
        n = narrowed(CHANNELS, divisor)
        self.down = nn.ModuleList(
            [
                nn.Conv3d(1, n, KERNEL, stride=2, padding=1),
                nn.Conv3d(n, 2 * n, KERNEL, stride=2, padding=1),
                nn.Conv3d(2 * n, 4 * n, KERNEL, stride=2, padding=1),
                nn.Conv3d(4 * n, 8 * n, KERNEL),
            ]
        )
        self.full = nn.ModuleList([nn.Linear(8 * n, 8 * n), nn.Linear(8 * n, 8 * n)])
        self.up = nn.ModuleList(
            [
                nn.ConvTranspose3d(16 * n, 4 * n, KERNEL),
                nn.ConvTranspose3d(8 * n, 2 * n, KERNEL, stride=2, padding=1),
                nn.ConvTranspose3d(4 * n, n, KERNEL, stride=2, padding=1),
                nn.ConvTranspose3d(2 * n, 1, KERNEL, stride=2, padding=1),
            ]
        )
        self.norms_down = nn.ModuleList(nn.BatchNorm3d(k * n, eps=EPSILON) for k in (2, 4, 8))
        self.norms_up = nn.ModuleList(nn.BatchNorm3d(k * n, eps=EPSILON) for k in (4, 2, 1))
        self._initialise()

    def _initialise(self) -> None:
        """Draw weights and biases uniformly in +-1 / sqrt(fan-in), and scales of normalisation in [0, 1].

        Source: the default `reset` of the Torch7 modules that the authors use.
        """
        for layer in self.modules():
            if isinstance(layer, nn.BatchNorm3d):
                nn.init.uniform_(layer.weight)
            elif isinstance(layer, nn.Linear):
                _uniform(layer, layer.in_features)
            elif isinstance(layer, nn.Conv3d | nn.ConvTranspose3d):
                _uniform(layer, layer.in_channels * KERNEL**3)

    def forward(self, partial: Tensor) -> Tensor:
        """Return logits of occupancy, (b, 1, 32, 32, 32), for partial views of the same shape."""
        levels, x = [], partial
        for index, layer in enumerate(self.down):
            x = layer(x)
            if index:
                x = _normalised(self.norms_down[index - 1], x)
            x = functional.leaky_relu(x, SLOPE)
            levels.append(x)
        vector = x.flatten(1)
        for layer in self.full:
            vector = functional.relu(layer(vector))
        grown = vector.reshape(x.shape)
        for index, layer in enumerate(self.up):
            grown = layer(torch.cat([grown, levels.pop()], dim=1))
            if index < len(self.norms_up):
                grown = functional.relu(_normalised(self.norms_up[index], grown))
        return grown


def _uniform(layer: nn.Linear | nn.Conv3d | nn.ConvTranspose3d, inputs: int) -> None:
    bound = inputs**-0.5
    for values in layer.parameters():
        nn.init.uniform_(values, -bound, bound)


def _normalised(norm: nn.Module, x: Tensor) -> Tensor:
    """Apply batch normalisation; if a channel has only one value, use running statistics even in training."""
    if x.shape[0] * x.shape[2] ** 3 > 1:
        return norm(x)
    assert isinstance(norm, nn.BatchNorm3d)
    return functional.batch_norm(x, norm.running_mean, norm.running_var, norm.weight, norm.bias, eps=norm.eps)
