"""Check out a recording whose benchmark is in a store: copy the needed files into a local folder.

The store has no locks. The folder `sources/` keeps the hashes of a recording's files, in a file named by a
hash of the store's listing. So current artefacts are recognised without downloading the recording.
"""

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePosixPath

from kinectbench.core import (
    UNTOUCHED,
    KinectBenchError,
    RecordingError,
    SettingsError,
    StorageError,
    below,
    canonical_json,
    printable,
    sha256_text,
    storage_errors,
    write_below,
)
from kinectbench.core.artefacts.manifest import Failed, Manifest, SourceFile, Sources
from kinectbench.core.store.address import url_of
from kinectbench.core.store.store import Store, StoredObject, fetch_all, in_parallel
from kinectbench.core.types import NamedProgress, no_progress
from kinectbench.engine.artefact import VERSIONS, Artefact, whole_hash
from kinectbench.engine.pipeline import artefacts_upto
from kinectbench.engine.scratch import SCRATCH_VARIABLE, scratch_folder
from kinectbench.engine.stages import STAGES, Job
from kinectbench.engine.stored_stage import is_stored
from kinectbench.settings.pick import PICK_FILE
from kinectbench.stages.ingest.readers import source_files
from kinectbench.stages.ingest.readers.seven_scenes import names_beside
from kinectbench.stages.ingest.sources import MOST_FILES, check_there

SOURCES = "sources"
# Largest failed.json, which holds a line of text.
MOST_FAILED_BYTES = 1 << 20
# Folder of the store in which the file or folder named by each key of a recording lies.
LIE_BELOW = {"path": "recordings", "masks": "masks", "reference": "meshes"}


@dataclass(frozen=True)
class Checkout:
    """A recording from a store, and its local folder.

    Attributes:
        store: store of the benchmark's root.
        job: the recording; its root is a local scratch folder.
        artefacts: the artefacts of the requested stages, by stage.
        current: names of those stages whose artefacts are up to date in the store.
        built: names of all files in the store below `build/<recording>/`.
        failed: whether the store holds a failed.json.
    """

    store: Store
    job: Job
    artefacts: Mapping[str, Artefact]
    current: tuple[str, ...]
    built: frozenset[str]
    failed: bool


@contextlib.contextmanager
def checked_out(job: Job, upto: str = "pairs", report: NamedProgress = no_progress) -> Iterator[Checkout]:
    """Check out a recording into a local folder for the time of the block; artefacts are not downloaded yet.

    The recording is downloaded only if the hashes of its files are not stored.

    Raises:
        SettingsError: the path of the recording, its masks or its reference mesh leads out of the store.
        RecordingError: the recording is missing, or is no recording.
        StorageError: the store fails.
    """
    with scratch_folder() as root, named_as_there(store_of(job), root):
        yield checkout(job, root, upto, report)


def checkout(job: Job, root: Path, upto: str = "pairs", report: NamedProgress = no_progress) -> Checkout:
    """Check out a recording into an existing folder; see `checked_out`."""
    listing, job = _listing(job), replace(job, root=root)
    recording = _of_known_files(listing, job, upto)
    if recording is not None:
        return recording
    store = listing.store
    fetch_recording(store, job, listing.files, report)
    STAGES[0].sources(job)  # hashes the files, and keeps the hashes
    known = Sources.read(job.build)
    rows = {file: SourceFile(row.size, 0, row.sha256) for file, row in known.files.items()}
    store.put_new(listing.sources, Sources.model_validate(rows).text().encode())
    return _checkout(listing, job, known, upto)


@dataclass(frozen=True)
class _Listing:
    """A store's listing of a recording's files.

    Attributes:
        store: store of the benchmark's root.
        files: the recording's own files.
        built: all files below `build/<recording>/`, by name.
        sources: name of the file for the hashes of the recording's files.
    """

    store: Store
    files: Sequence[StoredObject]
    built: Mapping[str, StoredObject]
    sources: str


def store_of(job: Job) -> Store:
    """Return the store of a job whose root is a URL."""
    url = url_of(job.root)
    assert url is not None, "a benchmark on this machine is not fetched"
    return Store(url)


