"""Plays any readable recording as if it were a camera, at its own or another speed."""

import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np

from kinectbench.core import CaptureError
from kinectbench.core.trajectory.stamps import JUMP_NS, JUMP_PERIODS, NS_PER_S, typical_period_ns
from kinectbench.record.interface import Device, Frame, Setup
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import DamagedImageError
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import RawFrame

# Frames kept for a late consumer: as many buffers as librealsense requests from the kernel's driver
# (DEFAULT_V4L2_FRAME_BUFFERS).
KEPT = 4


class Replay(Device):
    """A recording in place of a camera; like a camera, it has no poses."""

    name = "replay"
    cameras = "any recording that is read"

    def __init__(self, path: Path, speed: float = 1.0, camera: CameraSettings | None = None) -> None:
        """Prepare the device without opening the recording.

        Args:
            path: the recording's file or folder.
            speed: playback speed; 1 is the speed of the recording.
            camera: settings that override values of the recording.
        """
        self._path, self._speed, self._settings = path, speed, camera
        self._damage: DamagedImageError | None = None

    def plugged_in(self) -> tuple[str, ...]:
        """Return the recording's path, if it exists."""
        return (str(self._path),) if self._path.exists() else ()

    def open(self) -> Setup:
        """Open the recording as a build does, on the one thread that also reads it."""
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="replay")
        self._recording = self._pool.submit(open_recording, self._path, self._settings).result()
        if not len(self._recording):
            raise CaptureError(f"{self._path}: has no frame that could be replayed")
        said = self._recording
        return Setup(said.camera, said.depth_scale, said.color_registered, said.color_calibration)

    def frames(self) -> Iterator[Frame]:
        """Yield each frame at its time; a damaged frame, or one requested too late, counts as missed.

        If the clock jumps, the wait is shortened to the longest step that still counts as a pause
        (`core.trajectory.stamps`).

        Raises:
            CaptureError: all frames are damaged.
        """
        stamps_ns = np.asarray(self._recording.stamps_ns)
        longest_ns = max(JUMP_NS, JUMP_PERIODS * typical_period_ns(stamps_ns))
        steps_ns = np.clip(np.diff(stamps_ns, prepend=stamps_ns[0]), 0, longest_ns)
        due_s = (np.cumsum(steps_ns) / NS_PER_S / self._speed).tolist()
        started_s: float | None = None
        yielded = False
        for index, raw in enumerate(self._read_ahead()):
            now_s = time.monotonic()
            started_s = now_s if started_s is None else started_s
            wait_s = started_s + due_s[index] - now_s
            if wait_s > 0:
                time.sleep(wait_s)
            late = index + KEPT < len(due_s) and started_s + due_s[index + KEPT] <= now_s
            if late or raw is None:
                self.missed += 1
            else:
                yielded = True
                yield Frame(raw.stamp_ns, raw.depth, raw.color)
        if not yielded and self._damage is not None:
            raise CaptureError(f"no frame can be read: {self._damage}")

    def close(self) -> None:
        """End the thread that reads."""
        if hasattr(self, "_pool"):
            self._pool.shutdown(cancel_futures=True)

    def _read_ahead(self) -> Iterator[RawFrame | None]:
        """Yield the frames in order, a few of them read ahead; None for a damaged frame."""
        reading: deque[Future[RawFrame | None]] = deque()
        for index in range(len(self._recording)):
            reading.append(self._pool.submit(self._read, index))
            if len(reading) > KEPT:
                yield reading.popleft().result()
        while reading:
            yield reading.popleft().result()

    def _read(self, index: int) -> RawFrame | None:
        try:
            return self._recording.frame(index)
        except DamagedImageError as error:
            self._damage = self._damage or error
            return None
