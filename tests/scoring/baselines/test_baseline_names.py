"""A user's method may have the name of a baseline; tables call only a baseline's predictions a baseline."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_benchmark import Run
from synthetic_release import RECORDINGS, publish_synthetic

from kinectbench.core import SettingsError
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.release.release import Release, open_release
from kinectbench.report.run import files_in, kept_baselines
from kinectbench.report.space_table import is_baseline
from kinectbench.scoring.api import Scorer
from kinectbench.scoring.baselines.in_grids import score_baselines
from kinectbench.scoring.baselines.predict import write_baselines
from kinectbench.scoring.read_table import read_table
from kinectbench.scoring.recheck import recheck
from kinectbench.scoring.score import score
from kinectbench.scoring.truth import read_parts

Command = Callable[..., Run]
SCORE = ("score", "predictions", "--no-surface", "--no-gallery", "--jobs", "1", "--benchmark")


def own_partial(release: Release, folder: Path) -> Path:
    """The partial views at 64^3, saved by hand; the baseline's are of 256^3."""
    for target in release.targets:
        (partial,) = read_parts(release.pair_path(target), target.sha256, ("partial",))
        path = folder / target.recording / f"{target.view}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, unpack(partial))
    return folder


def test_a_method_and_the_baseline_of_its_name_both_stand_in_the_table(
    command: Command, release: Release, tmp_path: Path
) -> None:
    own_partial(release, tmp_path / "predictions" / "partial")
    write_baselines(release, tmp_path / "predictions", ["hull"])
    done = command(tmp_path, *SCORE, str(release.folder))
    assert done.status == 0, done.err
    lines = [line.split("│")[1:3] for line in done.out.splitlines() if line.startswith("│")]
    cells = {name.strip(): cell.split("/")[0].strip() for name, cell in lines}
    assert cells["partial"] == "0.046" and cells["partial (baseline)"] == "0.001"
    assert "hull" not in cells and "hull (baseline)" in cells
    scores = tmp_path / "scores"
    assert not is_baseline(read_table(scores / "partial" / "scores.json"))
    assert is_baseline(read_table(scores / "hull" / "scores.json"))
    # The page is made of the files alone.
    files, _ = files_in(scores, release.benchmark_sha256)
    beside = [file.table.method for file in kept_baselines(files)]
    assert beside.count("partial") == 1 and "hull" not in beside


@pytest.mark.parametrize("method_json", [True, False])
def test_files_changed_after_baseline_are_no_baseline(
    release: Release, tmp_path: Path, method_json: bool
) -> None:
    write_baselines(release, tmp_path, ["partial"])
    file = tmp_path / "partial" / "method.json"
    assert is_baseline(score(release, tmp_path / "partial", method="partial", surface=False))
    kept = file.read_bytes()
    shutil.rmtree(tmp_path / "partial")
    own_partial(release, tmp_path / "partial")
    if method_json:
        file.write_bytes(kept)
    for protocols in (["known"], ["camera"]):
        table = score(release, tmp_path / "partial", method="partial", protocols=protocols, surface=False)
        assert not is_baseline(table), protocols


def test_a_baseline_with_one_prediction_of_another_is_none(tmp_path: Path) -> None:
    # Of eleven pairs, four would be drawn.
    publish_synthetic(tmp_path, (("chair_01", "chair", "red_chair", "test", 10), *RECORDINGS[2:]))
    release = open_release(tmp_path / "benchmark")
    write_baselines(release, tmp_path / "predictions", ["hull"])
    folder = tmp_path / "predictions" / "hull"
    for changed in range(3):
        for protocols in (["known"], ["camera"]):
            table = score(release, folder, method="hull", protocols=protocols, surface=False)
            assert is_baseline(table) == (not changed), (changed, protocols)
        (folder / "chair_01" / f"{changed:03d}.npz").unlink()
        np.save(folder / "chair_01" / f"{changed:03d}.npy", np.ones((16, 16, 16), bool))


