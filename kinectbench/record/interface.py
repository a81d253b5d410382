"""The interface of all cameras, and a frame of a camera."""

import ctypes
import io
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import CaptureError
from kinectbench.core.geometry import Camera
from kinectbench.stages.ingest.recording import ColorCalibration

# A device is polled in this interval, so that Ctrl-C is answered at once; after this many seconds without a
# frame it counts as gone. Cameras give 5 frames a second and more; the first may take two seconds (exposure,
# laser).
POLL_MS, SILENT_S = 200, 5.0
Item = TypeVar("Item")


class Acceleration(NamedTuple):
    """An accelerometer measurement: stamp (ns), and (x, y, z) in m/s^2, in the depth camera's optical axes.

    At rest, it is the reaction to gravity and points up.
    """

    stamp_ns: int
    mps2: tuple[float, float, float]


@dataclass(frozen=True)
class Frame:
    """One frame as a device gave it.

    Attributes:
        stamp_ns: stamp of the depth image, nanoseconds of the device's clock.
        depth: (height, width) uint16 in native units, 0 = no measurement; the device does not reuse the
            array.
        color: (file suffix, encoded image) if the device encodes colour; (height, width, 3) uint8 RGB if it
            gives pixels; None if there is no colour.
        color_stamp_ns: stamp of colour, nanoseconds; None: the stamp of depth.
        accelerations: measurements since the previous frame.
    """

    stamp_ns: int
    depth: NDArray[np.uint16]
    color: tuple[str, bytes] | NDArray[np.uint8] | None
    color_stamp_ns: int | None = None
    accelerations: tuple[Acceleration, ...] = ()

    @property
    def nbytes(self) -> int:
        """Bytes of the frame in memory."""
        if self.color is None:
            return self.depth.nbytes
        return self.depth.nbytes + (
            len(self.color[1]) if isinstance(self.color, tuple) else self.color.nbytes
        )


@dataclass(frozen=True)
class Setup:
    """The properties that a device states once it is open.

    Attributes:
        camera: intrinsics of the depth images (pinhole images), pixels.
        depth_scale: native depth units per metre.
        color_registered: whether colour pixels lie on depth pixels.
        color_calibration: the colour camera relative to the depth camera; None if colour is registered, or
            if it is not known.
    """

    camera: Camera
    depth_scale: float
    color_registered: bool
    color_calibration: ColorCalibration | None = None


class Device(Protocol):
    """A camera, or something that acts like one.

    Attributes:
        name: the device's name for `--device`.
        cameras: the cameras that it supports.
        extra: the optional dependencies of kinectbench that it needs, as in `kinectbench[extra]`; "" = none.
        system: what it needs that pip does not install, and how to get it; "" = nothing.
        missed: number of frames lost since it was opened, as far as the device reports.
    """

    name: str
    cameras: str
    extra: str = ""
    system: str = ""
    missed: int = 0

    def plugged_in(self) -> tuple[str, ...]:
        """Return the names of the cameras that are plugged in."""
        ...

    def open(self) -> Setup:
        """Start the first camera that is plugged in, and return its setup.

        Raises:
            CaptureError: there is no camera, or it cannot be started.
        """
        ...

    def frames(self) -> Iterator[Frame]:
        """Yield the frames, each as soon as it arrives, until the device ends.

        Raises:
            CaptureError: no more frames arrive.
        """
        ...

    def close(self) -> None:
        """Stop the camera; allowed also if it was not opened, or is gone."""
        ...


def polled(
    ask: Callable[[], Item | None], device: str, has_depth: Callable[[Item], bool] = lambda item: True
) -> Iterator[Item]:
    """Yield the items that `ask` returns, without end.

    Args:
        ask: waits at most 200 ms for an item; returns None if none arrived.
        device: the device's name, for the message.
        has_depth: whether an item contains depth; items of other streams do not reset the time limit.

    Raises:
        CaptureError: no depth arrived for five seconds.
    """
    last = time.monotonic()
    while True:
        item = ask()
        if item is not None:
            yield item
        if item is not None and has_depth(item):
            last = time.monotonic()
        elif time.monotonic() - last > SILENT_S:
            raise CaptureError(f"{device}: no depth came for {SILENT_S:g} s; look at its cable and its power")


STDOUT = 1


@contextmanager
def quiet() -> Iterator[None]:
    """Silence, within the block, Python's output and the standard output of native libraries.

    Orbbec's SDK prints a line on standard output when imported, in the middle of `--json`. NumPy prints a
    page on standard error if a library was compiled for another version of NumPy.
    """
    flush = ctypes.CDLL(None).fflush  # the buffers of C, whose lines may come from before the block
    flush(None)
    kept, nowhere = os.dup(STDOUT), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, STDOUT)
    os.close(nowhere)
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            yield
    finally:
        flush(None)
        os.dup2(kept, STDOUT)
        os.close(kept)


def in_a_line(error: Exception) -> str:
    """Return the first sentence of the first line of an error's message, or its class if that is empty."""
    said = str(error).strip().partition("\n")[0].partition(". ")[0].rstrip(":. ")
    return said or type(error).__name__
