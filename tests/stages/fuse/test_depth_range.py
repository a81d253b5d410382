"""How far depth makes surface: ranges by hand, cavities seen from afar, noise wider than the truncation."""

from pathlib import Path

import numpy as np
import pytest
from analytic_scenes import CAMERA, MemoryFrames, depth_of, plane, ring, trajectory_of

from kinectbench.core.artefacts.reconstruction import ReconstructionFile
from kinectbench.core.geometry import Camera, Grid, rigid
from kinectbench.core.geometry.depth import depth_sigma_m
from kinectbench.core.sequence import Sequence
from kinectbench.lab.simulate.path import look_at
from kinectbench.settings.models import FusionSettings
from kinectbench.stages.fuse import fuse, observe
from kinectbench.stages.fuse.depth_range import (
    depth_range,
    grid_range_m,
    range_warnings,
    sample_depth,
    some_frames,
)
from kinectbench.stages.fuse.reconstruction import write_reconstruction

# Of the wider side of 320 pixels at 262.5: half of it is seen at 31.4 degrees.
BALL_SHARE = np.sin(np.arctan(160 / 262.5))
NOTHING = sample_depth([])


def far_sequence(depths_m: list[np.ndarray], camera: Camera = CAMERA) -> Sequence:
    """Depth of up to 13 m, to 0.2 mm."""
    native = [np.rint(depth_m * 5000).astype(np.uint16) for depth_m in depths_m]
    stamps_ns = np.arange(len(native), dtype=np.int64) * 10**8
    return Sequence(camera, 5000.0, stamps_ns, False, None, MemoryFrames(lambda index: native[index]))


@pytest.mark.parametrize(
    ("distance_m", "expected_m"),
    # 1.9 m reach 2.889 m, 2.2 m reach 3.345 m, 3.2 m reach 4.865 m, 6 m more than 8 m.
    [(0.5, 3.0), (1.9, 3.0), (2.2, 3.4), (3.2, 4.9), (6.0, 8.0)],
)
def test_the_range_is_how_far_what_is_looked_at_reaches(distance_m: float, expected_m: float) -> None:
    chosen = depth_range(CAMERA, ring(24, distance_m), NOTHING, FusionSettings())
    assert chosen.looked_at_m == pytest.approx(distance_m, abs=0.01)
    assert chosen.reach_m == pytest.approx((1 + BALL_SHARE) * distance_m, abs=0.02)
    assert (chosen.max_depth_m, chosen.chosen_by) == (expected_m, "recording")
    assert chosen.beyond_share == chosen.missed_share == 0 and range_warnings(chosen) == ()


def test_where_axes_do_not_meet_depth_tells() -> None:
    """Along a shelf 3.5 m away; without any depth, axes that part meet 1.5 m ahead."""
    looking = look_at(np.zeros(3), np.array([0.0, 1.0, 0.0]))[:3, :3]
    along = np.stack([rigid(looking, [0.5 * k, 0.0, 1.0]) for k in range(8)])
    assert depth_range(CAMERA, along, NOTHING, FusionSettings()).looked_at_m == pytest.approx(1.5, abs=0.01)
    shelf = sample_depth([np.full((30, 40), 3.5, np.float32)] * 8)
    chosen = depth_range(CAMERA, along, shelf, FusionSettings())
    assert chosen.looked_at_m == 3.5 and chosen.max_depth_m == 5.4
    # Without poses, too; and without both nothing tells.
    assert depth_range(CAMERA, np.zeros((0, 4, 4)), shelf, FusionSettings()) == chosen
    empty = depth_range(CAMERA, np.zeros((0, 4, 4)), NOTHING, FusionSettings())
    assert empty.looked_at_m is None and empty.reach_m is None and empty.max_depth_m == 3.0


def test_a_given_range_holds_and_what_it_drops_is_told() -> None:
    """Ninths of the image at three depths: 4 m may be of what is looked at, 6 m may not."""
    depth_m = np.full((90, 90), 2.0, np.float32)
    depth_m[30:60, 40:50], depth_m[30:60, 50:60], depth_m[:30, :30] = 4.0, 6.0, 0.0
    sampled = sample_depth([depth_m])
    chosen = depth_range(CAMERA, ring(24, 3.2), sampled, FusionSettings(max_depth_m=3.0))
    assert (chosen.max_depth_m, chosen.chosen_by) == (3.0, "setting")
    assert chosen.missed_share == pytest.approx(1 / 3, abs=1e-4)
    assert chosen.beyond_share == pytest.approx(600 / 7200, abs=1e-4)
    (line,) = range_warnings(chosen)
    assert (
        "33% of the depth" in line and "beyond 3 m" in line and "to 4.9 m" in line and "leave it out" in line
    )
    by_recording = depth_range(CAMERA, ring(24, 3.2), sampled, FusionSettings())
    assert by_recording.missed_share == 0 and by_recording.beyond_share == pytest.approx(300 / 7200, abs=1e-4)
    assert range_warnings(by_recording) == ()
    # Farther than any range: nobody can raise it.
    afar = depth_range(CAMERA, ring(24, 7.5), sample_depth([4.5 + depth_m]), FusionSettings())
    assert afar.max_depth_m == 8.0 and "record from nearer" in range_warnings(afar)[0]


