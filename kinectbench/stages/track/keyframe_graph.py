"""Connect keyframes by constraints: between covisible keyframes, at loop closures, and between segments."""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kinectbench.core.geometry import NO_CALIBRATION, DepthCalibration, invert_rigid, rotation_angle_rad
from kinectbench.core.threads import ahead
from kinectbench.core.types import Float64
from kinectbench.stages.track.covisibility import KeyframeThumbnail, covisible, keyframe_thumbnail
from kinectbench.stages.track.depth_calibration import CalibrationView, calibrate, evenly_chosen
from kinectbench.stages.track.features import FeatureCache, pose_from_features, similarity
from kinectbench.stages.track.frame_maps import MapCache
from kinectbench.stages.track.odometry import Odometry, is_accepted, point_stride
from kinectbench.stages.track.pose_graph import optimise
from kinectbench.stages.track.registration import PLACED, Registration, better, measure, register, search
from kinectbench.stages.track.tracked import Constraint, ConstraintKind

# Number of rounds. With texture, keyframes are so well constrained that further rounds add little.
ROUNDS_WITH_COLOR, ROUNDS_WITHOUT = 2, 3
# Few tries per keyframe and round: with similar keyframes, and with keyframes of a predicted shared view.
SIMILAR_PER_KEYFRAME, COVISIBLE_PER_KEYFRAME = 2, 3
# Pairs below these values mostly fail to register, and cost time.
MIN_SIMILARITY, MIN_SHARED_VIEW = 0.25, 0.3
# Keyframes this close in order are neighbours, not loops.
NEAR_IN_ORDER = 3
# Largest correction by a loop: this ratio of the path since then, plus this much.
DRIFT_SHARE, DRIFT_M, DRIFT_RAD = 0.1, 0.15, 0.35
# Two registrations between two segments confirm each other within this, and what the angle moves 1 m away.
AGREE_M, AGREE_RAD = 0.06, 0.06
# Limit on the inlier ratio of joining constraints, below the odometry's: a chair's back resembles its front.
INLIER_MARGIN = 0.015
# Number of constraints between two groups for which the neighbouring keyframes are tried, too.
JOINS_CONFIRMED = 5
# A constraint is refused if the pose graph gives it less weight.
MIN_CONSTRAINT_WEIGHT = 0.05
# Limits for a loop, stricter than for a step of odometry, because other places may look similar.
LOOP_INLIERS, LOOP_OVERLAP = 0.93, 0.3


@dataclass(frozen=True)
class KeyframeGraph:
    """The keyframes, their optimised poses, and the constraints between them.

    Attributes:
        keyframes: (k,) frame indices of the keyframes.
        T_world: (k, 4, 4), NaN where a keyframe's segment could not be joined.
        constraints: the accepted ones, with weights. All but odometry's were accepted in both directions.
        refused: constraints rejected, switched off by the optimisation, or outside the world.
        joined: indices of the segments that were joined into the world.
        thumbnails: (k,) thumbnails of the keyframes.
        calibration: the depth calibration of the constraints.
    """

    keyframes: tuple[int, ...]
    T_world: Float64
    constraints: tuple[Constraint, ...]
    refused: tuple[Constraint, ...]
    joined: frozenset[int]
    thumbnails: tuple[KeyframeThumbnail, ...]
    calibration: DepthCalibration = NO_CALIBRATION


def build_graph(
    maps: MapCache, features: FeatureCache, odometry: Odometry, T_given: Float64 | None = None
) -> KeyframeGraph:
    """Find constraints between keyframes, join trajectory segments, and optimise the poses, in rounds.

    A segment is a stretch of frames tracked in a world of its own. The function estimates a depth calibration
    and sets it in `maps`. `T_given` (n, 4, 4) are given poses of all frames, a weak prior; or None.
    """
    builder = _Builder(maps, features, odometry, T_given)
    builder.add_loop_candidates()
    rounds = ROUNDS_WITH_COLOR if builder.textured else ROUNDS_WITHOUT
    for last in [False] * (rounds - 1) + [True]:
        builder.add_covisibility_constraints()
        builder.optimise()
        if not last:
            builder.calibrate()
    return builder.graph()


