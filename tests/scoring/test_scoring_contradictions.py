"""Forged tables: what cannot be true of any predictions is refused on reading, what is not of the release is
kept off its page, and what is forged consistently stays *reported* and is found by a recheck.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from raising import raises
from test_scoring_believed import as_if_from_a_file, changed, older, write

import kinectbench
from kinectbench.core.artefacts.score_figures import VOXEL_METRICS
from kinectbench.core.errors import KinectBenchError, PredictionError, SettingsError, StorageError
from kinectbench.release.release import Release
from kinectbench.report.run import page_of_release
from kinectbench.scoring.compare import compare
from kinectbench.scoring.counts import THRESHOLDS
from kinectbench.scoring.read_table import read_table
from kinectbench.scoring.recheck import recheck
from kinectbench.scoring.score import score_methods

Content = dict[str, Any]
Edit = Callable[[Content], object]
DERIVED = ("by_category", "overall", "extremes", "iou_by_threshold", "all_unknown_pairs", "marks", "notes")


@pytest.fixture(scope="module")
def net(release: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Predictions, and what was scored of them."""
    root = tmp_path_factory.mktemp("forged")
    write(release, root / "net")
    score_methods(release, root / "net", root / "scores", surface=False)
    return root


def underived(edit: Edit) -> Edit:
    """The edit of a forger who leaves all to be computed that follows from rows."""

    def both(of: Content) -> None:
        for key in (*DERIVED, "truth_unknown_share"):
            of.pop(key, None)
        edit(of)

    return both


def every(**values: Any) -> Edit:
    return underived(lambda of: [row.update(values) for row in of["rows"]])


def first(**values: Any) -> Edit:
    return underived(lambda of: of["rows"][0].update(values))


def own_threshold(of: Content) -> None:
    """The best threshold of each row, by its own curve, and the table says nothing of thresholds."""
    of["thresholds"] = {}
    for row in of["rows"]:
        iou = max(row["iou_by_threshold"])
        row.update(iou=iou, threshold=THRESHOLDS[row["iou_by_threshold"].index(iou)], f1=2 * iou / (1 + iou))
        row.update(precision=iou, recall=1.0)


def better(of: Content) -> None:
    """Every figure of a row follows from a better IoU."""
    for row in of["rows"]:
        row["iou_by_threshold"] = [min(1.0, iou + 0.3) for iou in row["iou_by_threshold"]]
        iou = row["iou_by_threshold"][THRESHOLDS.index(row["threshold"])]
        row.update(iou=iou, f1=2 * iou / (1 + iou), precision=iou, recall=1.0)


def without(recording: str) -> Edit:
    """A recording less, wherever it stands."""

    def cut(of: Content) -> None:
        of["rows"] = [row for row in of["rows"] if row["recording"] != recording]
        of["hashes"] = {k: v for k, v in of["hashes"].items() if not k.startswith(f"{recording}/")}
        of["truth_quality"].pop(recording, None)

    return underived(cut)


