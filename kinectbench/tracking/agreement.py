"""Does a frame's depth agree with other frames' depth under the poses it was given?

Each frame is compared with some keyframes that look at the same place. A projective point-to-plane
ICP tells how far the frame would have to move to agree with them: a right pose stays where it is, a
wrong one moves.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.config import TrackingSettings
from kinectbench.geometry import Camera, invert_rigid, transform_points
from kinectbench.sequence import Sequence
from kinectbench.tracking.icp import (
    OrientedPoints,
    normal_equations,
    oriented_points,
    turn_rad,
)
from kinectbench.tracking.twist import rigid_from_twist

KEYFRAMES = 60
ITERATIONS = 5
MIN_OVERLAP_POINTS = 150
# A pose is believed to within this before the depth is asked: keeps weakly constrained motion at zero.
PRIOR_SIGMA_M = 0.05
PRIOR_SIGMA_RAD = 0.03


@dataclass(frozen=True)
class Agreement:
    """How each frame agrees with its neighbours; NaN where too little overlaps to tell.

    Attributes:
        residual_m: (n,) median absolute point-to-plane residual as given, metres.
        shift_m: (n,) how far the frame's points would move to agree, median, metres.
        turn_rad: (n,) by how much the camera would turn, radians.
    """

    residual_m: NDArray[np.float64]
    shift_m: NDArray[np.float64]
    turn_rad: NDArray[np.float64]

    def disagreeing(self, max_shift_m: float) -> NDArray[np.bool_]:
        """(n,) frames that would have to move by more than `max_shift_m` metres."""
        return np.nan_to_num(self.shift_m) > max_shift_m


def measure_agreement(
    sequence: Sequence,
    T_world_camera: NDArray[np.float64],
    settings: TrackingSettings,
    progress: Callable[[int, int], None] | None = None,
) -> Agreement:
    """Compare every frame that has a pose with the keyframes that look at the same place.

    A frame that disagrees is compared a second time, with keyframes that agree among themselves
    only, so that one wrong frame does not drag its right neighbours along.

    Args:
        sequence: the recording.
        T_world_camera: (n, 4, 4), NaN where a frame has no pose.
        settings: how many pixels and neighbours.
        progress: called with (done, total).
    """
    posed = np.flatnonzero(np.isfinite(T_world_camera).all(axis=(1, 2)))
    keyframes = posed[np.unique(np.linspace(0, len(posed) - 1, KEYFRAMES).astype(int))]
    surfaces = {
        int(k): oriented_points(sequence.depth_m(int(k)), sequence.camera, settings.check_stride_px)
        for k in keyframes
    }
    depths = {int(k): sequence.depth_m(int(k)) for k in keyframes}
    result = Agreement(*(np.full(len(sequence), np.nan) for _ in range(3)))

    def compare(index: int, among: NDArray[np.int64]) -> None:
        surface = surfaces.get(index) or oriented_points(
            sequence.depth_m(index), sequence.camera, settings.check_stride_px
        )
        near = _nearest_views(T_world_camera, index, among)[: settings.check_neighbours]
        figures = _compare(surface, index, near, depths, T_world_camera, sequence.camera)
        result.residual_m[index], result.shift_m[index], result.turn_rad[index] = figures

    for done, index in enumerate(posed, start=1):
        compare(int(index), keyframes)
        if progress:
            progress(done, len(posed))
    suspects = np.flatnonzero(result.disagreeing(settings.max_disagreement_m))
    sound = np.setdiff1d(keyframes, suspects)
    if len(sound) >= 2:
        for index in suspects:
            compare(int(index), sound)
    return result


def _nearest_views(
    T_world_camera: NDArray[np.float64], index: int, among: NDArray[np.int64]
) -> NDArray[np.int64]:
    """The other frames, most similar view first: 1 m apart counts as much as 1 rad turned."""
    others = among[among != index]
    apart_m = np.linalg.norm(T_world_camera[others, :3, 3] - T_world_camera[index, :3, 3], axis=1)
    cosine = T_world_camera[others, :3, 2] @ T_world_camera[index, :3, 2]
    order = np.argsort(apart_m + np.arccos(np.clip(cosine, -1, 1)), kind="stable")
    ordered: NDArray[np.int64] = others[order]
    return ordered


def _compare(
    surface: OrientedPoints,
    index: int,
    neighbours: NDArray[np.int64],
    depths: dict[int, NDArray[np.float32]],
    T_world_camera: NDArray[np.float64],
    camera: Camera,
) -> tuple[float, float, float]:
    """Residual as given, shift and turn to agree, of one frame; NaN if too few points overlap."""
    motion = np.eye(4)
    residual_m = np.nan
    prior = np.diag([PRIOR_SIGMA_RAD**-2] * 3 + [PRIOR_SIGMA_M**-2] * 3)
    for iteration in range(ITERATIONS):
        normal_matrix, gradient = prior.copy(), np.zeros(6)
        residuals = []
        for other in neighbours:
            T_other_camera = invert_rigid(T_world_camera[other]) @ T_world_camera[index] @ motion
            A, b, r = normal_equations(surface, depths[int(other)], T_other_camera, camera)
            normal_matrix += A
            gradient += b
            residuals.append(r)
        found = np.concatenate(residuals) if residuals else np.zeros(0)
        if len(found) < MIN_OVERLAP_POINTS:
            return np.nan, np.nan, np.nan
        if iteration == 0:
            residual_m = float(np.median(np.abs(found)))
        step = np.linalg.solve(normal_matrix, gradient)
        motion = motion @ rigid_from_twist(step)
    moved_m = np.linalg.norm(transform_points(motion, surface.points) - surface.points, axis=1)
    return residual_m, float(np.median(moved_m)), turn_rad(motion)
