"""The doctor's figures in words."""

import re
from collections.abc import Callable
from pathlib import Path

from small_benchmark import Run

from kinectbench.doctor.finding import Diagnosis, Finding, fact_lines
from kinectbench.doctor.page import write_diagnosis_page

CHAIR = Path(__file__).parents[2] / "recordings" / "chair_01"


def test_words() -> None:
    facts: dict[str, object] = {
        "path": "a/True.bag",
        "frames": 120,
        "rate_hz": 29.97,
        "duration_s": None,
        "camera": {"width": 320, "height": 240, "fx": 262.5, "fy": 262.5, "cx": 159.5, "cy": 119.5},
        "color_size_px": [320, 240],
        "color_registered": True,
        "color_calibrated": False,
        "depth_scale": 5000.0,
        "depth_m": {"p05": 1.192, "median": None, "p95": 4.143},
        "valid_share": 0.838,
        "color_shift_px": [0.0, -0.25],
        "pose_residual_mm": 3.11,
        "arc_deg": 356,
    }
    assert fact_lines(facts) == [
        ("path", "a/True.bag"),
        ("frames", "120"),
        ("rate", "29.97 Hz"),
        ("camera", "320 x 240 px, fx 262.5, fy 262.5, cx 159.5, cy 119.5"),
        ("colour size", "320 x 240 px"),
        ("colour registered", "yes"),
        ("colour calibrated", "no"),
        ("depth scale", "5000"),
        ("depth", "p05 1.192 m, p95 4.143 m"),
        ("valid share", "83.8 %"),
        ("colour shift", "0, -0.25 px"),
        ("pose residual", "3.11 mm"),
        ("arc", "356°"),
    ]


def test_the_verdict_names_each_kind_of_finding_once() -> None:
    findings = [Finding("floor", "warning", what, "") for what in ("a step", "a slope")]
    assert Diagnosis({}, tuple(findings)).verdict == "usable with care: floor"
    stops = Finding("no_depth", "stops", "none", "")
    assert Diagnosis({}, (stops, *findings)).verdict == "not usable as it is: no_depth"


def test_registration_that_nothing_shows_is_no_plain_yes() -> None:
    """Even of images without stamps, which are not counted."""
    facts: dict[str, object] = {"color_images": None, "color_size_px": [320, 240], "color_registered": True}
    for registration, said in (
        ("seen", "yes"),
        ("unclear", "assumed: nothing shows it"),
        ("contradicted", "assumed, but its edges lie elsewhere"),
    ):
        lines = fact_lines(facts | {"color_registration": registration})
        assert lines == [("colour size", "320 x 240 px"), ("colour registered", said)]
    without = fact_lines({"color_registered": True, "color_registration": "unclear"})
    assert without == [("colour registered", "yes")]


def test_terminal_and_page_say_the_same(command: Callable[..., Run], tmp_path: Path) -> None:
    page = tmp_path / "inspect.html"
    said = command(tmp_path, "inspect", str(CHAIR), "--page", str(page))
    html = page.read_text()
    for line in ("colour registered: yes", "colour size: 320 x 240 px", "rate: 5 Hz"):
        name, value = line.split(": ")
        assert line in said.out.splitlines() and f"<dt>{name}</dt><dd>{value}</dd>" in html
    for text in (said.out, html):
        assert "True" not in text and "False" not in text and "{&#39;" not in text and "{'" not in text


def test_findings_of_the_page_are_one_column(tmp_path: Path) -> None:
    """A table squeezed advice to a word a line at 400 px: each finding is a block, with its advice below."""
    found = (
        Finding("depth_scale", "stops", "the scale is 5000", "depth/0.png", "put 256"),
        Finding("no_trajectory", "note", "no trajectory", "."),
    )
    write_diagnosis_page(Diagnosis({"path": "a"}, found), None, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text().split("<h2>Findings</h2>")[1].split("<h2>")[0]
    assert "<table" not in text
    said = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", text)).strip()
    assert said == "stops depth_scale the scale is 5000 What to do: put 256 note no_trajectory no trajectory"