REFUSED: dict[str, tuple[Edit, str]] = {
    "an empty curve": (first(iou_by_threshold=[]), "iou_by_threshold' is (), but must have 17 values"),
    "a calibration of one tenth": (
        first(calibration={"error": 0.1, "cells": [1], "said": [], "true": []}), "must have 10 values"
    ),
    "a share above one": (first(iou=1.5), "'rows.0.iou' is 1.5, but must be at most 1"),
    "a loss below nothing": (every(ce=-1.0), "'rows.0.ce' is -1.0, but must be at least 0"),
    "a loss that no clipped prediction has": (every(ce=1e300), "none is above 16.1"),
    "cells without end": (every(cells=10**30), "'rows.0.cells' is 10"),
    "a coverage above one": (every(coverage_shape=7.0), "'rows.0.coverage_shape'"),
    "paper without all voxels": (every(coverage_voxels=0.5), "does not count every voxel"),
    "a view's name": (every(view="../x"), "'rows.0.view'"),
    "a way to close": (first(closed="glue"), "is 'glue', but must be one of winding, poisson"),
    "words for missing": (lambda of: of["settings"].update(missing="skip"), "one of error, empty"),
    "F1 alone": (every(f1=0.999), "states an F1 of 0.999, which no IoU of"),
    "precision alone": (every(precision=0.999), "states precision 0.999 and recall"),
    "IoU and curve alone": (every(iou=0.9, iou_by_threshold=[0.9] * 17), "which no IoU of 0.9 has"),
    "no curve": (every(iou_by_threshold=None), "has no IoU at each of the 17 thresholds"),
    "a hard pair declared unknown": (
        first(**dict.fromkeys((*VOXEL_METRICS, "iou_by_threshold"))),
        "has no figures, though it counts a part of the shape",
    ),
    "half declared unknown": (first(iou=None), "has figures, but no IoU"),
    "a threshold for each row": (underived(own_threshold), "its category"),
    "a threshold between": (first(threshold=0.123), "not one of the 17"),
    "called fixed": (
        lambda of: of.update(
            threshold_source="fixed", validation=None,
            threshold_source_by_category=dict.fromkeys(of["thresholds"], "fixed"),
        ),
        "is called fixed, but is",
    ),
    "words for a source": (lambda of: of.update(threshold_source="mine"), "'threshold_source' is 'mine'"),
    "a category's source": (
        lambda of: of["threshold_source_by_category"].update(chair="magic"),
        "those of its categories from magic",
    ),
    "own thresholds that differ": (
        lambda of: of["threshold_source_by_category"].update(chair="method", table="fixed"),
        "those of its categories from fixed, method",
    ),
    "a part of validation, and no word of it": (
        lambda of: of["hashes"].update({"a/000": dict(of["hashes"]["chair_01/000"])}), "'hashes' has",
    ),
    "more validation than there is": (
        lambda of: of["validation"].update(predicted=10**9), "cannot have been predicted",
    ),
    "no validation": (lambda of: of.update(validation=None), "but 'validation' says otherwise"),
    "thresholds of objects that are scored": (
        lambda of: of.update(threshold_objects=["red_chair"]), "found on objects that it scores (red_chair)",
    ),
    "empty, and not said": (every(cells=0), "'missing_as_empty' names other pairs"),
    "empty under one protocol": (first(cells=0), "has other cells"),
    "said to be empty": (lambda of: of.update(missing_as_empty=["chair_01/000"]), "'missing_as_empty'"),
    "rows without hashes": (lambda of: of.update(hashes={}), "'hashes' lacks pairs of its rows"),
    "rows taken away, hashes left": (
        underived(lambda of: of.update(rows=[r for r in of["rows"] if r["recording"] != "chair_01"])),
        "pairs beside its rows",
    ),
    "an object for each view": (
        underived(lambda of: [row.update(object=f"{row['object']}{row['view']}") for row in of["rows"]]),
        "is of another object or category",
    ),
    "a category that is called as the mean": (
        lambda of: of["thresholds"].update(overall=0.5), "'overall' is what the mean over all categories",
    ),
    "an object in two categories": (
        underived(lambda of: [
            row.update(object="red_chair", category="table")
            for row in of["rows"] if row["recording"] == "chair_02"
        ]),
        "object 'red_chair' is in two categories",
    ),
    "a protocol less": (
        underived(lambda of: of.update(rows=[r for r in of["rows"] if r["protocol"] != "known"])),
        "its rows are under occluded, paper, its settings name",
    ),
    "a protocol of one's own": (
        lambda of: of["settings"].update(protocols=["known", "mine"]), "settings name known, mine",
    ),
    "incomplete without a failure": (
        underived(lambda of: of.update(complete=False)), "called incomplete, but no prediction failed",
    ),
    "a version to come": (lambda of: of["settings"].update(score_version=99), "knows none after"),
    "a version below all": (
        lambda of: of["settings"].update(score_version=-1), "'settings.score_version' is -1",
    ),
    "an older version with what it lacked": (
        lambda of: of["settings"].update(score_version=3), "which score version 3 did not write",
    ),
    "no version": (lambda of: of["settings"].pop("score_version"), "which score version 1 did not write"),
    "no hash of a release": (lambda of: of.update(benchmark_sha256="zz"), "'benchmark_sha256' is 'zz'"),
    "a name with a line's end": (lambda of: of.update(method="a\nb"), "'a?b': no name for a method"),
    "a name that steers the terminal": (lambda of: of.update(method="\x1b[31m"), "no name for a method"),
}  # fmt: skip
LACKING = (
    *("complete", "benchmark_sha256", "thresholds", "threshold_source", "threshold_source_by_category"),
    *("threshold_objects", "validation", "missing_as_empty", "base_rate", "failures", "hashes"),
)
REFUSED |= {
    f"without {key}": (lambda of, key=key: of.pop(key), f"lacks '{key}', which score version")  # type: ignore[misc]
    for key in LACKING
}


