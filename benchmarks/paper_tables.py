"""The paper's tables of synthetic pairs, for methods that were scored on a release of `synthesize`.

Same viewing (recordings that end in -sv) and cross viewing (-cv), IoU and cross-entropy of each category, as
means over pairs under the protocol `paper`. The paper's own rows stand below ours: they are of other shapes.

    python benchmarks/paper_tables.py scores/recae-small scores/recae-small/baselines/*     # Markdown
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from kinectbench.core.artefacts.score_figures import ScoreRow
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.errors import KinectBenchError
from kinectbench.scoring.published import CATEGORIES, SYNTHETIC, Four, PublishedTable
from kinectbench.scoring.read_table import read_table

# The published tables of one network for all categories: as ours are trained.
GROUPS = {"sv": SYNTHETIC[2], "cv": SYNTHETIC[3]}
TITLES = {"sv": "Same viewing angles", "cv": "Cross viewing angles"}


def of_categories(rows: Sequence[ScoreRow], figure: str) -> Four | None:
    """The mean of a figure over the pairs of each of the paper's categories; None if one has no pair."""
    values = [[getattr(row, figure) for row in rows if row.category == name] for name in CATEGORIES]
    if not all(values) or any(value is None for some in values for value in some):
        return None
    bench, chair, couch, table = (float(np.mean(some)) for some in values)
    return bench, chair, couch, table


def line(name: str, iou: Four, ce: Four) -> str:
    """A row of Markdown."""
    return f"| {name} | {' | '.join(f'{value:.3f}' for value in (*iou, *ce))} |"


def table_lines(
    title: str, group: str, scores: Sequence[ScoreTable], beside: PublishedTable
) -> Iterator[str]:
    """One table in the paper's form."""
    yield f"**{title}.** IoU, then cross-entropy (nats a voxel)."
    yield ""
    yield f"| method | {' | '.join(CATEGORIES)} | {' | '.join(CATEGORIES)} |"
    yield "|---" * 9 + "|"
    ours = []
    for table in scores:
        rows = [row for row in table.rows if row.protocol == "paper" and row.recording.endswith(f"-{group}")]
        iou, ce = of_categories(rows, "iou"), of_categories(rows, "ce")
        if iou is None or ce is None:
            raise KinectBenchError(f"{table.method}: has no {group} pair of each of {', '.join(CATEGORIES)}")
        ours.append((iou, line(table.method, iou, ce)))
    yield from (text for _, text in sorted(ours, key=lambda each: -sum(each[0])))
    for row in beside.rows:
        yield line(f"*{row.method}, published: ShapeNet*", row.iou, row.ce)
    yield ""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scores", type=Path, nargs="+", help="folders with scores.json")
    folders = parser.parse_args().scores
    scores = [read_table(folder / ScoreTable.FILE) for folder in folders]
    if len({table.benchmark_sha256 for table in scores}) > 1:
        raise KinectBenchError("the scores are of different releases")
    for group, beside in GROUPS.items():
        print("\n".join(table_lines(TITLES[group], group, scores, beside)))


if __name__ == "__main__":
    main()
