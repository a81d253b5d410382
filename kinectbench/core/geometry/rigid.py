"""Rigid transforms as 4x4 float64 matrices: `points_a = T_a_b @ points_b`; small motions as twists.

A twist is a rotation vector (radians) and a translation (metres), stacked.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinectbench.core.types import Float64

# For entries of a rotation matrix; rounding leaves a ten-thousandth of this.
ORTHONORMAL_TOLERANCE = 1e-6
# For an untrusted similarity: products of float32 leave 1e-6; 1e-4 moves a point at 1 m by 0.1 mm.
SIMILAR_TOLERANCE = 1e-4
# From millimetres to metres the scale is 1e-3; a shape 1 unit wide in a room of a thousand units is far below
# (chosen here).
MOST_SCALE = 1e6
# 16-bit depth in millimetres ends at 66 m.
MOST_SHIFT_M = 100.0


def rigid(rotation: ArrayLike, translation_m: ArrayLike) -> Float64:
    """Assemble a 4x4 transform from a (3, 3) rotation and a (3,) translation in metres."""
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = translation_m
    return T


def is_rigid(T: Float64) -> bool:
    """Whether a (4, 4) matrix is a rotation (orthonormal, determinant +1) and a translation."""
    R = T[:3, :3]
    return bool(
        np.allclose(R @ R.T, np.eye(3), rtol=0, atol=ORTHONORMAL_TOLERANCE)
        and np.linalg.det(R) > 0
        and np.isfinite(T).all()
        and np.array_equal(T[3], [0, 0, 0, 1])
    )


def similarity_scale(T: Float64) -> float:
    """Return the scale of a (4, 4) similarity."""
    return float(np.cbrt(np.linalg.det(T[:3, :3])))


def similarity_problem(T: Float64) -> str | None:
    """Return why a finite (4, 4) matrix is no similarity, or has an unusual scale or shift; None if fine.

    A similarity is a rotation with determinant +1 times a scale > 0, plus a shift; it maps column vectors.
    """
    if not np.array_equal(T[3], [0, 0, 0, 1]):
        is_of_rows = T[3, 3] == 1 and not T[:3, 3].any()
        advice = "it is made for row vectors: transpose it" if is_of_rows else "write that"
        return f"its last row is not 0 0 0 1; {advice}"
    if np.abs(T[:3, :3]).max() > MOST_SCALE:
        return f"its scale is not within {1 / MOST_SCALE:g} and {MOST_SCALE:g}"
    determinant = float(np.linalg.det(T[:3, :3]))
    if not determinant > 0:
        kind = "mirrors" if determinant < 0 else "flattens"
        return f"it {kind} the shape; its rotation must have determinant +1 and its scale must be > 0"
    scale = similarity_scale(T)
    R = T[:3, :3] / scale
    if not np.allclose(R @ R.T, np.eye(3), rtol=0, atol=SIMILAR_TOLERANCE):
        return "it shears, or scales its axes differently; a rotation, one scale and a shift are accepted"
    if not 1 / MOST_SCALE <= scale <= MOST_SCALE:
        return f"its scale {scale:.3g} is not within {1 / MOST_SCALE:g} and {MOST_SCALE:g}"
    if np.abs(T[:3, 3]).max() > MOST_SHIFT_M:
        return f"it shifts by more than {MOST_SHIFT_M:g} m; write metres"
    return None


def invert_rigid(T_a_b: Float64) -> Float64:
    """Invert rigid transforms of shape (..., 4, 4): returns T_b_a."""
    rotation_b_a = np.swapaxes(T_a_b[..., :3, :3], -1, -2)
    T_b_a = np.zeros_like(T_a_b)
    T_b_a[..., :3, :3] = rotation_b_a
    T_b_a[..., :3, 3] = -(rotation_b_a @ T_a_b[..., :3, 3, None])[..., 0]
    T_b_a[..., 3, 3] = 1.0
    return T_b_a


def invert_similarity(T: Float64) -> Float64:
    """Invert a (4, 4) similarity: a rotation times a scale, and a shift."""
    linear = T[:3, :3].T / (T[:3, 0] @ T[:3, 0])
    return rigid(linear, -(linear @ T[:3, 3]))


def transform_points(T_a_b: Float64, points_b: NDArray[np.floating]) -> Float64:
    """Map points of shape (..., 3) from frame b to frame a; float64, same shape."""
    return np.asarray(points_b, dtype=np.float64) @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def closest_rotation(matrix: Float64) -> Float64:
    """Project (..., 3, 3) matrices onto SO(3) in the Frobenius norm (orthogonal Procrustes by SVD)."""
    u, _, vt = np.linalg.svd(matrix)
    sign = np.sign(np.linalg.det(u @ vt))
    u[..., :, 2] *= sign[..., None]
    result: Float64 = u @ vt
    return result


def rotation_angle_rad(rotation: Float64) -> Float64:
    """Rotation angle in radians of (..., 3, 3) rotations, accurate for small angles."""
    skew = rotation - np.swapaxes(rotation, -1, -2)
    axis = skew[..., [2, 0, 1], [1, 2, 0]]
    trace = np.trace(rotation, axis1=-2, axis2=-1)
    angle: Float64 = np.arctan2(np.linalg.norm(axis, axis=-1), trace - 1.0)
    return angle


def rotation_from_quaternion_xyzw(quaternion_xyzw: ArrayLike) -> Float64:
    """Turn quaternions (..., 4), order x y z w, into rotations (..., 3, 3). ValueError: length 0."""
    from scipy.spatial.transform import Rotation

    q = np.asarray(quaternion_xyzw, dtype=np.float64)
    if not (np.linalg.norm(q, axis=-1) > 0).all():
        raise ValueError("a rotation whose quaternion has no length")
    return np.reshape(Rotation.from_quat(q.reshape(-1, 4)).as_matrix(), (*q.shape[:-1], 3, 3))


def quaternion_xyzw_from_rotation(rotation: Float64) -> Float64:
    """Turn rotations (..., 3, 3) into unit quaternions (..., 4), x y z w, w >= 0. ValueError: no rotation."""
    return np.reshape(_rotations(rotation).as_quat(canonical=True), (*rotation.shape[:-2], 4))


def interpolate_rigid(T_a_b0: Float64, T_a_b1: Float64, fraction: ArrayLike) -> Float64:
    """Interpolate between transforms: slerp for the rotation, linear for the translation.

    Args:
        T_a_b0: (..., 4, 4), the result at fraction 0.
        T_a_b1: (..., 4, 4), the result at fraction 1.
        fraction: (...) in [0, 1].
    """
    share = np.asarray(fraction, np.float64)[..., None, None]
    before = _rotations(T_a_b0[..., :3, :3])
    turn = before.inv() * _rotations(T_a_b1[..., :3, :3])
    T = T_a_b0 + share * (T_a_b1 - T_a_b0)
    rotation = (before * type(turn).from_rotvec(turn.as_rotvec() * share.reshape(-1, 1))).as_matrix()
    T[..., :3, :3] = rotation.reshape(T[..., :3, :3].shape)
    return T


def _rotations(rotation: Float64) -> Any:
    """Turn (..., 3, 3) rotations into one scipy `Rotation`."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(rotation.reshape(-1, 3, 3))


def rigid_from_twist(twist: NDArray[np.floating]) -> Float64:
    """Turn a twist (6,), rotation vector (radians) and translation (metres), into a transform (4, 4)."""
    import cv2

    return rigid(np.asarray(cv2.Rodrigues(twist[:3])[0]), twist[3:])


def on_so3(T: Float64) -> Float64:
    """Project the rotation of T (4, 4) onto SO(3), from which products of many transforms drift away."""
    return rigid(closest_rotation(T[:3, :3]), T[:3, 3])


def twist_from_rigid(T: Float64) -> Float64:
    """Turn a transform (4, 4) into its twist (6,): the inverse of `rigid_from_twist`."""
    import cv2

    return np.concatenate([cv2.Rodrigues(np.ascontiguousarray(T[:3, :3]))[0].ravel(), T[:3, 3]])
