"""The build that begins while one records: it goes on from what was done, and makes the same bytes."""

import json
import multiprocessing
import os
import pickle
import shutil
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from growing_folder import FRAMES, all_taken, recorded_once
from typed import noted

from kinectbench.core import threads
from kinectbench.core.errors import RecordingError
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.engine.executor import SendMessage, WorkerLost
from kinectbench.record import build_process
from kinectbench.record.build_process import MAY_CHANGE, STORED, BuildProcess, GrowingBuild
from kinectbench.settings.models import TrackingSettings
from kinectbench.stages.ingest import sequence_writer
from kinectbench.stages.ingest.partial_sequence import (
    go_on_from,
    partial_sequence,
)
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence
from kinectbench.stages.ingest.sequence_writer import SequenceWriter
from kinectbench.stages.track import partial_odometry, track, tracker
from kinectbench.stages.track.odometry import Follower
from kinectbench.stages.track.partial_odometry import (
    PartialOdometry,
    partial_odometry_of,
    using_partial_odometry,
)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`out`, 16 frames of a chair, and `sequence`, what `ingest` makes of it."""
    return recorded_once(tmp_path_factory)


def taken_of(folder: Path, stored: Path, *, whole: bool) -> PartialOdometry:
    """The odometry of all that can be taken of a folder."""
    made = all_taken(folder, stored, whole=whole).odometry()
    assert made is not None
    return made


def tracked(sequence: Sequence) -> Trajectory:
    return track(sequence, "ignore", TrackingSettings())


@pytest.mark.parametrize("whole", [False, True])
def test_tracking_goes_on_with_the_same_result(
    recorded: Path, whole: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Poses, figures and warnings are equal to the last bit, and no frame is followed twice."""
    sequence = read_sequence(recorded / "sequence")
    alone = tracked(sequence)
    partial: PartialOdometry = pickle.loads(pickle.dumps(taken_of(recorded / "out", tmp_path, whole=whole)))
    count = FRAMES - (0 if whole else MAY_CHANGE)
    assert len(partial.digests) == len(partial.follower.frames) == count
    fresh: list[object] = []
    monkeypatch.setattr(tracker, "Follower", noted(Follower, fresh))
    with using_partial_odometry(lambda: partial):
        after = tracked(sequence)
    assert not fresh and len(partial.follower.frames) == FRAMES
    assert np.array_equal(after.T_world_camera, alone.T_world_camera, equal_nan=True)
    assert after.health == alone.health
    found, wanted = (each.depth_calibration.coefficients_per_m for each in (after, alone))
    assert np.array_equal(found, wanted)


def test_what_was_taken_of_other_frames_is_not_used(recorded: Path, tmp_path: Path) -> None:
    """One pixel, one stamp or the depth's scale differs; nor is it given out twice."""
    sequence = read_sequence(recorded / "sequence")
    with using_partial_odometry(lambda: taken_of(recorded / "out", tmp_path, whole=True)):
        assert partial_odometry_of(sequence) is not None and partial_odometry_of(sequence) is None
    source = open_recording(recorded / "out")
    for change in ("pixel", "scale"):
        write_sequence(source, tmp_path / change)
        partial = taken_of(recorded / "out", tmp_path / "stored", whole=True)
        if change == "pixel":
            frame = next((tmp_path / change / "depth").iterdir())
            frame.write_bytes(frame.read_bytes()[:-1] + b"?")
        else:
            maps = partial.follower.maps
            maps.sequence = Sequence(source.camera, 1.0, source.stamps_ns, True, None, maps.sequence.frames)
        with using_partial_odometry(lambda partial=partial: partial):  # type: ignore[misc]
            assert partial_odometry_of(read_sequence(tmp_path / change)) is None


class Heard(list[object]):
    """The messages of tasks."""

    def heard(self, message: object) -> None:
        self.append(message)

    def warn(self, message: str, task: object = None) -> None:
        raise AssertionError(message)


