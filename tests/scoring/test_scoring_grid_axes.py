"""Grids with other axes than those of the pairs are named by what the views measured; no right ones are."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from made_once import made_once
from scipy import ndimage
from small_benchmark import Run

from kinectbench.core.types import Bools, Float32
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.lab.synthesize.models import SynthesisSettings
from kinectbench.lab.synthesize.synthesize import synthesize
from kinectbench.release.release import Release, open_release
from kinectbench.scoring.baselines.predict import BaselineTask, predicted
from kinectbench.scoring.counts import Prediction, reduced
from kinectbench.scoring.grid_axes import ALL_AXES, axes_problem
from kinectbench.scoring.predictions import check
from kinectbench.scoring.truth import read_parts

# The orders of the axes and what a line calls them; flips.
ORDERS = {(2, 1, 0): "z, y, x", (1, 0, 2): "y, x, z", (0, 2, 1): "x, z, y", (1, 2, 0): "y, z, x"}
FLIPS = {0: "-x, y, z", 1: "x, -y, z", 2: "x, y, -z"}


def chairs(folder: Path) -> None:
    """Ten views of a drawn chair, with the depth of a Kinect."""
    drawn = SynthesisSettings(
        categories=("chair",), train=0, validation=0, test=1, most_views=5, noise="kinect", framing="view"
    )
    synthesize(drawn, folder / "benchmark")


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Release:
    return open_release(made_once(tmp_path_factory, "axes", chairs) / "benchmark")


@pytest.fixture(scope="module")
def truths(views: Release) -> list[tuple[Bools, Bools]]:
    """Each view's `full` and `partial_256`."""
    parts = [read_parts(views.pair_path(t), t.sha256, ("full", "partial_256")) for t in views.targets]
    assert len(parts) == 10
    return [(unpack(full), unpack(partial)) for full, partial in parts]


def coarse(full: Bools, cells: int = 32) -> Float32:
    return reduced(full, cells).astype(np.float32)


def test_every_order_and_flip_is_named(truths: list[tuple[Bools, Bools]]) -> None:
    for order, name in ORDERS.items():
        line = axes_problem([(full.transpose(order), partial) for full, partial in truths])
        back = ", ".join(map(str, np.argsort(order)))
        assert line == (
            f"the grids agree with their views' own depth if their axes are taken as {name}, in 10 of 10 "
            f"views; of arrays write grid.transpose({back})"
        )
    for axis, name in FLIPS.items():
        line = axes_problem([(np.flip(full, axis), partial) for full, partial in truths])
        back = ", ".join("::-1" if axis == other else ":" for other in range(3))
        assert line is not None and line.endswith(f"of arrays write grid[{back}]")
        assert f"taken as {name} (-: turned round)" in line


def test_grids_whose_empty_and_occupied_are_exchanged_are_named(truths: list[tuple[Bools, Bools]]) -> None:
    for wrong in (lambda full: ~full, lambda full: 1 - coarse(full), lambda full: 0.9 - 0.8 * coarse(full)):
        line = axes_problem([(wrong(full), partial) for full, partial in truths])
        assert line is not None and line.endswith("in 10 of 10 views; of arrays write 1 - grid")
    for cells in (6, 10, 18):  # nearer to the camera than what it measured: another fault
        near = [(np.roll(full, -cells, 2), partial) for full, partial in truths]
        assert "1 - grid" not in (axes_problem(near) or "")


def test_grids_that_lie_elsewhere_are_named(truths: list[tuple[Bools, Bools]]) -> None:
    for wrong in (
        lambda full: np.pad(full[::2, ::2, ::2], ((0, 128),) * 3),
        lambda full: np.pad(coarse(full, 64), ((0, 64),) * 3).astype(np.float16),
    ):
        line = axes_problem([(wrong(full), partial) for full, partial in truths])
        assert line is not None and "views the grids are empty near what the view measured" in line


def test_unsure_grids_in_their_place_are_not_named(truths: list[tuple[Bools, Bools]]) -> None:
    """A shape of low probability with one sure cell, and one whose probability grows with its depth."""

    def spiked(full: Bools, low: float) -> Float32:
        grid = low * coarse(full)
        grid[tuple(np.argwhere(grid > 0)[0])] = 1
        return grid

    def deep(full: Bools) -> Float32:
        grid = coarse(full) > 0.5
        depth_cells = ndimage.distance_transform_edt(grid)
        return np.where(grid, 1 / (1 + np.exp(3 - depth_cells)), 0).astype(np.float32)

    for made in (lambda full: spiked(full, 0.28), lambda full: spiked(full, 0.1), deep):
        assert axes_problem([(made(full), partial) for full, partial in truths]) is None


