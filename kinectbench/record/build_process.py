"""Build in a separate process, which begins while the recording is still being written.

The process reads the growing folder, so it never delays the recorder. It stores each frame and registers it
to earlier frames with the build's own code. The build continues from these results, in the same process: all
libraries are loaded there by then.
"""

import copy
import multiprocessing
import os
import shutil
import signal
import threading
import warnings
from collections import abc
from concurrent.futures import BrokenExecutor, ThreadPoolExecutor
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from kinectbench.core import KinectBenchError, RecordingError
from kinectbench.core.geometry import raycaster
from kinectbench.core.pictures import new_figure
from kinectbench.core.sequence import Sequence
from kinectbench.core.threads import using_threads
from kinectbench.engine.executor import Executor, Listener, Outcomes, Result, SendMessage, Task
from kinectbench.stages.ingest.partial_sequence import (
    FrameMark,
    PartialSequence,
    frame_mark,
    stored_by,
    using_partial_sequence,
)
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import Recording
from kinectbench.stages.ingest.sequence_folder import FolderFrames
from kinectbench.stages.ingest.sequence_writer import SequenceWriter
from kinectbench.stages.track.features import FeatureCache
from kinectbench.stages.track.frame_maps import MapCache
from kinectbench.stages.track.odometry import Follower
from kinectbench.stages.track.partial_odometry import PartialOdometry, using_partial_odometry

# Niceness while recording: the recorder and the guide get the processor first.
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
# The process ends with its next progress; after this time it is killed.
ENDS_WITHIN_S = 5.0


class BuildProcess(Executor):
    """Stores and registers the frames of a growing folder in a separate process, and builds there."""

    def __init__(self, folder: Path, threads: int = 1) -> None:
        """Start the process (spawned: threads do not survive a fork); the folder may appear later.

        Args:
            folder: the growing folder.
            threads: number of threads for the build.
        """
        folder = folder.absolute()  # as in a build's tasks: of another path, no stored frame is used
        context = multiprocessing.get_context("spawn")
        self._mine, theirs = context.Pipe()
        self._threads = threads
        self._process = context.Process(
            target=_run, args=(theirs, folder, threads), name="build", daemon=True
        )
        self._process.start()
        self._stored = folder / f"{STORED}{self._process.pid}"
        theirs.close()

    @property
    def pid(self) -> int | None:
        """Id of the process."""
        return self._process.pid

    def ended(self) -> None:
        """Tell the process that the folder is complete, so that it takes the last frames, too."""
        with suppress(OSError):
            self._mine.send(None)

    def slots(self) -> int:
        """Always one."""
        return 1

    def outcomes(
        self,
        function: abc.Callable[[Task, SendMessage], Result],
        tasks: abc.Sequence[Task],
        listener: Listener,
        memory_gb: abc.Callable[[Task], float] | None = None,
        *,
        slowest_twice: bool = False,
    ) -> Outcomes[Task, Result]:
        """See `Executor`; if the process has died, its tasks run in this process."""
        try:
            for task in tasks:
                yield task, self._result(function, task, listener)
        except BaseException:
            self.close()  # only then can the caller remove what an interrupted build leaves
            raise

    def _result(
        self, function: abc.Callable[[Task, SendMessage], Result], task: Task, listener: Listener
    ) -> Result:
        with suppress(OSError):
            self._mine.send((function, task))
        while True:
            try:
                is_result, said = self._mine.recv()
            except (EOFError, OSError):  # the process has died
                break
            if is_result:
                result: Result = said
                return result
            listener.heard(said)  # an OSError of its own does not begin the task again
        listener.warn("the build's process was killed, perhaps for lack of memory; the build begins again")
        with using_threads(self._threads):
            return function(task, listener.heard)

    def close(self) -> None:
        """End the process, and delete the frames and results that it stored."""
        self._mine.close()
        try:
            self._process.join(ENDS_WITHIN_S)
        finally:  # after another Ctrl-C, too
            self._process.kill()
            self._process.join()
            shutil.rmtree(self._stored, ignore_errors=True)


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
            RecordingError: the folder now names another camera than before.
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
            whole: whether the folder is complete. If not, the last two frames are not taken yet, because
                their colour may still arrive.
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
        """Register the newest stored frame, the last of `frames`, to earlier frames."""
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
        """Return the frames stored so far; None if the folder does not exist yet."""
        return PartialSequence(self._writer, tuple(self._marks)) if self._writer else None

    def odometry(self) -> PartialOdometry | None:
        """Return the odometry of the stored frames; None if there is none yet."""
        return PartialOdometry(self._follower, tuple(self._digests)) if self._follower else None


