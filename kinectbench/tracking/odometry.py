"""Follow the camera from frame to frame: each frame is registered to a keyframe.

A frame that fits no keyframe at hand begins a new segment, with a world of its own; loop closure may join the
segments later. Nothing is guessed.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import invert_rigid, rotation_angle_rad
from kinectbench.tracking.depth_average import DepthAverage
from kinectbench.tracking.features import FeatureCache, pose_from_features
from kinectbench.tracking.frame_maps import FrameMaps, MapCache
from kinectbench.tracking.registration import Registration, measure, register
from kinectbench.tracking.search import score, search
from kinectbench.tracking.tracked import Tie
from kinectbench.tracking.twist import on_so3, rigid_from_twist, twist_from_rigid

Float64 = NDArray[np.float64]

# A frame with fewer points (of some 19000) shows nothing to register.
MIN_POINTS = 400
# Believed at once: as good as the frames before, but for so much less.
SURE_OVERLAP, UNUSUAL_INLIERS, UNUSUAL_CORRELATION = 0.4, 0.008, 0.03
# Believed after a search: as good as the frames before but for this, or of nearly the same view (something in
# it may have moved); and at least so good.
MUCH_FEWER_INLIERS, SAME_VIEW = 0.03, 0.7
ENOUGH_INLIERS, ENOUGH_OVERLAP, ENOUGH_CORRELATION = 0.9, 0.25, 0.3
# The next keyframe.
KEYFRAME_OVERLAP, KEYFRAME_TURN_RAD, KEYFRAME_SHIFT = 0.7, 0.26, 0.2
RECENT_SEGMENTS = 3
# Frames before a keyframe that its depth is averaged with; those after it are too, up to the next one.
FRAMES_BEFORE = 5
NO_DEPTH = "too little depth to register"
OPEN_MOTION = "one plane in view: a motion is left open"
# A frame is compared with itself to see whether all it shows is one plane: few points tell. Its normals then
# say no more than so many times what their noise does.
EVERY_ALONE, ONE_PLANE = 4, 1.2
# Texture holds what few points leave open.
EVERY_WITH_COLOR, EVERY_WITHOUT = 3, 1


@dataclass(frozen=True)
class Followed:
    """One frame of a segment.

    Attributes:
        segment: which.
        keyframe: frame index of the keyframe it was registered to; its own for a keyframe.
        T_segment_camera: (4, 4).
        registration: to the keyframe; None for the first frame of a segment.
    """

    segment: int
    keyframe: int
    T_segment_camera: Float64
    registration: Registration | None


@dataclass(frozen=True)
class Odometry:
    """All frames, followed as far as they can be.

    Attributes:
        frames: per frame; None: it shows too little to register.
        reasons: why, by frame.
        keyframes: frame indices, ascending.
        ties: between consecutive keyframes of a segment.
    """

    frames: tuple[Followed | None, ...]
    reasons: dict[int, str]
    keyframes: tuple[int, ...]
    ties: tuple[Tie, ...]


@dataclass(frozen=True)
class Usual:
    """What a right registration of this recording looks like: running means."""

    inlier_share: float
    correlation: float

    def after(self, registration: Registration) -> "Usual":
        """With one more registration that is believed."""
        correlation = registration.intensity_correlation
        known = self.correlation if np.isnan(correlation) else correlation
        return Usual(
            0.9 * self.inlier_share + 0.1 * registration.inlier_share, 0.9 * self.correlation + 0.1 * known
        )

    def is_possible(self, registration: Registration) -> bool:
        """Whether a registration is believable and not much worse than usual."""
        usual = registration.inlier_share >= self.inlier_share - MUCH_FEWER_INLIERS
        return (usual or registration.overlap >= SAME_VIEW) and is_believable(registration)

    def is_sure(self, registration: Registration) -> bool:
        """Whether a registration is as good as usual, or nearly."""
        return (
            registration.inlier_share >= self.inlier_share - UNUSUAL_INLIERS
            and registration.overlap >= SURE_OVERLAP
            and not registration.intensity_correlation < self.correlation - UNUSUAL_CORRELATION
        )


# Before anything is known much is asked: a first frame that is wrong would be followed by others.
AT_FIRST = Usual(0.99, 0.99)


def usual_of(registrations: Sequence[Registration]) -> Usual:
    """The median of registrations that are believed."""
    correlations = [r.intensity_correlation for r in registrations if np.isfinite(r.intensity_correlation)]
    if not registrations:
        return AT_FIRST
    return Usual(
        float(np.median([r.inlier_share for r in registrations])),
        float(np.median(correlations)) if correlations else AT_FIRST.correlation,
    )


def follow(
    maps: MapCache,
    features: FeatureCache,
    T_given: Float64 | None = None,
    progress: Callable[[int], None] | None = None,
) -> Odometry:
    """Register every frame of a sequence to the keyframes before it.

    Args:
        maps: of the frames.
        features: of the frames.
        T_given: (n, 4, 4) poses to start the registrations from, NaN where there is none; or None.
        progress: called with the number of frames done.
    """
    frames: list[Followed | None] = []
    reasons: dict[int, str] = {}
    keyframes: list[int] = []
    ties: list[Tie] = []
    usual = AT_FIRST
    average: DepthAverage | None = None
    for index in range(len(maps.sequence)):
        found: Followed | None = None
        too_little = _too_little(maps[index])
        if too_little is not None:
            reasons[index] = too_little
        else:
            for reference in _references(frames, index):
                tried = _register(maps, features, frames, reference, index, T_given, usual)
                if tried is not None:
                    found = tried
                    break
            if found is None:
                segment = 1 + max((f.segment for f in frames if f is not None), default=-1)
                found = Followed(segment, index, np.eye(4), None)
            elif found.registration is not None:
                usual = usual.after(found.registration)
                if _is_keyframe(found.registration, maps[index]):
                    ties.append(tie(found.keyframe, index, found.registration, "odometry"))
                    found = replace(found, keyframe=index)
            if found.keyframe == index:
                if average is not None:
                    maps.improve(keyframes[-1], average.stored())
                keyframes.append(index)
                average = _begun_average(maps, frames, index, found)
            elif average is not None and found.keyframe == keyframes[-1] and found.registration is not None:
                average.add(maps[index].levels[0], found.registration.T_target_source)
        frames.append(found)
        if progress:
            progress(index + 1)
    if average is not None:
        maps.improve(keyframes[-1], average.stored())
    return Odometry(tuple(frames), reasons, tuple(keyframes), tuple(ties))


def _too_little(maps: FrameMaps) -> str | None:
    """Why a frame cannot be registered to anything; None if it can."""
    if len(maps.levels[0].points) < MIN_POINTS:
        return NO_DEPTH
    alone = measure(maps, [maps], [np.eye(4)], EVERY_ALONE)
    return OPEN_MOTION if alone.degenerate and alone.over_noise < ONE_PLANE else None


def _begun_average(
    maps: MapCache, frames: list[Followed | None], index: int, keyframe: Followed
) -> DepthAverage:
    """The average of a new keyframe's depth, with the frames just before it."""
    average = DepthAverage(maps[index].levels[0])
    for before in range(max(0, index - FRAMES_BEFORE), index):
        frame = frames[before]
        if frame is not None and frame.segment == keyframe.segment:
            T_keyframe_frame = invert_rigid(keyframe.T_segment_camera) @ frame.T_segment_camera
            average.add(maps[before].levels[0], T_keyframe_frame)
    return average


