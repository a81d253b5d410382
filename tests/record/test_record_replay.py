"""A recording in place of a camera: what is recorded of it, when, and what a build makes of that."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from small_runs import make_small, start
from written_frames import START_NS, STEP_NS, color_rgb, frame, read, write

from kinectbench.core.errors import CaptureError, RecordingError
from kinectbench.lab.simulate.writers import RecordedFrame
from kinectbench.record.devices.replay import KEPT, Replay
from kinectbench.record.recorder import record
from kinectbench.stages.ingest.readers import open_recording

# One of each kind: files, a ROS 1 bag, sqlite, an archive, colour that is not registered.
FORMATS = [("tum", True), ("folder", False), ("bag", False), ("ros2_sqlite", True), ("sens", True)]


@pytest.mark.parametrize(("name", "registered"), FORMATS, ids=lambda value: str(value))
def test_a_replay_is_recorded_as_it_was(tmp_path: Path, name: str, registered: bool) -> None:
    """Depth, stamps, bytes of colour, camera, scale and calibration are equal."""
    source = write(tmp_path / f"source{'.sens' * (name == 'sens')}", name, map(frame, range(6)), registered)
    before = open_recording(source)
    done = record(Replay(source, 2.0 if name != "folder" else 40.0), tmp_path / "out")
    after = open_recording(tmp_path / "out")
    assert (done.frames, done.missed, done.dropped) == (6, 0, 0)
    assert after.camera == before.camera and after.depth_scale == before.depth_scale
    assert after.color_registered == before.color_registered
    for one, other in zip(read(before), read(after), strict=True):
        assert one.stamp_ns == other.stamp_ns and np.array_equal(one.depth, other.depth)
        assert one.color == other.color and color_rgb(one).shape == color_rgb(other).shape
    if before.color_calibration is not None:
        assert after.color_calibration is not None
        assert after.color_calibration.camera == before.color_calibration.camera
        T = before.color_calibration.T_color_depth
        assert np.allclose(after.color_calibration.T_color_depth, T, rtol=0, atol=1e-12)


def test_a_recording_without_a_sound_frame_says_why(tmp_path: Path) -> None:
    source = write(tmp_path / "source", "tum", map(frame, range(3)))
    for path in (source / "depth").iterdir():
        with Image.open(path) as depth:
            Image.new("L", depth.size, 7).save(path)
    with pytest.raises(CaptureError, match=r"no frame can be read: .*\.png"):
        record(Replay(source, 50.0), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_frames_come_at_their_own_pace_or_faster(tmp_path: Path) -> None:
    source = write(tmp_path / "source", "tum", map(frame, range(10)))
    for speed in (1.0, 3.0):
        replay = Replay(source, speed)
        replay.open()
        times_s = [time.monotonic() for _ in replay.frames()]
        replay.close()
        took_s = 9 * STEP_NS / 1e9 / speed
        assert took_s - 0.001 < times_s[-1] - times_s[0] < took_s + 0.3


@pytest.mark.parametrize("jump_s", [1.7e9, -50.0])
def test_a_jump_of_the_clock_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, jump_s: float
) -> None:
    """As where a camera's own clock becomes the machine's: 54 years."""

    def stamped(k: int) -> RecordedFrame:
        raw, shift_ns = frame(k), round(1e9 * (jump_s if k >= 6 else 0))
        return replace(raw, stamp_ns=raw.stamp_ns - START_NS + 10**11 + shift_ns)

    source = write(tmp_path / "source", "tum", map(stamped, range(12)))
    waited_s: list[float] = []
    monkeypatch.setattr(time, "sleep", waited_s.append)
    replay = Replay(source)
    replay.open()
    assert len([*replay.frames()]) == 12
    replay.close()
    assert 0.3 < max(waited_s) < 1.0 + 12 * STEP_NS / 1e9


def test_frames_that_are_taken_late_are_lost_and_counted(tmp_path: Path) -> None:
    """Whoever takes 100 ms for each of 40 frames that come within 33 ms gets every third one."""
    source = write(tmp_path / "source", "tum", map(frame, range(40)))
    replay, taken = Replay(source), []
    replay.open()
    for raw in replay.frames():
        taken.append(round((raw.stamp_ns - START_NS) / STEP_NS))
        time.sleep(0.1)
    replay.close()
    assert len(taken) + replay.missed == 40
    assert 10 <= len(taken) <= 10 + 2 * KEPT and taken == sorted(taken) and taken[-1] >= 36


def test_damaged_images_are_lost_and_counted(tmp_path: Path) -> None:
    source = write(tmp_path / "source", "tum", map(frame, range(5)))
    sorted((source / "depth").iterdir())[2].write_bytes(b"no image")
    done = record(Replay(source, 4.0), tmp_path / "out")
    assert (done.frames, done.missed) == (4, 1)


def test_what_is_no_recording_is_one_line_and_makes_nothing(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(RecordingError, match="the folder is empty"):
        record(Replay(tmp_path / "empty"), tmp_path / "out")
    assert not (tmp_path / "out").exists()
    assert Replay(tmp_path / "gone").plugged_in() == ()


def test_a_build_makes_the_same_of_what_is_recorded(tmp_path: Path) -> None:
    """Nothing differs but that a camera gives no poses: frames, trajectory, object, views and pairs."""
    root = make_small(tmp_path / "one", ("chair",))
    source = root / "recordings/chair"
    record(Replay(source, 30.0), tmp_path / "out")
    again = tmp_path / "two"
    (again / "recordings").mkdir(parents=True)
    (tmp_path / "out").rename(again / "recordings/chair")
    text = (root / "benchmark.yaml").read_text()
    for place in (root, again):
        ignored = text.replace("category: chair}", "category: chair, trajectory: ignore}")
        (place / "benchmark.yaml").write_text(ignored)
        process = start(place, "build", "--jobs", "1")
        said = process.communicate()[1]
        assert process.returncode == 0, said
    made = sorted(path.relative_to(root) for path in (root / "build/chair").rglob("*") if path.is_file())
    stored = (".kbd", ".npz", ".ply", ".txt", ".jpg", ".png")
    compared = [path for path in made if path.suffix in stored and path.name != "given_trajectory.txt"]
    assert sum(path.parts[2] == "pairs" for path in compared) == 2
    differ = [path for path in compared if (root / path).read_bytes() != (again / path).read_bytes()]
    assert differ == []
