"""What `publish` says of other runs, of warnings and of the release that it replaces."""

import json
import os
from collections.abc import Callable
from pathlib import Path

from small_benchmark import Run, copied, hashes
from typed import model_of

from kinectbench.cli.publish import to_mend
from kinectbench.engine.locks import locked
from kinectbench.engine.summary import BuiltRecording, RecordingSummary
from kinectbench.release.publish.publish import PublishSummary

Command = Callable[..., Run]


def test_publish_that_does_not_wait_builds_and_publishes_nothing(
    command: Command, small: Path, tmp_path: Path
) -> None:
    root = copied(small, tmp_path / "b")
    before = hashes(root)
    with locked(root / "build" / "chair"):
        done = command(root, "publish", "--no-wait", "--set", "views.seed=3", "--jobs", "1")
    assert done.status == 1 and hashes(root) == before and not done.progress
    assert len([line for line in done.err.splitlines() if f"in use by process {os.getpid()}" in line]) == 1
    assert "failed" not in done.err + done.out


def test_a_recording_in_use_is_not_called_failed(command: Command, small: Path, tmp_path: Path) -> None:
    root = copied(small, tmp_path / "b")
    with locked(root / "build" / "chair"):
        done = command(root, "build", "--no-wait", "--jobs", "1")
        values = command(root, "build", "--no-wait", "--jobs", "1", "--json")
    assert done.status == 3 and "failed" not in done.err + done.out
    assert f"chair: error: build/chair: in use by process {os.getpid()}" in done.err
    assert "in use: 1 of 2 recordings: chair; the rest is done. Run the same command again" in done.err
    (line,) = [line for line in done.out.splitlines() if line.startswith("│ chair")]
    assert line.rstrip(" │").endswith("in use")
    assert [row["status"] for row in json.loads(values.out)] == ["in use", "up to date"]


def test_a_warning_is_printed_once_and_a_replaced_release_is_named(
    command: Command, small: Path, tmp_path: Path
) -> None:
    root = copied(small, tmp_path / "b")
    config = root / "benchmark.yaml"
    text = config.read_text().replace("{gate:", "{citation: {version: 1.0.0}, gate:")
    config.write_text(text)
    first = command(root, "publish", "--jobs", "1")
    assert first.status == 0 and "replaced" not in first.err, first.err
    sha256 = json.loads((root / "benchmark" / "benchmark.json").read_text())["benchmark_sha256"]
    assert "replaced" not in command(root, "publish", "--force", "--jobs", "1").err
    config.write_text(text.replace("seed: 0", "seed: 3").replace("count: 3", "count: 2"))
    again = command(root, "publish", "--jobs", "1")
    assert again.status == 0 and any("chair: pairs" in line for line in again.progress)
    lines = [line for line in again.err.splitlines() if not line.startswith("note: chair: built with")]
    assert not [line for line in lines if line.startswith(("chair: ", "table: "))]
    for text in ("the solid begins 0.39 m above the floor", "nobody looked into the opening at the bottom"):
        assert sum(text in line for line in lines) == 1, (text, again.err)
    (note,) = [line for line in lines if "replaced" in line]
    assert note == (
        f"note: benchmark: replaced small 1.0.0, benchmark_sha256 {sha256}; both have version 1.0.0: raise "
        "`publish.citation.version`"
    )


def test_what_to_do_first_for_recordings_that_are_left_out(
    command: Command, small: Path, tmp_path: Path
) -> None:
    root = copied(small, tmp_path / "b")
    config, strict = root / "benchmark.yaml", ("--set", "publish.gate.min_estimated_iou=1")
    none = command(root, "publish", "--jobs", "1", *strict)
    assert none.status == 1 and "no recording to publish" in none.err, none.err
    first = [line for line in none.err.splitlines() if ": do this first: " in line]
    assert [line.partition(":")[0] for line in first] == ["chair", "table"]
    assert "`kinectbench build table --set publish.gate.min_estimated_iou=1 -v`" in none.err
    accepted = "category: chair, review: {decision: accept, reason: looked at}"
    config.write_text(config.read_text().replace("category: chair", accepted))
    one = command(root, "publish", "--jobs", "1", *strict)
    assert one.status == 3 and [line for line in one.err.splitlines() if "do this first" in line] == first[1:]
    text = first[1].partition("do this first: ")[2]
    assert one.err.count(text) == 1
    shown = "all warnings of a recording are shown by `kinectbench build ID"
    (note,) = [line for line in one.err.splitlines() if shown in line]
    assert f"{shown} --set publish.gate.min_estimated_iou=1 -v`" in note
    rejected = accepted.replace("accept", "reject")
    config.write_text(config.read_text().replace(accepted, rejected))
    both = command(root, "publish", "--jobs", "1", *strict)
    assert [line for line in both.err.splitlines() if "do this first" in line] == first[1:]


def test_what_isolate_leaves_out_is_not_to_be_mended() -> None:
    """One view of an object is published, of whichever recording was drawn; the others are no worse."""

    def built(name: str, pairs: int | None) -> BuiltRecording:
        return BuiltRecording(name, None, (), lambda: model_of(RecordingSummary, pairs=pairs))

    rows = [built("drawn", 3), built("other", 3), built("poor", 3), built("empty", 0)]
    summary = PublishSummary(Path("benchmark"), "", 1, ("drawn",), (), refused=("poor",))
    told = {
        alone: [row.recording for row in to_mend(rows, summary, isolated=alone)] for alone in (True, False)
    }
    assert told == {True: ["poor", "empty"], False: ["other", "poor", "empty"]}
