import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from kinectbench.core.geometry import Camera

CAMERA = Camera(width=7, height=5, fx=100.0, fy=50.0, cx=3.0, cy=2.0)


def test_the_axis_meets_the_principal_point() -> None:
    np.testing.assert_array_equal(CAMERA.project(np.array([0.0, 0.0, 2.0])), [3.0, 2.0])


def test_right_and_down_are_positive() -> None:
    # u = 100 * 0.1 / 2 + 3, v = 50 * 0.2 / 2 + 2
    np.testing.assert_allclose(CAMERA.project(np.array([0.1, 0.2, 2.0])), [8.0, 7.0])


def test_rays_go_through_pixel_centres() -> None:
    rays = CAMERA.rays()
    assert rays.shape == (5, 7, 3)
    np.testing.assert_array_equal(rays[2, 3], [0, 0, 1])
    np.testing.assert_allclose(rays[0, 0], [-0.03, -0.04, 1])
    homogeneous = np.linalg.inv(CAMERA.K) @ [6, 4, 1]
    np.testing.assert_allclose(rays[4, 6], homogeneous)


def test_backprojection_then_projection_gives_the_pixels() -> None:
    depth_m = np.random.default_rng(0).uniform(0.5, 4, (5, 7)).astype(np.float32)
    points_camera = CAMERA.backproject(depth_m)
    np.testing.assert_allclose(points_camera[..., 2], depth_m)
    v, u = np.mgrid[:5, :7]
    np.testing.assert_allclose(CAMERA.project(points_camera), np.stack([u, v], axis=-1), atol=1e-9)


def test_no_measurement_stays_at_the_origin() -> None:
    assert not CAMERA.backproject(np.zeros((5, 7), np.float32)).any()


@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.1, 10))
@settings(deadline=None)
def test_projection_is_the_matrix(x: float, y: float, z: float) -> None:
    u, v, w = CAMERA.K @ [x, y, z]
    np.testing.assert_allclose(CAMERA.project(np.array([x, y, z])), [u / w, v / w], rtol=1e-9, atol=1e-9)
