"""Build recordings and report their status, whether the benchmark is in a local folder or in a store."""

import contextlib
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

from pydantic import Field

from kinectbench.core import KILLED, StorageError
from kinectbench.core.artefacts.manifest import Failed
from kinectbench.core.artefacts.stored import StoredPart, optional
from kinectbench.core.store.address import url_of
from kinectbench.core.store.store import StoredObject, in_parallel
from kinectbench.engine.artefact import whole_manifest
from kinectbench.engine.failures import keep_failure, stored_failure
from kinectbench.engine.locks import locked
from kinectbench.engine.pipeline import Outcome, build_recording, differing_settings
from kinectbench.engine.stage_settings import MADE_OF
from kinectbench.engine.stages import STAGES, Job, Stage, current_stages

State = Literal["done", "failed", "missing"]
# The state, in words, of a recording that was built with other settings.
OTHER_SETTINGS = "other settings"


def builder_of(job: Job) -> Callable[..., Outcome]:
    """Return `build_recording`, or in a store `build_stored`, which has the same parameters."""
    if url_of(job.root) is None:
        return build_recording
    from kinectbench.engine.stored_build import build_stored

    return build_stored


def status_of(job: Job) -> tuple[tuple[str, ...], Failed | None, list[StoredObject]]:
    """Return a recording's current stages, the last run's failure or None, and its built files in a store."""
    if url_of(job.root) is not None:
        from kinectbench.engine.checkout import status_there

        return status_there(job)
    return tuple(current_stages(job.build, job)), stored_failure(job.build), []


def keep_killed(job: Job, error: str) -> None:
    """Write failed.json of a recording whose process was killed or hangs."""
    if url_of(job.root) is None:
        keep_failure(job.build, None, error)
        return
    from kinectbench.engine.stored_build import put_failure

    with contextlib.suppress(StorageError):
        put_failure(job, Failed(stage=None, error=error, code=KILLED))


def for_elsewhere(job: Job) -> Job:
    """Return the job with an absolute root, for processes with another working folder."""
    return replace(job, root=job.root.absolute()) if url_of(job.root) is None else job


def waits_for_others(job: Job) -> bool:
    """Whether a run waits for another one on the same recording: True for local folders, False in a store."""
    return url_of(job.root) is None


def clear_away(job: Job) -> None:
    """Remove temporary files that killed workers left in a local build, unless another run uses it now."""
    if url_of(job.root) is not None or not job.build.is_dir():
        return
    with contextlib.suppress(StorageError), locked(job.build, wait=False):
        pass


class RecordingStatus(StoredPart):
    """The status of one recording."""

    recording: str = Field(description="id of the recording")
    state: State = Field(
        description="failed: the last run failed; done: all stages are up to date; missing: others"
    )
    current: tuple[str, ...] = Field(description="stages that are up to date")
    next: str | None = Field(description="the first stage that is not up to date; null: there is none")
    differs: str | None = optional("the first setting of `next` that has changed since the stage was made")
    error: str | None = Field(description="why the last run failed")
    code: str | None = Field(description="code of this error")

    @property
    def state_in_words(self) -> str:
        """The state as shown to users: if a stage was built with other settings, it is not "missing"."""
        return OTHER_SETTINGS if self.state == "missing" and self.differs else self.state


def statuses(jobs: Iterable[Job]) -> list[RecordingStatus]:
    """Return the status of each recording under the present settings, without building or reading it.

    Changes of a recording are noticed only in the names and sizes of some files; `build` notices any change.
    """
    return in_parallel(partial(_status, job) for job in jobs)


def _status(job: Job) -> RecordingStatus:
    current, failed, built = status_of(job)
    left = [stage for stage in STAGES if stage.name not in current]
    state: State = "failed" if failed else "missing" if left else "done"
    return RecordingStatus(
        recording=job.recording.id,
        state=state,
        current=current,
        next=left[0].name if left else None,
        differs=_differing_setting(job, left[0], built) if left else None,
        error=failed.error if failed else None,
        code=failed.code if failed else None,
    )


def _differing_setting(job: Job, stage: Stage, built: Sequence[StoredObject]) -> str | None:
    """Return the dotted key of the first setting in which a built artefact differs from `job`, or None.

    In a store, the newest artefact counts. Nothing is compared if the artefact is missing or damaged, or was
    made by another version of the stage.
    """
    if url_of(job.root) is None:
        manifest = whole_manifest(job.build / stage.folder)
    else:
        from kinectbench.engine.checkout import newest_there

        manifest = newest_there(job, stage.name, built)
    if manifest is None or manifest.stage_version != stage.version:
        return None
    key = next(iter(differing_settings(stage.settings(job), manifest.settings)), None)
    return None if key is None else MADE_OF.get(key, key)


def in_words(rows: Sequence[RecordingStatus]) -> str:
    """Summarise in one line how many recordings are done, failed, missing, or of other settings."""
    counts = Counter(row.state_in_words for row in rows)
    others = f", {counts[OTHER_SETTINGS]} of {OTHER_SETTINGS}" if counts[OTHER_SETTINGS] else ""
    failed, missing = counts["failed"], counts["missing"]
    return f"{counts['done']} of {len(rows)} done, {failed} failed, {missing} missing{others}"
