"""Whole builds whose errors are known: perfect, noisy, dilated, partly unknown, of another world."""

from dataclasses import replace

import numpy as np
import pytest
from known_builds import CHAIR, FRAMES, T_WORLD_OBJECT, Known, chair, known_build, noisy
from raising import raises
from typed import present

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.errors import RecordingError
from kinectbench.core.geometry import (
    Grid,
    OrientedBox,
    invert_rigid,
    rigid,
    rotation_from_quaternion_xyzw,
    transform_points,
)
from kinectbench.core.geometry.mesh import box_mesh, join
from kinectbench.lab.evaluate.build import register_build
from kinectbench.lab.evaluate.evaluation import Evaluation, evaluate
from kinectbench.lab.evaluate.solid import (
    EvaluatedSolids,
    canonical_cube,
    compare_on,
    overlap,
    reduced_solids,
)
from kinectbench.lab.evaluate.surface import surface_errors, surface_figures
from kinectbench.lab.simulate.truth import Truth

OTHER_WORLD = rigid(rotation_from_quaternion_xyzw([0.3, -0.2, 0.5, 0.7]), [1.0, -2.0, 0.5])


def centres_object(grid: Grid) -> np.ndarray:
    """(n, n, n, 3) centres of a grid's cells, object frame."""
    cells = (np.moveaxis(np.indices(grid.shape), 0, -1) + 0.5) * grid.voxel_size_m
    return transform_points(invert_rigid(T_WORLD_OBJECT) @ grid.T_world_grid, cells)


def near_chair(points: np.ndarray, distance_m: float) -> np.ndarray:
    """Which points are at most that far from the chair's boxes, by hand."""
    found = np.zeros(points.shape[:-1], bool)
    for low, high in CHAIR:
        outside = np.maximum(np.maximum(np.array(low) - points, points - np.array(high)), 0)
        found |= np.linalg.norm(outside, axis=-1) <= distance_m
    return found


def assert_perfect(evaluation: Evaluation) -> None:
    e = evaluation
    assert e.trajectory and e.trajectory.error and e.floor and e.surface and e.solid and e.masks and e.pairs
    error = e.trajectory.error
    assert error.matched == FRAMES
    assert e.trajectory.tracked_share == 1
    assert e.trajectory.lost == e.trajectory.rejected == e.trajectory.foreign_tracked == ()
    for errors in (error.ate_m, error.rpe_frame_m, error.rpe_frame_rad, error.rpe_metre_m):
        assert errors is not None
        assert errors.max < 1e-12
    assert e.floor.angle_rad < 1e-12
    assert abs(e.floor.height_m) < 1e-12
    for part in (e.surface.whole, e.surface.visible):
        assert part.accuracy and part.completeness
        # The library's distances are float32, and off by up to 0.3 mm beside slivers.
        assert max(part.accuracy.mean_m, part.completeness.mean_m) < 1e-6
        assert [(s.precision, s.recall, s.f) for s in part.scores] == [(1, 1, 1)] * 2
    for grid in (e.solid.fine, e.solid.coarse):
        # The same mesh in another world: a cell may flip whose centre lies on a face to within rounding.
        assert grid.iou > 1 - 1e-6
        assert present(grid.known_iou) > 1 - 1e-6
        assert grid.true_unknown_share == grid.empty_unknown_share == 0
    assert e.solid.built_volume_m3 == pytest.approx(e.solid.true_volume_m3, rel=1e-9)
    assert e.solid.built_outside_share == 0
    assert (e.masks.mean_valid_iou, e.masks.worst_valid_iou, e.masks.mean_iou) == (1, 1, 1)
    assert e.pairs.iou and e.pairs.known_iou and e.pairs.true_unknown_share and e.pairs.containment
    assert min(e.pairs.iou.worst, e.pairs.known_iou.worst) > 1 - 1e-6
    assert e.pairs.true_unknown_share.worst == 0
    assert e.pairs.containment.worst == 1


def test_perfect(perfect: Known) -> None:
    evaluation = evaluate(perfect.build, perfect.truth)
    assert_perfect(evaluation)
    assert evaluation.alignment.moved_m < 1e-12


