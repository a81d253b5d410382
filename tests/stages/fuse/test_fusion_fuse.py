"""The stage `fuse` and `observe`: analytic shapes seen by exact depth."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from analytic_scenes import (
    CAMERA,
    FurnitureFrames,
    box,
    depth_of,
    plane,
    ring,
    scene_of,
    sequence_of,
    sphere,
    trajectory_of,
)
from object_checks import closed
from raising import raises

from kinectbench.core.errors import TrackingError
from kinectbench.core.geometry import Grid, rigid, rotation_from_quaternion_xyzw
from kinectbench.core.geometry.depth import depth_sigma_m
from kinectbench.core.geometry.mesh import TriangleMesh
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import UNCHECKED_POSE_SIGMA_M, Trajectory
from kinectbench.core.voxels.observation import merge
from kinectbench.lab.simulate.path import look_at
from kinectbench.settings.models import FusionSettings, TrackingSettings
from kinectbench.stages.fuse import fuse
from kinectbench.stages.fuse.mesh import extract_mesh
from kinectbench.stages.fuse.reconstruction import observe, scene_voxel_size_m, write_reconstruction

SETTINGS = FusionSettings(scene_voxel_size_m=0.005)
CENTER, RADIUS_M = (0.01, -0.02, 0.03), 0.2


@pytest.fixture(scope="module")
def ball() -> tuple[Sequence, Trajectory]:
    poses = ring(20, 0.75, CENTER, (0.3, -0.5, 0.9, -1.1))
    return scene_of([sphere(CENTER, RADIUS_M)], poses)


@pytest.fixture(scope="module")
def ball_mesh(ball: tuple[Sequence, Trajectory]) -> TriangleMesh:
    return fuse(*ball, SETTINGS).mesh


def test_sphere_within_the_bar(ball_mesh: TriangleMesh) -> None:
    error_mm = 1000 * (np.linalg.norm(ball_mesh.vertices - CENTER, axis=1) - RADIUS_M)
    assert abs(error_mm.mean()) <= 0.2
    assert error_mm.std() <= 0.6
    assert np.abs(error_mm).max() < 5


def test_sphere_across_bricks_is_closed_and_outward(ball_mesh: TriangleMesh) -> None:
    mesh = closed(ball_mesh)
    assert mesh.body_count == 1
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * RADIUS_M**3, rel=0.005)
    outward = mesh.triangles_center - CENTER
    cosine = (mesh.face_normals * outward).sum(1) / np.linalg.norm(outward, axis=1)
    assert np.median(cosine) > 0.98 and (cosine > 0).mean() > 0.999


@pytest.mark.parametrize("axis", [0, 1])
def test_sphere_is_where_it_is(axis: int) -> None:
    """From one side only a half-pixel error would shift it across by 1.4 mm."""
    poses = np.stack(
        [look_at(np.array([0.1 * k - 0.2, -0.75, 0.05 * k]) + CENTER, np.array(CENTER)) for k in range(5)]
    )
    mesh = fuse(*scene_of([sphere(CENTER, RADIUS_M)], poses), SETTINGS).mesh
    facing = mesh.vertices[:, 1] - CENTER[1] < -0.7 * RADIUS_M
    offsets = mesh.vertices[facing] - CENTER
    # Least-squares sphere: |p|^2 = 2 c.p + const.
    A = np.column_stack([2 * offsets, np.ones(len(offsets))])
    found = np.linalg.lstsq(A, (offsets**2).sum(1), rcond=None)[0][:3]
    assert abs(found[2 * axis]) < 0.0003


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.1, 0.2, 0.97)])
def test_plane_within_the_bar(normal: tuple[float, float, float]) -> None:
    unit = np.array(normal) / np.linalg.norm(normal)
    turns = np.linspace(0, 6, 10)
    poses = np.stack([look_at(np.array([0.4 * np.cos(a), 0.4 * np.sin(a), 0.9]), np.zeros(3)) for a in turns])
    mesh = fuse(*scene_of([plane(tuple(unit), 0.0123)], poses), SETTINGS).mesh
    error_mm = 1000 * (mesh.vertices @ unit - 0.0123)
    assert len(error_mm) > 10_000
    assert abs(error_mm.mean()) <= 0.2
    assert error_mm.std() <= 0.6


def test_box_faces() -> None:
    """Edges seen at a slant pull a little at the faces beside them (projective distances)."""
    low, high = np.array([-0.2, -0.15, -0.1]), np.array([0.2, 0.15, 0.1])
    poses = ring(16, 0.8, elevations_rad=(0.7, -0.7))
    mesh = fuse(*scene_of([box(tuple(low), tuple(high))], poses), SETTINGS).mesh
    for axis in range(3):
        others = [a for a in range(3) if a != axis]
        inner = np.all(np.abs(mesh.vertices[:, others]) < high[others] - 0.02, axis=1)
        for side in (low, high):
            near = inner & (np.abs(mesh.vertices[:, axis] - side[axis]) < 0.02)
            error_mm = 1000 * (mesh.vertices[near, axis] - side[axis])
            assert near.sum() > 500
            assert abs(error_mm.mean()) <= 0.4 and error_mm.std() <= 0.6


@pytest.mark.parametrize("thick_m", [0.012, 0.016, 0.02])
def test_panels_are_as_thick_as_they_are(thick_m: float) -> None:
    """An upright panel thinner than the truncation: from either side the other's air is hidden."""
    half = np.array([thick_m / 2, 0.25, 0.2])
    panel, poses = box(tuple(-half), tuple(half)), ring(24, 0.9, elevations_rad=(0.1, 0.5, -0.3))
    mesh = fuse(*scene_of([panel], poses), SETTINGS).mesh
    face = np.all(np.abs(mesh.vertices[:, 1:]) < half[1:] - 0.03, axis=1)
    outside_mm = 1000 * (np.abs(mesh.vertices[face, 0]) - half[0])
    assert face.sum() > 5000
    assert abs(outside_mm.mean()) < 0.3 and np.abs(outside_mm).max() < 1.5


