"""The progress of a benchmark: which recordings are built, failed, or remain."""

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Literal

from pydantic import Field

from kinectbench.core.artefacts.stored import StoredPart
from kinectbench.core.store.store import in_parallel
from kinectbench.engine.place import status_of
from kinectbench.engine.stages import STAGES, Job

State = Literal["done", "failed", "missing"]


class RecordingStatus(StoredPart):
    """The progress of one recording."""

    recording: str = Field(description="its id")
    state: State = Field(
        description="failed: the last run failed, whatever earlier ones left; done: all stages are current; "
        "missing"
    )
    current: tuple[str, ...] = Field(description="stages that are made and current")
    next: str | None = Field(description="the first stage that is not; null: all are, of an earlier run")
    error: str | None = Field(description="why the last run failed")
    code: str | None = Field(description="of that error")


def statuses(jobs: Iterable[Job]) -> list[RecordingStatus]:
    """The progress of each recording under the present settings; builds and reads nothing.

    Whether a recording's own files changed since is therefore not seen here; `build` looks at them.
    """
    return in_parallel(partial(_status, job) for job in jobs)


def _status(job: Job) -> RecordingStatus:
    current, failed = status_of(job)
    left = [stage.name for stage in STAGES if stage.name not in current]
    state: State = "failed" if failed else "missing" if left else "done"
    return RecordingStatus(
        recording=job.recording.id,
        state=state,
        current=current,
        next=left[0] if left else None,
        error=failed.error if failed else None,
        code=failed.code if failed else None,
    )


def in_words(rows: Sequence[RecordingStatus]) -> str:
    """A summary line."""
    counts = {state: sum(row.state == state for row in rows) for state in ("done", "failed", "missing")}
    return f"{counts['done']} of {len(rows)} done, {counts['failed']} failed, {counts['missing']} missing"
