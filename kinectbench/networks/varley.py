"""Varley et al.: occupancy at 40^3 from a partial view, by three convolutions and two fully connected layers.

Source: Varley et al., Shape Completion Enabled Robotic Grasping, IROS 2017; layer sizes as in
CRLab/shape_completion_experiments, `conv3_dense2.py`, reimplemented from its description.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from kinectbench.networks.layers import KERNEL, narrowed
from kinectbench.networks.network import Network

CELLS = 40
CHANNELS, VECTOR = 64, 5000
# Sides after each layer, from 40 cells: 37, 34, pooled to 17, 14, pooled to 7.
BOTTOM_CELLS = 7


class Varley(Network):
    """Varley et al.: 430,288,384 weights, the paper's 430.3 M, and 69,192 biases."""

    def __init__(self, divisor: int = 1) -> None:
        """Make the network; hidden channels, and the vector of 5000, are divided by `divisor`."""
        super().__init__(input_cells=CELLS, output_cells=CELLS)
        n = narrowed(CHANNELS, divisor)
        vector = max(VECTOR // divisor, 1)
        self.convolutions = nn.ModuleList(nn.Conv3d(a, n, KERNEL) for a in (1, n, n))
        self.to_vector = nn.Linear(n * BOTTOM_CELLS**3, vector)
        self.from_vector = nn.Linear(vector, CELLS**3)
        self._initialise()

    def _initialise(self) -> None:
        """Draw weights as in the source: He-normal, Glorot-normal in the last layer. Set biases to zero."""
        with torch.no_grad():
            for layer in (*self.convolutions, self.to_vector):
                nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
                layer.bias.zero_()
            nn.init.xavier_normal_(self.from_vector.weight)
            self.from_vector.bias.zero_()

    def forward(self, partial: Tensor) -> Tensor:
        """Return logits of occupancy, (b, 1, 40, 40, 40), for partial views of the same shape."""
        x = functional.relu(self.convolutions[0](partial))
        x = functional.max_pool3d(functional.relu(self.convolutions[1](x)), 2)
        x = functional.max_pool3d(functional.relu(self.convolutions[2](x)), 2)
        x = functional.relu(self.to_vector(x.flatten(1)))
        return self.from_vector(x).reshape(-1, 1, CELLS, CELLS, CELLS)
