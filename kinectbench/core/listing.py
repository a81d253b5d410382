"""A long table on a page: the first rows are static; a script shows, searches and filters all rows."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from kinectbench.core.untrusted import STEERING

if TYPE_CHECKING:
    from markupsafe import Markup

# A page shows up to this many recordings in full; of more recordings, this many: two to four MB.
SHOWN = 24
# Rows shown at a time: one to three screens, which a browser lays out at once.
PAGE_ROWS = 100
# A column with more values than this is searched by text instead of by a choice.
MOST_CHOICES = 200


@dataclass(frozen=True)
class Listing:
    """The content of a table that `core/listing.html` shows.

    Attributes:
        columns: headings of the columns.
        filters: indices of the columns that get a drop-down list of their values.
        rows: texts of all rows, a cell for each column.
        links: first cell of a row → target of its link, for the rows that have a link.
        elsewhere: a few words on where a reader without scripts finds all rows.
    """

    columns: Sequence[str]
    filters: Sequence[int]
    rows: Sequence[Sequence[str]]
    links: Mapping[str, str]
    elsewhere: str

    @property
    def first(self) -> Sequence[Sequence[str]]:
        """The rows that are visible without the script."""
        return self.rows[:PAGE_ROWS]

    @property
    def choices(self) -> dict[int, list[str]]:
        """{index of a filter column: its sorted values}, without columns that have one value or too many."""
        by_column = {column: sorted({row[column] for row in self.rows}) for column in self.filters}
        return {column: values for column, values in by_column.items() if 1 < len(values) <= MOST_CHOICES}

    @property
    def data(self) -> "Markup":
        """All rows as JSON for the script; untrusted text cannot end the script element."""
        rows = [[STEERING.sub("?", cell) for cell in row] for row in self.rows]
        return inert_json({"size": PAGE_ROWS, "links": dict(self.links), "rows": rows})


def inert_json(content: object) -> "Markup":
    """JSON for an HTML page, escaped so that it cannot end its script element.

    Raises:
        ValueError: a number is not finite.
    """
    from markupsafe import Markup

    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)
