"""The terminal's tables: no row wraps and no cell is lost, whatever the categories and the width."""

import io
import re
from typing import Any

import pytest
from rich.console import Console
from score_rows import row, table

from kinectbench.cli.score_tables import comparison_tables, score_table
from kinectbench.core.artefacts.score_marks import Verified
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.engine.artefact import VERSIONS
from kinectbench.scoring.caveats import marks_of
from kinectbench.scoring.compare import compare
from kinectbench.scoring.read_table import recomputed

PAPERS = ("bench", "chair", "couch", "table")
MANY = tuple(f"category_{letter * 5}" for letter in "abcdefghijklmnopqrstu")


def tables(categories: tuple[str, ...]) -> list[ScoreTable]:
    found = []
    for place, name in enumerate(("net", "a-method-with-a-name-of-quite-some-length-indeed", "hull")):
        rows = [
            row(category, thing, 0, 0.1 + 0.2 * place + index / 100 + thing / 1000)
            for index, category in enumerate(categories)
            for thing in range(3)
        ]
        thresholds = dict.fromkeys(categories, 0.5)
        plain = table(name, rows).model_copy(
            update={
                "thresholds": thresholds,
                "threshold_source_by_category": dict.fromkeys(categories, "fixed"),
            }
        )
        found.append(recomputed(plain, name))
    return found


def drawn(shown: Any, width: int) -> list[str]:
    console = Console(width=width, file=io.StringIO(), record=True)
    for one in shown:
        console.print(one)
    return console.export_text().splitlines()


@pytest.mark.parametrize("width", [80, 120, 200])
@pytest.mark.parametrize("categories", [PAPERS, MANY], ids=["4", "21"])
def test_scores_of_any_width(categories: tuple[str, ...], width: int) -> None:
    made = tables(categories)
    lines = drawn([score_table(made, published=True)], width)
    text = "\n".join(lines)
    assert all(len(line) <= width for line in lines)
    for of in made:
        assert of.by_category is not None and of.overall is not None
        for averages in (*of.by_category["known"].values(), of.overall["known"]):
            assert f"{averages.iou:.3f} / {averages.ce:.3f}" in text
    for category in categories:
        assert text.count(category) == 1
    cells = [cell.strip() for line in lines for cell in line.split("│")[1:-1]]
    assert cells and "…" not in cells
    # One line for each method in each piece: none is wrapped.
    pieces = sum(line.startswith("┏") for line in lines)
    assert sum(line.startswith("│ net") for line in lines) == pieces
    assert re.search("nats a voxel", lines[0]) and "higher is better" in lines[0]


@pytest.mark.parametrize("width", [80, 120, 200])
@pytest.mark.parametrize("categories", [PAPERS, MANY], ids=["4", "21"])
def test_comparisons_of_any_width(categories: tuple[str, ...], width: int) -> None:
    found = compare(tables(categories))
    lines = drawn(comparison_tables(found), width)
    text = "\n".join(lines)
    assert all(len(line) <= width for line in lines)
    cells = [cell.strip() for line in lines for cell in line.split("│")[1:-1]]
    assert "…" not in cells and set(categories) <= {*re.split(r"[\s┃│]+", text)}
    for scope, means in found.means.items():
        for name, mean in means.items():
            assert f"{found.groups[scope][name]}  {mean:.3f}" in cells
    assert "cannot be distinguished" in text


def test_what_sets_a_method_apart_is_said() -> None:
    net, long, hull = tables(PAPERS)
    verified = Verified(
        date="2026-11-25", package_version="0.1.0", table_sha256="0" * 64, predictions_sha256="0" * 64
    )
    hull = hull.model_copy(update={"verified": verified, "baseline": True})
    hull = hull.model_copy(update={"marks": marks_of(hull)})
    text = "\n".join(drawn([score_table([net, long, hull])], 120))
    assert "net* " in text and "hull (baseline)*" in text
    names, marks = "net, a-method-with-a-name-of-quite-some-length-indeed, hull", "thresholds fixed at 0.5"
    assert f"* {names}: score version 1, now {VERSIONS['score']}; {marks}" in text
    assert "reported: net, a-method-with-a-name-of-quite-some-length-indeed" in text
    assert "verified 2026-11-25, kinectbench 0.1.0 (as its scores.json says): hull" in text
