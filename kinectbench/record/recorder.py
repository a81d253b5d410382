"""Record: write a device's frames into a folder, and show them to observers."""

import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from kinectbench.core import CaptureError, KinectBenchError
from kinectbench.record.folder import FolderWriter, check_new
from kinectbench.record.interface import Acceleration, Device, Frame, Setup, in_a_line, quiet

# Interval at which Python's lock changes hands. It is 5 ms by default while another thread computes in
# Python, and writing a frame takes the lock a dozen times. A busy observer cost 306 of 1,000 frames at 30 Hz;
# with 0.2 ms it cost 6, with this value none (two shared cores; `ingest_speed`).
SWITCH_S = 0.00005
# Called with (frames added, seconds since the first).
Progress = Callable[[int, float], None]


class Observer(Protocol):
    """An observer of a recording, such as a live picture or a tracker."""

    def see(self, number: int, frame: Frame, setup: Setup) -> None:
        """Process a frame; this may take any time.

        It is called on a separate thread. If several frames arrive while it runs, only the newest of them is
        kept. An error ends the observation, but not the recording.

        Args:
            number: the frame's number in the recording, from 0, as in its file names.
            frame: the frame as it is written; its arrays must not be changed.
            setup: the device's cameras.
        """
        ...


class Watcher:
    """Hands the newest frame to an observer, one at a time; older frames that still wait are skipped.

    Attributes:
        skipped: number of frames that the observer did not get.
        failure: the error that ended the observation; None if there is none.
    """

    def __init__(self, observer: Observer, setup: Setup) -> None:
        """Start the observer's thread (a daemon thread)."""
        self.skipped = 0
        self.failure: Exception | None = None
        self._observer, self._setup = observer, setup
        self._newest: tuple[int, Frame] | None = None
        self._ended = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._look, name="observer", daemon=True)
        self._thread.start()

    def offer(self, number: int, frame: Frame) -> None:
        """Replace the waiting frame, if any, by this one; return at once."""
        with self._changed:
            self.skipped += self._newest is not None
            self._newest = (number, frame)
            self._changed.notify()

    def end(self) -> None:
        """Let the observer process the last frame, and wait for it."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        self._thread.join()

    def _look(self) -> None:
        while (newest := self._next()) is not None:
            try:
                self._observer.see(*newest, self._setup)
            except Exception as error:
                self.failure = error
                return

    def _next(self) -> tuple[int, Frame] | None:
        """Wait for a frame; return (its number, the frame), None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None or self._ended)
            newest, self._newest = self._newest, None
            return newest


@dataclass(frozen=True)
class Recorded:
    """The outcome of a recording.

    Attributes:
        folder: the folder of the recording.
        device: the name of the device.
        frames: number of written frames.
        missed: number of frames that the device lost, as far as it reports.
        dropped: number of frames not written because the disk was too slow.
        set_back: number of times that the device's clock stood still or went back.
        seconds: time from the first frame to the last, by the clock of this machine.
        failure: one line on what ended the recording too early, or "".
        observers: one line for each observer that failed.
    """

    folder: Path
    device: str
    frames: int
    missed: int
    dropped: int
    set_back: int
    seconds: float
    failure: str = ""
    observers: tuple[str, ...] = ()


class Clock:
    """Makes stamps that increase, whatever the device's clock does.

    If the device's clock stands still, goes back or restarts, the new stamp is the previous one plus the time
    passed by this machine's monotonic clock. Later stamps keep that offset.

    Attributes:
        set_back: number of times that this happened.
    """

    def __init__(self) -> None:
        """Start without frames."""
        self.set_back = 0
        self._offset_ns = 0
        self._last: tuple[int, int] | None = None

    def put_right(self, frame: Frame, now_ns: int) -> Frame:
        """Return the frame with its stamps shifted, if necessary, to be later than those of the frame before.

        Args:
            frame: the frame from the device.
            now_ns: the monotonic time of its arrival, nanoseconds.
        """
        stamp_ns = frame.stamp_ns + self._offset_ns
        if self._last is not None and stamp_ns <= self._last[0]:
            stamp_ns = self._last[0] + max(now_ns - self._last[1], 1)
            self._offset_ns = stamp_ns - frame.stamp_ns
            self.set_back += 1
        self._last = (stamp_ns, now_ns)
        if not self._offset_ns:
            return frame
        color_ns = None if frame.color_stamp_ns is None else frame.color_stamp_ns + self._offset_ns
        moved = tuple(Acceleration(at_ns + self._offset_ns, mps2) for at_ns, mps2 in frame.accelerations)
        return replace(frame, stamp_ns=stamp_ns, color_stamp_ns=color_ns, accelerations=moved)


