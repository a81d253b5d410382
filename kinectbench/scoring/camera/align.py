"""Register a predicted surface to the true one by a translation, optionally with a scale and a rotation.

Rule of this project: a symmetric form of point-to-plane ICP (Chen and Medioni 1992). Each sample of the
prediction is matched to the nearest sample of the truth, and vice versa, so that neither shape can shrink
onto a part of the other. Only known parts of the truth are used. Initial poses and numbers of steps are
fixed: nothing is random, and no result depends on the number of cores.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kinectbench.core.geometry import invert_similarity, rigid, similarity_scale
from kinectbench.core.types import Float64
from kinectbench.scoring.camera.nearest import NearestOfMoving
from kinectbench.scoring.camera.surface import Surface
from kinectbench.scoring.camera.truth import SpaceTruth

# Number of free parameters of a step, counted from the first one. A step is a translation (3), the logarithm
# of a scale (1) and a rotation vector (3).
KINDS = {"t": 3, "t+s": 4, "R+t+s": 7}
# Number of samples of each surface and maximum number of steps: first from all starts, then from the best
# result (chosen here; with these the shapes in the tests are registered to within the bounds stated in
# docs/scoring-in-space.md).
COARSE, FINE = (400, 12), (3000, 40)
# Rotation of the further starts. The start without rotation can correct a rotation of up to 30 degrees; these
# starts can correct larger ones (chosen here).
START_DEG = 45.0
# Weight of the distance along the surface relative to the distance across it: large at first, then small.
ALONG_COARSE, ALONG_FINE = 0.3, 0.01
# The surface of cells is a staircase. So each sample is moved along its normal to the mean of the samples
# within this many cells. With this, sizes are found to within 0.03 %; without it, to within 0.11 % (measured:
# a ball, a box, a cone and an ellipsoid at 256 cells for 1.1 m).
SMOOTHED_CELLS = 3
# The registration ends if a step moves no sample by more than the first share of the object's size: 0.01 mm
# for 1 m. It is called ok if the last step was below the second share: 0.1 mm for 1 m (chosen here).
STILL, OK_STILL = 1e-5, 1e-4
# It also ends after PATIENCE successive steps that make no progress, because a ball could rotate forever
# without coming nearer. A step makes progress if its length is below SHRINKING times that of the previous
# step, or if it brings the distance along the normals below NEARER times the smallest so far. This distance
# alone would not do: it may rise before convergence, as steps also reduce the distance along the surface. If
# in the end it is below CLOSE times the size, the points only slide along a surface that fits (chosen here; a
# dented ball has 0.6 %).
SHRINKING, NEARER, PATIENCE, CLOSE = 0.7, 0.999, 3, 0.02
# A registration is not ok if the size of the registered shape, relative to that of the truth, is outside this
# range (chosen here).
LEAST_SIZE, MOST_SIZE = 0.05, 20.0


@dataclass(frozen=True)
class SurfaceRegistration:
    """The similarity that aligns a predicted surface with the true one.

    Attributes:
        T: (4, 4) similarity to apply to the prediction, from the truth's grid frame to itself, metres; its
            rotation has determinant +1.
        ok: whether the iteration converged and the registered shape has a plausible size.
    """

    T: Float64
    ok: bool


@dataclass(frozen=True)
class _Pair:
    """Samples of the predicted surface (`ours`), not registered, and of the known true surface (`theirs`)."""

    truth: SpaceTruth
    ours: Surface
    theirs: Surface

    @property
    def normals(self) -> Float64:
        """Normals of the samples of the true surface: (n, 3)."""
        assert self.theirs.normals is not None
        return self.theirs.normals

    @cached_property
    def ways(self) -> tuple[NearestOfMoving, NearestOfMoving]:
        """Searches for the nearest true sample of each predicted sample, and for the reverse."""
        ours, theirs = self.ours, self.theirs
        return NearestOfMoving(theirs.samples, len(ours)), NearestOfMoving(ours.samples, len(theirs))

    def thinned(self, most: int) -> "_Pair":
        """Return the pair with at most `most` samples per surface; true samples are also smoothed."""
        made = self.truth.smoothed
        if most not in made:
            few = replace(self, theirs=self.theirs.thinned(most))
            points_m = few.theirs.points_m
            radius_m = SMOOTHED_CELLS * self.truth.voxel_size_m
            off = self.theirs.samples.offsets(points_m, few.normals, radius_m)
            made[most] = replace(few.theirs, points_m=points_m + off[:, None] * few.normals)
        return replace(self, ours=self.ours.thinned(most), theirs=made[most])


def register_surface(truth: SpaceTruth, surface: Surface, kind: str) -> SurfaceRegistration:
    """Register a predicted surface to the known part of the true surface.

    Args:
        truth: the truth of the view.
        surface: the predicted surface, in the truth's grid frame.
        kind: what the registration estimates: "t" a translation, "t+s" also a scale, "R+t+s" also a rotation.
    """
    return register_kinds(truth, surface, (kind,))[kind]


def register_kinds(
    truth: SpaceTruth, surface: Surface, kinds: Sequence[str]
) -> dict[str, SurfaceRegistration]:
    """Return {kind: registration}, as `register_surface` does for each kind, but do shared work only once.

    If no part of the true surface is known, each registration is the identity, with `ok` False.
    """
    known = truth.known_surface
    if not len(known):
        return dict.fromkeys(kinds, SurfaceRegistration(np.eye(4), ok=False))
    pair = _Pair(truth, surface, known)
    coarse, fine = pair.thinned(COARSE[0]), pair.thinned(FINE[0])
    found = {}
    for kind in kinds:
        starts = [_steps(coarse, start, kind, COARSE[1], ALONG_COARSE)[0] for start in _starts(pair, kind)]
        best = min(starts, key=lambda T: _far(coarse, T))
        T, moved = _steps(fine, best, kind, FINE[1], ALONG_FINE)
        # If the prediction's scale is free, only the resulting size can be judged.
        size = similarity_scale(T) * surface.spread_m / max(known.spread_m, 1e-9)
        rests = moved < OK_STILL * truth.size_m
        found[kind] = SurfaceRegistration(T, rests and LEAST_SIZE < size < MOST_SIZE)
    return found


def _starts(pair: _Pair, kind: str) -> Iterator[Float64]:
    """Yield initial similarities (4, 4): the identity; then one or more that align the centroids.

    If `kind` allows a scale, these also equalise the sizes; if it allows a rotation, there is one for each of
    several fixed rotations.
    """
    yield np.eye(4)
    ours, theirs = pair.ours.center_m, pair.theirs.center_m
    scale = 1.0 if kind == "t" else pair.theirs.spread_m / max(pair.ours.spread_m, 1e-9)
    for rotation in _rotations() if kind == "R+t+s" else [np.eye(3)]:
        yield rigid(scale * rotation, theirs - scale * rotation @ ours)


def _rotations() -> Sequence[Float64]:
    from scipy.spatial.transform import Rotation

    vectors = [np.zeros(3), *(sign * axis for axis in np.eye(3) for sign in (1, -1))]
    return [np.asarray(Rotation.from_rotvec(np.radians(START_DEG) * one).as_matrix()) for one in vectors]


def _matches(pair: _Pair, T: Float64) -> tuple[Float64, Float64, Float64, Float64, Float64, int]:
    """Match samples in both directions, with the prediction moved by `T` (4, 4).

    Returns:
        moved: (k, 3) moved predicted samples of the k matches. Matches from prediction to truth come first.
        targets: (k, 3) the true samples that they match.
        normals: (k, 3) the normals of the true samples.
        middle: (3,) mean of `moved`.
        weights: (k,) robust weight of each match.
        count: number of matches from prediction to truth.
    """
    from kinectbench.core.geometry.gauss_newton import robust_weights
    from kinectbench.scoring.camera.kernels import mapped
    from kinectbench.scoring.camera.steps import drawn_together

    ours, theirs, (ahead, behind) = pair.ours.points_m, pair.theirs.points_m, pair.ways
    moved = mapped(ours, T[:3])
    is_known = pair.truth.at(moved)[0]
    there, found = ahead.of(moved, is_known)
    back, nearest = behind.of(mapped(theirs, invert_similarity(T)[:3]), np.ones(len(theirs), bool))
    drawn = drawn_together(ours, theirs, pair.normals, is_known, found, nearest, T[:3])
    weights = [robust_weights(there), robust_weights(back)]
    return *drawn, np.concatenate(weights), len(found)


def _far(pair: _Pair, T: Float64) -> float:
    """Return the sum of both directions' mean match distances, metres; `T` moves the prediction."""
    places, targets, *_, count = _matches(pair, T)
    distances = np.sqrt(((places - targets) ** 2).sum(axis=1))
    ways = np.split(distances, [count])
    return float(sum(way.mean() if len(way) else np.inf for way in ways))


