"""Maps of a frame for registration: depth, normals and intensity at three resolutions, and points.

The finest resolution is about 320 pixels wide. The depth of a Kinect has no more detail, because its noise is
correlated over two pixels; and a quarter of the pixels takes a quarter of the time.

The depth of a keyframe is averaged with that of the frames registered to it, for less noise and better
normals, after the keyframe fusion of Meilland & Comport (IROS 2013). Each pixel of the keyframe is projected
into those frames and averaged where they see the same surface.
"""

from collections import OrderedDict
from dataclasses import dataclass, field, replace

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.encoded_images import decoded_image
from kinectbench.core.geometry import (
    SIGMA_GROWTH_PER_M,
    SIGMA_NEAR_DEPTH_M,
    SIGMA_NEAR_M,
    Camera,
    DepthCalibration,
    corrected_depth_m,
    invert_rigid,
)
from kinectbench.core.geometry.rolling_shutter import RollingShutter, upright_depth, upright_gray
from kinectbench.core.images import image_sharpness
from kinectbench.core.sequence import Sequence, depth_in_metres
from kinectbench.core.types import Float32
from kinectbench.stages.track.map_kernels import (
    PROJECTED_FROM_M,
    chosen_points,
    halved,
    normal_differences,
    normals_of,
    reduced_depth,
    smoothed_depth,
)

# Half of a Kinect's columns, for the reason in the docstring of this module.
WORKING_WIDTH_PX = 320
# Largest number of points to register per level, finest first.
POINTS = (20_000, 3_000, 1_500)
# Lower bound of the normal noise: smoothing bends the exact planes of a simulation by this much.
MIN_NORMAL_NOISE = 8.0
# Neighbouring pixels belong to one surface if their relative depth difference is below the first value, or
# below the second value divided by the focal length (a slope). The first pair is for smoothing, the second
# for normals.
SAME_SURFACE = ((0.025, 6.6), (0.04, 10.5))
# Number of frames whose maps are kept, because loops use keyframes again. More would take memory.
CACHED_FRAMES = 150
# Number of frames whose reduced images are kept; each takes about 0.2 MB.
READ_FRAMES = 2000
# Reduced depth is stored in tenths of a millimetre: at most 6.5 m.
STORED_PER_M = 10_000.0
# Standard deviation of the blur of intensities, working pixels, so that their gradients are less noisy.
BLUR_PX = 0.7
# A depth is averaged with that of another frame within this many standard deviations, and a slack for the
# pose.
SAME_SIGMAS, SAME_SLACK_M = 4, 0.003
# Largest number of frames to average; more would only cost time. Chosen by hand.
MAX_FRAMES = 16


@dataclass(frozen=True)
class ReducedFrame:
    """The images of one frame at working resolution.

    Attributes:
        depth: (height, width) uint16, 0.1 mm, 0 = none.
        gray: (height, width) uint8; of shape (0, 0) where colour is missing or not registered to depth.
    """

    depth: NDArray[np.uint16]
    gray: NDArray[np.uint8]


@dataclass(frozen=True)
class Level:
    """One resolution of a frame.

    Attributes:
        camera: intrinsics at this resolution.
        depth_m: (height, width) float32, 0 = none.
        normals: (height, width, 3) float32, camera frame, towards the camera; 0 = none.
        intensity: (height, width) float32, 0 to 255; of shape (0, 0) where there is no registered colour.
        points: (m, 8) float32: position (metres, camera frame), normal, standard deviation sigma of the depth
            (metres), intensity.
        normal_noise: noise of the normals, normalised so that one number holds for the whole frame. The
            standard deviation of a normal along each of its two tangents, radians, is normal_noise * sigma /
            depth * cos(angle between normal and viewing ray).
    """

    camera: Camera
    depth_m: Float32
    normals: Float32
    intensity: Float32
    points: Float32
    normal_noise: float


