"""A recording that takes longer than it may fails by itself, and what comes after it is left alone."""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from small_benchmark import Run, copied, leftovers

from kinectbench.engine import steps
from kinectbench.engine.time_limit import TimeLimitError, time_limit

Command = Callable[..., Run]


def test_what_takes_too_long_is_stopped_at_its_next_report() -> None:
    said: list[int] = []
    match = r"fuse: took longer than --time-limit 0\.3 \(seconds\)"
    with (
        pytest.raises(TimeLimitError, match=match),
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

def hang():
    time_limit.HANG_S = 0.2
    with time_limit.time_limit(0.1, print):
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
    assert done.stdout == "ended by 1\n", done


@pytest.mark.xdist_group("resume")
def test_a_recording_that_takes_too_long_fails_and_is_tried_again(
    command: Command, small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = copied(small, tmp_path / "b")
    with monkeypatch.context() as patched:
        patched.setitem(steps.STEPS, "pairs", slow)  # type: ignore[arg-type]
        result = command(root, "pairs", "chair", "--force", "--time-limit", "1", "--jobs", "1")
    assert result.status == 1 and "chair: error: pairs: took longer than --time-limit 1" in result.err
    assert leftovers(root) == []
    assert command(root, "pairs", "chair", "--jobs", "1").status == 0


def slow(job: object, folder: Path, progress: Callable[[int, int], None]) -> None:
    for done in range(600):
        progress(done, 600)
        time.sleep(0.1)
