"""Estimate the readout time of a rolling shutter from pairs of frames with different motion.

No format states the readout time, and colour may be delayed relative to depth. Frames with the same motion
are distorted equally and fit each other. Frames with different motions fit only if the rolling shutter is
undone with the correct time.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from kinectbench.core.even_choice import evenly
from kinectbench.core.geometry import invert_rigid
from kinectbench.core.geometry.rolling_shutter import RollingShutter, motions
from kinectbench.core.types import Float64
from kinectbench.stages.track.frame_maps import FrameMaps, MapCache
from kinectbench.stages.track.odometry import Followed, Odometry
from kinectbench.stages.track.registration import Registration, measure, register

# A pair of frames is informative if its image flow differs by this much: the outermost rows of a Kinect are
# then 4.5 mrad off, one pixel at working resolution. No pair of simulated slow orbits (0.4 to 0.8 m/s) is
# informative, and one of 150 in a recording that pans over a room.
INFORMATIVE_RAD_PER_S = 0.3
# Minimum number and ratio of informative frames (for one jolt the odometry is not repeated); pairs to use.
MIN_INFORMATIVE, MIN_INFORMATIVE_RATIO, PAIRS = 16, 0.05, 12
# Image positions at which flow is evaluated: x and y at z = 1.
FLOW_AT = np.array([(x, y, 1.0) for x in (-0.3, 0.0, 0.3) for y in (-0.25, 0.0, 0.25)])
# Number of frames for the median depth, which turns motion into flow.
DEPTH_FRAMES = 8
# The first readout to try, the step, and the number of steps. A readout is at most the frame interval, 1/30
# s.
FIRST_TRIED_S, STEP_S, MOST_STEPS = 0.03, 0.01, 4
# Images of at least twice this width are halved: for pairs of a simulated Kinect the readout is still within
# 4 ms and the delay within 2.5 ms.
ENOUGH_PX = 140
# A shutter is undone if it lowers the misfit by this ratio, compared with no shutter and with the opposite
# shutter, which smooths depth equally. Measured: 3 % for a slow pan over a real room, 18 % for TUM fr1_xyz,
# 60 to 75 % for simulated turns of 150 degrees a second.
MIN_GAIN = 0.1
# Misfit of a point that disagrees; inliers are within three standard deviations.
OUTLIER = 9.0


@dataclass(frozen=True)
class _Pair:
    source: int
    target: int
    T_target_source: Float64


def find_shutter(maps: MapCache, odometry: Odometry) -> RollingShutter | None:
    """Estimate the readout time of the rolling shutter and the delay of colour.

    The result is None if too few frames differ enough in motion from their keyframe, or if both times are 0.
    No shutter is undone in the maps.
    """
    motion = motions_of(odometry.frames, maps.sequence.stamps_ns / 1e9)
    pairs = _informative_pairs(maps, odometry, motion)
    if not pairs:
        return None
    search = _Search(maps, pairs, motion)
    forward, none, backward = (search.misfit(sign * FIRST_TRIED_S) for sign in (1, 0, -1))
    readout_s = 0.0
    if min(forward, backward) < (1 - MIN_GAIN) * min(none, max(forward, backward)):
        readout_s = _least(search.misfit, FIRST_TRIED_S if forward < backward else -FIRST_TRIED_S)
    delay_s = 0.0
    if maps[pairs[0].source].has_intensity:
        delay_s = _least(lambda tried_s: search.dissimilarity(readout_s, tried_s), 0.0)
        if search.dissimilarity(readout_s, delay_s) > (1 - MIN_GAIN) * search.dissimilarity(readout_s, 0.0):
            delay_s = 0.0
    return RollingShutter(readout_s, delay_s, motion) if readout_s or delay_s else None


def motions_of(frames: Sequence[Followed | None], stamps_s: Float64) -> Float64:
    """Return the camera's motion at each frame, (n, 12), from the odometry; see `rolling_shutter.motions`."""
    T = np.array([np.full((4, 4), np.nan) if each is None else each.T_segment_camera for each in frames])
    segment = np.array([-1 if each is None else each.segment for each in frames], np.int64)
    return motions(T.reshape(-1, 4, 4), segment, stamps_s)


def flow_rad_per_s(rates: Float64, depth_m: float) -> Float64:
    """Image flow averaged over the view, (n,) rad/s, from twists per second (n, 6).

    Args:
        rates: (n, 6) twists per second, rad/s and m/s, camera axes.
        depth_m: typical depth of the scene, metres.
    """
    moved = -np.cross(rates[:, None, :3], FLOW_AT) - rates[:, None, 3:6] / depth_m
    through = moved[..., :2] - FLOW_AT[:, :2] * moved[..., 2:]
    return np.asarray(np.linalg.norm(through, axis=2).mean(axis=1))