class Warned(Heard):
    """The messages of tasks, and warnings."""

    def warn(self, message: str, task: object = None) -> None:
        self.append(message)


def taken_in(task: object, say: SendMessage) -> tuple[int, int, object, int]:
    """What a build finds: numbers of frames stored and followed, its threads' default, and its process."""
    sequence, ask = partial_sequence(), partial_odometry._ask.get()
    odometry = ask() if ask else None
    say(task)
    stored = sequence.writer.taken if sequence else 0
    return stored, len(odometry.digests) if odometry else 0, threads._threads.get(), os.getpid()


def built_by(process: BuildProcess, listener: Heard) -> tuple[int, int, object, int]:
    """The result of `taken_in` in the process."""
    [(task, result)] = process.outcomes(taken_in, ["task"], listener)
    assert task == "task" and not isinstance(result, WorkerLost)
    return result


def test_a_process_takes_the_frames_as_they_come(recorded: Path, tmp_path: Path) -> None:
    """It waits for the folder, and the build in it goes on from what it has taken."""
    process = BuildProcess(tmp_path / "out", threads=2)
    shutil.copytree(recorded / "out", tmp_path / "out")
    process.ended()
    listener = Heard()
    stored, followed, count, pid = built_by(process, listener)
    process.close()
    assert listener == ["task"] and (count, pid) == (2, process.pid)
    assert 1 <= stored <= followed <= FRAMES
    assert not [*(tmp_path / "out").glob(f"{STORED}*")]


def stored_frames_used(path: Path, say: SendMessage) -> int:
    """The number of frames that `ingest` of the recording at this path need not store again."""
    partial = partial_sequence()
    assert partial is not None
    writer = SequenceWriter(open_recording(path), path.with_name("sequence"))
    go_on_from(partial, writer)
    return writer.taken