def test_noise_makes_a_panel_no_thicker() -> None:
    """With noise of half its thickness each face lies 1.5 mm too far out; cut at 2 sigma, 2.1 mm."""
    half, rng = np.array([0.006, 0.3, 0.25]), np.random.default_rng(3)
    panel, poses = box(tuple(-half), tuple(half)), ring(60, 1.9, elevations_rad=(0.1, 0.5, -0.3))
    exact = [depth_of([panel], CAMERA, T) for T in poses]
    noisy = [
        d + (rng.standard_normal(d.shape) * depth_sigma_m(d) * (d > 0)).astype(np.float32) for d in exact
    ]
    mesh = fuse(sequence_of(noisy, CAMERA, poses), trajectory_of(poses), SETTINGS).mesh
    face = np.all(np.abs(mesh.vertices[:, 1:]) < half[1:] - 0.03, axis=1)
    outside_mm = 1000 * (np.abs(mesh.vertices[face, 0]) - half[0])
    assert face.sum() > 5000
    assert abs(outside_mm.mean()) < 1.7


def test_slats_are_no_thicker_than_they_are() -> None:
    """Two slats, seen from all around also through the gap between them."""
    half = np.array([0.2, 0.02, 0.01])
    centers = np.array([[0, 0, -0.04], [0, 0, 0.04]])
    boxes = [box(tuple(c - half), tuple(c + half)) for c in centers]
    fused = fuse(*scene_of(boxes, ring(24, 0.9, elevations_rad=(0.2, -0.3, 0.8, -0.9))), SETTINGS)
    mesh = extract_mesh(fused.volume, min_weight=0.01, trust=1.0)
    nearest = np.where(mesh.vertices[:, 2:] < 0, centers[0], centers[1])
    beyond_m = np.abs(mesh.vertices - nearest) - half
    outside_mm = 1000 * np.linalg.norm(np.maximum(beyond_m, 0), axis=1)
    assert len(outside_mm) > 3000
    assert outside_mm.mean() < 0.6 and np.quantile(outside_mm, 0.95) < 1.6