def test_perfect_in_another_world(truth: Truth) -> None:
    known = known_build(truth, T_built_truth=OTHER_WORLD)
    evaluation = evaluate(known.build, truth)
    assert_perfect(evaluation)
    np.testing.assert_allclose(evaluation.alignment.T_truth_built, invert_rigid(OTHER_WORLD), atol=1e-12)
    assert evaluation.alignment.moved_m == pytest.approx(np.sqrt(1 + 4 + 0.25))
    left = evaluate(replace(known.build, views=None), truth, align=False)
    assert not left.alignment.aligned
    assert left.alignment.moved_m == 0
    assert left.surface and left.surface.whole.scores[1].f == 0
    assert left.masks is None and left.pairs is None
    # The trajectory is aligned for itself.
    assert left.trajectory and left.trajectory.error and left.trajectory.error.ate_m.max < 1e-12


def test_trajectory_noise(perfect: Known) -> None:
    sigma_m, seeds = 0.005, range(6)
    trajectory_only = replace(perfect.build, views=None, model=None)
    evaluations = [evaluate(noisy(trajectory_only, sigma_m, seed), perfect.truth) for seed in seeds]
    errors = [e.trajectory.error for e in evaluations if e.trajectory and e.trajectory.error]
    ate = np.sqrt(np.mean([error.ate_m.rmse**2 for error in errors]))
    # Six of 3 n coordinates are used up by the alignment; one ATE varies by 1 / sqrt(6 n) = 5 %, six by 2 %.
    assert ate == pytest.approx(sigma_m * np.sqrt(3 - 6 / FRAMES), rel=0.05)
    # Two positions differ by twice the variance, in three coordinates.
    rpe = np.sqrt(np.mean([error.rpe_frame_m.rmse**2 for error in errors]))
    assert rpe == pytest.approx(sigma_m * np.sqrt(6), rel=0.05)


def test_dilated_mesh(truth: Truth) -> None:
    known = known_build(truth, dilated_m=0.004)
    evaluation = evaluate(known.build, truth)
    assert evaluation.surface and evaluation.solid and evaluation.pairs and evaluation.pairs.iou
    whole = evaluation.surface.whole
    assert whole.accuracy and whole.completeness
    # Every point of a dilated surface is 4 mm away; the balls are polyhedra.
    assert whole.accuracy.mean_m == pytest.approx(0.004, rel=1e-3)
    assert whole.accuracy.quantile_90_m == pytest.approx(0.004, rel=1e-3)
    assert evaluation.surface.mean_signed_m == pytest.approx(0.004, rel=1e-3)
    # The other way it is farther in concave edges, which are short.
    assert 0.004 - 1e-6 < whole.completeness.mean_m < 0.00402
    assert whole.scores[0].precision == 1
    assert 0.997 < whole.scores[0].f < 1
    assert whole.scores[1].f == 1
    # The exact ratio of the volumes; grids in the object's own axes gain or lose whole layers.
    exact = chair().volume() / chair(0.004).volume()
    assert evaluation.pairs.exact_iou
    assert evaluation.pairs.exact_iou.mean == pytest.approx(exact, abs=0.001)
    # Edges between parts are not judged, where the dilated chair has more of its volume.
    assert exact < evaluation.pairs.iou.mean < exact + 0.01
    assert evaluation.solid.fine.iou == pytest.approx(exact, abs=0.02)
    assert evaluation.solid.built_volume_m3 / evaluation.solid.true_volume_m3 == pytest.approx(1 / exact)
    assert evaluation.pairs.containment and evaluation.pairs.containment.worst == 1
    mesh = known.build.model.shape.mesh if known.build.model else None
    assert mesh is not None
    near = surface_figures(surface_errors(mesh, truth, samples=5000), (0.003, 0.0041)).whole.scores
    assert near[0].f == 0
    assert near[1].f > 0.98


