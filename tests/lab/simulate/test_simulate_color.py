"""Motion blur, exposure and grain against values worked out by hand."""

import numpy as np
import pytest
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera, rigid, rotation_from_quaternion_xyzw
from kinectbench.lab.simulate.color import GRAIN_LEVELS, expose, exposure_gains
from kinectbench.lab.simulate.render import Rendering

CAMERA = Camera(160, 120, 131.25, 131.25, 79.5, 59.5)
STILL = (np.eye(4), np.eye(4), np.eye(4))


def rendering(color_rgb: int | NDArray[np.int64] | NDArray[np.float64], depth_m: float = 2.0) -> Rendering:
    shape = (CAMERA.height, CAMERA.width)
    color = np.broadcast_to(np.asarray(color_rgb, np.uint8), (*shape, 3)).copy()
    depth = np.full(shape, depth_m, np.float32)
    one = np.ones(shape, np.float32)
    return Rendering(depth, color, np.zeros(shape, bool), one, one)


def step() -> NDArray[np.int64]:
    """Black on the left, 200 on the right from column 80 on."""
    return np.where(np.arange(CAMERA.width)[None, :, None] < 80, 0, 200)


def ramp_px(color_rgb: NDArray[np.uint8]) -> float:
    """Width of an edge, from the standard deviation of its slope: a box of width w has w / sqrt(12)."""
    profile = color_rgb.astype(np.float64).mean(axis=(0, 2))
    slope = np.clip(np.diff(profile)[50:110], 2.0, None) - 2.0
    at = np.arange(len(slope)) - np.average(np.arange(len(slope)), weights=slope)
    return float(np.sqrt(12 * np.average(at**2, weights=slope)))


def sideways(half_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Translations along x, camera at start, middle and end."""
    start, middle, end = (rigid(np.eye(3), np.array([x, 0, 0])) for x in (-half_m, 0.0, half_m))
    return start, middle, end


def test_a_still_camera_changes_nothing_but_grain() -> None:
    flat = expose(rendering(100), CAMERA, STILL, 1.0, np.random.default_rng(0))
    assert flat.mean() == pytest.approx(100, abs=0.05)
    assert flat[..., 0].std() == pytest.approx(GRAIN_LEVELS, rel=0.05)
    sharp = expose(rendering(step()), CAMERA, STILL, 1.0, np.random.default_rng(0))
    assert sharp[:, :78].max() < 10
    assert sharp[:, 82:].min() > 190


@pytest.mark.parametrize(("moved_m", "depth_m"), [(0.1, 1.0), (0.1, 2.0), (0.2, 1.0)])
def test_a_passing_edge_smears_by_its_path(moved_m: float, depth_m: float) -> None:
    blurred = expose(rendering(step(), depth_m), CAMERA, sideways(moved_m / 2), 1.0, np.random.default_rng(1))
    path_px = CAMERA.fx * moved_m / depth_m
    assert ramp_px(blurred) == pytest.approx(path_px, rel=0.12, abs=0.5)
    # Half the light has come where the edge was in the middle of the exposure, between columns 79 and 80.
    assert blurred[:, 79:81].mean() == pytest.approx(100, abs=6)


def test_a_turn_smears_near_and_far_alike() -> None:
    half_rad = 0.04
    turns = [
        rotation_from_quaternion_xyzw(np.array([0, np.sin(a / 2), 0, np.cos(a / 2)]))
        for a in (-half_rad, 0, half_rad)
    ]
    start, middle, end = (rigid(turn, np.zeros(3)) for turn in turns)
    for depth_m in (0.0, 1.0, 4.0):
        blurred = expose(
            rendering(step(), depth_m), CAMERA, (start, middle, end), 1.0, np.random.default_rng(2)
        )
        assert ramp_px(blurred) == pytest.approx(CAMERA.fx * 2 * half_rad, rel=0.12)


def test_the_streak_follows_any_motion() -> None:
    # A dot stays on the line from where its point is seen at the start to where it is at the end.
    T_start = rigid(
        rotation_from_quaternion_xyzw(np.array([0.02, -0.01, 0.03, 1.0])), np.array([0.05, 0.02, -0.04])
    )
    T_end = rigid(
        rotation_from_quaternion_xyzw(np.array([-0.02, 0.01, -0.03, 1.0])), np.array([-0.05, -0.02, 0.04])
    )
    u, v = 110, 40
    dots = np.zeros((CAMERA.height, CAMERA.width, 3))
    dots[v - 1 : v + 2, u - 1 : u + 2] = 255
    blurred = expose(rendering(dots, 1.5), CAMERA, (T_start, np.eye(4), T_end), 1.0, np.random.default_rng(3))
    point = CAMERA.rays()[v, u] * 1.5
    ends = [CAMERA.project((np.linalg.inv(T) @ [*point, 1])[:3]) for T in (T_start, T_end)]
    y, x = np.nonzero(blurred[..., 0] > 15)
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    away = np.stack([x, y], axis=1) - np.mean(ends, axis=0)
    assert np.abs(away @ [-along[1], along[0]]).max() < 3.5
    reach = np.ptp(away @ along)
    assert reach == pytest.approx(np.linalg.norm(ends[1] - ends[0]), abs=5)
    assert reach > 10


def test_gain_brightens_and_saturates() -> None:
    assert expose(rendering(100), CAMERA, STILL, 1.4, np.random.default_rng(4)).mean() == pytest.approx(
        140, abs=0.1
    )
    assert expose(rendering(200), CAMERA, STILL, 1.5, np.random.default_rng(4)).min() == 255


def test_exposure_wanders_slowly_within_its_bounds() -> None:
    time_s = np.arange(0, 20, 1 / 30)
    gains = exposure_gains(time_s, 0.3, np.random.default_rng(5))
    assert gains.min() >= 1 / 1.3 - 1e-12
    assert gains.max() <= 1.3 + 1e-12
    assert np.ptp(gains) > 0.3
    assert np.abs(np.diff(gains)).max() < 0.05
    assert np.all(exposure_gains(time_s, 0.0, np.random.default_rng(5)) == 1)


def test_the_seed_decides() -> None:
    first, same, other = (
        expose(rendering(100), CAMERA, sideways(0.02), 1.0, np.random.default_rng(seed)) for seed in (6, 6, 7)
    )
    assert np.array_equal(first, same)
    assert not np.array_equal(first, other)
