"""Hand-made trajectories whose health is known: circles of cameras, constraints that are off, given poses."""

from collections.abc import Sequence as Rows
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from analytic_scenes import depth_of, plane, sequence_of, sphere
from tracking_scenes import tie_at

from kinectbench.core.artefacts.stored import known
from kinectbench.core.artefacts.trajectory import GivenFigures, Source
from kinectbench.core.geometry import Camera, invert_rigid
from kinectbench.core.geometry.depth import NO_CALIBRATION
from kinectbench.core.sequence import Sequence
from kinectbench.stages.track.check_given import GivenCheck
from kinectbench.stages.track.frame_check import FrameCheck
from kinectbench.stages.track.health import health
from kinectbench.stages.track.health_figures import median
from kinectbench.stages.track.tracked import Constraint, ConstraintKind, Tracked

SMALL = Camera(80, 60, 65.625, 65.625, 39.5, 29.5)
FLOOR = plane((0, 0, 1), -0.3)
SCENE = [sphere((0, 0, 0), 0.3), FLOOR]
DISTANCE_M = 1.5
# Figures are rounded to a hundredth of a millimetre.
ROUNDED_MM = 0.006
NOT_OFF = np.eye(4)


def sequence_at(poses: np.ndarray, camera: Camera = SMALL) -> Sequence:
    """Depth seen from the poses; of frames without one, none."""
    blank = np.zeros((camera.height, camera.width), np.float32)
    return sequence_of([depth_of(SCENE, camera, T) if np.isfinite(T).all() else blank for T in poses], camera)


def constraint(
    poses: np.ndarray,
    a: int,
    b: int,
    kind: ConstraintKind = "odometry",
    off: np.ndarray = NOT_OFF,
    **changes: float,
) -> Constraint:
    """A constraint that agrees with the poses; `off` (4, 4) is put behind it."""
    measured = invert_rigid(poses[a]) @ poses[b] @ off
    values = {"overlap": 0.7, "inlier_share": 0.9, "residual_m": 0.004, **changes}
    return tie_at(a, b, measured, np.eye(6), kind, **values)


def tracked_of(poses: np.ndarray, **changes: Any) -> Tracked:
    """Everything tracked, every second frame a keyframe with a constraint to the next one, residual 3 mm."""
    n = len(poses)
    posed = np.isfinite(poses).all(axis=(1, 2))
    keyframes = np.flatnonzero(posed & (np.arange(n) % 2 == 0))
    values: dict[str, Any] = {
        "T_world_camera": poses,
        "states": tuple("tracked" if p else "lost" for p in posed),
        "reasons": {},
        "keyframes": keyframes,
        "constraints": tuple(constraint(poses, int(a), int(b)) for a, b in pairwise(keyframes)),
        "refused": (),
        "residual_m": np.where(posed, 0.003, np.nan),
        "noise_m": np.where(posed, 0.004, np.nan),
        "inlier_share": np.where(posed, 0.9, np.nan),
        "degenerate": np.zeros(n, dtype=bool),
        **changes,
    }
    return Tracked(**values)


def check_of(
    n: int, shift_m: float | np.ndarray = 0.002, rejected: np.ndarray | None = None, **changes: Any
) -> GivenCheck:
    """Frames that move by 2 mm, with a residual of 2.5 mm; distant ones by 5 mm."""
    nothing = np.zeros(n, dtype=bool)
    frames = FrameCheck(
        compared=np.arange(n),
        shift_m=np.broadcast_to(shift_m, n),
        turn_rad=np.full(n, 0.01),
        residual_m=np.full(n, 0.0025),
        noise_m=np.full(n, np.nan),
        inlier_share=np.full(n, np.nan),
        degenerate=nothing,
        disagrees=nothing if rejected is None else rejected,
        outlier=nothing,
        blind=nothing,
        jumps=(),
    )
    values: dict[str, Any] = {
        "disagreeing": np.flatnonzero(frames.disagrees).tolist(),
        "median_shift_m": known(median(frames.shift_m)),
        "distant_shift_m": 0.005,
        "distant_unmatched": None,
        "refined_apart_m": None,
        "largest_jump_m": 0.0,
        "distant_residual_m": 0.004,
        "refined_distant_residual_m": 0.004,
        **changes,
    }
    T_given = np.tile(np.eye(4), (n, 1, 1))
    return GivenCheck(T_given, frames, (), GivenFigures(**values), {}, NO_CALIBRATION)


def figures_of(
    sequence: Sequence, source: Source, tracked: Tracked, warnings: Rows[str], given: GivenCheck | None = None
) -> dict[str, Any]:
    """The health as the file holds it."""
    return health(sequence, source, tracked, warnings, given).json_value()


def closed(poses: np.ndarray, off: np.ndarray = NOT_OFF, **changes: float) -> Tracked:
    """The tracked circle with a loop from its first to its last frames."""
    tracked = tracked_of(poses)
    last = int(tracked.keyframes[-1])
    loop = constraint(poses, 0, last, "loop", off, **changes)
    return replace(tracked, constraints=(*tracked.constraints, loop))
