"""The base class of networks, and a batch's grids at the resolutions of a network's input and output."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Generator, Tensor, nn
from torch.nn import functional


def reduced_partial(partial: Tensor, cells: int) -> Tensor:
    """Reduce partial views (b, 1, 64, 64, 64) to `cells`^3: a cell is set if it overlaps a set cell.

    The paper does not say how it reduced its views to 32^3 and 40^3; this is its rule for 64^3.
    """
    return partial if partial.shape[-1] == cells else functional.adaptive_max_pool3d(partial, cells)


@dataclass(frozen=True)
class TruthBatch:
    """The truth of a batch.

    Attributes:
        full: (b, 1, 256, 256, 256) bool, the full shapes; after `tile`, (1, 1, n, n, n) with n below 256.
        known: bool of the same shape, where the truth is known; None if every voxel counts.
    """

    full: Tensor
    known: Tensor | None

    def at(self, cells: int) -> tuple[Tensor, Tensor]:
        """Return targets and weights, each (b, 1, cells, cells, cells) float32.

        A cell's target is the occupied share of its known part, or 0 if it has no known part. Its weight is
        its known share. At the grids' own resolution, targets and weights are the grids themselves.
        """
        if self.known is None:
            return _shares(self.full, cells), self._ones(cells)
        weight = _shares(self.known, cells)
        return _shares(self.full & self.known, cells) / weight.clamp(min=1e-6), weight

    def tile(self, index: int, place: tuple[int, ...], count: int) -> "TruthBatch":
        """Return one of the `count`^3 tiles into which the grids of pair `index` are cut: (1, 1, n, n, n).

        `place` (3,) is the tile's index along each axis, 0 to `count` - 1.
        """
        cells = self.full.shape[-1] // count
        box = tuple(slice(cells * k, cells * (k + 1)) for k in place)
        cut = (slice(index, index + 1), slice(None), *box)
        return TruthBatch(self.full[cut], None if self.known is None else self.known[cut])

    def _ones(self, cells: int) -> Tensor:
        ones = self.full.new_ones((), dtype=torch.float32)
        return ones.expand(len(self.full), 1, cells, cells, cells)


def _shares(grid: Tensor, cells: int) -> Tensor:
    values = grid.float()
    return values if grid.shape[-1] == cells else functional.adaptive_avg_pool3d(values, cells)


class Network(nn.Module):
    """A network that completes shapes; its forward pass returns logits.

    Attributes:
        input_cells: number of cells along a side of its input grid, to which partial views are reduced.
        output_cells: number of cells along a side of its output grid.
    """

    def __init__(self, *, input_cells: int, output_cells: int) -> None:
        """Store the number of cells along a side of the input grid and of the output grid."""
        super().__init__()
        self.input_cells, self.output_cells = input_cells, output_cells

    def taught(
        self, partial: Tensor, truth: TruthBatch, generator: Generator
    ) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        """Yield (logits, targets in [0, 1], weights) for each output that the loss is computed on.

        Args:
            partial: (b, 1, 64, 64, 64) float32.
            truth: the truth of the same pairs.
            generator: the source of all random choices.
        """
        logits = self(reduced_partial(partial, self.input_cells))
        yield logits, *truth.at(self.output_cells)

    def completed(self, partial: Tensor) -> Tensor:
        """Return probabilities (b, 1, n, n, n) float32 for partial views (b, 1, 64, 64, 64) float32."""
        return self(reduced_partial(partial, self.input_cells)).float().sigmoid()

    @property
    def parameter_count(self) -> int:
        """Number of trained values."""
        return sum(values.numel() for values in self.parameters())
