"""What registration knows of a frame, against analytic surfaces: sizes, normals, points, averaged depth."""

from dataclasses import replace

import numpy as np
import pytest
from analytic_scenes import SCALE, depth_of, displaced, plane, sphere
from tracking_scenes import (
    CORNER_VIEW,
    ROOM,
    SMALL,
    PaintedFrames,
    frame_maps,
    levels,
    native,
    painted,
    png,
    waves,
)

from kinectbench.core.geometry import Camera, invert_rigid
from kinectbench.core.geometry.depth import depth_sigma_m
from kinectbench.stages.track.frame_maps import (
    CACHED_FRAMES,
    MIN_NORMAL_NOISE,
    DepthAverage,
    MapCache,
    reduced_camera,
)

pytestmark = pytest.mark.xdist_group("tracking")

SIZES = {
    "tiny": SMALL,
    "quarter": Camera(320, 240, 262.5, 262.5, 159.5, 119.5),
    "kinect": Camera(640, 480, 525.0, 525.0, 319.5, 239.5),
    "odd": Camera(517, 389, 420.0, 421.0, 255.0, 190.0),
    "wide": Camera(1280, 720, 900.0, 900.0, 639.5, 359.5),
}
# A tilted plane and a ball in front of it, camera frame.
TILTED = np.array([0.3, -0.2, -1.0]) / np.linalg.norm([0.3, -0.2, -1.0])
BACK = plane(tuple(TILTED), -1.6)
BALL_CENTER, BALL_RADIUS_M = np.array([0.1, 0.05, 1.0]), 0.2


# --- resolutions


