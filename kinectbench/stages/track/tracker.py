"""Camera tracking: the pose of every frame is estimated in four steps.

1. Odometry (`odometry.follow`) registers each frame to a previous keyframe. A frame that fits none
   starts a new segment with its own world.
2. The keyframe graph (`keyframe_graph.build_graph`) registers keyframes that see the same places, joins
   segments, and optimises the keyframes' poses (`pose_graph.optimise`).
3. The placer (`_Placer.place`) registers each frame to several optimised keyframes at once. A frame that
   does not agree with them gets a reason instead of a pose.
4. The smoother (`smoothing.smoothed`) moves each pose within the uncertainty of its registration.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from kinectbench.core.geometry import invert_rigid, on_so3
from kinectbench.core.sequence import Sequence
from kinectbench.core.threads import ahead
from kinectbench.core.trajectory.compare import has_pose
from kinectbench.core.types import Float64, Progress, no_progress
from kinectbench.stages.track.covisibility import keyframe_thumbnail, shared_view
from kinectbench.stages.track.features import FeatureCache
from kinectbench.stages.track.frame_maps import MapCache
from kinectbench.stages.track.keyframe_graph import KeyframeGraph, build_graph
from kinectbench.stages.track.odometry import (
    UNOBSERVABLE,
    Followed,
    Follower,
    Odometry,
    follow,
    is_accepted,
    median_quality,
    point_stride,
)
from kinectbench.stages.track.outliers import OUTLIER_REASON, find_outliers
from kinectbench.stages.track.partial_odometry import partial_odometry_of
from kinectbench.stages.track.registration import PLACED, Registration, better, measure, register, search
from kinectbench.stages.track.shutter_search import find_shutter
from kinectbench.stages.track.smoothing import smoothed
from kinectbench.stages.track.tracked import State, Tracked

# Number of keyframes to register each frame to: its own, and those with the largest shared view.
NEIGHBOURS = 2
NOT_JOINED = "fits no frame before it, and no place seen elsewhere"
# Information of a frame without neighbours, so large that smoothing leaves it in place.
HELD = 1e8 * np.eye(6)
DISAGREES = "its depth does not agree with the keyframes around it"
# A passer-by may fill a keyframe's view: two frames that only fitted such a keyframe were 0.8 and 1.2 m off.
UNSUPPORTED = "the keyframe that it is registered to could not be placed"


def track_frames(
    sequence: Sequence, T_given: Float64 | None = None, progress: Progress | None = None
) -> Tracked:
    """Estimate the pose of every frame.

    Args:
        sequence: the recording.
        T_given: (n, 4, 4) initial poses and weak priors, NaN where unknown. None: the world is defined by the
            first camera of one segment, usually the largest.
        progress: called with (done, total); each frame counts twice.
    """
    n = len(sequence)
    report = progress or no_progress
    follower = None if T_given is not None else partial_odometry_of(sequence)
    if follower is None:
        maps = MapCache(sequence)
        follower = Follower(maps, FeatureCache(maps), T_given)
    maps, features = follower.maps, follower.features
    odometry = follower.to_the_end(lambda done: report(done, 2 * n))
    shutter = find_shutter(maps, odometry)
    if shutter is not None:
        maps.undo_shutter(shutter)
        features = FeatureCache(maps)
        odometry = follow(maps, features, T_given)
    graph = build_graph(maps, features, odometry, T_given)
    return _place(maps, odometry, graph, lambda done: report(n + done, 2 * n))


def _place(
    maps: MapCache, odometry: Odometry, graph: KeyframeGraph, progress: Callable[[int], None]
) -> Tracked:
    """Register every frame to several optimised keyframes at once; drop outliers, and smooth the poses."""
    placer, placed = _Placer(maps, odometry, graph), []
    for index, first in enumerate(ahead(placer.first_try, range(len(maps.sequence)))):
        progress(index + 1)
        placed.append(placer.place(index, first))
    placed = [_supported(placed, odometry, index) for index in range(len(placed))]
    registrations = [each.registration for each in placed]
    measured = [(r.residual_m, r.noise_m, r.inlier_share) if r else (np.nan,) * 3 for r in registrations]
    residual_m, noise_m, inlier_share = np.array(measured).T
    information = np.array([r.information if r else HELD for r in registrations])
    poses = np.array([each.T_world_camera for each in placed])
    accepted = np.array([each.reason is None for each in placed])
    odd = accepted & find_outliers(residual_m / noise_m, accepted)
    placed = [replace(each, reason=OUTLIER_REASON) if odd[k] else each for k, each in enumerate(placed)]
    posed = accepted & ~odd
    poses[~posed] = np.nan
    poses[posed] = smoothed(poses[posed], maps.sequence.stamps_ns[posed], information[posed])
    return Tracked(
        T_world_camera=poses,
        states=tuple(each.state if each.reason is None else "lost" for each in placed),
        reasons={index: each.reason for index, each in enumerate(placed) if each.reason is not None},
        keyframes=np.array(graph.keyframes, np.int64)[has_pose(graph.T_world)],
        constraints=graph.constraints,
        refused=graph.refused,
        residual_m=residual_m,
        noise_m=noise_m,
        inlier_share=inlier_share,
        degenerate=np.array([each.reason == UNOBSERVABLE for each in placed]),
        sharpness=maps.sharpness,
        calibration=graph.calibration,
        readout_s=maps.shutter.readout_s if maps.shutter else 0.0,
        color_delay_s=maps.shutter.color_delay_s if maps.shutter else 0.0,
    )


@dataclass(frozen=True)
class _Placed:
    """A frame's pose and registration to nearby keyframes; or the reason why its pose is not used."""

    state: State
    reason: str | None = None
    T_world_camera: Float64 = field(default_factory=lambda: np.full((4, 4), np.nan))
    registration: Registration | None = None


