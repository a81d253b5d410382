"""Build many recordings, several at a time; a failed or killed recording does not stop the others."""

from collections.abc import Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from math import prod
from typing import Protocol

from kinectbench.core import KILLED, KinectBenchError
from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.core.store.address import url_of
from kinectbench.core.threads import using_threads
from kinectbench.engine.executor import Executor, Pool, SendMessage, SerialExecutor, WorkerLost
from kinectbench.engine.pipeline import Outcome
from kinectbench.engine.scratch import clear_scratch
from kinectbench.engine.stages import Job
from kinectbench.engine.status import builder_of, clear_away, for_elsewhere, keep_killed, waits_for_others
from kinectbench.engine.time_limit import watched

# Most threads of one recording; each thread holds a pair in memory. Peak of `pairs` on 92 frames of a phone:
# 274 MiB with one thread, 301 with two, 340 with 4, 415 with 8, 504 with 16. Time was measured on two cores
# only.
MOST_THREADS = 8
# Measured peak memory of the stages, one by one (`/usr/bin/time -f %M kinectbench STAGE --jobs 1`), and the
# estimate by the sum of libraries, frames and voxels of the object:
#   phone, 92 frames of 256 x 192, 0.3 million voxels              0.48 GB (fuse)      0.58
#   cabinet, 58 frames of 640 x 480, 3.1 million                   0.91 GB (segment)   0.94
#   kitchen, 150 frames of 640 x 480, a chair of 3.8 million       0.95 GB (segment)   1.11
#   a simulated chair, 1000 frames of 640 x 480, 2.4 million       0.97 GB (track)     1.45
LIBRARIES_GB = 0.55
BYTES_PER_PIXEL = 2.0
BYTES_PER_VOXEL = 130.0
# Assumed without a box: the kitchen above takes 2.2 GB if its largest thing is the object.
UNKNOWN_VOXELS = 13e6
# Frames as PNG and JPEG files, the smallest format: 0.43 to 0.46 bytes for a depth pixel with its colour.
# Other formats give an overestimate, so at most a thousand frames of 640 x 480 are assumed.
BYTES_OF_FILE_PER_PIXEL = 0.4
UNKNOWN_PIXELS = 1000 * 640 * 480
# Largest number of files of a folder to count (a thousand frames have some thousands).
MOST_FILES = 10_000


class ProgressWatcher(Protocol):
    """Receives the progress of recordings."""

    def __call__(self, recording: str, stage: str, done: int, total: int) -> None:
        """Receive the progress of a recording in a stage."""

    def ended(self, outcome: Outcome) -> None:
        """Receive the outcome of a recording once its build has ended, with or without an error."""

    def warn(self, message: str) -> None:
        """Receive a warning that concerns all recordings."""


class _Nobody:
    def __call__(self, recording: str, stage: str, done: int, total: int) -> None: ...
    def ended(self, outcome: Outcome) -> None: ...
    def warn(self, message: str) -> None: ...


def build(
    jobs: Sequence[Job],
    upto: str = "pairs",
    force: Sequence[str] = (),
    workers: int = 1,
    watcher: ProgressWatcher | None = None,
    *,
    wait_for_others: bool = True,
    limit_s: float | None = None,
    executor: Executor | None = None,
) -> list[Outcome]:
    """Bring recordings up to date, several at a time; a recording that fails does not stop the others.

    A recording whose process is killed is tried again; it fails if its process is killed even while no other
    one runs. A recording that hangs fails as well, but a hang is noticed only in worker processes and with
    `limit_s`. The reason is in `failed.json`.

    Args:
        jobs: the recordings.
        upto: name of the last stage.
        force: names of stages to make again even if they are current.
        workers: number of processes, or of threads (at most eight) for a single recording. Results do not
            depend on it.
        watcher: called in this process with the progress of each recording.
        wait_for_others: whether to wait for another run that builds the same recording, or to fail.
        limit_s: time limit of a recording, seconds; None: no limit.
        executor: runs the builds instead of `workers` local processes.

    Returns:
        One outcome for each job, in the order of the jobs.

    Raises:
        ClusterError: the executor has become unusable; finished work is kept.
    """
    outcomes = _Outcomes(watcher or _Nobody())
    options = {"upto": upto, "force": tuple(force), "wait": wait_for_others, "limit_s": limit_s}
    alone = executor is None and (workers <= 1 or len(jobs) <= 1)
    tasks = [job.alone if executor is None else for_elsewhere(job.alone) for job in jobs]
    where = executor or (SerialExecutor() if alone else Pool(min(workers, len(jobs))))
    results = where.outcomes(
        partial(_build if alone or limit_s is None else _build_watched, options),
        tasks,
        outcomes,
        expected_gb,
        slowest_twice=not any(map(waits_for_others, jobs)),
    )
    try:
        with using_threads(min(workers, MOST_THREADS)) if alone else nullcontext(), closing(results):
            for job, outcome in results:
                outcomes.add(_killed(job, outcome) if isinstance(outcome, WorkerLost) else outcome)
    except BaseException:
        for job in jobs if not alone else ():
            clear_away(job)
        if not alone:
            clear_scratch()
        raise
    return [outcomes.by_id[job.recording.id] for job in jobs]


