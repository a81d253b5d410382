"""Those who look on while a recording is made: they get the newest frame, and never hold it up."""

import threading
from typing import Protocol

from kinectbench.record.interface import Frame, Setup


class Observer(Protocol):
    """Somebody who looks on, such as a live picture or a tracker."""

    def see(self, number: int, frame: Frame, setup: Setup) -> None:
        """Look at a frame, for as long as it takes.

        It runs on a thread of its own. Of the frames that come meanwhile only the newest waits for it. An
        error ends its looking on, not the recording.

        Args:
            number: of the frame in the recording, from 0; its files are named by it.
            frame: as it is written; its arrays are not to be changed.
            setup: the device's cameras.
        """
        ...


class Watcher:
    """Hands an observer the newest frame, one at a time.

    Attributes:
        skipped: frames that the observer did not see.
        failure: what ended its looking on, or None.
    """

    def __init__(self, observer: Observer, setup: Setup) -> None:
        """Start its thread, which ends with the process at the latest."""
        self.skipped = 0
        self.failure: Exception | None = None
        self._observer, self._setup = observer, setup
        self._newest: tuple[int, Frame] | None = None
        self._ended = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._look, name="observer", daemon=True)
        self._thread.start()

    def offer(self, number: int, frame: Frame) -> None:
        """Put a frame in place of the one that waits, if any; returns at once."""
        with self._changed:
            self.skipped += self._newest is not None
            self._newest = (number, frame)
            self._changed.notify()

    def end(self) -> None:
        """Let it see the last frame, and wait for it."""
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
        """Wait for a frame; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None or self._ended)
            newest, self._newest = self._newest, None
            return newest
