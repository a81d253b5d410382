"""A stage's artefact in a store: `build/<recording>/<stage>/<fingerprint>/`, written once and never changed.

The files are in a folder beside the manifest, named by a hash of their content. The manifest is written last;
without it, the artefact does not exist. If two machines make different bytes for a stage, the first manifest
decides which of their folders is valid. The many small files of a sequence, of views and of pairs form one
tar; JSON files are stored separately.
"""

import tarfile
import tempfile
from collections.abc import Collection, Mapping
from functools import partial
from pathlib import Path
from typing import IO

from kinectbench.core import (
    StorageError,
    below,
    canonical_json,
    copy_bounded,
    open_plain,
    printable,
    sha256_file,
    sha256_text,
    storage_errors,
)
from kinectbench.core.artefacts.manifest import Manifest, Timing
from kinectbench.core.store.attempts import MissingObjectError
from kinectbench.core.store.store import MOST_OBJECT_BYTES, Store, fetch_all, in_parallel
from kinectbench.engine.artefact import Artefact

ARCHIVE = "files.tar"
PACKED = ("ingest", "sample-views", "pairs")
# Limit in bytes of a tar besides the files' content: two blocks of 512 bytes for each file, and its end.
TAR_BYTES = 1024
REBUILD = "remove the folder and build again"


def stored_folder(recording: str, artefact: Artefact) -> str:
    """Return the folder of an artefact in the store, relative to the benchmark's root."""
    return f"build/{recording}/{artefact.stage}/{artefact.fingerprint}"


def is_stored(names: Collection[str], recording: str, artefact: Artefact) -> bool:
    """Whether `names`, a listing of `build/<recording>/`, contains the finished artefact."""
    return f"{stored_folder(recording, artefact)}/{Manifest.FILE}" in names


def put_stage(store: Store, recording: str, artefact: Artefact) -> bool:
    """Upload a local artefact unless a finished one exists.

    Returns:
        Whether the store now holds these bytes; False: another run has stored different bytes.

    Raises:
        StorageError: the store fails, or the stored artefact is damaged.
    """
    manifest, where = Manifest.read(artefact.folder), stored_folder(recording, artefact)
    ours = manifest.model_copy(update={"content": _content_hash(artefact.folder, manifest)})
    place = f"{where}/{Manifest.FILE}"
    stored = store.read_if_there(place)
    if stored is None:
        _put_files(store, f"{where}/{ours.content}", artefact, manifest)
        if store.put_new(place, ours.text().encode(), same=lambda stored, ours: True):
            return True
        stored = store.read(place)
    return _parsed(stored, store.place(place), artefact).content == ours.content


def _put_files(store: Store, where: str, artefact: Artefact, manifest: Manifest) -> None:
    packed, loose = _parts(manifest)
    with tempfile.TemporaryDirectory(prefix="kinectbench-", dir=artefact.folder.parent) as scratch:
        files = {name: artefact.folder / name for name in loose}
        if (artefact.folder / Timing.FILE).is_file():
            files[Timing.FILE] = artefact.folder / Timing.FILE
        if packed:
            files[ARCHIVE] = Path(scratch) / ARCHIVE
            pack_files(artefact.folder, packed, files[ARCHIVE])
        in_parallel(partial(store.put, f"{where}/{name}", path) for name, path in files.items())


def fetch_stage(store: Store, recording: str, artefact: Artefact) -> None:
    """Download a stored artefact into its local folder.

    Raises:
        StorageError: the stored artefact is damaged, or is a different one, or the store fails.
    """
    where = stored_folder(recording, artefact)
    manifest = _manifest(store, where, artefact)
    packed, loose = _parts(manifest)
    folder, data = artefact.folder, files_folder(where, manifest)
    files = [(f"{data}/{name}", below(folder, name), manifest.files[name]) for name in loose]
    with tempfile.TemporaryDirectory(prefix="kinectbench-", dir=_made(folder).parent) as scratch:
        archive = Path(scratch) / ARCHIVE
        if packed:
            sizes = {name: manifest.files[name] for name in packed}
            most = min(MOST_OBJECT_BYTES, sum(sizes.values()) + TAR_BYTES * (10 + 2 * len(sizes)))
            files.append((f"{data}/{ARCHIVE}", archive, most))
        try:
            fetch_all(store, files)
        except MissingObjectError as error:
            raise StorageError(f"{store.place(where)}: a file is missing; {REBUILD}") from error
        if packed:
            unpack_files(archive, folder, sizes)
    if any((folder / name).stat().st_size != size for name, size in manifest.files.items()) or (
        manifest.content is not None and manifest.content != _content_hash(folder, manifest)
    ):
        raise StorageError(f"{store.place(where)}: its files are not those of its {Manifest.FILE}; {REBUILD}")
    _written(manifest, folder)