def test_stored_frames_are_used_if_the_folder_was_named_from_here(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A build's tasks have absolute paths; a recorder's user writes `record out`."""
    shutil.copytree(recorded / "out", tmp_path / "out")
    monkeypatch.chdir(tmp_path)
    process = BuildProcess(Path("out"))
    process.ended()
    [(_, used)] = process.outcomes(stored_frames_used, [tmp_path / "out"], Heard())
    process.close()
    assert not isinstance(used, WorkerLost) and used > 0  # further frames are stored meanwhile


def test_a_closed_terminal_leaves_nothing(recorded: Path, tmp_path: Path) -> None:
    """Signals to a group of processes do not stop it; its recorder ends it, and what it stored is removed."""
    shutil.copytree(recorded / "out", tmp_path / "out")
    process = BuildProcess(tmp_path / "out")
    stored = tmp_path / "out" / f"{STORED}{process.pid}"
    assert comes(stored.is_dir)
    for each in (signal.SIGHUP, signal.SIGTERM):
        os.kill(process.pid or 0, each)
    assert built_by(process, Heard())[3] == process.pid and stored.is_dir()
    process.close()
    assert not [*(tmp_path / "out").glob(f"{STORED}*")]


def comes(true: Callable[[], bool], within_s: float = 60) -> bool:
    """Whether something comes true in time."""
    ends = time.monotonic() + within_s
    while not true() and time.monotonic() < ends:
        time.sleep(0.05)
    return true()


def goes_on(marks: Path, say: SendMessage) -> None:
    """A build that makes progress until it is stopped, and then says so in a file."""
    try:
        while True:
            say("progress")
            time.sleep(0.01)
    except Exception:  # a build would take it as its own failure
        (marks / "failed").touch()
    except KeyboardInterrupt:
        (marks / "interrupted").touch()
        raise


class Stops(Heard):
    """The first message raises an error."""

    def __init__(self, error: BaseException) -> None:
        self.error = error

    def heard(self, message: object) -> None:
        self.append(message)
        if len(self) == 1:
            raise self.error


def test_a_stopped_recorder_interrupts_the_build(tmp_path: Path) -> None:
    """It ends with its next progress, as after Ctrl-C, and not as by a failure."""
    with pytest.raises(KeyboardInterrupt):
        next(BuildProcess(tmp_path / "out").outcomes(goes_on, [tmp_path], Stops(KeyboardInterrupt())))
    # It has ended before the caller clears away what an interrupted build leaves.
    assert (tmp_path / "interrupted").exists() and not (tmp_path / "failed").exists()


def test_a_second_interrupt_leaves_no_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C while the recorder waits for the build to end: the build is killed at once."""
    process = BuildProcess(tmp_path / "out")
    join, stops = process._process.join, [KeyboardInterrupt]

    def joined(timeout_s: float | None = None) -> None:
        if stops:
            raise stops.pop()
        join(timeout_s)

    monkeypatch.setattr(process._process, "join", joined)
    with pytest.raises(KeyboardInterrupt):
        process.close()
    assert process._process.exitcode == -signal.SIGKILL


def records(out: Path) -> None:
    [*BuildProcess(out).outcomes(waits, [60.0], Heard())]


def waits(seconds: float, say: SendMessage) -> None:
    time.sleep(seconds)


def test_a_killed_recorder_leaves_no_process(recorded: Path, tmp_path: Path) -> None:
    """The build ends with it, whatever it computes."""
    shutil.copytree(recorded / "out", tmp_path / "out")
    recorder = multiprocessing.get_context("spawn").Process(target=records, args=(tmp_path / "out",))
    recorder.start()
    assert comes(lambda: bool([*(tmp_path / "out").glob(f"{STORED}*")]))
    recorder.kill()
    assert comes(lambda: not [*(tmp_path / "out").glob(f"{STORED}*")], within_s=20)


def test_a_message_that_cannot_be_shown_does_not_build_twice(tmp_path: Path) -> None:
    """An OSError of the listener is no sign that the process has died."""
    outcomes = BuildProcess(tmp_path / "out").outcomes(taken_in, ["task"], Stops(BrokenPipeError()))
    with pytest.raises(BrokenPipeError):
        next(outcomes)


@pytest.mark.parametrize("fails", ["_write_packed", "_prepare"])
def test_what_fails_while_recording_is_done_again(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    """A frame that a full disk did not take, or a library that was not loaded: the build takes all frames."""
    module = sequence_writer if fails == "_write_packed" else build_process
    done = threading.Event()

    def fail(*_: object) -> None:
        done.set()
        raise OSError("No space left on device")

    monkeypatch.setattr(module, fails, fail)
    taking = build_process._Taking(GrowingBuild(recorded / "out", tmp_path))
    taking.ended.set()
    assert done.wait(60) and taking.sequence() is None and taking.odometry() is None


def test_another_camera_in_between_is_refused(recorded: Path, tmp_path: Path) -> None:
    """What was stored by one camera.json does not go on with another."""
    out = tmp_path / "out"
    shutil.copytree(recorded / "out", out)
    growing = GrowingBuild(out, tmp_path / "stored")
    growing.read_again()
    assert growing.take(whole=True)
    said = json.loads((out / "camera.json").read_text())
    (out / "camera.json").write_text(json.dumps({**said, "depth_scale": said["depth_scale"] / 2}))
    with pytest.raises(RecordingError):
        growing.read_again()


def test_a_process_that_dies_costs_time_only(tmp_path: Path) -> None:
    process = BuildProcess(tmp_path / "out")
    assert process.pid is not None
    os.kill(process.pid, signal.SIGKILL)
    process.ended()
    listener = Warned()
    stored, followed, _, pid = built_by(process, listener)
    assert (stored, followed, pid) == (0, 0, os.getpid())
    assert len(listener) == 2  # a warning, then the task's own message
    process.close()