def test_depth_out_of_range_is_not_fused(ball: tuple[Sequence, Trajectory]) -> None:
    sequence, trajectory = ball
    near_only = FusionSettings(scene_voxel_size_m=0.01, max_depth_m=0.5)
    assert len(fuse(sequence, trajectory, near_only).mesh.faces) == 0


def test_the_scene_of_a_long_recording_takes_some_of_its_frames() -> None:
    poses = ring(330, 0.75, CENTER, (0.3, -0.5, 0.9, -1.1))
    counts: list[tuple[int, int]] = []
    mesh = fuse(
        *scene_of([sphere(CENTER, RADIUS_M)], poses), SETTINGS, lambda *count: counts.append(count)
    ).mesh
    assert counts[-1] == (300, 300)
    assert abs(1000 * (np.linalg.norm(mesh.vertices - CENTER, axis=1) - RADIUS_M).mean()) <= 0.2


def test_no_poses() -> None:
    sequence = sequence_of([np.ones((240, 320), np.float32)] * 2)
    nowhere = Trajectory(sequence.stamps_ns, np.full((2, 4, 4), np.nan), "trust")
    with raises(TrackingError, "tracking.no-trajectory"):
        fuse(sequence, nowhere, SETTINGS)


def test_same_input_same_bytes(ball: tuple[Sequence, Trajectory], tmp_path: Path) -> None:
    sequence, trajectory = ball
    few = trajectory_of(np.where(np.arange(20)[:, None, None] < 3, trajectory.T_world_camera, np.nan))
    written = []
    for name in ("one", "two"):
        folder = tmp_path / name
        folder.mkdir()
        write_reconstruction(fuse(sequence, few, FusionSettings()), folder)
        written.append({path.name: path.read_bytes() for path in folder.iterdir()})
    assert written[0] == written[1]
    assert set(written[0]) == {"mesh.ply", "reconstruction.json", "volume.npz"}
    with np.load(tmp_path / "one" / "volume.npz") as volume:
        assert volume["tsdf"].shape == volume["free"].shape == (len(volume["blocks"]), 16, 16, 16)


GRID = Grid(
    (96, 96, 96), 0.005, rigid(rotation_from_quaternion_xyzw([0.0, 0.0, 0.3, 0.9]), [0.02, -0.36, -0.21])
)


def test_observe_tells_inside_from_outside(ball: tuple[Sequence, Trajectory]) -> None:
    seen = observe(*ball, range(20), GRID, SETTINGS)
    centers = np.stack(np.meshgrid(*[(np.arange(96) + 0.5) * 0.005] * 3, indexing="ij"), -1)
    world = centers @ GRID.T_world_grid[:3, :3].T + GRID.T_world_grid[:3, 3]
    distance_m = np.linalg.norm(world - CENTER, axis=-1) - RADIUS_M
    assert not seen.weight[distance_m < -0.08].any()
    assert not seen.free[distance_m < -0.004].any()
    near = np.abs(distance_m) < 0.003
    assert (seen.weight[near] > 0).mean() > 0.99
    assert (seen.surface[near] > 0).mean() > 0.99
    judged = (np.abs(distance_m) < 0.02) & (seen.weight > 0)
    assert ((seen.tsdf > 0) == (distance_m > 0))[judged].mean() > 0.98


@pytest.mark.parametrize(("wall_m", "before"), [(2.0, True), (3.1, False)])
def test_depth_out_of_range_is_free_before_it(wall_m: float, before: bool) -> None:
    """A wall beyond the fused range, and one farther away than twice that."""
    sequence = sequence_of([np.full((240, 320), wall_m, np.float32)])
    grid = Grid((16, 16, 120), 0.02, rigid(np.eye(3), [-0.16, -0.16, 0.4]))
    settings = FusionSettings(max_depth_m=1.5)
    seen = observe(sequence, trajectory_of(np.eye(4)[None]), [0], grid, settings)
    z = 0.4 + (np.arange(120) + 0.5) * 0.02
    np.testing.assert_array_equal((seen.free > 0).all(axis=(0, 1)), before & (z <= wall_m - 0.25))
    assert (seen.tsdf[seen.weight > 0] > 0).all() and not seen.surface.any()


