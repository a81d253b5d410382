"""What averages say of the truth's estimated IoU and its interval, against means worked out by hand."""

import dataclasses

import pytest
from docs_schemas import LATER

from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.score_figures import ScoreRow
from kinectbench.core.artefacts.scores import BaseRate, CategoryAverages
from kinectbench.report.tables import DETAILS
from kinectbench.scoring.averages import category_averages, object_means, overall_averages
from kinectbench.scoring.derived_values import _by_object

# Recording, object, category; the red chair was recorded twice.
RECORDINGS = (
    ("chair_01", "red_chair", "chair"),
    ("chair_02", "red_chair", "chair"),
    ("chair_03", "blue_chair", "chair"),
    ("table_01", "old_table", "table"),
)
QUALITY = {
    "chair_01": QualityFile(estimated_iou=0.8, estimated_iou_low=0.6, estimated_iou_high=0.9),
    "chair_02": QualityFile(estimated_iou=0.9, estimated_iou_low=0.8, estimated_iou_high=0.95),
    "chair_03": QualityFile(estimated_iou=0.7, estimated_iou_low=0.3, estimated_iou_high=0.775),
    "table_01": QualityFile(estimated_iou=0.95, estimated_iou_low=0.9, estimated_iou_high=0.97),
}


def rows() -> list[ScoreRow]:
    return [
        ScoreRow(
            recording=recording, object=thing, view="000", category=category, protocol="known",
            threshold=0.5, iou=0.5, unknown_share=0.0,
        )
        for recording, thing, category in RECORDINGS
    ]  # fmt: skip


def averages(quality: dict[str, QualityFile]) -> dict[str, CategoryAverages]:
    means = object_means(rows())
    rates = {name: BaseRate(value=0.1, source="test") for name in ("chair", "table")}
    by_category = category_averages(means, rates, _by_object(rows(), quality))
    return {**by_category["known"], "overall": overall_averages(by_category, means)["known"]}  # type: ignore[dict-item]


def test_the_interval_is_averaged_as_the_estimate_is() -> None:
    found = averages(QUALITY)
    # The red chair's recordings have the means 0.85, 0.7 and 0.925; the chairs' are of both chairs.
    expected = {"chair": (0.775, 0.5, 0.85), "table": (0.95, 0.9, 0.97), "overall": (0.8625, 0.7, 0.91)}
    for name, values in expected.items():
        of = found[name]
        shown = (of.truth_estimated_iou, of.truth_estimated_iou_low, of.truth_estimated_iou_high)
        assert shown == pytest.approx(values)
    assert DETAILS["truth's IoU, estimated"](found["chair"]) == "0.775 (0.500 to 0.850)"


def test_without_the_interval_of_one_there_is_none() -> None:
    found = averages(QUALITY | {"chair_03": QualityFile(estimated_iou=0.7)})["chair"]
    assert found.truth_estimated_iou == pytest.approx(0.775)
    assert found.truth_estimated_iou_low is found.truth_estimated_iou_high is None
    assert DETAILS["truth's IoU, estimated"](found) == "0.775"
    assert DETAILS["truth's IoU, estimated"](dataclasses.replace(found, truth_estimated_iou=None)) == "–"


def test_older_tables_lack_it() -> None:
    assert {"truth_estimated_iou_low", "truth_estimated_iou_high"} <= LATER
