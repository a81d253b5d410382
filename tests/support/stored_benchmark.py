"""The small benchmark in a store: its recordings, and what was built of them on this machine."""

from collections.abc import Collection
from functools import partial
from pathlib import Path

from kinectbench.core.store.store import Store, in_parallel
from kinectbench.engine.checkout import checked_out
from kinectbench.engine.pipeline import STAGE_NAMES, artefacts_upto
from kinectbench.engine.stages import Job
from kinectbench.engine.stored_stage import put_stage
from kinectbench.settings.file import load_benchmark


def jobs_of(root: Path) -> list[Job]:
    settings = load_benchmark(root / "benchmark.yaml")
    return [Job(settings, recording, root) for recording in settings.recordings]


def put_benchmark(root: Path, url: str, stages: Collection[str] = STAGE_NAMES) -> Store:
    """Put benchmark.yaml, the recordings, and these stages of what was built."""
    store = Store(url)
    files = [root / "benchmark.yaml", *sorted((root / "recordings").rglob("*"))]
    in_parallel(
        partial(store.put, file.relative_to(root).as_posix(), file) for file in files if file.is_file()
    )
    for job in jobs_of(root):
        artefacts = artefacts_upto(job, "pairs")
        for stage in stages:
            put_stage(store, job.recording.id, artefacts[stage])
    return store


def know_sources(url: str) -> None:
    """Let the store know the hashes of the recordings' files, as a build leaves them."""
    settings = load_benchmark(Path(url) / "benchmark.yaml")
    for recording in settings.recordings:
        with checked_out(Job(settings, recording, Path(url))):
            pass
