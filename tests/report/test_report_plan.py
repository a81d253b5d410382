"""The plan and the figures, against values computed by hand."""

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from report_fake_build import cameras_floor

from kinectbench.report import recording, stored
from kinectbench.report.plan import PlanView, draw_plan, time_color


def test_plan_is_seen_from_above_to_scale() -> None:
    corners = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    svg = draw_plan(PlanView(cameras_floor(), np.array([[0.0, 1.2, 1.0]]), [corners]))
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
    root = ElementTree.fromstring(draw_plan(PlanView(cameras_floor(), np.zeros((0, 3)), [])))
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
    svg = draw_plan(PlanView(np.repeat(np.eye(4)[None], n, axis=0), np.zeros((0, 3)), []))
    assert ElementTree.fromstring(svg).get("role") == "img"
    assert "nan" not in svg and len(svg) < 30_000


def test_time_runs_from_blue_to_orange() -> None:
    assert (time_color(0), time_color(1), time_color(2)) == ("#2f6bc4", "#e88c2e", "#e88c2e")


@pytest.mark.parametrize(
    ("rejected", "rows", "expected"),
    [
        ([{"frame": 1}], [0, 2, 3], [[1.0, 0, 0]]),  # left out of the trajectory: between its neighbours
        ([{"frame": 1}], [0, 1, 2, 3], [[1.0, 0, 0]]),  # kept in it: its own place
        ([2, {"frame": 2}], [0, 1, 3], [[2.0, 0, 0]]),  # plain numbers, named twice
        ([{"frame": 1}], [0, 3], []),  # rows that cannot be told apart
        ([{"frame": "one"}, None], [0, 1, 2, 3], []),
        (7, [0, 1, 2, 3], []),
    ],
)
def test_place_of_frames_left_out(rejected: object, rows: list[int], expected: list) -> None:
    cameras = np.repeat(np.eye(4)[None], len(rows), axis=0)
    cameras[:, 0, 3] = rows
    found = recording._left_out(cameras, {"frames": 4, "rejected": rejected})
    np.testing.assert_allclose(found, np.array(expected).reshape(-1, 3))


def test_frames_lost_have_no_row_and_no_cross() -> None:
    cameras = np.repeat(np.eye(4)[None], 2, axis=0)
    cameras[:, 0, 3] = [0, 3]
    found = recording._left_out(cameras, {"frames": 4, "rejected": [{"frame": 2}], "lost": [1]})
    np.testing.assert_allclose(found, [[2, 0, 0]])


def test_figures_in_words(tmp_path: Path) -> None:
    path = tmp_path / "health.json"
    path.write_text(
        '{"verdict": "Good at 5 mm: all well", "per_frame": [{"frame": 1}],'
        ' "drift_mm": 1.23456, "edges": {"loop": 3, "list": [1, 2]}, "a": null, "b": true,'
        ' "long": [1, 2, 3, 4, 5, 6, 7], "rejected": [1, 2]}'
    )
    figures = stored.read_figures(path)
    assert figures is not None
    assert (figures.verdict, figures.brief) == ("Good at 5 mm: all well", "Good at 5 mm")
    assert (figures.tone, figures.warnings) == ("good", ())
    assert figures.rows == (
        ("drift (mm)", "1.235"),
        ("edges · loop", "3"),
        ("edges · list", "1, 2"),
        ("a", "–"),
        ("b", "yes"),
        ("long", "7 entries"),
        ("rejected", "2"),
    )
    assert stored.read_figures(tmp_path / "none.json") is None


@pytest.mark.parametrize(
    ("value", "lines"),
    [
        (None, ()),
        ("one", ("one",)),
        (["a", {"view": "003", "error": "missing"}], ("a", "view 003, error missing")),
        ({"chair_01/003": "missing"}, ("chair_01/003: missing",)),
    ],
)
def test_messages_as_lines(value: object, lines: tuple[str, ...]) -> None:
    assert stored.as_lines(value) == lines