@dataclass(frozen=True)
class _FirstTry:
    """A frame's predicted pose, the rows of nearby keyframes, and its registration to them from that pose."""

    state: State
    T_world_camera: Float64
    around: tuple[int, ...]
    registration: Registration


def _supported(placed: list[_Placed], odometry: Odometry, index: int) -> _Placed:
    """Return `placed[index]`, with a reason not to use its pose if its keyframe could not be placed."""
    frame, each = odometry.frames[index], placed[index]
    if frame is None or each.reason is not None or placed[frame.keyframe].reason is None:
        return each
    return replace(each, reason=UNSUPPORTED)


class _Placer:
    """Registers frames to the optimised keyframes."""

    def __init__(self, maps: MapCache, odometry: Odometry, graph: KeyframeGraph) -> None:
        self.maps, self.odometry, self.graph = maps, odometry, graph
        self.row = {frame: row for row, frame in enumerate(graph.keyframes)}
        self.neighbours = _neighbours(graph, self.row)
        joined = (f.segment for f in odometry.frames if f is not None and f.segment in graph.joined)
        self.first_segment = min(joined, default=0)
        followed = [f.registration for f in odometry.frames if f is not None and f.registration is not None]
        self.reference = median_quality(followed)

    def first_try(self, index: int) -> _Placed | _FirstTry:
        """Register a frame to the keyframes with the largest shared view, from its predicted pose.

        The result does not depend on other frames. It is already final (`_Placed`) for a lost frame, with the
        reason, and for a keyframe without neighbours.
        """
        frame = self.odometry.frames[index]
        if frame is None:
            return _Placed(state="lost", reason=self.odometry.reasons[index])
        T_world = self._predicted(frame)
        if not np.isfinite(T_world).all():
            return _Placed(state="lost", reason=NOT_JOINED)
        state: State = "tracked" if frame.segment == self.first_segment else "relocalised"
        around = self._around(index, frame, T_world)
        if not around:
            return _Placed(state=state, T_world_camera=T_world)
        return _FirstTry(state, T_world, tuple(around), self._registered(index, around, T_world))

    def place(self, index: int, first: _Placed | _FirstTry) -> _Placed:
        """Return the final pose of the next frame: from its first try, or from a search if that is poor."""
        if isinstance(first, _Placed):
            return first
        around, T_world, state = first.around, first.T_world_camera, first.state
        registration = first.registration
        if index not in self.row:
            registration = self._good_enough(index, first)
            T_world = on_so3(self.graph.T_world[around[0]] @ registration.T_target_source)
        reason = None if is_accepted(registration) else UNOBSERVABLE if registration.degenerate else DISAGREES
        return _Placed(state=state, reason=reason, T_world_camera=T_world, registration=registration)

    def _predicted(self, frame: Followed) -> Float64:
        """Return a frame's pose in the world: its keyframe's optimised pose, then the odometry from there."""
        home = self.odometry.frames[frame.keyframe]
        assert home is not None
        T_home_camera = invert_rigid(home.T_segment_camera) @ frame.T_segment_camera
        return np.asarray(self.graph.T_world[self.row[frame.keyframe]] @ T_home_camera)

    def _around(self, index: int, frame: Followed, T_world: Float64) -> list[int]:
        """Return rows of at most two keyframes: its own, then connected ones by descending shared view."""
        home = self.row[frame.keyframe]
        view = keyframe_thumbnail(self.maps[index])
        shared = [
            (-shared_view(self.graph.thumbnails[k], view, invert_rigid(self.graph.T_world[k]) @ T_world), k)
            for k in self.neighbours[home]
            if self.graph.keyframes[k] != index
        ]
        own = [home] if frame.keyframe != index else []
        return (own + [k for _, k in sorted(shared)])[:NEIGHBOURS]

    def _registered(self, index: int, around: list[int], T_world: Float64) -> Registration:
        """Register a frame, from the pose `T_world`, to the keyframes in the rows `around`.

        A keyframe does not move: only its residuals are measured.
        """
        source = self.maps[index]
        targets = [self.maps[self.graph.keyframes[k]] for k in around]
        starts = [invert_rigid(self.graph.T_world[k]) @ T_world for k in around]
        if index in self.row:
            return measure(source, targets, starts)
        return register(source, targets, starts, coarsest=0, prior=PLACED, every=point_stride(source))

    def _good_enough(self, index: int, first: _FirstTry) -> Registration:
        """Return the first registration if it is good enough, else the best of a search."""
        registration = first.registration
        if not self.reference.meets_reference(registration):
            source = self.maps[index]
            targets = [self.maps[self.graph.keyframes[k]] for k in first.around]
            T_around = [invert_rigid(self.graph.T_world[k]) for k in first.around]
            for T_around_k, target in zip(T_around, targets, strict=True):
                elsewhere = search(source, target, T_around_k @ first.T_world_camera).T_target_source
                T_there = invert_rigid(T_around_k) @ elsewhere
                other = register(source, targets, [T @ T_there for T in T_around], coarsest=0, prior=PLACED)
                registration = better(registration, other)
        self.reference = self.reference.after(registration)
        return registration


def _neighbours(graph: KeyframeGraph, row: dict[int, int]) -> list[list[int]]:
    """Return, for each keyframe, the rows of the keyframes that a constraint connects it to, best first.

    The best constraint has the largest weight * overlap. `row` maps a keyframe's frame index to its row.
    """
    neighbours: list[list[int]] = [[] for _ in graph.keyframes]
    for each in sorted(graph.constraints, key=lambda t: -t.weight * t.registration.overlap):
        neighbours[row[each.a]].append(row[each.b])
        neighbours[row[each.b]].append(row[each.a])
    return neighbours