class _Builder:
    """Builds the keyframe graph step by step; a group is one or more segments joined into one world."""

    def __init__(
        self, maps: MapCache, features: FeatureCache, odometry: Odometry, T_given: Float64 | None
    ) -> None:
        self.maps, self.features = maps, features
        self.calibration = NO_CALIBRATION
        self.keyframes = odometry.keyframes
        self.row = {frame: row for row, frame in enumerate(self.keyframes)}
        self.thumbnails = list(ahead(lambda frame: keyframe_thumbnail(maps[frame]), self.keyframes))
        self.textured = any(maps[frame].has_intensity for frame in self.keyframes[:3])
        self.lost = np.array([frame is None for frame in odometry.frames])
        followed = [odometry.frames[frame] for frame in self.keyframes]
        self.segments = np.array([f.segment for f in followed if f is not None])
        self.T_segment = np.array([f.T_segment_camera for f in followed if f is not None])
        self.T_given = None if T_given is None else T_given[list(self.keyframes)]
        steps = np.linalg.norm(np.diff(self.T_segment[:, :3, 3], axis=0), axis=1) if len(followed) else []
        self.path_m = np.concatenate([[0.0], np.cumsum(steps)])
        self.constraints: list[Constraint] = list(ahead(self._again, odometry.constraints))
        self.round = 0
        self.refused: list[Constraint] = []
        self.tried = {(constraint.a, constraint.b) for constraint in self.constraints}
        # Each segment starts as a separate group with its own world.
        self.group = self.segments.copy()
        self.T_world = self.T_segment.copy()
        self._place_groups_as_given()
        self.weights = np.ones(len(self.constraints))

    def _again(self, each: Constraint) -> Constraint:
        """Repeat a constraint's registration with averaged depth; return the old constraint if that fails."""
        source, target = self.maps[each.b], self.maps[each.a]
        registration = register(source, [target], [each.T_a_b], 0, PLACED, point_stride(source))
        return Constraint(each.a, each.b, registration, each.kind) if is_accepted(registration) else each

    def add_loop_candidates(self) -> None:
        """Register similar keyframes more than three keyframes apart, and the two at each segment border."""
        similar = similarity(list(ahead(self.features.__getitem__, self.keyframes)))
        order = np.arange(len(self.keyframes))
        similar[np.abs(order[:, None] - order[None]) <= NEAR_IN_ORDER] = 0
        tries = set[tuple[int, int]]()
        for row in order:
            for other in np.argsort(-similar[row], kind="stable")[:SIMILAR_PER_KEYFRAME]:
                if similar[row, other] >= MIN_SIMILARITY:
                    tries.add((int(min(row, other)), int(max(row, other))))
        parted = (1 + np.flatnonzero(np.diff(self.segments))).tolist()
        tries |= {(row - 1, row) for row in parted}
        self._try((a, b, None) for a, b in sorted(tries))

    def add_covisibility_constraints(self) -> None:
        """Register pairs of keyframes whose poses predict a shared view, those that share most first."""
        tries: dict[int, int] = defaultdict(int)
        chosen = []
        pairs = sorted(self._covisible_pairs(), key=lambda pair: (-pair[0], pair[1:]))
        for share, a, b in pairs:
            if share < MIN_SHARED_VIEW or max(tries[a], tries[b]) >= COVISIBLE_PER_KEYFRAME:
                continue
            if (self.keyframes[a], self.keyframes[b]) in self.tried:
                continue
            tries[a] += 1
            tries[b] += 1
            chosen.append((a, b))
        # In the order of the path, so that the keyframes' maps are still cached.
        self._try((a, b, self._between(a, b)) for a, b in sorted(chosen))

    def _covisible_pairs(self) -> list[tuple[float, int, int]]:
        pairs = []
        for group in np.unique(self.group):
            rows = np.flatnonzero(self.group == group)
            result = covisible([self.thumbnails[row] for row in rows], self.T_world[rows])
            pairs += [(share, int(rows[i]), int(rows[j])) for share, i, j in result]
        return pairs

    def _try(self, pairs: Iterable[tuple[int, int, Float64 | None]]) -> None:
        """Register pairs (row a, row b, initial T_a_b or None) not tried before; store the constraints."""
        fresh = []
        for a, b, T_a_b in pairs:
            frames = self.keyframes[a], self.keyframes[b]
            if frames not in self.tried:
                self.tried.add(frames)
                fresh.append((a, b, T_a_b))
        for made in ahead(self._constraint, fresh):
            if made is not None:
                (self.constraints if made.weight else self.refused).append(made)

    def _constraint(self, pair: tuple[int, int, Float64 | None]) -> Constraint | None:
        """Register a pair; return a constraint, of weight 0 if rejected; None if no initial pose is known."""
        a, b, T_a_b = pair
        frames = self.keyframes[a], self.keyframes[b]
        near = b - a <= NEAR_IN_ORDER and self.segments[a] == self.segments[b]
        kind: ConstraintKind = "covisible" if near else "loop"
        best = self._register(frames, T_a_b)
        if best is None:
            return None
        made = Constraint(*frames, best, kind)
        drifts = self.group[a] == self.group[b] and self._breaks_drift_bound(a, b, best.T_target_source)
        return made if self._is_mutual(frames, best) and not drifts else replace(made, weight=0.0)

    def _register(self, frames: tuple[int, int], T_a_b: Float64 | None) -> Registration | None:
        target, source = (self.maps[frame] for frame in frames)
        best: Registration | None = None
        if T_a_b is not None:
            best = register(source, [target], [T_a_b], every=point_stride(source))
        lost = T_a_b is None or self.round == 0
        if lost and (best is None or not _convinces(best)):
            seen = pose_from_features(self.features[frames[1]], self.features[frames[0]], source[0].camera)
            if seen is not None:
                best = better(best, register(source, [target], [seen[0]], 1, every=point_stride(source)))
        if lost and T_a_b is not None and best is not None and not _convinces(best):
            best = better(best, search(source, target, T_a_b))
        return best

    def _is_mutual(self, frames: tuple[int, int], registration: Registration) -> bool:
        """Whether a registration is accepted in both directions."""
        source, target = self.maps[frames[0]], self.maps[frames[1]]
        back = measure(source, [target], [invert_rigid(registration.T_target_source)], point_stride(source))
        return _convinces(registration) and _convinces(back)

    def _breaks_drift_bound(self, a: int, b: int, T_a_b: Float64) -> bool:
        error = invert_rigid(T_a_b) @ invert_rigid(self.T_world[a]) @ self.T_world[b]
        walked_m = abs(self.path_m[b] - self.path_m[a])
        moved = np.linalg.norm(error[:3, 3]) > DRIFT_M + DRIFT_SHARE * walked_m
        return bool(moved or rotation_angle_rad(error[:3, :3]) > DRIFT_RAD)

    def optimise(self) -> None:
        """Join groups that enough constraints connect, then optimise each group."""
        self.round += 1
        self._confirm_joins()
        self._join_groups()
        self.weights = np.ones(len(self.constraints))
        ends = [self._ends(each) for each in self.constraints]
        for group in np.unique(self.group):
            rows = np.flatnonzero(self.group == group)
            local = {int(row): i for i, row in enumerate(rows)}
            chosen = [t for t, (a, b) in enumerate(ends) if a in local and b in local]
            nodes = [(local[a], local[b]) for a, b in (ends[t] for t in chosen)]
            prior = None if self.T_given is None else self.T_given[rows]
            if prior is not None and not np.isfinite(prior).any():
                prior = None
            poses, weights = optimise(self.T_world[rows], [self.constraints[t] for t in chosen], nodes, prior)
            self.T_world[rows] = poses
            self.weights[chosen] = weights

    def calibrate(self) -> None:
        """Estimate the depth distortion from overlapping keyframes, then repeat the registrations."""
        if not self.constraints:
            return
        pairs = sorted((a, b) for share, a, b in self._covisible_pairs() if share >= MIN_SHARED_VIEW)
        self.maps.calibrate(NO_CALIBRATION)
        self.calibration = calibrate(self._view(a, b) for a, b in evenly_chosen(pairs))
        self.maps.calibrate(self.calibration)
        ends = [(each.a, each.b) for each in self.constraints]
        along = sorted(range(len(ends)), key=ends.__getitem__)
        again = ahead(self._again, [self.constraints[t] for t in along])
        for t, constraint in zip(along, list(again), strict=True):
            self.constraints[t] = constraint

    def _view(self, a: int, b: int) -> CalibrationView:
        target, source = (self.maps[self.keyframes[row]][0] for row in (a, b))
        return CalibrationView(source, target, self._between(a, b))

    def _ends(self, each: Constraint) -> tuple[int, int]:
        return self.row[each.a], self.row[each.b]

    def _between(self, a: int, b: int) -> Float64:
        """Return T_a_b (4, 4) of the keyframes in the rows a and b, from their current poses."""
        return np.asarray(invert_rigid(self.T_world[a]) @ self.T_world[b])

    def _joining_constraints(self) -> dict[tuple[int, int], list[Constraint]]:
        """Return the constraints that are good enough to join groups: {(lower, higher group): list}.

        Their inlier ratio is at most `INLIER_MARGIN` below the median of the odometry constraints.
        """
        along = [each.registration for each in self.constraints if each.kind == "odometry"]
        typical_share = np.median([each.inlier_share for each in along] or [0.0])
        between: dict[tuple[int, int], list[Constraint]] = defaultdict(list)
        for each in self.constraints:
            low, high = sorted(int(self.group[row]) for row in self._ends(each))
            if low != high and each.registration.inlier_share >= typical_share - INLIER_MARGIN:
                between[low, high].append(each)
        return between

    def _confirm_joins(self) -> None:
        """Register the neighbours of keyframes that join two groups: in a correct join they overlap, too."""
        near = []
        for _, constraints in sorted(self._joining_constraints().items()):
            for each in constraints[:JOINS_CONFIRMED]:
                a, b = self._ends(each)
                for i, j in ((a - 1, b), (a + 1, b), (a, b - 1), (a, b + 1)):
                    inside = 0 <= i < len(self.group) and 0 <= j < len(self.group)
                    if inside and (self.group[i], self.group[j]) == (self.group[a], self.group[b]):
                        near.append((i, j, self._between(i, a) @ each.T_a_b @ self._between(b, j)))
        self._try(near)

    def _join_groups(self) -> None:
        """Join pairs of groups if two constraints agree on their relative pose, until no such pair is left.

        One constraint suffices between consecutive keyframes, or for a group of one keyframe. Joins of
        consecutive keyframes between which the camera was never lost come first, and loops that contradict
        them are refused: such loops often connect opposite sides of a symmetric object.
        """
        while True:
            candidates = []
            for groups, constraints in sorted(self._joining_constraints().items()):
                following = [each for each in constraints if self._follows(each)]
                if (agreed := self._agreed(following or constraints)) is not None:
                    candidates.append((bool(following), *agreed, groups))
            if not candidates:
                return
            follows, _, each, groups = max(candidates, key=lambda candidate: candidate[:2])
            self._join(each, groups)
            if follows:
                self._refuse_contradictions()

    def _refuse_contradictions(self) -> None:
        """Refuse loops within a group that differ from its poses by more than odometry may drift."""
        kept: list[Constraint] = []
        for each in self.constraints:
            a, b = self._ends(each)
            within = each.kind == "loop" and self.group[a] == self.group[b]
            if within and self._breaks_drift_bound(a, b, each.T_a_b):
                self.refused.append(replace(each, weight=0.0))
            else:
                kept.append(each)
        self.constraints = kept

    def _follows(self, each: Constraint) -> bool:
        """Whether a constraint joins consecutive keyframes between which the camera was never lost."""
        a, b = self._ends(each)
        return b == a + 1 and not self.lost[each.a : each.b].any()

    def _agreed(self, constraints: Sequence[Constraint]) -> tuple[int, Constraint] | None:
        """Return (number, constraint): how many agree with the most supported one; None if too few agree."""
        relative = [self._T_group_group(each) for each in constraints]
        best: tuple[int, Constraint] | None = None
        for each, T in zip(constraints, relative, strict=True):
            errors = [invert_rigid(T) @ other for other in relative]
            agree = sum(
                float(np.linalg.norm(e[:3, 3])) < AGREE_M + AGREE_RAD
                and rotation_angle_rad(e[:3, :3]) < AGREE_RAD
                for e in errors
            )
            if best is None or agree > best[0]:
                best = int(agree), each
        if best is None:
            return None
        a, b = self._ends(best[1])
        small = min(int((self.group == self.group[row]).sum()) for row in (a, b)) == 1
        return best if best[0] >= 2 or b == a + 1 or small else None

    def _T_group_group(self, each: Constraint) -> Float64:
        """Return T_low_high (4, 4) by one constraint: from the higher group's world to the lower group's."""
        a, b = self._ends(each)
        T = self.T_world[a] @ each.T_a_b @ invert_rigid(self.T_world[b])
        return T if self.group[a] < self.group[b] else invert_rigid(T)

    def _join(self, each: Constraint, groups: tuple[int, int]) -> None:
        """Move the smaller of two groups into the world of the larger one, by a constraint between them."""
        T_low_high = self._T_group_group(each)
        low, high = (np.flatnonzero(self.group == group) for group in groups)
        if len(low) >= len(high):
            self.T_world[high] = T_low_high @ self.T_world[high]
            self.group[high] = groups[0]
        else:
            self.T_world[low] = invert_rigid(T_low_high) @ self.T_world[low]
            self.group[low] = groups[1]

    def _place_groups_as_given(self) -> None:
        """Move each segment into the world of the given poses, by its middle keyframe with a given pose."""
        if self.T_given is None:
            return
        for segment in np.unique(self.segments):
            rows = np.flatnonzero(self.segments == segment)
            posed = [row for row in rows if np.isfinite(self.T_given[row]).all()]
            if posed:
                middle = posed[len(posed) // 2]
                self.T_world[rows] = (
                    self.T_given[middle] @ invert_rigid(self.T_segment[middle]) @ self.T_segment[rows]
                )

    def graph(self) -> KeyframeGraph:
        """Assemble the result: the largest group becomes the world, the others stay lost."""
        if not len(self.keyframes):
            return KeyframeGraph((), np.zeros((0, 4, 4)), (), (), frozenset(), ())
        groups, counts = np.unique(self.group, return_counts=True)
        world = groups[np.argmax(counts)]
        inside = self.group == world
        T_world = np.where(inside[:, None, None], self.T_world, np.nan)
        kept: list[Constraint] = []
        refused = list(self.refused)
        for each, weight in zip(self.constraints, self.weights, strict=True):
            weighed = replace(each, weight=float(weight))
            within = inside[list(self._ends(each))].all()
            (kept if within and weight >= MIN_CONSTRAINT_WEIGHT else refused).append(weighed)
        return KeyframeGraph(
            keyframes=self.keyframes,
            T_world=T_world,
            constraints=tuple(kept),
            refused=tuple(refused),
            joined=frozenset(self.segments[inside].tolist()),
            thumbnails=tuple(self.thumbnails),
            calibration=self.calibration,
        )


def _convinces(registration: Registration) -> bool:
    return (
        is_accepted(registration)
        and registration.inlier_share >= LOOP_INLIERS
        and registration.overlap >= LOOP_OVERLAP
    )
