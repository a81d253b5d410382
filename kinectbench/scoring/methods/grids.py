"""Grids of a batch as tensors, at the side that a network takes or gives."""

from dataclasses import dataclass
from functools import cached_property

from torch import Tensor
from torch.nn import functional


def reduced_partial(partial: Tensor, cells: int) -> Tensor:
    """Partial views (b, 1, 64, 64, 64) at a smaller side: a cell is set if any cell that it touches is.

    The paper does not say how its views came to 32^3 and 40^3; this is the rule by which they came to 64^3.
    """
    return partial if partial.shape[-1] == cells else functional.adaptive_max_pool3d(partial, cells)


@dataclass(frozen=True)
class TruthBatch:
    """The truth of a batch.

    Attributes:
        full: (b, 1, 256, 256, 256) float32, 0 or 1.
        known: the same, 1 where the truth is trusted; None: every voxel counts.
    """

    full: Tensor
    known: Tensor | None

    def at(self, cells: int) -> tuple[Tensor, Tensor]:
        """Targets and weights, each (b, 1, cells, cells, cells) float32.

        A target is the share of a cell that is occupied, of what is known of it; its weight is the share that
        is known. At 256^3 they are the grids themselves.
        """
        if self.known is None:
            return _shares(self.full, cells), self._ones(cells)
        weight = _shares(self.known, cells)
        return _shares(self._occupied, cells) / weight.clamp(min=1e-6), weight

    @cached_property
    def _occupied(self) -> Tensor:
        assert self.known is not None
        return self.full * self.known

    def _ones(self, cells: int) -> Tensor:
        return self.full.new_ones(()).expand(len(self.full), 1, cells, cells, cells)


def _shares(grid: Tensor, cells: int) -> Tensor:
    return grid if grid.shape[-1] == cells else functional.adaptive_avg_pool3d(grid, cells)
