"""The plan and the figures, against values computed by hand."""

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from analytic_scenes import health_of
from report_fake_build import cameras_floor

from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.sequence import DAMAGED_FRAME, CameraFile
from kinectbench.core.artefacts.trajectory import RejectedFrame
from kinectbench.report import figures as words
from kinectbench.report import recording
from kinectbench.report.plan import draw_plan, time_color
from kinectbench.stages.track.verdict import GRADES


def test_plan_is_seen_from_above_to_scale() -> None:
    corners = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    svg = draw_plan(cameras_floor(), np.array([[0.0, 1.2, 1.0]]), [corners])
    root = ElementTree.fromstring(svg)
    assert root.get("class") == "plan"
    start = root.find("circle")
    assert start is not None
    polygon = next(p for p in root.findall("path") if p.get("class") == "object")
    pairs = re.findall(r"([-\d.]+),([-\d.]+)", polygon.get("d") or "")
    points = np.array([[float(x), float(y)] for x, y in pairs])
    px_per_m = (points[:, 0].max() - points[:, 0].min()) / 2
    # The first camera stands at (0, -1.2): below the middle of the drawing by 1.2 m.
    middle = points.mean(axis=0)
    assert float(start.get("cx", 0)) == pytest.approx(middle[0], abs=0.2)
    assert float(start.get("cy", 0)) == pytest.approx(middle[1] + 1.2 * px_per_m, abs=0.2)
    # The frame left out stands at (0, 1.2): above it.
    cross = next(p for p in root.findall("path") if p.get("class") == "left-out")
    x, y = (float(v) + 4 for v in re.findall(r"M([-\d.]+),([-\d.]+)", cross.get("d") or "")[0])
    assert (x, y) == pytest.approx((middle[0], middle[1] - 1.2 * px_per_m), abs=0.2)
    # The scale bar says how long it is.
    bar = next(p for p in root.findall("path") if p.get("class") == "bar")
    low, high = (float(v) for v in re.findall(r"M([\d.]+),.*H([\d.]+)", bar.get("d") or "")[0])
    label = next(t.text for t in root.findall("text") if t.text and t.text.endswith(" m"))
    assert (high - low) / px_per_m == pytest.approx(float(label.split()[0]), rel=0.01)


def test_ticks_point_at_what_the_cameras_look_at() -> None:
    root = ElementTree.fromstring(draw_plan(cameras_floor(), np.zeros((0, 3)), []))
    ticks = [{k: float(v) for k, v in t.attrib.items() if len(k) == 2} for t in root.findall("line")]
    starts = np.array([[t["x1"], t["y1"]] for t in ticks])
    ends = np.array([[t["x2"], t["y2"]] for t in ticks])
    # Three quarters of a circle: its middle lies half way between two opposite cameras.
    center = (starts[:, 0].min() + starts[:, 0].max()) / 2, (starts[:, 1].min() + starts[:, 1].max()) / 2
    towards = np.array(center) - starts
    cosine = np.sum((ends - starts) * towards, axis=1)
    cosine /= np.linalg.norm(ends - starts, axis=1) * np.linalg.norm(towards, axis=1)
    assert cosine.min() > 0.98


@pytest.mark.parametrize("n", [1, 2, 500])
def test_plan_of_few_and_many_cameras(n: int) -> None:
    svg = draw_plan(np.repeat(np.eye(4)[None], n, axis=0), np.zeros((0, 3)), [])
    assert ElementTree.fromstring(svg).get("role") == "img"
    assert "nan" not in svg and len(svg) < 30_000


def test_time_runs_from_blue_to_orange() -> None:
    assert (time_color(0), time_color(1), time_color(2)) == ("#2f6bc4", "#e88c2e", "#e88c2e")


