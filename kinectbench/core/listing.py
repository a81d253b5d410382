"""A long table on a page: static first rows, and a script that shows, searches and filters all."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from kinectbench.core.untrusted import STEERING

if TYPE_CHECKING:
    from markupsafe import Markup

T = TypeVar("T")
# Recordings that a page shows with all there is of them, and of more so many: two to four MB.
SHOWN = 24
# Rows at a time: a screen or three, which a browser lays out at once.
PAGE_ROWS = 100
# Values that a column may have to be offered as a choice: more are searched for.
MOST_CHOICES = 200


@dataclass(frozen=True)
class Listing:
    """A table as `core/listing.html` shows it.

    Attributes:
        columns: their headings.
        filters: indices of the columns of which one value may be chosen.
        rows: texts of all rows, a cell for each column.
        links: first cell of a row → where it leads; most lead nowhere.
        elsewhere: where all rows can be read without scripts, in a few words.
    """

    columns: Sequence[str]
    filters: Sequence[int]
    rows: Sequence[Sequence[str]]
    links: Mapping[str, str]
    elsewhere: str

    @property
    def first(self) -> Sequence[Sequence[str]]:
        """The rows that are shown without the script."""
        return self.rows[:PAGE_ROWS]

    @property
    def choices(self) -> dict[int, list[str]]:
        """The values of each column that has a choice, sorted."""
        by_column = {column: sorted({row[column] for row in self.rows}) for column in self.filters}
        return {column: values for column, values in by_column.items() if 1 < len(values) <= MOST_CHOICES}

    @property
    def data(self) -> "Markup":
        """All rows for the script; untrusted text cannot end its element."""
        rows = [[STEERING.sub("?", cell) for cell in row] for row in self.rows]
        return inert_json({"size": PAGE_ROWS, "links": dict(self.links), "rows": rows})


def spread(items: Sequence[T], most: int) -> list[T]:
    """At most `most` of the items, evenly spread from the first to the last."""
    count = min(most, len(items))
    return [items[round(at * (len(items) - 1) / max(1, count - 1))] for at in range(count)]


def inert_json(content: object) -> "Markup":
    """JSON without characters that could end its element of a page.

    Raises:
        ValueError: a number is not finite.
    """
    from markupsafe import Markup

    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)
