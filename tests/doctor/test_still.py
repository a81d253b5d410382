"""`inspect` tells a turntable from a camera that is carried around."""

from pathlib import Path

import numpy as np
import pytest
from ingest_writers import jpeg, png, write_folder
from ycb_replica import make_thing

from kinectbench.doctor import inspect
from kinectbench.doctor.during_build import OffsetWatch
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.stages.ingest.readers import open_recording

# Of each finding, by its name.
Advice = dict[str, str]
# A camera that is led around at one height sees the floor as if it stood still.
LEVEL = {"swing_rad": 0.0, "reach_share": 0.0, "shake_m": 0.002, "shake_rad": 0.003}


def found(
    tmp_path: Path, given: dict[str, object], own_pixels: bool = False, **path: object
) -> dict[str, str]:
    spec = {
        "object": "kettle:seed=1",
        "seed": 1,
        "format": "folder",
        "path": {"frames": 12, "rate_hz": 4.0, **LEVEL, **path},
        "sensor": {"width": 320, "height": 240},
        "given": {"trajectory": "none", **given},
    }
    simulate(SimulationSpec.model_validate(spec), tmp_path / "kettle")
    return advice_in(tmp_path / "kettle", own_pixels)[0]


def advice_in(recording: Path, own_pixels: bool = False) -> tuple[dict[str, str], dict[str, object]]:
    """The advice of each finding, and the facts."""
    diagnosis, _ = inspect(recording, own_pixels=own_pixels)
    return {finding.name: finding.advice for finding in diagnosis.findings}, dict(diagnosis.facts)


NAMES = {"turntable", "one_view", "plain_background"}


@pytest.mark.parametrize("given", [{}, {"trajectory": "true"}])
def test_a_turntable_is_recognised(tmp_path: Path, given: dict[str, object]) -> None:
    advice = found(tmp_path, given, moves="turntable")
    assert "segment_by: turntable" in advice["turntable"]
    # Poses of a camera that does not move fit nothing and everything.
    assert not any(name.startswith("trajectory") for name in advice)


def test_where_masks_come_with_it_they_are_named(tmp_path: Path) -> None:
    advice = found(tmp_path, {"masks": True}, moves="hand", swing_rad=0.3)
    assert "segment_by: masks" in advice["turntable"]


def test_nothing_is_said_once_it_is_said_in_the_settings(tmp_path: Path) -> None:
    assert not NAMES & found(tmp_path, {}, own_pixels=True, moves="turntable").keys()


def test_a_camera_that_is_carried_around_is_none(tmp_path: Path) -> None:
    assert not NAMES & found(tmp_path, {}).keys()


def test_poses_of_a_turning_object_are_not_those_of_another_recording(tmp_path: Path) -> None:
    make_thing(tmp_path, "crate", "crate:seed=0")
    advice, _ = advice_in(tmp_path / "crate")
    assert "segment_by: masks" in advice["turntable"] and "trajectory: trust" in advice["turntable"]
    assert (
        "trajectory_wrong" not in advice and "trajectory_wrong" not in advice_in(tmp_path / "crate", True)[0]
    )
    recording = open_recording(tmp_path / "crate")
    watch = OffsetWatch(recording)
    for index in range(len(recording)):
        if watch.wants(index):
            watch.see(index, recording.frame(index))
    assert any("segment_by: masks" in line for line in watch.warnings())


def test_one_view_only(tmp_path: Path) -> None:
    advice = found(tmp_path, {}, moves="turntable", arc_rad=0.0)
    assert "one_view" in advice
    assert "turntable" not in advice


@pytest.mark.parametrize("own_pixels", [False, True])
@pytest.mark.parametrize("arc_rad", [0.0, 3.0])
def test_poses_of_a_camera_that_stands_still_are_not_read(
    tmp_path: Path, arc_rad: float, own_pixels: bool
) -> None:
    found(tmp_path, {"trajectory": "true"}, moves="turntable", arc_rad=arc_rad)
    advice, facts = advice_in(tmp_path / "kettle", own_pixels)
    assert facts["poses"] == 12 and "poses_read_as" not in facts and "arc_deg" not in facts
    assert not {"mirrored_images", "trajectory_reading", "trajectory_scale"} & advice.keys()


def test_frames_in_no_order_of_time_are_of_no_turntable(tmp_path: Path) -> None:
    """A camera that is driven over a bare floor, which has the same depth in every frame."""
    write_folder(tmp_path / "r", [str(i) for i in range(30)])
    rng = np.random.default_rng(0)
    for i in range(30):
        depth = np.repeat(np.linspace(1500, 700, 48)[:, None], 64, axis=1)
        depth[:28] = rng.uniform(1000, 6000)
        depth += 3 * np.arange(64)
        (tmp_path / f"r/depth/{i}.png").write_bytes(png(depth.astype(np.uint16)))
    gray = np.full((48, 64, 3), 90, np.uint8)
    for file in (tmp_path / "r/color").iterdir():
        file.write_bytes(jpeg(gray))
    advice, _ = advice_in(tmp_path / "r")
    assert "frame_order" in advice and not NAMES & advice.keys()
