"""One tracker on one recording, in a process of its own: poses, CPU time and peak memory are this run's."""

import resource
import time
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from memory import peak_mb
from tracking_distant import all_planes, distant_pairs, measure_distant
from tracking_recordings import part, sequence_in, true_poses
from tracking_rivals import chained_odometry, dense_slam

from kinectbench.core.errors import KinectBenchError
from kinectbench.core.sequence import Sequence
from kinectbench.core.types import Float64
from kinectbench.engine.processes import submit_all, worker_pool
from kinectbench.settings.models import TrackingSettings, TrajectoryMode
from kinectbench.stages.track import track

# Frames of either end, tracked before the clock starts: libraries and compiled code are loaded by then.
WARM_UP_FRAMES = 20


@dataclass(frozen=True)
class Task:
    """What to run.

    Attributes:
        method: a name in METHODS.
        folder: of the ingested sequence.
        stride: every n-th frame.
        first: of no more than this many frames; None: all.
        warm_up: frames from the start that are tracked before the clock starts; None: some of both ends.
    """

    method: str
    folder: Path
    stride: int = 1
    first: int | None = None
    warm_up: int | None = None


@dataclass(frozen=True)
class Outcome:
    """What came of it.

    Attributes:
        T_world_camera: (n, 4, 4), NaN without a pose.
        T_true: (n, 4, 4), of the recording.
        cpu_s: of all threads, loading the images included.
        peak_mb: greatest resident memory of the process.
        problem: why there are no poses, or no more; None if all went well.
        unnamed: frames without a pose that the tracker does not name.
        more: further figures: of a refined trajectory, how distant frames agree, before and after.
    """

    T_world_camera: Float64
    T_true: Float64
    cpu_s: float
    peak_mb: float
    problem: str | None
    unnamed: int
    more: dict[str, float] = field(default_factory=dict)


Found = tuple[Float64, str | None, int]


def _ours(sequence: Sequence, mode: TrajectoryMode = "ignore") -> Found:
    trajectory = track(sequence, mode, TrackingSettings())
    missing = set(np.flatnonzero(np.isnan(trajectory.T_world_camera[:, 0, 0])).tolist())
    health = trajectory.health
    named = {*health.lost, *(row.frame for row in health.rejected)} if health else set()
    return trajectory.T_world_camera, None, len(missing - named)


METHODS: dict[str, Callable[[Sequence], Found]] = {
    "ours": _ours,
    "ours, depth only": _ours,
    "ours, refine": lambda sequence: _ours(sequence, "refine"),
    "slam.Model": lambda sequence: (*dense_slam(sequence), 0),
    "odometry": lambda sequence: (*chained_odometry(sequence), 0),
}


def measure_apart(task: Task) -> Outcome:
    """Run a task in a process of its own; a failure is an outcome too."""
    try:
        with worker_pool(1) as pool:
            return submit_all(pool, measure, [task])[0].result()
    except BrokenProcessPool:
        true = true_poses(sequence_in(task.folder, task.stride, task.first))
        return Outcome(
            np.full_like(true, np.nan), true, float("nan"), float("nan"), "the process died", len(true)
        )


def measure(task: Task) -> Outcome:
    """Run a task in this process, which is a fresh one."""
    with_color = task.method != "ours, depth only"
    sequence = sequence_in(task.folder, task.stride, task.first, with_color=with_color)
    true = true_poses(sequence)
    ends = np.arange(len(sequence))
    ends = ends[: task.warm_up] if task.warm_up else np.union1d(ends[:WARM_UP_FRAMES], ends[-WARM_UP_FRAMES:])
    _guarded(task.method, part(sequence, ends))
    started_s = _cpu_s()
    T_world_camera, problem, unnamed = _guarded(task.method, sequence)
    cpu_s, used_mb = _cpu_s() - started_s, peak_mb()
    more = _distant_figures(sequence, true, T_world_camera) if task.method == "ours, refine" else {}
    return Outcome(T_world_camera, true, cpu_s, used_mb, problem, unnamed, more)


def _distant_figures(sequence: Sequence, T_given: Float64, T_refined: Float64) -> dict[str, float]:
    """How distant frames agree: the same pairs, of frames that both trajectories have."""
    T_both = np.where(np.isfinite(T_refined), T_given, np.nan)
    planes, camera = all_planes(sequence), sequence.camera
    pairs = distant_pairs(planes, camera, T_both)
    given, refined = (measure_distant(planes, camera, T, pairs) for T in (T_both, T_refined))
    return {
        "distant_pairs": len(pairs),
        "given_residual_mm": 1000 * given.residual_m,
        "given_share": given.share,
        "refined_residual_mm": 1000 * refined.residual_m,
        "refined_share": refined.share,
    }


def _guarded(method: str, sequence: Sequence) -> Found:
    """Run a tracker; whatever it raises is its outcome, so that the other rows are measured all the same."""
    try:
        return METHODS[method](sequence)
    except KinectBenchError as error:
        # It says itself that no frame has a pose.
        return np.full((len(sequence), 4, 4), np.nan), str(error), 0
    except Exception as error:
        return np.full((len(sequence), 4, 4), np.nan), f"{type(error).__name__}: {error}", len(sequence)


def _cpu_s() -> float:
    """CPU time of this process and of those it started and waited for."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime
