"""Odometry: follow the camera from frame to frame by registering each frame to a keyframe.

A frame that fits no recent keyframe starts a new segment with its own world. Loop closures may join segments
later. No pose is guessed.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kinectbench.core.geometry import (
    DepthCalibration,
    invert_rigid,
    on_so3,
    rigid_from_twist,
    rotation_angle_rad,
    twist_from_rigid,
)
from kinectbench.core.threads import ahead
from kinectbench.core.types import Float64
from kinectbench.stages.track.features import FeatureCache, pose_from_features
from kinectbench.stages.track.frame_maps import DepthAverage, FrameMaps, MapCache
from kinectbench.stages.track.registration import Registration, better, measure, register, search
from kinectbench.stages.track.tracked import Constraint

# A frame with fewer points (of about 19000) cannot be registered.
MIN_POINTS = 400
# A registration is accepted without a search with at least this overlap, and at most these margins below the
# reference quality.
REFERENCE_OVERLAP, INLIER_SLACK, CORRELATION_SLACK = 0.4, 0.008, 0.03
# It is accepted after a search with at most this margin below the reference quality, or with an overlap of at
# least SAME_VIEW (something in view may have moved).
MUCH_FEWER_INLIERS, SAME_VIEW = 0.03, 0.7
# Smallest inlier ratio, overlap and intensity correlation of any accepted registration.
ENOUGH_INLIERS, ENOUGH_OVERLAP, ENOUGH_CORRELATION = 0.9, 0.25, 0.3
# A frame becomes the next keyframe below this overlap, or beyond this turn or shift (ratio of the depth).
KEYFRAME_OVERLAP, KEYFRAME_TURN_RAD, KEYFRAME_SHIFT = 0.7, 0.26, 0.2
# Weights of the reference quality and of a new registration in their mean: it is over some ten frames.
KEPT, ADDED = 0.9, 0.1
# The last motion predicts the next one if the ratio of the two times between frames lies between these.
MIN_STEP_RATIO, MAX_STEP_RATIO = 0.3, 3.0
# A frame is registered to the latest RECENT_SEGMENTS segments, unless they ended longer ago than both limits:
# a symmetric object also fits itself elsewhere, and one registration is no proof. Of 36 simulated scans,
# three were joined by one registration after 4 s (13 frames) and more, and two of these are 0.8 m off. Stamps
# may count frames as seconds.
RECENT_SEGMENTS, RECENT_FRAMES, RECENT_S = 3, 6, 2.0
# A keyframe's depth is averaged with this many previous frames, and with all frames up to the next keyframe.
FRAMES_BEFORE = 5
NO_DEPTH = "too little depth to register"
UNOBSERVABLE = "one plane in view: a motion is left open"
# To detect a view of a single plane, a frame is compared with itself, on every fourth point: the
# signal-to-noise ratio of the normals is then below this.
EVERY_ALONE, ONE_PLANE = 4, 1.2
# With texture fewer points suffice, because intensity constrains the remaining directions.
EVERY_WITH_COLOR, EVERY_WITHOUT = 3, 1


@dataclass(frozen=True)
class Followed:
    """The odometry of one frame.

    Attributes:
        segment: index of the frame's segment.
        keyframe: frame index of the keyframe it was registered to; a keyframe has its own index.
        T_segment_camera: (4, 4), pose in the segment's world.
        registration: registration to its keyframe; if the frame is a keyframe, to the previous keyframe; None
            for the first frame of a segment.
    """

    segment: int
    keyframe: int
    T_segment_camera: Float64
    registration: Registration | None


@dataclass(frozen=True)
class Odometry:
    """The odometry of all frames.

    Attributes:
        frames: the odometry of each frame; None if its depth cannot be registered.
        reasons: why a frame has no odometry, by frame.
        keyframes: frame indices of the keyframes, ascending.
        constraints: constraints between consecutive keyframes of a segment.
    """

    frames: tuple[Followed | None, ...]
    reasons: dict[int, str]
    keyframes: tuple[int, ...]
    constraints: tuple[Constraint, ...]


@dataclass(frozen=True)
class ReferenceQuality:
    """The usual quality of registrations: running means of inlier ratio and intensity correlation."""

    inlier_share: float
    correlation: float

    def after(self, registration: Registration) -> "ReferenceQuality":
        """Return the running means after another accepted registration."""
        correlation = registration.intensity_correlation
        known = self.correlation if np.isnan(correlation) else correlation
        return ReferenceQuality(
            KEPT * self.inlier_share + ADDED * registration.inlier_share,
            KEPT * self.correlation + ADDED * known,
        )

    def is_possible(self, registration: Registration) -> bool:
        """Whether a registration is accepted and has 70 % overlap or nearly the mean inlier ratio."""
        reference = registration.inlier_share >= self.inlier_share - MUCH_FEWER_INLIERS
        return (reference or registration.overlap >= SAME_VIEW) and is_accepted(registration)

    def meets_reference(self, registration: Registration) -> bool:
        """Whether a registration reaches both means, less small margins, and overlaps by at least 40 %."""
        return (
            registration.inlier_share >= self.inlier_share - INLIER_SLACK
            and registration.overlap >= REFERENCE_OVERLAP
            and not registration.intensity_correlation < self.correlation - CORRELATION_SLACK
        )


# The initial reference is strict, because errors of a wrong first frame would spread to the next frames.
INITIAL_QUALITY = ReferenceQuality(0.99, 0.99)


def median_quality(registrations: Sequence[Registration]) -> ReferenceQuality:
    """Return the median quality of accepted registrations; `INITIAL_QUALITY` if there are none."""
    correlations = [r.intensity_correlation for r in registrations if np.isfinite(r.intensity_correlation)]
    if not registrations:
        return INITIAL_QUALITY
    return ReferenceQuality(
        float(np.median([r.inlier_share for r in registrations])),
        float(np.median(correlations)) if correlations else INITIAL_QUALITY.correlation,
    )


def follow(maps: MapCache, features: FeatureCache, T_given: Float64 | None = None) -> Odometry:
    """Register every frame of a sequence to the previous keyframe, else to other recent frames.

    `T_given` (n, 4, 4) are initial poses for the registrations, NaN where unknown; or None.
    """
    return Follower(maps, features, T_given).to_the_end()


class Follower:
    """Builds the odometry frame by frame; a pickled copy continues elsewhere with the same result.

    `frames` is the odometry of the frames taken so far.
    """

    def __init__(self, maps: MapCache, features: FeatureCache, T_given: Float64 | None = None) -> None:
        """Start without any frame; the arguments are those of `follow`."""
        self.maps, self.features, self.T_given = maps, features, T_given
        self.frames: list[Followed | None] = []
        self.reasons: dict[int, str] = {}
        self.keyframes: list[int] = []
        self.constraints: list[Constraint] = []
        self.reference = INITIAL_QUALITY
        self.average: DepthAverage | None = None

    def take(self, index: int) -> None:
        """Register the next frame, whose index is the number of frames taken so far."""
        self._take(index, self._too_little(index))

    def _too_little(self, index: int) -> str | None:
        """Compute a frame's maps; return why it cannot be registered to any other; None if it can."""
        return _too_little(self.maps[index])

    def _take(self, index: int, reason: str | None) -> None:
        if reason is not None:
            self.reasons[index] = reason
            self.frames.append(None)
            return
        tried = (self._register(reference, index) for reference in self._references(index))
        followed = next((each for each in tried if each is not None), None)
        frame = self._first_of_segment(index) if followed is None else self._accepted(index, followed)
        if frame.keyframe == index:
            self._begin_keyframe(index, frame)
        elif self.average is not None and frame.keyframe == self.keyframes[-1] and frame.registration:
            self.average.add(self.maps[index][0], frame.registration.T_target_source)
        self.frames.append(frame)

    def to_the_end(self, progress: Callable[[int], None] | None = None) -> Odometry:
        """Take the remaining frames, and return the odometry of all frames."""
        # Frames that are not taken yet have no averaged depth: threads may prepare their maps.
        remaining = range(len(self.frames), len(self.maps.sequence))
        for index, reason in zip(remaining, ahead(self._too_little, remaining), strict=True):
            self._take(index, reason)
            if progress:
                progress(index + 1)
        return self.so_far()

    def so_far(self) -> Odometry:
        """Return the odometry so far; give the maps the last keyframe's depth, averaged up to now."""
        self._end_average()
        frames, keyframes = tuple(self.frames), tuple(self.keyframes)
        return Odometry(frames, dict(self.reasons), keyframes, tuple(self.constraints))

    def calibrate(self, calibration: DepthCalibration) -> None:
        """Correct depth from now on; the averaging of the last keyframe's depth ends."""
        self._end_average()
        self.average = None
        self.maps.calibrate(calibration)

    def _first_of_segment(self, index: int) -> Followed:
        """Make a frame that fits no previous frame the first keyframe of a new segment."""
        segment = 1 + max((f.segment for f in self.frames if f is not None), default=-1)
        return Followed(segment, index, np.eye(4), None)

    def _accepted(self, index: int, followed: Followed) -> Followed:
        """Accept a registered frame; make it a keyframe if far from its keyframe or overlapping it little."""
        assert followed.registration is not None
        self.reference = self.reference.after(followed.registration)
        if not is_keyframe(followed.registration, self.maps[index]):
            return followed
        self.constraints.append(Constraint(followed.keyframe, index, followed.registration, "odometry"))
        return replace(followed, keyframe=index)

    def _begin_keyframe(self, index: int, keyframe: Followed) -> None:
        """Start averaging the new keyframe's depth, with the frames just before it."""
        self._end_average()
        self.keyframes.append(index)
        self.average = DepthAverage(self.maps[index][0])
        for before in range(max(0, index - FRAMES_BEFORE), index):
            frame = self.frames[before]
            if frame is not None and frame.segment == keyframe.segment:
                T_keyframe_frame = invert_rigid(keyframe.T_segment_camera) @ frame.T_segment_camera
                self.average.add(self.maps[before][0], T_keyframe_frame)

    def _end_average(self) -> None:
        if self.average is not None:
            self.maps.improve(self.keyframes[-1], self.average.stored())

    def _references(self, index: int) -> list[int]:
        """Return frames to try as reference: the last keyframe and the last frame of each recent segment."""
        references: list[int] = []
        segments: list[int] = []
        stamps_ns = self.maps.sequence.stamps_ns
        for back in range(index - 1, -1, -1):
            if index - back > RECENT_FRAMES and stamps_ns[index] - stamps_ns[back] > 1e9 * RECENT_S:
                break
            frame = self.frames[back]
            if frame is None or frame.segment in segments:
                continue
            references += [frame.keyframe] if back == frame.keyframe else [frame.keyframe, back]
            segments.append(frame.segment)
            if len(segments) == RECENT_SEGMENTS:
                break
        return references

    def _register(self, reference: int, index: int) -> Followed | None:
        """Register a frame to a reference from predicted poses, else by a search; None if it does not fit."""
        source, target, before = self.maps[index], self.maps[reference], self._followed(reference)
        every = point_stride(source)
        starts = self._predictions(reference, index)
        best: Registration | None = None
        for T_start, coarsest in itertools.product(starts, (1, 2)):
            best = better(best, register(source, [target], [T_start], coarsest, every=every))
            if self.reference.meets_reference(best):
                break
        else:
            seen = pose_from_features(self.features[index], self.features[reference], source[0].camera)
            if seen is not None:
                best = better(best, register(source, [target], [seen[0]], coarsest=1, every=every))
            if best is None or not self.reference.meets_reference(best):
                best = better(best, search(source, target, starts[0]))
        if best is None or not self.reference.is_possible(best):
            return None
        T_segment_camera = on_so3(before.T_segment_camera @ best.T_target_source)
        # The reference may not be a keyframe; the pose is stored relative to the reference's keyframe.
        keyframe = self._followed(before.keyframe)
        T_keyframe_camera = on_so3(invert_rigid(keyframe.T_segment_camera) @ T_segment_camera)
        registration = replace(best, T_target_source=T_keyframe_camera)
        return Followed(before.segment, before.keyframe, T_segment_camera, registration)

    def _predictions(self, reference: int, index: int) -> list[Float64]:
        """Return predicted T_reference_camera, best first: given poses, constant velocity, no motion."""
        predictions = []
        if self.T_given is not None and np.isfinite(self.T_given[[reference, index]]).all():
            predictions.append(invert_rigid(self.T_given[reference]) @ self.T_given[index])
        last, before = (self.frames[index - k] if index >= k else None for k in (1, 2))
        at, stamps_ns = self._followed(reference), self.maps.sequence.stamps_ns
        if last is not None and last.segment == at.segment:
            T_reference_last = invert_rigid(at.T_segment_camera) @ last.T_segment_camera
            if before is not None and before.segment == last.segment:
                moved = invert_rigid(before.T_segment_camera) @ last.T_segment_camera
                elapsed_ns = np.diff(stamps_ns[index - 2 : index + 1])
                ratio = float(elapsed_ns[1] / elapsed_ns[0])
                if MIN_STEP_RATIO < ratio < MAX_STEP_RATIO:
                    predictions.append(T_reference_last @ rigid_from_twist(ratio * twist_from_rigid(moved)))
            predictions.append(T_reference_last)
        return predictions or [np.eye(4)]

    def _followed(self, index: int) -> Followed:
        frame = self.frames[index]
        assert frame is not None
        return frame


