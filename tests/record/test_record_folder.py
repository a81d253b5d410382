"""What a recording holds while it is written, and after whatever ends it."""

import errno
import os
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn_camera import DrawnCamera, drawn
from written_frames import DEPTH, START_NS, STEP_NS, color_rgb, read

from kinectbench.core.errors import CaptureError, RecordingError, SettingsError, StorageError
from kinectbench.record import folder as writing
from kinectbench.record.folder import FolderWriter
from kinectbench.record.interface import Frame, Setup
from kinectbench.record.recorder import record
from kinectbench.stages.ingest.images import encode_png
from kinectbench.stages.ingest.readers import open_recording

SETUP = Setup(DEPTH, 1000.0, True)


def check_frames(folder: Path, count: int) -> None:
    """The first frames are there, equal in depth, colour and stamps."""
    frames = read(open_recording(folder))
    assert len(frames) == count
    for index, raw in enumerate(frames):
        made = drawn(index)
        assert raw.stamp_ns == made.stamp_ns and np.array_equal(raw.depth, made.depth)
        assert isinstance(made.color, np.ndarray) and np.array_equal(color_rgb(raw), made.color)


def test_what_a_device_gives_is_read_back(tmp_path: Path) -> None:
    camera = DrawnCamera(8)
    done = record(camera, tmp_path / "out")
    assert (done.frames, done.dropped, done.missed, done.set_back, done.failure) == (8, 0, 0, 0, "")
    assert camera.closed
    check_frames(tmp_path / "out", 8)
    recording = open_recording(tmp_path / "out")
    assert recording.camera == DEPTH and recording.depth_scale == 1000 and not recording.warnings
    rows = (tmp_path / "out/accelerometer.txt").read_text().splitlines()
    assert len(rows) == 17 and rows[1].split()[1:] == ["0.125", "-9.75", "0.0"]


def test_up_is_read_back_where_the_camera_is_still(tmp_path: Path) -> None:
    """The camera's accelerometer says -y nearly; a folder of the benchmark itself does not say its axes."""
    record(DrawnCamera(8), tmp_path / "out")
    up = open_recording(tmp_path / "out").up_cameras
    assert len(up) == 8 and [sample.stamp_ns for sample in up] == [drawn(k).stamp_ns for k in range(8)]
    assert np.allclose([sample.up_camera[:2] for sample in up], [0.0128, -0.9986], atol=2e-3)
    said = (tmp_path / "out/camera.json").read_text()
    (tmp_path / "out/camera.json").write_text(said.replace('"accelerometer_axes": "depth"', '"a": 1'))
    assert open_recording(tmp_path / "out").up_cameras == ()
    (tmp_path / "out/camera.json").write_text(said)
    rows = (tmp_path / "out/accelerometer.txt").read_text()
    for number in ("1e308", "nan", "inf"):
        (tmp_path / "out/accelerometer.txt").write_text(rows.replace("-9.75", number))
        assert open_recording(tmp_path / "out").up_cameras == ()
    (tmp_path / "out/accelerometer.txt").write_text(rows + "1.0 2.0\n")
    with pytest.raises(RecordingError, match="line 18: is not 'stamp ax ay az'"):
        open_recording(tmp_path / "out")


def test_each_row_is_of_a_whole_image_at_any_moment(tmp_path: Path) -> None:
    """The folder is read while it is written."""
    out = tmp_path / "out"
    recorder = threading.Thread(target=record, args=(DrawnCamera(20, step_s=0.01), out))
    recorder.start()
    looks = 0
    while recorder.is_alive():
        if (out / "depth.txt").is_file() and len((out / "depth.txt").read_text().splitlines()) > 1:
            frames = read(open_recording(out))
            assert all(np.array_equal(f.depth, drawn(i).depth) for i, f in enumerate(frames))
            looks += 1
    recorder.join()
    assert looks > 2
    check_frames(out, 20)


def test_stamps_increase_where_the_clock_is_set_back(tmp_path: Path) -> None:
    """By an hour before frame 3: the steps before and after stay, and no stamp goes back."""
    hour_ns = 3600 * 10**9
    camera = DrawnCamera(
        6, lambda index: START_NS + index * STEP_NS - (hour_ns if index >= 3 else 0), step_s=0.02
    )
    done = record(camera, tmp_path / "out")
    recording = open_recording(tmp_path / "out")
    steps_ns = np.diff(recording.stamps_ns)
    assert done.set_back == 1 and len(recording) == 6
    assert steps_ns[[0, 1, 3, 4]].tolist() == [STEP_NS] * 4
    assert 15e6 < steps_ns[2] < 1e9  # what passed meanwhile
    color_ns = recording.recorded_stamps_ns[1]
    assert (color_ns - recording.stamps_ns == color_ns[0] - recording.stamps_ns[0]).all()


def test_a_pulled_cable_leaves_what_was_recorded(tmp_path: Path) -> None:
    done = record(DrawnCamera(8, breaks_at=5), tmp_path / "out")
    words = f"the 5 frames before are whole: {tmp_path / 'out'} can be built"
    assert done.failure == f"drawn: the device is gone; {words}"
    check_frames(tmp_path / "out", 5)