class FrameMaps:
    """One frame at three resolutions, each half the previous one; computed on demand.

    Threads may share it: at worst two of them compute the same level.
    """

    def __init__(self, camera: Camera, depth_m: Float32, intensity: Float32) -> None:
        self._inputs = {0: (camera, depth_m, intensity)}
        self._made: dict[int, Level] = {}

    def __getitem__(self, level: int) -> Level:
        """Return one resolution; level 0 is the finest."""
        if level not in self._made:
            self._made[level] = _level(*self._input(level), POINTS[level])
        return self._made[level]

    def _input(self, level: int) -> tuple[Camera, Float32, Float32]:
        if level not in self._inputs:
            self._inputs[level] = _halved_inputs(*self._input(level - 1))
        return self._inputs[level]

    @property
    def has_intensity(self) -> bool:
        """Whether the photometric term can be used, because there is intensity."""
        return self._inputs[0][2].size > 0

    def reduced(self, enough_px: int, *, with_intensity: bool) -> "FrameMaps":
        """Return the same frame, at half the resolution if it is then still at least `enough_px` wide."""
        camera, depth_m, intensity = self._inputs[0]
        if camera.width >= 2 * enough_px:
            camera, depth_m, intensity = _halved_inputs(camera, depth_m, intensity)
        return FrameMaps(camera, depth_m, intensity if with_intensity else np.zeros((0, 0), np.float32))


@dataclass
class MapCache:
    """The maps of a sequence's frames, computed on demand; only the 150 used last are kept, to bound memory.

    Reading is slow, so the reduced images of the first 2000 frames read stay in memory. With `keeps_all`, the
    images of all frames stay until `forget` is called; it is for live frames, which cannot be read again.
    Threads may share the cache: at worst two of them compute the same maps. Meanwhile `improve` may change
    only frames that no other thread reads, as `Follower` does: its threads prepare frames that are not taken
    yet, and it improves its last keyframe. `calibrate` and `undo_shutter` must not be called.

    Attributes:
        sequence: the recording.
        averaged: averaged depth of some frames, by index: see `improve`.
        correction_per_m: (height, width) float32 at working resolution, added to 1 / depth: see `calibrate`.
        shutter: the rolling shutter that is undone in each frame: see `undo_shutter`.
        sharpness: sharpness of the frames read, by index; empty if colour is not registered to depth.
        keeps_all: whether the images of more than 2000 frames stay in memory.
    """

    sequence: Sequence
    averaged: dict[int, NDArray[np.uint16]] = field(default_factory=dict)
    correction_per_m: Float32 | None = None
    shutter: RollingShutter | None = None
    sharpness: dict[int, float] = field(default_factory=dict)
    keeps_all: bool = False
    _kept: OrderedDict[int, FrameMaps] = field(default_factory=OrderedDict)
    _read: dict[int, ReducedFrame] = field(default_factory=dict)

    def __getstate__(self) -> dict[str, object]:
        """Return the state to pickle, without the maps, which are computed again on demand."""
        return {**vars(self), "_kept": OrderedDict()}

    def copied(self) -> "MapCache":
        """Return a copy for another thread, without maps and sharpness; later changes are not shared."""
        read = {**self._read}
        return replace(self, averaged={**self.averaged}, sharpness={}, _kept=OrderedDict(), _read=read)

    def forget(self, index: int) -> None:
        """Drop the images and the maps of a frame that is not needed any more."""
        self._read.pop(index, None)
        self._kept.pop(index, None)

    def __getitem__(self, index: int) -> FrameMaps:
        # Each single call on a dictionary is atomic, whatever other threads do.
        maps = self._kept.pop(index, None) or self._made(index, self.shutter, self.averaged.get(index))
        self._kept[index] = maps
        if len(self._kept) > CACHED_FRAMES:
            self._kept.popitem(last=False)
        return maps

    def upright(self, index: int, shutter: RollingShutter) -> FrameMaps:
        """Return uncached maps of a frame, from its own depth, with this rolling shutter undone."""
        return self._made(index, shutter, None)

    def _made(
        self, index: int, shutter: RollingShutter | None, averaged: NDArray[np.uint16] | None
    ) -> FrameMaps:
        frame = self._read.get(index) or self._reduced(index)
        camera = reduced_camera(self.sequence.camera, _reduction(self.sequence.camera))
        depth, gray = frame.depth, frame.gray
        if shutter is not None and averaged is None:
            depth = upright_depth(depth, STORED_PER_M, camera, shutter.motion[index], shutter.readout_s)
        depth_m = depth_in_metres(depth if averaged is None else averaged, STORED_PER_M)
        if shutter is not None and gray.size:
            motion, delay_s = shutter.motion[index], shutter.color_delay_s
            gray = upright_gray(gray, depth_m, camera, motion, shutter.readout_s, delay_s)
        if self.correction_per_m is not None:
            depth_m = corrected_depth_m(depth_m, self.correction_per_m)
        intensity = np.zeros((0, 0), np.float32)
        if gray.size:
            intensity = np.asarray(cv2.GaussianBlur(gray.astype(np.float32), (0, 0), BLUR_PX), np.float32)
        return FrameMaps(camera, depth_m, intensity)

    def _reduced(self, index: int) -> ReducedFrame:
        """Read one frame of the recording; with grey only if colour is registered to depth."""
        sequence, reduction = self.sequence, _reduction(self.sequence.camera)
        native = sequence.frames.depth_native(index)
        depth = reduced_depth(native, sequence.depth_scale, reduction, np.float32(STORED_PER_M))
        gray = reduced_gray(sequence, index) if sequence.color_registered else None
        frame = ReducedFrame(depth, np.zeros((0, 0), np.uint8) if gray is None else gray)
        if self.keeps_all or len(self._read) < READ_FRAMES:
            self._read[index] = frame
        if frame.gray.size and index not in self.sharpness:
            self.sharpness[index] = image_sharpness(frame.gray)
        return frame

    def improve(self, index: int, depth: NDArray[np.uint16]) -> None:
        """Replace the depth of a frame from now on.

        `depth` is (height, width) uint16, 0.1 mm, at working resolution. If the maps are calibrated (see
        `calibrate`), it must have been corrected in the same way.
        """
        if self.correction_per_m is not None:
            depth_m = corrected_depth_m(depth_in_metres(depth, STORED_PER_M), -self.correction_per_m)
            depth = stored_depth(depth_m)
        self.averaged[index] = depth
        self._kept.pop(index, None)

    def undo_shutter(self, shutter: RollingShutter) -> None:
        """Undo a rolling shutter in all maps from now on; drop maps and averaged depth made so far."""
        self.shutter = shutter
        self.averaged.clear()
        self._kept.clear()

    def calibrate(self, calibration: DepthCalibration) -> None:
        """Correct the depth of all frames from now on; this calibration replaces an earlier one."""
        camera = reduced_camera(self.sequence.camera, _reduction(self.sequence.camera))
        none = calibration.is_none
        self.correction_per_m = None if none else calibration.correction_per_m(camera.width, camera.height)
        self._kept.clear()