def _listing(job: Job) -> _Listing:
    store = store_of(job)
    files = files_of_recording(store, job)
    built = {each.name: each for each in store.objects(f"build/{job.recording.id}")}
    if Path(job.recording.path).is_absolute() and not job.source.exists():
        kept = [name for name in built if name.startswith(f"build/{job.recording.id}/{SOURCES}/")]
        if len(kept) == 1:  # the scan was deleted after this build
            return _Listing(store, files, built, kept[0])
    return _Listing(store, files, built, sources_name(job, files))


def _of_known_files(listing: _Listing, job: Job, upto: str) -> Checkout | None:
    """Check out a recording by its stored hashes; None if its files have not been hashed yet."""
    if listing.sources not in listing.built:
        return None
    text = listing.store.read(listing.sources)
    known = Sources.parse(text.decode("utf-8", errors="replace"), listing.store.place(listing.sources))
    write_below(job.build / Sources.FILE, text)
    return _checkout(listing, job, known, upto)


def _checkout(listing: _Listing, job: Job, known: Sources, upto: str) -> Checkout:
    """Check out a recording whose hashes are known, with its masks, reference mesh and last failure."""
    store, name = listing.store, job.recording.id
    fetch_named(store, job)
    job = replace(job, source_sha256=whole_hash(known))
    artefacts = artefacts_upto(job, upto)
    current = tuple(stage for stage, made in artefacts.items() if is_stored(listing.built, name, made))
    failed = f"build/{name}/{Failed.FILE}"
    if failed in listing.built:
        store.fetch(failed, job.build / Failed.FILE, MOST_FAILED_BYTES)
    return Checkout(store, job, artefacts, current, frozenset(listing.built), failed in listing.built)


def fetch_named(store: Store, job: Job) -> None:
    """Download the user's masks and the reference mesh below the job's root, if benchmark.yaml names any."""
    masks, mesh = name_there(store, job, "masks"), name_there(store, job, "reference")
    if masks is not None:
        fetch_files(store, job.root, store.objects(masks))
    if mesh is not None and (found := store.head(mesh)) is not None:
        fetch_files(store, job.root, [found])


def name_there(store: Store, job: Job, key: str) -> str | None:
    """Return the store's name for the file or folder to which a key of the recording refers.

    The key is "path", "masks" or "reference". The result is None if the key is not set, or if it is an
    absolute path: such a path is on a disk that all machines share, not in the store.

    Raises:
        SettingsError: the path leads out of the store.
    """
    path = PurePosixPath(getattr(job.recording, key) or "/")
    if path.is_absolute():
        return None
    if ".." in path.parts or not path.parts:
        raise SettingsError(
            f"recordings.{job.recording.id}.{key}: '{printable(str(path))}' leads out of {store.place()}; "
            f"{LIE_BELOW[key]} of a benchmark in a store lie below it",
            what="outside-folder",
        )
    return str(path)


def status_there(job: Job) -> tuple[tuple[str, ...], Failed | None, list[StoredObject]]:
    """Return the status of a recording in a store, without downloading the recording.

    Returns:
        Names of the stages that are up to date (none if the recording's files have not been hashed); why the
        last run failed, None if it did not; and the stored files below `build/<recording>/`. A missing
        recording, or a path that leads out of the store, counts as a failure.
    """
    try:
        listing = _listing(job)
        with scratch_folder() as root, named_as_there(listing.store, root):
            known = _of_known_files(listing, replace(job, root=root), STAGES[-1].name)
    except (RecordingError, SettingsError) as error:
        return (), Failed(stage=None, error=str(error), code=error.code), []
    name, failed = f"build/{job.recording.id}/{Failed.FILE}", None
    if name in listing.built:
        text = listing.store.read(name, MOST_FAILED_BYTES)
        failed = Failed.parse(text.decode("utf-8", errors="replace"), listing.store.place(name))
    return () if known is None else known.current, failed, list(listing.built.values())


def newest_there(job: Job, stage: str, built: Sequence[StoredObject]) -> Manifest | None:
    """Return the manifest of a stage's latest stored artefact; None if there is no readable one.

    `built` are the files of the store below `build/<recording>/`.
    """
    store = store_of(job)
    made = [each for each in built if PurePosixPath(each.name).match(f"{stage}/*/{Manifest.FILE}")]
    if not made:
        return None
    name = max(made, key=lambda each: each.modified_s).name
    with contextlib.suppress(StorageError):
        return Manifest.parse(store.read(name).decode("utf-8", errors="replace"), store.place(name))
    return None


