"""Tables, charts and merged score files: against numbers by hand."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from raising import raises
from report_fake_build import parsed_tables, score

from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.errors import SettingsError, StorageError
from kinectbench.report import charts, tables
from kinectbench.report.page import Groups
from kinectbench.report.run import files_in, files_named, grouped, kept_baselines
from kinectbench.scoring.compare import method_names
from kinectbench.scoring.counts import THRESHOLDS


def made(
    method: str, iou: float | None, ce: float | None, interval: list[float] | None = None
) -> dict[str, Any]:
    chair = {"iou": iou, "ce": ce, "base_rate_ce": 0.26, "intervals": {"iou": interval, "ce": None}}
    return {"method": method, "by_category": {"known": {"chair": chair}}, "overall": {"known": chair}}


def rows(method: str, ious: dict[str, float], occluded: dict[str, float] | None = None) -> dict[str, Any]:
    """Pairs `chair_<n>/000`; coverage of `known` is 0.8, of `occluded` as given."""

    def row(name: str, protocol: str, iou: float, coverage: float) -> dict[str, Any]:
        recording, view = name.split("/")
        return {"recording": recording, "view": view, "object": recording, "category": "chair",
                "protocol": protocol, "threshold": 0.5, "iou": iou, "coverage_shape": coverage}  # fmt: skip

    listed = [row(name, "known", iou, 0.8) for name, iou in ious.items()]
    listed += [row(name, "occluded", 0.9, coverage) for name, coverage in (occluded or {}).items()]
    return {"method": method, "rows": listed}


def test_a_zero_has_no_sign() -> None:
    assert [tables.shown_figure(value) for value in (-0.0001, -0.0, -0.0006)] == ["0.000", "0.000", "-0.001"]


def test_best_of_a_column_is_marked_by_what_is_shown() -> None:
    parsed = parsed_tables([made("a", 0.41001, 12.5), made("c", None, None), made("b", 0.40999, 2.25)])
    table = tables.protocol_table(parsed, "known")
    assert table.categories == ("overall", "chair")
    assert [row.method for row in table.rows] == ["a", "b", "c"]
    assert [(row.iou[0].text, row.iou[0].best) for row in table.rows] == [
        ("0.410", True),
        ("0.410", True),
        ("–", False),
    ]
    assert [(row.ce[1].text, row.ce[1].best) for row in table.rows] == [
        ("12.500", False),
        ("2.250", True),
        ("–", False),
    ]
    assert table.base_rate == ("0.260", "0.260") and not table.grouped


def test_what_every_baseline_is_marked_with_stands_above_the_table() -> None:
    fixed = {"thresholds": {"chair": 0.5}, "threshold_source_by_category": {"chair": "fixed"}}
    names = ("net", "hull", "partial")
    parsed = parsed_tables([made(name, 0.4, 1.0) | (fixed if name != "net" else {}) for name in names])
    parsed = [t if t.method == "net" else t.model_copy(update={"baseline": True}) for t in parsed]
    table = tables.protocol_table(parsed, "known")
    assert len(table.shared) == 1 and len(table.of_baselines) == 1 and "fixed" in table.of_baselines[0]
    assert {row.method: row.marks for row in table.rows} == {
        "net": (),
        "hull": ("baseline",),
        "partial": ("baseline",),
    }


def test_a_first_click_sorts_the_best_first() -> None:
    """Of IoU and other shares the highest; of cross-entropy and lengths the lowest."""
    assert {"IoU", "precision", "surface Dice"} <= tables.MORE_IS_BETTER <= {*tables.DETAILS}
    assert not {"CE", "Chamfer, mm", "pairs"} & tables.MORE_IS_BETTER


def test_intervals_and_groups() -> None:
    parsed = parsed_tables([made("a", 0.5, 1.0, [0.25, 0.7504]), made("b", 0.4, 1.0), made("c", 0.1, 1.0)])
    table = tables.protocol_table(parsed, "known", {"a": "a", "b": "ab", "c": "b"})
    assert [row.group for row in table.rows] == ["a", "ab", "b"] and table.grouped
    assert [row.iou[0].interval for row in table.rows] == ["0.250–0.750", "", ""]


def test_published_table_marks_the_papers_best() -> None:
    table = tables.published_table()
    assert table.categories == ("bench", "chair", "couch", "table")
    first = table.rows[0]
    assert [cell.text for cell in first.iou] == ["0.177", "0.208", "0.540", "0.156"]
    assert all(cell.best for cell in first.iou)
    assert [cell.text for cell in table.rows[1].ce] == ["0.065", "0.156", "0.318", "0.180"]
    assert table.base_rate == () and table.note == "published, not comparable"


def test_methods_of_one_name_are_told_apart() -> None:
    parsed = parsed_tables([made("net", 0.5, 1.0), made("net", 0.4, 1.0), made("hull", 0.1, 1.0)])
    assert method_names(parsed) == ("net", "net #2", "hull")


@pytest.mark.parametrize("value", ["NaN", "Infinity", "1e999"])
def test_numbers_that_are_none_are_refused(value: str) -> None:
    text = json.dumps(made("a", 0.125, 1.0)).replace("0.125", value)
    with raises(StorageError, "storage.damaged", match="is not JSON|'by_category.known.chair.iou'"):
        ScoreTable.parse(text, "scores.json")


def test_bars_by_hand() -> None:
    parsed = parsed_tables([made("a", 0.5, 1.0, [0.25, 0.78]), made("b", 0.2, 1.0), made("c", None, 1.0)])
    groups = charts.iou_bars(parsed, "known")
    assert list(groups) == ["chair"]
    bars = groups["chair"]
    assert [(bar.method, bar.text) for bar in bars] == [("a", "0.500"), ("b", "0.200")]
    # The axis ends at 0.8, the tenth above the highest interval.
    assert bars[0].length == pytest.approx(62.5)
    assert bars[0].interval == pytest.approx((31.25, 66.25))
    assert bars[1].interval is None


@pytest.mark.parametrize(
    ("value", "top"), [(0.0, 0.1), (0.1, 0.1), (0.11, 0.2), (0.3, 0.3), (0.99, 1.0), (1.5, 1.0)]
)
def test_the_end_of_an_axis(value: float, top: float) -> None:
    assert charts.nice_top(value) == pytest.approx(top)


def svg(chart: charts.Chart) -> ElementTree.Element:
    return ElementTree.fromstring(str(chart.svg))


def test_curves_go_through_their_points() -> None:
    curve = np.linspace(0.9, 0.1, 17).tolist()
    table = made("a", 0.5, 1.0) | {"thresholds": {"chair": 0.4}}
    table["iou_by_threshold"] = {"known": {"chair": curve, "odd": [0.1, 0.2]}}
    (chart,) = charts.threshold_charts(parsed_tables([table]), "known")
    assert chart.title == "chair"
    drawn = svg(chart)
    line = next(e for e in drawn.iter("path") if e.get("class") == "line")
    points = np.array(re.findall(r"[-\d.]+", line.get("d") or ""), float).reshape(-1, 2)
    left, right = charts.LEFT, charts.WIDTH - charts.RIGHT
    bottom, top = charts.HEIGHT - charts.BOTTOM, charts.TOP
    across = (np.array(THRESHOLDS) - 0.1) / 0.8
    np.testing.assert_allclose(points[:, 0], left + across * (right - left), atol=0.06)
    np.testing.assert_allclose(points[:, 1], bottom - np.array(curve) / 0.9 * (bottom - top), atol=0.06)
    dot = next(drawn.iter("circle"))
    used = points[THRESHOLDS.index(0.4)]
    assert [float(dot.get("cx") or 0), float(dot.get("cy") or 0)] == used.tolist()


def test_visible_shares_by_hand() -> None:
    table = rows("a", {"chair_1/000": 0.3, "chair_2/000": 0.2}, {"chair_1/000": 0.6, "chair_3/000": 0.1})
    (parsed,) = parsed_tables([table])
    # 0.2 of the shape's 0.8 that are known are not among the occluded.
    assert charts.visible_shares(parsed) == pytest.approx({"chair_1/000": 0.25})
    (chart,) = charts.visible_charts([parsed], "known")
    dots = next(e for e in svg(chart).iter("path") if e.get("class") == "dots")
    assert (dots.get("d") or "").count("M") == 1
    without = parsed_tables([rows("a", {"chair_1/000": 0.3})])
    assert charts.visible_charts(without, "known") == ()


def test_many_methods_have_their_own_style() -> None:
    styles = [charts.series_class(index) for index in range(24)]
    assert len(set(styles)) == 24


def test_best_and_worst_pairs() -> None:
    ious = {f"chair_{n}/000": n / 10 for n in (3, 1, 4, 5, 9, 2, 6)}
    found = tables.best_and_worst(parsed_tables([rows("a", ious), {"method": "b"}]), "known")
    assert list(found) == ["a"]
    assert [(pair.recording, pair.view, pair.iou) for pair in found["a"].best] == [
        ("chair_9", "000", 0.9),
        ("chair_6", "000", 0.6),
        ("chair_5", "000", 0.5),
    ]
    assert [pair.recording for pair in found["a"].worst] == ["chair_1", "chair_2", "chair_3"]


def put(folder: Path, name: str, sha256: str = "ab" * 32, **more: object) -> Path:
    (folder / name).mkdir(parents=True)
    path = folder / name / "scores.json"
    no_rows = {"by_category": None, "overall": None}  # averages without rows are refused
    path.write_text(json.dumps(score(name, 0.4) | no_rows | {"benchmark_sha256": sha256} | more))
    return path


def test_named_files_are_of_one_truth(tmp_path: Path) -> None:
    first, other = put(tmp_path / "ours", "net"), put(tmp_path / "theirs", "net", "cd" * 32)
    second = put(tmp_path / "ours", "hull")
    files = files_named([tmp_path / "ours", first, first.parent], "ab" * 32)
    assert [file.path for file in files] == [second, first]
    with raises(SettingsError, "settings.other-scores", match="cdcdcdcdcdcd.*abab") as caught:
        files_named([first, other], "ab" * 32)
    assert "\n" not in str(caught.value) and str(caught.value).startswith(str(other))
    with raises(SettingsError, "settings.other-scores", match="abab"):
        files_named([first, other], None)
    found, warnings = files_in(tmp_path / "theirs", "ab" * 32)
    assert found == [] and len(warnings) == 1


def test_scores_of_an_older_version_are_left_out_or_refused(tmp_path: Path) -> None:
    scores = tmp_path / "scores"
    unknown = put(scores, "a")
    first, second = (put(scores, f"b{version}", settings={"score_version": version}) for version in (1, 2))
    other = put(scores, "c", "cd" * 32, settings={"score_version": 3})
    for version in (1, 2):
        settings = {"score_version": version}
        put(scores / "baselines", f"hull{version}", settings=settings, baseline=True)
    files, warnings = files_in(scores, "ab" * 32)
    assert [file.path for file in files] == [second]
    assert warnings == [
        f"{other}: scores of another benchmark, left out of the page; score again",
        f"{unknown}: scores of an older version, left out of the page; score again",
        f"{first}: scores of an older version, left out of the page; score again",
    ]
    assert [file.table.method for file in kept_baselines(files)] == ["hull2"]
    with raises(SettingsError, "settings.other-scores", match=r"b1/scores\.json.*1.*2"):
        files_named([second, first], None)
    assert [file.path for file in files_named([first, unknown], None)] == [first, unknown]


@pytest.mark.parametrize("content", [b"{", b"[]", b'{"method": "a", "x": NaN}', b"\xff"])
def test_damaged_files_are_one_line(tmp_path: Path, content: bytes) -> None:
    path = put(tmp_path, "net")
    path.write_bytes(content)
    with raises(StorageError, "storage.damaged", match=re.escape(str(path))) as caught:
        files_named([path], "ab" * 32)
    assert "\n" not in str(caught.value)


def ranked_file(folder: Path, name: str, gain: float, objects: int = 8) -> Path:
    """A whole scores.json: one view of each object."""

    def row(thing: int) -> dict[str, Any]:
        iou = 0.4 + gain + (thing % 3) / 100
        return {"recording": f"c{thing}", "object": f"c{thing}", "view": "000", "category": "chair",
                "protocol": "known", "threshold": 0.5, "iou": iou, "ce": 0.1, "precision": 0.5, "recall": 0.5,
                "f1": 0.5, "base_rate_ce": 0.3, "coverage_voxels": 1.0, "coverage_shape": 1.0}  # fmt: skip

    path = put(folder, name)
    content = json.loads(path.read_text()) | {"complete": True, "base_rate": {}, "truth_quality": {}}
    path.write_text(json.dumps(content | {"rows": [row(thing) for thing in range(objects)]}))
    return path


def read(paths: list[Path]) -> list[ScoreTable]:
    return [ScoreTable.read_file(path) for path in paths]


def test_letters_join_what_cannot_be_told_apart(tmp_path: Path) -> None:
    paths = [
        ranked_file(tmp_path, name, gain) for name, gain in (("low", 0.0), ("top", 0.2), ("as-top", 0.2))
    ]
    paths.insert(1, put(tmp_path, "older"))  # has no rows to test
    found = grouped(read(paths), ("known", "occluded"))
    assert found.letters == {"known": {0: "b", 2: "a", 3: "a"}} and found.too_small == ""
    assert any("occluded" in note for note in found.notes)
    assert grouped(read(paths[:2]), ("known",)) == Groups()
    camera = []
    for table in read(paths[2:]):
        in_space = tuple(replace(row, protocol="camera", part="whole") for row in table.rows)
        camera.append(table.model_copy(update={"rows": in_space}))
    # A method of another protocol takes no letters from the others, and has its own.
    both = grouped([*read(paths), *camera], ("known", "camera"))
    assert both.letters == {"known": {0: "b", 2: "a", 3: "a"}, "camera": {4: "a", 5: "a"}}
    alone = grouped([*read(paths), camera[0]], ("known", "camera"))
    assert alone.letters == found.letters and any("under camera" in note for note in alone.notes)
    many = [ranked_file(tmp_path, name, gain, objects=45) for name, gain in (("many", 0.1), ("more", 0.2))]
    found = grouped(read(many), ("known",))
    assert found.letters == {"known": {0: "b", 1: "a"}}
    assert any("1,000,000 sign flips drawn" in note for note in found.notes)
