"""`off_share` is measured from the plane of each face; where there is no depth to compare, it is none."""

from dataclasses import replace

import numpy as np
import pytest
from analytic_scenes import CAMERA
from bad_scenes import FLOOR, FUSION, OBJECT, Recorded, recorded

from kinectbench.core.artefacts.object import MAX_OFF_SHARE
from kinectbench.core.geometry import OrientedBox, TriangleMesh, rigid_from_twist
from kinectbench.core.geometry.camera import DepthRenderer
from kinectbench.stages.fuse import fuse

pytestmark = pytest.mark.xdist_group("bad_scenes")


@pytest.mark.parametrize("seed", [0, 1])
def test_poses_off_by_millimetres_contradict_no_grazed_face(seed: int) -> None:
    """6 mm and 0.2 degrees: along rays that graze a side of the box, its depth moves by 20 mm and more."""
    good, rng = recorded([FLOOR, OBJECT]), np.random.default_rng(seed)
    twists = rng.normal(0, np.repeat([0.004, 0.006], 3), (24, 6))
    poses = good.trajectory.T_world_camera @ np.stack([rigid_from_twist(twist) for twist in twists])
    off = replace(good.trajectory, T_world_camera=poses)
    seen = Recorded(good.sequence, off, fuse(good.sequence, off, FUSION).mesh).coverage_report()
    assert seen.off_share is not None and seen.off_share <= MAX_OFF_SHARE


def test_an_object_too_low_to_compare_has_no_share() -> None:
    seen = recorded([FLOOR, OBJECT])
    chosen = replace(seen.segment(), box=OrientedBox((0, 0, 0.009), (0.4, 0.3, 0.018)))
    assert seen.coverage_report_of(chosen).off_share is None
    # From near, less of it is taken for the floor.
    nearer = replace(chosen, floor=replace(chosen.floor, scale=0.5))
    assert seen.coverage_report_of(nearer).off_share == 0


@pytest.mark.parametrize("tilt_deg", [0.0, 60.0, 80.0])
def test_how_far_depth_leads_away_from_a_face(tilt_deg: float) -> None:
    plate = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    T = rigid_from_twist(np.array([np.radians(tilt_deg), 0, 0, 0, 0, 0.0]))
    vertices = plate @ T[:3, :3].T + np.array([0, 0, 2.0])
    renderer = DepthRenderer(TriangleMesh(vertices, np.array([[0, 1, 2], [0, 2, 3]], np.int32)))
    depth_m, lift = renderer.depth_and_lift(CAMERA, np.eye(4))
    np.testing.assert_array_equal(depth_m, renderer.depth_m(CAMERA, np.eye(4)))
    at = np.argwhere(depth_m > 0)
    rays = CAMERA.rays()[tuple(at.T)]
    points = rays * (depth_m[tuple(at.T)][:, None] + 0.1)
    normal = T[:3, 2]
    np.testing.assert_allclose(
        0.1 * lift[tuple(at.T)], np.abs((points - [0, 0, 2.0]) @ normal), rtol=1e-4, atol=1e-5
    )
    assert not lift[depth_m == 0].any()
