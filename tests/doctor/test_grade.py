"""`inspect` grades a given trajectory as a build does: by the same functions, in the same words."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from read_pictures import read_picture

import kinectbench
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.doctor import grade
from kinectbench.doctor.finding import Finding
from kinectbench.doctor.grade import check_grade
from kinectbench.doctor.probe import Probe, probe_recording
from kinectbench.settings.models import TrackingSettings
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import FileRecording, Recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence
from kinectbench.stages.track import track

CHAIR = Path(__file__).parents[2] / "recordings/chair_01"
FRAMES = 20
Change = Callable[[NDArray[np.generic]], bytes]
# Fewer points than usual: the same are taken by both.
TRACKING = TrackingSettings(check_stride_px=16)


def shifted(recording: Recording, from_row: int, by_m: float) -> Recording:
    """The recording with poses that jump."""
    given = recording.given_trajectory
    assert given is not None
    T = given.T_world_camera.copy()
    T[from_row:, 0, 3] += by_m
    return replace(recording, given_trajectory=GivenTrajectory(given.stamps_ns, T))


@pytest.fixture(scope="module")
def chair() -> Recording:
    recording = open_recording(CHAIR, None)
    return replace(recording, places=recording.places[:FRAMES])


@pytest.fixture(scope="module")
def jumping(chair: Recording) -> Probe:
    return probe_recording(shifted(chair, FRAMES // 2, 0.06))


@pytest.fixture(scope="module")
def findings(jumping: Probe) -> dict[str, Finding]:
    return {found.name: found for found in check_grade(jumping, TRACKING)}


def test_the_grade_is_that_of_the_build(jumping: Probe, findings: dict[str, Finding], tmp_path: Path) -> None:
    write_sequence(jumping.recording, tmp_path)
    health = track(read_sequence(tmp_path), None, TRACKING).health
    assert health is not None and health.grade == "not good"
    found = findings["trajectory_grade"]
    assert found.what == f"the given trajectory: {health.verdict}" and found.severity == "warning"
    assert found.advice == f"recommended is `trajectory: {health.recommended}`"
    assert findings["trajectory_check"].what == health.warnings[-1]


def test_of_a_long_recording_some_frames_are_compared(
    jumping: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(grade, "MOST_FRAMES", 10)
    (found,) = check_grade(jumping, TRACKING, mode="refine")
    assert found.what.startswith("the given trajectory, by 10 of 20 frames: ") and found.severity == "note"
    assert found.what.endswith("a build refines it, and grades the result") and found.advice == ""


def halved(image: NDArray[np.generic]) -> bytes:
    return cv2.imencode(".png", image[: image.shape[0] // 2, : image.shape[1] // 2])[1].tobytes()


def cut_off(image: NDArray[np.generic]) -> bytes:
    """A header and an end, so that decoding alone shows the damage."""
    data = cv2.imencode(".png", image)[1].tobytes()
    return data[:200] + data[-200:]


@pytest.mark.parametrize("most", [10, FRAMES])
@pytest.mark.parametrize("change", [halved, cut_off])
@pytest.mark.parametrize("part", ["depth", "color"])
def test_frames_that_a_build_leaves_out_are_not_compared(
    jumping: Probe, part: str, change: Change, most: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(grade, "MOST_FRAMES", most)
    of_folder = jumping.recording
    assert isinstance(of_folder, FileRecording)
    right = read_picture(getattr(of_folder.places[8], part), cv2.IMREAD_UNCHANGED)
    (tmp_path / "0008.png").write_bytes(change(right))
    changed: dict[str, Any] = {part: tmp_path / "0008.png"}
    *before, old = of_folder.places[:9]
    places = (*before, replace(old, **changed), *of_folder.places[9:])
    (found, *_) = check_grade(probe_recording(replace(of_folder, places=places)), TRACKING, mode="refine")
    which = "" if most == FRAMES else f", by {most - 1} of {FRAMES} frames"
    assert found.what.startswith(f"the given trajectory{which}: ")


def test_poses_that_fit_nowhere_stop_as_in_a_build(chair: Recording) -> None:
    given = chair.given_trajectory
    assert given is not None
    T = given.T_world_camera.copy()
    T[:, :3, 3] += np.random.default_rng(0).uniform(-0.3, 0.3, (len(T), 3))
    wrong = replace(chair, given_trajectory=GivenTrajectory(given.stamps_ns, T))
    (found,) = check_grade(probe_recording(wrong), TRACKING)
    assert found.name == "trajectory_wrong" and found.severity == "stops"
    assert "frames disagree" in found.what or "frames can be used" in found.what


def test_inspect_never_points_at_itself() -> None:
    """What it shows comes from the rooms below; these say it where a build alone does."""
    package = Path(kinectbench.__file__).parent
    rooms = (file for room in ("core", "stages", "doctor") for file in (package / room).rglob("*.py"))
    pointing = {file.name for file in rooms if "`kinectbench inspect`" in file.read_text(encoding="utf-8")}
    assert pointing == {"during_build.py", "plausibility.py"}
