"""The odometry of a build, in a process of its own while a recording is written.

It reads the folder that grows, so that it never holds the recorder up. It takes every frame, by the build's
own code, and the build goes on where it is.
"""

import multiprocessing
import os
import signal
import warnings
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.errors import KinectBenchError
from kinectbench.core.sequence import Sequence
from kinectbench.stages.ingest.depth_code import encode_depth
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import RawFrame, Recording
from kinectbench.stages.ingest.sequence_folder import frame_digest, onto_depth
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


class OdometryProcess:
    """Takes the frames of a folder as they are written."""

    def __init__(self, folder: Path) -> None:
        """Start the process (spawned: threads do not survive a fork); the folder may come later."""
        context = multiprocessing.get_context("spawn")
        self._mine, theirs = context.Pipe()
        self._process = context.Process(target=_run, args=(theirs, folder), name="odometry", daemon=True)
        self._process.start()
        theirs.close()

    @property
    def pid(self) -> int | None:
        """Of the process."""
        return self._process.pid

    def ended(self) -> None:
        """The folder is whole: its last frames are taken too."""
        self._ask("whole")

    def so_far(self) -> PartialOdometry | None:
        """What was done so far; None if nothing was, or the process failed. The process ends."""
        self._ask("give")
        with suppress(EOFError, OSError):
            answer = self._mine.recv()
            return answer if isinstance(answer, PartialOdometry) else None
        return None

    def close(self) -> None:
        """End the process."""
        self._mine.close()
        self._process.terminate()
        self._process.join()

    def _ask(self, what: str) -> None:
        with suppress(OSError):
            self._mine.send(what)


class GrowingFrames:
    """The frames of a recording that is still written, as `ingest` stores them; the newest is kept."""

    def __init__(self, recording: Recording) -> None:
        self.recording, self._register = recording, onto_depth(recording)
        self._kept: tuple[int, RawFrame] | None = None

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        """Its depth."""
        return self._frame(index).depth

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        """Its colour, on the pixels of depth."""
        return self._frame(index).color

    def digest(self, index: int) -> bytes:
        """As `FolderFrames.digest` of the sequence."""
        return frame_digest(encode_depth(self.depth_native(index)), self.color_encoded(index))

    def _frame(self, index: int) -> RawFrame:
        if self._kept is None or self._kept[0] != index:
            frame = self.recording.frame(index)
            self._kept = index, self._register(frame) if self._register else frame
        return self._kept[1]


class GrowingOdometry:
    """Takes the frames of a folder that grows."""

    def __init__(self, folder: Path) -> None:
        """Nothing was taken; the folder may come later."""
        self.folder = folder
        self._follower: Follower | None = None
        self._frames: GrowingFrames | None = None
        self._digests: list[bytes] = []

    def read_again(self) -> None:
        """Look for new frames."""
        try:
            recording = open_recording(self.folder)
        except KinectBenchError:
            return  # nothing is there yet
        self._frames = GrowingFrames(recording)
        registered = recording.color_registered or recording.color_calibration is not None
        facts = recording.camera, recording.depth_scale, recording.stamps_ns, registered
        sequence = Sequence(*facts, None, self._frames)
        if self._follower is None:
            maps = MapCache(sequence)
            self._follower = Follower(maps, FeatureCache(maps))
        self._follower.maps.sequence = sequence

    def take(self, *, whole: bool) -> bool:
        """Take the next frame; False if there is none.

        Args:
            whole: no frame will come; else the last ones are left, as their colour may still come.
        """
        follower, frames = self._follower, self._frames
        if follower is None or frames is None:
            return False
        index = len(follower.frames)
        if index >= len(frames.recording) - (0 if whole else MAY_CHANGE):
            return False
        self._digests.append(frames.digest(index))
        follower.take(index)
        return True

    def so_far(self) -> PartialOdometry | None:
        """What was done so far."""
        return PartialOdometry(self._follower, tuple(self._digests)) if self._follower else None


def _run(connection: Connection, folder: Path) -> None:
    """In the process: take frames until they are asked for, or the other end closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the recorder
    warnings.simplefilter("ignore")  # the terminal has one line: that of the recorder
    with suppress(OSError):
        os.nice(NICER)
    growing, whole, busy = GrowingOdometry(folder), False, False
    with suppress(EOFError, OSError):
        while True:
            asked = connection.recv() if connection.poll(0 if busy else READ_AGAIN_S) else ""
            if asked == "give":
                connection.send(growing.so_far())
                return
            try:
                whole |= asked == "whole"
                if not busy or asked == "whole":  # the last rows of the lists are known only now
                    growing.read_again()
                busy = growing.take(whole=whole)
            except Exception:  # the terminal is the recorder's: the build says what is wrong
                return