@pytest.mark.slow
def test_all_axes_are_named_and_the_remedy_brings_them_back(truths: list[tuple[Bools, Bools]]) -> None:
    right = [(coarse(full), partial) for full, partial in truths]
    for order, turned in ALL_AXES[1:]:
        flipped = [axis for axis in range(3) if turned[axis]]
        wrong = [(np.flip(grid, tuple(flipped)).transpose(order), partial) for grid, partial in right]
        line = axes_problem(wrong)
        assert line is not None, (order, turned)
        remedy = line.split("of arrays write ")[1]
        for (grid, _), (expected, _) in zip(wrong, right, strict=True):
            assert np.array_equal(eval(remedy, {"grid": grid}), expected), (order, turned, line)


def test_right_predictions_are_not_named_however_poor(
    truths: list[tuple[Bools, Bools]], views: Release
) -> None:
    names = ("partial", "hull", "silhouette")
    made: dict[str, list[tuple[Prediction, Bools]]] = {}
    noise = np.random.default_rng(0)
    for target, (full, partial) in zip(views.targets, truths, strict=True):
        poor: dict[str, Prediction] = dict(predicted(BaselineTask(views, target, 0.1, names)))
        poor |= {"true": full, "few cells": coarse(full, 8), "moved": np.roll(full, 10, 2)}
        poor |= {"noisy": (0.2 * coarse(full, 64) + 0.2 * noise.random((64,) * 3)).astype(np.float32)}
        poor |= {"noise": noise.random((32,) * 3, np.float32), "empty": np.zeros((8,) * 3, bool)}
        poor |= {"everywhere": np.full((4,) * 3, 0.3, np.float32)}
        for name, grid in poor.items():
            made.setdefault(name, []).append((grid, partial))
    assert {name: line for name, of in made.items() if (line := axes_problem(of))} == {}
    for name in ("partial", "hull", "silhouette", "noisy"):
        line = axes_problem([(grid.transpose(2, 1, 0), partial) for grid, partial in made[name]])
        assert line is not None and "taken as z, y, x," in line, name


def test_a_symmetric_prediction_is_not_accused_of_what_changes_nothing() -> None:
    """A ball fits with all axes; a roof that stands askew in depth fits as well with left for right."""
    x, y, z = np.ogrid[-127.5:128, -127.5:128, -127.5:128]
    ball: Bools = x**2 + y**2 + z**2 < 90**2
    roof: Bools = (np.abs(x) < 100) & (np.abs(y) < 40) & (z > 0.5 * y) & (z < 90)
    for solid, named in ((ball, None), (roof, "x, -y, z (-")):
        seen = solid & (np.cumsum(solid, axis=2) == 1)
        assert axes_problem([(solid, seen)] * 10) is None
        assert axes_problem([(solid[::-1], seen)] * 10) is None
        line = axes_problem([(solid[::-1, ::-1], seen)] * 10)
        assert line is None if named is None else line is not None and f"taken as {named}" in line


def test_of_few_views_nothing_is_said(truths: list[tuple[Bools, Bools]]) -> None:
    assert axes_problem([(full.transpose(2, 1, 0), partial) for full, partial in truths[:9]]) is None


def test_check_names_the_axes_beside_other_faults(
    views: Release, truths: list[tuple[Bools, Bools]], tmp_path: Path
) -> None:
    for target, (full, _) in zip(views.targets, truths, strict=True):
        path = tmp_path / f"{target.name}.npy"
        path.parent.mkdir(exist_ok=True)
        np.save(path, coarse(full))
    assert check(views, tmp_path) == []
    for path in tmp_path.rglob("*.npy"):
        np.save(path, np.load(path).transpose(2, 0, 1).copy())
    (tmp_path / "notes.txt").touch()
    line, stray = check(views, tmp_path)
    assert "taken as z, x, y, in 10 of 10 views" in line and stray.startswith("notes.txt: answers no target")


def test_score_warns_and_scores(
    views: Release, truths: list[tuple[Bools, Bools]], tmp_path: Path, command: Callable[..., Run]
) -> None:
    for target, (full, _) in zip(views.targets, truths, strict=True):
        path = tmp_path / "net" / f"{target.name}.npy"
        path.parent.mkdir(exist_ok=True, parents=True)
        np.save(path, 1 - coarse(full))
    options = ("--no-baselines", "--no-gallery", "--no-surface")
    scored = command(tmp_path, "score", "net", "--benchmark", str(views.folder), *options)
    assert scored.status == 0
    warned = " ".join(scored.err.split())
    assert "net: warning: the grids agree with their views' own depth if empty and occupied" in warned
