"""Pairs of which little or nothing is known, made by hand: what is left out, counted and shown."""

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from docs_schemas import LATER, scores_schema
from numpy.typing import NDArray
from raising import raises
from references import shell_of
from rich.console import Console
from synthetic_release import Recordings, synthetic_pair, synthetic_settings, write_build

from kinectbench.cli.score_tables import comparison_tables, score_table
from kinectbench.core.artefacts.counted import Tally
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.errors import SettingsError
from kinectbench.core.voxels.pair_file import pack, pair_bytes
from kinectbench.release.publish.publish import publish
from kinectbench.release.release import Release, open_release
from kinectbench.report import tables as report_tables
from kinectbench.report.page import write_report
from kinectbench.scoring.compare import compare
from kinectbench.scoring.counts import is_all_unknown, tally_unknown_share
from kinectbench.scoring.release_contradictions import release_contradictions
from kinectbench.scoring.score import score

Bools = NDArray[np.bool_]
RECORDINGS: Recordings = (
    ("chair_01", "chair", "red_chair", "test", 2),
    ("chair_02", "chair", "blue_chair", "test", 1),
    ("table_01", "table", "old_table", "test", 1),
)
BOX = np.zeros((256,) * 3, bool)
BOX[64:192, 64:192, 64:192] = True
NONE, ALL = np.zeros_like(BOX), np.ones_like(BOX)
LEFT = np.arange(256)[:, None, None] + np.zeros_like(BOX, int) < 128  # half of the box
LINE = "known: 2 of 4 pairs are left out: nothing of the true shape is known there"
# known and seen of each pair; the shape is the box.
TRUST: dict[str, tuple[Bools, Bools]] = {
    "chair_01/000": (NONE, NONE),  # nothing is known at all
    "chair_01/001": (LEFT, NONE),  # half of the box is
    "chair_02/000": (~BOX, NONE),  # all around it is, but nothing of it
    "table_01/000": (ALL, ALL),  # all is, and the view sees all
}


def make_release(root: Path, recordings: Recordings) -> Release:
    write_build(root / "build", recordings)
    for name, (known, seen) in TRUST.items():
        recording, view = name.split("/")
        path = root / "build" / recording / "pairs" / f"{view}.npz"
        if path.is_file():
            full = pack(BOX)
            pair = replace(synthetic_pair(0, "chair"), full=full, shell=shell_of(BOX))
            path.write_bytes(pair_bytes(replace(pair, known=pack(known), seen=pack(seen))))
    names = [recording[0] for recording in recordings]
    return open_release(
        publish(synthetic_settings(recordings), root / "build", root / "benchmark", names).folder
    )


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Release:
    return make_release(tmp_path_factory.mktemp("unknown"), RECORDINGS)


def made(release: Release, folder: Path, method: str, unknown: Bools) -> ScoreTable:
    """A quarter of the box for the half-known pair, the table's box, and `unknown` for all else."""
    for target in release.targets:
        prediction = {"chair_01/001": BOX & (np.arange(256) < 96)[:, None, None], "table_01/000": BOX}
        path = folder / method / target.recording / f"{target.view}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, prediction.get(target.name, unknown))
    return score(release, folder / method, method=method)


@pytest.fixture(scope="module")
def tables(release: Release, tmp_path_factory: pytest.TempPathFactory) -> tuple[ScoreTable, ScoreTable]:
    """Two methods that differ only where nothing of the shape is known."""
    folder = tmp_path_factory.mktemp("methods")
    return made(release, folder, "timid", NONE), made(release, folder, "bold", ALL)


CODES = {
    "nothing is known": ({0: 9, 1: 5}, True, True),
    "nothing of the shape is": ({1: 5, 2: 9}, True, True),
    "one voxel of it is": ({1: 5, 2: 9, 3: 1}, False, False),
    "what is hidden of it is not": ({1: 5, 2: 9, 7: 1}, False, True),
    "nothing of it is hidden, which is known": ({2: 9, 7: 5}, False, False),
    "nothing at all is hidden": ({6: 9, 7: 5}, False, True),
    "there is no shape, which is known": ({2: 9}, False, False),
}