def reduced_gray(sequence: Sequence, index: int) -> NDArray[np.uint8] | None:
    """Read colour as grey, working resolution; None if missing, damaged or of another size than depth."""
    gray, camera = gray_frame(sequence, index, cv2.IMREAD_GRAYSCALE), sequence.camera
    if gray is None or gray.shape != (camera.height, camera.width):
        return None
    reduction = _reduction(sequence.camera)
    height, width = (size // reduction for size in gray.shape)
    whole = gray[: height * reduction, : width * reduction]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))


def _reduction(camera: Camera) -> int:
    """Return the reduction factor: the number of pixels, in each direction, that form a working pixel."""
    return max(1, round(camera.width / WORKING_WIDTH_PX))


def _halved_inputs(camera: Camera, depth_m: Float32, intensity: Float32) -> tuple[Camera, Float32, Float32]:
    half = halved(depth_m)
    if intensity.size:
        even = intensity[: half.shape[0] * 2, : half.shape[1] * 2]
        intensity = np.asarray(cv2.resize(even, half.shape[::-1], interpolation=cv2.INTER_AREA), np.float32)
    return reduced_camera(camera, 2), half, intensity


def reduced_camera(camera: Camera, factor: int) -> Camera:
    """Return the camera whose pixels are blocks of `factor` x `factor` pixels; a remainder is cut off."""
    shift = (factor - 1) / 2
    return Camera(
        camera.width // factor,
        camera.height // factor,
        camera.fx / factor,
        camera.fy / factor,
        (camera.cx - shift) / factor,
        (camera.cy - shift) / factor,
    )


def gray_frame(sequence: Sequence, index: int, mode: int) -> NDArray[np.uint8] | None:
    """Read the colour of a frame as grey, in a mode of `cv2.imdecode`; None if missing or damaged."""
    encoded = sequence.frames.color_encoded(index)
    try:
        return None if encoded is None else np.asarray(decoded_image(encoded[1], mode), np.uint8)
    except ValueError:
        return None


def _level(camera: Camera, depth_m: Float32, intensity: Float32, n_points: int) -> Level:
    intrinsics = camera.intrinsics
    smooth, differ = (np.float32(max(least, slope / camera.fx)) for least, slope in SAME_SURFACE)
    normals = normals_of(smoothed_depth(depth_m, smooth), intrinsics, differ)
    points = chosen_points(depth_m, normals, intensity, intrinsics, n_points)
    return Level(camera, depth_m, normals, intensity, points, _normal_noise(normals, depth_m, intrinsics))


