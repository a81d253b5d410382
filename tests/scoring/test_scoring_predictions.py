"""Which file answers which target, and everything that is wrong said at once."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from raising import raises

from kinectbench.core.errors import PredictionError
from kinectbench.release.release import Release
from kinectbench.scoring.mesh_prediction import IN_CAMERA
from kinectbench.scoring.predictions import check, check_grids, find_predictions, split_methods
from kinectbench.scoring.score import score

GRID = np.zeros((2, 2, 2), bool)


@pytest.fixture
def folder(tmp_path: Path, release: Release) -> Path:
    """A complete submission for the test split."""
    for target in release.split("test"):
        path = tmp_path / "mine" / target.recording / f"{target.view}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, GRID)
    return tmp_path / "mine"


def test_a_complete_submission(folder: Path, release: Release) -> None:
    seen: list[tuple[int, int]] = []
    assert check_grids(release, folder, lambda done, total: seen.append((done, total)))[0] == []
    assert seen[-1] == (len(release.targets),) * 2
    found = find_predictions(folder, release.split("test"))
    assert len(found.files) == 4 and not found.missing and not found.stray


def test_everything_wrong_at_once(folder: Path, release: Release, tmp_path: Path) -> None:
    np.save(tmp_path / "elsewhere.npy", GRID)
    (folder / "chair_01" / "000.npy").unlink()
    (folder / "chair_01" / "000.npy").symlink_to(tmp_path / "elsewhere.npy")
    np.savez(folder / "chair_01" / "001.npz", GRID)
    (folder / "chair_02" / "000.npy").unlink()
    (folder / "table_01" / "000.npy").write_bytes(b"")
    np.save(folder / "table_01" / "0.npy", GRID)
    (folder / ".DS_Store").write_bytes(b"")
    assert check(release, folder) == [
        "chair_01/000.npy: a link out of the folder; put the file itself",
        "chair_01/001: both .npy and .npz are there; keep one",
        "chair_02/000: no prediction; expected chair_02/000.npy, .npz, .ply or .obj",
        "table_01/000.npy: the file is empty",
        "table_01/0.npy: answers no target of the benchmark; move it away",
    ]


@pytest.mark.parametrize("suffix", [".glb", ".gltf", ".stl", ".off"])
def test_meshes_of_other_kinds_are_told_what_is_read(folder: Path, release: Release, suffix: str) -> None:
    """By `check` and by `score`, also where there is nothing else."""
    for path in folder.rglob("*.npy"):
        path.rename(path.with_suffix(suffix))
    name = f"chair_01/000{suffix}"
    line = f"{name}: no kind of mesh that is read; save it as .ply or .obj, closed, in metres, {IN_CAMERA}"
    assert check(release, folder)[0] == line and len(check(release, folder)) == 4
    assert split_methods(folder, release.targets) == {folder.name: folder}
    table = score(release, folder, method="m", missing="empty")
    assert table.failures[0].reason == line and len(table.failures) == 4 and not table.missing_as_empty


def test_validation_is_all_or_nothing(folder: Path, release: Release) -> None:
    (folder / "chair_03").mkdir()
    np.save(folder / "chair_03" / "000.npy", GRID)
    assert [line.split(":")[0] for line in check(release, folder)] == ["chair_03/001", "table_02/000"]


def test_links(folder: Path, release: Release, tmp_path: Path) -> None:
    shutil.move(folder / "chair_01", tmp_path / "outside")
    (folder / "chair_01").symlink_to(tmp_path / "outside")
    (folder / "table_01" / "000.npy").unlink()
    (folder / "table_01" / "000.npy").symlink_to("000.npy")  # to itself
    (folder / "chair_02" / "000.npy").rename(folder / "chair_02" / "real.npy")
    (folder / "chair_02" / "000.npy").symlink_to("real.npy")  # inside: fine
    found = find_predictions(folder, release.split("test"))
    assert [target.name for target in found.problems] == ["chair_01/000", "chair_01/001", "table_01/000"]
    assert [target.name for target in found.files] == ["chair_02/000"]
    # Of the linked folder each prediction has a line, so that the link itself is none to move away.
    assert found.stray == ("chair_02/real.npy",)


def test_names_that_nearly_fit_are_told_what_to_become(folder: Path, release: Release) -> None:
    (folder / "chair_01" / "000.npy").rename(folder / "chair_01" / "view_0.NPY")
    (folder / "chair_02").rename(folder / "Chair_02")
    (folder / "table_01" / "000.npy").rename(folder / "table_01" / "step1_0.npy")
    strays = check(release, folder)[3:]
    assert [line.partition(": ")[0] for line in strays] == [
        "Chair_02/", "chair_01/view_0.NPY", "table_01/step1_0.npy"
    ]  # fmt: skip
    assert [line.rpartition(" ")[2] for line in strays] == ["chair_02/", "chair_01/000.npy", "away"]
    shutil.rmtree(folder / "chair_01")
    shutil.rmtree(folder / "table_01")
    with raises(PredictionError, "prediction.none", match="Chair_02/.* chair_02/"):
        split_methods(folder, release.targets)
    (folder / "chair_02").symlink_to("nowhere")
    assert check(release, folder)[-1].startswith("chair_02: no folder")


def test_split_methods(folder: Path, release: Release, tmp_path: Path) -> None:
    assert split_methods(folder, release.targets) == {"mine": folder}
    shutil.copytree(folder, tmp_path / "all" / "theirs")
    shutil.copytree(folder, tmp_path / "all" / "ours")
    (tmp_path / "all" / "notes").mkdir()
    methods = split_methods(tmp_path / "all", release.targets)
    assert methods == {name: tmp_path / "all" / name for name in ("ours", "theirs")}
    (tmp_path / "all" / "linked").symlink_to(folder)
    with raises(PredictionError, "prediction.link"):
        split_methods(tmp_path / "all", release.targets)


def test_no_predictions(release: Release, tmp_path: Path) -> None:
    with raises(PredictionError, "prediction.none"):
        split_methods(tmp_path, release.targets)
    (tmp_path / "chair_01").mkdir()
    (tmp_path / "chair_01" / "depth.png").touch()  # a recording
    with raises(PredictionError, "prediction.none"):
        split_methods(tmp_path, release.targets)
    for part in (".", "pairs"):
        with raises(PredictionError, "prediction.no-folder"):
            split_methods(release.folder / part, release.targets)
    for function in (split_methods, find_predictions):
        with raises(PredictionError, "prediction.no-folder"):
            function(tmp_path / "nowhere", release.targets)
        (tmp_path / "file").touch()
        with raises(PredictionError, "prediction.no-folder", match="a file"):
            function(tmp_path / "file", release.targets)
