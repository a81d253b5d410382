"""A rolling shutter: undone as computed by hand, found from the frames alone, and only where there is one."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from analytic_scenes import Furniture, furniture
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from slow import slow
from tracking_scenes import couch, errors_m

from kinectbench.core.geometry import Camera, rigid
from kinectbench.core.geometry.rigid import rigid_from_twist
from kinectbench.core.geometry.rolling_shutter import RollingShutter, upright_depth, upright_gray
from kinectbench.lab.simulate.presets import preset_spec
from kinectbench.stages.track.features import FeatureCache
from kinectbench.stages.track.frame_maps import FrameMaps, MapCache
from kinectbench.stages.track.odometry import Followed, follow
from kinectbench.stages.track.registration import measure
from kinectbench.stages.track.shutter_search import OUTLIER, _Search, find_shutter, flow_rad_per_s, motions_of
from kinectbench.stages.track.tracker import track_frames

pytestmark = pytest.mark.xdist_group("tracking")
CAMERA = Camera(160, 121, 130.0, 130.0, 79.5, 60.0)
READOUT_S = 0.03
UNITS_PER_M = 10_000.0
STILL = np.zeros(12)


def motion(
    *, turn: tuple[float, float, float] = (0, 0, 0), shift: tuple[float, float, float] = (0, 0, 0)
) -> NDArray[np.float64]:
    """A steady motion: rad/s and m/s."""
    return np.array([*turn, *shift, *np.zeros(6)], np.float64)


def rolled_depth(moving: np.ndarray, normal: np.ndarray, offset_m: float) -> np.ndarray:
    """Depth (height, width) uint16 of the plane normal . p = offset in the middle's camera, row by row."""
    rays, rows = CAMERA.rays(), []
    for row, since_s in enumerate(READOUT_S * np.linspace(-0.5, 0.5, CAMERA.height)):
        T_middle_then = rigid_from_twist(since_s * moving[:6] + since_s**2 / 2 * moving[6:])
        along = rays[row] @ (T_middle_then[:3, :3].T @ normal)
        rows.append((offset_m - normal @ T_middle_then[:3, 3]) / along)
    return np.rint(np.array(rows) * UNITS_PER_M).astype(np.uint16)


@pytest.mark.parametrize(
    "moving",
    [
        motion(turn=(2.6, 0, 0)),
        motion(turn=(0, -2.6, 0)),
        motion(turn=(0, 0, 2.6)),
        motion(shift=(0.5, -0.5, 0.8)),
        np.array([1.5, 1.0, -1.5, 0.3, 0.2, -0.4, 20, -20, 20, 3, 3, 3], np.float64),
    ],
    ids=["pitch", "yaw", "roll", "shift", "all, accelerated"],
)
def test_depth_read_row_by_row_becomes_that_of_one_moment(moving: NDArray[np.float64]) -> None:
    normal = np.array([0.3, -0.4, np.sqrt(0.75)])
    exact = 2.0 / (CAMERA.rays() @ normal) * UNITS_PER_M
    read = rolled_depth(moving, normal, 2.0)
    found = upright_depth(read, UNITS_PER_M, CAMERA, moving, READOUT_S).astype(np.float64)
    seen = found > 0
    assert seen.mean() > 0.8
    # A millimetre at two metres or so; unmended it is centimetres.
    assert np.abs(found - exact)[seen].max() < 10
    assert np.abs(read - exact).max() > 100


def test_a_yaw_moves_a_row_as_computed_by_hand() -> None:
    """At 2 rad/s the first row, taken 15 ms early, looked 30 mrad farther to the left."""
    bright = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    bright[:] = np.arange(CAMERA.width)
    found = upright_gray(
        bright, np.ones(bright.shape, np.float32), CAMERA, motion(turn=(0, 2.0, 0)), READOUT_S, 0.0
    )
    # What is straight ahead in the middle (column 79.5) lay to the right then, by 130 tan(0.03) = 3.90 px.
    assert found[0, 79:81].mean() == pytest.approx(79.5 + 130 * np.tan(0.03), abs=0.6)
    assert found[60, 79:81].mean() == pytest.approx(79.5, abs=0.6)
    assert found[120, 79:81].mean() == pytest.approx(79.5 - 130 * np.tan(0.03), abs=0.6)


def test_late_colour_is_moved_back_by_its_delay() -> None:
    """At 1 m a shift of 0.5 m/s for 20 ms is 10 mm, 1.3 pixels; without depth nothing is known of it."""
    bright = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    bright[:] = np.arange(CAMERA.width)
    near = np.ones(bright.shape, np.float32)
    moving = motion(shift=(1.5, 0, 0))
    found = upright_gray(bright, near, CAMERA, moving, 0.0, 0.02)
    assert np.all(found[:, 80] == 80 - round(130 * 0.03))
    assert np.all(upright_gray(bright, 0 * near, CAMERA, moving, 0.0, 0.02) == bright)


def test_nothing_moves_without_motion_or_readout() -> None:
    depth = np.random.default_rng(0).integers(0, 40_000, (CAMERA.height, CAMERA.width)).astype(np.uint16)
    inner = np.s_[:-1, :-1]
    for moving, readout_s in ((STILL, READOUT_S), (motion(turn=(1, 1, 1)), 0.0)):
        found = upright_depth(depth, UNITS_PER_M, CAMERA, moving, readout_s)
        assert np.array_equal(found[inner], depth[inner])