def _build_watched(options: dict[str, object], job: Job, say: SendMessage) -> Outcome | WorkerLost:
    """Build as `_build` does, in a worker; if the build hangs, the process ends."""
    return watched(lambda hung: _build({**options, "hung": hung}, job, say))


def _build(options: dict[str, object], job: Job, say: SendMessage) -> Outcome:
    """Build a recording, and send its progress to the parent process by `say`."""

    def report(stage: str, done: int, total: int) -> None:
        say((job.recording.id, stage, done, total))

    return builder_of(job)(job, progress=report, **options)


@dataclass(frozen=True)
class _Outcomes:
    """Collects the outcomes of recordings, and passes progress and warnings to the watcher."""

    watcher: ProgressWatcher
    by_id: dict[str, Outcome] = field(default_factory=dict)

    def heard(self, message: tuple[str, str, int, int]) -> None:
        recording, stage, done, total = message
        if recording not in self.by_id:  # messages may arrive after the outcome
            self.watcher(recording, stage, done, total)

    def warn(self, message: str, task: Job | None = None) -> None:
        self.watcher.warn(message if task is None else message.format(id=task.recording.id))

    def add(self, outcome: Outcome) -> None:
        self.by_id[outcome.recording] = outcome
        self.watcher.ended(outcome)


def _killed(job: Job, lost: WorkerLost) -> Outcome:
    error = lost.reason.format(id=job.recording.id)
    keep_killed(job, error)
    return Outcome(job.recording.id, (), (), error, 0.0, code=KILLED)


def expected_gb(job: Job) -> float:
    """Estimate the peak memory of building a recording, GB; the estimate is not an upper bound."""
    return LIBRARIES_GB + (BYTES_PER_PIXEL * _pixels(job) + BYTES_PER_VOXEL * _voxels(job)) / 1e9


def _pixels(job: Job) -> float:
    """Return the number of pixels in all depth images, from `ingest` or estimated from file sizes."""
    if url_of(job.root) is not None:
        return UNKNOWN_PIXELS
    try:
        camera = CameraFile.read(job.build / "sequence")
    except (KinectBenchError, OSError):
        camera = None
    if camera is not None and camera.frames is not None:
        return camera.frames * camera.width * camera.height
    try:
        files = job.source.rglob("*") if job.source.is_dir() else [job.source]
        size = sum(file.lstat().st_size for file in islice(files, MOST_FILES))
    except OSError:  # the build reports it
        return UNKNOWN_PIXELS
    return min(size / BYTES_OF_FILE_PER_PIXEL, UNKNOWN_PIXELS)


def _voxels(job: Job) -> float:
    """Estimate the number of voxels around the user's box, from the floor up; without a box, a high guess."""
    from kinectbench.stages.segment.solid.grids import MARGIN_M, REFERENCE_VOXEL_M

    box = job.recording.box
    if box is None:
        return UNKNOWN_VOXELS
    edge_m = job.settings.fusion.voxel_size_m or REFERENCE_VOXEL_M
    top_m = box.center_m[2] + box.size_m[2] / 2
    return prod((side_m + 2 * MARGIN_M) / edge_m for side_m in (*box.size_m[:2], top_m))
