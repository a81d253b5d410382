"""A table for terminals of any width: columns that do not fit continue in a table below."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from rich.cells import cell_len
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult

BESIDE_CELL = 3  # a border, and a space on both sides
# A name takes at most this fraction (one third) of the width, or this many cells; longer names are cut with
# an ellipsis.
NAME_SHARE, NAME_CELLS = 3, 30
# Beside an uncut id, a text has at least this many cells, and as many lines as it needs.
TEXT_CELLS = 12


class WideTable(Table):
    """A rich table that is split into as many pieces as the terminal's width requires, one below the other.

    Each piece repeats the first `keep` columns. If the very first column is too wide, its cells are
    shortened, or wrapped if `whole` is set.
    """

    def __init__(
        self, *, keep: int = 1, title: str | None = None, caption: str | None = None, whole: bool = False
    ) -> None:
        """Make an empty table.

        Every piece repeats `keep` leading columns. With `whole`, cells are wrapped instead of shortened, so
        that ids can be copied.
        """
        super().__init__(title=title, caption=caption)
        self.keep, self.whole = keep, whole

    def __rich_console__(self, console: "Console", options: "ConsoleOptions") -> "RenderResult":
        """Yield the title, the pieces and the caption, as rich asks for them."""
        if self.title:
            yield Text(str(self.title), style="italic")
        yield from self._pieces(options.max_width)
        if self.caption:
            yield Text(str(self.caption), style="dim")

    def _pieces(self, width: int) -> Iterator[Table]:
        """Yield the pieces, each no wider than `width` character cells."""
        widths = [self._width(index) for index in range(len(self.columns))]
        most = max(NAME_CELLS, width // NAME_SHARE)
        if self.whole:
            most = max(1, width - 1 - 2 * BESIDE_CELL - self._most_beside(widths))
        widths[0] = min(widths[0], most)
        room = width - 1 - sum(widths[: self.keep]) - BESIDE_CELL * self.keep
        chosen: list[int] = []
        used = 0
        for index in range(self.keep, len(self.columns)):
            widths[index] = min(widths[index], room - BESIDE_CELL)
            if chosen and used + widths[index] + BESIDE_CELL > room:
                yield self._piece(chosen, widths)
                chosen, used = [], 0
            chosen.append(index)
            used += widths[index] + BESIDE_CELL
        yield self._piece(chosen, widths)

    def _most_beside(self, widths: list[int]) -> int:
        """Return the width of the widest column that is not repeated, in character cells, up to a limit.

        Cells wider than the limit are wrapped.
        """
        texts = [column.justify == "left" for column in self.columns]
        beside = list(zip(widths, texts, strict=True))[self.keep :]
        return max((min(each, TEXT_CELLS if text else NAME_CELLS) for each, text in beside), default=0)

    def _width(self, index: int) -> int:
        """Return the width of the widest line in a column, in character cells."""
        column = self.columns[index]
        texts = [str(column.header), *(str(cell) for cell in column.cells)]
        return max(cell_len(line) for text in texts for line in [*text.splitlines(), ""])

    def _piece(self, chosen: list[int], widths: list[int]) -> Table:
        """Return a piece with the repeated and the `chosen` columns; `widths` has the widths of all."""
        piece = Table()
        columns = [*range(self.keep), *chosen]
        for index in columns:
            of = self.columns[index]
            piece.add_column(
                of.header, justify=of.justify, no_wrap=not self.whole, min_width=1,
                max_width=max(1, widths[index]), overflow="fold" if self.whole else "ellipsis",
            )  # fmt: skip
        cells = [list(self.columns[index].cells) for index in columns]
        for row, drawn in zip(self.rows, zip(*cells, strict=True), strict=True):
            piece.add_row(*drawn, style=row.style, end_section=row.end_section)
        return piece