def test_merge_of_halves_is_fusing_all(ball: tuple[Sequence, Trajectory]) -> None:
    sequence, trajectory = ball
    halves = [observe(sequence, trajectory, range(start, 20, 2), GRID, SETTINGS) for start in (0, 1)]
    whole, together = observe(sequence, trajectory, range(20), GRID, SETTINGS), merge(*halves)
    np.testing.assert_array_equal(together.free, whole.free)
    np.testing.assert_array_equal(together.surface, whole.surface)
    # What is hidden in part has a weight by its mean distance.
    np.testing.assert_allclose(together.weight, whole.weight, rtol=1e-3)
    np.testing.assert_allclose(together.tsdf, whole.tsdf, atol=1e-6)
    assert not together.tsdf[together.weight == 0].any()


def test_uncertain_poses_weigh_less_and_widen_the_band(ball: tuple[Sequence, Trajectory]) -> None:
    """A frame whose pose may be off by s gets 1 / (sigma(d)^2 + s^2), and truncation at least 3 s."""
    sequence, trajectory = ball
    unsure = replace(trajectory, pose_sigma_m=np.array([0.0, 0.009] + 18 * [np.nan]))
    assert [unsure.assumed_pose_sigma_m(frame) for frame in range(4)] == [0.0, 0.009, 0.02, 0.02]
    sure_seen = observe(sequence, trajectory, [1], GRID, SETTINGS)
    unsure_seen = observe(sequence, unsure, [1], GRID, SETTINGS)
    both = (sure_seen.weight > 0) & (unsure_seen.weight > 0)
    ratio = np.median(unsure_seen.weight[both] / sure_seen.weight[both])
    sigma_m = depth_sigma_m(0.6)  # about the distance of the ball's near side
    assert ratio == pytest.approx(sigma_m**2 / (sigma_m**2 + 0.009**2), rel=0.15)
    shaky = replace(trajectory, pose_sigma_m=np.full(20, 0.015))
    assert observe(sequence, shaky, [1], GRID, SETTINGS).tsdf.min() == pytest.approx(-0.045, abs=0.001)
    assert sure_seen.tsdf.min() == pytest.approx(-0.02, abs=0.001)


def test_an_unchecked_pose_weighs_as_the_largest_plausible_error(ball: tuple[Sequence, Trajectory]) -> None:
    """A frame without a figure weighs as 20 mm; its votes and the truncation are those of a usual frame."""
    sequence, trajectory = ball
    assert UNCHECKED_POSE_SIGMA_M * 1000 == 20 and TrackingSettings().max_disagreement_m > 0.02
    sigma_m = np.where(np.arange(20) == 1, np.nan, 0.002)
    largest_m = np.where(np.arange(20) == 1, 0.02, 0.002)
    seen, as_largest = (
        observe(sequence, replace(trajectory, pose_sigma_m=each), [1], GRID, SETTINGS)
        for each in (sigma_m, largest_m)
    )
    # What lies beside a surface fades with the width of the votes.
    at_surface = np.abs(seen.tsdf) < 0.004
    np.testing.assert_array_equal(seen.weight[at_surface], as_largest.weight[at_surface])
    np.testing.assert_allclose(seen.tsdf, as_largest.tsdf, atol=1e-8)
    as_usual = observe(sequence, replace(trajectory, pose_sigma_m=np.full(20, 0.002)), [1], GRID, SETTINGS)
    np.testing.assert_array_equal(seen.free, as_usual.free)
    assert (seen.free > 0).sum() > (as_largest.free > 0).sum()
    checked = observe(sequence, replace(trajectory, pose_sigma_m=sigma_m), [2], GRID, SETTINGS)
    assert 0 < seen.weight.max() < checked.weight.max() / 20