def fetch_recording(store: Store, job: Job, listed: Sequence[StoredObject], report: NamedProgress) -> None:
    """Download a recording's files into the job's root, unless its path is absolute."""
    if not Path(job.recording.path).is_absolute():
        fetch_files(store, job.root, listed, lambda done: report("fetch", done, len(listed)))


def fetch_files(
    store: Store, root: Path, listed: Sequence[StoredObject], done: Callable[[int], None] = lambda count: None
) -> None:
    """Download files into a folder, under their names in the store; hidden files are skipped."""
    seen = [each for each in listed if not _hidden(each.name)]
    try:
        files = [(each.name, below(root, each.name), each.size) for each in seen]
    except ValueError as error:
        raise RecordingError(f"{store.place()}: {error}", what="not-fetched") from error
    with storage_errors(root):
        fetch_all(store, files, done)


def files_of_recording(store: Store, job: Job) -> list[StoredObject]:
    """List a recording's files in the store, including files beside its folder that belong to it.

    Returns:
        The files, without hidden files and without the file of the point that the user clicked; [] if the
        recording's path is absolute.

    Raises:
        SettingsError: the path leads out of the store.
        RecordingError: there is no such recording.
    """
    name = name_there(store, job, "path")
    if name is None:
        return []
    path = PurePosixPath(name)
    clicked = str(path / PICK_FILE)  # not part of the recording, as in `source_files`
    objects = store.objects(name, MOST_FILES)
    listed = [each for each in objects if not _hidden(each.name) and each.name != clicked]
    if listed:
        names = names_beside(PurePosixPath(each.name).name for each in listed)
        beside = in_parallel(partial(store.head, str(path.parent / name)) for name in names)
        return listed + [each for each in beside if each is not None]
    file = store.head(name)
    if file is None:
        raise RecordingError(
            f"{store.place(name)}: no such recording; correct `path` of '{job.recording.id}'",
            what="not-found",
        )
    return [file]


def sources_name(job: Job, listed: Sequence[StoredObject]) -> str:
    """Return the name under which the store has the hashes of a recording's files.

    The name changes with the names, sizes and ETags of the listed files (without ETags, with their times);
    for an absolute path, with the names, sizes and times of the files there. It also changes with the version
    of `ingest`, because another version may read other files.

    Raises:
        RecordingError: nothing is at the absolute path, or what is there cannot be listed.
    """
    if Path(job.recording.path).is_absolute():
        rows = _local_rows(job)
    else:
        rows = [[each.name, each.size, each.e_tag or each.modified_s] for each in listed]
    listing = sha256_text(canonical_json([VERSIONS["ingest"], job.recording.path, rows]))
    return f"build/{job.recording.id}/{SOURCES}/{listing}.json"


def _local_rows(job: Job) -> list[object]:
    """Return the names, sizes and times (nanoseconds) of the files of a recording outside the store."""
    check_there(job.source, f"no such recording; correct `path` of '{job.recording.id}'")
    with storage_errors(job.source):
        files = source_files(job.source, follow_links=job.recording.follow_links)
        found = [(str(file), file.stat()) for file in files]
    return [[name, of.st_size, of.st_mtime_ns] for name, of in found]


def _hidden(name: str) -> bool:
    return any(part.startswith(".") and part != ".." for part in PurePosixPath(name).parts)


@contextlib.contextmanager
def named_as_there(store: Store, root: Path) -> Iterator[None]:
    """Make errors raised in the block name the store instead of the scratch folder."""
    try:
        yield
    except KinectBenchError as error:
        raise type(error)(*(as_there(store, root, line) for line in error.lines), what=error.what) from error


def as_there(store: Store, root: Path, text: str) -> str:
    """Replace a local folder in an error message by the URL of the store.

    A message that the local disk cannot be written keeps the local path.
    """
    own = f"{SCRATCH_VARIABLE}={root}" if text.endswith(UNTOUCHED) else store.place()
    return text.replace(str(root), own)
