"""`reproduce paper-real`: from two small recordings to the table in the paper's form, and on after a stop."""

import json
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from shutil import copytree

import pytest
from small_benchmark import YAML, Run, copied, make_benchmark, start

from kinectbench.release.exchange.recgan import export_recgan, import_recgan
from kinectbench.release.release import open_release
from kinectbench.scoring.published import LABEL, REAL

Command = Callable[..., Run]
ASKED = ("reproduce", "paper-real", "--set", "views.count=3", "--jobs", "1")


def made(root: Path) -> dict[Path, int]:
    """When each file of predictions was made."""
    return {path: path.stat().st_mtime_ns for path in (root / "reproduce").rglob("*.npz")}


def recordings_alone(root: Path) -> Path:
    """Two recordings and a benchmark.yaml; nothing was ever built."""
    make_benchmark(root)
    # The table, in the split validation, has the category of the test pairs: thresholds are by category.
    (root / "benchmark.yaml").write_text(YAML.replace("category: table", "category: chair"))
    return root


@pytest.mark.slow
def test_one_command_makes_the_papers_table(command: Command, tmp_path: Path) -> None:
    root = recordings_alone(tmp_path / "small")
    killed = start(root, *ASKED)
    while killed.poll() is None and not made(root):
        time.sleep(0.02)
    os.killpg(killed.pid, signal.SIGKILL)
    killed.communicate()
    assert killed.returncode == -signal.SIGKILL and not (root / "reproduce/paper-real/table.md").exists()
    kept = made(root) | {path: path.stat().st_mtime_ns for path in (root / "benchmark").rglob("*.npz")}
    run = command(root, *ASKED)
    assert run.status == 0, run.err
    assert kept and all(path.stat().st_mtime_ns == time_ns for path, time_ns in kept.items())
    row, of_shell = [line for line in run.out.splitlines() if line.startswith("| recae-small |")]
    assert "**all pairs, the surface alone as truth**" in run.out and row != of_shell
    published = [line for line in run.out.splitlines() if LABEL in line]
    assert len(published) == 2 * len(REAL.rows) and "IoU chair" in run.out
    assert "- The figures are of 3 pairs of small, built of 1 recording; source: unspecified." in run.out
    assert (root / "reproduce/paper-real/table.md").read_text() == run.out
    before = made(root)
    assert len(before) == 6
    # A second run goes on where there is nothing to do; one that lost a file makes that.
    lost = next(iter(before))
    lost.unlink()
    again = command(root, *ASKED)
    assert (again.status, again.out) == (0, run.out)
    assert {path for path, time_ns in before.items() if path.stat().st_mtime_ns != time_ns} == {lost}
    # Predictions of another method that lie there stand in the table.
    predictions = root / "reproduce/paper-real/predictions"
    copytree(predictions / "recae-small", predictions / "mine")
    method = json.loads((predictions / "mine/method.json").read_text())
    (predictions / "mine/method.json").write_text(json.dumps({**method, "name": "mine"}))
    own = command(root, *ASKED)
    assert own.status == 0 and row.replace("recae-small", "mine") in own.out.splitlines()
    # The same from a release in the layout of the paper's authors.
    export_recgan(open_release(root / "benchmark"), tmp_path / "theirs")
    import_recgan(tmp_path / "theirs", tmp_path / "imported")
    (tmp_path / "other").mkdir()
    other = command(tmp_path / "other", "reproduce", "paper-real", "--benchmark", "../imported")
    assert other.status == 0 and {row, of_shell} <= {*other.out.splitlines()}
    assert "which were not built of recordings here but synthesised or imported" in other.out


def test_a_release_of_another_protocol_is_refused(command: Command, small: Path, tmp_path: Path) -> None:
    root = copied(small, tmp_path / "small")
    assert command(root, "publish", "--jobs", "1").status == 0
    run = command(root, "reproduce", "paper-real", "--jobs", "1")
    assert run.status == 2 and "Traceback" not in run.err
    (line,) = [line for line in run.err.splitlines() if line.startswith("error")]
    assert "3 views a recording, where the protocol has framing object and 50" in line