@pytest.mark.parametrize("camera", SIZES.values(), ids=SIZES.keys())
def test_three_resolutions_of_any_size(camera: Camera) -> None:
    """The finest is some 320 wide, the others a half and a fourth; a plane stays where the rays meet it."""
    maps = frame_maps(painted([BACK], np.eye(4)[None], camera=camera), 0)
    widths = [level.camera.width for level in levels(maps)]
    assert widths[0] in range(150, 331) and widths[1:] == [widths[0] // 2, widths[0] // 4]
    for level in levels(maps):
        assert level.depth_m.shape == (level.camera.height, level.camera.width) == level.normals.shape[:2]
        # TILTED . (z ray) = -1.6 at the centres of the larger pixels.
        expected = -1.6 / (level.camera.rays() @ TILTED)
        inner = np.s_[2:-2, 2:-2]
        np.testing.assert_allclose(level.depth_m[inner], expected[inner], rtol=0.001)


def test_a_reduced_camera_sees_the_same_rays() -> None:
    """The centre of a block of pixels lies on the mean of its rays."""
    for factor in (1, 2, 3, 4):
        small = reduced_camera(SIZES["odd"], factor)
        assert (small.width, small.height) == (517 // factor, 389 // factor)
        rays = SIZES["odd"].rays()[: small.height * factor, : small.width * factor]
        blocks = rays.reshape(small.height, factor, small.width, factor, 3).mean(axis=(1, 3))
        np.testing.assert_allclose(small.rays(), blocks, atol=1e-12)


def test_edges_stay_sharp() -> None:
    """A pixel that covers two surfaces takes the nearer one, not something in between."""
    surfaces = [BACK, sphere(tuple(BALL_CENTER), BALL_RADIUS_M)]
    for level in levels(frame_maps(painted(surfaces, np.eye(4)[None], camera=SIZES["kinect"]), 0)):
        wall, ball = (depth_of([each], level.camera, np.eye(4)).astype(np.float64) for each in surfaces)
        off_m = np.minimum(np.abs(level.depth_m - wall), np.where(ball > 0, np.abs(level.depth_m - ball), 9))
        on_edge = (ball == 0) & (level.depth_m < wall - 0.1)  # the ball's rim, a pixel wider
        assert off_m[~on_edge].max() < 0.06 and on_edge.mean() < 0.03


def test_depth_out_of_range_is_not_used() -> None:
    depth_m = np.full((120, 160), 1.0, np.float32)
    depth_m[:40], depth_m[40:50], depth_m[100:] = 0.2, 0.0, 3.0
    raw = np.rint(depth_m * 1000).astype(np.uint16)
    raw[110:] = 9000
    sequence = replace(
        painted(ROOM, np.eye(4)[None]), depth_scale=1000.0, frames=PaintedFrames([raw], [None])
    )
    finest = frame_maps(sequence, 0)[0].depth_m
    np.testing.assert_array_equal(finest[:50], 0)
    np.testing.assert_array_equal(finest[110:], 0)
    np.testing.assert_allclose(finest[50:110], depth_m[50:110])


# --- normals and points


@pytest.mark.parametrize("noise", [False, True])
def test_normals_of_a_plane_and_a_ball(noise: bool) -> None:
    rng = np.random.default_rng(0) if noise else None
    for surfaces, limit_deg in (([BACK], 0.2), ([sphere(tuple(BALL_CENTER), BALL_RADIUS_M)], 3.0)):
        sequence = painted(surfaces, np.eye(4)[None], camera=SIZES["quarter"], noise=rng)
        level = frame_maps(sequence, 0)[0]
        found = level.normals[..., 2] != 0
        assert found.sum() > 0.4 * (level.depth_m > 0).sum()
        points = level.camera.backproject(level.depth_m)[found]
        expected = np.broadcast_to(TILTED, points.shape)
        if surfaces[0] is not BACK:
            expected = (points - BALL_CENTER) / BALL_RADIUS_M
        normals = level.normals[found].astype(np.float64)
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
        cosine = np.clip((normals * expected).sum(axis=1), -1, 1)
        assert np.degrees(np.median(np.arccos(cosine))) < (limit_deg if not noise else limit_deg + 8)
        assert (normals * points).sum(axis=1).max() < 0  # towards the camera


@pytest.mark.parametrize("distance_m", [0.8, 1.2, 2.4])
def test_the_noise_of_normals_is_told(distance_m: float) -> None:
    """Against the spread of a plane's normals around the true one, over what it goes with."""
    for seed in (None, 0):
        rng = None if seed is None else np.random.default_rng(seed)
        surfaces = [plane((0, 0, -1), -distance_m)]
        level = frame_maps(painted(surfaces, np.eye(4)[None], camera=SIZES["quarter"], noise=rng), 0)[0]
        tangents = level.normals[level.normals[..., 2] != 0][:, :2]
        spread = float(tangents.std()) * distance_m / depth_sigma_m(distance_m)
        assert level.normal_noise == pytest.approx(max(spread, MIN_NORMAL_NOISE), rel=0.15)
        assert (spread > MIN_NORMAL_NOISE) == (rng is not None)


def test_points_lie_on_their_pixels_and_rare_directions_count() -> None:
    """A floor that fills the image and a small box: the box's sides keep most of their points."""
    sequence = painted(ROOM, CORNER_VIEW[None], camera=SIZES["quarter"], texture=waves)
    for level in levels(frame_maps(sequence, 0)):
        p = level.points.astype(np.float64)
        pixels = level.camera.project(p[:, :3])
        u, v = np.rint(pixels).astype(int).T
        np.testing.assert_allclose(pixels, np.rint(pixels), atol=1e-3)
        assert len(set(zip(u, v, strict=True))) == len(p)
        np.testing.assert_allclose(p[:, 2], level.depth_m[v, u])
        np.testing.assert_array_equal(p[:, 3:6].astype(np.float32), level.normals[v, u])
        np.testing.assert_allclose(p[:, 6], depth_sigma_m(p[:, 2]), rtol=1e-5)
        np.testing.assert_array_equal(p[:, 7].astype(np.float32), level.intensity[v, u])
    coarse = frame_maps(sequence, 0)[1]
    normals_world = coarse.normals.astype(np.float64) @ CORNER_VIEW[:3, :3].T
    chosen_world = coarse.points[:, 3:6].astype(np.float64) @ CORNER_VIEW[:3, :3].T
    valid = coarse.normals[..., 2] != 0
    floor, rare = (
        (np.abs(n @ [0, 0, 1]) > 0.99, np.abs(n @ [0, 0, 1]) < 0.8)
        for n in (normals_world[valid], chosen_world)
    )
    kept_of_floor, kept_of_rare = rare[0].sum() / floor[0].sum(), rare[1].sum() / floor[1].sum()
    assert len(coarse.points) < valid.sum()
    assert kept_of_rare > 1.5 * kept_of_floor


def test_a_frame_without_depth_has_no_points() -> None:
    empty = PaintedFrames([np.zeros((120, 160), np.uint16)], [None])
    for level in levels(frame_maps(replace(painted(ROOM, np.eye(4)[None]), frames=empty), 0)):
        assert len(level.points) == 0 and not level.depth_m.any() and not level.normals.any()
        assert level.normal_noise > 0


# --- intensity


def test_intensity_is_the_texture_at_each_pixel() -> None:
    sequence = painted(ROOM, CORNER_VIEW[None], camera=SIZES["kinect"], texture=waves)
    maps = frame_maps(sequence, 0)
    assert maps.has_intensity
    level = maps[0]
    expected = waves(level.camera.backproject(level.depth_m) @ CORNER_VIEW[:3, :3].T + CORNER_VIEW[:3, 3])
    assert np.median(np.abs(level.intensity - expected)) < 2.0
    for each in levels(maps):
        assert each.intensity.shape == each.depth_m.shape


@pytest.mark.parametrize("color", ["unregistered", "another size", "missing", "damaged", "empty"])
def test_colour_that_does_not_lie_on_depth_is_not_used(color: str) -> None:
    sequence = painted(ROOM, CORNER_VIEW[None], texture=waves)
    frames = sequence.frames
    if color == "unregistered":
        sequence = replace(sequence, color_registered=False)
    else:
        large = np.kron(np.full((120, 160), 99.0), np.ones((2, 2)))
        assert isinstance(frames, PaintedFrames)
        images = {"another size": png(large), "damaged": b"\x89PNG nothing", "empty": b""}
        sequence = replace(sequence, frames=replace(frames, color=[images.get(color)]))
    maps = frame_maps(sequence, 0)
    assert not maps.has_intensity
    assert not maps[0].points[:, 7].any() and len(maps[0].points) > 1000


# --- the cache, and better depth


def test_the_cache_is_bounded_and_gives_the_same_maps() -> None:
    one = np.stack([CORNER_VIEW] * 2)
    depth = native(depth_of(ROOM, SMALL, CORNER_VIEW))
    n = CACHED_FRAMES + 10
    frames = PaintedFrames([depth] * n, [None] * n)
    sequence = replace(painted(ROOM, one), frames=frames, stamps_ns=np.arange(n) * 10**8)
    cache = MapCache(sequence)
    first = cache[0]
    assert cache[0] is first
    for index in range(1, n):
        assert cache[index] is not first
    again = cache[0]
    assert again is not first  # forgotten by now
    np.testing.assert_array_equal(again[0].points, first[0].points)


def test_averaged_depth_has_less_noise() -> None:
    """Ten noisy frames of one camera that moves a little: a third of the noise, and no bias."""
    rng = np.random.default_rng(4)
    poses = np.stack([displaced(CORNER_VIEW, (0.004 * k, 0.0, 0.003 * k), 0.2 * k) for k in range(11)])
    sequence = painted(ROOM, poses, camera=SIZES["quarter"], noise=rng)
    cache = MapCache(sequence)
    average = DepthAverage(cache[0][0])
    for k in range(1, 11):
        average.add(cache[k][0], invert_rigid(poses[0]) @ poses[k])
    true_m = depth_of(ROOM, SIZES["quarter"], poses[0])
    before_m = cache[0][0].depth_m - true_m
    noisy_points = cache[0][0].normal_noise
    cache.improve(0, average.stored())
    after_m = cache[0][0].depth_m - true_m
    seen = (cache[0][0].depth_m > 0) & (true_m > 0)
    assert np.median(np.abs(after_m[seen])) < 0.45 * np.median(np.abs(before_m[seen]))
    assert abs(np.median(after_m[seen])) < 0.0003
    assert cache[0][0].normal_noise < 0.6 * noisy_points


def test_another_surface_is_not_averaged_in() -> None:
    """Something stands in front of the wall in the second frame."""
    wall, near = [plane((0, 0, -1), -1.5)], [plane((0, 0, -1), -1.5), sphere((0, 0, 1.0), 0.2)]
    maps = [frame_maps(painted(each, np.eye(4)[None]), 0)[0] for each in (wall, near)]
    for this, other in (maps, maps[::-1]):
        average = DepthAverage(this)
        average.add(other, np.eye(4))
        np.testing.assert_allclose(average.stored() / 10_000, this.depth_m, atol=0.0015)
        assert ((average.stored() > 0) == (this.depth_m > 0)).all()


def test_recorded_depth_is_left_alone() -> None:
    sequence = painted(ROOM, CORNER_VIEW[None], texture=waves)
    before = sequence.frames.depth_native(0).copy()
    a, b = frame_maps(sequence, 0), frame_maps(sequence, 0)
    np.testing.assert_array_equal(sequence.frames.depth_native(0), before)
    assert a[0].points.tobytes() == b[0].points.tobytes()
    assert before.max() / SCALE > 1
