"""Where thresholds come from."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from raising import raises

from kinectbench.core.artefacts.counted import Tally
from kinectbench.core.errors import SettingsError
from kinectbench.release.release import Target
from kinectbench.scoring.counts import THRESHOLDS
from kinectbench.scoring.thresholds import best_threshold, read_thresholds, searched_thresholds


def tally_of(hit: list[int], predicted: list[int], occupied: int) -> Tally:
    """A tally whose known, seen voxels (codes 6 and 7) have these counts per threshold."""
    above = np.zeros((17, 8), np.int64)
    above[:, 7] = hit
    above[:, 6] = np.array(predicted) - hit
    voxels = np.array([0, 0, 0, 0, 0, 0, 1000, occupied])
    return Tally(voxels, above, np.zeros(8))


# IoU 10/20 up to 0.4, 10/15 for 0.45 to 0.6, then 10/40
MIDDLE = tally_of([10] * 17, [20] * 7 + [15] * 4 + [40] * 6, 10)
# IoU 1/100 at first, 99/100 from 0.7 on
LATE = tally_of([1] * 12 + [99] * 5, [1] * 12 + [99] * 5, 100)


def target(recording: str, category: str, split: str = "validation") -> Target:
    return Target(recording, recording, "000", category, split, "", "")


def test_best_is_the_highest_mean_pair_iou_and_ties_go_down() -> None:
    assert best_threshold([MIDDLE]) == 0.45
    assert best_threshold([LATE]) == 0.7
    assert best_threshold([MIDDLE, LATE]) == 0.7


def test_mean_over_pairs_not_over_voxels() -> None:
    assert best_threshold([MIDDLE] * 2 + [LATE]) == 0.7  # 2 x 0.25 + 0.99 against 2 x 2/3 + 0.01
    # 3 x 0.25 + 0.99 against 3 x 2/3 + 0.01; all voxels together would say 129/220 against 31/145
    assert best_threshold([MIDDLE] * 3 + [LATE]) == 0.45


def test_search_by_category() -> None:
    tallies = {target("a", "chair"): MIDDLE, target("b", "table"): LATE}
    tested = [target("c", category, "test") for category in ("table", "lamp", "chair")]
    found = searched_thresholds([*tested, *tallies], tallies)
    assert found.of == {"chair": 0.45, "lamp": 0.7, "table": 0.7}  # as of MIDDLE and LATE together
    assert found.source == "validation" and found.sources["lamp"] == "pooled"
    assert found.objects == ("a", "b")
    assert found.warnings == (
        "threshold of lamp is 0.7, which all validation predictions give together: no validation prediction "
        "of it",
    )


def test_a_methods_own_threshold_wins_where_there_is_no_validation() -> None:
    """Over the pooled one and 0.5, not over what was searched."""
    tallies = {target("a", "chair"): MIDDLE}
    tested = [target("c", category, "test") for category in ("table", "lamp", "chair")]
    found = searched_thresholds([*tested, *tallies], tallies, 0.25)
    assert found.of == {"chair": 0.45, "lamp": 0.25, "table": 0.25}
    assert found.sources == {"chair": "validation", "lamp": "method", "table": "method"}
    assert (found.source, found.objects) == ("validation", None)
    assert found.warnings == (
        "threshold of lamp, table is the method's own, 0.25: no validation prediction of it",
    )
    alone = searched_thresholds(tested, {}, 0.25)
    assert (set(alone.of.values()), alone.source, alone.objects) == ({0.25}, "method", None)
    assert "threshold is the method's own, 0.25: the benchmark has no validation split" in alone.warnings[0]


def test_validation_of_other_categories_alone_is_pooled() -> None:
    tallies = {target("a", "sofa"): LATE}
    found = searched_thresholds([target("c", "lamp", "test"), *tallies], tallies)
    assert (found.of, found.source, found.objects) == ({"lamp": 0.7}, "pooled", ("a",))


@pytest.mark.parametrize(
    ("has", "why"), [(True, "no prediction for the"), (False, "has no validation split")]
)
def test_fixed(has: bool, why: str) -> None:
    validation = [target("b", "chair")] if has else []
    found = searched_thresholds([target("a", "chair", "test"), *validation], {})
    assert (found.of, found.source) == ({"chair": 0.5}, "fixed")
    assert len(found.warnings) == 1 and why in found.warnings[0]


def write(path: Path, content: object) -> Path:
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def test_threshold_file(tmp_path: Path) -> None:
    path = write(
        tmp_path / "t.json", {"thresholds": {"chair": 0.30000000000000004, "x": 9}, "objects": ["o"]}
    )
    found = read_thresholds(path, ["chair"], frozenset({"red"}))
    assert found.of["chair"] in THRESHOLDS and found.of["chair"] == 6 / 20
    assert found.source == f"file:{hashlib.sha256(path.read_bytes()).hexdigest()}"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([], "a threshold file is"),
        ({"thresholds": {"table": 0.5}}, "no threshold for chair; add it"),
        ({"thresholds": {"chair": 0.95}}, "threshold of chair is 0.95: it must be one of 0.1"),
        ({"thresholds": {"chair": 0.05}}, "must be one of"),
        ({"thresholds": {"chair": 0.33}}, "must be one of"),
        ({"thresholds": {"chair": True}}, "'thresholds.chair': Input should be a valid number"),
        ({"thresholds": {"chair": "0.5"}}, "'thresholds.chair': Input should be a valid number"),
        ({"thresholds": {"chair": 1e300}}, "must be one of"),
        ({"thresholds": {"chair": -1.7e308}}, "must be one of"),
        ({"thresholds": {"chair": 0.5}, "objects": "red"}, "'objects': Input should be a valid array"),
        ({"thresholds": {"chair": 0.5}, "objects": ["red"]}, r"on objects of the test split \(red\)"),
        ({"thresholds": {"chair": 0.5}, "objects": ["a", " RED"]}, r"on objects of the test split \( RED\)"),
    ],
)
def test_bad_threshold_files(content: object, message: str, tmp_path: Path) -> None:
    with raises(SettingsError, "settings.bad-thresholds", match=message):
        read_thresholds(write(tmp_path / "t.json", content), ["chair"], frozenset({"red"}))


@pytest.mark.parametrize(
    "text",
    [
        b"{",
        b"\xff\xfe",
        b'{"thresholds": {"chair": NaN}}',
        b"[" * 100_000,
        b'{"thresholds": {"chair": 0.5, "chair": 0.1}}',
    ],
)
def test_malformed_threshold_files(text: bytes, tmp_path: Path) -> None:
    (tmp_path / "t.json").write_bytes(text)
    with raises(SettingsError, "settings.bad-thresholds", match=r"t\.json"):
        read_thresholds(tmp_path / "t.json", ["chair"], frozenset())
    with raises(SettingsError, "settings.bad-thresholds", match=r"file \(not"):
        read_thresholds(tmp_path, ["chair"], frozenset())
    with raises(SettingsError, "settings.no-file"):
        read_thresholds(tmp_path / "none.json", ["chair"], frozenset())
