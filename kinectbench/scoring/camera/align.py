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
from numba import njit
from scipy.spatial.transform import Rotation

from kinectbench.core.geometry import invert_similarity, rigid, similarity_scale
from kinectbench.core.geometry.gauss_newton import NormalEquations, robust_weights
from kinectbench.core.types import Float64
from kinectbench.scoring.camera.kernels import mapped
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


@njit(cache=True, error_model="numpy", nogil=True)
def drawn_together(ours, theirs, normals, asked, found, nearest, affine):  # type: ignore[no-untyped-def]
    """Collect a registration step's matches: first from prediction to truth, then from truth to prediction.

    Args:
        ours: (n, 3) samples of the prediction.
        theirs: (m, 3) samples of the truth.
        normals: (m, 3) normals of the truth's samples.
        asked: (n,) bool, which predicted samples are matched; k of them are.
        found: (k,) index of each matched predicted sample's nearest true sample.
        nearest: (m,) index of each true sample's nearest predicted sample.
        affine: (3, 4) transform of the predicted samples.

    Returns:
        Three arrays (k + m, 3) float64: the transformed predicted samples, the true samples that they match,
        and the normals of these true samples. And the mean (3,) of the first array.
    """
    count, k = len(found), 0
    places, middle = np.empty((count + len(theirs), 3)), np.zeros(3)
    targets, across = np.empty_like(places), np.empty_like(places)
    for n in range(len(ours) + len(theirs)):
        if n < len(ours) and not asked[n]:
            continue
        one = n if n < len(ours) else nearest[n - len(ours)]
        other = found[k] if n < len(ours) else n - len(ours)
        x, y, z = ours[one]
        for axis in range(3):
            a, b, c, d = affine[axis]
            places[k, axis] = a * x + b * y + c * z + d
            targets[k, axis], across[k, axis] = theirs[other, axis], normals[other, axis]
            middle[axis] += places[k, axis]
        k += 1
    return places, targets, across, middle / k


@njit(cache=True, error_model="numpy", nogil=True)
def step_equations(places, targets, normals, weights, middle, along, free):  # type: ignore[no-untyped-def]
    """Return the normal equations of a registration step, and the sum of squared distances along the normals.

    The equations are H (free, free) and the gradient (free,); the sum is weighted. A step is a translation
    (3), the logarithm of a scale (1) and a rotation vector (3); scale and rotation are about `middle`. The
    cost is the weighted sum of squared point-to-plane distances, plus `along` times the weighted sum of
    squared point-to-point distances.

    Args:
        places: (n, 3) points of the prediction.
        targets: (n, 3) the matched points of the truth.
        normals: (n, 3) normals of the targets.
        weights: (n,) weight of each match.
        middle: (3,) the centre of scaling and rotation.
        along: weight of the point-to-point distances.
        free: number of free parameters, 3, 4 or 7: the first parameters of a step.
    """
    H, g, squares = np.zeros((free, free)), np.zeros(free), 0.0
    row, whole = np.empty(7), np.empty(7)
    # Products of the columns of the Jacobian: (1 0 0), (0 1 0), (0 0 1), p, and the unit axes x p.
    of = np.zeros((7, 7))
    of[0, 0] = of[1, 1] = of[2, 2] = 1.0
    for n in range(len(places)):
        x, y, z = places[n, 0] - middle[0], places[n, 1] - middle[1], places[n, 2] - middle[2]
        a, b, c = places[n, 0] - targets[n, 0], places[n, 1] - targets[n, 1], places[n, 2] - targets[n, 2]
        p, q, r = normals[n]
        across, weight = a * p + b * q + c * r, weights[n]
        row[0], row[1], row[2], row[3] = p, q, r, x * p + y * q + z * r
        row[4], row[5], row[6] = -z * q + y * r, z * p + -x * r, -y * p + x * q
        whole[0], whole[1], whole[2], whole[3] = a, b, c, x * a + y * b + z * c
        whole[4], whole[5], whole[6] = -z * b + y * c, z * a + -x * c, -y * a + x * b
        of[3, 0], of[3, 1], of[3, 2], of[3, 3] = x, y, z, x * x + y * y + z * z
        of[4, 1], of[4, 2], of[5, 0], of[5, 2], of[6, 0], of[6, 1] = -z, y, z, -x, -y, x
        of[4, 4], of[5, 5], of[6, 6] = z * z + y * y, z * z + x * x, y * y + x * x
        of[5, 4], of[6, 4], of[6, 5] = -x * y, -z * x, -y * z
        squares += weight * across * across
        for i in range(free):
            g[i] += weight * (row[i] * across + along * whole[i])
            for j in range(i + 1):
                H[i, j] += weight * (row[i] * row[j] + along * of[i, j])
    for i in range(free):
        for j in range(i):
            H[j, i] = H[i, j]
    return H, g, squares


@njit(cache=True, error_model="numpy", nogil=True)
def similarity_about(step, middle):  # type: ignore[no-untyped-def]
    """Return the similarity (4, 4) of a registration step (7,) about `middle` (3,).

    The step is a translation (3), the logarithm of a scale (1) and a rotation vector (3). Rodrigues' formula
    is used here because SciPy takes 17 times as long for a single rotation (measured).
    """
    T, scale = np.eye(4), np.exp(step[3])
    x, y, z = step[4], step[5], step[6]
    angle = np.sqrt(x * x + y * y + z * z)
    along = np.sin(angle) / angle if angle > 0 else 1.0
    # (1 - cos a) / a^2, written without the difference, which would lose digits.
    across = 0.5 * (np.sin(angle / 2) / (angle / 2)) ** 2 if angle > 0 else 0.5
    T[0, 0], T[0, 1], T[0, 2] = (
        1 - across * (y * y + z * z),
        across * x * y - along * z,
        across * x * z + along * y,
    )
    T[1, 0], T[1, 1], T[1, 2] = (
        across * x * y + along * z,
        1 - across * (x * x + z * z),
        across * y * z - along * x,
    )
    T[2, 0], T[2, 1], T[2, 2] = (
        across * x * z - along * y,
        across * y * z + along * x,
        1 - across * (x * x + y * y),
    )
    for i in range(3):
        T[i, 3] = middle[i] + step[i]
        for j in range(3):
            T[i, j] *= scale
            T[i, 3] -= T[i, j] * middle[j]
    return T
