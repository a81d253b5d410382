"""What a run tells of an object: the estimate's interval, its reasons, and what to record again."""

import io
import json
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from kinectbench.cli import console
from kinectbench.cli.build import SHOWN_RECORDINGS, show_rows
from kinectbench.core.artefacts.views import PairsFile, Refused
from kinectbench.engine.pipeline import Outcome
from kinectbench.engine.stages import Job
from kinectbench.engine.summary import BuiltRecording, RecordingSummary, summary
from kinectbench.settings.models import BenchmarkSettings

SETTINGS = BenchmarkSettings.model_validate(
    {"name": "bins", "license": "CC0-1.0", "recordings": [{"id": "bin", "path": "bin", "category": "bin"}]}
)
ADVICE = "nobody looked into the opening at the top, 31 x 29 cm: record from above"
FRONTIER = {
    "direction": "up",
    "area_m2": 0.09,
    "size_m": [0.31, 0.29],
    "center_m": [0.0, 0.0, 0.6],
    "look_from": [0.0, 0.0, 1.0],
    "advice": ADVICE,
    "volume_m3": 0.05,
    "inside_share": 0.5,
    "solid_share": 1.0,
}
ESTIMATE = {
    "warnings": [ADVICE],
    "estimated_iou": 0.7412,
    "estimated_iou_low": 0.352,
    "estimated_iou_high": 0.8,
    "estimated_iou_reasons": ["an opening that nobody looked into", "thin parts"],
    "frontiers": [FRONTIER],
}


def row(root: Path, quality: dict[str, Any], made: tuple[str, ...] = ()) -> RecordingSummary:
    """The summary of a recording whose object has this quality.json."""
    folder = root / "build" / "bin" / "object"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "quality.json").write_text(json.dumps(quality))
    current = () if made else ("segment",)
    return summary(Job(SETTINGS, SETTINGS.recordings[0], root), Outcome("bin", made, current, None, 0.0))


def told(
    rows: list[RecordingSummary], monkeypatch: pytest.MonkeyPatch, *, frontiers: bool = False
) -> list[str]:
    shown = Console(width=160, record=True, file=io.StringIO())
    monkeypatch.setattr(console, "out", shown)
    console.object_lines(rows, frontiers=frontiers)
    return shown.export_text().splitlines()


def test_a_line_for_each_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = told([row(tmp_path, ESTIMATE)], monkeypatch)
    assert lines == [
        "bin: estimated IoU 0.74 (0.35 to 0.80); the interval in brackets is so wide because of:",
        "  an opening that nobody looked into",
        "  thin parts",
    ]
    # What was made in this run has it among its warnings.
    assert told([row(tmp_path, ESTIMATE)], monkeypatch, frontiers=True) == [*lines, f"bin: {ADVICE}"]
    assert told([row(tmp_path, ESTIMATE, ("segment",))], monkeypatch, frontiers=True) == lines


def test_what_rests_on_the_word_of_a_person(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A word that decides much of the solid is shown with what it costs if it is false; no warning."""
    closed = {"estimated_iou_low": 0.97, "underside": "closed", "underside_share": 0.75}
    line = "bin: 75% of the solid rests on `underside: closed` alone, which no frame confirms"
    assert told([row(tmp_path, closed)], monkeypatch) == [
        f"{line}; if it is false, the IoU may be as low as 0.22"
    ]
    assert told([row(tmp_path, closed | {"estimated_iou_low": None})], monkeypatch) == [line]
    for of in ({"underside_share": 0.05}, {"underside": "open"}, {"underside_share": None}):
        assert told([row(tmp_path, closed | of)], monkeypatch) == []


def test_an_object_without_an_interval(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    older = row(tmp_path, {"estimated_iou": 0.93, "repeatability_iou": 0.9})
    assert told([older], monkeypatch) == []
    shown = older.json_value()
    assert shown["estimated_iou_low"] is None and shown["frontiers"] == []
    failed = summary(Job(SETTINGS, SETTINGS.recordings[0], tmp_path), Outcome("bin", (), (), "no floor", 0.0))
    assert failed.frontiers is None and told([failed], monkeypatch) == []


def test_the_json_holds_them(tmp_path: Path) -> None:
    shown = json.loads(json.dumps(row(tmp_path, ESTIMATE).json_value()))
    keys = ("estimated_iou", "estimated_iou_low", "estimated_iou_high", "estimated_iou_reasons", "frontiers")
    assert {key: shown[key] for key in keys} == {key: ESTIMATE[key] for key in keys}


@pytest.mark.parametrize(
    ("quality", "words"),
    [(ESTIMATE, "0.74 (0.35 to 0.80)"), ({"estimated_iou": 0.93}, "0.930"), ({}, " - ")],
)
def test_the_table_shows_the_interval(tmp_path: Path, quality: dict[str, Any], words: str) -> None:
    shown = Console(width=160, record=True, file=io.StringIO())
    shown.print(console.summary_table([row(tmp_path, quality)], ("segment",)))
    assert words in shown.export_text()


def test_of_many_the_table_shows_what_was_done_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shown = console.SafeConsole(width=160, record=True, file=io.StringIO())
    monkeypatch.setattr(console, "out", shown)
    plain = row(tmp_path, {})
    rows = [plain.model_copy(update={"recording": f"r{number}_"}) for number in range(SHOWN_RECORDINGS + 50)]
    rows[-1] = rows[-1].model_copy(update={"made": ("segment",), "recording": "made"})
    rows[-2] = rows[-2].model_copy(update={"error": "too dark", "recording": "failed"})
    show_rows([BuiltRecording.of(each) for each in rows], "segment")
    text = shown.export_text()
    assert text.index("failed") < text.index("made") < text.index("r0_")
    assert sum(text.count(each.recording) for each in rows) == SHOWN_RECORDINGS
    counts = f"{SHOWN_RECORDINGS + 48} of all {SHOWN_RECORDINGS + 50}"
    last = f"and 50 more; {counts} were up to date; --json lists all"
    assert capsys.readouterr().out.splitlines() == [last]


def test_of_many_only_those_that_are_shown_are_read(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    read, plain = list[int](), row(tmp_path, {})

    def one(number: int) -> BuiltRecording:
        return BuiltRecording("bin", None, (), lambda: read.append(number) or plain)  # type: ignore[func-returns-value]

    monkeypatch.setattr(console, "out", console.SafeConsole(width=160, file=io.StringIO()))
    show_rows([one(number) for number in range(SHOWN_RECORDINGS + 50)], "segment")
    assert read == list(range(SHOWN_RECORDINGS))


def test_views_without_a_pair_are_named_where_a_person_drew_masks(tmp_path: Path) -> None:
    refused = tuple(Refused(view=f"00{n}", frame=10 * n, reason="no pixel of the mask") for n in range(5))
    folder = tmp_path / "build" / "bin" / "pairs"
    folder.mkdir(parents=True)
    PairsFile(pairs=(), refused=refused).write(folder)
    drawn = SETTINGS.recordings[0].model_copy(update={"masks": "masks/bin"})
    found = [
        summary(Job(SETTINGS, recording, tmp_path), Outcome("bin", (), ("pairs",), None, 0.0)).warnings
        for recording in (SETTINGS.recordings[0], drawn)
    ]
    assert found[0] == ()
    (line,) = found[1]
    assert "no pair of 5 views" in line and "000 of frame 0 (no pixel of the mask)" in line
    assert "and 2 more in pairs.json" in line
