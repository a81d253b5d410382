"""Absolute and relative errors of an estimated trajectory against a reference (Sturm et al. 2012).

`T_world_camera` of both may refer to different worlds: the estimate is aligned first, without scale.
"""

from dataclasses import dataclass

import numpy as np

from kinectbench.core.errors import TrackingError
from kinectbench.core.geometry import (
    closest_rotation,
    invert_rigid,
    rigid,
    rotation_angle_rad,
    transform_points,
)
from kinectbench.core.trajectory.association import associate, half_step_ns
from kinectbench.core.types import Bools, Float64, Int64

MIN_MATCHED = 3
# Length of the pieces of path over which drift is measured, within a tenth.
PIECE_M = 1.0
PIECE_TOLERANCE_M = 0.1
# Camera positions that spread less than this about a line do not determine a rotation between worlds.
MIN_SPREAD_M = 0.05


@dataclass(frozen=True)
class ErrorStatistics:
    """Statistics of errors, all >= 0, in the unit of the `TrajectoryError` field that holds them."""

    rmse: float
    mean: float
    median: float
    max: float


@dataclass(frozen=True)
class TrajectoryError:
    """Errors of an estimated trajectory against a reference, over the poses that both have.

    Attributes:
        matched: number of these poses, n.
        T_reference_estimate: (4, 4), from the estimate's world to the reference's (the alignment of ATE).
        ate_m: statistics of the distances of the aligned positions; its rmse is the absolute error, ATE.
        rpe_frame_m: statistics of the relative translation errors between one pose and the next.
        rpe_frame_rad: the same for rotation.
        rpe_metre_m: the same for translation over a metre of path; None if no piece is that long.
        rpe_metre_rad: the same for rotation over a metre of path; None if no piece is that long.
        position_errors_m: (n,) distances of the aligned positions, in the order given.
    """

    matched: int
    T_reference_estimate: Float64
    ate_m: ErrorStatistics
    rpe_frame_m: ErrorStatistics
    rpe_frame_rad: ErrorStatistics
    rpe_metre_m: ErrorStatistics | None
    rpe_metre_rad: ErrorStatistics | None
    position_errors_m: Float64


def has_pose(T: Float64) -> Bools:
    """Whether each transform (n, 4, 4) is finite: (n,) bool."""
    return np.asarray(np.isfinite(T).all(axis=(1, 2)))


def match_stamps(estimate_ns: Int64, reference_ns: Int64) -> tuple[Int64, Int64]:
    """Pair the stamps of two trajectories one to one.

    Equal stamps are paired first. The others are paired if they differ by half a frame at most: as many pairs
    as possible, and among those the smallest sum of differences (`association.associate`). Half a frame is
    half the smaller of the two median intervals, so that a stamp is never paired with one of the next frame.

    Args:
        estimate_ns: (k,) int64, any order.
        reference_ns: (m,) int64, any order, same clock.

    Returns:
        Indices into the estimate and into the reference, (n,) int64 each, ordered by the estimate's stamps.
    """
    _, first, second = np.intersect1d(estimate_ns, reference_ns, return_indices=True)
    unmatched, rest_reference = (
        np.setdiff1d(np.unique(stamps, return_index=True)[1], used)
        for stamps, used in ((estimate_ns, first), (reference_ns, second))
    )
    # np.setdiff1d sorts by index; the association needs the order of time.
    unmatched = unmatched[np.argsort(estimate_ns[unmatched], kind="stable")]
    rest_reference = rest_reference[np.argsort(reference_ns[rest_reference], kind="stable")]
    half_ns = min(half_step_ns(estimate_ns), half_step_ns(reference_ns))
    partners = associate(estimate_ns[unmatched].tolist(), reference_ns[rest_reference].tolist(), half_ns)
    near = [(unmatched[i], rest_reference[j]) for i, j in enumerate(partners) if j is not None]
    pairs = np.array([*zip(first, second, strict=True), *near], dtype=np.int64).reshape(-1, 2)
    estimate, reference = pairs[np.argsort(estimate_ns[pairs[:, 0]], kind="stable")].T
    return estimate, reference


