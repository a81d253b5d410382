"""Still cameras, by hand-made images."""

import numpy as np
import pytest

from kinectbench.core.still_camera import Watched, _nanquantiles, some_of, watch
from kinectbench.core.types import Float32

HEIGHT, WIDTH, FRAMES = 60, 80, 12


def room(seed: int = 0) -> Float32:
    """A slanted floor with a sensor's noise, metres."""
    noise = 0.002 * np.random.default_rng(seed).standard_normal((HEIGHT, WIDTH))
    return (1.0 + np.linspace(1.0, 0.0, HEIGHT)[:, None] + noise).astype(np.float32)


def pattern(shift: int = 0) -> np.ndarray:
    """A floor's pattern, in an image twice as large."""
    tiles = np.random.default_rng(7).integers(40, 220, (HEIGHT // 4, WIDTH // 4)).astype(np.uint8)
    return np.roll(np.kron(tiles, np.ones((8, 8), np.uint8)), shift, axis=1)


def judged(depths: list[Float32], grays: list[np.ndarray] | None = None) -> Watched:
    found = watch(depths, [*grays] if grays else [None] * len(depths))
    assert found is not None
    return found


def with_something(depth: Float32, index: int) -> Float32:
    """A thing that sways by a pixel a frame, 10 to 21 pixels wide together."""
    depth[20:30, 30 + index : 40 + index] = 0.8
    return depth


@pytest.mark.parametrize("grays", [None, [pattern()] * FRAMES])
def test_something_that_moves_before_a_still_camera(grays: list[np.ndarray] | None) -> None:
    found = judged([with_something(room(i), i) for i in range(FRAMES)], grays)
    assert found.camera_still
    assert found.something_moves
    assert not found.plain
    # What stands still has the depth of the floor; what moves lies where the thing was.
    assert found.moving[22:28, 42:48].all()
    assert not found.moving[:18].any()
    assert np.abs(found.still_m[5:15, 5:25] - room()[5:15, 5:25]).max() < 0.01


def test_noise_is_no_motion() -> None:
    found = judged([room(i) for i in range(FRAMES)])
    assert found.camera_still
    assert not found.something_moves


def test_a_camera_that_tips() -> None:
    found = judged([with_something(np.roll(room(i), i, axis=0), i) for i in range(FRAMES)])
    assert not found.camera_still
    assert not found.plain


def test_a_camera_that_goes_along_a_floor_is_told_by_its_pattern() -> None:
    depths = [with_something(room(i), i) for i in range(FRAMES)]
    assert judged(depths).camera_still
    assert not judged(depths, [pattern(6 * i) for i in range(FRAMES)]).camera_still
    # Exposure that adapts is no motion.
    darker = [(pattern() * (1 - 0.04 * i)).astype(np.uint8) for i in range(FRAMES)]
    assert judged(depths, darker).camera_still


def test_nothing_around() -> None:
    empty = np.zeros((HEIGHT, WIDTH), np.float32)
    found = judged([with_something(empty.copy(), i) for i in range(FRAMES)])
    assert found.plain
    assert not found.camera_still
    assert found.something_moves


def test_too_few_frames_say_nothing() -> None:
    assert watch([room(i) for i in range(5)], [None] * 5) is None
    assert some_of(0) == []
    assert some_of(3) == [0, 1, 2]
    assert len(some_of(1000)) == 24


def test_quantiles_are_those_of_numpy() -> None:
    random = np.random.default_rng(0)
    values = random.random((9, 6, 8)).astype(np.float32)
    values[random.random(values.shape) < 0.5] = np.nan
    values[3] = 1.0  # no pixel is without a value
    shares = [0.0, 0.1, 0.5, 0.9, 1.0]
    expected = np.nanquantile(values, shares, axis=0)
    np.testing.assert_allclose(_nanquantiles(values, shares), expected, atol=1e-6)