def _normal_noise(normals: Float32, depth_m: Float32, intrinsics: NDArray[np.float64]) -> float:
    """Estimate `Level.normal_noise` from normals nine pixels apart, which mostly lie on one plane.

    If a normal's noise along each tangent has standard deviation s, the squared difference of two normals is
    exponentially distributed with mean 4 s^2. The mean is estimated from the median.
    """
    squared = normal_differences(normals, depth_m, intrinsics)
    if not len(squared):
        return MIN_NORMAL_NOISE
    return max(MIN_NORMAL_NOISE, float(np.sqrt(np.median(squared) / (4 * np.log(2)))))


class DepthAverage:
    """The running average of a keyframe's depth."""

    def __init__(self, keyframe: Level) -> None:
        """Start with the keyframe at its finest resolution."""
        self._own = keyframe.depth_m
        self._total, self._count = self._own.copy(), (self._own > 0).astype(np.float32)
        self._frames = 0

    def add(self, frame: Level, T_keyframe_frame: NDArray[np.float64]) -> None:
        """Add a frame, with the relative pose T_keyframe_frame (4, 4); at most 16 frames are added."""
        if self._frames >= MAX_FRAMES:
            return
        self._frames += 1
        T_frame_keyframe = np.ascontiguousarray(invert_rigid(T_keyframe_frame))
        _add(self._total, self._count, self._own, frame.depth_m, frame.camera.intrinsics, T_frame_keyframe)

    def stored(self) -> NDArray[np.uint16]:
        """Return the mean depth in 0.1 mm: (height, width) uint16, 0 = none."""
        mean_m = self._total / np.maximum(self._count, 1)
        return stored_depth(mean_m)


def stored_depth(depth_m: Float32 | NDArray[np.float64]) -> NDArray[np.uint16]:
    """Convert depth of any shape from metres to 0.1 mm; depth beyond 6.5 m becomes 6.5 m."""
    return np.asarray(np.rint(np.minimum(depth_m * STORED_PER_M, 65535)), np.uint16)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _add(total, count, keyframe, frame, intrinsics, T):  # type: ignore[no-untyped-def]
    height, width = keyframe.shape
    fx, fy, cx, cy = intrinsics
    over_fx, over_fy = 1 / fx, 1 / fy
    r00, r01, r02, t0 = T[0, 0], T[0, 1], T[0, 2], T[0, 3]
    r10, r11, r12, t1 = T[1, 0], T[1, 1], T[1, 2], T[1, 3]
    r20, r21, r22, t2 = T[2, 0], T[2, 1], T[2, 2], T[2, 3]
    for v in range(height):
        b = (v - cy) * over_fy
        for u in range(width):
            d = float(keyframe[v, u])
            if d <= 0:
                continue
            a = (u - cx) * over_fx
            z = (r20 * a + r21 * b + r22) * d + t2
            if z < PROJECTED_FROM_M:
                continue
            over_z = 1 / z
            x = fx * ((r00 * a + r01 * b + r02) * d + t0) * over_z + cx
            y = fy * ((r10 * a + r11 * b + r12) * d + t1) * over_z + cy
            if x < 0 or y < 0 or x >= width - 1 or y >= height - 1:
                continue
            near = frame[np.uint32(y + 0.5), np.uint32(x + 0.5)]
            sigma_m = SIGMA_NEAR_M + SIGMA_GROWTH_PER_M * (z - SIGMA_NEAR_DEPTH_M) ** 2
            reach = SAME_SIGMAS * sigma_m + SAME_SLACK_M
            if near <= 0 or abs(near - z) > reach:
                continue
            # Unsigned, so that no index is negative.
            i, j = np.uint32(y), np.uint32(x)
            down, right = y - i, x - j
            d00, d01, d10, d11 = frame[i, j], frame[i, j + 1], frame[i + 1, j], frame[i + 1, j + 1]
            seen = float(near)
            if max(abs(d00 - near), abs(d01 - near), abs(d10 - near), abs(d11 - near)) < reach:
                seen = (d00 * (1 - right) + d01 * right) * (1 - down)
                seen += (d10 * (1 - right) + d11 * right) * down
            total[v, u] += d + (seen - z)
            count[v, u] += 1
