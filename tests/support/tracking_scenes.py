"""Scenes and small recordings that several tests of the tracker share, and the error of a trajectory."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import cv2
import numpy as np
from analytic_scenes import (
    SCALE,
    Furniture,
    Surface,
    box,
    depth_of,
    displaced,
    furniture,
    plane,
    small_spec,
    sphere,
)
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera, transform_points
from kinectbench.core.geometry.depth import depth_sigma_m
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.compare import align_positions
from kinectbench.lab.simulate.path import look_at
from kinectbench.stages.track.frame_maps import POINTS, FrameMaps, Level, MapCache
from kinectbench.stages.track.registration import Registration
from kinectbench.stages.track.tracked import Constraint, ConstraintKind

Float64 = NDArray[np.float64]
# Points (..., 3) of the world to intensities 0 to 255.
Texture = Callable[[Float64], Float64]

# What 16 bits hold, less the noise.
MAX_DEPTH_M = 3.2
SMALL = Camera(160, 120, 131.25, 131.25, 79.5, 59.5)
FLOOR = plane((0.0, 0.0, 1.0), 0.0)
# A corner of a room with a box and a ball: every motion is fixed.
ROOM: list[Surface] = [
    FLOOR,
    plane((1.0, 0.0, 0.0), -0.9),
    plane((0.0, 1.0, 0.0), -0.8),
    box((-0.3, -0.2, 0.0), (0.2, 0.15, 0.35)),
    sphere((0.45, 0.3, 0.18), 0.18),
]
CORNER_VIEW = look_at(np.array([1.1, 0.9, 0.9]), np.array([0.0, 0.0, 0.15]))
# A small motion from there.
MOVED = displaced(CORNER_VIEW, (0.02, -0.015, 0.01), 1.2)


def waves(points: Float64) -> Float64:
    """A smooth texture without a direction."""
    x, y, z = np.moveaxis(points, -1, 0)
    waves: Float64 = (
        127
        + 45 * np.sin(31 * x + 5 * np.sin(7 * y)) * np.cos(23 * y + z)
        + 40 * np.sin(17 * z + 11 * x - 13 * y)
    )
    return waves


@dataclass(frozen=True)
class PaintedFrames:
    """Frames in memory, colour as PNG or missing."""

    depth: list[NDArray[np.uint16]]
    color: list[bytes | None]

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        return self.depth[index]

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        encoded = self.color[index]
        return None if encoded is None else (".png", encoded)


def native(depth_m: NDArray[np.floating], noise: np.random.Generator | None = None) -> NDArray[np.uint16]:
    """Depth as it is recorded, 20 units a millimetre; with a Kinect's noise if a generator is given."""
    depth_m = np.where(depth_m < MAX_DEPTH_M, depth_m, 0)
    if noise is not None:
        noisy = depth_m + noise.standard_normal(depth_m.shape) * depth_sigma_m(depth_m)
        depth_m = np.where(depth_m > 0, noisy, 0)
    native: NDArray[np.uint16] = np.rint(depth_m * SCALE).astype(np.uint16)
    return native


def png(gray: NDArray[np.floating]) -> bytes:
    return cv2.imencode(".png", np.clip(np.rint(gray), 0, 255).astype(np.uint8))[1].tobytes()


def levels(maps: FrameMaps) -> list[Level]:
    """All resolutions of a frame, the finest first."""
    return [maps[level] for level in range(len(POINTS))]


def painted(
    surfaces: list[Surface],
    poses: Float64,
    *,
    camera: Camera = SMALL,
    texture: Texture | None = None,
    exposures: list[tuple[float, float]] | None = None,
    noise: np.random.Generator | None = None,
) -> Sequence:
    """A recording of analytic surfaces at known poses (n, 4, 4), 10 Hz; with colour if there is a texture.

    Args:
        surfaces: what there is.
        poses: `T_world_camera`.
        camera: of both images.
        texture: of all surfaces.
        exposures: gain and offset of each image.
        noise: draws the depth's noise; None: exact.
    """
    depths = [depth_of(surfaces, camera, T) for T in poses]
    color: list[bytes | None] = [None] * len(poses)
    if texture is not None:
        gains = exposures or [(1.0, 0.0)] * len(poses)
        color = [
            png(gain * texture(transform_points(T, camera.backproject(depth))) + offset)
            for T, depth, (gain, offset) in zip(poses, depths, gains, strict=True)
        ]
    stamps_ns = np.arange(len(poses), dtype=np.int64) * 10**8
    frames = PaintedFrames([native(depth, noise) for depth in depths], color)
    return Sequence(camera, SCALE, stamps_ns, texture is not None, None, frames)


def orbit(name: str, frames: int, arc_rad: float, *, seed: int = 0, **changed: dict[str, Any]) -> Furniture:
    """A simulated walk around a piece of furniture, 320 x 240; sections of the spec can be changed."""
    spec = small_spec(name, frames, seed=seed, arc_rad=arc_rad)
    for section, values in changed.items():
        spec = spec.model_copy(update={section: getattr(spec, section).model_copy(update=values)})
    return furniture(spec)