def every_of(source: FrameMaps) -> int:
    """Every how many points of a frame are enough to register it."""
    return EVERY_WITH_COLOR if source.has_intensity else EVERY_WITHOUT


def tie(a: int, b: int, registration: Registration, kind: str) -> Tie:
    """The registration of keyframe b to keyframe a as a tie."""
    return Tie(
        a,
        b,
        registration.T_target_source,
        registration.information,
        kind,  # type: ignore[arg-type]
        registration.overlap,
        registration.inlier_share,
        registration.residual_m,
    )


def is_believable(registration: Registration) -> bool:
    """Whether two frames show the same place where the registration says so."""
    correlation = registration.intensity_correlation
    return (
        registration.inlier_share >= ENOUGH_INLIERS
        and registration.overlap >= ENOUGH_OVERLAP
        and not correlation < ENOUGH_CORRELATION
        and not registration.degenerate
    )


def _references(frames: list[Followed | None], index: int) -> list[int]:
    """Frames to register to: the last one's keyframe, itself, then the last frames of the segments before."""
    references: list[int] = []
    segments: list[int] = []
    for back in range(index - 1, max(-1, index - 200), -1):
        frame = frames[back]
        if frame is None or frame.segment in segments:
            continue
        references += [frame.keyframe] if not segments or back == frame.keyframe else [frame.keyframe, back]
        if not segments and back != frame.keyframe:
            references.append(back)
        segments.append(frame.segment)
        if len(segments) == RECENT_SEGMENTS:
            break
    return references