def test_some_frames_are_spread_evenly() -> None:
    frames = np.arange(0, 800, 2)
    assert len(some_frames(frames)) == 40 and {0, 798} <= set(some_frames(frames).tolist())
    assert some_frames(frames[:3]).tolist() == [0, 2, 4]


def test_the_range_of_a_grid_is_its_farthest_corner() -> None:
    """A cube of 1.6 m, its middle 3.2 m ahead of a camera along z, and one of which nobody may see more."""
    grid = Grid((16, 16, 16), 0.1, rigid(np.eye(3), [-0.8, -0.8, 2.45]))
    assert grid_range_m(np.eye(4)[None], grid, FusionSettings()) == 4.1
    nearer = Grid((16, 16, 16), 0.1, rigid(np.eye(3), [-0.8, -0.8, 1.2]))
    assert grid_range_m(np.eye(4)[None], nearer, FusionSettings()) == 3.0
    assert grid_range_m(np.eye(4)[None], grid, FusionSettings(max_depth_m=2.0)) == 2.0


@pytest.fixture(scope="module")
def cavity() -> np.ndarray:
    """Depth of a camera at the origin: the back of a cavity 3.6 m ahead, its front, 0.5 m wide, at 3.1 m."""
    rays = CAMERA.rays()
    inside = (np.abs(rays[..., :2]) * 3.1 < 0.25).all(axis=-1)
    return np.where(inside, 3.6, 3.1).astype(np.float32)


@pytest.mark.parametrize(("max_depth_m", "free_to_m"), [(None, 3.56), (3.0, 3.35)])
def test_the_far_wall_of_a_cavity_carves_it(
    cavity: np.ndarray, max_depth_m: float | None, free_to_m: float
) -> None:
    """Up to two standard deviations, 42 mm, before the wall; by depth out of range, a quarter of a metre."""
    sequence, still = far_sequence([cavity]), trajectory_of(np.eye(4)[None])
    grid = Grid((16, 16, 80), 0.01, rigid(np.eye(3), [-0.08, -0.08, 3.0]))
    seen = observe(sequence, still, [0], grid, FusionSettings(max_depth_m=max_depth_m))
    z = 3.0 + (np.arange(80) + 0.5) * 0.01
    np.testing.assert_array_equal((seen.free > 0).all(axis=(0, 1)), z < free_to_m)
    assert bool(seen.surface.any()) == (max_depth_m is None)


def test_what_is_recorded_from_afar_is_fused_and_written(tmp_path: Path) -> None:
    """A floor seen from 3.5 m: nothing of it lies within 3 m of a camera."""
    poses = ring(6, 3.5, elevations_rad=(0.9,))
    floor = plane((0.0, 0.0, 1.0), 0.0)
    sequence = far_sequence([np.minimum(depth_of([floor], CAMERA, T), 13) for T in poses])
    for given_m, faces in ((None, True), (2.5, False)):
        settings = FusionSettings(scene_voxel_size_m=0.02, max_depth_m=given_m)
        fused = fuse(sequence, trajectory_of(poses), settings)
        assert bool(len(fused.mesh.faces)) == faces
        write_reconstruction(fused, tmp_path)
        stored = ReconstructionFile.read(tmp_path)
        assert stored.depth_range == fused.depth_range and bool(stored.warnings) == (given_m is not None)
    assert stored.depth_range.beyond_share > 0.9


def test_noise_wider_than_the_truncation_leaves_a_surface_where_it_is() -> None:
    """A wall 3.9 m away, measured with a Kinect's noise of 25 mm: by the truncation alone it is 16 mm off."""
    rng, camera = np.random.default_rng(0), Camera(80, 60, 65.6, 65.6, 39.5, 29.5)
    sigma_m = depth_sigma_m(3.9)
    depths_m = [3.9 + sigma_m * rng.standard_normal((60, 80)) for _ in range(200)]
    still = trajectory_of(np.tile(np.eye(4), (200, 1, 1)))
    grid = Grid((32, 32, 32), 0.005, rigid(np.eye(3), [-0.08, -0.08, 3.82]))
    seen = observe(far_sequence(depths_m, camera), still, range(200), grid, FusionSettings())
    z = 3.82 + (np.arange(32) + 0.5) * 0.005
    mean_m = seen.tsdf.mean(axis=(0, 1))
    measured = np.abs(z - 3.9) < 0.03
    crossing_m = np.interp(0.0, -mean_m[measured], z[measured])
    assert crossing_m == pytest.approx(3.9, abs=0.003)
