"""Build a recording whose benchmark is in a store: check it out, build it locally, and upload its stages.

The store has no locks or renames, so an artefact lies under its fingerprint. If two machines make the same
artefact with different bytes, the second one goes on with the artefact that was stored first.
"""

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from kinectbench.core import RecordingError, StorageError, error_code
from kinectbench.core.artefacts.manifest import Failed
from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.reconstruction import ReconstructionFile
from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.core.artefacts.trajectory import TrajectoryHealth
from kinectbench.core.artefacts.views import MasksFile, PairsFile, ViewsFile
from kinectbench.core.store.attempts import StoreGoneError
from kinectbench.core.store.store import in_parallel
from kinectbench.core.types import NamedProgress, no_progress
from kinectbench.engine.checkout import (
    Checkout,
    as_there,
    checked_out,
    fetch_recording,
    files_of_recording,
    name_there,
    store_of,
)
from kinectbench.engine.failures import failed_before, forget_failure
from kinectbench.engine.pipeline import Outcome, build_recording, error_line
from kinectbench.engine.stages import STAGES, Job, Stage, stages_upto
from kinectbench.engine.stored_stage import fetch_file, fetch_stage, put_stage
from kinectbench.engine.summary import summary
from kinectbench.engine.time_limit import Hung

# Files from which the table of a build is made, by stage.
SHOWN = {
    "ingest": CameraFile.FILE,
    "track": TrajectoryHealth.FILE,
    "fuse": ReconstructionFile.FILE,
    "segment": QualityFile.FILE,
    "sample-views": ViewsFile.FILE,
    "pairs": PairsFile.FILE,
}


def build_stored(
    job: Job,
    upto: str = "pairs",
    force: Sequence[str] = (),
    progress: NamedProgress | None = None,
    *,
    wait: bool = True,
    limit_s: float | None = None,
    hung: Hung | None = None,
) -> Outcome:
    """Build a recording in a store as `build_recording` does.

    The outcome includes the summary `row`, unless the recording could not be checked out or stored.

    Args:
        job: the recording.
        upto: name of the last stage.
        force: names of stages to make again even if they are current.
        progress: called with (stage, done, total); `fetch` and `put` count as stages.
        wait: has no effect: in a store, runs do not wait for each other.
        limit_s: time limit of the stages, seconds; None: no limit.
        hung: called with the reason, on another thread, if the build still hangs long after the limit.

    Raises:
        StoreGoneError: the store has stopped answering.
    """
    report = progress or no_progress
    started = time.monotonic()

    def once(force: Sequence[str]) -> Outcome | None:
        with checked_out(job, upto, report) as copy:
            build = partial(build_recording, copy.job, upto, force, report, limit_s=limit_s, hung=hung)
            return _built(copy, upto, force, build, report)

    try:
        outcome = once(force)
        while outcome is None:  # each repetition finds one more stored stage
            outcome = once(())
    except StoreGoneError:  # the next recordings would fail, too
        raise
    except Exception as failure:
        outcome = Outcome(job.recording.id, (), (), error_line(failure), 0.0, code=error_code(failure))
        if isinstance(failure, RecordingError):
            with contextlib.suppress(StorageError):
                put_failure(job, Failed(stage=STAGES[0].name, error=str(failure), code=failure.code))
    return replace(outcome, seconds=time.monotonic() - started)


def _built(
    copy: Checkout, upto: str, force: Sequence[str], build: Callable[[], Outcome], report: NamedProgress
) -> Outcome | None:
    """Call `build` if a stage up to `upto` is missing or forced, and upload the stages that it made.

    Returns:
        The outcome; None if another run has stored different bytes of a stage, so that the caller must
        start again.
    """
    missing = [each for each in stages_upto(upto) if each.name not in copy.current or each.name in force]
    if not missing:
        if copy.failed:
            forget_failure(copy.job.build, copy.current)
            _put_failure(copy)
        return _nothing_made(copy, None)
    if missing[0].name not in force:
        failed = failed_before(copy.job.build, copy.artefacts[missing[0].name])
        if failed is not None:
            return _nothing_made(copy, failed)
    _fetch_needed(copy, missing, report)
    drawn = _masks_file(copy)
    outcome = build()
    masks = name_there(copy.store, copy.job, "masks")
    if masks is not None and _masks_file(copy) != drawn:
        copy.store.put(f"{masks}/{MasksFile.FILE}", _masks_file(copy).encode())
    if outcome.error is not None:
        outcome = replace(outcome, error=as_there(copy.store, copy.job.root, outcome.error))
    outcome = replace(outcome, row=summary(copy.job, outcome))
    for number, name in enumerate(outcome.made):
        report("put", number, len(outcome.made))
        if not put_stage(copy.store, copy.job.recording.id, copy.artefacts[name]):
            return None
    _put_failure(copy)
    return outcome


def _masks_file(copy: Checkout) -> str:
    """Return the content of the local masks.json, which a build may extend; "" without it."""
    masks = None if copy.job.masks is None else MasksFile.read_if_there(copy.job.masks)
    return "" if masks is None else masks.text()


def _nothing_made(copy: Checkout, failed: Failed | None) -> Outcome:
    """Return the outcome if no stage has to be built; download only the files that the summary needs."""
    in_parallel(
        partial(fetch_file, copy.store, copy.job.recording.id, copy.artefacts[name], SHOWN[name], copy.built)
        for name in copy.current
        if name in SHOWN
    )
    error, code = (failed.error, failed.code) if failed else (None, None)
    outcome = Outcome(copy.job.recording.id, (), copy.current, error, 0.0, failed is not None, code=code)
    return replace(outcome, row=summary(copy.job, outcome))


def _fetch_needed(copy: Checkout, missing: Sequence[Stage], report: NamedProgress) -> None:
    """Download the artefacts that are up to date, and the recording if `ingest` has to run."""
    job = copy.job
    if any(stage.name == "ingest" for stage in missing) and not job.source.exists():
        fetch_recording(copy.store, job, files_of_recording(copy.store, job), report)
    for number, name in enumerate(copy.current):
        report("fetch", number, len(copy.current))
        fetch_stage(copy.store, job.recording.id, copy.artefacts[name])


def _put_failure(copy: Checkout) -> None:
    """Upload the recording's failed.json, or delete the stored one after success."""
    name, kept = f"build/{copy.job.recording.id}/{Failed.FILE}", Failed.read_if_there(copy.job.build)
    if kept is not None:
        stored = kept.model_copy(update={"error": as_there(copy.store, copy.job.root, kept.error)})
        copy.store.put(name, stored.text().encode())
    elif copy.failed:
        copy.store.delete([name])


def put_failure(job: Job, failed: Failed) -> None:
    """Store why a recording could not be built, as failed.json in its store."""
    store_of(job).put(f"build/{job.recording.id}/{Failed.FILE}", failed.text().encode())
