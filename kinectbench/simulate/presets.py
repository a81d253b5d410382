"""Named, versioned recordings: the figures of different versions of the package compare on these.

A preset is never changed; a better one gets the next version. `tests/simulate/test_simulate_presets.py` holds
the hash of each.
"""

import difflib
from collections.abc import Sequence
from typing import Any

import numpy as np

from kinectbench.errors import SettingsError
from kinectbench.options import merged, settings_from_options
from kinectbench.simulate.spec import SimulationSpec

# 300 frames at 15 Hz: twenty seconds around the object and a little farther, at an easy pace.
_ORBIT: dict[str, Any] = {"path": {"frames": 300, "rate_hz": 15.0}}


def _orbit(**sections: dict[str, Any]) -> dict[str, Any]:
    return {**_ORBIT, **sections, "path": {**_ORBIT["path"], **sections.get("path", {})}}


PRESETS: dict[str, tuple[str, dict[str, Any]]] = {
    "orbit-v1": ("a full orbit indoors, Kinect v1", _orbit()),
    "ideal-v1": ("the same with exact depth and colour", _orbit(sensor={"model": "ideal"})),
    "arc-v1": (
        "120 degrees, no loop to close",
        _orbit(path={"arc_rad": 2 * np.pi / 3, "frames": 120, "swings": 0.5}),
    ),
    "half-v1": ("half an orbit: the back is never seen", _orbit(path={"arc_rad": np.pi, "frames": 150})),
    "stride2-v1": ("half as many frames a second", _orbit(path={"frames": 150, "rate_hz": 7.5})),
    "stride3-v1": ("a third as many frames a second", _orbit(path={"frames": 100, "rate_hz": 5.0})),
    "blur-v1": (
        "motion blur, changing exposure, a restless hand",
        _orbit(
            path={"shake_m": 0.012, "shake_rad": 0.02}, sensor={"exposure_s": 1 / 30, "exposure_drift": 0.3}
        ),
    ),
    "jolt-v1": ("a knock of 8 cm and 8 degrees", _orbit(path={"jolt_m": 0.08, "jolt_rad": 0.14})),
    "pause-v1": ("three seconds' pause half-way", _orbit(path={"pause_s": 3.0})),
    "drop-v1": ("5 % of the frames are missing", _orbit(faults={"drop_share": 0.05})),
    "outdoor-v1": ("open ground in the sun: less depth", _orbit(scene={"place": "outdoor"})),
    "touching-v1": ("a box stands against the object", _orbit(scene={"touching": True})),
    "cluttered-v1": ("four walls and eight things around", _orbit(scene={"walls": 4, "clutter": 8})),
    "unregistered-v1": (
        "colour from its own camera, 16 ms late",
        _orbit(sensor={"color_registered": False, "color_delay_s": 0.016}),
    ),
    "drift-v1": ("a given trajectory that drifts 1 %", _orbit(given={"trajectory": "drifting"})),
    "jump-v1": ("a given trajectory that jumps by 10 cm", _orbit(faults={"jump_m": 0.1})),
    "foreign-v1": ("ten frames show another scene", _orbit(faults={"foreign_frames": 10})),
}


def preset_spec(name: str, changes: dict[str, Any], overrides: Sequence[str] = ()) -> SimulationSpec:
    """The spec of a preset, with some of its values changed.

    Args:
        name: such as "orbit-v1".
        changes: nested values as in SimulationSpec; they win.
        overrides: `section.key=value` or `key=value`, the value in YAML; they win over these.

    Raises:
        SettingsError: there is no such preset, or one line for each wrong value.
    """
    values = merged(preset_values(name), changes)
    return settings_from_options(SimulationSpec, values, overrides, "simulation")


def preset_values(name: str) -> dict[str, Any]:
    """What a preset says, as nested values.

    Raises:
        SettingsError: there is no such preset; the nearest name is suggested.
    """
    if name not in PRESETS:
        near = difflib.get_close_matches(name, PRESETS, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"there are {', '.join(PRESETS)}"
        raise SettingsError(f"preset '{name}': unknown; {hint}")
    return PRESETS[name][1]
