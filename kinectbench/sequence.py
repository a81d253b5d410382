"""The normalised recording: frames by index, one pinhole camera, an optional given trajectory."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera
from kinectbench.geometry.depth_calibration import DepthCalibration, corrected_depth_m


@dataclass(frozen=True)
class GivenTrajectory:
    """The trajectory that came with a recording, as it was given.

    Attributes:
        stamps_ns: (m,) int64, nanoseconds, strictly increasing, same clock as the frames.
        T_world_camera: (m, 4, 4) float64, optical camera axes; rotations on SO(3).
    """

    stamps_ns: NDArray[np.int64]
    T_world_camera: NDArray[np.float64]


class FrameStore(Protocol):
    """Where the frames of a sequence lie: any frame at random."""

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        """Depth of one frame as recorded: (height, width) uint16, 0 = no measurement."""
        ...

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        """Colour of one frame as it was encoded: (suffix such as ".jpg", bytes), or None."""
        ...


@dataclass(frozen=True)
class Sequence:
    """A recording that every later stage can use without knowing its format.

    Attributes:
        camera: intrinsics of the depth image (and of colour, where that is registered).
        depth_scale: native units per metre: `metres = native / depth_scale`.
        stamps_ns: (n,) int64, depth stamps, strictly increasing; a recording without stamps counts
            its frames in seconds (index * 10**9).
        color_registered: colour pixels lie on depth pixels.
        given_trajectory: the trajectory that came with the recording, or None.
        frames: where depth and colour lie.
        depth_correction_per_m: (height, width) float32, added to 1 / depth; None: depth as recorded.
        masks: the masks that came with the recording, or None: index -> (height, width) bool, the object, or
            None for a frame without one.
        trajectory_error: why a trajectory that came with the recording cannot be used, or "".
    """

    camera: Camera
    depth_scale: float
    stamps_ns: NDArray[np.int64]
    color_registered: bool
    given_trajectory: GivenTrajectory | None
    frames: FrameStore
    depth_correction_per_m: NDArray[np.float32] | None = None
    masks: Callable[[int], NDArray[np.bool_] | None] | None = None
    trajectory_error: str = ""

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def depth_m(self, index: int) -> NDArray[np.float32]:
        """Depth of one frame in metres along z: (height, width) float32, 0 = no measurement."""
        depth_m = self.frames.depth_native(index).astype(np.float32) / np.float32(self.depth_scale)
        if self.depth_correction_per_m is None:
            return depth_m
        return corrected_depth_m(depth_m, self.depth_correction_per_m)

    def calibrated(self, calibration: DepthCalibration) -> "Sequence":
        """The same recording, its depth in metres with a calibration."""
        if calibration.is_none:
            return replace(self, depth_correction_per_m=None)
        correction = calibration.correction_per_m(self.camera.width, self.camera.height)
        return replace(self, depth_correction_per_m=correction)

    def color_rgb(self, index: int) -> NDArray[np.uint8] | None:
        """Colour of one frame: (height, width, 3) uint8 RGB, or None if there is none."""
        import cv2

        encoded = self.frames.color_encoded(index)
        if encoded is None:
            return None
        bgr = cv2.imdecode(np.frombuffer(encoded[1], np.uint8), cv2.IMREAD_COLOR)
        return np.ascontiguousarray(np.asarray(bgr)[..., ::-1])


def counts_frames(stamps_ns: NDArray[np.int64]) -> bool:
    """Whether stamps (n,) are those of a recording without any: they count frames in whole seconds."""
    return bool(len(stamps_ns)) and not (stamps_ns % 10**9).any()


@dataclass(frozen=True)
class MemoryFrames:
    """Frames made on demand by a function: tests and the simulator use it.

    Attributes:
        make_depth: index -> (height, width) uint16.
    """

    make_depth: Callable[[int], NDArray[np.uint16]]

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        """Depth of one frame: (height, width) uint16."""
        return self.make_depth(index)

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        """No colour."""
        return None
