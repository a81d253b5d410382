"""Smooth the trajectory as far as the uncertainty of its poses allows.

Frames are registered one by one. In directions that a frame's depth hardly constrains, its neighbours give a
better estimate. The prior is white noise on acceleration (Anderson & Barfoot, "Full STEAM ahead", IROS 2015).
Its variance is estimated from the trajectory itself. A Geman-McClure kernel lowers the weight of a jolt.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_diag, diags_array, eye_array, kron
from scipy.sparse.linalg import spsolve

from kinectbench.core.geometry import invert_rigid, rigid_from_twist, twist_from_rigid
from kinectbench.core.types import Float64

# Number of reweightings by the kernel.
ITERATIONS = 6
# Median of the mean of three squared standard normal variables.
MEDIAN_OF_THREE = 0.789
# At most this ratio of the measured acceleration variance counts as noise. The rest is doubled, because
# motion is uneven.
MAX_NOISE, ROUGHER = 0.5, 2.0
# Mean squared acceleration, in standard deviations, at which a frame loses three quarters of its weight.
KERNEL = 9.0
# Regularises a frame without information: radians and metres.
LOOSE = 1e-3
# Smallest time step that is counted, as a share of the median step: stamps may be equal.
LEAST_STEP = 0.1
# With fewer frames the usual accelerations are unknown: three frames have one.
MIN_FRAMES = 5


def smoothed(T_world_camera: Float64, stamps_ns: NDArray[np.int64], information: Float64) -> Float64:
    """Return the trajectory that best fits both the registrations and the motion prior.

    Args:
        T_world_camera: (n, 4, 4), all finite.
        stamps_ns: (n,) stamps, in any order.
        information: (n, 6, 6) inverse covariance of each pose's twist (rotation, translation).

    Returns:
        (n, 4, 4) smoothed poses; fewer than five are returned unchanged.
    """
    if len(T_world_camera) < MIN_FRAMES:
        return T_world_camera
    order = np.argsort(stamps_ns, kind="stable")
    poses, known = T_world_camera[order], information[order] + LOOSE * np.eye(6)
    weights = second_differences(stamps_ns[order] / 1e9)
    rough = _accelerations(poses, stamps_ns[order] / 1e9)
    variance, noise_scale = _variances(rough, weights, known)
    operator = kron(diags_array(weights, offsets=[0, 1, 2], shape=(len(rough), len(poses))), eye_array(6))
    measured = block_diag(known / noise_scale).tocsc()
    twists = np.zeros(6 * len(poses))
    for _ in range(ITERATIONS):
        squares = ((rough + (operator @ twists).reshape(-1, 6)) ** 2 / variance).mean(axis=1)
        accepted = ((KERNEL / (KERNEL + squares)) ** 2)[:, None] / variance
        weighted = operator.T @ diags_array(accepted.ravel())
        twists = spsolve((measured + weighted @ operator).tocsc(), -(weighted @ rough.ravel()))
    result = np.empty_like(T_world_camera)
    result[order] = [T @ rigid_from_twist(x) for T, x in zip(poses, twists.reshape(-1, 6), strict=True)]
    return result


def second_differences(times_s: Float64) -> list[Float64]:
    """Return weights (1/s^2) of three consecutive values for their second derivative: 3 arrays (n - 2,)."""
    before, behind, span = _spans(times_s)
    first, last = 1 / (before * span), 1 / (behind * span)
    return [first, -(first + last), last]


def _spans(times_s: Float64) -> tuple[Float64, Float64, Float64]:
    """Return the time before each inner frame, the time after it, and the mean of both: (n - 2,) each, s.

    A time step shorter than a tenth of the median step is replaced by that tenth.
    """
    steps = np.diff(times_s)
    steps = np.maximum(steps, LEAST_STEP * max(float(np.median(steps)), 1e-6))
    return steps[:-1], steps[1:], (steps[:-1] + steps[1:]) / 2


def _accelerations(poses: Float64, times_s: Float64) -> Float64:
    """Accelerations (n - 2, 6) at the inner frames: change of the twist per second, camera axes."""
    before, behind, span = _spans(times_s)
    moves = np.array([twist_from_rigid(T) for T in invert_rigid(poses[:-1]) @ poses[1:]])
    return np.asarray((moves[1:] / behind[:, None] - moves[:-1] / before[:, None]) / span[:, None])


def _variances(accelerations: Float64, weights: list[Float64], information: Float64) -> tuple[Float64, float]:
    """Split the measured accelerations (n - 2, 6) into the camera's motion and the noise of its poses.

    `weights` are the result of `second_differences`; `information` (n, 6, 6) belongs to the poses.

    Returns:
        (6,) variance of the camera's own accelerations; and the scale factor for the poses' covariance.
    """
    uncertain = np.diagonal(np.linalg.inv(information), axis1=1, axis2=2)
    inner = len(accelerations)
    noise = np.sum([w[:, None] ** 2 * uncertain[k : k + inner] for k, w in enumerate(weights)], axis=0)
    rotation, translation = slice(0, 3), slice(3, 6)
    parts = [
        (
            float(np.median((accelerations[:, part] ** 2).mean(axis=1))) / MEDIAN_OF_THREE,
            float(np.median(noise[:, part].mean(axis=1))),
        )
        for part in (rotation, translation)
    ]
    # A smooth path shows that the poses are better than their stated covariance.
    noise_scale = min(1.0, *(MAX_NOISE * measured / added for measured, added in parts))
    own = [ROUGHER * (measured - noise_scale * added) for measured, added in parts]
    return np.maximum(np.repeat(own, 3), 1e-12), max(noise_scale, 1e-6)
