"""A rolling shutter that was found is stored, and undone in what the later stages see."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from kinectbench.core.artefacts.trajectory import TrajectoryHealth
from kinectbench.core.geometry import Camera
from kinectbench.core.geometry.rigid import rigid_from_twist
from kinectbench.core.own_pixels import by_own_pixels
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory, read_trajectory, write_trajectory
from kinectbench.core.upright import upright

READOUT_S, RATE = 0.03, np.array([0, 1.5, 0, 0, 0, 0])
CAMERA = Camera(160, 120, 140.0, 140.0, 79.5, 59.5)
STAMPS_NS = (np.arange(5) * 1e9 / 30).astype(np.int64)
POSES = np.array([rigid_from_twist(RATE * k / 30) for k in range(5)])
# An upright edge, 12 degrees off the axis of the middle frame.
EDGE = np.tan(0.2)


class Bent:
    """A near half plane before a far one, taken row by row while the camera yaws."""

    def _near(self) -> np.ndarray:
        x = (np.arange(160) - CAMERA.cx) / CAMERA.fx
        since_s = READOUT_S * (np.arange(120) / 119 - 0.5)
        yaw = RATE[1] * since_s
        near: np.ndarray = x[None, :] < np.tan(np.arctan(EDGE) - yaw)[:, None]
        return near

    def depth_native(self, index: int) -> np.ndarray:
        return np.where(self._near(), np.uint16(1000), np.uint16(3000))

    def color_encoded(self, index: int) -> tuple[str, bytes]:
        import cv2

        gray = np.where(self._near(), np.uint8(200), np.uint8(20))
        return ".png", cv2.imencode(".png", np.dstack([gray] * 3))[1].tobytes()

    def mask(self, index: int) -> np.ndarray:
        return self._near()


def edges(near: np.ndarray) -> np.ndarray:
    """In which column the near part ends, of the rows but for the border."""
    edges: np.ndarray = near[5:-5, 5:-5].sum(axis=1)
    return edges


def trajectory(readout_s: float | None) -> Trajectory:
    health = TrajectoryHealth(
        source="tracked", verdict="", grade="good", frames=5, tracked=5, readout_s=readout_s
    )
    return Trajectory(STAMPS_NS, POSES, "tracked", health=health)


def test_what_is_found_is_stored_in_milliseconds(tmp_path: Path) -> None:
    write_trajectory(trajectory(READOUT_S), tmp_path)
    assert '"readout_ms": 30.0' in (tmp_path / "health.json").read_text()
    shutter = read_trajectory(tmp_path, STAMPS_NS).shutter
    assert shutter is not None and shutter.readout_s == READOUT_S and shutter.color_delay_s == 0
    np.testing.assert_allclose(shutter.motion[:, :6], np.tile(RATE, (5, 1)), atol=1e-6)
    assert trajectory(None).shutter is None


@pytest.mark.parametrize("of", ["depth", "color", "mask", "own pixels"])
def test_an_upright_edge_is_straight_again(of: str) -> None:
    frames = Bent()
    sequence = Sequence(CAMERA, 1000.0, STAMPS_NS, True, None, frames, masks=frames.mask)
    assert np.ptp(edges(frames.mask(2))) >= 5
    seen = upright(sequence, trajectory(READOUT_S).shutter)
    if of == "own pixels":
        assert seen.masks is not None
        seen = by_own_pixels(seen, seen.masks)
    near_pixels: dict[str, Callable[[], np.ndarray | None]] = {
        "depth": lambda: seen.depth_m(2) < 2,
        "color": lambda: seen.color_rgb(2)[..., 0] > 100,  # type: ignore[index]
        "mask": lambda: seen.masks(2),  # type: ignore[misc]
        "own pixels": lambda: (seen.depth_m(2) < 2) & (seen.depth_m(2) > 0),
    }
    near = near_pixels[of]()
    assert near is not None and np.ptp(edges(np.asarray(near))) <= 2
    assert upright(sequence, None) is sequence


@pytest.mark.parametrize("damaged", [b"", b"\x89PNG nothing"])
def test_damaged_colour_stays_as_it_was_recorded(damaged: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Bent, "color_encoded", lambda self, index: (".png", damaged))
    sequence = Sequence(CAMERA, 1000.0, STAMPS_NS, True, None, Bent())
    assert upright(sequence, trajectory(READOUT_S).shutter).frames.color_encoded(2) == (".png", damaged)
