"""The ICP kernel against plain numpy; and a view's wrong pose is corrected, a right one left where it is."""

import numpy as np
import pytest
from analytic_scenes import CAMERA, box, depth_of, displaced, plane, sphere
from chair_model import Chair
from chair_model import chair as make_chair
from numpy.typing import NDArray

from kinectbench.core.geometry import (
    Camera,
    invert_rigid,
    rigid,
    rotation_angle_rad,
    rotation_from_quaternion_xyzw,
    transform_points,
)
from kinectbench.core.geometry.camera import DepthRenderer
from kinectbench.core.geometry.depth import depth_sigma_m
from kinectbench.core.geometry.rigid import rigid_from_twist
from kinectbench.core.trajectory.trajectory import UNCHECKED_POSE_SIGMA_M as UNCHECKED_M
from kinectbench.core.types import Float32, Float64
from kinectbench.lab.simulate.path import look_at
from kinectbench.stages.sample_views.alignment import (
    HUBER_SIGMAS,
    OUTLIER_M,
    OrientedPoints,
    ViewAlignment,
    align_view,
    fitted_motion,
    helps,
    normal_equations,
    oriented_points,
)

SURFACES = [box((-0.3, -0.2, 0.0), (0.3, 0.2, 0.5)), plane((0, 0, 1), 0.0), sphere((0.0, 0.0, 0.6), 0.15)]
EYE = look_at(np.array([0.9, -1.4, 1.1]), np.array([0.0, 0.0, 0.25]))
SMALL = Camera(40, 30, 35.0, 36.0, 18.7, 15.2)
pytestmark = pytest.mark.xdist_group("chair_model")
FRAMES = (1, 8, 15, 21)
# Views with enough smooth surface on the object at this resolution.
WELL_COVERED = (8, 15)


