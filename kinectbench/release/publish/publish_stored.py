"""Publish a benchmark in a store: fetch its build, publish locally, and upload the release."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from kinectbench.core import write_below
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, PublishOptions, PublishStamp
from kinectbench.core.artefacts.manifest import Failed, Manifest
from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.core.artefacts.trajectory import TrajectoryHealth
from kinectbench.core.store.address import joined, url_of
from kinectbench.core.store.store import Store, in_parallel
from kinectbench.core.types import Progress, no_progress
from kinectbench.engine.checkout import Checkout, checkout, named_as_there
from kinectbench.engine.scratch import scratch_folder
from kinectbench.engine.stages import Job
from kinectbench.engine.stored_stage import fetch_file, fetch_stage
from kinectbench.release.publish.publish import PRIVATE, PublishSummary
from kinectbench.release.publish.publish_if_stale import already_published, publish_if_stale
from kinectbench.release.put import put_release

RELEASE = "benchmark"
# {stage: its files that a release is made from; None: all}.
READ: Mapping[str, tuple[str, ...] | None] = {
    "ingest": (Manifest.FILE, CameraFile.FILE),
    "track": (Manifest.FILE, TrajectoryHealth.FILE),
    "fuse": (Manifest.FILE,),
    "segment": None,
    "sample-views": None,
    "pairs": None,
}


def publish_stored(
    jobs: Sequence[Job],
    force: bool = False,
    options: PublishOptions | None = None,
    progress: Progress = no_progress,
) -> PublishSummary:
    """Publish a benchmark whose build is in a store as `benchmark/` in that store; see `publish_if_stale`.

    Args:
        jobs: the built recordings, at least one.
        force: publish again in any case.
        options: options beyond the settings; None: the options of the last publication.
        progress: called with (recordings fetched, recordings in all).

    Raises:
        ReleaseError, SettingsError: as in `publish_if_stale`; or a release's folder in the store holds other
            files.
        StorageError: the store fails; the release in the store may be incomplete until the next run.
    """
    settings, place = jobs[0].settings, jobs[0].root
    url = url_of(place) or ""
    store, names = Store(url), [job.recording.id for job in jobs]
    with scratch_folder() as root, named_as_there(store, root):
        _fetch_state(store, root)
        _fetch_failures(store, root, [each.id for each in settings.recordings if each.id not in names])
        checkouts = [checkout(job, root) for job in jobs]
        in_parallel(partial(_fetch_pairs_manifest, each) for each in checkouts)
        summary = None if force else already_published(settings, root, names, options)
        if summary is None:
            for number, each in enumerate(checkouts, start=1):
                _fetch_read(each)
                progress(number, len(checkouts))
            summary = publish_if_stale(settings, root, names, force, options)
            for part in (summary.folder, summary.private):
                if part is not None:
                    put_release(part, Store(joined(url, part.name)))
            store.put(f"build/{PublishStamp.FILE}", root / "build" / PublishStamp.FILE)
    private = None if summary.private is None else place / summary.private.name
    return replace(summary, folder=place / RELEASE, private=private)


def _fetch_state(store: Store, root: Path) -> None:
    """Download the last publication's record, and benchmark.json of the release and of its private part."""
    for name in (
        f"build/{PublishStamp.FILE}",
        f"{RELEASE}/{BENCHMARK_JSON}",
        f"{RELEASE}{PRIVATE}/{BENCHMARK_JSON}",
    ):
        content = store.read_if_there(name)
        if content is not None:
            write_below(root / name, content)


def _fetch_failures(store: Store, root: Path, names: Sequence[str]) -> None:
    """Download failed.json, the reason why a recording is not built, of each named recording that has it."""
    for name, content in zip(
        names,
        in_parallel(partial(store.read_if_there, f"build/{name}/{Failed.FILE}") for name in names),
        strict=True,
    ):
        if content is not None:
            write_below(root / "build" / name / Failed.FILE, content)


def _fetch_pairs_manifest(copy: Checkout) -> None:
    fetch_file(copy.store, copy.job.recording.id, copy.artefacts["pairs"], Manifest.FILE)


def _fetch_read(copy: Checkout) -> None:
    """Download those files of a built recording that `publish` reads."""
    recording = copy.job.recording.id
    for stage, files in READ.items():
        if files is None:
            fetch_stage(copy.store, recording, copy.artefacts[stage])
        else:
            in_parallel(
                partial(fetch_file, copy.store, recording, copy.artefacts[stage], name) for name in files
            )
