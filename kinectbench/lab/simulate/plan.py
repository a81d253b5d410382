"""Plan a simulated recording: its frames, stamps and given poses, with the faults of the settings."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from kinectbench.core.geometry import invert_rigid, rigid
from kinectbench.core.types import Float64
from kinectbench.lab.simulate.spec import FAULTS, GIVEN, SimulationSpec

# A drifting trajectory also rotates: radians per metre, for each metre of drift per metre.
DRIFT_RAD_PER_M = 0.5


@dataclass(frozen=True)
class PlannedFrame:
    """One planned frame of the recording, before it is rendered.

    Attributes:
        source: index of the frame among all frames of the path, before some were dropped.
        time_s: time at which depth is taken, seconds since the start.
        stamp_ns: the recorded stamp of depth.
        color_stamp_ns: the recorded stamp of colour.
        T_world_given: (4, 4) the recorded pose of the frame; None if there is none.
        foreign: whether the frame shows another scene.
    """

    source: int
    time_s: float
    stamp_ns: int
    color_stamp_ns: int
    T_world_given: Float64 | None
    foreign: bool


def plan_frames(spec: SimulationSpec, T_world_camera: Float64) -> tuple[PlannedFrame, ...]:
    """Plan which frames are recorded, in which order, with which stamps and poses.

    `T_world_camera` (n, 4, 4) has the true poses of all frames, before any is dropped.
    """
    faults = spec.faults
    rng = spec.rng(FAULTS)
    total = spec.path.frames
    kept = np.flatnonzero(rng.random(total) >= faults.drop_share)
    if len(kept) == 0:
        kept = np.array([0])
    stamps_ns = np.array([spec.stamp_ns(int(index)) for index in kept], dtype=np.int64)
    jitter_us = np.round(rng.standard_normal(len(kept)) * faults.stamp_jitter_s * 1e6).astype(np.int64)
    stamps_ns += jitter_us * 1000
    for first in rng.permutation(np.arange(0, len(kept) - 1, 2))[: faults.swapped_stamps]:
        stamps_ns[[first, first + 1]] = stamps_ns[[first + 1, first]]
    middle = (len(kept) - faults.foreign_frames) // 2
    given = given_trajectory(spec, T_world_camera)
    delay_ns = round(spec.sensor.color_delay_s * 10**6) * 1000
    return tuple(
        PlannedFrame(
            source=int(source),
            time_s=int(source) / spec.path.rate_hz,
            stamp_ns=int(stamp_ns),
            color_stamp_ns=int(stamp_ns) + delay_ns,
            T_world_given=None if given is None else given[source],
            foreign=0 <= position - middle < faults.foreign_frames,
        )
        for position, (source, stamp_ns) in enumerate(zip(kept, stamps_ns, strict=True))
    )


def given_trajectory(spec: SimulationSpec, T_world_camera: Float64) -> Float64 | None:
    """Return the trajectory (n, 4, 4) to record, true or with errors; None if none is to be recorded."""
    given, rng = spec.given, spec.rng(GIVEN)
    if given.trajectory == "none":
        return None
    poses = T_world_camera
    if given.trajectory == "noisy":
        poses = _disturbed(poses, given.noise_m, given.noise_rad, rng)
    elif given.trajectory == "drifting":
        poses = _drifting(poses, given.drift_m_per_m, rng)
    if spec.faults.jump_m > 0:
        direction = rng.standard_normal(3)
        poses = poses.copy()
        poses[len(poses) // 2 :, :3, 3] += spec.faults.jump_m * direction / np.linalg.norm(direction)
    return poses


def _disturbed(poses: Float64, sigma_m: float, sigma_rad: float, rng: np.random.Generator) -> Float64:
    """Add Gaussian noise to every pose: standard deviations `sigma_m` and `sigma_rad` per camera axis."""
    turns = Rotation.from_rotvec(rng.standard_normal((len(poses), 3)) * sigma_rad).as_matrix()
    shifts = rng.standard_normal((len(poses), 3)) * sigma_m
    return np.stack([T @ rigid(R, t) for T, R, t in zip(poses, turns, shifts, strict=True)])


def _drifting(poses: Float64, drift_m_per_m: float, rng: np.random.Generator) -> Float64:
    """Add odometry drift to the poses, always in the same direction and about the same axis.

    The error of a step is a shift by the step's length times `drift_m_per_m`, and a rotation in proportion.
    """
    shift, turn = (axis / np.linalg.norm(axis) for axis in rng.standard_normal((2, 3)))
    drifted = [poses[0]]
    for before, after in pairwise(poses):
        step = invert_rigid(before) @ after
        error_m = drift_m_per_m * float(np.linalg.norm(step[:3, 3]))
        error = rigid(Rotation.from_rotvec(turn * error_m * DRIFT_RAD_PER_M).as_matrix(), shift * error_m)
        drifted.append(drifted[-1] @ step @ error)
    return np.stack(drifted)
