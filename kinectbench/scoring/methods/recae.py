"""3D-RecAE: the generator of 3D-RecGAN++ alone, from a partial view at 64^3 to occupancy at 256^3.

Source: Yang et al., Dense 3D Object Reconstruction from a Single Depth View, TPAMI 2018; layers as in the
authors' code, Yang7879/3D-RecGAN-extended, `aeu` in main_3D-RecGAN++.py (MIT), written anew.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from kinectbench.scoring.methods.layers import Doubling, SameConv, narrowed, xavier
from kinectbench.scoring.methods.network import Network

ENCODER = (64, 128, 256, 512)
VECTOR = 2000
DECODER = (256, 128, 64, 16, 8)
SLOPE = 0.2
BOTTOM_CELLS = 4


class RecAE(Network):
    """164,282,729 parameters at full width: four convolutions, two full layers, six transposed convolutions.

    Each of the first five of these takes the encoder's output of the same side beside its own input, the last
    of them the partial view itself.
    """

    def __init__(self, divisor: int = 1, output_cells: int = 256) -> None:
        """Make the network.

        Args:
            divisor: hidden channels are divided by it; of the decoder at least 4 stay.
            output_cells: 64, 128 or 256; the transposed convolutions that are left out are the last ones.
        """
        super().__init__(input_cells=64, output_cells=output_cells)
        encoder = [narrowed(channels, divisor) for channels in ENCODER]
        count = {64: 4, 128: 5, 256: 6}[output_cells]
        decoder = [narrowed(channels, divisor) for channels in DECODER[: count - 1]] + [1]
        bottom = encoder[-1] * BOTTOM_CELLS**3
        vector = max(VECTOR // divisor, 1)
        self.down = nn.ModuleList(SameConv(a, b) for a, b in zip([1, *encoder], encoder, strict=False))
        self.to_vector = nn.Linear(bottom, vector)
        self.from_vector = nn.Linear(vector, bottom)
        skips = [*reversed(encoder), 1]
        inputs = [encoder[-1], *decoder]
        self.up = nn.ModuleList(
            Doubling(inputs[k] + (skips[k] if k < len(skips) else 0), channels)
            for k, channels in enumerate(decoder)
        )
        xavier(self)

    def forward(self, partial: Tensor) -> Tensor:
        """Logits of occupancy, (b, 1, n, n, n), of partial views (b, 1, 64, 64, 64)."""
        levels = [partial]
        for layer in self.down:
            levels.append(functional.max_pool3d(functional.leaky_relu(layer(levels[-1]), SLOPE), 2))
        vector = functional.relu(self.to_vector(levels[-1].flatten(1)))
        grown = functional.relu(self.from_vector(vector)).reshape(levels[-1].shape)
        for index, layer in enumerate(self.up):
            if levels:
                grown = torch.cat([grown, levels.pop()], dim=1)
            grown = layer(grown)
            if index + 1 < len(self.up):
                grown = functional.relu(grown)
        return grown