@pytest.mark.parametrize("name", list(REFUSED))
def test_what_cannot_be_true_is_refused(net: Path, tmp_path: Path, name: str) -> None:
    edit, words = REFUSED[name]
    path = changed(net, tmp_path / "scores.json", edit)
    with raises(StorageError, "storage.damaged", match=r"\S*scores\.json") as caught:
        read_table(path)
    assert words in str(caught.value) and "\n" not in str(caught.value)
    assert all(character.isprintable() for character in str(caught.value))


@pytest.mark.parametrize("number", ["NaN", "Infinity", "1e999", "1" * 400, "-" + "1" * 5000])
def test_numbers_that_are_none_are_one_line(net: Path, tmp_path: Path, number: str) -> None:
    text = (net / "scores" / "scores.json").read_text()
    start = text.index('"ce": ') + len('"ce": ')
    path = tmp_path / "scores.json"
    path.write_text(text[:start] + number + text[text.index(",", start) :], encoding="utf-8")
    with pytest.raises(KinectBenchError) as caught:
        read_table(path)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


NOT_OF_THE_RELEASE: dict[str, tuple[Edit, str]] = {
    "an object dropped": (without("chair_01"), "of the 4 test pairs; chair_01/000 is not there"),
    "another truth": (
        lambda of: of["hashes"]["chair_01/000"].update(truth="0" * 64),
        "chair_01/000: scored against another truth",
    ),
    "better truth": (
        underived(lambda of: of["truth_quality"]["chair_01"].update(estimated_iou=0.999)),
        "'truth_quality.chair_01' is not what the release says",
    ),
    "another category": (
        underived(lambda of: [
            row.update(object="other") for row in of["rows"] if row["recording"] == "chair_02"
        ]),
        "chair_02/000 is of ",
    ),
    "another validation split": (lambda of: of["validation"].update(pairs=99), "states 99 validation pairs"),
}  # fmt: skip


@pytest.mark.parametrize("name", list(NOT_OF_THE_RELEASE))
def test_what_is_not_of_the_release_is_not_on_its_page(
    net: Path, release: Release, tmp_path: Path, name: str
) -> None:
    edit, words = NOT_OF_THE_RELEASE[name]
    path = changed(net, tmp_path / "scores.json", edit)
    assert read_table(path).standing == "reported"
    with pytest.raises(SettingsError) as caught:
        page_of_release(release, [path], tmp_path / "page.html")
    assert words in str(caught.value) and "\n" not in str(caught.value)
    page, warnings = page_of_release(release, tmp_path)
    assert words in warnings[0] and len(warnings) == 1
    assert "<small>reported</small>" not in page.read_text(encoding="utf-8")


