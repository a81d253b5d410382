"""Make the tables of the paper, 3D-RecGAN++, for some methods: mean IoU and cross-entropy by category.

They have the form of the paper's tables at 256^3 (`scoring.published`), and every pair weighs equally. Like
the paper's test sets, each set of viewing angles gets its own table. The names of recordings state the
angles.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean

from kinectbench.core import SettingsError, printable
from kinectbench.core.artefacts.score_figures import ScoreRow
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.report.space_table import is_baseline
from kinectbench.scoring.compare import method_names
from kinectbench.scoring.published import (
    CATEGORIES,
    LABEL,
    PARAMETERS_LINE,
    REAL,
    SYNTHETIC,
    UNSEEN,
    PublishedTable,
)

# The paper's synthetic truth is solid; its real truth is less solid. `shell` is the other extreme.
PROTOCOL, SHELL = "paper", "shell"
# Endings of recordings from `import` and `synthesize` -> views of the paper's test set with the same angles.
VIEWS = {"125": 125, "sv": 125, "216": 216, "cv": 216}
TITLES = {125: "same viewing angles", 216: "cross viewing angles", None: "all pairs"}
OF_SHELL = ", the surface alone as truth"
_ENDING = re.compile(r".+-(125|216|sv|cv)")
NOT_KNOWN = "–"
# Largest number of characters of a cell; the longest published row has 93.
LONGEST_CELL = 100


@dataclass(frozen=True)
class PaperRow:
    """One row of the paper's table: the results of a method.

    Attributes:
        method: the method's name.
        published: title of the paper's table that states these results; "" for a scored method.
        iou: {category: mean over pairs}; a category without a pair is left out.
        ce: {category: mean cross-entropy over pairs}, nats per voxel.
        baseline: whether it is a baseline.
    """

    method: str
    published: str
    iou: Mapping[str, float]
    ce: Mapping[str, float]
    baseline: bool = False


@dataclass(frozen=True)
class PaperTable:
    """One table in the paper's form.

    Attributes:
        title: states the scored pairs, such as those of one set of viewing angles.
        categories: categories with pairs: first the paper's in its order, then others by name.
        pairs: number of scored pairs of each method, taken from one method. All are scored on the same truth.
        rows: scored methods, by descending mean IoU over the categories, then the rows that the paper
            published.
    """

    title: str
    categories: tuple[str, ...]
    pairs: int
    rows: tuple[PaperRow, ...]


def paper_tables(tables: Sequence[ScoreTable]) -> list[PaperTable]:
    """Return tables in the paper's form for methods scored on one truth, one for each set of viewing angles.

    If all methods were also scored under the protocol `shell`, the tables of `shell` follow. The paper's
    results on real recordings are in the tables of both protocols, because the paper does not say whether the
    truth of these recordings is solid or a shell.

    Raises:
        SettingsError: a table is not complete, or was not scored under the protocol `paper`.
    """
    both = all(table.pairs(SHELL) for table in tables)
    solid = _tables(tables, PROTOCOL, "", (REAL, *SYNTHETIC))
    return [*solid, *_tables(tables, SHELL, OF_SHELL, (REAL,))] if both else solid


def _tables(
    tables: Sequence[ScoreTable], protocol: str, ending: str, published: Sequence[PublishedTable]
) -> list[PaperTable]:
    """Return the tables of one protocol, with rows of matching `published` tables; titles end in `ending`."""
    of_methods = []
    for name, table in zip(method_names(tables), tables, strict=True):
        rows = table.pairs(protocol)
        if not rows or not table.complete or any(None in (row.iou, row.ce) for row in rows):
            why = "some of its pairs are not scored" if rows else f"not scored under '{protocol}'"
            raise SettingsError(f"{name}: {why}; score it again", what="other-scores")
        of_methods.append((name, is_baseline(table), rows))
    views = sorted({_views(row) for *_, rows in of_methods for row in rows}, key=lambda of: (of is None, of))
    result = []
    for of in views:
        with_views = [
            (name, baseline, [row for row in rows if _views(row) == of])
            for name, baseline, rows in of_methods
        ]
        beside = [table for table in published if table.views == of]
        result.append(_table(TITLES[of] + ending, with_views, beside))
    return result


def _views(row: ScoreRow) -> int | None:
    """Return the number of viewing angles that a recording's name states; None if it states none."""
    match = _ENDING.fullmatch(row.recording)
    return VIEWS[match[1]] if match else None


def _table(
    title: str, methods: Iterable[tuple[str, bool, Sequence[ScoreRow]]], beside: Sequence[PublishedTable]
) -> PaperTable:
    methods = [method for method in methods if method[2]]
    present = {row.category for *_, rows in methods for row in rows}
    known = (*CATEGORIES, *UNSEEN)
    categories = (*(c for c in known if c in present), *sorted(present.difference(known)))
    ours = [
        PaperRow(name, "", _means(rows, "iou"), _means(rows, "ce"), baseline)
        for name, baseline, rows in methods
    ]
    ours.sort(key=lambda row: -fmean(row.iou.values()))
    published = [
        PaperRow(row.method, of.title, _present(of, row.iou, categories), _present(of, row.ce, categories))
        for of in beside
        if of.views is None or present & set(of.categories)
        for row in of.rows
    ]
    return PaperTable(title, categories, len(methods[0][2]), (*ours, *published))


def _means(rows: Sequence[ScoreRow], figure: str) -> dict[str, float]:
    """Return {category: mean over its pairs} of `figure`, "iou" or "ce", which every row must have."""
    values: dict[str, list[float]] = {}
    for row in rows:
        values.setdefault(row.category, []).append(getattr(row, figure))
    return {category: fmean(of) for category, of in values.items()}


def _present(of: PublishedTable, figures: Sequence[float], categories: Sequence[str]) -> dict[str, float]:
    """Return {category: value} for the wanted categories; `figures` is a row of the published table `of`."""
    return {name: value for name, value in zip(of.categories, figures, strict=True) if name in categories}


def paper_markdown(tables: Sequence[PaperTable]) -> str:
    """Return tables as Markdown: a row for each method, with the IoU, then the cross-entropy, by category.

    If a table has published rows, the last line states the numbers of parameters of the paper's networks.
    """
    last = [PARAMETERS_LINE] if any(row.published for table in tables for row in table.rows) else []
    return "\n\n".join([*("\n".join(_lines(table)) for table in tables), *last]) + "\n"


def _lines(table: PaperTable) -> list[str]:
    heads = [*(f"IoU {name}" for name in table.categories), *(f"CE {name}" for name in table.categories)]
    lines = [
        f"**{table.title}**: {table.pairs} pairs a method, means over pairs, every voxel counted; IoU, and "
        "cross-entropy in nats a voxel",
        "",
        f"| method | {' | '.join(map(_text, heads))} |",
        "|---" * (1 + len(heads)) + "|",
    ]
    for row in table.rows:
        name = f"*{row.method}; {row.published}: {LABEL}*" if row.published else row.method
        name += " (baseline)" * row.baseline
        values = [of.get(category) for of in (row.iou, row.ce) for category in table.categories]
        figures = [NOT_KNOWN if value is None else f"{value:.3f}" for value in values]
        lines.append(f"| {_text(name)} | {' | '.join(figures)} |")
    return lines


def _text(words: str) -> str:
    """Return an untrusted text escaped for a cell of a Markdown table."""
    return printable(words, LONGEST_CELL).replace("|", "\\|")
