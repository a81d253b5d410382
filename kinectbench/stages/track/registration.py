"""Registration: move a frame until it agrees with other frames; `linearise` has the cost function.

If registration from the prediction is not good enough, `search` tries poses around it. Registration converges
at once in the directions that the surfaces constrain (a floor: two rotations and the height). Only the
remaining directions need a search: a grid along the three weakest, scored at the coarsest level.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.linalg import eigh

from kinectbench.core.geometry import on_so3, rigid_from_twist, twist_from_rigid
from kinectbench.core.geometry.gauss_newton import NormalEquations, descend
from kinectbench.core.types import Float64
from kinectbench.stages.track.frame_maps import FrameMaps, Level
from kinectbench.stages.track.linearise import NO_EXPOSURE_CHANGE, LinearTerms, linearise

# Noise of neighbouring pixels is correlated: this many points count as one measurement.
CORRELATED_POINTS = 10.0
# Per level, finest first: the largest distance along the ray between a point and its measurement, the number
# of iterations, and the step at which they stop.
GATES_M = (0.06, 0.10, 0.20)
ITERATIONS = (5, 8, 20)  # (chosen by hand)
STEP_ENOUGH = (1e-4, 2e-4, 5e-4)  # (chosen by hand)
# Fewer points at the finest level may agree by chance.
MIN_POINTS = 100
# Along a motion that slides surfaces on each other, noisy normals add false information. Its expected value
# is subtracted 1.5 times, because the noise is only estimated.
NOISE_FACTOR = 1.5
# A direction with a larger standard deviation is unobservable.
MAX_SIGMA_M = 0.012
# Shortens steps in weakly constrained directions.
HELD = NormalEquations(np.diag([0.1**-2] * 6), np.zeros(6))
NO_PRIOR = np.zeros((6, 6))  # nothing is known about the start
# Prior of a start known to 10 mrad and 10 mm, scaled like correlated measurements.
PLACED = CORRELATED_POINTS * np.diag([0.01**-2] * 3 + [0.01**-2] * 3)
# Level of the search.
COARSEST = 2
# Root-mean-square motion of the points from one start to the next.
SPACING_M = 0.12
STARTS = np.array([k for k in itertools.product((-2, -1, 0, 1, 2), repeat=3) if any(k)])
# Number of the best starts that are refined at the coarsest level, and of these that are registered.
SETTLED, REGISTERED = 8, 2
# Gate during the search: half that of the coarsest level, because the best start is near.
SEARCH_GATE_M = 0.1
# Limits of refining a start: number of steps, and motion of the points (chosen by hand, for time).
SETTLE_ITERATIONS, SETTLE_ENOUGH = 10, 3e-4
# The score of a start with less overlap than this is reduced in proportion.
ENOUGH_OVERLAP = 0.5
# What a full correlation of the intensities adds to it, beside a share of inliers of at most 1.
PER_CORRELATION = 0.25
# State of a registration: the motion (4, 4) since the start; for each target its exposure and its last terms.
Moving = tuple[Float64, list[Float64], list[LinearTerms]]


@dataclass(frozen=True)
class Registration:
    """The relative pose of two frames, and its quality.

    Attributes:
        T_target_source: (4, 4) relative pose.
        information: (6, 6) inverse covariance of the twist, less the false information of noisy normals.
        overlap: ratio of the source's points that project onto the target's depth and are not occluded by it;
            the mean over several targets.
        inlier_share: inlier ratio of these points.
        residual_m: root mean square of the inliers' point-to-plane residuals, metres.
        noise_m: the residual expected from a Kinect's depth noise alone, metres.
        signal_to_noise: information of the normals along the least constrained direction, divided by that of
            their noise alone; about 1 for one plane, 0 for too few points.
        sigma_m: standard deviation along the least constrained direction, as root-mean-square motion of the
            points; infinite where that direction is unobservable.
        intensity_correlation: correlation of the intensities, -1 to 1; NaN if a frame has too few.
    """

    T_target_source: Float64
    information: Float64
    overlap: float
    inlier_share: float
    residual_m: float
    noise_m: float
    signal_to_noise: float
    sigma_m: float
    intensity_correlation: float

    @property
    def degenerate(self) -> bool:
        """Whether a direction is unobservable, as with a single plane in view without texture."""
        return not self.sigma_m < MAX_SIGMA_M


def register(
    source: FrameMaps,
    targets: Sequence[FrameMaps],
    T_targets_source: Sequence[Float64],
    coarsest: int = 2,
    prior: Float64 = NO_PRIOR,
    every: int = 1,
) -> Registration:
    """Move a frame until it agrees with others that are fixed relative to each other.

    Args:
        source: the frame to move.
        targets: one or more other frames.
        T_targets_source: (4, 4) for each target, the initial poses.
        coarsest: level to start at, 0 the finest.
        prior: (6, 6) information of the initial pose, multiplied by `CORRELATED_POINTS`, because the points'
            residuals are summed here as if they were independent.
        every: stride of the points used at the finest level.

    Returns:
        The registration to the first target. If a frame has no intensity, motion in unobservable directions
            is undone.
    """
    starts = [np.asarray(T) for T in T_targets_source]
    moving: Moving = np.eye(4), [NO_EXPOSURE_CHANGE] * len(starts), []
    for level in range(coarsest, -1, -1):
        advance = partial(_advanced, source, targets, starts, level, prior, every)
        moving, moved = descend(advance, moving, ITERATIONS[level], STEP_ENOUGH[level])
    motion, exposures, linear_terms = moving
    T_now = [start @ motion for start in starts]
    if not moved < STEP_ENOUGH[0]:
        linear_terms = _linearised(source, targets, T_now, exposures, 0, every)
    registration, free = _figures(source, targets, T_now[0], linear_terms, every)
    textured = source.has_intensity and all(target.has_intensity for target in targets)
    if textured or not free.shape[1]:
        return registration
    # Undo motion in unobservable directions, which only noise caused.
    twist = twist_from_rigid(motion)
    motion = rigid_from_twist(twist - free @ np.linalg.pinv(free) @ twist)
    return measure(source, targets, [start @ motion for start in starts], every)


def _advanced(
    source: FrameMaps,
    targets: Sequence[FrameMaps],
    starts: Sequence[Float64],
    level: int,
    prior: Float64,
    every: int,
    moving: Moving,
) -> tuple[Moving, float]:
    """Advance a registration by one step at a level; also return the step's largest component.

    `starts` are the initial poses, (4, 4) for each target; `moving` is the motion since then, and for each
    target its exposure and its last terms. The other arguments are those of `register`.
    """
    motion, exposures, _ = moving
    linear_terms = _linearised(source, targets, [start @ motion for start in starts], exposures, level, every)
    known = NormalEquations.of_prior(prior, twist_from_rigid(motion))
    step = sum((terms.equations for terms in linear_terms), HELD + known).step()
    exposures = [terms.exposure_after(step) for terms in linear_terms]
    return (motion @ rigid_from_twist(step), exposures, linear_terms), float(np.abs(step).max())


def measure(
    source: FrameMaps, targets: Sequence[FrameMaps], T_targets_source: Sequence[Float64], every: int = 1
) -> Registration:
    """Measure the quality of a registration at given poses, without moving the frame.

    There is a transform (4, 4) for each target.
    """
    exposures = [NO_EXPOSURE_CHANGE] * len(targets)
    terms = _linearised(source, targets, T_targets_source, exposures, 0, every)
    return _figures(source, targets, np.asarray(T_targets_source[0]), terms, every)[0]


def _linearised(
    source: FrameMaps,
    targets: Sequence[FrameMaps],
    T_targets_source: Sequence[Float64],
    exposures: Sequence[Float64],
    level: int,
    every: int,
) -> list[LinearTerms]:
    """Linearise the registration to each target at a resolution level.

    At the finest level, the terms for observability are included, and only every n-th point is used (n =
    `every`). `exposures` are (2,) for each target: gain and offset of intensity.
    """
    finest = level == 0
    return [
        linearise(
            source[level],
            target[level],
            T,
            GATES_M[level],
            exposure,
            with_observability=finest,
            every=every if finest else 1,
        )
        for target, T, exposure in zip(targets, T_targets_source, exposures, strict=True)
    ]


def _figures(
    source: FrameMaps,
    targets: Sequence[FrameMaps],
    T_target_source: Float64,
    linear_terms: Sequence[LinearTerms],
    every: int,
) -> tuple[Registration, Float64]:
    """Return the registration with its quality, and the unobservable directions: twists as columns (6, k).

    `T_target_source` (4, 4) is the pose relative to the first target. `linear_terms` are the terms for each
    target at the finest level, linearised with a stride of `every` points.
    """
    inliers = sum(terms.inliers for terms in linear_terms)
    compared = inliers + sum(terms.violations for terms in linear_terms)
    squares = sum(terms.inliers * terms.residual_m**2 for terms in linear_terms)
    variances = sum(terms.inliers * terms.noise_m**2 for terms in linear_terms)
    held = observability(linear_terms, source[0], [target[0] for target in targets])
    geometric = held.without_noise(np.sum([terms.geometric for terms in linear_terms], axis=0))
    photometric = np.sum([terms.photometric for terms in linear_terms], axis=0)
    information = (geometric + photometric) * (every / CORRELATED_POINTS)
    known = np.einsum("ik,ij,jk->k", held.motions, information, held.motions)
    enough = inliers * every >= MIN_POINTS
    weakest = float(known.min()) if enough else 0.0
    registration = Registration(
        T_target_source=on_so3(T_target_source),
        information=information,
        overlap=min(1.0, compared * every / max(1, len(source[0].points) * len(targets))),
        inlier_share=inliers / max(1, compared),
        residual_m=float(np.sqrt(squares / max(1, inliers))),
        noise_m=float(np.sqrt(variances / max(1, inliers))),
        signal_to_noise=float(held.signal_to_noise[0]) if enough else 0.0,
        sigma_m=float(weakest**-0.5) if weakest > 1e-3 else np.inf,
        intensity_correlation=float(np.mean([terms.intensity_correlation for terms in linear_terms])),
    )
    return registration, held.motions[:, known < MAX_SIGMA_M**-2]


@dataclass(frozen=True)
class Observability:
    """The strength with which the normals constrain six directions of motion, the weakest first.

    Attributes:
        signal_to_noise: (6,) information of the normals along a direction, divided by that of their noise.
        motions: (6, 6) the directions as columns of twists; each moves the points by 1 m (root mean square).
        metric: (6, 6), twist @ metric @ twist is the points' mean squared motion; motions.T @ metric @
            motions is the unit matrix.
    """

    signal_to_noise: Float64
    motions: Float64
    metric: Float64

    def without_noise(self, information: Float64) -> Float64:
        """Subtract from the information (6, 6) the part due to noise of the normals along each direction."""
        left = np.sqrt(np.maximum(0.0, 1 - NOISE_FACTOR / np.maximum(self.signal_to_noise, NOISE_FACTOR)))
        # The inverse of the motions is motions.T @ metric.
        back = self.metric @ self.motions * left
        return np.asarray(back @ (self.motions.T @ information @ self.motions) @ back.T)


def observability(parts: Sequence[LinearTerms], source: Level, targets: Sequence[Level]) -> Observability:
    """Compute how well the normals constrain each direction of motion, relative to the noise of normals.

    Noise of unit variance along each axis e of a normal adds J J^T to the information, where J = ([p]x e, e).
    The sum over the axes is [[p]x; 1] [[p]x; 1]^T. Its mean over the points is the metric: the length of a
    twist in this metric is the root-mean-square motion of the points. `parts` are the terms for each target,
    linearised `with_observability`.
    """
    moments = np.sum([terms.moments for terms in parts], axis=0)
    x, y, z, n = moments[3] / max(moments[3, 3], 1)
    squares = moments[:3, :3] / max(moments[3, 3], 1)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    metric = np.block([[np.trace(squares) * np.eye(3) - squares, cross], [cross.T, n * np.eye(3)]])
    metric += 1e-6 * np.eye(6)
    shares = np.sum([terms.normal_information for terms in parts], axis=0) / max(moments[3, 3], 1)
    signal_to_noise, motions = eigh(shares, metric)
    counts = np.array([max(terms.inliers, 1) for terms in parts])
    # The mean of two normals is less noisy than either, unless the frames are the same.
    noises = [
        source.normal_noise**2 if target is source else (source.normal_noise**2 + target.normal_noise**2) / 4
        for target in targets
    ]
    noise = np.average(noises, weights=counts)
    return Observability(signal_to_noise / noise, motions, metric)


def registration_score(registration: Registration) -> float:
    """Return a score by inliers, overlap and intensity correlation: at most 1.25, or 1 without intensity."""
    return _score(registration.inlier_share, registration.overlap, registration.intensity_correlation)


def better(best: Registration | None, other: Registration) -> Registration:
    """Return the registration with the higher score; `best` if both are equal."""
    return other if best is None or registration_score(other) > registration_score(best) else best


def search(source: FrameMaps, target: FrameMaps, T_start: Float64) -> Registration:
    """Register a frame to another from many poses around `T_start` (4, 4); return the best-scoring result."""
    points, maps = source[COARSEST], target[COARSEST]
    T_settled, _ = _settle(source, target, T_start)
    terms = linearise(points, maps, T_settled, SEARCH_GATE_M, with_observability=True)
    weakest = observability([terms], points, [maps]).motions[:, :3]
    starts = [np.asarray(T_settled @ rigid_from_twist(weakest @ (SPACING_M * k))) for k in STARTS]
    starts.sort(key=lambda T: -_score_at(linearise(points, maps, T, SEARCH_GATE_M), points))
    settled = [_settle(source, target, T) for T in [T_settled, *starts[:SETTLED]]]
    settled.sort(key=lambda result: -_score_at(result[1], points))
    return max(
        (register(source, [target], [T], coarsest=1) for T, _ in settled[:REGISTERED]), key=registration_score
    )


def _settle(source: FrameMaps, target: FrameMaps, T_start: Float64) -> tuple[Float64, LinearTerms]:
    advance = partial(_advanced, source, [target], [T_start], COARSEST, NO_PRIOR, 1)
    still: Moving = np.eye(4), [NO_EXPOSURE_CHANGE], []
    (motion, (exposure,), _), _ = descend(advance, still, SETTLE_ITERATIONS, SETTLE_ENOUGH)
    T = T_start @ motion
    return T, linearise(source[COARSEST], target[COARSEST], T, SEARCH_GATE_M, exposure)


def _score_at(terms: LinearTerms, points: Level) -> float:
    compared = terms.inliers + terms.violations
    share, overlap = terms.inliers / max(1, compared), compared / max(1, len(points.points))
    return _score(share, overlap, terms.intensity_correlation)


def _score(inlier_share: float, overlap: float, correlation: float) -> float:
    agreement = 0.0 if np.isnan(correlation) else PER_CORRELATION * max(correlation, 0.0)
    return inlier_share * min(1.0, overlap / ENOUGH_OVERLAP) + agreement
