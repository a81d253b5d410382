"""Pose conventions of a given trajectory, and the fit of the poses in a convention to the depth."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.even_choice import evenly
from kinectbench.core.geometry import Camera, depth_sigma_m, image_normals, invert_rigid
from kinectbench.core.trajectory.coverage import in_order_of_time
from kinectbench.core.trajectory.pose_convention import AXES, PoseConvention
from kinectbench.core.types import Float64
from kinectbench.doctor.probe import Probe

OTHER_UNITS = (0.001, 1000.0, 0.1, 10.0, 0.2, 5.0)
ANCHORS = 12
# A frame is compared with the frames this many places after it, if they were read.
AHEAD = (1, 4, 12, 40)
# Views in no order of time are compared with their n-th nearest views by angle, for these n.
NEAREST = (1, 2, 4, 8)
POINT_STEP = 7
# A depth error of at least this ratio of the distance counts as entirely wrong.
WRONG_SHARE = 0.1
NEAREST_M = 1e-3
# Poses fit if the residual is at most this many times a Kinect's depth noise of two frames at that distance,
# and at most 50 mm, because the noise at 3 m is large. Measured: correct poses leave 0.6 to 1.2 times the
# noise.
FITTING_NOISES, MOST_FITTING_M = 3.0, 0.05


def likely_conventions() -> Iterator[PoseConvention]:
    """Yield the conventions to try first, beginning with the default."""
    yield from _of_unit(1.0)
    yield from (PoseConvention(unit_m=unit_m) for unit_m in OTHER_UNITS)
    for images in ("mirrored", "y_up", "turned"):
        yield from (PoseConvention(inverse, images=images) for inverse in (False, True))


def further_conventions() -> Iterator[PoseConvention]:
    """Yield the further conventions to try if no likely one fits."""
    for unit_m in OTHER_UNITS:
        yield from (convention for convention in _of_unit(unit_m) if convention.changes > 1)


def _of_unit(unit_m: float) -> Iterator[PoseConvention]:
    for inverse in (False, True):
        for wxyz in (False, True):
            for axes in AXES:
                yield PoseConvention(inverse, axes, wxyz, "upright", unit_m)


@dataclass(frozen=True)
class FramePair:
    """Two frames that should show the same surface, prepared to compare their depth under given poses.

    Attributes:
        first: index of the first frame among the probe's frames.
        second: index of the second frame there.
        points: (n, 3) points of the first frame, in its camera's axes, metres.
        depth_m: (height, width), the small depth image of the second frame, metres, 0 = none.
        camera: intrinsics of this image.
    """

    first: int
    second: int
    points: Float64
    depth_m: NDArray[np.float32]
    camera: Camera


def choose_pairs(probe: Probe, poses: Float64) -> tuple[FramePair, ...]:
    """Choose pairs of frames that have poses, evenly over the recording, some near and some distant.

    Of frames in a row with identical depth, only the first is used: repeated images fit any poses that stand.
    The second frame comes 1 to 40 frames after the first one (near the end: before it). If the poses are not
    in the order of time, the second frame is instead one with a similar orientation: the angle between two
    orientations is the same in every convention.

    Args:
        probe: the probe of the recording.
        poses: (n, 4, 4), poses of the probe's frames, in any convention; NaN where a frame has none.
    """
    camera, frames = probe.small_camera, probe.frames
    kept = [i for i, frame in enumerate(frames) if not i or frame.digest != frames[i - 1].digest]
    count, poses = len(kept), poses[kept]
    has_pose = np.isfinite(poses[:, 0, 0])
    ordered = in_order_of_time(poses)
    rays = camera.rays()[::POINT_STEP, ::POINT_STEP]
    pairs = []
    for first in evenly(count, ANCHORS).tolist():
        if not has_pose[first]:
            continue
        for second in _later(first, count) if ordered else _beside(first, poses):
            if second < 0 or not has_pose[second]:
                continue
            of_first_m, of_second_m = frames[kept[first]].depth_m, frames[kept[second]].depth_m
            if any(depth_m.shape != (camera.height, camera.width) for depth_m in (of_first_m, of_second_m)):
                continue
            z = of_first_m[::POINT_STEP, ::POINT_STEP]
            points = (rays * z[..., None])[z > 0]
            if len(points):
                pairs.append(FramePair(kept[first], kept[second], points, of_second_m, camera))
    return tuple(pairs)


def _later(first: int, count: int) -> list[int]:
    """Return the indices 1, 4, 12 and 40 after `first`.

    An index that is not below `count` is replaced by the index as far before `first`. A negative index means
    that there is no such frame.
    """
    return [first + ahead if first + ahead < count else first - ahead for ahead in AHEAD]


def _beside(first: int, poses: Float64) -> list[int]:
    """Return the 1st, 2nd, 4th and 8th nearest frames to frame `first`, by the angle between orientations."""
    cosine = np.einsum("ij,nij->n", poses[first, :3, :3], poses[:, :3, :3])
    order = [k for k in np.argsort(-cosine, kind="stable").tolist() if k != first and np.isfinite(cosine[k])]
    return [order[rank - 1] for rank in NEAREST if rank <= len(order)]


def fits(residual_m: float, pairs: Sequence[FramePair]) -> bool:
    """Whether the poses fit: `pair_residual_m` of the pairs, metres, is small compared with depth noise."""
    distance_m = float(np.median(np.concatenate([pair.points[:, 2] for pair in pairs])))
    noise_m = np.sqrt(2) * depth_sigma_m(distance_m)
    return bool(residual_m <= min(FITTING_NOISES * noise_m, MOST_FITTING_M))


def frames_of(pairs: Sequence[FramePair]) -> NDArray[np.int64]:
    """Return the indices of all frames that occur in pairs, increasing."""
    return np.unique([index for pair in pairs for index in (pair.first, pair.second)]).astype(np.int64)


def disagreements(pairs: Sequence[FramePair], T_world_camera: Float64) -> Float64:
    """Return the disagreement of poses and depth in each frame pair: the mean error of its points, 0 to 1.

    The first frame's points are projected into the second frame by the poses. A point's error is the absolute
    difference of its depth and the depth measured at its pixel, divided by a tenth of its depth; at most 1.
    Points outside the image count as 1, because wrong poses often leave no overlap. Points at pixels without
    a measurement are left out; without other points the mean is 0.

    Args:
        pairs: the pairs of frames to compare.
        T_world_camera: (k, n, 4, 4), k sets of poses of the probe's n frames; poses of paired frames are
            finite.

    Returns:
        (k, pairs) float64.
    """
    residuals = np.empty((len(T_world_camera), len(pairs)))
    for column, pair in enumerate(pairs):
        wrong, _ = point_errors(pair, T_world_camera)
        counted = np.isfinite(wrong).sum(axis=-1)
        residuals[:, column] = np.nansum(wrong, axis=-1) / np.maximum(counted, 1)
    return residuals


def point_errors(pair: FramePair, T_world_camera: Float64) -> tuple[Float64, NDArray[np.bool_]]:
    """Return the error of each of a pair's m points (`disagreements`), and whether it is inside the image.

    Args:
        pair: the pair of frames.
        T_world_camera: (k, n, 4, 4), k sets of poses of the probe's n frames; those of the pair are finite.

    Returns:
        (k, m) errors, 0 to 1, NaN at pixels without a measurement; (k, m) bool.
    """
    points, rows, columns, inside = _project(pair, T_world_camera)
    expected_m, measured_m = points[..., 2], pair.depth_m[rows, columns]
    known = inside & (measured_m > 0)
    off = np.abs(measured_m - expected_m)[known] / (WRONG_SHARE * expected_m[known])
    wrong = np.where(inside, np.nan, 1.0)
    wrong[known] = np.minimum(off, 1.0)
    return wrong, inside


def pair_residual_m(pairs: Sequence[FramePair], T_world_camera: Float64) -> float:
    """Return the median point-to-plane distance between the frames of pairs, m; NaN if none overlap.

    Points whose depth differs by a tenth or more from the depth at their pixel are left out.

    Args:
        pairs: the pairs of frames.
        T_world_camera: (n, 4, 4), poses of the probe's frames; those of paired frames are finite.
    """
    all_m = [np.zeros(0)]
    for pair in pairs:
        points, rows, columns, inside = _project(pair, T_world_camera)
        surface = pair.camera.rays() * pair.depth_m[..., None]
        normals = image_normals(surface, pair.depth_m)
        rows, columns = rows[inside], columns[inside]
        p, q, n = points[inside], surface[rows, columns], normals[rows, columns]
        near = (np.abs(p - q)[:, 2] < WRONG_SHARE * p[:, 2]) & np.isfinite(n).all(axis=1)
        all_m.append(np.abs(((p - q) * n).sum(axis=1))[near])
    distances_m = np.concatenate(all_m)
    return float(np.median(distances_m)) if len(distances_m) else float("nan")


def _project(
    pair: FramePair, T_world_camera: Float64
) -> tuple[Float64, NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Project a pair's m points from its first frame into its second, by poses (..., n, 4, 4).

    Returns:
        (..., m, 3) points in the second camera's axes; (..., m) each: rows, columns (both 0 outside the
        image), and whether the point is inside the image.
    """
    first, second = (T_world_camera[..., index, :, :] for index in (pair.first, pair.second))
    T_second_first = invert_rigid(second) @ first
    points = pair.points @ np.swapaxes(T_second_first[..., :3, :3], -1, -2) + T_second_first[..., None, :3, 3]
    u, v = np.moveaxis(pair.camera.project(np.maximum(points, [-np.inf, -np.inf, NEAREST_M])), -1, 0)
    before = points[..., 2] > NEAREST_M
    inside = before & (u >= 0) & (v >= 0) & (u < pair.camera.width - 1) & (v < pair.camera.height - 1)
    rows, columns = (np.rint(np.where(inside, each, 0)).astype(np.int64) for each in (v, u))
    return points, rows, columns, inside