SAID_OTHERWISE: dict[str, tuple[Edit, str]] = {
    "coverage": (
        underived(lambda of: [r.update(coverage_voxels=1.0) for r in of["rows"]]),
        "states other truth of chair_01/000",
    ),
    "base rate": (
        underived(lambda of: of["base_rate"]["chair"].update(value=0.9)), "other base rates than net",
    ),
    "cross-entropy of the base rate": (every(base_rate_ce=9.0), "states other truth of chair_01/000"),
    "a category": (
        underived(lambda of: [
            r.update(category="table", threshold=of["thresholds"]["table"], iou=r["iou_by_threshold"][i],
                     f1=2 * r["iou_by_threshold"][i] / (1 + r["iou_by_threshold"][i]),
                     precision=r["iou_by_threshold"][i], recall=1.0)
            for i in [THRESHOLDS.index(of["thresholds"]["table"])]
            for r in of["rows"] if r["recording"] == "chair_01"
        ]),
        "states other truth of chair_01/000",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", list(SAID_OTHERWISE))
def test_methods_agree_on_the_truth(net: Path, tmp_path: Path, name: str) -> None:
    edit, words = SAID_OTHERWISE[name]
    forged = read_table(changed(net, tmp_path / "scores.json", edit))
    with raises(SettingsError, "settings.other-scores", match=words):
        compare([read_table(net / "scores" / "scores.json"), forged])


CONSISTENT: dict[str, Edit] = {
    "better rows": underived(better),
    "no cross-entropy": every(ce=0.0),
    "better surfaces": every(chamfer_mm=0.1),
    "a better ceiling": every(ceiling_iou=1.0),
    "thresholds of a file": as_if_from_a_file,
    "a setting": lambda of: of["settings"].update(ce_clip=0.1),
    "a pasted mark": lambda of: of.update(
        verified={
            "date": "2026-11-25", "package_version": "0.1.0",
            "table_sha256": "0" * 64, "predictions_sha256": "0" * 64,
        }
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", list(CONSISTENT))
def test_what_is_consistent_is_only_reported(net: Path, release: Release, tmp_path: Path, name: str) -> None:
    path = changed(net, tmp_path / "scores.json", CONSISTENT[name])
    assert read_table(path).standing == "reported"
    page, _ = page_of_release(release, [path], tmp_path / "page.html")
    text = page.read_text(encoding="utf-8")
    assert "<small>reported</small>" in text and "<small>verified" not in text
    if name == "a pasted mark":  # nothing else was changed
        return
    before = path.read_bytes()
    try:
        assert recheck(release, path, net / "net")
    except SettingsError as error:  # a file of thresholds that is not there
        assert "give it: --thresholds" in str(error)
    assert path.read_bytes() == before


def test_a_mark_belongs_to_its_table(net: Path, release: Release, tmp_path: Path) -> None:
    path = changed(net, tmp_path / "scores.json", lambda of: None)
    assert recheck(release, path, net / "net") == []
    mark = read_table(path).json_value()["verified"]

    def pasted(of: Content) -> None:
        of["verified"] = mark
        every(ce=0.0)(of)

    assert read_table(path).standing.startswith("verified ")
    assert read_table(changed(net, tmp_path / "other.json", pasted)).standing == "reported"


def test_an_older_version_is_marked_and_has_its_own_page(net: Path, release: Release, tmp_path: Path) -> None:
    path = changed(net, tmp_path / "scores.json", older)
    page, _ = page_of_release(release, [path], tmp_path / "page.html")
    assert "score version 3, now " in page.read_text(encoding="utf-8")
    with raises(SettingsError, "settings.other-scores", match="counted"):
        page_of_release(release, [path, net / "scores" / "scores.json"], tmp_path / "page.html")


def test_scorer_refuses_what_score_refuses(net: Path, release: Release, tmp_path: Path) -> None:
    chosen = tmp_path / "thresholds.json"
    chosen.write_text('{"thresholds": {"chair": 0.5, "table": 0.5}, "objects": ["red_chair"]}')
    cases: tuple[tuple[dict[str, Any], type[KinectBenchError], str], ...] = (
        ({"thresholds_file": chosen}, SettingsError, "found on objects of the test split"),
        ({"method": "a\nb"}, PredictionError, "no name for a method"),
        ({"method": "index.html"}, PredictionError, "no name for a method"),
        ({"missing": "skip"}, SettingsError, "choose error or empty"),
        ({"protocols": ["mine"]}, SettingsError, "no protocol 'mine'"),
        ({"upsampling": "nearest"}, SettingsError, "no upsampling"),
    )
    for options, kind, words in cases:
        told = []
        for way in (
            lambda of: kinectbench.Scorer(release.folder, **of),
            lambda of: score_methods(release, net / "net", tmp_path / "out", surface=False, **of),
        ):
            with pytest.raises(kind, match=words) as caught:
                way(options)
            told.append(str(caught.value))
        assert told[0] == told[1]
