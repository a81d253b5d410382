"""Start a build in a separate process while the recording is still being written.

The process reads the growing folder, so it never delays the recorder. It stores each frame and registers it
to earlier frames with the build's own code, and the build later continues from these results.
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

# Niceness: the recorder and the guide get the processor first.
NICER = 10
# Interval at which the folder's lists are read: 70 ms for 600 frames.
READ_AGAIN_S = 1.0
# Number of rows at the end of the lists whose colour may still arrive.
MAY_CHANGE = 2
# A hidden folder inside the recording's folder, so that both are on one disk; it is no part of the recording.
# The process id follows, so that another recorder, which is refused, removes only its own folder.
STORED = ".stored-"
# Signals that a closed terminal, or the end of a process group, sends. They are ignored: the recorder ends
# this process.
IGNORED = (signal.SIGINT, signal.SIGHUP, signal.SIGTERM) if os.name == "posix" else (signal.SIGINT,)
# The process ends within a frame; after this time it is killed.
ENDS_WITHIN_S = 5.0


class BuildProcess:
    """Stores and registers the frames of a growing folder in a separate process."""

    def __init__(self, folder: Path) -> None:
        """Start the process (spawned: threads do not survive a fork); the folder may appear later."""
        context = multiprocessing.get_context("spawn")
        self._mine, theirs = context.Pipe()
        self._process = context.Process(target=_run, args=(theirs, folder), name="build", daemon=True)
        self._process.start()
        self._stored = folder / f"{STORED}{self._process.pid}"
        theirs.close()

    @property
    def pid(self) -> int | None:
        """Id of the process."""
        return self._process.pid

    def ended(self) -> None:
        """Tell the process that the folder is complete, so that it takes the last frames, too."""
        self._ask("whole")

    def sequence(self) -> PartialSequence | None:
        """Return the frames stored so far, while the process goes on; None without any, or if it failed."""
        answer = self._answer("sequence")
        return answer if isinstance(answer, PartialSequence) else None

    def odometry(self) -> PartialOdometry | None:
        """Return the odometry so far, and let the process end; None without any, or if it failed."""
        answer = self._answer("odometry")
        return answer if isinstance(answer, PartialOdometry) else None

    def close(self) -> None:
        """End the process, and delete what it stored."""
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
    """Takes the frames of a growing folder: each is stored as in `ingest`, and registered as in `track`.

    Attributes:
        folder: the growing folder.
        stored: the folder into which the frames are stored as a sequence.
    """

    def __init__(self, folder: Path, stored: Path) -> None:
        """Start without frames; the folder may appear later."""
        self.folder, self.stored = folder, stored
        self._writer: SequenceWriter | None = None
        self._follower: Follower | None = None
        self._marks: list[FrameMark | None] = []
        self._digests: list[bytes] = []

    def read_again(self) -> None:
        """Read the folder's lists of images again, because they may have grown.

        Raises:
            RecordingError: the camera is another one now.
        """
        try:
            recording = open_recording(self.folder)
        except KinectBenchError:
            return  # the folder does not exist yet
        if self._writer is None:
            self._writer = SequenceWriter(recording, self.stored)
        if stored_by(recording) != stored_by(self._writer.checks.recording):
            raise RecordingError(f"{self.folder}: its camera is another one now; the build stores all again")
        self._writer.checks.recording = recording

    def take(self, *, whole: bool) -> bool:
        """Take the next frame; return False if there is none.

        Args:
            whole: whether the folder is complete; else the last frames are left, as their colour may still
                arrive.
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
        """Register the newest stored frame, the last of `frames`, to earlier ones."""
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
        """Return the frames stored so far; None before the folder exists."""
        return PartialSequence(self._writer, tuple(self._marks)) if self._writer else None

    def odometry(self) -> PartialOdometry | None:
        """Return the odometry of the stored frames; None without any."""
        return PartialOdometry(self._follower, tuple(self._digests)) if self._follower else None


def _run(connection: Connection, folder: Path) -> None:
    """The process: take frames until the other end asks for the odometry, or closes."""
    for each in IGNORED:
        signal.signal(each, signal.SIG_IGN)
    warnings.simplefilter("ignore")  # the recorder owns the terminal
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
            if not busy or asked == "whole":  # only now are the last rows final
                growing.read_again()
            busy = growing.take(whole=whole)
    except Exception:  # the other end closed, or the build reports the error later
        return
    finally:
        shutil.rmtree(stored, ignore_errors=True)
