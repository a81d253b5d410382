"""Base class of networks: a torch module with the resolutions of its grids and its training targets."""

from collections.abc import Iterator

from torch import Generator, Tensor, nn

from kinectbench.networks.grids import TruthBatch, reduced_partial


class Network(nn.Module):
    """A network that completes shapes; its forward pass gives logits.

    Attributes:
        input_cells: number of cells along a side of its input, to which partial views are reduced.
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