def compare_poses(T_estimate: Float64, T_reference: Float64) -> TrajectoryError:
    """Compute the absolute and relative trajectory errors of matched poses.

    ATE: the distances |p_i - S q_i| of the positions, with the rigid least-squares S (Sturm et al., "A
    benchmark for the evaluation of RGB-D SLAM systems", IROS 2012, eq. 2; Umeyama 1991 without scale). RPE:
    translation and angle of E = (P_i^-1 P_j)^-1 (Q_i^-1 Q_j) (eq. 1), for j = i + 1, and for the pose j whose
    path from i along the reference is closest to 1 m (0.9 to 1.1 m).

    Args:
        T_estimate: (n, 4, 4) `T_world_camera`, n >= 3, in the order of time.
        T_reference: (n, 4, 4), the reference pose for each of these.

    Raises:
        TrackingError: fewer than three poses.
    """
    n = len(T_estimate)
    if n < MIN_MATCHED:
        raise TrackingError(
            f"only {n} poses of the two trajectories match by stamp, and {MIN_MATCHED} are needed; "
            "are they of one recording, on one clock?",
            what="no-match",
        )
    T_reference_estimate = align_positions(T_estimate[:, :3, 3], T_reference[:, :3, 3])
    aligned = transform_points(T_reference_estimate, T_estimate[:, :3, 3])
    errors_m = np.linalg.norm(aligned - T_reference[:, :3, 3], axis=1)
    i = np.arange(n - 1)
    frame_m, frame_rad = _relative_errors(T_estimate, T_reference, i, i + 1)
    metre_m, metre_rad = _relative_errors(T_estimate, T_reference, *_pieces(T_reference[:, :3, 3]))
    return TrajectoryError(
        matched=n,
        T_reference_estimate=T_reference_estimate,
        ate_m=statistics(errors_m),
        rpe_frame_m=statistics(frame_m),
        rpe_frame_rad=statistics(frame_rad),
        rpe_metre_m=statistics(metre_m) if len(metre_m) else None,
        rpe_metre_rad=statistics(metre_rad) if len(metre_rad) else None,
        position_errors_m=errors_m,
    )


def align_positions(points_b: Float64, points_a: Float64) -> Float64:
    """Return the rigid T_a_b that minimises the sum of |a_i - T_a_b b_i|^2.

    Source: Umeyama, "Least-squares estimation of transformation parameters" (PAMI 1991), without scale.

    Args:
        points_b: (n, 3), n > 0.
        points_a: (n, 3), the same points in the other frame.
    """
    mean_a, mean_b = points_a.mean(axis=0), points_b.mean(axis=0)
    rotation = closest_rotation((points_a - mean_a).T @ (points_b - mean_b))
    return rigid(rotation, mean_a - rotation @ mean_b)


def align_worlds(T_estimate: Float64, T_reference: Float64) -> Float64:
    """Return the rigid transform from the estimate's world to the reference's, also for degenerate positions.

    It aligns the positions, as for the ATE. With fewer than three poses, or if the cameras stand still or
    move along a line (less than 5 cm rms about it), the rotation comes from the orientations.

    Args:
        T_estimate: (n, 4, 4) `T_world_camera`, n > 0.
        T_reference: (n, 4, 4), poses of the same cameras in the reference's world.
    """
    points_estimate, points_reference = T_estimate[:, :3, 3], T_reference[:, :3, 3]
    centred = points_reference - points_reference.mean(axis=0)
    spread_m = np.linalg.svd(centred, compute_uv=False)[1] / np.sqrt(len(centred)) if len(centred) > 1 else 0
    if len(centred) >= MIN_MATCHED and spread_m >= MIN_SPREAD_M:
        return align_positions(points_estimate, points_reference)
    turns = T_reference[:, :3, :3] @ np.swapaxes(T_estimate[:, :3, :3], 1, 2)
    rotation = closest_rotation(turns.sum(axis=0))
    return rigid(rotation, points_reference.mean(axis=0) - rotation @ points_estimate.mean(axis=0))


def statistics(errors: Float64) -> ErrorStatistics:
    """Root mean square, mean, median and maximum of errors (n,), n > 0, in the unit of the errors."""
    return ErrorStatistics(
        rmse=float(np.sqrt(np.mean(errors**2))),
        mean=float(errors.mean()),
        median=float(np.median(errors)),
        max=float(errors.max()),
    )


def _relative_errors(
    T_estimate: Float64, T_reference: Float64, i: Int64, j: Int64
) -> tuple[Float64, Float64]:
    """Return translation (m) and angle (rad) of the relative pose errors from poses i to poses j."""
    moved_estimate = invert_rigid(T_estimate[i]) @ T_estimate[j]
    moved_reference = invert_rigid(T_reference[i]) @ T_reference[j]
    error = invert_rigid(moved_reference) @ moved_estimate
    return np.linalg.norm(error[:, :3, 3], axis=1), rotation_angle_rad(error[:, :3, :3])


def _pieces(positions: Float64) -> tuple[Int64, Int64]:
    """Find pieces of the path, each about 1 m long; return the indices of their first and last poses.

    Each pose is paired with the later pose closest to 1 m along the path, if that is 0.9 to 1.1 m away.
    """
    steps_m = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    path_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    first = np.arange(len(path_m) - 1)
    # The path ascends: the closest pose is the first one beyond, or the one before it.
    beyond = np.clip(np.searchsorted(path_m, path_m[first] + PIECE_M), first + 1, len(path_m) - 1)
    before = np.maximum(beyond - 1, first + 1)
    off_beyond_m, off_before_m = (np.abs(path_m[at] - path_m[first] - PIECE_M) for at in (beyond, before))
    last = np.where(off_before_m <= off_beyond_m, before, beyond)
    # Of poses at one place the first.
    last = np.maximum(np.searchsorted(path_m, path_m[last]), first + 1)
    fits = np.abs(path_m[last] - path_m[first] - PIECE_M) <= PIECE_TOLERANCE_M
    return first[fits], last[fits]