@pytest.mark.parametrize("name", list(CODES))
def test_what_is_all_unknown(name: str) -> None:
    counts, under_known, under_occluded = CODES[name]
    voxels = np.zeros(8, np.int64)
    voxels[[*counts]] = [*counts.values()]
    tally = Tally(voxels, np.zeros((17, 8), np.int64), np.zeros(8))
    found = [is_all_unknown(tally, protocol) for protocol in ("paper", "known", "occluded")]
    assert found == [False, under_known, under_occluded]
    shape = sum(counts.get(code, 0) for code in (1, 3, 5, 7))
    expected = sum(counts.get(code, 0) for code in (1, 5)) / shape if shape else 0
    assert tally_unknown_share(tally) == expected


def test_rows_say_how_much_is_unknown(tables: tuple[ScoreTable, ScoreTable]) -> None:
    for table in tables:
        for row in table.rows:
            share = {"chair_01/001": 0.5, "table_01/000": 0.0}.get(row.pair, 1.0)
            assert row.unknown_share == share
            left_out = row.pair in table.all_unknown_pairs[row.protocol]
            figures = (row.iou, row.ce, row.f1, row.chamfer_mm, row.base_rate_ce)
            assert [figure is None for figure in figures] == [left_out] * 5
        assert table.all_unknown_pairs == {
            "paper": (),
            "known": ("chair_01/000", "chair_02/000"),
            "occluded": ("chair_01/000", "chair_02/000", "table_01/000"),
        }
        assert table.truth_unknown_share == {"blue_chair": 1.0, "old_table": 0.0, "red_chair": 0.75}


def test_what_is_declared_unknown_is_held_against_the_release(
    release: Release, tables: tuple[ScoreTable, ScoreTable]
) -> None:
    """Of half of the pair's shape the truth is known: a table may not leave it out."""
    table = tables[0]
    assert list(release_contradictions(table, release)) == []
    for change, words in (
        ({"iou": None}, "is left out under known as all unknown; the release says 0.5 of its shape"),
        ({"iou": None, "unknown_share": 1.0}, "has 1 of its true shape unknown; the release says 0.5"),
    ):
        rows = tuple(
            replace(row, **change) if (row.pair, row.protocol) == ("chair_01/001", "known") else row
            for row in table.rows
        )
        forged = table.model_copy(update={"rows": rows})
        assert list(release_contradictions(forged, release)) == [f"chair_01/001 {words}"]


def test_means_leave_out_what_is_all_unknown(tables: tuple[ScoreTable, ScoreTable]) -> None:
    """Of the half that is known a half is predicted: IoU .5, and 1 of the table, whatever else there is."""
    for table in tables:
        assert table.by_category is not None and table.overall is not None
        chair, board = table.by_category["known"]["chair"], table.by_category["known"]["table"]
        assert (chair.iou, chair.pairs, chair.objects, chair.truth_unknown_share) == (0.5, 1, 1, 0.875)
        assert (board.iou, board.pairs, board.objects, board.truth_unknown_share) == (1.0, 1, 1, 0.0)
        known = table.overall["known"]
        assert (known.iou, known.pairs, known.objects, known.categories) == (0.75, 2, 2, 2)
        assert known.truth_unknown_share == 0.4375
        hidden = table.by_category["occluded"]["table"]
        assert (hidden.iou, hidden.pairs, hidden.objects, hidden.truth_unknown_share) == (None, None, None, 0)
        assert (table.overall["occluded"].iou, table.overall["occluded"].categories) == (0.5, 1)
        assert table.by_category["paper"]["chair"].pairs == 3
        best = [(f"{pair.recording}/{pair.view}", pair.iou) for pair in table.extremes["known"].best]
        assert best == [("table_01/000", 1.0), ("chair_01/001", 0.5)]
        assert table.iou_by_threshold is not None
        assert table.iou_by_threshold["known"] == {"chair": [0.5] * 17, "table": [1.0] * 17}
        assert set(table.iou_by_threshold["occluded"]) == {"chair"}
    timid, bold = (table.by_category["paper"]["chair"].iou for table in tables)  # type: ignore[index]
    assert timid != bold


