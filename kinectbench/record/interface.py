"""What every camera offers, and what a frame of it holds."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.errors import CaptureError
from kinectbench.core.geometry import Camera
from kinectbench.stages.ingest.recording import ColorCalibration

# A device is asked so often, that Ctrl-C is answered at once; after so long without a frame it is gone.
# Cameras give 5 frames a second and more; the first may take two seconds (exposure, laser).
POLL_MS, SILENT_S = 200, 5.0
Item = TypeVar("Item")


class Acceleration(NamedTuple):
    """What an accelerometer measured: stamp in ns, and m/s^2 in the optical axes of the depth camera.

    At rest it is the reaction to gravity, which points up.
    """

    stamp_ns: int
    mps2: tuple[float, float, float]


@dataclass(frozen=True)
class Frame:
    """One frame as a device gave it.

    Attributes:
        stamp_ns: stamp of the depth image, nanoseconds of the device's clock.
        depth: (height, width) uint16 in native units, 0 = no measurement; nobody else writes to it.
        color: (suffix, encoded image) as the device gave it; (height, width, 3) uint8 RGB where it gives
            pixels; or None.
        color_stamp_ns: stamp of colour, nanoseconds; None: that of depth.
        accelerations: what was measured since the frame before.
    """

    stamp_ns: int
    depth: NDArray[np.uint16]
    color: tuple[str, bytes] | NDArray[np.uint8] | None
    color_stamp_ns: int | None = None
    accelerations: tuple[Acceleration, ...] = ()

    @property
    def nbytes(self) -> int:
        """Bytes that it takes in memory."""
        if self.color is None:
            return self.depth.nbytes
        return self.depth.nbytes + (
            len(self.color[1]) if isinstance(self.color, tuple) else self.color.nbytes
        )


@dataclass(frozen=True)
class Setup:
    """What a device says once it is open.

    Attributes:
        camera: intrinsics of the depth images, pixels; they are pinhole images.
        depth_scale: native depth units per metre.
        color_registered: colour pixels lie on depth pixels.
        color_calibration: how colour lies to depth, where it is not registered; None: not known.
    """

    camera: Camera
    depth_scale: float
    color_registered: bool
    color_calibration: ColorCalibration | None = None


class Device(Protocol):
    """A camera, or what acts as one.

    Attributes:
        name: as `--device` has it.
        cameras: which cameras it is for.
        extra: of kinectbench, with the packages that it needs; "" = none.
        system: what it needs that pip does not bring, with a command; "" = nothing.
        missed: frames that the device lost since it was opened, as far as it says.
    """

    name: str
    cameras: str
    extra: str = ""
    system: str = ""
    missed: int = 0

    def plugged_in(self) -> tuple[str, ...]:
        """The cameras that are plugged in, a name each."""
        ...

    def open(self) -> Setup:
        """Start the first camera that is plugged in.

        Raises:
            CaptureError: there is none, or it cannot be started.
        """
        ...

    def frames(self) -> Iterator[Frame]:
        """The frames, each as soon as it is there.

        Raises:
            CaptureError: no more come.
        """
        ...

    def close(self) -> None:
        """Stop it; also where it was not opened, or is gone."""
        ...


def polled(ask: Callable[[], Item | None], device: str) -> Iterator[Item]:
    """What a device gives, one after another.

    Args:
        ask: waits `POLL_MS` at most; None: nothing came.
        device: its name, for the message.

    Raises:
        CaptureError: nothing came for `SILENT_S`.
    """
    last = time.monotonic()
    while True:
        item = ask()
        if item is not None:
            yield item
            last = time.monotonic()
        elif time.monotonic() - last > SILENT_S:
            raise CaptureError(f"{device}: no frame came for {SILENT_S:g} s; look at its cable and its power")