def test_a_baseline_of_which_validation_files_alone_changed_is_none(tmp_path: Path) -> None:
    """They decide the thresholds, and so its scores; thresholds of a file are stated with the table."""
    recordings = (("a", "test", 1), ("b", "validation", 1), ("c", "train", 1), ("d", "train", 1))
    publish_synthetic(
        tmp_path, tuple((name, "chair", name, split, count) for name, split, count in recordings)
    )
    release, out = open_release(tmp_path / "benchmark"), tmp_path / "predictions"
    write_baselines(release, out, ["mean-shape"])

    def called_baseline(protocol: str, **options: object) -> bool:
        folder, how = out / "mean-shape", {"protocols": [protocol], "surface": False}
        return is_baseline(score(release, folder, method="mean-shape", **how, **options))  # type: ignore[arg-type]

    protocols = ("known", "camera")
    assert all(called_baseline(protocol) for protocol in protocols)
    assert called_baseline("known", upsampling="corner-aligned")
    # The ball of b, at which the threshold is best above the half that is around it.
    cells = (np.indices((64, 64, 64)) + 0.5) * 4 - np.array([121, 128, 130]).reshape(3, 1, 1, 1)
    changed = np.where(np.sqrt((cells**2).sum(axis=0)) < 87, 0.9, 0.5).astype(np.float32)
    (out / "mean-shape" / "b" / "000.npz").unlink()
    np.save(out / "mean-shape" / "b" / "000.npy", changed)
    assert not any(called_baseline(protocol) for protocol in protocols)
    thresholds = tmp_path / "thresholds.json"
    thresholds.write_text('{"thresholds": {"chair": 0.5}}')
    assert called_baseline("known", thresholds_file=thresholds)


def test_older_tables_are_of_baselines_by_their_names(release: Release, tmp_path: Path) -> None:
    """Tables that do not state whether they are a baseline's."""
    write_baselines(release, tmp_path / "predictions", ["hull"])
    score(release, tmp_path / "predictions" / "hull", method="hull", surface=False).write(tmp_path / "hull")
    path = tmp_path / "hull" / "scores.json"
    content = json.loads(path.read_text())
    del content["settings"]["baseline_version"]
    path.write_text(json.dumps(content))
    assert is_baseline(read_table(path))
    path.write_text(json.dumps(content | {"method": "net"}))
    assert not is_baseline(read_table(path))
    path.write_text(json.dumps(content))
    assert recheck(release, path, tmp_path / "predictions" / "hull") == []
    score_baselines(release, tmp_path, protocols=["known"], surface=False)
    assert read_table(path).settings.of_baseline


def test_a_scorer_gives_the_table_of_score(release: Release, tmp_path: Path) -> None:
    write_baselines(release, tmp_path, ["empty"])
    table = score(release, tmp_path / "empty", method="empty", protocols=["known"], surface=False)
    scorer = Scorer(release.folder, method="empty", protocols=["known"], surface=False)
    for target in sorted(release.targets, key=lambda of: of.split != "validation"):
        if target.split != "train":
            scorer.update(target.name, np.zeros((16, 16, 16), bool))
    again = scorer.result()
    assert is_baseline(table) and is_baseline(again)
    assert (again.settings, again.warnings) == (table.settings, table.warnings)


def test_a_table_that_says_baseline_is_not_verified(release: Release, tmp_path: Path) -> None:
    folder = own_partial(release, tmp_path / "predictions" / "partial")
    score(release, folder, method="partial", surface=False).write(tmp_path)
    path = tmp_path / "scores.json"
    content = json.loads(path.read_text())
    for forged in ({"baseline": True}, {"settings": content["settings"] | {"baseline_version": 1}}):
        path.write_text(json.dumps(content | forged))
        assert is_baseline(read_table(path))
        assert [line for line in recheck(release, path, folder) if "states that" in line]
    path.write_text(json.dumps(content))
    assert recheck(release, path, folder) == []


def test_baselines_do_not_replace_the_scores_of_a_method_of_their_name(
    release: Release, tmp_path: Path
) -> None:
    folder = own_partial(release, tmp_path / "predictions" / "partial")
    score(release, folder, method="partial", surface=False).write(tmp_path / "partial")
    before = (tmp_path / "partial" / "scores.json").read_bytes()
    with pytest.raises(SettingsError, match=r"named like a baseline.*--out"):
        score_baselines(release, tmp_path, protocols=["known"], surface=False)
    assert (tmp_path / "partial" / "scores.json").read_bytes() == before
