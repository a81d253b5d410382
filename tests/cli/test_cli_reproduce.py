"""`reproduce paper-real`: from two small recordings to the table in the paper's form, and on after a stop."""

from collections.abc import Callable
from pathlib import Path

import pytest
from small_benchmark import YAML, Run, copied

from kinectbench.release.exchange.recgan import export_recgan, import_recgan
from kinectbench.release.release import open_release
from kinectbench.scoring.published import LABEL, REAL

Command = Callable[..., Run]
ASKED = ("reproduce", "paper-real", "--set", "views.count=3", "--jobs", "1")


@pytest.mark.slow
def test_one_command_makes_the_papers_table(command: Command, small: Path, tmp_path: Path) -> None:
    root = copied(small, tmp_path / "small")
    # The table, in the split validation, has the category of the test pairs: thresholds are by category.
    (root / "benchmark.yaml").write_text(YAML.replace("category: table", "category: chair"))
    run = command(root, *ASKED)
    assert run.status == 0, run.err
    row, of_shell = [line for line in run.out.splitlines() if line.startswith("| recae-small |")]
    assert "**all pairs, the surface alone as truth**" in run.out and row != of_shell
    published = [line for line in run.out.splitlines() if LABEL in line]
    assert len(published) == 2 * len(REAL.rows) and "IoU chair" in run.out
    assert (root / "reproduce/paper-real/table.md").read_text() == run.out
    made = {path: path.stat().st_mtime_ns for path in (root / "reproduce").rglob("*.npz")}
    assert len(made) == 6
    # A second run goes on where there is nothing to do; one that lost a file makes that.
    lost = next(iter(made))
    lost.unlink()
    again = command(root, *ASKED)
    assert (again.status, again.out) == (0, run.out)
    assert {path for path, time in made.items() if path.stat().st_mtime_ns != time} == {lost}
    # The same from a release in the layout of the paper's authors.
    export_recgan(open_release(root / "benchmark"), tmp_path / "theirs")
    import_recgan(tmp_path / "theirs", tmp_path / "imported")
    (tmp_path / "other").mkdir()
    other = command(tmp_path / "other", "reproduce", "paper-real", "--benchmark", "../imported")
    assert other.status == 0 and {row, of_shell} <= {*other.out.splitlines()}


def test_a_release_of_another_protocol_is_refused(command: Command, small: Path, tmp_path: Path) -> None:
    root = copied(small, tmp_path / "small")
    assert command(root, "publish", "--jobs", "1").status == 0
    run = command(root, "reproduce", "paper-real", "--jobs", "1")
    assert run.status == 2 and "Traceback" not in run.err
    (line,) = [line for line in run.err.splitlines() if line.startswith("error")]
    assert "3 views a recording, where the protocol has framing object and 50" in line