def test_comparisons_leave_it_out(tables: tuple[ScoreTable, ScoreTable]) -> None:
    found = compare(tables)
    assert found.means["all"] == {"timid": 0.75, "bold": 0.75}
    assert set(found.differences[-1].by_object) == {"red_chair", "old_table"}
    assert found.truth_unknown_share == {"chair": 0.875, "table": 0.0, "all": 0.4375}
    assert found.unknown_by_object["blue_chair"] == 1
    assert LINE in found.notes


def test_what_people_see(tables: tuple[ScoreTable, ScoreTable], tmp_path: Path) -> None:
    with (tmp_path / "out").open("w") as file:
        console = Console(width=200, record=True, file=file)
        console.print(score_table(tables, published=True))
        for shown in comparison_tables(compare(tables)):
            console.print(shown)
    text = console.export_text()
    assert LINE in text and "occluded: 3 of 4 pairs are left out" in text and "paper: " not in text
    rows = [row.split() for row in text.splitlines() if "truth unknown " in row]
    assert " ".join(text.split()).count("nobody saw, a guess; unseen") == 2
    assert [[cell for cell in row if "." in cell] for row in rows] == [
        ["87.5", "0.0", "43.8"] * 2,  # under `known` and `paper`
        ["87.5", "0.0", "43.8"],
    ]
    table = report_tables.protocol_table(tables, "known")
    assert table.categories == ("overall", "chair", "table")
    assert (table.unknown, table.left_out) == (("43.8 %", "87.5 %", "0.0 %"), LINE)
    assert report_tables.truth_of_objects(tables, "known") == (
        ("blue_chair", "chair", 1, "100.0 %", 1),
        ("red_chair", "chair", 2, "75.0 %", 1),
        ("old_table", "table", 1, "0.0 %", 0),
    )
    # An open mesh has no IoU, but metrics of its surface: it is not left out.
    surfaces = tuple(replace(row, iou=None, chamfer_l1_m=0.01) for row in tables[0].rows)
    of_surfaces = report_tables.truth_of_objects([tables[0].model_copy(update={"rows": surfaces})], "known")
    assert [left for *_, left in of_surfaces] == [0, 0, 0]
    # A method of which a prediction failed has fewer pairs than the object.
    rows_left = tuple(row for row in tables[0].rows if row.pair != "chair_01/000")
    broken = tables[0].model_copy(
        update={"rows": rows_left, "truth_unknown_share": {**tables[0].truth_unknown_share, "red_chair": 0.5}}
    )
    several = report_tables.truth_of_objects((broken, tables[1]), "known")
    assert several == report_tables.truth_of_objects(tables, "known")
    page = write_report(synthetic_settings(RECORDINGS), None, tables, tmp_path / "index.html").read_text()
    assert page.count(f'<p class="note">{LINE}</p>') == 1 and ">75.0 %</td>" in page


def test_the_file(tables: tuple[ScoreTable, ScoreTable], tmp_path: Path) -> None:
    content = json.loads(tables[0].text())
    jsonschema.validate(content, scores_schema())
    assert ScoreTable.parse(tables[0].text(), "scores.json") == tables[0]
    for key in ("truth_unknown_share", "all_unknown_pairs"):  # older files stay readable
        assert key in LATER
        del content[key]
    for row in content["rows"]:
        assert row.pop("unknown_share") is not None
    jsonschema.validate(content, scores_schema())
    older = ScoreTable.parse(json.dumps(content), "scores.json")
    assert older.rows[0].unknown_share is None and older.left_out_line("known") == ""


def test_where_nothing_is_left(tmp_path: Path) -> None:
    release = make_release(tmp_path, RECORDINGS[1:2])
    table = made(release, tmp_path, "bold", ALL)
    assert table.complete and table.overall is not None
    assert (table.overall["known"].iou, table.overall["known"].pairs) == (None, None)
    assert table.overall["known"].truth_unknown_share == 1 and table.overall["paper"].iou == 0.125
    jsonschema.validate(json.loads(table.text()), scores_schema())
    line = "known: 1 of 1 pairs is left out: nothing of the true shape is known there; there is nothing to"
    with raises(SettingsError, "settings.other-scores", match=line):
        compare([table, table])
    assert write_report(synthetic_settings(), None, [table], tmp_path / "page.html").is_file()