def fetch_file(
    store: Store, recording: str, artefact: Artefact, name: str, names: Collection[str] = ()
) -> None:
    """Download one JSON file of a stored artefact.

    `names`, a listing of `build/<recording>/`, often saves a request: the file's place in the store is read
    from it instead of from the manifest, if it has one such file.
    """
    where, folder = stored_folder(recording, artefact), _made(artefact.folder)
    if name == Manifest.FILE:
        _written(_manifest(store, where, artefact), folder)
        return
    matches = [each for each in names if each.startswith(f"{where}/") and each.endswith(f"/{name}")]
    if len(matches) != 1:
        matches = [f"{files_folder(where, _manifest(store, where, artefact))}/{name}"]
    store.fetch(matches[0], folder / name, 100 << 20)


def files_folder(where: str, manifest: Manifest) -> str:
    """Return the folder in the store that holds an artefact's files: `where`/<content hash>.

    Artefacts of earlier versions, whose manifest has no hash, have their files in `where` itself.
    """
    return where if manifest.content is None else f"{where}/{manifest.content}"


def _content_hash(folder: Path, manifest: Manifest) -> str:
    return sha256_text(canonical_json({name: sha256_file(folder / name) for name in manifest.files}))


def _manifest(store: Store, where: str, artefact: Artefact) -> Manifest:
    place = f"{where}/{Manifest.FILE}"
    return _parsed(store.read(place), store.place(place), artefact)


def _written(manifest: Manifest, folder: Path) -> None:
    """Write a manifest into a local folder, without the key that only stored manifests have."""
    Manifest.model_validate(manifest.model_dump(exclude={"content"})).write(folder)


def _parsed(text: bytes, place: str, artefact: Artefact) -> Manifest:
    manifest = Manifest.parse(text.decode("utf-8", errors="replace"), place)
    if (manifest.stage, manifest.fingerprint) != (artefact.stage, artefact.fingerprint):
        raise StorageError(f"{place}: is of another artefact; {REBUILD}")
    try:
        for name in manifest.files:
            below(artefact.folder, name)
    except ValueError as error:
        raise StorageError(f"{place}: {error}") from error
    return manifest


def _parts(manifest: Manifest) -> tuple[list[str], list[str]]:
    """Return the names of an artefact's files: (files packed into a tar, files stored separately)."""
    names = sorted(manifest.files)
    if manifest.stage not in PACKED:
        return [], names
    return [n for n in names if not n.endswith(".json")], [n for n in names if n.endswith(".json")]


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def pack_files(folder: Path, names: list[str], archive: Path) -> None:
    """Write files into an uncompressed tar, in the given order, without times and owners: reproducibly."""
    with storage_errors(archive), tarfile.open(archive, "w", format=tarfile.PAX_FORMAT) as tar:
        for name in names:
            entry = tarfile.TarInfo(name)
            entry.size = (folder / name).stat().st_size
            with open_plain(folder / name) as file:
                tar.addfile(entry, file)


def unpack_files(archive: Path, folder: Path, sizes: Mapping[str, int]) -> None:
    """Extract a tar that must hold exactly these files with these sizes.

    Args:
        archive: tar from a store, untrusted.
        folder: target; created if missing.
        sizes: name -> bytes of each file.

    Raises:
        StorageError: the tar holds something else, is damaged, or the disk cannot be written.
    """
    left = dict(sizes)
    try:
        with (
            storage_errors(folder),
            open_plain(archive) as file,
            tarfile.open(fileobj=file, mode="r:") as tar,
        ):
            while (entry := tar.next()) is not None:
                if not entry.isreg() or left.pop(entry.name, None) != entry.size:
                    name = printable(entry.name)
                    raise StorageError(f"{archive.name}: '{name}' is not what manifest.json lists")
                _write(tar.extractfile(entry), below(folder, entry.name), entry.size)
                tar.members.clear()  # type: ignore[attr-defined] # it keeps all
    except (tarfile.TarError, ValueError, EOFError) as error:
        raise StorageError(f"{archive.name}: damaged ({printable(str(error))})") from error
    if left:
        raise StorageError(f"{archive.name}: lacks '{printable(next(iter(left)))}' and is damaged")


def _write(source: IO[bytes] | None, path: Path, size: int) -> None:
    assert source is not None, "a regular member has bytes"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as target:
        copy_bounded(source, target, size)