def _informative_pairs(maps: MapCache, odometry: Odometry, motion: Float64) -> list[_Pair]:
    """Return at most 12 pairs of a frame and its keyframe, chosen for their different motions.

    They are taken evenly from the informative frames with the larger differences in image flow. The result is
    [] if too few frames are informative. `motion` is (n, 12), as from `motions_of`.
    """
    frames = odometry.frames
    homes = np.array([index if frame is None else frame.keyframe for index, frame in enumerate(frames)])
    chosen_frames = evenly(len(frames), DEPTH_FRAMES).tolist()
    depths_m = [float(np.median(maps[k][0].points[:, 2])) for k in chosen_frames if frames[k] is not None]
    if not depths_m:
        return []
    differ = flow_rad_per_s(motion[:, :6] - motion[homes, :6], float(np.median(depths_m)))
    informative = np.flatnonzero(differ > INFORMATIVE_RAD_PER_S)
    if len(informative) < max(MIN_INFORMATIVE, MIN_INFORMATIVE_RATIO * len(frames)):
        return []
    informative = informative[differ[informative] >= np.median(differ[informative])]
    chosen = informative[evenly(len(informative), PAIRS)]
    pairs = []
    for index in chosen.tolist():
        frame, home = frames[index], frames[homes[index]]
        assert frame is not None and home is not None
        T_home_camera = invert_rigid(home.T_segment_camera) @ frame.T_segment_camera
        pairs.append(_Pair(index, frame.keyframe, T_home_camera))
    return pairs


class _Search:
    """Undoes a rolling shutter and measures how well pairs of frames then fit; large images are halved."""

    def __init__(self, maps: MapCache, pairs: Sequence[_Pair], motion: Float64) -> None:
        self.maps, self.pairs, self.motion = maps, pairs, motion
        self.found: dict[float, list[Registration]] = {}

    def misfit(self, readout_s: float) -> float:
        """Return the mean square of residual / noise at each pair's best pose; an outlier counts as 9."""
        fits = self._registered(readout_s)
        squares = [  # without inliers both are 0
            r.inlier_share * (r.residual_m / (r.noise_m or 1.0)) ** 2 + OUTLIER * (1 - r.inlier_share)
            for r in fits
        ]
        return float(np.mean(squares))

    def dissimilarity(self, readout_s: float, delay_s: float) -> float:
        """Return 1 - mean intensity correlation at the poses that fit the depth best; 1 if unknown."""
        correlations = [
            measure(
                *self._maps(pair, readout_s, delay_s, with_intensity=True), [r.T_target_source]
            ).intensity_correlation
            for pair, r in zip(self.pairs, self._registered(readout_s), strict=True)
        ]
        known = [each for each in correlations if np.isfinite(each)]
        return 1 - float(np.mean(known)) if known else 1.0

    def _registered(self, readout_s: float) -> list[Registration]:
        if readout_s not in self.found:
            self.found[readout_s] = [
                register(*self._maps(pair, readout_s, 0.0, with_intensity=False), [pair.T_target_source], 1)
                for pair in self.pairs
            ]
        return self.found[readout_s]

    def _maps(
        self, pair: _Pair, readout_s: float, delay_s: float, *, with_intensity: bool
    ) -> tuple[FrameMaps, list[FrameMaps]]:
        """Return the maps of a pair's source, and a list of those of its target, with this shutter undone."""
        shutter = RollingShutter(readout_s, delay_s, self.motion)
        source, target = (
            self.maps.upright(k, shutter).reduced(ENOUGH_PX, with_intensity=with_intensity)
            for k in (pair.source, pair.target)
        )
        return source, [target]


def _least(value_at: Callable[[float], float], start_s: float) -> float:
    """Return the time (s) with the smallest value: descend in 10 ms steps, then fit a parabola."""
    values: dict[int, float] = {}

    def at(step: int) -> float:
        if step not in values:
            values[step] = value_at(round(step * STEP_S, 9))
        return values[step]

    best = round(start_s / STEP_S)
    while abs(best) < MOST_STEPS and min(at(best - 1), at(best + 1)) < at(best):
        best += 1 if at(best + 1) < at(best - 1) else -1
    if abs(best) == MOST_STEPS:
        return best * STEP_S
    before, least, after = at(best - 1), at(best), at(best + 1)
    bend = before - 2 * least + after
    return STEP_S * (best + (0.5 * (before - after) / bend if bend > 0 else 0.0))