def test_solids_cell_by_cell(truth: Truth) -> None:
    known = known_build(truth, dilated_m=0.004, unknown_above_m=0.4)
    assert known.build.model
    cube = canonical_cube(truth)
    np.testing.assert_allclose(
        centres_object(cube)[0, 0, 0], np.array([-0.005, -0.005, 0.425]) - 127.5 * 0.85 / 252
    )
    # Not every fourth centre, which would lie on the box's ends: a cube of other cells.
    grid = Grid((72, 72, 72), cube.size_m[0] / 72, cube.T_world_grid)
    solids = compare_on(grid, known.build.model, truth, register_build(known.build, truth))
    centres = centres_object(grid)
    np.testing.assert_array_equal(solids.true, near_chair(centres, 0))
    assert np.count_nonzero(solids.built != near_chair(centres, 0.004)) <= 4  # beside the polyhedral balls
    np.testing.assert_array_equal(solids.known, centres[..., 2] < 0.4)


def test_majority_by_hand() -> None:
    true, built, known = np.zeros((3, 8, 8, 8), bool)
    true[:4, :4, :3] = True  # 48 of 64: set
    built[:4, :4, :2] = True  # 32 of 64: a tie, not set
    built[4:, 4:, 4:] = known[:, :, 4:] = True
    judged = np.ones((8, 8, 8), bool)
    judged[4:, :4, :4] = False
    coarse = reduced_solids(EvaluatedSolids(true, built, known, judged, exact=true))
    assert np.argwhere(coarse.true).tolist() == [[0, 0, 0]]
    assert np.argwhere(coarse.built).tolist() == [[1, 1, 1]]
    found = overlap(coarse)
    # None of the true solid is known: nothing can be said of it.
    assert (found.cells, found.iou, found.known_iou) == (2, 0, None)
    assert found.true_unknown_share == 1
    # Of six judged cells that are empty four are known.
    assert found.empty_unknown_share == pytest.approx(2 / 6)


def test_unknown_labels(truth: Truth) -> None:
    evaluation = evaluate(known_build(truth, unknown_above_m=0.4).build, truth)
    assert evaluation.solid and evaluation.pairs and evaluation.pairs.true_unknown_share
    whole = chair()
    above_m3 = whole.trim_by_plane([0, 0, 1], 0.4).volume()
    side_m = 0.85 * 256 / 252
    upper_m3 = (0.425 + side_m / 2 - 0.4) * side_m**2
    exact = above_m3 / whole.volume()
    exact_empty = (upper_m3 - above_m3) / (side_m**3 - whole.volume())
    fine = evaluation.solid.fine
    assert fine.true_unknown_share == pytest.approx(exact, abs=0.01)
    assert fine.empty_unknown_share == pytest.approx(exact_empty, abs=0.005)
    assert evaluation.pairs.true_unknown_share.mean == pytest.approx(exact, abs=0.002)
    assert fine.iou == fine.known_iou == 1  # nothing is wrong with what is known


def test_what_is_guessed_is_not_what_was_measured(perfect: Known, truth: Truth) -> None:
    """A sheet that nobody saw, under the seat, counts in the closed mesh, but not in what was measured."""
    model = perfect.build.model
    assert model is not None
    guessed = box_mesh(OrientedBox((0, 0, 0.25), (0.15, 0.15, 1e-6))).transformed(truth.T_world_object)
    mesh = join([model.shape.mesh, guessed.transformed(register_build(perfect.build, truth).T_built_truth)])
    labels = np.where(model.shape.solid, np.uint8(Label.SURFACE), np.uint8(Label.FREE))
    shape = replace(model.shape, mesh=mesh, labels=labels)
    found = evaluate(replace(perfect.build, model=replace(model, shape=shape)), truth)
    assert found.surface and found.measured
    assert found.surface.whole.scores[0].precision < 0.97
    assert [score.f for score in found.measured.visible.scores] == [1, 1]
    nothing_measured = evaluate(perfect.build, truth)
    assert nothing_measured.measured is None


def test_the_truth_of_another_recording(perfect: Known, truth: Truth) -> None:
    other = replace(truth, stamps_ns=truth.stamps_ns + 10**12)
    with raises(RecordingError, "recording.other-truth"):
        evaluate(perfect.build, other)
