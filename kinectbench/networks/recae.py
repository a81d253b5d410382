"""3D-RecAE: the generator of 3D-RecGAN++ alone. It maps a partial view at 64^3 to occupancy at 256^3.

Source: Yang et al., Dense 3D Object Reconstruction from a Single Depth View, TPAMI 2018; layers as in the
authors' code, Yang7879/3D-RecGAN-extended, `aeu` in main_3D-RecGAN++.py (MIT), reimplemented.
"""

from collections.abc import Iterator, Sequence

import torch
from torch import Generator, Tensor, nn
from torch.nn import functional

from kinectbench.networks.layers import Doubling, SameConv, he, narrowed, xavier
from kinectbench.networks.network import Network, TruthBatch

ENCODER = (64, 128, 256, 512)
VECTOR = 2000
DECODER = (256, 128, 64, 16, 8)
SLOPE = 0.2
BOTTOM_CELLS = 4
# Number of transposed convolutions from 4^3 to 64^3; the rest go beyond.
UNTIL_64 = 4
# Logit of 0.074, the share of occupied cells in 71 training pairs of recae-small (every hundredth pair).
FIRST_LOGIT = -2.5


class RecAE(Network):
    """3D-RecAE, 164,282,729 parameters.

    It has four convolutions, two fully connected layers and six transposed convolutions. Each of the first
    four transposed convolutions also takes the encoder's output of its input resolution; the fifth takes the
    partial view itself.
    """

    def __init__(self, divisor: int = 1, output_cells: int = 256) -> None:
        """Make the network.

        Args:
            divisor: hidden channels are divided by it; each convolution keeps at least 4.
            output_cells: 64, 128 or 256 cells a side; below 256, the last transposed convolutions are left
                out.
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

    def start_by_he(self) -> None:
        """Initialise weights by `he`, and the output's bias by the logit of 0.074, a usual occupied share."""
        he(nn.ModuleList([self.down, self.to_vector, self.from_vector, self.up]))
        last = self.up[-1]
        assert isinstance(last, Doubling) and last.bias is not None
        nn.init.constant_(last.bias, FIRST_LOGIT)

    def forward(self, partial: Tensor) -> Tensor:
        """Return logits of occupancy, (b, 1, n, n, n), for partial views (b, 1, 64, 64, 64)."""
        grown = self._until_64(partial)
        finer = self._finer
        if finer:
            grown = finer[0](torch.cat([functional.relu(grown), partial], dim=1))
        for layer in finer[1:]:
            grown = layer(functional.relu(grown))
        return grown

    def taught_tiles(
        self, partial: Tensor, truth: TruthBatch, generator: Generator, cells: int
    ) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        """Yield one tuple: logits, targets and weights of a random tile of each shape.

        All are (b, 1, cells, cells, cells). Layers beyond 64^3 compute only the tile.

        All tiles are equally likely, so the expected loss is that of the whole grid if no voxels are masked.
        A step of `recae-small` takes 0.29 s of CPU per pair with tiles of 128^3, and 1.36 s without tiles.

        Args:
            partial: (b, 1, 64, 64, 64) float32.
            truth: the truth of the same pairs.
            generator: source of the random numbers that choose the tiles.
            cells: number of cells along a side of a tile.
        """
        base = torch.cat([functional.relu(self._until_64(partial)), partial], dim=1)
        count = self.output_cells // cells
        parts = []
        for index, one in enumerate(base.split(1)):
            drawn = torch.randint(count, (3,), generator=generator, device=generator.device)
            place = tuple(int(k) for k in drawn)
            logits = _tile_of(self._finer, one, place, cells)
            parts.append((logits, *truth.tile(index, place, count).at(cells)))
        yield tuple(torch.cat(each) for each in zip(*parts, strict=True))

    def _until_64(self, partial: Tensor) -> Tensor:
        """Return the output of the fourth transposed convolution, (b, c, 64, 64, 64)."""
        levels = [partial]
        for layer in self.down:
            levels.append(functional.max_pool3d(functional.leaky_relu(layer(levels[-1]), SLOPE), 2))
        vector = functional.relu(self.to_vector(levels[-1].flatten(1)))
        grown = functional.relu(self.from_vector(vector)).reshape(levels[-1].shape)
        for index, layer in enumerate(self.up[:UNTIL_64]):
            grown = layer(torch.cat([functional.relu(grown) if index else grown, levels.pop()], dim=1))
        return grown

    @property
    def _finer(self) -> list[nn.Module]:
        """Return the layers beyond 64^3; the first of them also takes the partial view."""
        return list(self.up)[UNTIL_64:]


def _tile_of(layers: Sequence[nn.Module], base: Tensor, place: tuple[int, ...], cells: int) -> Tensor:
    """Compute one tile of the output of doubling layers, but not the rest of the output.

    There is a ReLU between two layers. An output cell of a layer depends on the input cell that contains it,
    and on the neighbours of this input cell. So at every layer, a margin of one cell around the tile is
    enough.

    `layers` are transposed convolutions 4^3 of stride 2; `base` (1, c, n, n, n) is the input of the first.
    The tile (1, 1, cells, cells, cells) has the indices `place` (3,) along the axes.
    """
    lows = [index * cells >> len(layers) for index in place]
    width, side, margin = cells >> len(layers), base.shape[-1], 1
    begins = [max(low - margin, 0) for low in lows]
    x = _cut(base, [0, 0, 0], begins, [min(low + width + margin, side) for low in lows])
    for number, layer in enumerate(layers, start=1):
        margin = int(number < len(layers))
        x = layer(x if number == 1 else functional.relu(x))
        lows, begins = [2 * low for low in lows], [2 * begin for begin in begins]
        width, side = 2 * width, 2 * side
        wanted = [max(low - margin, 0) for low in lows]
        x = _cut(x, begins, wanted, [min(low + width + margin, side) for low in lows])
        begins = wanted
    return x


def _cut(x: Tensor, begins: Sequence[int], lows: Sequence[int], highs: Sequence[int]) -> Tensor:
    """Return the cells from `lows` to before `highs` along each axis of x (1, c, …).

    All indices refer to the whole grid; x is the part of it that starts at `begins`.
    """
    box = (slice(low - first, high - first) for first, low, high in zip(begins, lows, highs, strict=True))
    return x[(slice(None), slice(None), *box)]