@pytest.mark.parametrize(
    ("rejected", "rows", "expected"),
    [
        ([1], [0, 2, 3], [[1.0, 0, 0]]),  # left out of the trajectory: between its neighbours
        ([1], [0, 1, 2, 3], [[1.0, 0, 0]]),  # kept in it: its own place
        ([2, 2], [0, 1, 3], [[2.0, 0, 0]]),  # named twice
        ([1], [0, 3], []),  # rows that cannot be told apart
        ([], [0, 1, 2, 3], []),
    ],
)
def test_place_of_frames_left_out(rejected: list[int], rows: list[int], expected: list[list[float]]) -> None:
    cameras = np.repeat(np.eye(4)[None], len(rows), axis=0)
    cameras[:, 0, 3] = rows
    health = health_of(4, rejected=[RejectedFrame(frame=frame) for frame in rejected])
    found = recording._left_out(cameras, health)
    np.testing.assert_allclose(found, np.array(expected).reshape(-1, 3))


def test_frames_lost_have_no_row_and_no_cross() -> None:
    cameras = np.repeat(np.eye(4)[None], 2, axis=0)
    cameras[:, 0, 3] = [0, 3]
    found = recording._left_out(cameras, health_of(4, rejected=[RejectedFrame(frame=2)], lost=[1]))
    np.testing.assert_allclose(found, [[2, 0, 0]])


def test_figures_in_words(tmp_path: Path) -> None:
    (tmp_path / "quality.json").write_text(
        '{"verdict": "The poses will do.", "warnings": [], "per_frame": [{"frame": 1}],'
        ' "drift_mm": 1.23456, "edges": {"loop": 3, "list": [1, 2]}, "a": null, "b": true,'
        ' "long": [1, 2, 3, 4, 5, 6, 7], "rejected": [1, 2]}'
    )
    figures = words.quality_figures(QualityFile.read(tmp_path))
    assert (figures.verdict, figures.tone) == ("The poses will do.", "good")
    assert figures.rows == (
        ("drift (mm)", "1.235"),
        ("edges · loop", "3"),
        ("edges · list", "1, 2"),
        ("a", "–"),
        ("b", "yes"),
        ("long", "7 entries"),
        ("rejected", "2"),
    )


CAMERA = dict.fromkeys(("fx", "fy", "cx", "cy"), 1.0) | {"color_registered": True}
FILE: dict[str, Any] = CAMERA | {"format_version": 2, "width": 4, "height": 3, "depth_scale": 1000.0}


def test_the_health_in_words() -> None:
    rejected = [RejectedFrame(frame=1), RejectedFrame(frame=2)]
    health = health_of(
        4, verdict="They will do.", arc_rad=np.pi, rejected=rejected, keyframes=range(7), median_shift_m=None
    )
    figures = words.health_figures(health)
    assert (figures.verdict, figures.grade, figures.tone) == ("They will do.", "good", "good")
    assert figures.warnings == ()
    rows = dict(figures.rows)
    assert rows["grade"] == "good" and rows["arc (deg)"] == "180" and rows["median shift (mm)"] == "–"
    assert "damaged frames" not in rows
    lines = tuple(f"{DAMAGED_FRAME}{name}: cut off" for name in "abc")
    sequence = CameraFile.model_validate(FILE | {"warnings": ("other", *lines)})
    assert dict(words.health_figures(health, sequence).rows) == {"damaged frames": "3", **rows}
    assert rows["rejected"] == "2" and rows["keyframes"] == "7 entries" and rows["ties · loop"] == "0"


@pytest.mark.parametrize("verdict", ["good for ground truth", "not good for anything", "bad", "42", ""])
def test_the_colour_does_not_depend_on_words(tmp_path: Path, verdict: str) -> None:
    def of_health(grade: str, *warnings: str) -> str:
        return words.health_figures(health_of(4, verdict=verdict, grade=grade, warnings=warnings)).tone

    def of_quality(**values: Any) -> str:
        (tmp_path / "quality.json").write_text(json.dumps({"verdict": verdict, **values}))
        figures = words.quality_figures(QualityFile.read(tmp_path))
        assert figures.verdict == verdict
        return figures.tone

    assert set(words.TONES) == set(GRADES)
    for grade, expected in (("good", "good"), ("fair", "good"), ("not good", "bad")):
        assert of_health(grade) == expected
    assert of_health("good", "2 frames disagree") == "warn"
    assert of_health("not good", "2 frames disagree") == "bad"
    assert of_quality() == "plain" and of_quality(warnings=[]) == "good"
    assert of_quality(warnings=["few frames"]) == "warn"
