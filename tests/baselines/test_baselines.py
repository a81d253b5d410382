"""The baselines: hulls against every half-space, files that the scorer accepts, figures that can be known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from synthetic_release import ball, synthetic_pair

from kinectbench.baselines.hull import filled_hull
from kinectbench.baselines.registry import BASELINES
from kinectbench.baselines.trivial import constant, empty, partial
from kinectbench.baselines.write import write_baselines
from kinectbench.errors import SettingsError
from kinectbench.release.release import Release
from kinectbench.scoring.check import check
from kinectbench.scoring.prediction_file import load_prediction
from kinectbench.scoring.predictions import split_methods
from kinectbench.scoring.score import score
from kinectbench.voxels.pair_file import pack, unpack

PAIR = synthetic_pair(0, "chair")


@pytest.mark.parametrize("seed", range(6))
def test_hull_is_exact(seed: int) -> None:
    occupied = np.random.default_rng(seed).random((14, 17, 12)) < 0.01 + 0.01 * seed
    cells = np.argwhere(np.ones_like(occupied))
    planes = ConvexHull(np.argwhere(occupied)).equations
    inside = (cells @ planes[:, :3].T + planes[:, 3] <= 1e-9).all(axis=1)
    np.testing.assert_array_equal(filled_hull(occupied).ravel(), inside)


def test_hull_of_a_box_and_of_a_ball() -> None:
    box = np.zeros((20, 20, 20), bool)
    box[3, 4, 5] = box[3, 4, 15] = box[3, 12, 5] = box[10, 4, 5] = box[10, 12, 15] = True
    box[3, 12, 15] = box[10, 4, 15] = box[10, 12, 5] = True
    assert filled_hull(box).sum() == 8 * 9 * 11
    solid = ball((128, 128, 128), 60.3)
    front = solid & ~np.roll(solid, 1, axis=2)
    half = filled_hull(front)
    assert not (half & ~solid).any() and not (front & ~half).any()
    assert half.sum() == pytest.approx(solid.sum() / 2, rel=0.03)


@pytest.mark.parametrize(
    "cells", [[], [(1, 2, 3)], [(1, 2, 3), (4, 4, 4)], [(0, 0, 5), (9, 0, 5), (0, 9, 5), (9, 9, 5)]]
)
def test_flat_partials_are_their_own_hull(cells: list[tuple[int, int, int]]) -> None:
    occupied = np.zeros((10, 10, 10), bool)
    for cell in cells:
        occupied[cell] = True
    np.testing.assert_array_equal(filled_hull(occupied), occupied)


def test_baselines_look_at_the_input_only() -> None:
    nothing = np.zeros_like(PAIR.full)
    blind = replace(PAIR, full=nothing, shell=nothing, known=nothing)
    for name, baseline in BASELINES.items():
        before = pack(unpack(PAIR.partial_256))
        np.testing.assert_array_equal(baseline(blind, 0.1), baseline(PAIR, 0.1), err_msg=name)
        np.testing.assert_array_equal(PAIR.partial_256, before)


def test_trivial() -> None:
    assert not empty(PAIR, 0.3).any()
    assert constant(PAIR, 0.123)[0, 0, 0] == np.float16(0.123)
    assert constant(PAIR, 0.0).min() > 0 and constant(PAIR, 1.0).max() < 1
    np.testing.assert_array_equal(partial(PAIR, 0.3), unpack(PAIR.partial_256))


def test_written_baselines_are_a_valid_submission(release: Release, tmp_path: Path) -> None:
    write_baselines(release, tmp_path / "a")
    methods = split_methods(tmp_path / "a", release.targets)
    assert list(methods) == sorted(BASELINES)
    tables = {}
    for name, folder in methods.items():
        assert check(release, folder) == []
        tables[name] = score(release, folder, method=name)
    rows = {
        (name, row.protocol): row
        for name, table in tables.items()
        for row in table.rows
        if row.category == "chair"
    }
    assert rows["empty", "known"].iou == 0
    constant_row = rows["base-rate", "paper"]
    assert constant_row.ce == pytest.approx(constant_row.base_rate_ce, rel=1e-3)
    assert rows["hull", "known"].iou > rows["partial", "known"].iou > 0
    assert rows["partial", "known"].precision == 1


def test_same_bytes_with_any_number_of_workers(release: Release, tmp_path: Path) -> None:
    names = ["base-rate", "partial"]
    write_baselines(release, tmp_path / "a", names)
    write_baselines(release, tmp_path / "b", names, jobs=2)
    files = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.npz"))
    assert len(files) == 2 * 7
    assert all((tmp_path / "a" / f).read_bytes() == (tmp_path / "b" / f).read_bytes() for f in files)
    assert load_prediction(tmp_path / "a" / files[0]).shape == (16, 16, 16)


def test_unknown_baseline(release: Release, tmp_path: Path) -> None:
    with pytest.raises(
        SettingsError, match="no baseline 'hul': choose among empty, base-rate, partial, hull"
    ):
        write_baselines(release, tmp_path, ["hul"])
