"""The normalised recording: indexed frames, one pinhole camera, and optionally a given trajectory."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.sequence import AGAIN
from kinectbench.core.encoded_images import decoded_image
from kinectbench.core.errors import StorageError
from kinectbench.core.geometry import Camera, DepthCalibration, corrected_depth_m
from kinectbench.core.threads import ahead
from kinectbench.core.types import Bools, Float32, Float64, Int64


@dataclass(frozen=True)
class GivenTrajectory:
    """The trajectory that came with a recording.

    Attributes:
        stamps_ns: (m,) int64, nanoseconds, strictly increasing, on the clock of the frames.
        T_world_camera: (m, 4, 4) float64, optical camera axes; rotations on SO(3).
    """

    stamps_ns: Int64
    T_world_camera: Float64

    def equals(self, other: "GivenTrajectory", tolerance_m: float) -> bool:
        """Whether both have the same poses at the same stamps, up to rounding.

        Entries of a rotation have no unit; they may differ by the value of `tolerance_m`.
        """
        return np.array_equal(self.stamps_ns, other.stamps_ns) and np.allclose(
            self.T_world_camera, other.T_world_camera, rtol=0, atol=tolerance_m
        )


class FrameStore(Protocol):
    """Random access to the frames of a sequence."""

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        """Return depth of one frame as recorded: (height, width) uint16, 0 = no measurement."""
        ...

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        """Encoded colour of one frame: (suffix such as ".jpg", bytes); None if it has no colour."""
        ...


class UpSample(NamedTuple):
    """The up direction by an accelerometer at one time: a stamp, and a unit vector in the camera's axes."""

    stamp_ns: int
    up_camera: tuple[float, float, float]


@dataclass(frozen=True)
class Sequence:
    """A recording that every later stage can use without knowing its format.

    Attributes:
        camera: intrinsics of the depth image, and of registered colour.
        depth_scale: native units per metre: `metres = native / depth_scale`.
        stamps_ns: (n,) int64, depth stamps, strictly increasing; a recording without stamps counts its frames
            in seconds (index * 10**9).
        color_registered: colour pixels lie on depth pixels.
        given_trajectory: the trajectory that came with the recording; None if there is none.
        frames: access to depth and colour.
        depth_correction_per_m: (height, width) float32, added to 1 / depth; None: depth as recorded.
        masks: the masks that came with the recording, or None: index -> (height, width) bool, the object;
            None for a frame without mask.
        trajectory_error: why the trajectory that came with the recording cannot be used, or "".
        up_world: (3,) unit: up in the frame of the given trajectory, by gravity; None: unknown.
        up_cameras: up in the camera's axes at some times, by an accelerometer.
        recorded: number of each frame in the recording, damaged frames included; None: equal to its index.
        beside_m: for a recording masked by `own_pixels`: index -> (height, width) float32 metres, the depth
            well outside the mask, 0 = nothing; else None.
    """

    camera: Camera
    depth_scale: float
    stamps_ns: Int64
    color_registered: bool
    given_trajectory: GivenTrajectory | None
    frames: FrameStore
    depth_correction_per_m: Float32 | None = None
    masks: Callable[[int], Bools | None] | None = None
    trajectory_error: str = ""
    up_world: Float64 | None = None
    up_cameras: tuple[UpSample, ...] = ()
    recorded: tuple[int, ...] | None = None
    beside_m: Callable[[int], Float32] | None = None

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def depth_m(self, index: int) -> Float32:
        """Return depth of one frame in metres along z: (height, width) float32, 0 = no measurement."""
        depth_m = depth_in_metres(self.frames.depth_native(index), self.depth_scale)
        if self.depth_correction_per_m is None:
            return depth_m
        return corrected_depth_m(depth_m, self.depth_correction_per_m)

    def depths_m(self, frames: Iterable[int], step_px: int = 1) -> Iterator[Float32]:
        """Yield the depth of frames as `depth_m` does, at every `step_px`-th row and column, read ahead."""
        return ahead(lambda index: self.depth_m(int(index))[::step_px, ::step_px], frames)

    def calibrated(self, calibration: DepthCalibration) -> "Sequence":
        """Return the same recording with its depth corrected by a calibration."""
        if calibration.is_none:
            return replace(self, depth_correction_per_m=None)
        correction = calibration.correction_per_m(self.camera.width, self.camera.height)
        return replace(self, depth_correction_per_m=correction)

    def color_rgb(self, index: int) -> NDArray[np.uint8] | None:
        """Colour of one frame: (height, width, 3) uint8 RGB; None if it has no colour.

        Raises:
            StorageError: the image is missing or damaged.
        """
        encoded = self.frames.color_encoded(index)
        return None if encoded is None else np.ascontiguousarray(stored_bgr(encoded[1], index)[..., ::-1])


def stored_bgr(data: bytes, index: int) -> NDArray[np.uint8]:
    """Decode the stored colour of a frame: (height, width, 3) uint8 BGR.

    Raises:
        StorageError: the image is damaged.
    """
    import cv2

    try:
        return decoded_image(data, cv2.IMREAD_COLOR).astype(np.uint8, copy=False)
    except ValueError as error:
        raise StorageError(f"the stored colour of frame {index} {error}; {AGAIN}") from error


def depth_in_metres(native: NDArray[np.uint16], depth_scale: float) -> Float32:
    """Convert depth of any shape to float32 metres; `depth_scale` is native units per metre; 0 stays 0."""
    return native.astype(np.float32) / np.float32(depth_scale)


def counts_frames(stamps_ns: Int64) -> bool:
    """Whether stamps (n,) only count frames in whole seconds, as in recordings without times."""
    return bool(len(stamps_ns)) and not (stamps_ns % 10**9).any()
