"""Predictions with wrong names, or without half of their files: each line has the remedy."""

import re
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from raising import raises
from small_benchmark import Run
from small_grids import small_grids

from kinectbench.core.errors import PredictionError
from kinectbench.release.release import Release
from kinectbench.scoring.predictions import check
from kinectbench.scoring.score import score_methods
from kinectbench.scoring.strays import stray_lines


@pytest.fixture
def folder(release: Release, tmp_path: Path) -> Path:
    """An empty grid for each test pair."""
    return small_grids(release, tmp_path / "mine", value=False)


def test_a_misspelt_name_gets_the_nearest_that_is_missing(
    release: Release, folder: Path, tmp_path: Path
) -> None:
    wanted = {"chair1/000": "chair_01/000", "chair1/001": "chair_01/001", "chair_02_000": "chair_02/000"}
    (folder / "chair_01").rename(folder / "chair1")
    (folder / "table_01" / "000.npy").rename(folder / "table_01" / "first.npy")
    (folder / "chair_02" / "000.npy").rename(folder / "chair_02_000.npy")
    (folder / "zz.npy").touch()
    none = "answers no target of the benchmark;"
    lines = [
        f"{own}.npy: {none} rename it to {name}.npy, the nearest that is missing, or move it away"
        for own, name in wanted.items()
    ]
    lines += [f"{name}.npy: {none} move it away" for name in ("table_01/first", "zz")]
    assert [line for line in check(release, folder) if none in line] == lines
    with raises(
        PredictionError,
        "prediction.malformed",
        match=rf"nothing could be scored.*; chair1/000.npy: {none} rename",
    ):
        score_methods(release, folder, tmp_path / "scores", surface=False)


@pytest.mark.parametrize(
    ("stray", "missing", "advised"),
    [
        (["chair_01/007.npy"], ["chair_01/003"], {}),
        (["chair_01/notes.npy"], ["chair_01/003"], {}),
        (["chair_03/000.npy"], ["chair_02/000"], {}),
        (["chair_a/003.npy"], ["chair_b/003"], {}),
        (["chair1/001.npy"], ["chair_01/000"], {}),
        (
            ["chair1/000.npy", "chair_1/000.npy", "Chair/000.npy"],
            ["chair_01/000"],
            {"chair1/000.npy": "chair_01/000.npy"},
        ),
        (["chair1/000.npy", "chair_01/0.npy"], ["chair_01/000"], {"chair_01/0.npy": "chair_01/000.npy"}),
        (["chair_01/0.npy", "chair_01/v0.npy"], ["chair_01/000"], {"chair_01/0.npy": "chair_01/000.npy"}),
    ],
)
def test_another_view_is_not_advised_and_none_twice(
    stray: list[str], missing: list[str], advised: dict[str, str]
) -> None:
    lines = stray_lines(stray, missing, {"chair_01", "chair_02", "chair_a", "chair_b"})
    assert len(lines) == len(stray)
    found = {name: line.partition("rename it to ")[2] for name, line in zip(stray, lines, strict=True)}
    assert {name: re.split("[,;]", to)[0] for name, to in found.items() if to} == advised


def test_a_folder_with_another_name_is_told_in_one_line() -> None:
    stray = [f"chiar_01/{i:03d}.npy" for i in range(50)] + [f"logs/{i}.txt" for i in range(30)]
    missing = [f"{name}/{i:03d}" for name in ("chair_01", "table_01") for i in range(50)]
    chair, logs = stray_lines(stray, missing, {"chair_01", "table_01"})
    assert chair == (
        "chiar_01/: no recording of the benchmark has this name (50 files); rename it to chair_01/, the "
        "nearest that is missing, or move it away"
    )
    assert logs == "logs/: no recording of the benchmark has this name (30 files); move it away"


@pytest.mark.parametrize("digits", ["0123456789", "abcdefghij"])
def test_misspelt_names_are_compared_with_few(digits: str) -> None:
    names = [f"{i:06d}".translate(str.maketrans("0123456789", digits)) for i in range(20000)]
    recordings = {f"recording_{name}" for name in names}
    stray = [f"recordinh_{name}x/000.npy" for name in names[-30:]]
    start = time.perf_counter()
    stray_lines(stray, [f"{name}/{view:03d}" for name in recordings for view in range(2)], recordings)
    assert time.perf_counter() - start < 3  # 11 s when each was compared with all


def test_score_says_what_to_do_where_predictions_are_missing(
    command: Callable[..., Run], release: Release, folder: Path, tmp_path: Path
) -> None:
    shutil.rmtree(folder / "chair_01")
    words = ("score", str(folder), "--benchmark", str(release.folder), "--no-surface", "--no-baselines")
    done = command(tmp_path, *words, "--jobs", "1")
    line = "mine: note: 2 predictions are missing: add them, or score empty grids there: --missing empty"
    assert done.status == 3 and line in done.err.splitlines()
    done = command(tmp_path, *words, "--jobs", "1", "--missing", "empty")
    assert done.status == 0 and line not in done.err


def four(name: str) -> list[str]:
    return [f"{name}/{index}.npy" for index in range(4)]


UP = "has chair_01/ in it; move what is in it up"
AWAY = "no recording of the benchmark has this name (4 files); move it away"
TO_02 = AWAY.replace("move", "rename it to chair_02/, the nearest that is missing, or move")


@pytest.mark.parametrize(
    ("stray", "answered", "said"),
    [
        (["mine/chair_01/000.npy"], (), {"mine/": UP}),
        ([*four("a/chair_01"), *four("a/chair_02")], (), {"a/": UP}),
        (four("mine/chair_01"), ("chair_01",), {"mine/": AWAY}),
        ([*four("a/chair_01"), *four("b/chair_01")], (), {"a/": UP, "b/": AWAY}),
        (four("chiar_3"), (), {"chiar_3/": AWAY}),
        (four("chiar_02"), (), {"chiar_02/": TO_02}),
        (four("chiar_02"), ("chair_02",), {"chiar_02/": AWAY}),
        ([*four("chiar_02"), *four("chai_02")], (), {"chiar_02/": TO_02, "chai_02/": AWAY}),
        (
            [*four("chiar_02"), "chai_02/000.npy"],
            (),
            {"chiar_02/": TO_02, "chai_02/000.npy": "answers no target of the benchmark; move it away"},
        ),
    ],
)
def test_no_two_folders_are_advised_to_be_one_and_none_to_be_one_that_is_there(
    stray: list[str], answered: tuple[str, ...], said: dict[str, str]
) -> None:
    missing = [f"{name}/{index:03d}" for name in ("chair_01", "chair_02") for index in range(4)]
    lines = stray_lines(stray, missing, {"chair_01", "chair_02"}, answered)
    assert lines == [f"{name}: {words}" for name, words in said.items()]
