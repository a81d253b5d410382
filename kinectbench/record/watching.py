"""Observers of a recording: they get the newest frame, and never delay the recorder."""

import threading
from typing import Protocol

from kinectbench.record.interface import Frame, Setup


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
