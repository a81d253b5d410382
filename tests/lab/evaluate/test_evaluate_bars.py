"""The bars of `benchmarks/truth/known.py` on rows made by hand."""

from dataclasses import replace
from typing import Any

import pytest
from figures import Figure
from known import bars, recordings
from known_rows import NotBuilt, Row, mean_of

from kinectbench.lab.evaluate.known import CalibrationBin
from kinectbench.lab.evaluate.measured import FaceBias
from kinectbench.lab.evaluate.refined import RefinedFigures

REFINED = RefinedFigures(
    lifted_m=0.001, moved_m=0.001, turned_rad=0.0, measured_distance_m=0.0012, refined_distance_m=0.0007,
    face_bias_m=FaceBias(0.0003, -0.0003, None), iou=0.93, known_iou=0.97,
)  # fmt: skip
CHAIR = Row(
    name="chair31",
    family="chair",
    path="known-v1",
    ate_m=0.002,
    iou=0.92,
    known_iou=0.96,
    known_gross=0.0005,
    air_called_solid=0.0,
    not_known=0.08,
    near_solid=0.02,
    near_air=0.01,
    estimated=0.93,
    low=0.89,
    high=0.95,
    in_interval=True,
    estimated_known=0.95,
    known_in_interval=True,
    frontiers=0,
    calibration=0.02,
    bins=(CalibrationBin(0.1, 0.12, 100), CalibrationBin(0.9, 0.88, 100)),
    bias=FaceBias(0.0013, -0.0003, None),
    refined=REFINED,
    scene_f=0.96,
    fused_f=0.98,
    mesh_f=0.99,
    warnings=(),
)
BIN = replace(
    CHAIR, name="bin31", family="bin", iou=0.6, known_iou=0.88, known_gross=0.003, not_known=0.15,
    estimated=0.75, low=0.62, high=0.8, frontiers=1, warnings=("look into it",),
    estimated_known=0.87,
)  # fmt: skip


def refined(**figures: Any) -> Row:
    """The chair with other figures after a rigid motion."""
    return replace(CHAIR, refined=replace(REFINED, **figures))


def verdicts(figures: list[Figure]) -> dict[str, bool | None]:
    return {figure.name: figure.met for figure in figures}


def short(rows: list[Row]) -> list[str]:
    """The bars that are missed, without figures that are only stated."""
    return [name for name, met in verdicts(bars(rows, [], True, [])).items() if met is False]


def test_what_is_asked_is_met() -> None:
    figures = bars([CHAIR, BIN], [], True, [])
    # Four of furniture, three of others and sixteen of all: none is left out, but for undersides.
    assert sum(figure.met is not None for figure in figures) == 23
    assert [figure.name for figure in figures if figure.met is False] == ["estimated_iou: median error"]


@pytest.mark.parametrize(
    ("row", "name"),
    [
        (replace(CHAIR, known_gross=0.0011), "furniture: known_gross_share, greatest"),
        (replace(BIN, known_gross=0.0031), "others: known_gross_share, greatest"),
        (replace(CHAIR, known_iou=0.94), "furniture: IoU on known, mean"),
        (replace(BIN, not_known=0.21), "others: true volume not known, mean"),
        (replace(CHAIR, near_solid=0.07), "unknown_near_measured, solid, mean"),
        (replace(CHAIR, near_air=0.07), "unknown_near_measured, air, mean"),
        (replace(CHAIR, in_interval=False), "IoU within the interval, share of objects"),
        (replace(CHAIR, low=0.86), "no frontier: high - low, median"),
        (replace(BIN, low=0.59), "a frontier, at most 20 % unknown: high - low, median"),
        (replace(CHAIR, calibration=0.031), "calibration error, mean of the objects'"),
        (refined(face_bias_m=FaceBias(-0.0005, 0.0, None)), "the same after refinement, upper faces, mm"),
        (refined(face_bias_m=FaceBias(None, 0.0005, None)), "the same after refinement, sides, mm"),
        (refined(refined_distance_m=0.0009), "measured surface: mean distance after refinement, mm"),
        (replace(CHAIR, fused_f=0.96), "fused object, what was measured: F at 5 mm, mean"),
        (replace(BIN, fused_f=0.92), "fused object, what was measured: F at 5 mm, least"),
    ],
)  # fmt: skip
def test_each_bar_can_be_missed(row: Row, name: str) -> None:
    assert name in short([row])
    assert name not in short([CHAIR if row.is_furniture else BIN])