TINY = {"width": 160, "height": 120, "model": "ideal", "distortion": 0.0}


@cache
def couch() -> Furniture:
    """A sixth of a circle around a couch in 24 frames, with noise."""
    return orbit("couch:seed=4", 24, 1.2)


@cache
def chair_circle() -> Furniture:
    """A full circle around a chair and a bit more, 160 x 120, 48 frames."""
    return orbit("chair:seed=3", 48, 2.2 * np.pi, sensor=TINY)


@cache
def noisy_circle() -> Furniture:
    """A full circle around a chair and a bit more, with noise, 48 frames."""
    return orbit("chair:seed=3", 48, 2.2 * np.pi)


def frame_maps(sequence: Sequence, index: int) -> FrameMaps:
    """What registration knows of one frame of a recording."""
    return MapCache(sequence)[index]


def moved_pair() -> tuple[FrameMaps, FrameMaps]:
    """Two noisy, textured views of a room's corner, a small motion apart; the second is exposed otherwise."""
    sequence = painted(
        ROOM,
        np.stack([CORNER_VIEW, MOVED]),
        texture=waves,
        exposures=[(1.0, 0.0), (0.9, 12.0)],
        noise=np.random.default_rng(3),
    )
    return frame_maps(sequence, 0), frame_maps(sequence, 1)


def without_color(sequence: Sequence) -> Sequence:
    return replace(sequence, color_registered=False)


def stored(sequence: Sequence, index: int) -> tuple[NDArray[np.uint16], bytes | None]:
    encoded = sequence.frames.color_encoded(index)
    return sequence.frames.depth_native(index), None if encoded is None else encoded[1]


def made_of(sequence: Sequence, frames: list[tuple[NDArray[np.uint16], bytes | None]]) -> Sequence:
    """Other frames in place of a recording's, at its rate, without a given trajectory."""
    step_ns = int(sequence.stamps_ns[1] - sequence.stamps_ns[0])
    stamps_ns = sequence.stamps_ns[0] + step_ns * np.arange(len(frames), dtype=np.int64)
    held = PaintedFrames([depth for depth, _ in frames], [color for _, color in frames])
    return replace(sequence, frames=held, stamps_ns=stamps_ns, given_trajectory=None)


def with_frames(sequence: Sequence, order: Iterable[int]) -> Sequence:
    """Frames of a recording in another order, repeated, or with some missing."""
    return made_of(sequence, [stored(sequence, int(i)) for i in order])


def with_depth(sequence: Sequence, depth: dict[int, NDArray[np.uint16]]) -> Sequence:
    """A recording with the depth of some frames replaced."""
    frames = [stored(sequence, i) for i in range(len(sequence))]
    return made_of(sequence, [(depth.get(i, frame[0]), frame[1]) for i, frame in enumerate(frames)])


def with_blank_color(sequence: Sequence, missing: Iterable[int]) -> Sequence:
    """A recording without the colour images of some frames."""
    frames, gone = [stored(sequence, i) for i in range(len(sequence))], set(missing)
    return made_of(
        sequence, [(depth, None if i in gone else color) for i, (depth, color) in enumerate(frames)]
    )


def spliced(*parts: tuple[Sequence, Iterable[int]]) -> Sequence:
    """Chosen frames of several recordings of one camera, one after the other."""
    return made_of(parts[0][0], [stored(sequence, int(i)) for sequence, chosen in parts for i in chosen])


def walk(n: int, arc_rad: float, *, target: tuple[float, float, float] = (0.0, 0.0, 0.15)) -> Float64:
    """(n, 4, 4): from `CORNER_VIEW` some way around the target, a metre and a half away."""
    turns = np.arctan2(0.9, 1.1) + np.linspace(-arc_rad / 2, arc_rad / 2, n)
    places = np.stack([1.42 * np.cos(turns), 1.42 * np.sin(turns), 0.9 + 0.1 * np.sin(5 * turns)], axis=1)
    return np.stack([look_at(place, np.array(target)) for place in places])


def errors_m(T_found: Float64, T_true: Float64) -> Float64:
    """(n,) how far each camera is from its true place once both worlds are aligned; NaN where it is lost."""
    good = np.isfinite(T_found).all(axis=(1, 2))
    T_true_found = align_positions(T_found[good, :3, 3], T_true[good, :3, 3])
    errors = np.full(len(T_found), np.nan)
    errors[good] = np.linalg.norm((T_true_found @ T_found[good])[:, :3, 3] - T_true[good, :3, 3], axis=1)
    return errors


def tie_at(
    a: int,
    b: int,
    T_a_b: np.ndarray,
    information: np.ndarray,
    kind: ConstraintKind,
    overlap: float = 0.8,
    inlier_share: float = 0.99,
    residual_m: float = 0.002,
    weight: float = 1.0,
) -> Constraint:
    """A constraint with the figures that the pose graph and health.json use; the others are NaN."""
    unknown = dict.fromkeys(("noise_m", "signal_to_noise", "sigma_m", "intensity_correlation"), np.nan)
    found = Registration(T_a_b, information, overlap, inlier_share, residual_m, **unknown)
    return Constraint(a, b, found, kind, weight)
