"""`kinectbench triage`: triage.json, its page, and what is printed."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from small_benchmark import Run, copied

from kinectbench.core.artefacts.triage import TriageFile, TriageRow
from kinectbench.report.triage import write_triage_page

Command = Callable[..., Run]


@pytest.fixture
def two(small: Path, tmp_path: Path) -> Path:
    """The small benchmark as it was built, and a recording that cannot be read."""
    root = copied(small, tmp_path / "two")
    text = (root / "benchmark.yaml").read_text(encoding="utf-8")
    line = "  - {id: broken, path: recordings/none, category: chair}\n"
    (root / "recordings" / "none").mkdir()
    (root / "benchmark.yaml").write_text(text.replace("fusion:", f"{line}fusion:", 1), encoding="utf-8")
    return root


def test_triage_of_a_build(two: Path, command: Command) -> None:
    done = command(two, "triage", "--jobs", "1")
    assert done.status == 3, done.err
    found = TriageFile.read(two / "triage")
    rows = {row.recording: row for row in found.rows}
    assert set(rows) == {"chair", "table", "broken"} and rows["broken"].decision == "reject"
    assert rows["broken"].reasons[0].startswith("its build failed at ingest: ")
    assert found.rows[0].decision == "reject"
    page = (two / "triage/index.html").read_text(encoding="utf-8")
    assert page.count("<article>") == 3 and page.count('<img src="data:image/') == 4
    assert "There is no picture of it." in page and "http" not in page.replace("http-equiv", "")
    chair = page.partition("<h3>chair ")[2].partition("</article>")[0]
    assert "underside closed, as its recording says" in chair
    assert "of the solid rests on `underside: closed` alone" in chair
    known = f"IoU on known voxels {rows['chair'].estimated_known_iou:.2f}"
    assert chair.count(known) == 1 and chair.count("on known voxels") == 1
    counts = ", ".join(f"{decision} {count}" for decision, count in found.counts.items())
    assert counts in done.out and "its build failed at ingest" in " ".join(done.out.split())
    again = command(two, "triage", "--jobs", "1", "--json")
    assert json.loads(again.out) == found.json_value()


def test_triage_of_one_recording_shows_its_decision_and_writes_nothing(two: Path, command: Command) -> None:
    done = command(two, "triage", "chair", "--jobs", "1", "--json")
    assert done.status == 0, done.err
    (row,) = json.loads(done.out)["rows"]
    assert row["recording"] == "chair" and row["built"] and not (two / "triage").exists()
    wrong = command(two, "triage", "chairs", "--jobs", "1")
    assert wrong.status == 2 and "did you mean 'chair'?" in wrong.err


def test_a_review_decides_and_a_strangers_words_are_text(two: Path, command: Command) -> None:
    text = (two / "benchmark.yaml").read_text(encoding="utf-8")
    review = "category: chair, review: {decision: reject, reason: '<b>a cloth</b>'}, underside"
    (two / "benchmark.yaml").write_text(
        text.replace("category: chair, underside", review, 1), encoding="utf-8"
    )
    command(two, "triage", "--jobs", "1")
    row = next(row for row in TriageFile.read(two / "triage").rows if row.recording == "chair")
    assert (row.decision, row.review) == ("reject", "<b>a cloth</b>")
    page = (two / "triage/index.html").read_text(encoding="utf-8")
    assert "&lt;b&gt;a cloth&lt;/b&gt;" in page and "<b>a cloth" not in page


def test_a_sequence_without_frames_has_no_picture(small: Path, tmp_path: Path) -> None:
    shutil.copytree(small / "build/chair/sequence", tmp_path / "chair/sequence")
    (tmp_path / "chair/sequence/frames.json").write_text("[]")
    row = TriageRow(
        recording="chair", object="chair", split="test", decision="reject", reasons=(), built=False
    )
    write_triage_page("x", TriageFile(rows=(row,)), tmp_path, tmp_path / "index.html")
    assert "There is no picture of it." in (tmp_path / "index.html").read_text()
