"""A camera that draws its frames, and does what it is asked to: to break, to go back in time, to hurry."""

import time
from collections.abc import Callable, Iterator

import numpy as np
from written_frames import DEPTH, START_NS, STEP_NS, frame

from kinectbench.record.interface import Acceleration, Device, Frame, Setup


def drawn(index: int, stamp_ns: int = -1) -> Frame:
    """Depth in mm and colour as pixels, different for each frame; and two accelerations."""
    made = frame(index, stamp_ns=stamp_ns)
    depth = np.rint(made.depth_m * 1000).astype(np.uint16)
    felt = tuple(Acceleration(made.stamp_ns + k, (0.125, -9.75, float(k))) for k in range(2))
    return Frame(made.stamp_ns, depth, made.color_rgb, made.color_stamp_ns, felt)


class DrawnCamera(Device):
    """So many frames, as fast as they are taken unless `step_s` says how far apart they come."""

    name, cameras = "drawn", "no camera"

    def __init__(
        self,
        count: int = 8,
        stamp_ns: Callable[[int], int] = lambda index: START_NS + index * STEP_NS,
        breaks_at: int | None = None,
        step_s: float = 0.0,
    ) -> None:
        self.count, self.stamp_ns, self.breaks_at, self.step_s = count, stamp_ns, breaks_at, step_s
        self.closed = False

    def plugged_in(self) -> tuple[str, ...]:
        return ("a pencil",)

    def open(self) -> Setup:
        return Setup(DEPTH, 1000.0, True)

    def frames(self) -> Iterator[Frame]:
        for index in range(self.count):
            if index == self.breaks_at:
                raise RuntimeError("the device is gone\nat 0x7f")
            time.sleep(self.step_s)
            yield drawn(index, self.stamp_ns(index))

    def close(self) -> None:
        self.closed = True
