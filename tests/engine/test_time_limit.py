"""A recording that takes longer than it may fails by itself, and what comes after it is left alone."""

import json
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path, PosixPath
from typing import Any

import pytest
from raising import raises
from slow import slow
from small_benchmark import Run, copied, hashes, leftovers
from test_many_recordings import Listener

from kinectbench.engine import steps
from kinectbench.engine import time_limit as module
from kinectbench.engine.cluster import cluster
from kinectbench.engine.parallel import build
from kinectbench.engine.stage_settings import Work
from kinectbench.engine.stages import Job
from kinectbench.engine.time_limit import TimeLimitError, time_limit, watched
from kinectbench.settings.file import load_benchmark

Command = Callable[..., Run]


@pytest.mark.parametrize("limit_s", [1e10, float("inf")])
def test_a_limit_that_no_timer_can_wait_for_is_none(limit_s: float) -> None:
    said: list[int] = []
    with time_limit(limit_s, lambda stage, done, total: said.append(done)) as report:
        report("fuse", 1, 1)
    assert said == [1]


def test_what_takes_too_long_is_stopped_at_its_next_report() -> None:
    said: list[int] = []
    match = r"fuse: took longer than --time-limit 0\.3 \(seconds\)"
    with (
        raises(TimeLimitError, "run.time-limit", match=match),
        time_limit(0.3, lambda stage, done, total: said.append(done)) as report,
    ):
        for done in range(100):
            report("fuse", done, 100)
            time.sleep(0.1)
    assert said == list(range(len(said))) and 1 <= len(said) <= 4


def test_without_a_limit_or_in_time_nothing_is_stopped() -> None:
    said: list[str] = []
    for limit_s in (None, 60.0):
        with time_limit(limit_s, lambda stage, done, total: said.append(stage)) as report:
            report("fuse", 0, 1)
    assert said == ["fuse", "fuse"]


HANGS = """
import time
from multiprocessing import get_context
from kinectbench.engine import time_limit

def hang_on(hung):
    with time_limit.time_limit(0.1, lambda *_: None, hung) as report:
        report("fuse", 0, 1)
        time.sleep(60)

def hang():
    time_limit.HANG_S = time_limit.HAND_OVER_S = 0.2
    print(time_limit.watched(hang_on), flush=True)
    time.sleep(60)

if __name__ == "__main__":
    process = get_context("spawn").Process(target=hang)
    process.start()
    process.join()
    print("ended by", process.exitcode)
"""


def test_a_worker_process_that_hangs_is_ended(tmp_path: Path) -> None:
    (tmp_path / "hangs.py").write_text(HANGS)
    done = subprocess.run([sys.executable, tmp_path / "hangs.py"], capture_output=True, text=True, timeout=50)
    said, end = done.stdout.splitlines()
    assert "fuse: hangs: did not end or go on for 0.4 s, with --time-limit 0.1 (seconds)" in said, done
    assert end == "ended by 1", done


@pytest.mark.parametrize("error", [None, TimeLimitError("late")])
def test_what_is_watched_ends_as_it_does(error: Exception | None) -> None:
    def work(hung: object) -> int:
        if error is not None:
            raise error
        return 3

    with pytest.raises(TimeLimitError, match="late") if error else nullcontext():
        assert watched(work) == 3


LIMIT_S = 60.0


class Hanging(PosixPath):
    """Where a recording hangs in its last stage, in whatever process unpickles this path."""

    def __reduce__(self) -> tuple[Callable[[str], Path], tuple[str]]:
        return hanging, (str(self),)


def hanging(root: str) -> Path:
    # Long before the limit, which the recording beside it must keep also on a machine with other work.
    module.HANG_S, module.HAND_OVER_S = 5 - 2 * LIMIT_S, 5.0
    steps.STEPS = {**steps.STEPS, "pairs": hang}
    return Path(root)


def hang(work: Work[Any]) -> None:
    work.progress(3, 7)
    time.sleep(600)


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("place", ["processes", slow("cluster")])
@pytest.mark.xdist_group("resume")
def test_a_recording_that_hangs_fails_with_the_reason_and_once(
    place: str, small: Path, tmp_path: Path
) -> None:
    root = copied(small, tmp_path / "b")
    settings = load_benchmark(root / "benchmark.yaml", ())
    chair, table = (Job(settings, recording, root) for recording in settings.recordings)
    hangs, listener = replace(chair, root=Hanging(root)), Listener()
    with cluster("local:2") if place == "cluster" else nullcontext() as where:
        outcomes = build([hangs, table], "pairs", ("pairs",), 2, listener, limit_s=LIMIT_S, executor=where)
    wanted = "pairs: hangs: did not end or go on for 5 s, with --time-limit 60 (seconds)"
    assert outcomes[0].error is not None and outcomes[0].error.startswith(wanted)
    assert json.loads((root / "build" / "chair" / "failed.json").read_text())["error"] == outcomes[0].error
    assert outcomes[1].error is None and outcomes[1].made == ("pairs",)
    assert hashes(root / "build" / "table") == hashes(small / "build" / "table")
    # It hung once only: no other attempt is told. What is beside it begins again if it has not ended.
    assert all("those beside it begin again" in line for line in listener.warnings), listener.warnings
    assert build([chair])[0].error is None and leftovers(root) == []


@pytest.mark.xdist_group("resume")
def test_a_recording_that_takes_too_long_fails_and_is_tried_again(
    command: Command, small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = copied(small, tmp_path / "b")
    with monkeypatch.context() as patched:
        patched.setitem(steps.STEPS, "pairs", slowly)
        result = command(root, "pairs", "chair", "--force", "--time-limit", "1", "--jobs", "1")
    assert result.status == 1 and "chair: error: pairs: took longer than --time-limit 1" in result.err
    assert leftovers(root) == []
    assert command(root, "pairs", "chair", "--jobs", "1").status == 0


def slowly(work: Work[Any]) -> None:
    for done in range(600):
        work.progress(done, 600)
        time.sleep(0.1)
