"""A recording whose benchmark lies in a store: checked out and built here, its stages put back.

In the store nothing is locked or renamed: what a stage makes lies under its fingerprint. Whoever makes it
again makes the same; a machine that makes other bytes goes on from those that were there first.
"""

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import PurePosixPath

from kinectbench.core.artefacts.manifest import Failed
from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.reconstruction import ReconstructionFile
from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.core.artefacts.trajectory import TrajectoryHealth
from kinectbench.core.artefacts.views import MasksFile, PairsFile, ViewsFile
from kinectbench.core.errors import RecordingError, StorageError, error_code
from kinectbench.core.store.attempts import StoreGoneError
from kinectbench.core.store.store import in_parallel
from kinectbench.engine.checkout import (
    Checkout,
    Report,
    as_there,
    checked_out,
    fetch_recording,
    files_of_recording,
    nobody,
    store_of,
)
from kinectbench.engine.failures import failed_before, forget_failure
from kinectbench.engine.pipeline import Outcome, build_recording, told
from kinectbench.engine.stages import STAGES, Job, Stage, stages_upto
from kinectbench.engine.stored_stage import fetch_file, fetch_stage, put_stage
from kinectbench.engine.summary import summary
from kinectbench.engine.time_limit import Hung

# What the table of a build shows comes from these.
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
    progress: Report | None = None,
    *,
    limit_s: float | None = None,
    hung: Hung | None = None,
) -> Outcome:
    """`build_recording` of a recording whose root is a URL; its outcome holds its row of the table.

    Args:
        job: the recording.
        upto: name of the last stage.
        force: names of stages to make anew even if they are current.
        progress: called with (stage, done, total); `fetch` and `put` are stages, too.
        limit_s: how long its stages may take, seconds; None: as long as they do.
        hung: see `build_recording`.

    Raises:
        StoreGoneError: the store does not answer any more.
    """
    report = progress or nobody
    started = time.monotonic()
    try:
        once = partial(_once, job, upto, report=report, limit_s=limit_s, hung=hung)
        outcome = once(force)
        while outcome is None:  # each time a stage more is there already
            outcome = once(())
    except StoreGoneError:  # nor would the next recordings find it
        raise
    except Exception as failure:
        outcome = Outcome(job.recording.id, (), (), told(failure), 0.0, code=error_code(failure))
        if isinstance(failure, RecordingError):
            with contextlib.suppress(StorageError):
                put_failure(job, Failed(stage=STAGES[0].name, error=str(failure), code=failure.code))
    return replace(outcome, seconds=time.monotonic() - started)


def _once(
    job: Job,
    upto: str,
    force: Sequence[str],
    *,
    report: Report,
    limit_s: float | None,
    hung: Hung | None,
) -> Outcome | None:
    with checked_out(job, upto, report) as found:
        build = partial(build_recording, found.job, upto, force, report, limit_s=limit_s, hung=hung)
        return _built(found, upto, force, build, report)


def _built(
    found: Checkout, upto: str, force: Sequence[str], build: Callable[[], Outcome], report: Report
) -> Outcome | None:
    """The outcome; None if a stage was there first with other bytes, from which the next are to be made."""
    missing = [each for each in stages_upto(upto) if each.name not in found.current or each.name in force]
    if not missing:
        if found.failed:
            forget_failure(found.job.build, found.current)
            _put_failure(found)
        return _nothing_made(found, None)
    if missing[0].name not in force:
        failed = failed_before(found.job.build, found.artefacts[missing[0].name])
        if failed is not None:
            return _nothing_made(found, failed)
    _fetch_needed(found, missing, report)
    drawn = _masks_file(found)
    outcome = build()
    if _masks_file(found) != drawn:
        place = PurePosixPath(f"{found.job.recording.masks}", MasksFile.FILE)
        found.store.put(str(place), _masks_file(found).encode())
    if outcome.error is not None:
        outcome = replace(outcome, error=as_there(found.store, found.job.root, outcome.error))
    outcome = replace(outcome, row=summary(found.job, outcome))
    for number, name in enumerate(outcome.made):
        report("put", number, len(outcome.made))
        if not put_stage(found.store, found.job.recording.id, found.artefacts[name]):
            return None
    _put_failure(found)
    return outcome


def _masks_file(found: Checkout) -> str:
    """What masks.json says here, which a build may add to; "" if there is none."""
    masks = None if found.job.masks is None else MasksFile.read_if_there(found.job.masks)
    return "" if masks is None else masks.text()


def _nothing_made(found: Checkout, failed: Failed | None) -> Outcome:
    """Of a recording that is up to date, or failed before: only what the table shows is fetched."""
    in_parallel(
        partial(
            fetch_file, found.store, found.job.recording.id, found.artefacts[name], SHOWN[name], found.built
        )
        for name in found.current
        if name in SHOWN
    )
    error, code = (failed.error, failed.code) if failed else (None, None)
    outcome = Outcome(found.job.recording.id, (), found.current, error, 0.0, failed is not None, code=code)
    return replace(outcome, row=summary(found.job, outcome))


def _fetch_needed(found: Checkout, missing: Sequence[Stage], report: Report) -> None:
    """Fetch the recording, if it is read again and not here already, and what was built of it before."""
    job = found.job
    if any(stage.name == "ingest" for stage in missing) and not job.source.exists():
        fetch_recording(found.store, job, files_of_recording(found.store, job), report)
    for number, name in enumerate(found.current):
        report("fetch", number, len(found.current))
        fetch_stage(found.store, job.recording.id, found.artefacts[name])


def _put_failure(found: Checkout) -> None:
    """Leave in the store why the recording failed, as it is kept here; or that it does not any more."""
    name, kept = f"build/{found.job.recording.id}/{Failed.FILE}", Failed.read_if_there(found.job.build)
    if kept is not None:
        told_there = kept.model_copy(update={"error": as_there(found.store, found.job.root, kept.error)})
        found.store.put(name, told_there.text().encode())
    elif found.failed:
        found.store.delete([name])


def put_failure(job: Job, failed: Failed) -> None:
    """Leave in the store why a recording could not be built."""
    store_of(job).put(f"build/{job.recording.id}/{Failed.FILE}", failed.text().encode())
