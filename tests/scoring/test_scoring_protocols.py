"""`measured` and `known-unsaid`: where the pairs tell by what they are known, and only there."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from raising import raises
from synthetic_release import publish_synthetic, told_pair
from typed import present

import kinectbench
from kinectbench.core.errors import ReleaseError, SettingsError, StorageError
from kinectbench.core.storage import sha256_file
from kinectbench.core.voxels.pair_file import Pair, pair_bytes, read_pair, unpack
from kinectbench.release.release import Release, open_release
from kinectbench.scoring.compare import compare
from kinectbench.scoring.protocols import PRIMARY, USUAL, protocols_of
from kinectbench.scoring.read_table import read_table
from kinectbench.scoring.recheck import recheck
from kinectbench.scoring.score import score, score_methods
from kinectbench.scoring.truth import read_packed_truth

CHAIRS = (
    ("chair_01", "chair", "red_chair", "test", 1),
    ("chair_02", "chair", "blue_chair", "test", 1),
    ("chair_03", "chair", "val_chair", "validation", 1),
)
EVERYWHERE = ("paper", "known", "occluded")


def write(release: Release, folder: Path) -> Path:
    """Predictions of 64 cells a side: the shape, moved."""
    for target in release.targets:
        full = unpack(read_pair(release.pair_path(target)).full)
        (folder / target.recording).mkdir(parents=True, exist_ok=True)
        shares = np.roll(full, 5, axis=2).reshape(64, 4, 64, 4, 64, 4).mean(axis=(1, 3, 5))
        np.save(folder / target.recording / f"{target.view}.npy", shares.astype(np.float32))
    return folder


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> Release:
    root = tmp_path_factory.mktemp("told")
    publish_synthetic(root, CHAIRS, told_pair)
    return open_release(root / "benchmark")


@pytest.fixture(scope="module")
def scores(told: Release, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("scores")
    score_methods(told, write(told, root / "moved"), root / "scores", surface=False)
    return root


def masks(pair: Pair) -> dict[str, np.ndarray]:
    assert pair.interior is not None and pair.said is not None
    return {
        "measured": unpack(pair.known & ~pair.interior),
        "known-unsaid": unpack(pair.known & ~pair.said),
    }


def test_rows_are_those_of_their_masks(told: Release, scores: Path) -> None:
    table = read_table(scores / "scores" / "scores.json")
    assert table.settings.protocols == USUAL and table.settings.primary_protocol == PRIMARY
    whole = {row.pair: row for row in table.pairs("paper")}
    for target in told.split("test"):
        pair = read_pair(told.pair_path(target))
        full = unpack(pair.full)
        for protocol, mask in masks(pair).items():
            (row,) = [row for row in table.pairs(protocol) if row.pair == target.name]
            assert row.coverage_voxels == pytest.approx(mask.mean())
            assert row.coverage_shape == pytest.approx((full & mask).sum() / full.sum())
            assert row.unknown_share == whole[row.pair].unknown_share and row.iou != whole[row.pair].iou
            # Counted as `known` is, of a truth that is known there.
            path = told.pair_path(target)
            plain = read_packed_truth(path, target.sha256)
            again = replace(plain, known=np.packbits(mask, axis=-1))
            assert np.array_equal(
                read_packed_truth(path, target.sha256, ("interior", "said")).known, plain.known
            )
            assert row.iou == pytest.approx(iou(scores / "moved", target.name, again, row.threshold))
    by = {name: present(each.coverage_shape) for name, each in present(table.overall).items()}
    assert set(by) == set(table.settings.protocols)
    assert by["measured"] < by["known-unsaid"] < by["known"] < by["paper"]


def iou(folder: Path, name: str, truth: Any, threshold: float) -> float:
    from kinectbench.scoring.counts import occupied

    full, known = unpack(truth.full), unpack(truth.known)
    found = unpack(occupied(np.load(folder / f"{name}.npy"), threshold))
    return float((found & full & known).sum() / ((found | full) & known).sum())


def test_they_are_compared_shown_and_rechecked(
    told: Release, scores: Path, command: Callable[..., Any]
) -> None:
    path = scores / "scores" / "scores.json"
    table = read_table(path)
    other = table.model_copy(update={"method": "other"})
    found = compare([table, other], protocol="measured")
    assert found.protocol == "measured"
    assert recheck(told, path, scores / "moved") == []
    assert read_table(path).verified is not None
    listed = (scores / "scores" / "scores.csv").read_text()
    assert ",measured," in listed and ",known-unsaid," in listed
    page = scores / "page.html"
    run = command(
        scores, "report", "--scores", str(path), "--benchmark", str(told.folder), "--out", str(page)
    )
    assert run.status == 0, run
    shown = set(re.findall("Protocol “([a-z-]+)”", page.read_text()))
    assert shown == set(USUAL)


def test_a_table_that_counts_more_than_is_known_is_refused(scores: Path, tmp_path: Path) -> None:
    table = read_table(scores / "scores" / "scores.json")
    rows = tuple(replace(r, coverage_voxels=1.0) if r.protocol == "measured" else r for r in table.rows)
    table.model_copy(update={"rows": rows}).write(tmp_path)
    with raises(StorageError, "storage.damaged", match="measured"):
        read_table(tmp_path / "scores.json")


def test_pairs_that_do_not_tell_have_the_others(release: Release, tmp_path: Path) -> None:
    assert protocols_of(release, None) == EVERYWHERE
    assert protocols_of(release, ["known"]) == ("known",)
    for name in ("measured", "known-unsaid"):
        line = f"--protocol {name}: the pairs of .* do not say by what they are known"
        with raises(SettingsError, "settings.wrong-value", match=line):
            score(release, write_one(release, tmp_path), method="m", protocols=["known", name])
        with raises(SettingsError, "settings.wrong-value", match=line):
            kinectbench.Scorer(release.folder, protocols=[name])


def write_one(release: Release, folder: Path) -> Path:
    """A folder of predictions, of which nothing is read."""
    target = release.split("test")[0]
    (folder / target.recording).mkdir(exist_ok=True)
    np.save(folder / target.recording / f"{target.view}.npy", np.zeros((1, 1, 1), np.float32))
    return folder


def test_one_recording_that_does_not_tell_takes_them_from_all(told: Release, tmp_path: Path) -> None:
    target = told.split("test")[-1]
    other = replace(read_pair(told.pair_path(target)), interior=None)
    path = tmp_path / target.file
    path.parent.mkdir(parents=True)
    path.write_bytes(pair_bytes(other))
    for each in told.targets:
        if each != target:
            (tmp_path / each.file).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / each.file).write_bytes(told.pair_path(each).read_bytes())
    targets = tuple(replace(t, sha256=sha256_file(tmp_path / t.file)) for t in told.targets)
    mixed = replace(told, folder=tmp_path, targets=targets)
    assert protocols_of(mixed, None) == (*EVERYWHERE, "known-unsaid")
    with raises(SettingsError, "settings.wrong-value", match=f"of {target.recording} do"):
        protocols_of(mixed, ["measured"])
    with raises(ReleaseError, "release.damaged", match="'interior'"):
        read_packed_truth(path, targets[told.targets.index(target)].sha256, ("interior",))