def test_an_estimate_that_is_off_needs_a_frontier_and_a_warning() -> None:
    name = "estimated_iou off by over .10, and nothing says so: objects"
    assert name not in short([BIN])
    assert name in short([replace(BIN, frontiers=0)])
    assert name in short([replace(BIN, frontiers=None)])
    assert name in short([replace(BIN, warnings=())])


def test_what_is_unknown_is_judged_with_the_word_only() -> None:
    row = replace(CHAIR, not_known=0.5)
    name = "furniture: true volume not known, mean"
    assert verdicts(bars([row], [], True, []))[name] is False
    assert verdicts(bars([row], [], False, []))[name] is None


def test_shares_of_objects_have_their_bounds() -> None:
    figures = {figure.name: figure.value for figure in bars([CHAIR] * 13, [], False, [])}
    # 13 of 13: the 95 % bound of Clopper and Pearson is .025 ** (1 / 13).
    assert figures["furniture: objects up to 0.1%"] == "13 of 13 (75% to 100%)"
    assert figures["objects"] == "13 of 13 (75% to 100%)"


def test_couches_are_asked_one_by_one() -> None:
    couch = replace(CHAIR, name="couch31", family="couch", not_known=0.13)
    figures = verdicts(
        bars([CHAIR, CHAIR, CHAIR, CHAIR, couch, replace(couch, not_known=0.05)], [], True, [])
    )
    assert figures["furniture: true volume not known, mean"] is True
    assert figures["couches: true volume not known, greatest"] is False


def test_against_an_earlier_run() -> None:
    earlier = [
        {"name": "chair31", "iou": 0.914},
        {"name": "table31", "iou": 0.93},
        {"name": "bin31", "iou": 0.9},
    ]
    table = replace(CHAIR, name="table31", family="table", iou=0.924)
    figures = {figure.name: figure for figure in bars([CHAIR, table, BIN], [], True, earlier)}
    assert figures["furniture: IoU gained against the earlier run, mean"].value == pytest.approx(0)
    assert figures["furniture: IoU gained against the earlier run, mean"].met is False
    assert figures["chair: IoU gained, mean"].met is True
    assert figures["table: IoU gained, mean"].met is False  # 6 mm less of a thousand
    assert "bin: IoU gained, mean" not in figures


def test_what_was_not_built_is_counted() -> None:
    figures = verdicts(bars([], [NotBuilt("lamp31", "lamp", "too dark")], True, []))
    assert figures["objects that were not built"] is False


def test_a_mean_is_of_the_rows_that_have_a_value() -> None:
    assert mean_of([CHAIR, replace(CHAIR, near_air=None)], lambda row: row.near_air) == 0.01
    assert mean_of([CHAIR], lambda row: row.bias.down) is None


def test_small_things_are_recorded_from_near() -> None:
    found = recordings(["chair", "bin"], [4, 31], ["auto", "steep-v1"], ["sensor.width=320"])
    assert [one.name for one in found] == [
        "chair4", "chair4-steep", "bin4", "bin4-steep", "chair31", "chair31-steep", "bin31", "bin31-steep",
    ]  # fmt: skip
    paths = {one.name: one.path for one in found}
    assert (paths["chair4"], paths["bin4"], paths["bin4-steep"]) == ("known-v1", "near-v1", "steep-v1")
    small = next(one for one in found if one.name == "bin4").spec
    assert (small.path.frames, small.path.rate_hz, small.sensor.width, small.seed) == (180, 10.0, 320, 4)
    assert not small.save_depth
