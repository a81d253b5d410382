"""What `check` and `score` say of a folder of several methods before any figure."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_benchmark import Run

from kinectbench.release.release import Release

Command = Callable[..., Run]
PLAIN = ("--no-surface", "--no-baselines")


def method(folder: Path, release: Release) -> Path:
    """One method's predictions, the same grid for each pair."""
    for target in release.targets:
        path = folder / target.recording / f"{target.view}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, np.full((8, 8, 8), 0.25, np.float32))
    return folder


def of_foreign_names(folder: Path) -> None:
    folder.mkdir()
    for name in ("chair_01_000.npy", "chair_01_001.npy"):
        np.save(folder / name, np.zeros((8, 8, 8), bool))


def declared_alone(folder: Path) -> None:
    folder.mkdir()
    (folder / "method.json").write_text('{"name": "net", "frame": "camera"}')


@pytest.mark.parametrize("make", [Path.mkdir, of_foreign_names, declared_alone])
def test_a_method_without_any_prediction_is_named(
    command: Command, release: Release, tmp_path: Path, make: Callable[[Path], None]
) -> None:
    """Beside a method that has some, where nothing else is wrong."""
    method(tmp_path / "all" / "good", release)
    (tmp_path / "all" / ".cache").mkdir()
    (tmp_path / "all" / "notes.txt").touch()
    of = ("all", "--benchmark", str(release.folder), "--jobs", "1")
    assert command(tmp_path, "check", *of).status == 0
    make(tmp_path / "all" / "net")
    words = "net/: no prediction there; expected <recording>/<view>.npy, .npz, .ply or .obj"
    checked = command(tmp_path, "check", *of)
    (line,) = (line for line in checked.err.splitlines() if not line.startswith("note: "))
    assert checked.status == 3 and words in line and line.endswith("such as chair_01/000.npy")
    scored = command(tmp_path, "score", *of, *PLAIN)
    assert scored.status == 0 and f"warning: {words}" in scored.err


def test_an_incomplete_method_does_not_stop_the_comparison_of_others(
    command: Command, release: Release, tmp_path: Path
) -> None:
    for name in ("a", "b", "c"):
        method(tmp_path / "all" / name, release)
    (tmp_path / "all" / "c" / "chair_01" / "000.npy").unlink()
    of = ("--benchmark", str(release.folder), "--jobs", "1", *PLAIN, "--no-gallery")
    assert command(tmp_path, "score", "all", *of).status == 3
    compared = command(tmp_path, "compare", "scores")
    assert compared.status == 3 and "a - b" in compared.out and "c - " not in compared.out
    assert "note: c: left out, some of its pairs are not scored (1 failed): complete it" in compared.err
