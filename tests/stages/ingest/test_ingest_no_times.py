"""Stamps that are no times, such as steps since the frame before: frames stay in their order."""

from pathlib import Path

import numpy as np
import pytest
from ingest_writers import (
    depth_image,
    quaternion,
    translation,
    whole_frames,
    write_folder,
    write_tum,
)

from kinectbench.core.geometry import Camera
from kinectbench.core.trajectory.stamps import no_times
from kinectbench.lab.simulate.writers import RecordedFrame, Rig, formats
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.readers import open_recording

FRAMES = 24
CAMERA = Camera(64, 48, 60.0, 61.0, 31.5, 23.5)
# Seconds since the frame before; microseconds that were taken for seconds; a clock that runs far too fast.
STEPS_S = 0.033 + 0.004 * np.sin(np.arange(FRAMES) * 2.4)
WRONG = {
    "steps": STEPS_S,
    "steps in microseconds": STEPS_S * 1e-3,
    "too fast": np.arange(FRAMES) * 169e-6 + 5,
}


def tum(folder: Path, stamps_s: np.ndarray, poses: int = FRAMES) -> Path:
    write_tum(folder, FRAMES)
    rows = [f"{stamp_s:.9f}" for stamp_s in stamps_s]
    for name in ("depth", "rgb"):
        suffix = "png" if name == "depth" else "jpg"
        lines = [f"{stamp} {name}/{i}.{suffix}" for i, stamp in enumerate(rows)]
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    numbers = [" ".join(repr(v) for v in [*translation(i), *quaternion(i)]) for i in range(poses)]
    lines = [f"{rows[i % FRAMES]} {pose}" for i, pose in enumerate(numbers)]
    (folder / "groundtruth.txt").write_text("\n".join(lines) + "\n")
    return folder


@pytest.mark.parametrize("wrong", WRONG)
def test_rows_of_a_tum_folder_are_counted(tmp_path: Path, wrong: str) -> None:
    recording = open_recording(tum(tmp_path / "r", WRONG[wrong]))
    (warning,) = recording.warnings
    assert "its stamps are no times (they " in warning and warning.endswith("its rows are counted instead")
    assert recording.stamps_ns.tolist() == [i * 10**9 for i in range(FRAMES)]
    for i, frame in enumerate(whole_frames(recording)):
        np.testing.assert_array_equal(frame.depth, depth_image(i))
        assert frame.color == (".jpg", (tmp_path / f"r/rgb/{i}.jpg").read_bytes())
    given = recording.given_trajectory
    assert given is not None and given.stamps_ns.tolist() == [i * 10**9 for i in range(FRAMES)]
    np.testing.assert_allclose(given.T_world_camera[:, 0, 3], [translation(i)[0] for i in range(FRAMES)])


def test_poses_of_another_number_belong_to_no_frame(tmp_path: Path) -> None:
    recording = open_recording(tum(tmp_path / "r", STEPS_S, poses=FRAMES + 3))
    assert recording.given_trajectory is None and len(recording) == FRAMES
    assert "holds 27 poses for 24 frames whose stamps are no times" in recording.trajectory_error


def test_names_with_such_stamps_are_numbered(tmp_path: Path) -> None:
    stems = [
        f"{i + 1:07d}-{round(1e6 * step_s):012d}" for i, step_s in enumerate(STEPS_S + np.arange(24) % 5)
    ]
    recording = open_recording(write_folder(tmp_path / "r", stems))
    assert recording.stamps_ns.tolist() == [(i + 1) * 10**9 for i in range(FRAMES)]


@pytest.mark.parametrize("name", ["klg", "sens"])
def test_logs_with_such_stamps_are_counted(tmp_path: Path, name: str) -> None:
    stamps_ns = (STEPS_S * 1e9).astype(int).tolist()
    color = np.zeros((48, 64, 3), np.uint8)
    made = [
        RecordedFrame(ns, (depth_image(i, 1000.0) / 1000).astype(np.float32), ns, color, np.eye(4))
        for i, ns in enumerate(stamps_ns)
    ]
    out = formats()[name].write_new(tmp_path / "r", Rig(CAMERA, CAMERA, True, np.eye(4)), made)
    recording = open_recording(out, CameraSettings(width=64, height=48, fx=60, fy=61, cx=31.5, cy=23.5))
    assert recording.stamps_ns.tolist() == [i * 10**9 for i in range(FRAMES)]
    assert sum("its stamps are no times" in warning for warning in recording.warnings) == 1


@pytest.mark.parametrize(
    "stamps_s",
    [
        np.arange(200) / 30,
        np.arange(200) / 300 + 1.3e9,
        np.repeat(np.arange(100), 2) / 30,  # each frame twice
        np.concatenate([np.arange(100) / 30, np.arange(100) / 30]),  # a clock that began anew
        np.arange(200) / 30 + 0.05 * (np.arange(200) % 20 == 7),  # two frames of twenty exchanged
        STEPS_S[:9],  # too few to tell
        [0.0] * 200,
        np.random.default_rng(0).permutation(200) / 30 + 1.3e9,  # a list in no order
    ],
)
def test_stamps_of_clocks_are_times(stamps_s: np.ndarray) -> None:
    assert no_times((np.asarray(stamps_s) * 1e9).astype(int).tolist()) == ""