def reference(
    surface: OrientedPoints, depth_m: NDArray[np.float32], T: NDArray[np.float64], camera: Camera
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Point by point from the definition: r = (R n) . (q - T p), weights Huber over 2 sigma^2."""
    A, b, residuals = np.zeros((6, 6)), np.zeros(6), []
    for p, n, sigma in zip(surface.points, surface.normals, surface.sigma_m, strict=True):
        at = transform_points(T, p)
        if at[2] <= 0.1:
            continue
        u, v = np.floor(camera.project(at) + 0.5).astype(int)
        if not (0 <= u < camera.width and 0 <= v < camera.height):
            continue
        d = float(depth_m[v, u])
        if d <= 0 or abs(d - at[2]) > OUTLIER_M:
            continue
        q = d * np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])
        r = (T[:3, :3] @ n) @ (q - at)
        s = np.sqrt(2) * sigma
        w = min(1.0, HUBER_SIGMAS * s / max(abs(r), 1e-12)) / s**2
        J = np.concatenate([np.cross(p, n), n])
        A += w * np.outer(J, J)
        b += w * r * J
        residuals.append(r)
    return A, b, np.array(residuals)


def aligned(
    depth_m: Float32, camera: Camera, pose: Float64, renderer: DepthRenderer, pose_sigma_m: float
) -> ViewAlignment:
    """`align_view` with the object as it is rendered at the pose."""
    return align_view(depth_m, camera, pose, renderer.depth_m(camera, pose), pose_sigma_m)


def test_normal_equations_against_numpy() -> None:
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-0.8, 0.8, (400, 2)), rng.uniform(0.05, 1.5, 400)])
    normals = rng.normal(size=(400, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    surface = OrientedPoints(points, normals, np.asarray(depth_sigma_m(points[:, 2])))
    depth_m = rng.uniform(0.6, 1.3, (30, 40)).astype(np.float32)
    depth_m[rng.random(depth_m.shape) < 0.2] = 0
    T = rigid(rotation_from_quaternion_xyzw([0.05, -0.02, 0.1, 1.0]), [0.03, -0.02, 0.05])
    A, b, residuals = normal_equations(surface, depth_m, T, SMALL)
    A_slow, b_slow, residuals_slow = reference(surface, depth_m, T, SMALL)
    met = np.isfinite(residuals)
    assert 20 < met.sum() < 300
    np.testing.assert_allclose(residuals[met], residuals_slow, atol=1e-12)
    np.testing.assert_allclose(A, A_slow, rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(b, b_slow, rtol=1e-6, atol=1e-3)


def test_gradient_is_that_of_the_residuals() -> None:
    """The residual falls by J per unit of twist, by finite differences."""
    depth_m = depth_of(SURFACES, CAMERA, EYE)
    surface = oriented_points(depth_m, CAMERA, 12)
    k = len(surface.points) // 2
    one = OrientedPoints(surface.points[k : k + 1], surface.normals[k : k + 1], surface.sigma_m[k : k + 1])
    base = normal_equations(one, depth_m, np.eye(4), CAMERA)
    J = np.concatenate([np.cross(one.points[0], one.normals[0]), one.normals[0]])
    for axis in range(6):
        twist = np.zeros(6)
        twist[axis] = 1e-5  # too little to fall on another pixel
        moved = normal_equations(one, depth_m, rigid_from_twist(twist), CAMERA)[2]
        assert (moved - base[2])[0] / 1e-5 == pytest.approx(-J[axis], abs=1e-3)


def test_points_lie_on_the_surface_with_its_normals() -> None:
    depth_m = depth_of([plane((0.0, 0.0, 1.0), 0.0)], CAMERA, EYE)
    surface = oriented_points(depth_m, CAMERA, 8)
    assert len(surface.points) > 300
    world = transform_points(EYE, surface.points)
    np.testing.assert_allclose(world[:, 2], 0, atol=1e-5)
    normals = surface.normals @ EYE[:3, :3].T
    np.testing.assert_allclose(np.abs(normals[:, 2]), 1, atol=1e-4)
    np.testing.assert_allclose(surface.sigma_m, depth_sigma_m(surface.points[:, 2]))


def test_no_points_at_edges_or_holes() -> None:
    depth_m = depth_of(SURFACES, CAMERA, EYE)
    depth_m[100:140, 100:200] = 0
    surface = oriented_points(depth_m, CAMERA, 1)
    pixels = np.rint(CAMERA.project(surface.points)).astype(int)
    in_hole = (pixels[:, 0] > 96) & (pixels[:, 0] < 203) & (pixels[:, 1] > 96) & (pixels[:, 1] < 143)
    # Four pixels to the side of a hole a normal would need depth from within it.
    beside = in_hole & (pixels[:, 0] >= 100) & (pixels[:, 0] < 200)
    assert not beside.any()


def test_icp_recovers_a_known_motion() -> None:
    target = depth_of(SURFACES, CAMERA, EYE)
    moved = displaced(EYE, (0.012, -0.008, 0.015), 0.7)
    surface = oriented_points(depth_of(SURFACES, CAMERA, moved), CAMERA, 4)
    motion = np.eye(4)
    for _ in range(15):
        A, b, _ = normal_equations(surface, target, motion, CAMERA)
        motion = motion @ rigid_from_twist(np.linalg.solve(A, b))
    error = invert_rigid(motion) @ invert_rigid(EYE) @ moved
    assert np.linalg.norm(error[:3, 3]) < 0.001
    assert np.degrees(rotation_angle_rad(error[:3, :3])) < 0.05


@pytest.mark.parametrize(("times", "share"), [(0.0, 1.0), (1.0, 0.5), (3.0, 0.25)])
def test_a_prior_as_strong_as_the_depth_halves_the_motion(times: float, share: float) -> None:
    """A wall 1 mm off, known to 1 mm and asked to stay to 1 mm: half-way, however often it is linearised."""
    camera = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
    at_m, off_m = np.full((48, 64), 1.0, np.float32), 0.001
    surface = oriented_points(at_m, camera, 2)
    A, _, _ = normal_equations(surface, at_m, np.eye(4), camera)
    # What a wall leaves open is held where it is.
    prior = times * A + 1e-3 * np.diag([1.0, 1, 1, 1, 1, 0])
    motion = fitted_motion(surface, at_m + np.float32(off_m), camera, prior)
    assert motion[2, 3] / off_m == pytest.approx(share, rel=0.01)


def test_a_correction_is_judged_by_the_same_points() -> None:
    """Points that the motion takes off everything do not count before it either."""
    camera = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
    points = oriented_points(np.full((48, 64), 1.0, np.float32), camera, 1)
    rendered_m = np.full((48, 64), 1.001, np.float32)
    rendered_m[:, 32:48], rendered_m[:, 48:] = 0, 1.1
    sideways = rigid_from_twist(np.array([0, 0, 0, 16 / 60, 0, 0]))  # those at 1.1 m leave the image
    assert not helps(points, rendered_m, sideways, camera)
    ahead = rigid_from_twist(np.array([0, 0, 0, 0, 0, 0.001]))
    assert helps(points, np.full_like(rendered_m, 1.001), ahead, camera)


def test_twists() -> None:
    T = rigid_from_twist(np.array([0.0, 0.0, np.pi / 2, 1.0, 2.0, 3.0]))
    np.testing.assert_allclose(T, rigid([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1, 2, 3]), atol=1e-12)
    assert rotation_angle_rad(T[:3, :3]) == pytest.approx(np.pi / 2)


def test_every_second_point() -> None:
    numbers = np.arange(7.0)
    surface = OrientedPoints(np.tile(numbers[:, None], 3), np.tile(numbers[:, None], 3), numbers)
    np.testing.assert_array_equal(surface.every_second(0).sigma_m, [0, 2, 4, 6])
    np.testing.assert_array_equal(surface.every_second(1).points[:, 0], [1, 3, 5])


@pytest.fixture(scope="module")
def chair() -> Chair:
    return make_chair()


@pytest.fixture(scope="module")
def renderer(chair: Chair) -> DepthRenderer:
    """Of the true object, so that the true pose is the right answer."""
    return DepthRenderer(chair.recorded.mesh_world)


def error_m(chair: Chair, frame: int, T_world_camera: NDArray[np.float64]) -> float:
    """How far the object's points in this frame are from where they belong, median."""
    depth_m = chair.recorded.sequence.depth_m(frame)
    on_object = chair.recorded.masks[frame] & (depth_m > 0)
    points = chair.recorded.sequence.camera.backproject(depth_m)[on_object]
    truth = chair.recorded.simulation.T_world_camera[frame]
    apart = transform_points(T_world_camera, points) - transform_points(truth, points)
    return float(np.median(np.linalg.norm(apart, axis=1)))


@pytest.mark.parametrize("frame", FRAMES)
def test_a_right_pose_stays(chair: Chair, renderer: DepthRenderer, frame: int) -> None:
    truth = chair.recorded.simulation.T_world_camera[frame]
    sequence = chair.recorded.sequence
    alignment = aligned(sequence.depth_m(frame), sequence.camera, truth, renderer, pose_sigma_m=0.0005)
    np.testing.assert_array_equal(alignment.T_world_camera, truth)
    assert alignment.moved_m == alignment.turned_rad == 0
    unchecked = aligned(sequence.depth_m(frame), sequence.camera, truth, renderer, UNCHECKED_M)
    assert error_m(chair, frame, unchecked.T_world_camera) < 0.002
    assert unchecked.moved_m < 0.002 and np.degrees(unchecked.turned_rad) < 0.3


@pytest.mark.parametrize("frame", WELL_COVERED)
@pytest.mark.parametrize(
    ("shift_m", "turn_deg"),
    [
        ((0.015, 0, 0), 0.0),
        ((0, 0.015, 0), 0.0),
        ((0, 0, 0.015), 0.0),
        ((0, 0, 0), 0.8),
        ((0.012, 0, 0.009), 0.8),
    ],
)
def test_a_wrong_pose_is_corrected(
    chair: Chair, renderer: DepthRenderer, frame: int, shift_m: tuple[float, float, float], turn_deg: float
) -> None:
    """A pose off by 15 mm, turned by 0.8 degrees about the object, or both."""
    truth = chair.recorded.simulation.T_world_camera[frame]
    sequence = chair.recorded.sequence
    distance_m = float(np.median(sequence.depth_m(frame)[chair.recorded.masks[frame]]))
    T_camera_object = rigid(np.eye(3), [0, 0, distance_m])
    if any(shift_m):
        moved = displaced(np.eye(4), shift_m, turn_deg)
        wrong = truth @ T_camera_object @ moved @ invert_rigid(T_camera_object)
    else:
        wrong = displaced(truth, shift_m, turn_deg)  # about the camera: 0.8 degrees move the object by 17 mm
    before = error_m(chair, frame, wrong)
    alignment = aligned(sequence.depth_m(frame), sequence.camera, wrong, renderer, UNCHECKED_M)
    after = error_m(chair, frame, alignment.T_world_camera)
    assert before > 0.01
    assert after < 0.003
    assert alignment.moved_m == pytest.approx(before, abs=0.004)
    rotation = alignment.T_world_camera[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)


def test_too_little_to_align_by(chair: Chair, renderer: DepthRenderer) -> None:
    sequence = chair.recorded.sequence
    truth = chair.recorded.simulation.T_world_camera[0]
    for depth_m, pose in (
        (np.zeros_like(sequence.depth_m(0)), truth),
        (sequence.depth_m(0), truth @ rigid(np.diag([-1.0, 1.0, -1.0]), np.zeros(3))),  # looks away
    ):
        alignment = aligned(depth_m, sequence.camera, pose, renderer, UNCHECKED_M)
        np.testing.assert_array_equal(alignment.T_world_camera, pose)
        assert alignment.moved_m == 0 and alignment.turned_rad == 0


def test_never_farther_than_allowed(chair: Chair, renderer: DepthRenderer) -> None:
    """An error beyond the bounds is not half corrected: either the pose is as given, or within them."""
    sequence = chair.recorded.sequence
    for frame in FRAMES:
        wrong = displaced(chair.recorded.simulation.T_world_camera[frame], (0.06, 0.06, 0.0), 4.0)
        alignment = aligned(sequence.depth_m(frame), sequence.camera, wrong, renderer, UNCHECKED_M)
        assert alignment.moved_m <= 0.05 and alignment.turned_rad <= 0.05
        if alignment.moved_m == 0:
            np.testing.assert_array_equal(alignment.T_world_camera, wrong)
