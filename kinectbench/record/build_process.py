"""The beginning of a build, in a process of its own while a recording is written.

It reads the folder that grows, so that it never holds the recorder up. It stores every frame and registers it
to those before, by the build's own code, and the build goes on where it is.
"""

import multiprocessing
import os
import shutil
import signal
import warnings
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from kinectbench.core.errors import KinectBenchError, RecordingError
from kinectbench.core.sequence import Sequence
from kinectbench.stages.ingest.partial_sequence import FrameMark, PartialSequence, frame_mark, stored_by
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import Recording
from kinectbench.stages.ingest.sequence_folder import FolderFrames
from kinectbench.stages.ingest.sequence_writer import SequenceWriter
from kinectbench.stages.track.features import FeatureCache
from kinectbench.stages.track.frame_maps import MapCache
from kinectbench.stages.track.odometry import Follower
from kinectbench.stages.track.partial_odometry import PartialOdometry

# The process gives way to the recorder and to the guide.
NICER = 10
# The lists of the folder are read again so often: 70 ms for 600 frames.
READ_AGAIN_S = 1.0
# Rows at the end of the lists whose colour may still come.
MAY_CHANGE = 2
# A folder in that of the recording, so that one disk holds both; hidden, it is no part of the recording. The
# number of the process follows: another recorder, which is refused, removes its own alone.
STORED = ".stored-"
# What a closed terminal, or whoever ends a group of processes, sends: the other end decides, and is ended.
IGNORED = (signal.SIGINT, signal.SIGHUP, signal.SIGTERM) if os.name == "posix" else (signal.SIGINT,)
# The process ends by itself within a frame; then it is killed.
ENDS_WITHIN_S = 5.0


class BuildProcess:
    """Takes the frames of a folder as they are written."""

    def __init__(self, folder: Path) -> None:
        """Start the process (spawned: threads do not survive a fork); the folder may come later."""
        context = multiprocessing.get_context("spawn")
        self._mine, theirs = context.Pipe()
        self._process = context.Process(target=_run, args=(theirs, folder), name="build", daemon=True)
        self._process.start()
        self._stored = folder / f"{STORED}{self._process.pid}"
        theirs.close()

    @property
    def pid(self) -> int | None:
        """Of the process."""
        return self._process.pid

    def ended(self) -> None:
        """The folder is whole: its last frames are taken too."""
        self._ask("whole")

    def sequence(self) -> PartialSequence | None:
        """What was stored so far; None if nothing was, or the process failed. The process goes on."""
        answer = self._answer("sequence")
        return answer if isinstance(answer, PartialSequence) else None

    def odometry(self) -> PartialOdometry | None:
        """What was registered so far; None if nothing was, or the process failed. The process ends."""
        answer = self._answer("odometry")
        return answer if isinstance(answer, PartialOdometry) else None

    def close(self) -> None:
        """End the process, and remove what it stored."""
        self._mine.close()
        self._process.join(ENDS_WITHIN_S)
        self._process.kill()
        self._process.join()
        shutil.rmtree(self._stored, ignore_errors=True)

    def _ask(self, what: str) -> None:
        with suppress(OSError):
            self._mine.send(what)

    def _answer(self, what: str) -> object:
        self._ask(what)
        with suppress(EOFError, OSError):
            return self._mine.recv()
        return None


class GrowingBuild:
    """Takes the frames of a folder that grows: each is stored as by `ingest`, and registered as by `track`.

    Attributes:
        folder: that grows.
        stored: a folder for the sequence.
    """

    def __init__(self, folder: Path, stored: Path) -> None:
        """Nothing was taken; the folder may come later."""
        self.folder, self.stored = folder, stored
        self._writer: SequenceWriter | None = None
        self._follower: Follower | None = None
        self._marks: list[FrameMark | None] = []
        self._digests: list[bytes] = []

    def read_again(self) -> None:
        """Look for new frames."""
        try:
            recording = open_recording(self.folder)
        except KinectBenchError:
            return  # nothing is there yet
        if self._writer is None:
            self._writer = SequenceWriter(recording, self.stored)
        if stored_by(recording) != stored_by(self._writer.checks.recording):
            raise RecordingError(f"{self.folder}: its camera is another one now; the build stores all again")
        self._writer.checks.recording = recording

    def take(self, *, whole: bool) -> bool:
        """Take the next frame; False if there is none.

        Args:
            whole: no frame will come; else the last ones are left, as their colour may still come.
        """
        writer = self._writer
        if writer is None:
            return False
        recording = writer.checks.recording
        if writer.taken >= len(recording) - (0 if whole else MAY_CHANGE):
            return False
        self._marks.append(frame_mark(recording.places[writer.taken]))
        writer.take(writer.taken + 1)
        if len(writer.rows) > len(self._digests):  # not damaged
            self._follow(recording, FolderFrames(writer.folder, tuple(writer.rows)))
        return True

    def _follow(self, recording: Recording, frames: FolderFrames) -> None:
        """Register the newest of the stored frames."""
        registered = recording.color_registered or recording.color_calibration is not None
        stamps_ns = np.array([row.stamp_ns for row in frames.rows], np.int64)
        sequence = Sequence(recording.camera, recording.depth_scale, stamps_ns, registered, None, frames)
        if self._follower is None:
            maps = MapCache(sequence)
            self._follower = Follower(maps, FeatureCache(maps))
        self._follower.maps.sequence = sequence
        self._digests.append(frames.digest(len(self._digests)))
        self._follower.take(len(self._follower.frames))

    def sequence(self) -> PartialSequence | None:
        """What was stored so far."""
        return PartialSequence(self._writer, tuple(self._marks)) if self._writer else None

    def odometry(self) -> PartialOdometry | None:
        """What was registered so far."""
        return PartialOdometry(self._follower, tuple(self._digests)) if self._follower else None


def _run(connection: Connection, folder: Path) -> None:
    """In the process: take frames until they are asked for, or the other end closes."""
    for each in IGNORED:
        signal.signal(each, signal.SIG_IGN)
    warnings.simplefilter("ignore")  # the terminal has one line: that of the recorder
    with suppress(OSError):
        os.nice(NICER)
    stored = folder / f"{STORED}{os.getpid()}"
    growing, whole, busy = GrowingBuild(folder, stored), False, False
    try:
        while True:
            asked = connection.recv() if connection.poll(0 if busy else READ_AGAIN_S) else ""
            if asked == "odometry":
                connection.send(growing.odometry())
                return
            if asked == "sequence":
                connection.send(growing.sequence())
            whole |= asked == "whole"
            if not busy or asked == "whole":  # the last rows of the lists are known only now
                growing.read_again()
            busy = growing.take(whole=whole)
    except Exception:  # the other end is gone, or the build says what is wrong: the terminal is not ours
        return
    finally:
        shutil.rmtree(stored, ignore_errors=True)