def followed(T: np.ndarray, segment: int = 0) -> Followed:
    return Followed(segment, 0, T, None)


def test_motions_are_those_of_the_path() -> None:
    """Steady: 0.5 rad/s about y and 0.2 m/s; then none is known where frames lie far apart in time."""
    stamps_s = np.arange(6) / 30
    rate = np.array([0, 0.5, 0, 0.2, 0, 0])
    step = rigid_from_twist(rate / 30)
    frames = [followed(np.linalg.matrix_power(step, k)) for k in range(6)]
    found = motions_of(frames, stamps_s)
    # The camera moves along an arc: by 2 mm/s sidewards from one frame to the next.
    assert found[:, :6] == pytest.approx(np.tile(rate, (6, 1)), abs=3e-3)
    assert np.abs(found[:, 6:]).max() < 0.06
    assert not motions_of(frames, stamps_s * 10).any()
    assert not motions_of([None] * 6, stamps_s).any()
    # A lost frame moves as those beside it do; frames of two worlds say nothing of each other.
    assert motions_of([*frames[:2], None, *frames[3:]], stamps_s)[2, :6] == pytest.approx(rate, abs=3e-3)
    apart = [followed(rigid(Rotation.from_rotvec([0, k, 0]).as_matrix(), [0, 0, 0]), k) for k in range(6)]
    assert not motions_of(apart, stamps_s).any()


def test_flow_is_how_fast_things_pass() -> None:
    """At the centre of the view a yaw of 1 rad/s, or 2 m/s at 2 m, both move what is seen by 1 a second."""
    rates = np.array([[0, 1.0, 0, 0, 0, 0], [0, 0, 0, 2.0, 0, 0], [0, 0, 0, 0, 0, 0]])
    yaw, shift, still = flow_rad_per_s(rates, 2.0)
    assert yaw == pytest.approx(1.0, abs=0.1)
    assert shift == pytest.approx(1.0)
    assert still == 0


@cache
def turns(readout_s: float, delay_s: float) -> Furniture:
    """Two fast turns, there and back, 320 x 240."""
    sensor = {"width": 320, "height": 240, "readout_s": readout_s, "color_delay_s": delay_s}
    changed: dict[str, Any] = {
        "object": "chair:seed=3",
        "sensor": sensor,
        "path": {"frames": 42, "arc_rad": 0.03},
    }
    return furniture(preset_spec("turns-v1", changed))


def found_in(recording: Furniture) -> RollingShutter | None:
    maps = MapCache(recording.sequence)
    return find_shutter(maps, follow(maps, FeatureCache(maps)))


# That 0.03 and 0.01 are found is also said by test_fast_turns_are_tracked.
@pytest.mark.parametrize(("readout_s", "delay_s"), [slow(0.03, 0.01), slow(-0.02, 0.0)])
def test_readout_and_delay_are_found(readout_s: float, delay_s: float) -> None:
    found = found_in(turns(readout_s, delay_s))
    assert found is not None
    assert found.readout_s == pytest.approx(readout_s, abs=0.004)
    assert found.color_delay_s == pytest.approx(delay_s, abs=0.002)


def test_frames_taken_at_once_are_left_alone() -> None:
    """However fast the turns; a colour that is late is still mended."""
    assert found_in(turns(0.0, 0.0)) is None
    late = found_in(turns(0.0, 0.01))
    assert late is not None
    assert late.readout_s == 0
    assert late.color_delay_s == pytest.approx(0.01, abs=0.002)


def test_a_pair_without_common_points_is_the_worst_of_misfits() -> None:
    wall_m, nothing_m = np.full((240, 320), 2.0, np.float32), np.zeros((240, 320), np.float32)
    camera, no_color = Camera(320, 240, 290.0, 290.0, 159.5, 119.5), np.zeros((0, 0), np.float32)
    wall, nothing = (FrameMaps(camera, depth_m, no_color) for depth_m in (wall_m, nothing_m))
    search = _Search(MapCache(couch().sequence), [], STILL)
    search.found[READOUT_S] = [measure(wall, [nothing], [np.eye(4)])]
    assert search.misfit(READOUT_S) == OUTLIER


def test_slow_recordings_are_not_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(MapCache, "upright", lambda *_: pytest.fail("a slow walk tells nothing"))
    assert found_in(couch()) is None


def test_fast_turns_are_tracked(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = turns(0.03, 0.01)
    T_true = recording.simulation.T_world_camera
    tracked = track_frames(recording.sequence)
    assert tracked.readout_s == pytest.approx(0.03, abs=0.004)
    assert tracked.color_delay_s == pytest.approx(0.01, abs=0.002)
    assert np.isfinite(tracked.T_world_camera).all()
    right_m = np.sqrt(np.mean(errors_m(tracked.T_world_camera, T_true) ** 2))
    monkeypatch.setattr("kinectbench.stages.track.tracker.find_shutter", lambda *_: None)
    bent = track_frames(recording.sequence).T_world_camera
    kept = np.isfinite(bent[:, 0, 0])
    bent_m = np.sqrt(np.mean(errors_m(bent[kept], T_true[kept]) ** 2))
    assert right_m < 0.01
    assert right_m < 0.6 * bent_m