def record(
    device: Device,
    folder: Path,
    seconds: float | None = None,
    observers: Sequence[Observer] = (),
    progress: Progress | None = None,
) -> Recorded:
    """Record until the device ends or fails, a frame cannot be written, time is up, or KeyboardInterrupt.

    At the end, waiting frames are written, and observers finish. Ctrl-C in this phase only ends the waiting
    for observers. Another Ctrl-C ends the function at once; the folder can be read up to its last row.

    Args:
        device: the device, which is opened and closed here.
        folder: a missing or empty folder; it is created with the first frame.
        seconds: time limit from the first frame, by the clock of this machine; None: no limit.
        observers: get frames while recording, each on a separate thread.
        progress: called with (frames, seconds since the first frame) after each frame.

    Raises:
        SettingsError: the folder is not empty.
        CaptureError: the device cannot be opened, or gave no frame.
        StorageError: the folder cannot be created.
        ModuleNotFoundError: the device's library is not installed.
    """
    check_new(folder)
    try:
        setup = _opened(device)
        run = _Run(device, folder, setup, observers)
        switch_s = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_S)
        try:
            failure = run.until_the_end(seconds, progress or (lambda frames, passed_s: None))
        finally:
            sys.setswitchinterval(switch_s)
    finally:
        with suppress(Exception, KeyboardInterrupt):  # the device is gone, or Ctrl-C is pressed again
            device.close()
    if run.writer is None:
        raise CaptureError(failure or f"{device.name}: gave no frame, and nothing was written")
    return run.closed(failure)


def _opened(device: Device) -> Setup:
    try:
        with quiet():
            return device.open()
    except (KinectBenchError, ModuleNotFoundError):
        raise
    except Exception as error:
        raise CaptureError(
            f"{device.name}: cannot be opened ({in_a_line(error)}); is it plugged in?"
        ) from error


class _Run:
    """One recording; its writer exists from the first frame on."""

    def __init__(self, device: Device, folder: Path, setup: Setup, observers: Sequence[Observer]) -> None:
        self.device, self.folder, self.setup = device, folder, setup
        self.writer: FolderWriter | None = None
        self.clock = Clock()
        self.watchers = [Watcher(observer, setup) for observer in observers]
        self.started_s = self.seconds = 0.0

    def until_the_end(self, seconds: float | None, progress: Progress) -> str:
        """Take frames; return one line on the failure that ended the recording too early, or "".

        A KinectBenchError before the first frame is written is raised.
        """
        try:
            for frame in self.device.frames():
                self._take(frame)
                assert self.writer is not None
                progress(self.writer.added, self.seconds)
                if self.writer.error is not None or (seconds is not None and self.seconds >= seconds):
                    break
        except KeyboardInterrupt:
            pass
        except Exception as error:
            if self.writer is None and isinstance(error, KinectBenchError):
                raise
            said = str(error) if isinstance(error, KinectBenchError) else in_a_line(error)
            return said if said.startswith(f"{self.device.name}: ") else f"{self.device.name}: {said}"
        return ""

    def _take(self, frame: Frame) -> None:
        now_ns = time.monotonic_ns()
        if self.writer is None:
            self.writer = FolderWriter(self.folder, self.setup, self.device.name)
            self.started_s = now_ns / 1e9
        self.seconds = now_ns / 1e9 - self.started_s
        frame = self.clock.put_right(frame, now_ns)
        number = self.writer.add(frame)
        if number is not None:
            for watcher in self.watchers:
                watcher.offer(number, frame)

    def closed(self, failure: str) -> Recorded:
        """Wait for the writer and, until a KeyboardInterrupt, for the observers; return the outcome."""
        assert self.writer is not None
        try:
            self.writer.close()
            for watcher in self.watchers:
                watcher.end()
        except KeyboardInterrupt:
            self.writer.close()
        if self.writer.error is not None:
            reason = getattr(self.writer.error, "strerror", None) or in_a_line(self.writer.error)
            failure = f"{self.folder}: cannot be written any more ({reason})"
        if failure:
            failure += f"; the {self.writer.listed} frames before are whole: {self.folder} can be built"
        return Recorded(
            self.folder,
            self.device.name,
            self.writer.listed,
            self.device.missed,
            self.writer.dropped,
            self.clock.set_back,
            round(self.seconds, 3),
            failure,
            tuple(in_a_line(watcher.failure) for watcher in self.watchers if watcher.failure is not None),
        )