def _steps(pair: _Pair, start: Float64, kind: str, count: int, along: float) -> tuple[Float64, float]:
    """Take up to `count` registration steps from `start`; return the similarity and the last step's length.

    The length is in metres; it is 0 if the shape fits and the last steps only slid or turned it along the
    surface. `kind` is as in `register_surface`. `along` is the weight of point-to-point distances relative to
    point-to-plane distances.
    """
    from kinectbench.core.geometry.gauss_newton import NormalEquations
    from kinectbench.scoring.camera.steps import similarity_about, step_equations

    free, size_m = KINDS[kind], pair.truth.size_m
    T, moved, before, least, waited = start, np.inf, np.inf, np.inf, 0
    for _ in range(count):
        places, targets, normals, middle, weights, _count = _matches(pair, T)
        H, g, squares = step_equations(places, targets, normals, weights, middle, along, free)
        far = np.sqrt(squares / weights.sum())
        waited = 0 if far < NEARER * least or moved < SHRINKING * before else waited + 1
        if waited == PATIENCE:
            return T, 0.0 if far < CLOSE * size_m else moved
        least = min(least, far)
        step = np.zeros(7)
        step[:free] = NormalEquations(H, -g).damped().step()
        # No step may double the size, or rotate by more than 30 degrees per axis.
        step[3:] = np.clip(step[3:], -0.5, 0.5)
        before = moved
        moved = float(np.linalg.norm(step[:3]) + np.linalg.norm(step[3:]) * size_m / 2)
        T = similarity_about(step, middle) @ T
        if moved < STILL * size_m:
            break
    return T, moved
