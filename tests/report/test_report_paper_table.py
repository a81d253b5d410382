"""`kinectbench report --paper-table`: of synthetic, imported, real recordings, and what is no such table."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from raising import raises
from score_rows import row, table
from small_benchmark import Run

from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.errors import SettingsError
from kinectbench.release.release import Release
from kinectbench.report.paper_table import paper_markdown, paper_tables
from kinectbench.scoring.baselines.in_grids import comparison_baselines
from kinectbench.scoring.score import score_methods

Command = Callable[..., Run]


TWO = ("table", "bench")


@pytest.fixture(scope="module")
def scores(release: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of one method, with the baselines beside it."""
    root = tmp_path_factory.mktemp("paper")
    for target in release.split("test"):
        path = root / "mine" / target.recording / f"{target.view}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, np.full((2, 2, 2), 1, np.float16))
    (made,) = score_methods(release, root / "mine", root / "scores", surface=False)
    comparison_baselines(release, root / "scores", protocols=made.settings.protocols)
    return root / "scores"


def scored(name: str, gain: float, ending: str = "", categories: tuple[str, ...] = TWO) -> ScoreTable:
    """Two objects of two views in each category, under `paper`; the second's recording ends otherwise."""
    endings = {0: ending, 1: {"-sv": "-cv", "-125": "-125"}.get(ending, "")}
    rows = [
        replace(
            row(category, thing, view, gain + (thing + view) / 10),
            protocol="paper",
            recording=f"{category}_{thing}{endings[thing]}",
        )
        for category in categories
        for thing in range(2)
        for view in range(2)
    ]
    return table(name, rows)


def test_real_recordings_have_one_table() -> None:
    """Categories in the paper's order, and then others; what the paper does not have of them stays open."""
    categories = ("cabinet", "table", "bench")
    (found,) = paper_tables([scored("worse", 0.2, "", categories), scored("better", 0.4, "", categories)])
    assert (found.title, found.categories, found.pairs) == ("all pairs", ("bench", "table", "cabinet"), 12)
    assert [of.method for of in found.rows[:3]] == ["better", "worse", "3D-RecGAN++"]
    two = paper_tables([scored("net", 0.2), scored("net", 0.1)])
    assert [of.method for of in two[0].rows[:2]] == ["net", "net #2"]
    assert found.rows[0].iou == pytest.approx(dict.fromkeys(categories, 0.5))
    assert found.rows[0].ce == pytest.approx(dict.fromkeys(categories, 0.5))
    lines = paper_markdown([found]).splitlines()
    assert lines[2] == "| method | IoU bench | IoU table | IoU cabinet | CE bench | CE table | CE cabinet |"
    assert lines[4] == "| better | 0.500 | 0.500 | 0.500 | 0.500 | 0.500 | 0.500 |"
    published = "| *3D-RecGAN++; Table 10 (real recordings): published, not comparable* |"
    assert lines[6] == f"{published} 0.177 | 0.156 | – | 0.061 | 0.177 | – |"


def test_kinds_of_viewing_have_their_own_tables() -> None:
    same, cross = paper_tables([scored("net", 0.2, "-sv")])
    assert (same.title, cross.title) == ("same viewing angles", "cross viewing angles")
    assert same.pairs == cross.pairs == 4
    assert (same.rows[0].iou["bench"], cross.rows[0].iou["bench"]) == pytest.approx((0.25, 0.35))
    for found, iou in ((same, (0.580, 0.581)), (cross, (0.531, 0.540))):
        assert [of.iou["bench"] for of in found.rows if of.method == "3D-RecGAN++"] == [*iou]
    (imported,) = paper_tables([scored("net", 0.2, "-125")])
    assert imported.title == "same viewing angles" and len(imported.rows) == 15


def test_what_is_no_such_table_is_told() -> None:
    only_known = table("net", [row("chair", 0, 0, 0.5)])
    with raises(SettingsError, "settings.other-scores", match="'paper'"):
        paper_tables([only_known])
    with raises(SettingsError, "settings.other-scores", match="scored; score"):
        paper_tables([scored("net", 0.2).model_copy(update={"complete": False})])
    lacking = scored("net", 0.2)
    rows = (replace(lacking.rows[0], ce=None), *lacking.rows[1:])
    with raises(SettingsError, "settings.other-scores", match="scored; score"):
        paper_tables([lacking.model_copy(update={"rows": rows})])


def test_the_command_prints_it_or_writes_it(
    command: Command, release: Release, scores: Path, tmp_path: Path
) -> None:
    """With the baselines that lie beside the scores; nothing is built, no page is written."""
    words = ("report", "--paper-table", "--benchmark", str(release.folder), "--scores", str(scores))
    printed = command(tmp_path, *words)
    assert printed.status == 0 and printed.out.startswith("**all pairs**: "), printed
    assert "\n| mine | " in printed.out and "\n| hull (baseline) | " in printed.out
    alone = command(tmp_path, *words, "--no-baselines")
    assert "| mine |" in alone.out and "| hull" not in alone.out
    (found,) = json.loads(command(tmp_path, *words, "--json").out)
    assert found["rows"][0].keys() == {"method", "published", "iou", "ce", "baseline"}
    assert {row["method"]: row["baseline"] for row in found["rows"] if not row["published"]}["hull"] is True
    assert list(tmp_path.iterdir()) == []
    assert command(tmp_path, *words, "--out", "table.md").status == 0
    assert (tmp_path / "table.md").read_text() == printed.out
    refused = command(tmp_path, *words, "chair_01")
    assert refused.status == 2 and "is of score files, not of recordings" in refused.err
    nothing = command(tmp_path, "report", "--paper-table", "--benchmark", str(release.folder))
    assert nothing.status == 2 and "scores: no such file or folder" in nothing.err
