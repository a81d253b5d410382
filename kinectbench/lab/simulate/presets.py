"""Named simulations: versioned presets, the sample recordings, the demo's recordings, and their writer.

Presets serve to compare results of different package versions. So a preset never changes; a better one gets
the next version. `tests/lab/simulate/test_simulate_presets.py` has the hash of each.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from kinectbench.core import SettingsError
from kinectbench.core.types import NamedProgress
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec, WorldFrame
from kinectbench.scoring.workers import run_tasks
from kinectbench.settings.overrides import merged, settings_from_options
from kinectbench.settings.words import suggestion

# 300 frames at 15 Hz: twenty seconds around the object and a little farther, at an easy pace.
_ORBIT: dict[str, object] = {"path": {"frames": 300, "rate_hz": 15.0}}


def _orbit(**sections: dict[str, object]) -> dict[str, object]:
    return merged(_ORBIT, sections)


PRESETS: dict[str, tuple[str, dict[str, object]]] = {
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
    # 3 to 77 degrees, a view about every 5 degrees; from above a camera looks into openings that a walk
    # passes by.
    "hemisphere-v1": (
        "views from all over, in no order of time",
        _orbit(path={"order": "shuffled", "frames": 150, "elevation_rad": 0.7, "swing_rad": 0.65}),
    ),
    # 65 degrees, 10 more and less: upright faces are seen only at a slant, undersides never.
    "steep-v1": (
        "looking steeply down, 55 to 75 degrees",
        _orbit(path={"elevation_rad": 1.134, "swing_rad": 0.16}),
    ),
    # For objects of 10 to 40 cm, as near as the sensor's range allows; no fixed distance suits all of these
    # (from 0.6 m, a third of the visible part of a 40 cm cylinder is within a Kinect's 0.4 m). The objects
    # stand on a table, beside which a camera can be held lower than above a floor.
    "near-v1": (
        "table-top things (10-40 cm), from 0.5 to 0.9 m",
        _orbit(path={"reach_share": 0.08, "lowest_m": 0.1}),
    ),
    "far-v1": ("from 2.5 to 4 m away", _orbit(path={"distance_m": 3.2, "reach_share": 0.12})),
    # A hand turns a camera in place, to test a tracker: 150 degrees a second, 23 seconds.
    "turns-v1": (
        "fast turns in place, up to 150 degrees a second, blurred",
        {
            "path": {
                "frames": 700,
                "rate_hz": 30.0,
                "arc_rad": 0.4,
                "distance_m": 1.8,
                "shake_m": 0.015,
                "turn_rad": 0.6,
                "turn_rad_per_s": 2.618,
            },
            "scene": {"walls": 4, "clutter": 8},
            "sensor": {"exposure_s": 1 / 60, "exposure_drift": 0.3, "color_delay_s": 0.01, "readout_s": 0.03},
            "faults": {"drop_share": 0.02, "stamp_jitter_s": 0.001},
        },
    ),
    "azure-v1": ("a full orbit, Azure Kinect", _orbit(sensor={"model": "azure_kinect"})),
    "phone-v1": ("a full orbit, a phone's LiDAR", _orbit(sensor={"model": "phone_lidar"})),
    "stereo-v1": ("a full orbit, active stereo as of a RealSense D435", _orbit(sensor={"model": "stereo"})),
    # For recordings whose truth is judged: short, from 10 to 45 degrees of elevation, so that most openings
    # are seen at a slant. Two and a half swings in eighteen seconds show each side from low and from high.
    "known-v1": (
        "a short orbit, 10 to 45 degrees, no poses given",
        {
            "path": {
                "frames": 180,
                "rate_hz": 10.0,
                "elevation_rad": 0.48,
                "swing_rad": 0.305,
                "swings": 2.5,
            },
            "given": {"trajectory": "none"},
        },
    ),
    # A walk sees little of the undersides of objects on legs: from 20 to 30 cm above the floor, a camera
    # looks up at higher undersides.
    "known-low-v1": (
        "the same, and a second time around at 20 to 30 cm",
        {
            "path": {
                "frames": 360,
                "rate_hz": 10.0,
                "arc_rad": 4.2 * np.pi,
                "elevation_rad": 0.48,
                "swing_rad": 0.305,
                "swings": 5.0,
                "lowest_m": 0.2,
                "low_pass_share": 0.5,
            },
            "given": {"trajectory": "none"},
        },
    ),
}


def preset_spec(name: str, changes: Mapping[str, object], overrides: Sequence[str] = ()) -> SimulationSpec:
    """Return the spec of a preset, with some of its values changed.

    Args:
        name: the preset's name, such as "orbit-v1".
        changes: nested values as in SimulationSpec, which replace the preset's.
        overrides: `section.key=value` or `key=value`, the value in YAML; they replace `changes`.

    Raises:
        SettingsError: the preset is unknown (the most similar is suggested), or one line for each wrong
            value.
    """
    if name not in PRESETS:
        raise SettingsError(f"preset '{name}': unknown; {suggestion(name, [*PRESETS])}")
    return settings_from_options(SimulationSpec, merged(PRESETS[name][1], changes), overrides, "simulation")


def _spec(name: str, frames: int, form: str, world: WorldFrame) -> SimulationSpec:
    """Return the spec of a short recording at 320x240 and 5 Hz; to save space, it has no noise-free depth.

    Around tables the camera is held low, so that it also sees below the top.
    """
    low = {"elevation_rad": 0.2} if name.startswith("table") else {}
    values = {
        "object": name,
        "format": form,
        "world": world,
        "path": {"frames": frames, "rate_hz": 5.0, **low},
        "sensor": {"width": 320, "height": 240},
        "save_depth": False,
    }
    return SimulationSpec.model_validate(values)


# `kinectbench simulate --samples recordings` makes these two again, with the same bytes.
SAMPLES: dict[str, SimulationSpec] = {
    "chair_01": _spec("chair:seed=7", 72, "tum", "upright"),
    "table_01.bag": _spec("table:seed=9", 72, "bag", "first_camera"),
}

# `kinectbench simulate --demo demo/recordings` makes this one.
DEMO: dict[str, SimulationSpec] = {"chair_02": _spec("chair:seed=9", 60, "tum", "first_camera")}


def simulate_named(
    out: Path | None,
    preset: str,
    changes: dict[str, object],
    overrides: Sequence[str],
    samples: Path | None,
    demo: Path | None,
    progress: NamedProgress,
    jobs: int = 1,
) -> list[Path]:
    """Simulate and write one recording, all sample recordings, or all of the demo; return their paths.

    Args:
        out: path of one recording; its default format is a ROS 1 bag if it ends in .bag, else the preset's.
        preset: preset of `out`, such as "orbit-v1".
        changes: nested values as in SimulationSpec, which replace the preset's.
        overrides: `section.key=value`, which replace `changes`.
        samples: folder for the sample recordings.
        demo: folder for the demo's recordings.
        progress: called with (recording, frames done, frames), or (folder, recordings done, recordings).
        jobs: number of processes for several recordings.

    Raises:
        SettingsError: not exactly one of `out`, `samples` and `demo` is given; the preset or object is
            unknown; or a value is out of range.
        RecordingError: the mesh cannot be used.
        StorageError: a recording cannot be written.
    """
    if sum(choice is not None for choice in (out, samples, demo)) != 1:
        raise SettingsError("simulate: give one of OUT, --samples FOLDER and --demo FOLDER")
    if samples is not None:
        specs = {samples / name: spec for name, spec in SAMPLES.items()}
    elif demo is not None:
        specs = {demo / name: spec for name, spec in DEMO.items()}
    else:
        assert out is not None
        by_name = {"format": "bag"} if out.suffix == ".bag" else {}
        specs = {out: preset_spec(preset, by_name | changes, overrides)}
    if len(specs) == 1:
        for path, spec in specs.items():
            simulate(spec, path, partial(progress, path.name))
    else:
        run_tasks(_simulated, list(specs.items()), jobs, partial(progress, next(iter(specs)).parent.name))
    return list(specs)


def _simulated(task: tuple[Path, SimulationSpec]) -> None:
    """Simulate one (path, spec) of several; the task of a worker process."""
    path, spec = task
    simulate(spec, path)
