"""Gauss-Newton: the steps of every registration, from weighted residuals to convergence.

A step s reduces residuals r, with weights w, by J s. The step with the smallest sum of w r^2 solves the
normal equations (sum w J J^T) s = sum w J r (Nocedal & Wright, "Numerical Optimization", 2006, chapter 10). A
prior acts as one more measurement. The caller chooses units, limits of a step, and the threshold of
convergence.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numba
import numpy as np

from kinectbench.core.types import Float64

State = TypeVar("State")
# Damping as a share of the trace; residuals of this many medians have half the weight (before `power`).
DAMPING, HALF_AT_MEDIANS = 1e-6, 3.0


@dataclass(frozen=True)
class NormalEquations:
    """`matrix @ step = gradient`: (n, n) sum of w J J^T, and (n,) sum of w J r. Two systems can be added."""

    matrix: Float64
    gradient: Float64

    @classmethod
    def of_prior(cls, information: Float64, state: Float64) -> "NormalEquations":
        """Make the equations of a prior with information (n, n) that pulls `state` (n,) to 0."""
        return cls(information, -information @ state)

    @classmethod
    def of_products(cls, products: Float64) -> "NormalEquations":
        """Take the equations from `weighted_products` (n + 1, n + 1) of rows that hold J, then r."""
        return cls(products[:-1, :-1], products[:-1, -1])

    def __add__(self, other: "NormalEquations") -> "NormalEquations":
        return NormalEquations(self.matrix + other.matrix, self.gradient + other.gradient)

    def damped(self) -> "NormalEquations":
        """Add a share of the trace to the diagonal, so that unconstrained directions do not move."""
        damping = DAMPING * np.trace(self.matrix)
        return NormalEquations(self.matrix + damping * np.eye(len(self.matrix)), self.gradient)

    def step(self) -> Float64:
        """Solve for the step (n,). LinAlgError: the matrix is singular."""
        return np.asarray(np.linalg.solve(self.matrix, self.gradient))


def descend(
    advance: Callable[[State], tuple[State, float]], state: State, steps: int, still: float = 0.0
) -> tuple[State, float]:
    """Repeat `advance`; return the last state and the size of the last step, inf if no step was made.

    `advance` returns the next state and the size of the step to it; a step smaller than `still` is the last.
    """
    moved = np.inf
    for _ in range(steps):
        state, moved = advance(state)
        if moved < still:
            break
    return state, moved


def robust_weights(distances: Float64, counts: Float64 | float = 1.0, power: int = 1) -> Float64:
    """Return weights (n,), with sum 1, of residuals of sizes `distances` (n,) >= 0: small for outliers.

    They are proportional to counts / (1 + (d / s)^2)^power, where s is three median distances, and `counts`
    are weights without regard to outliers. Power 1 is Cauchy's function; 2 is Geman and McClure's, which
    nearly ignores outliers.
    """
    if not len(distances):
        return distances
    # The same as `np.median`, in a third of the time.
    middle = (len(distances) - 1) // 2, len(distances) // 2
    median = float(np.partition(distances, middle)[list(middle)].sum()) / 2
    half = HALF_AT_MEDIANS * max(median, 1e-9)
    weights = np.asarray(counts / (1 + (distances / half) ** 2) ** power)
    return np.asarray(weights / weights.sum())


def eliminated(products: Float64, first: int, information: Float64) -> tuple[Float64, Float64]:
    """Eliminate the first unknowns from a sum of products by the Schur complement.

    Args:
        products: (n, n), result of `weighted_products` for rows with the residual last.
        first: number of unknowns to eliminate.
        information: (first, first) of a prior of these unknowns.

    Returns:
        The products of the remaining unknowns x, and F (first, n - first). The eliminated unknowns are
        F[:, -1] - F[:, :-1] x.
    """
    own = products[:first, :first] + information
    follows = np.asarray(np.linalg.solve(own, products[:first, first:]), np.float64)
    return products[first:, first:] - products[first:, :first] @ follows, follows


def weighted_products(rows: Float64, weights: Float64) -> Float64:
    """Return the sum of w r r^T, (n, n), over rows r of (m, n) with weights w (m,)."""
    sums = np.zeros((rows.shape[1], rows.shape[1]))
    add_products(sums, np.ascontiguousarray(rows.T), weights, len(weights))
    return np.asarray(symmetric_matrix(sums))


@numba.njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"}, nogil=True)
def add_products(sums, rows, weights, m):  # type: ignore[no-untyped-def]
    """Add R W R^T to the lower triangle of `sums` (n, n): R: the first m columns of `rows`, W: their weights.

    BLAS is slower here: its threads wait longer for work than they compute.
    """
    for i in range(len(sums)):
        for j in range(i + 1):
            total = 0.0
            for k in range(m):
                total += weights[k] * rows[i, k] * rows[j, k]
            sums[i, j] += total


@numba.njit(cache=True, error_model="numpy", nogil=True)
def symmetric_matrix(lower):  # type: ignore[no-untyped-def]
    """Return the full symmetric matrix, given its lower triangle."""
    return lower + np.tril(lower, -1).T


@numba.njit(cache=True, error_model="numpy", nogil=True)
def projective_residuals(points, normals, depth, facing, intrinsics, T, gate_m, min_facing):  # type: ignore[no-untyped-def]
    """Return point-to-plane residuals n . (q - T p), (m,) metres.

    q is the point measured at the pixel of T p. n is turned into the frame of depth's camera. A residual is
    NaN also where T p is less than 0.1 m ahead, outside the image, or on a pixel without depth.

    Args:
        points: (m, 3 or more), metres; the first three columns are p.
        normals: (m, 3 or more); the first three columns are n, the normals of the points.
        depth: (height, width), metres, 0 = none.
        facing: (height, width, 3) normals of depth, or empty: not compared.
        intrinsics: fx, fy, cx, cy of depth.
        T: (4, 4) from the points' frame to the frame of depth's camera.
        gate_m: largest difference to the measured depth along z; the residual is NaN beyond it.
        min_facing: smallest cosine between the two normals; the residual is NaN below it.
    """
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    residuals = np.full(len(points), np.nan)
    for i in range(len(points)):
        p, n = points[i], normals[i]
        x = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
        y = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
        z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
        if z <= 0.1:
            continue
        u, v = fx * x / z + cx + 0.5, fy * y / z + cy + 0.5
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        column, row = int(u), int(v)
        d = depth[row, column]
        if d <= 0 or abs(d - z) > gate_m:
            continue
        nx = T[0, 0] * n[0] + T[0, 1] * n[1] + T[0, 2] * n[2]
        ny = T[1, 0] * n[0] + T[1, 1] * n[1] + T[1, 2] * n[2]
        nz = T[2, 0] * n[0] + T[2, 1] * n[1] + T[2, 2] * n[2]
        if facing.size:
            m = facing[row, column]
            if nx * m[0] + ny * m[1] + nz * m[2] < min_facing:
                continue
        dx, dy = (column - cx) / fx * d - x, (row - cy) / fy * d - y
        residuals[i] = nx * dx + ny * dy + nz * (d - z)
    return residuals
