"""Pose-graph optimisation with a robust kernel: keyframe poses that agree best with all constraints.

Levenberg-Marquardt on SE(3) with a sparse solver. Constraints that contradict the rest lose their weight by a
Geman-McClure kernel that is tightened step by step (graduated non-convexity: Yang, Antonante, Tzoumas &
Carlone, RA-L 2020), so that the result does not depend on the initial poses.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation

from kinectbench.core.geometry import invert_rigid, on_so3, rigid_from_twist, twist_from_rigid
from kinectbench.core.geometry.gauss_newton import descend
from kinectbench.core.types import Float64
from kinectbench.stages.track.tracked import Constraint

# Systematic error of a constraint between equal views, by calibration and depth distortion: radians, metres.
SYSTEMATIC = np.array([0.0007] * 3 + [0.001] * 3)
# The systematic error grows as the views overlap less, and by this factor with the ratio of outliers.
PER_DISAGREEING_SHARE = 100.0
# A lower overlap counts as this one.
LEAST_OVERLAP = 0.1
# Regularises unconstrained directions: a step of one radian or one metre costs this much.
LOOSE = 1e-3
# Damping (Levenberg and Marquardt) after a step that raises the cost, and after one that lowers it.
DAMPED, UNDAMPED = 30, 10
# Information of the first pose where no prior holds it: it does not move.
HELD = 1e12
# Squared error of a constraint, in its standard deviations, at which it loses three quarters of its weight.
KERNEL = 30.0
# Information of the priors: standard deviations of 30 mrad and 50 mm.
PRIOR = np.diag([0.03**-2] * 3 + [0.05**-2] * 3)
# Largest number of steps with the last kernel; with each kernel before it, which need not converge; and the
# final step size.
ITERATIONS, COARSE_ITERATIONS, STEP_ENOUGH = 40, 4, 1e-6
# Number of kernels, from one that keeps every constraint to the last, evenly spaced by the logarithm.
TIGHTENINGS = 8


def optimise(
    T_world: Float64,
    constraints: Sequence[Constraint],
    nodes: Sequence[tuple[int, int]],
    T_prior: Float64 | None = None,
) -> tuple[Float64, Float64]:
    """Optimise poses so that they agree best with the constraints.

    Args:
        T_world: (k, 4, 4) initial poses; the first stays fixed, unless there are priors.
        constraints: measured T_a_b with information.
        nodes: for each constraint, the rows of its two keyframes in `T_world`.
        T_prior: (k, 4, 4) poses used as weak priors, NaN where unknown; or None.

    Returns:
        (k, 4, 4) poses, and weights of the constraints, (number of constraints,), 0 to 1.
    """
    poses = T_world.copy()
    measured = np.array([constraint.T_a_b for constraint in constraints]).reshape(-1, 4, 4)
    information = np.array([softened(constraint) for constraint in constraints]).reshape(-1, 6, 6)
    ends = np.array(nodes, int).reshape(-1, 2)
    weights = np.ones(len(constraints))
    if len(poses) == 1 or not len(constraints):
        return poses, weights
    graph = _Graph(measured, information, ends, T_prior)
    largest = graph.squared(poses).max(initial=0.0)
    kernels = KERNEL * np.maximum(1.0, (largest / KERNEL) ** np.linspace(1, 0, TIGHTENINGS))
    for kernel in kernels:
        poses = np.array([on_so3(T) for T in poses])
        poses = graph.descend(poses, kernel, ITERATIONS if kernel == kernels[-1] else COARSE_ITERATIONS)
    return poses, graph.weights(poses, KERNEL)


def softened(constraint: Constraint) -> Float64:
    """Return the information (6, 6) of a constraint with systematic errors included: (A^-1 + S)^-1.

    A is the information of its registration, which may be singular, and S the systematic covariance.
    """
    A = constraint.registration.information
    systematic = np.diag((SYSTEMATIC * growth(constraint)) ** 2)
    return np.asarray(A - A @ np.linalg.solve(A + np.linalg.inv(systematic), A))


def growth(constraint: Constraint) -> float:
    """Return the factor on a constraint's systematic error: 1 at full overlap without outliers, else more.

    It grows as the overlap falls and as the outlier ratio rises; the formula was fitted to simulated orbits.
    """
    edge = constraint.registration
    return (1 + PER_DISAGREEING_SHARE * (1 - edge.inlier_share)) / max(edge.overlap, LEAST_OVERLAP) ** 2


@dataclass(frozen=True)
class _Graph:
    """The m constraints between k poses, and the priors, as arrays.

    The argument `kernel` of its methods is the squared error, in squared standard deviations, at which a
    constraint has a quarter of its weight; `poses` are (k, 4, 4).

    Attributes:
        measured: (m, 4, 4) the constraints' T_a_b.
        information: (m, 6, 6) their information.
        ends: (m, 2) the rows of a and b in `poses`.
        T_prior: (k, 4, 4) poses used as weak priors, NaN where unknown; or None.
    """

    measured: Float64
    information: Float64
    ends: NDArray[np.int64]
    T_prior: Float64 | None

    def descend(self, poses: Float64, kernel: float, iterations: int) -> Float64:
        """Lower the cost by Levenberg-Marquardt; after a step that raises it, retry with more damping."""

        def advance(state: tuple[Float64, float, float]) -> tuple[tuple[Float64, float, float], float]:
            """Return the next poses, cost and damping, and the size of the step."""
            poses, cost, damping = state
            step = self.step(poses, kernel, damping)
            moved = poses @ np.array([rigid_from_twist(twist) for twist in step])
            lower = self.cost(moved, kernel)
            if lower > cost:
                return (poses, cost, DAMPED * damping), np.inf
            return (moved, lower, max(damping / UNDAMPED, 1e-9)), float(np.abs(step).max())

        return descend(advance, (poses, self.cost(poses, kernel), 1e-6), iterations, STEP_ENOUGH)[0][0]

    def weights(self, poses: Float64, kernel: float) -> Float64:
        """Geman-McClure weights (m,) of the constraints."""
        return np.asarray((kernel / (kernel + self.squared(poses))) ** 2)

    def squared(self, poses: Float64) -> Float64:
        """Squared errors (m,) of the constraints, in squared standard deviations."""
        errors = _errors(poses, self.measured, self.ends)
        return np.asarray(np.einsum("mi,mij,mj->m", errors, self.information, errors))

    def cost(self, poses: Float64, kernel: float) -> float:
        """Return the sum of the kernel costs of all constraints and priors."""
        squares = self.squared(poses)
        total = float((kernel * squares / (kernel + squares)).sum())
        for _, error in self._priors(poses):
            square = float(error @ PRIOR @ error)
            total += KERNEL * square / (KERNEL + square)
        return total

    def step(self, poses: Float64, kernel: float, damping: float) -> Float64:
        """Return the twists (k, 6) of one damped Gauss-Newton step."""
        k = len(poses)
        errors = _errors(poses, self.measured, self.ends)[..., None]
        information = self.weights(poses, kernel)[:, None, None] * self.information
        jacobians = -adjoint(invert_rigid(self.measured))
        to_a = np.swapaxes(jacobians, 1, 2) @ information
        a, b = self.ends.T
        diagonal, gradient = np.zeros((k, 6, 6)), np.zeros((k, 6, 1))
        np.add.at(diagonal, a, to_a @ jacobians)
        np.add.at(diagonal, b, information)
        np.add.at(gradient, a, -(to_a @ errors))
        np.add.at(gradient, b, -(information @ errors))
        for node, error in self._priors(poses):
            # The robust kernel switches off a prior that is far off.
            weight = 1 / (1 + error @ PRIOR @ error / KERNEL) ** 2
            diagonal[node] += weight * PRIOR
            gradient[node, :, 0] -= weight * PRIOR @ error
        if self.T_prior is None:
            diagonal[0] += HELD * np.eye(6)
        across = np.arange(6)
        diagonal[:, across, across] += damping * diagonal[:, across, across] + LOOSE
        nodes = np.arange(k)
        return _solve(
            np.concatenate([diagonal, to_a, np.swapaxes(to_a, 1, 2)]),
            np.concatenate([nodes, a, b]),
            np.concatenate([nodes, b, a]),
            gradient,
        )

    def _priors(self, poses: Float64) -> Iterator[tuple[int, Float64]]:
        if self.T_prior is None:
            return
        for node in np.flatnonzero(np.isfinite(self.T_prior).all(axis=(1, 2))):
            yield int(node), twist_from_rigid(invert_rigid(self.T_prior[node]) @ poses[node])


def _errors(poses: Float64, measured: Float64, ends: NDArray[np.int64]) -> Float64:
    """Errors measured^-1 T_a^-1 T_b (m, 6): rotation vector, radians, and translation, metres.

    `measured` (m, 4, 4) are the constraints' T_a_b, `ends` (m, 2) the rows of a and b in `poses` (k, 4, 4).
    To first order, a twist of T_b adds to the error, and a twist of T_a adds -Ad(measured^-1) times itself.
    """
    back = invert_rigid(measured)
    relative = back @ invert_rigid(poses[ends[:, 0]]) @ poses[ends[:, 1]]
    return np.concatenate([Rotation.from_matrix(relative[:, :3, :3]).as_rotvec(), relative[:, :3, 3]], axis=1)


def adjoint(T: Float64) -> Float64:
    """Adjoint (m, 6, 6) of T_a_b (m, 4, 4): maps twists (rotation, translation) from frame b to frame a."""
    rotation, t = T[:, :3, :3], T[:, :3, 3]
    cross = np.zeros_like(rotation)
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -t[:, 2], t[:, 1], -t[:, 0]
    cross[:, 1, 0], cross[:, 2, 0], cross[:, 2, 1] = t[:, 2], -t[:, 1], t[:, 0]
    result = np.zeros((len(T), 6, 6))
    result[:, :3, :3], result[:, 3:, 3:], result[:, 3:, :3] = rotation, rotation, cross @ rotation
    return result


def _solve(blocks: Float64, rows: NDArray[np.int64], columns: NDArray[np.int64], right: Float64) -> Float64:
    """Solve a sparse system of k x k blocks of 6 x 6; return the solution (k, 6).

    Args:
        blocks: (b, 6, 6) the nonzero blocks; blocks at the same place are added.
        rows: (b,) block row of each block.
        columns: (b,) block column of each block.
        right: (k, 6, 1) the right side.
    """
    offsets = np.arange(6)
    i = np.broadcast_to(6 * rows[:, None, None] + offsets[:, None], blocks.shape)
    j = np.broadcast_to(6 * columns[:, None, None] + offsets, blocks.shape)
    size = right.shape[0] * 6
    normal = coo_array((blocks.ravel(), (i.ravel(), j.ravel())), shape=(size, size)).tocsc()
    return np.asarray(spsolve(normal, right.ravel())).reshape(-1, 6)
