"""Does a given trajectory agree with the depth? It is compared with what the tracker makes of it.

Both may drift over the whole path, but hardly over a few frames: so each frame's given pose is compared
relative to frames that see the same place from nearby. Drift shows in the residual between distant frames.
"""

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import invert_rigid, rotation_angle_rad, transform_points
from kinectbench.sequence import Sequence
from kinectbench.tracking.compare import has_pose
from kinectbench.tracking.frame_maps import FrameMaps, Level, MapCache
from kinectbench.tracking.health import GivenCheck
from kinectbench.tracking.tracked import Tracked
from kinectbench.tracking.twist import rigid_from_twist, twist_from_rigid

Float64 = NDArray[np.float64]

# Frames that others are compared with, evenly spread: the nearest ones are so near that drift does not count.
COMPARED_FRAMES = 60
# At most so many pairs of keyframes tell the residual between distant frames.
DISTANT_PAIRS = 120
DISTANT_GATE_M = 0.1
MIN_FACING = 0.5


def check_given(
    sequence: Sequence, T_given: Float64, tracked: Tracked, neighbours: int, max_shift_m: float
) -> GivenCheck:
    """Compare given poses with refined ones, each relative to the frames around it.

    A frame that disagrees is compared a second time with frames that agree among themselves only, so that one
    wrong frame does not drag its right neighbours along.

    Args:
        sequence: the recording, n frames.
        T_given: (n, 4, 4), NaN where there is none.
        tracked: refined from these.
        neighbours: frames each frame is compared with.
        max_shift_m: a frame that is farther off disagrees.
    """
    T_refined = tracked.T_world_camera
    known = has_pose(T_given) & has_pose(T_refined)
    shift_m, turn = np.full(len(sequence), np.nan), np.full(len(sequence), np.nan)
    posed = np.flatnonzero(known)
    compared = posed[np.unique(np.linspace(0, len(posed) - 1, COMPARED_FRAMES).astype(int))]

    def compare(frame: int, among: NDArray[np.int64]) -> None:
        near = _nearest_views(T_refined, frame, among)[:neighbours]
        if len(near):
            shift_m[frame], turn[frame] = _shift(sequence, T_given, T_refined, frame, near)

    for frame in np.flatnonzero(known):
        compare(int(frame), compared)
    wrong = np.nan_to_num(shift_m) > max_shift_m
    sound = compared[~wrong[compared]]
    if len(sound) >= 2:
        for frame in np.flatnonzero(wrong):
            compare(int(frame), sound)
    wrong = np.nan_to_num(shift_m) > max_shift_m
    given_m, refined_m = _distant_residuals(sequence, [T_given, T_refined], tracked, known)
    return GivenCheck(shift_m, turn, tracked.residual_m, wrong, given_m, refined_m)


def jumps(T_given: Float64, tracked: Tracked, max_shift_m: float) -> list[tuple[int, float]]:
    """Where the given trajectory jumps: the frame after it, and by how much (metres).

    A step is a jump if it is off by more than `max_shift_m`, and the steps before and after it are not: a
    single wrong frame makes two wrong steps, and is named anyway.
    """
    frames = np.flatnonzero(has_pose(T_given) & has_pose(tracked.T_world_camera))
    steps = [invert_rigid(T[frames[:-1]]) @ T[frames[1:]] for T in (T_given, tracked.T_world_camera)]
    apart_m = np.linalg.norm(steps[0][:, :3, 3] - steps[1][:, :3, 3], axis=1)
    off = np.concatenate([[False], apart_m > max_shift_m, [False]])
    alone = off[1:-1] & ~off[:-2] & ~off[2:]
    return [(int(frames[i + 1]), float(apart_m[i])) for i in np.flatnonzero(alone)]


def _nearest_views(T: Float64, frame: int, among: NDArray[np.int64]) -> NDArray[np.int64]:
    """The other frames, most similar view first: 1 m apart counts as much as 1 rad turned."""
    others = among[among != frame]
    apart_m = np.linalg.norm(T[others, :3, 3] - T[frame, :3, 3], axis=1)
    cosine = T[others, :3, 2] @ T[frame, :3, 2]
    order = np.argsort(apart_m + np.arccos(np.clip(cosine, -1, 1)), kind="stable")
    return np.asarray(others[order])


def _shift(
    sequence: Sequence, T_given: Float64, T_refined: Float64, frame: int, near: NDArray[np.int64]
) -> tuple[float, float]:
    """How far and by what angle a frame is off: by the median motion that its neighbours ask for.

    It is taken per component: their own errors cancel, and one wrong neighbour does not count.
    """
    depth_m = sequence.depth_m(frame)[::16, ::16]
    rays = sequence.camera.rays()[::16, ::16]
    points = (rays * depth_m[..., None])[depth_m > 0]
    refined = invert_rigid(T_refined[near]) @ T_refined[frame]
    given = invert_rigid(T_given[near]) @ T_given[frame]
    off = invert_rigid(refined) @ given
    motion = rigid_from_twist(np.median([twist_from_rigid(T) for T in off], axis=0))
    shifts_m = np.linalg.norm(transform_points(motion, points) - points, axis=1)
    return float(np.median(shifts_m)), float(rotation_angle_rad(motion[:3, :3]))


def _distant_residuals(
    sequence: Sequence, trajectories: list[Float64], tracked: Tracked, usable: NDArray[np.bool_]
) -> tuple[float, float]:
    """Median residual between keyframes that are tied but do not follow each other, for two trajectories."""
    pairs = [(t.a, t.b) for t in tracked.ties if t.kind != "odometry" and usable[t.a] and usable[t.b]]
    if not pairs:
        return np.nan, np.nan
    chosen = sorted(pairs[i] for i in np.unique(np.linspace(0, len(pairs) - 1, DISTANT_PAIRS).astype(int)))
    maps = MapCache(sequence)
    medians = [
        [_residual_m(maps[b], maps[a].levels[0], invert_rigid(T[a]) @ T[b]) for T in trajectories]
        for a, b in chosen
    ]
    given_m, refined_m = np.nanmedian(np.array(medians), axis=0)
    return float(given_m), float(refined_m)


def _residual_m(source: FrameMaps, target: Level, T_target_source: Float64) -> float:
    """Median absolute point-to-plane residual of all points within 0.1 m of what they fall on; NaN if few."""
    points = source.levels[0].points.astype(np.float64)
    p, n = transform_points(T_target_source, points[:, :3]), points[:, 3:6] @ T_target_source[:3, :3].T
    p, n = p[p[:, 2] > 0.1], n[p[:, 2] > 0.1]
    pixels = np.rint(target.camera.project(p)).astype(int)
    height, width = target.depth_m.shape
    inside = ((pixels >= 0) & (pixels < [width, height])).all(axis=1)
    p, n, (u, v) = p[inside], n[inside], pixels[inside].T
    q = target.camera.rays()[v, u] * target.depth_m[v, u][:, None]
    facing = (n * target.normals[v, u]).sum(axis=1) > MIN_FACING
    met = (q[:, 2] > 0) & (np.abs(q[:, 2] - p[:, 2]) < DISTANT_GATE_M) & facing
    if met.sum() < 100:
        return np.nan
    return float(np.median(np.abs((n[met] * (q[met] - p[met])).sum(axis=1))))