class _Taking:
    """Takes the frames of a growing folder on a thread, until the odometry is asked for.

    Attributes:
        ended: to be set when the folder is complete.
    """

    def __init__(self, growing: GrowingBuild) -> None:
        self.ended = threading.Event()
        self._growing, self._whole, self._busy = growing, False, False
        self._pool = ThreadPoolExecutor(1, initializer=_prepare)
        self._pool.submit(self._take)

    def _take(self) -> None:
        """Take one frame, or wait for one; then submit this method again, so that requests get a turn."""
        try:
            if not self._busy or self.ended.is_set() != self._whole:  # only now are the last rows final
                self._whole = self.ended.is_set()
                self._growing.read_again()
            self._busy = self._growing.take(whole=self._whole)
        except Exception:  # a frame is half taken: the build begins with the first, and reports an error
            self._growing = GrowingBuild(self._growing.folder, self._growing.stored)
            return
        if not self._busy and not self._whole:
            self.ended.wait(READ_AGAIN_S)
        if self._busy or not self._whole:
            self._pool.submit(self._take)

    def sequence(self) -> PartialSequence | None:
        """Return a copy of the sequence so far; further frames are taken meanwhile."""
        with suppress(BrokenExecutor):  # `_prepare` failed: the build reports why
            return self._pool.submit(lambda: copy.deepcopy(self._growing.sequence())).result()
        return None

    def odometry(self) -> PartialOdometry | None:
        """Return the odometry so far; take no more frames."""
        self.stop()
        growing = self._growing
        del self._growing  # it holds the frames' images
        return growing.odometry()

    def stop(self) -> None:
        """Take no more frames; wait for the present one."""
        self.ended.set()
        self._pool.shutdown(cancel_futures=True)


def _prepare() -> None:
    """Lower this thread's priority (Linux counts niceness by thread), and load the libraries of a build."""
    with suppress(OSError):
        os.nice(NICER)
    import kinectbench.engine.steps  # noqa: F401

    raycaster()
    new_figure(1, 1)


def _end_with_recorder(stored: Path) -> None:
    """Wait for the recorder to end, then exit at once: a stage may report no progress for a long time."""
    recorder = multiprocessing.parent_process()
    if recorder is not None:
        recorder.join()
        shutil.rmtree(stored, ignore_errors=True)
        os._exit(1)


def _run(connection: Connection, folder: Path, threads: int) -> None:
    """Run the process: take frames until the other end of the connection sends a task, or closes."""
    for each in IGNORED:
        signal.signal(each, signal.SIG_IGN)
    warnings.simplefilter("ignore")  # the recorder owns the terminal
    stored = folder / f"{STORED}{os.getpid()}"
    threading.Thread(target=_end_with_recorder, args=(stored,), daemon=True).start()
    taking = _Taking(GrowingBuild(folder, stored))

    def say(message: object) -> None:
        try:
            connection.send((False, message))
        except OSError as error:  # the other end closed; this is no failure of the build
            raise KeyboardInterrupt from error

    try:
        with (
            using_threads(threads),
            using_partial_sequence(taking.sequence),
            using_partial_odometry(taking.odometry),
        ):
            while True:
                asked = connection.recv()
                taking.ended.set()
                if asked is not None:
                    function, task = asked
                    connection.send((True, function(task, say)))
    except (Exception, KeyboardInterrupt):  # the other end closed, or the build reports the error later
        return
    finally:
        taking.stop()
        shutil.rmtree(stored, ignore_errors=True)
