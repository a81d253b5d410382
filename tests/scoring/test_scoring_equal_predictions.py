"""Predictions that say nothing of their view are named by `check`, in as many folders as it is given."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_benchmark import Run

from kinectbench.release.release import Release
from kinectbench.scoring.predictions import check_grids
from kinectbench.scoring.suspicious import content_of, same_lines

Grid = Callable[[int], np.ndarray]
NOISE = np.random.default_rng(0).random((4, 8, 8, 8)).astype(np.float32)


def written(release: Release, folder: Path, grid: Grid) -> Path:
    for number, target in enumerate(release.split("test")):
        path = folder / target.recording / f"{target.view}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, grid(number))
    return folder


SAME: dict[str, tuple[Grid, list[str]]] = {
    "all ones": (
        lambda _: np.ones((8, 8, 8), bool),
        ["4 of 4 predictions are 1 in every cell, such as chair_01/000"],
    ),
    "all zeros, of other sides": (
        lambda number: np.zeros((4 + number,) * 3, np.float32),
        ["4 of 4 predictions are 0 in every cell, such as chair_01/000"],
    ),
    "one grid for all views": (
        lambda _: NOISE[0],
        ["4 of 4 predictions are the same for every view, such as chair_01/000 and chair_01/001"],
    ),
    "two grids in turn": (
        lambda number: NOISE[number % 2],
        ["4 of 4 predictions are the same as for another view, such as chair_01/000 and chair_02/000"],
    ),
    "each its own": (lambda number: NOISE[number], []),
}


@pytest.mark.parametrize("name", SAME)
def test_what_is_constant_or_the_same_is_said_in_one_line(
    release: Release, tmp_path: Path, name: str
) -> None:
    grid, expected = SAME[name]
    assert check_grids(release, written(release, tmp_path / "mine", grid)) == ([], expected)


def test_nan_is_an_error_and_shapes_of_one_content_are_named(release: Release, tmp_path: Path) -> None:
    problems, notes = check_grids(
        release, written(release, tmp_path / "mine", lambda _: np.full((8, 8, 8), np.nan, np.float32))
    )
    assert len(problems) == 4 and notes == []
    points = np.zeros((3, 3))
    of = {"a/0": content_of(points, np.zeros((0, 3))), "a/1": content_of(points, np.zeros((0, 3)))}
    assert list(same_lines(of)) == ["2 of 2 predictions are the same for every view, such as a/0 and a/1"]


def test_several_folders_are_checked_in_turn(
    release: Release, tmp_path: Path, command: Callable[..., Run]
) -> None:
    ones = written(release, tmp_path / "ones", lambda _: np.ones((8, 8, 8), bool))
    own = written(release, tmp_path / "own", lambda number: NOISE[number])
    done = command(tmp_path, "check", str(ones), str(own), "--benchmark", str(release.folder))
    assert done.status == 0 and "all well" in done.out
    assert "note: ones: 4 of 4 predictions are 1 in every cell, such as chair_01/000" in done.err
    (own / "stray.txt").write_text("")
    done = command(tmp_path, "check", str(ones), str(own), "--benchmark", str(release.folder))
    assert done.status == 3 and "own: stray.txt: answers no target" in done.err
