"""A camera that stands still before what moves: every camera of the rig sees the same room."""

from typing import Any

import numpy as np
import pytest
from raising import raises

from kinectbench.core.errors import SettingsError
from kinectbench.core.geometry import invert_rigid
from kinectbench.lab.simulate.presets import preset_spec
from kinectbench.lab.simulate.render import StillRenderer
from kinectbench.lab.simulate.simulate import prepare, record_frame
from kinectbench.lab.simulate.spec import SimulationSpec


def spec_of(moves: str, **sensor: Any) -> SimulationSpec:
    return SimulationSpec.model_validate(
        {
            "object": "mug:seed=1",
            "path": {"moves": moves, "frames": 6, "rate_hz": 2.0, "distance_m": 0.7},
            "scene": {"stands_on": "table", "clutter": 4},
            "sensor": {"model": "ideal", "width": 160, "height": 120} | sensor,
        }
    )


@pytest.mark.parametrize("moves", ["turntable", "hand"])
@pytest.mark.parametrize("delay_s", [0.0, 0.1])
def test_a_colour_camera_beside_depth_sees_the_room_from_beside(moves: str, delay_s: float) -> None:
    simulation = prepare(spec_of(moves, color_registered=False, color_baseline_m=0.1, color_delay_s=delay_s))
    renderer, rig = simulation.renderer, simulation.rig
    assert isinstance(renderer, StillRenderer)
    T_room_color = renderer.T_room_still @ invert_rigid(rig.T_color_depth)
    around = renderer.around.render(rig.color, T_room_color)
    from_depth = renderer.around.render(rig.color, renderer.T_room_still)
    for index, planned in enumerate(simulation.frames):
        T_room_own = simulation.path.poses(np.array([planned.time_s + delay_s]))[0]
        own = renderer.own.render(rig.color, T_room_own @ invert_rigid(rig.T_color_depth))
        nothing = own.depth_m == 0
        seen = record_frame(simulation, index).frame.color_rgb
        np.testing.assert_array_equal(seen[nothing], around.color_rgb[nothing])
        # It is not what depth sees: the baseline shifts the table by several pixels.
        assert (seen[nothing] != from_depth.color_rgb[nothing]).any(axis=-1).mean() > 0.3


WALKED = (
    {"low_pass_share": 0.5},
    {"swing_rad": 0.5, "shake_m": 0.1, "shake_rad": 0.1, "reach_share": 0.1},
    {"jolt_m": 0.2, "jolt_rad": 0.5, "turn_rad": 0.5, "pause_s": 0.5, "order": "shuffled"},
)


@pytest.mark.parametrize("also", WALKED)
def test_a_turntable_only_turns(also: dict[str, Any]) -> None:
    """Seen from the plate, the camera keeps its height and its distance, whatever a walk would do."""
    spec = spec_of("turntable").model_dump()
    simulation = prepare(SimulationSpec.model_validate(spec | {"path": spec["path"] | also}))
    places = simulation.path.poses(np.arange(12) / 4)[:, :3, 3]
    assert np.ptp(places[:, 2]) < 1e-9 and np.ptp(np.linalg.norm(places[:, :2], axis=1)) < 1e-9
    assert np.ptp(places[:, 0]) > 0.1


def test_no_blur_of_a_room_that_stands_still() -> None:
    with raises(SettingsError, "settings.wrong-value", match="0") as caught:
        preset_spec("orbit-v1", {}, ["path.moves=turntable", "sensor.exposure_s=0.02"])
    assert "\n" not in str(caught.value)
