"""A stage's artefact in a store: `build/<recording>/<stage>/<fingerprint>/`, written once and never changed.

Its manifest is written last: a folder without one is nothing yet. Two that make the same write the same. The
many small files of a sequence, of views and of pairs travel as one tar, JSON apart.
"""

import tempfile
from collections.abc import Collection
from functools import partial
from pathlib import Path

from kinectbench.core.artefacts.manifest import Manifest, Timing
from kinectbench.core.errors import StorageError
from kinectbench.core.store.packed import pack, unpack
from kinectbench.core.store.store import MOST_OBJECT_BYTES, Store, fetch_all, in_parallel
from kinectbench.core.untrusted import below
from kinectbench.engine.artefact import Artefact

ARCHIVE = "files.tar"
PACKED = ("ingest", "sample-views", "pairs")
# A tar's share beyond its files: two blocks of 512 bytes a file, and its end.
TAR_BYTES = 1024


def stored_folder(recording: str, artefact: Artefact) -> str:
    """Where an artefact lies, relative to the benchmark's root."""
    return f"build/{recording}/{artefact.stage}/{artefact.fingerprint}"


def is_stored(names: Collection[str], recording: str, artefact: Artefact) -> bool:
    """Whether a listing of `build/<recording>/` holds the whole artefact."""
    return f"{stored_folder(recording, artefact)}/{Manifest.FILE}" in names


def put_stage(store: Store, recording: str, artefact: Artefact) -> None:
    """Put an artefact that was made here; finding the same there is success.

    Raises:
        StorageError: the store fails, or holds another artefact under the same fingerprint.
    """
    manifest, where = Manifest.read(artefact.folder), stored_folder(recording, artefact)
    packed, loose = _parts(manifest)
    with tempfile.TemporaryDirectory(prefix="kinectbench-", dir=artefact.folder.parent) as scratch:
        files = {name: artefact.folder / name for name in loose}
        if (artefact.folder / Timing.FILE).is_file():
            files[Timing.FILE] = artefact.folder / Timing.FILE
        if packed:
            files[ARCHIVE] = Path(scratch) / ARCHIVE
            pack(artefact.folder, packed, files[ARCHIVE])
        in_parallel(partial(store.put, f"{where}/{name}", path) for name, path in files.items())
    store.put_new(f"{where}/{Manifest.FILE}", manifest.text().encode(), same=_same)


def fetch_stage(store: Store, recording: str, artefact: Artefact) -> None:
    """Fetch a stored artefact into its folder here.

    Raises:
        StorageError: it is damaged, is no such artefact, or the store fails.
    """
    where = stored_folder(recording, artefact)
    manifest = _manifest(store, where, artefact)
    packed, loose = _parts(manifest)
    folder = artefact.folder
    files = [(f"{where}/{name}", below(folder, name), manifest.files[name]) for name in loose]
    with tempfile.TemporaryDirectory(prefix="kinectbench-", dir=_made(folder).parent) as scratch:
        archive = Path(scratch) / ARCHIVE
        if packed:
            sizes = {name: manifest.files[name] for name in packed}
            most = min(MOST_OBJECT_BYTES, sum(sizes.values()) + TAR_BYTES * (10 + 2 * len(sizes)))
            files.append((f"{where}/{ARCHIVE}", archive, most))
        fetch_all(store, files)
        if packed:
            unpack(archive, folder, sizes)
    manifest.write(folder)


def fetch_file(store: Store, recording: str, artefact: Artefact, name: str) -> None:
    """Fetch one JSON file of a stored artefact, without the others."""
    store.fetch(f"{stored_folder(recording, artefact)}/{name}", _made(artefact.folder) / name, 100 << 20)


def _manifest(store: Store, where: str, artefact: Artefact) -> Manifest:
    place, here = f"{where}/{Manifest.FILE}", artefact.folder / Manifest.FILE
    if here.is_file():  # it was fetched before the files
        manifest = Manifest.read_file(here)
    else:
        manifest = Manifest.parse(store.read(place).decode("utf-8", errors="replace"), store.place(place))
    if (manifest.stage, manifest.fingerprint) != (artefact.stage, artefact.fingerprint):
        raise StorageError(f"{store.place(place)}: is of another artefact; remove the folder and build again")
    try:
        for name in manifest.files:
            below(artefact.folder, name)
    except ValueError as error:
        raise StorageError(f"{store.place(place)}: {error}") from error
    return manifest


def _parts(manifest: Manifest) -> tuple[list[str], list[str]]:
    """Names of the files that travel in one tar, and of those that travel alone."""
    names = sorted(manifest.files)
    if manifest.stage not in PACKED:
        return [], names
    return [n for n in names if not n.endswith(".json")], [n for n in names if n.endswith(".json")]


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _same(there: bytes, ours: bytes) -> bool:
    """Whether two manifests are of the same artefact, whichever version of the package made it."""
    try:
        one, other = (Manifest.parse(text.decode(), Manifest.FILE) for text in (there, ours))
    except (StorageError, UnicodeDecodeError):
        return False
    return (one.fingerprint, one.files) == (other.fingerprint, other.files)