def test_a_device_that_gives_nothing_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match=r"^drawn: the device is gone$"):
        record(DrawnCamera(8, breaks_at=0), tmp_path / "out")
    with pytest.raises(CaptureError, match="gave no frame"):
        record(DrawnCamera(0), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("full", ["depth/000004.png", "rgb/000004.png", "depth.txt"])
def test_a_full_disk_leaves_what_was_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, full: str
) -> None:
    """An image is cut off, or a row: the frames before are whole, in one line."""

    def no_room() -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    plain_bytes, plain_write = Path.write_bytes, os.write

    def write_bytes(path: Path, data: bytes) -> int:
        if path.as_posix().endswith(full):
            plain_bytes(path, data[:100])
            no_room()
        return plain_bytes(path, data)

    def write(handle: int, data: bytes) -> int:
        if full == "depth.txt" and b"depth/000004" in data:
            return plain_write(handle, data[:7])
        if full == "depth.txt" and b"depth/000004"[-5:] in data:
            no_room()
        return plain_write(handle, data)

    monkeypatch.setattr(Path, "write_bytes", write_bytes)
    monkeypatch.setattr(os, "write", write)
    done = record(DrawnCamera(500), tmp_path / "out")
    assert done.failure.startswith(f"{tmp_path / 'out'}: cannot be written any more (No space left")
    assert done.frames == 4
    check_frames(tmp_path / "out", 4)


def test_an_image_that_cannot_be_encoded_ends_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the codec raises: no frame is lost without a word."""
    plain = encode_png

    def broken(image: Any, *, fast: bool = False) -> bytes:
        if image.shape == drawn(0).depth.shape and np.array_equal(image, drawn(3).depth):
            raise RuntimeError("odd image")
        return plain(image, fast=fast)

    monkeypatch.setattr(writing, "encode_png", broken)
    done = record(DrawnCamera(50), tmp_path / "out")
    assert done.frames == 3 and "cannot be written any more (odd image); the 3 frames" in done.failure
    check_frames(tmp_path / "out", 3)


def test_two_recordings_are_never_mixed(tmp_path: Path) -> None:
    record(DrawnCamera(3), tmp_path / "out")
    with pytest.raises(SettingsError, match="is there already; name a new folder"):
        record(DrawnCamera(3), tmp_path / "out")
    (tmp_path / "file").write_text("")
    (tmp_path / "nowhere").symlink_to(tmp_path / "gone")
    for place in ("file", "nowhere"):
        with pytest.raises(SettingsError, match="is there already"):
            record(DrawnCamera(3), tmp_path / place)
    with pytest.raises(StorageError):
        record(DrawnCamera(3), tmp_path / "file" / "out")
    check_frames(tmp_path / "out", 3)


def test_of_two_recorders_at_once_one_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both find the folder empty; making depth/ decides."""
    monkeypatch.setattr(writing, "check_new", lambda folder: None)
    first = FolderWriter(tmp_path / "out", SETUP, "drawn")
    with pytest.raises(SettingsError, match="another recorder has begun there"):
        FolderWriter(tmp_path / "out", SETUP, "drawn")
    for index in range(2):
        first.add(drawn(index))
    first.close()
    check_frames(tmp_path / "out", 2)


def test_a_slow_disk_costs_frames_and_never_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With room for three frames that wait, `add` returns at once and says that a frame is dropped."""
    monkeypatch.setattr(writing, "BACKLOG_BYTES", 3 * drawn(0).nbytes)
    plain, may_write = encode_png, threading.Event()

    def slow(image: Any, *, fast: bool = False) -> bytes:
        may_write.wait(60)
        return plain(image, fast=fast)

    monkeypatch.setattr(writing, "encode_png", slow)
    writer = FolderWriter(tmp_path / "out", SETUP, "drawn")
    numbers = [writer.add(drawn(index)) for index in range(8)]
    may_write.set()
    writer.close()
    assert numbers == [0, 1, 2, *[None] * 5] and writer.dropped == 5
    check_frames(tmp_path / "out", 3)


class Looker:
    """Sees a frame in a time of its own; breaks at the third, if it is to."""

    def __init__(self, takes_s: float, breaks: bool = False) -> None:
        self.takes_s, self.breaks, self.seen = takes_s, breaks, list[int]()

    def see(self, number: int, frame: Frame, setup: Setup) -> None:
        assert np.array_equal(frame.depth, drawn(number).depth) and setup == SETUP
        time.sleep(self.takes_s)
        self.seen.append(number)
        if self.breaks and len(self.seen) == 3:
            raise ValueError("cannot look\nat it")


def test_observers_are_late_skip_or_fail_and_every_frame_is_written(tmp_path: Path) -> None:
    quick, slow, failing = Looker(0), Looker(0.15), Looker(0, breaks=True)
    done = record(DrawnCamera(20, step_s=0.02), tmp_path / "out", observers=(quick, slow, failing))
    assert done.frames == 20 and done.observers == ("cannot look",) and not done.failure
    assert quick.seen == sorted(quick.seen) and len(quick.seen) > 15
    assert 2 <= len(slow.seen) < 12 and slow.seen[-1] == 19  # the last frame is seen
    assert len(failing.seen) == 3
    check_frames(tmp_path / "out", 20)