def _too_little(maps: FrameMaps) -> str | None:
    """Return why a frame cannot be registered to any other; None if it can."""
    if len(maps[0].points) < MIN_POINTS:
        return NO_DEPTH
    alone = measure(maps, [maps], [np.eye(4)], EVERY_ALONE)
    return UNOBSERVABLE if alone.degenerate and alone.signal_to_noise < ONE_PLANE else None


def point_stride(source: FrameMaps) -> int:
    """Return the stride n of points for registering a frame: every n-th point is enough."""
    return EVERY_WITH_COLOR if source.has_intensity else EVERY_WITHOUT


def is_accepted(registration: Registration) -> bool:
    """Whether a registration is accepted: its quality shows that both frames see the same place."""
    correlation = registration.intensity_correlation
    return (
        registration.inlier_share >= ENOUGH_INLIERS
        and registration.overlap >= ENOUGH_OVERLAP
        and not correlation < ENOUGH_CORRELATION
        and not registration.degenerate
    )


def is_keyframe(registration: Registration, maps: FrameMaps) -> bool:
    """Whether a frame becomes the next keyframe: it moved far from its keyframe, or overlaps it little."""
    T = registration.T_target_source
    depth_m = float(np.median(maps[0].points[:, 2]))
    return bool(
        registration.overlap < KEYFRAME_OVERLAP
        or rotation_angle_rad(T[:3, :3]) > KEYFRAME_TURN_RAD
        or np.linalg.norm(T[:3, 3]) > KEYFRAME_SHIFT * depth_m
    )
