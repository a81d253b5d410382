"""Single figures against values computed by hand."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from analytic_scenes import health_of
from known_builds import T_WORLD_OBJECT, VIEW_FRAMES, Known, chair
from typed import present

from kinectbench.core.artefacts.trajectory import RejectedFrame
from kinectbench.core.geometry import TriangleMesh, rigid, rotation_from_quaternion_xyzw
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.voxels.pair_file import pack
from kinectbench.lab.evaluate.build import BuildRegistration, register_build, true_frames
from kinectbench.lab.evaluate.evaluation import floor_figures, trajectory_figures
from kinectbench.lab.evaluate.measured import MeasuredSurface
from kinectbench.lab.evaluate.pairs import evaluated_pair, mask_figures, pair_figures
from kinectbench.lab.evaluate.refined import refined_figures
from kinectbench.lab.evaluate.solid import grid_iou, share
from kinectbench.lab.evaluate.surface import SurfaceErrors, surface_errors, surface_figures
from kinectbench.lab.simulate.truth import SurfaceTruth, Truth
from kinectbench.settings.models import PairSettings
from kinectbench.stages.pairs import full_shape, make_pair
from kinectbench.stages.sample_views.alignment import ViewAlignment
from kinectbench.stages.segment.find.floor import Floor
from kinectbench.stages.segment.find.planes import floor_frame

HERE = BuildRegistration(np.arange(60), np.ones(60, bool), np.eye(4), True)


def silent(_done: int, _total: int) -> None:
    pass


def test_overlap_by_hand() -> None:
    a = np.array([True, True, False, False])
    assert grid_iou(a, ~a) == 0
    assert grid_iou(a, np.array([True, False, True, False])) == pytest.approx(1 / 3)
    assert grid_iou(a & False, a & False) == 1
    assert share(a, of=np.array([True, False, False, True])) == 0.5
    assert share(a, of=a & False) == 0


def test_a_shift_of_the_world_is_refined_away(perfect: Known, truth: Truth) -> None:
    """A perfect build, 2 mm too low and 1 mm aside: the motion undoes just that."""
    model, placed = perfect.build.model, register_build(perfect.build, truth)
    assert model is not None
    low = rigid(np.eye(3), 0.001 * truth.T_world_object[:3, 0] - 0.002 * truth.T_world_object[:3, 2])
    points, normals = truth.surface.points_world, truth.surface.normals_world
    surface = MeasuredSurface(points, normals, np.ones(len(points), np.bool_))
    moved = replace(placed, T_truth_built=low @ placed.T_truth_built)
    found = refined_figures(model, truth, moved, surface)
    assert found.lifted_m == pytest.approx(0.002, abs=2e-4) and found.turned_rad < 1e-3
    assert found.moved_m == pytest.approx(0.00224, abs=2e-4)
    assert found.measured_distance_m is not None and found.refined_distance_m is not None
    assert found.refined_distance_m < found.measured_distance_m - 0.0005
    placed_well = refined_figures(model, truth, placed, surface)
    assert placed_well.moved_m < 2e-4
    assert found.iou == pytest.approx(placed_well.iou, abs=0.005)
    assert found.refined_distance_m == pytest.approx(placed_well.refined_distance_m, abs=5e-5)


def test_nothing_measured_moves_nothing(perfect: Known, truth: Truth) -> None:
    points, normals = truth.surface.points_world, truth.surface.normals_world
    surface = MeasuredSurface(points, normals, np.zeros(len(points), np.bool_))
    assert perfect.build.model is not None
    found = refined_figures(perfect.build.model, truth, register_build(perfect.build, truth), surface)
    assert (found.moved_m, found.measured_distance_m, found.refined_distance_m) == (0.0, None, None)


def test_surface_figures_by_hand() -> None:
    errors = SurfaceErrors(
        built_m=np.array([0.001, -0.004, 0.006, 0.020]),
        built_visible=np.array([True, True, False, False]),
        true_m=np.array([0.002, 0.004, 0.009, 0.1, 0.1]),
        true_visible=np.array([True, True, True, False, False]),
    )
    figures = surface_figures(errors)
    at_5, at_10 = figures.whole.scores
    assert (at_5.precision, at_5.recall) == (0.5, 0.4) and at_5.f == pytest.approx(0.4 / 0.9)
    assert (at_10.precision, at_10.recall) == (0.75, 0.6)
    assert [(s.precision, s.recall) for s in figures.visible.scores] == [(1, pytest.approx(2 / 3)), (1, 1)]
    assert figures.whole.accuracy and figures.whole.completeness
    assert figures.whole.accuracy.mean_m == pytest.approx(0.031 / 4)
    assert figures.whole.accuracy.rms_m == pytest.approx(np.sqrt((1 + 16 + 36 + 400) / 4) / 1000)
    assert figures.whole.completeness.quantile_90_m == pytest.approx(0.1)
    assert figures.mean_signed_m == pytest.approx(0.023 / 4)
    assert figures.visible_share == 0.6
    unseen = surface_figures(replace(errors, built_visible=np.zeros(4, bool), true_visible=np.zeros(5, bool)))
    assert unseen.visible.accuracy is None
    assert unseen.visible.scores[0].f == 0


def test_a_sphere_of_which_half_was_seen(perfect: Known) -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.3)
    vertices, faces = np.asarray(ball.vertices), np.asarray(ball.faces, np.int32)
    normals = vertices / 0.3
    seen = (vertices[:, 2] > 0).astype(np.uint16)
    truth = replace(
        perfect.truth,
        mesh_world=TriangleMesh(vertices, faces),
        surface=SurfaceTruth(vertices, normals, seen),
    )
    # The lower half is 20 mm too small, the upper one 3 mm too large.
    grown = vertices * np.where(vertices[:, 2:] > 0, 0.303 / 0.3, 0.280 / 0.3)
    errors = surface_errors(TriangleMesh(grown, faces), truth)
    upper = errors.built_visible
    assert np.median(errors.built_m[upper]) == pytest.approx(0.003, abs=1e-4)
    assert np.median(errors.built_m[~upper]) == pytest.approx(-0.020, abs=1e-4)
    figures = surface_figures(errors)
    assert figures.visible.scores[0].f > 0.97  # all but a seam
    assert figures.whole.scores[0].recall == pytest.approx(0.5, abs=0.02)
    # Areas of the two halves of the built sphere.
    assert figures.whole.scores[0].precision == pytest.approx(0.303**2 / (0.303**2 + 0.28**2), abs=0.02)


def test_a_view_that_is_turned_into_the_wrong_place(perfect: Known) -> None:
    view, truth = perfect.build.views[2], perfect.truth  # type: ignore[index]
    shift = rigid(np.eye(3), [0.02, -0.01, 0.015])  # in the camera's axes
    wrong = replace(view, alignment=ViewAlignment(view.alignment.T_world_camera @ shift, 0.0, 0.0))
    lenient = PairSettings(min_containment=0)
    shape = full_shape(perfect.build.model)  # type: ignore[arg-type]
    pair = make_pair(wrong, perfect.sequence, shape, lenient).pair
    assert pair is not None
    T_world_camera = truth.T_world_camera[view.frame]
    row = evaluated_pair(view.name, view.frame, pair, truth, T_world_camera)
    # `full` lies off its place by the shift, turned into the object's axes.
    moved = chair().translate(T_WORLD_OBJECT[:3, :3].T @ T_world_camera[:3, :3] @ -shift[:3, 3])
    exact = (chair() ^ moved).volume() / (chair() + moved).volume()
    assert exact < 0.6
    assert row.iou == pytest.approx(exact, abs=0.003)
    # The depth was taken by the true camera: it lies in the true object all the same.
    assert row.containment == 1
    assert perfect.build.views
    whole = pair_figures(
        replace(perfect.build, pair=lambda name: pair if name == view.name else perfect.pairs[name]),
        truth, register_build(perfect.build, truth), silent,
    )  # fmt: skip
    assert whole.iou and whole.iou.worst_view == view.name
    assert whole.iou.worst == row.iou
    assert whole.iou.mean == pytest.approx((4 + row.iou) / 5, abs=1e-6)


def test_containment_by_hand(perfect: Known) -> None:
    name, truth = "001", perfect.truth
    pair = perfect.pairs[name]
    full = np.unpackbits(pair.full, axis=-1)
    inside = np.argwhere(full.reshape(64, 4, 64, 4, 64, 4).all(axis=(1, 3, 5)))
    cells = np.zeros((256,) * 3, bool)
    for coarse in (inside[0], inside[-1]):
        cells[tuple(coarse * 4 + 1)] = True
    cells[0, 0, 0] = cells[1, 1, 1] = True  # one cell of 64^3, in an empty corner
    assert not full[:8, :8, :8].any()
    changed = replace(pair, partial_256=pack(cells))
    assert evaluated_pair(
        name, 0, changed, truth, truth.T_world_camera[VIEW_FRAMES[1]]
    ).containment == pytest.approx(2 / 3)


def test_masks_by_hand(perfect: Known) -> None:
    views, truth = perfect.build.views, perfect.truth
    assert views
    silhouette = truth.mask(views[0].frame)
    rows = np.arange(len(silhouette))[:, None]
    middle = int(np.median(np.nonzero(silhouette)[0]))
    upper = np.broadcast_to(rows < middle, silhouette.shape)
    half = replace(views[0], mask=silhouette & upper)
    build = replace(perfect.build, views=(half, *views[1:]), valid_depth=lambda _view: upper)
    figures = mask_figures(build, truth, HERE)
    assert figures.mean_valid_iou == 1  # what has depth is right
    assert figures.worst_iou == pytest.approx((silhouette & upper).sum() / silhouette.sum())
    full = mask_figures(replace(build, valid_depth=lambda _view: ~upper | upper), truth, HERE)
    assert full.worst_valid_iou == figures.worst_iou
    assert full.worst_view == "000"
    assert full.mean_valid_iou == pytest.approx((4 + present(figures.worst_iou)) / 5)
    foreign = replace(HERE, shown=np.arange(60) != views[1].frame)
    assert mask_figures(build, truth, foreign).without_truth == ("001",)


def test_floor_by_hand(perfect: Known) -> None:
    truth = perfect.truth
    up, foot = truth.T_world_object[:3, 2], truth.T_world_object[:3, 3]
    tilt = np.radians(1.0)
    normal = np.cos(tilt) * up + np.sin(tilt) * truth.T_world_object[:3, 0]
    plane = np.append(normal, -normal @ (foot + 0.003 * up))
    T_built_truth = rigid(rotation_from_quaternion_xyzw([0.3, -0.2, 0.5, 0.7]), [1.0, -2.0, 0.5])
    here = floor_figures(Floor(plane, floor_frame(plane), 0, 1), truth, HERE)
    assert here.angle_rad == pytest.approx(tilt)
    assert here.height_m == pytest.approx(0.003)
    moved = plane @ np.linalg.inv(T_built_truth)
    there = replace(HERE, T_truth_built=np.asarray(np.linalg.inv(T_built_truth)))
    same = floor_figures(Floor(moved, floor_frame(moved), 0, 1), truth, there)
    assert same.angle_rad == pytest.approx(tilt)
    assert same.height_m == pytest.approx(0.003)


def test_lost_rejected_and_foreign_frames(perfect: Known) -> None:
    trajectory = perfect.build.trajectory
    assert trajectory
    cameras = trajectory.T_world_camera.copy()
    cameras[[4, 9, 10]] = np.nan
    health = health_of(60, rejected=(RejectedFrame(frame=9),))
    true = perfect.truth.T_world_camera.copy()
    true[[10, 20]] = np.nan  # frames of another scene; one of them was lost, the other has a pose
    truth = replace(perfect.truth, T_world_camera=true)
    built = replace(perfect.build, trajectory=replace(trajectory, T_world_camera=cameras, health=health))
    assert built.trajectory
    figures = trajectory_figures(built.trajectory, truth, register_build(built, truth), built.stamps_ns)
    assert (figures.frames, figures.tracked, figures.lost) == (60, 57, (4, 10))
    assert figures.rejected == (9,)
    assert figures.foreign_tracked == (20,)
    assert figures.error and figures.error.matched == 56
    assert figures.error.ate_m.max < 1e-12


def test_two_poses_are_too_few_for_ate_but_align(perfect: Known) -> None:
    trajectory = perfect.build.trajectory
    assert trajectory
    T = rigid(rotation_from_quaternion_xyzw([0.3, -0.2, 0.5, 0.7]), [1.0, -2.0, 0.5])
    cameras = T @ trajectory.T_world_camera
    cameras[2:] = np.nan
    built = replace(perfect.build, trajectory=replace(trajectory, T_world_camera=cameras))
    registration = register_build(built, perfect.truth)
    np.testing.assert_allclose(registration.T_built_truth, T, atol=1e-9)
    of = perfect.truth, registration, built.stamps_ns
    assert trajectory_figures(built.trajectory, *of).error is None  # type: ignore[arg-type]


@pytest.mark.parametrize("late_ms", [0, 28])
def test_the_clock_of_a_given_trajectory_is_judged_by_the_truth(perfect: Known, late_ms: int) -> None:
    trajectory = perfect.build.trajectory
    assert trajectory
    stamps_ns = np.arange(len(trajectory.stamps_ns)) * 33_333_333 + 10**18
    times_s = np.arange(len(stamps_ns)) / 30
    wave_m = np.stack([0.3 * np.sin(2.1 * times_s), 0.2 * np.sin(3.3 * times_s), 0 * times_s], axis=1)
    poses = np.stack([rigid(np.eye(3), point) for point in wave_m])
    truth = replace(perfect.truth, T_world_camera=poses)
    given = GivenTrajectory(stamps_ns + late_ms * 1_000_000, poses)
    figures = trajectory_figures(trajectory, truth, register_build(perfect.build, truth), stamps_ns, given)
    if not late_ms:
        assert figures.given_clock is None
    else:
        assert figures.given_clock and figures.given_clock.late_s == pytest.approx(0.028, abs=0.002)


def test_frames_are_found_by_stamp_or_by_number() -> None:
    truth = 10**18 + np.arange(6) * 33_333_000
    np.testing.assert_array_equal(true_frames(truth[[0, 2, 5]], truth), [0, 2, 5])
    np.testing.assert_array_equal(true_frames(truth[[0, 2]] + np.array([9, 10**8]), truth), [0, 5])
    np.testing.assert_array_equal(true_frames(truth + 10**12, truth), [-1] * 6)
    # A recording without stamps counts its frames in seconds; frame 3 was left out.
    counted = np.array([0, 1, 2, 4]) * 10**9
    np.testing.assert_array_equal(true_frames(counted, truth), [0, 1, 2, 4])
    np.testing.assert_array_equal(true_frames(np.array([7 * 10**9]), truth), [-1])
    np.testing.assert_array_equal(true_frames(counted, np.arange(6) * 10**9), [0, 1, 2, 4])
