"""Exact poses of box-like things, near and far, in no order of time: no pose is doubted, none is left out."""

from pathlib import Path

import numpy as np
import pytest
from slow import slow
from typed import present

from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.settings.models import TrackingSettings
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence
from kinectbench.stages.track import track

pytestmark = pytest.mark.xdist_group("tracking")
# Half of what is allowed of a frame.
MOST_SHIFT_M = 0.0125


def recorded(folder: Path, name: str, model: str, frames: int, scene: dict[str, int]) -> Sequence:
    spec = {
        "object": name,
        "path": {"order": "shuffled", "frames": frames, "rate_hz": 15.0, "elevation_rad": 0.7,
                 "swing_rad": 0.65},
        "scene": scene,
        "sensor": {"model": model, "width": 320, "height": 240},
        "save_depth": False,
    }  # fmt: skip
    simulate(SimulationSpec.model_validate(spec), folder / "recording")
    (folder / "sequence").mkdir()
    write_sequence(open_recording(folder / "recording"), folder / "sequence", lambda done, total: None)
    return read_sequence(folder / "sequence")


def wrong(sequence: Sequence, frame: int, shift_m: float) -> Sequence:
    from dataclasses import replace

    from kinectbench.core.sequence import GivenTrajectory

    given = sequence.given_trajectory
    assert given is not None
    T = given.T_world_camera.copy()
    T[frame, :3, 3] += T[frame, :3, 2] * shift_m
    return replace(sequence, given_trajectory=GivenTrajectory(given.stamps_ns, T))


@pytest.mark.parametrize(
    ("name", "model", "frames", "scene"),
    [
        slow("fridge:seed=0", "ideal", 60, {}),
        ("fridge:seed=1", "ideal", 24, {"walls": 0, "clutter": 0}),
        slow("sideboard:seed=2", "kinect_v1", 30, {"walls": 0, "clutter": 0}),
        ("mug:seed=0", "ideal", 40, {}),
    ],
)
def test_exact_poses_get_the_verdict_they_deserve(
    name: str, model: str, frames: int, scene: dict[str, int], tmp_path: Path
) -> None:
    found = track(recorded(tmp_path, name, model, frames, scene), None, TrackingSettings())
    health = present(found.health)
    given = present(health.given)
    assert health.rejected == () and health.warnings == ()
    assert given.largest_jump_m == 0 and health.recommended == "trust"
    assert health.verdict.startswith("good") and np.isfinite(found.T_world_camera).all()
    assert given.distant_unmatched is None or given.distant_unmatched < 0.4
    assert max(row.shift_m or 0.0 for row in health.per_frame) < MOST_SHIFT_M


def test_a_wrong_pose_among_them_is_still_left_out(tmp_path: Path) -> None:
    sequence = recorded(tmp_path, "sideboard:seed=2", "kinect_v1", 40, {})
    for frame in (5, 22):
        found: Trajectory = track(wrong(sequence, frame, 0.08), None, TrackingSettings())
        assert [row.frame for row in present(found.health).rejected] == [frame]
