"""Where a recording is built: in its local folder, or for a store if its root is a URL."""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace

from kinectbench.core.artefacts.manifest import Failed
from kinectbench.core.errors import KILLED, StorageError
from kinectbench.core.store.address import url_of
from kinectbench.engine.failures import keep_failure
from kinectbench.engine.locks import locked
from kinectbench.engine.pipeline import Outcome, build_recording
from kinectbench.engine.stages import Job, current_stages
from kinectbench.engine.time_limit import Hung


def build_at_its_place(
    job: Job,
    upto: str = "pairs",
    force: Sequence[str] = (),
    progress: Callable[[str, int, int], None] | None = None,
    *,
    wait: bool = True,
    limit_s: float | None = None,
    hung: Hung | None = None,
) -> Outcome:
    """`build_recording`, for local benchmarks and for those in stores."""
    if url_of(job.root) is None:
        return build_recording(job, upto, force, progress, wait=wait, limit_s=limit_s, hung=hung)
    from kinectbench.engine.stored_build import build_stored

    return build_stored(job, upto, force, progress, limit_s=limit_s, hung=hung)


def status_of(job: Job) -> tuple[tuple[str, ...], Failed | None]:
    """The current stages of a recording, and why its last run failed, if it did."""
    if url_of(job.root) is not None:
        from kinectbench.engine.checkout import status_there

        return status_there(job)
    try:
        failed = Failed.read_if_there(job.build)
    except StorageError:  # nobody can read why
        failed = None
    return tuple(current_stages(job.build, job)), failed


def keep_killed(job: Job, error: str) -> None:
    """Write failed.json of a recording whose process was killed, or hangs."""
    if url_of(job.root) is None:
        keep_failure(job.build, None, error)
        return
    from kinectbench.engine.stored_build import put_failure

    with contextlib.suppress(StorageError):
        put_failure(job, Failed(stage=None, error=error, code=KILLED))


def for_elsewhere(job: Job) -> Job:
    """The job in a form for processes with other working folders."""
    return replace(job, root=job.root.absolute()) if url_of(job.root) is None else job


def waits_for_others(job: Job) -> bool:
    """Whether one run at a time builds a recording; in a store runs do not wait and write equal files."""
    return url_of(job.root) is None


def clear_away(job: Job) -> None:
    """Remove what killed workers left of a recording, unless another run works on it."""
    if url_of(job.root) is not None or not job.build.is_dir():
        return
    with contextlib.suppress(StorageError), locked(job.build, wait=False):
        pass