def test_usual_pose_error_is_of_checked_poses(ball: tuple[Sequence, Trajectory]) -> None:
    """Poses without a figure neither lower nor raise the median; without any figure there is none."""
    sequence, trajectory = ball
    sigma_m = np.where(np.arange(20) < 3, 0.004, np.nan)
    assert replace(trajectory, pose_sigma_m=sigma_m).median_pose_sigma_m == pytest.approx(0.004)
    unchecked = replace(trajectory, pose_sigma_m=np.full(20, np.nan))
    assert unchecked.median_pose_sigma_m is None
    # No frame is better than another: their depth alone weighs, and the truncation stays four voxels.
    exact = replace(trajectory, pose_sigma_m=np.zeros(20))
    seen, of_exact = (observe(sequence, each, [1], GRID, SETTINGS) for each in (unchecked, exact))
    np.testing.assert_array_equal(seen.weight, of_exact.weight)
    np.testing.assert_array_equal(seen.free, of_exact.free)
    assert seen.tsdf.min() == pytest.approx(-0.02, abs=0.001)


def test_vertices_take_the_colour_of_what_they_show() -> None:
    """A red box and a green floor; each pixel has the colour of the surface it measures."""
    surfaces = [box((-0.15, -0.15, 0.0), (0.15, 0.15, 0.3)), plane((0.0, 0.0, 1.0), 0.0)]
    poses = ring(8, 1.1, (0, 0, 0.15), (0.5,))
    depths, colors = [], []
    for T in poses:
        depth_m = depth_of(surfaces, CAMERA, T)
        depth_m[depth_m > 3] = 0
        on_box = np.abs(depth_of(surfaces[:1], CAMERA, T) - depth_m) < 1e-6
        bgr = np.where((on_box & (depth_m > 0))[..., None], [0, 0, 200], [0, 160, 0]).astype(np.uint8)
        depths.append(depth_m)
        colors.append(cv2.imencode(".png", bgr)[1].tobytes())
    plain = sequence_of(depths)
    native = [plain.frames.depth_native(i) for i in range(8)]
    frames = FurnitureFrames(native, colors)
    colored = Sequence(CAMERA, plain.depth_scale, plain.stamps_ns, True, None, frames)
    coarse = FusionSettings(voxel_size_m=0.01, scene_voxel_size_m=0.02)
    mesh = fuse(colored, trajectory_of(poses), coarse).mesh
    assert mesh.colors is not None and mesh.colors.dtype == np.uint8
    on_top = mesh.vertices[:, 2] > 0.06
    on_floor = np.abs(mesh.vertices[:, :2]).max(axis=1) > 0.25
    np.testing.assert_allclose(np.median(mesh.colors[on_top], axis=0), [200, 0, 0])
    np.testing.assert_allclose(np.median(mesh.colors[on_floor], axis=0), [0, 160, 0])
    assert fuse(plain, trajectory_of(poses), coarse).mesh.colors is None


@pytest.mark.parametrize(("width_mm", "voxel_mm"), [(3.0, 7.5), (7.4, 7.5), (7.6, 10.0), (20.0, 10.0)])
def test_scene_is_as_fine_as_the_rays(width_mm: float, voxel_mm: float) -> None:
    assert 1000 * scene_voxel_size_m(width_mm / 1000) == pytest.approx(voxel_mm)


def test_recording_decides_how_fine_the_scene_is_unless_settings_say(
    ball: tuple[Sequence, Trajectory],
) -> None:
    sequence, trajectory = ball
    assert fuse(sequence, trajectory, FusionSettings()).volume.voxel_size_m == 0.0075
    loose = replace(trajectory, pose_sigma_m=np.full(len(trajectory.T_world_camera), 0.005))
    assert fuse(sequence, loose, FusionSettings()).volume.voxel_size_m == 0.01
    assert fuse(sequence, loose, FusionSettings(scene_voxel_size_m=0.02)).volume.voxel_size_m == 0.02