def _register(
    maps: MapCache,
    features: FeatureCache,
    frames: list[Followed | None],
    reference: int,
    index: int,
    T_given: Float64 | None,
    usual: Usual,
) -> Followed | None:
    """Register a frame to a reference: from the prediction, and if that does not convince, from elsewhere."""
    source, target = maps[index], maps[reference]
    every = every_of(source)
    before = frames[reference]
    assert before is not None
    starts = _predictions(frames, before, reference, index, maps.sequence.stamps_ns, T_given)
    best: Registration | None = None
    for T_start, coarsest in itertools.product(starts, (1, 2)):
        best = _better(best, register(source, [target], [T_start], coarsest, every=every))
        if usual.is_sure(best):
            break
    else:
        seen = pose_from_features(features[index], features[reference], source.levels[0].camera)
        if seen is not None:
            best = _better(best, register(source, [target], [seen[0]], coarsest=1, every=every))
        if best is None or not usual.is_sure(best):
            best = _better(best, search(source, target, starts[0]))
    if best is None or not usual.is_possible(best):
        return None
    T_segment_camera = on_so3(before.T_segment_camera @ best.T_target_source)
    keyframe = frames[before.keyframe]
    assert keyframe is not None
    # The reference may be a frame beside the keyframe: what counts is how the frame lies to the keyframe.
    T_keyframe_camera = on_so3(invert_rigid(keyframe.T_segment_camera) @ T_segment_camera)
    registration = replace(best, T_target_source=T_keyframe_camera)
    return Followed(before.segment, before.keyframe, T_segment_camera, registration)


def _better(best: Registration | None, other: Registration) -> Registration:
    return other if best is None or score(other) > score(best) else best


def _predictions(
    frames: list[Followed | None],
    reference_frame: Followed,
    reference: int,
    index: int,
    stamps_ns: NDArray[np.int64],
    T_given: Float64 | None,
) -> list[Float64]:
    """T_reference_camera, the likeliest first: as given, with constant velocity, standing still."""
    predictions = []
    if T_given is not None and np.isfinite(T_given[[reference, index]]).all():
        predictions.append(invert_rigid(T_given[reference]) @ T_given[index])
    last, before = (frames[index - k] if index >= k else None for k in (1, 2))
    T_reference_segment = invert_rigid(reference_frame.T_segment_camera)
    if last is not None and last.segment == reference_frame.segment:
        T_reference_last = T_reference_segment @ last.T_segment_camera
        if before is not None and before.segment == last.segment:
            moved = invert_rigid(before.T_segment_camera) @ last.T_segment_camera
            ratio = (stamps_ns[index] - stamps_ns[index - 1]) / (stamps_ns[index - 1] - stamps_ns[index - 2])
            if 0.3 < ratio < 3:
                predictions.append(
                    T_reference_last @ rigid_from_twist(float(ratio) * twist_from_rigid(moved))
                )
        predictions.append(T_reference_last)
    return predictions or [np.eye(4)]


def _is_keyframe(registration: Registration, maps: FrameMaps) -> bool:
    """Whether a frame has moved so far from its keyframe that it becomes the next one."""
    T = registration.T_target_source
    depth_m = float(np.median(maps.levels[0].points[:, 2]))
    return bool(
        registration.overlap < KEYFRAME_OVERLAP
        or rotation_angle_rad(T[:3, :3]) > KEYFRAME_TURN_RAD
        or np.linalg.norm(T[:3, 3]) > KEYFRAME_SHIFT * depth_m
    )
