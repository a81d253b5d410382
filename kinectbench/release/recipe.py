"""Recipes: download the public scans that a sources.yaml lists, and add them to the recipe's benchmark.

sources.yaml, sources.lock and the scans are untrusted. sources.lock pins the hashes of the first download.
"""

import contextlib
import os
import shutil
import threading
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from kinectbench.core import (
    KinectBenchError,
    SettingsError,
    StorageError,
    open_plain,
    read_plain_text,
    replaced_file,
    sha256_file,
    storage_errors,
)
from kinectbench.core.artefacts.sources_lock import LockedFile, ScanIndex, SourcesLock
from kinectbench.core.store.attempts import StoreGoneError
from kinectbench.core.store.download import MOST_FILE_BYTES, Content, download, partial_downloads
from kinectbench.core.store.store import in_parallel
from kinectbench.core.types import Progress, no_progress
from kinectbench.engine.locks import locked, only_writer
from kinectbench.release.unpack import unpack_archive
from kinectbench.settings import yaml_nodes
from kinectbench.settings.file import load_benchmark
from kinectbench.settings.sources import SOURCES_YAML, Scan, SourcesSettings, chosen_scans, read_sources
from kinectbench.settings.template import yaml_text

BENCHMARK, RECORDINGS = "benchmark.yaml", "recordings.yaml"
SCANS, INDEX = "scans", "index.json"
# Number of scans downloaded at a time: public servers are shared, and a browser opens six connections.
AT_ONCE = 4
# Largest list of scans: a million ids take 16 MB.
INDEX_BYTES = 16 << 20
HEADER = """\
# Written by `kinectbench fetch`: a recording for each scan that was fetched. What you change stays;
# scans that are fetched later are added at the end.
recordings:
"""


class NoRoomError(StorageError):
    """The disk has no room for a download; the downloads that follow are not tried."""

    what = "no-room"


@dataclass(frozen=True)
class FetchedScan:
    """The outcome of downloading one scan.

    Attributes:
        scan: the scan.
        fetched: whether it was downloaded now; False if it was here already or the download failed.
        error: why the download failed (or the build, with `fetch --stream`), one line; None on success.
    """

    scan: Scan
    fetched: bool
    error: str | None = None


def is_recipe(name: str) -> bool:
    """Return whether `name` is a recipe: a local folder with a sources.yaml."""
    return os.path.isfile(f"{name}/{SOURCES_YAML}")  # noqa: PTH113 - whatever the name is


@dataclass(frozen=True)
class Recipe:
    """An open recipe, made by `opened_recipe`.

    Attributes:
        folder: the folder that holds sources.yaml and sources.lock.
        out: the benchmark's folder; it may be the same.
        sources: the content of sources.yaml.
        is_read: function that returns whether a recording reader can open a file without unpacking it. If it
            returns False for a zip archive, the archive is unpacked.
    """

    folder: Path
    out: Path
    sources: SourcesSettings
    is_read: Callable[[Path], bool]
    _locked: dict[str, LockedFile]
    _writing: threading.Lock = field(default_factory=threading.Lock)

    def chosen(self, categories: tuple[str, ...] = (), limit: int | None = None) -> list[Scan]:
        """Return the scans of some categories, at most `limit` of each; first download the index if missing.

        If no categories are given, scans of all categories are returned.

        Raises:
            SettingsError: there are no such scans, or the index of scans is invalid.
            StorageError: the index cannot be downloaded.
        """
        listed: dict[str, list[str]] = {}
        index = self.sources.index
        if index is not None:
            path = self.out / SCANS / INDEX
            self._bring(
                index.file, path, index.bases, index.sha256, most_bytes=INDEX_BYTES, check=ScanIndex.read_file
            )
            listed = ScanIndex.read_file(path).scans
        return chosen_scans(self.sources, listed, categories, limit)

    def place(self, scan: Scan) -> str:
        """Return the path of a downloaded scan's recording, relative to the benchmark's folder."""
        return scan.folder if (self.out / scan.folder).is_dir() else scan.path

    def fetch_all(self, scans: Sequence[Scan], progress: Progress = no_progress) -> list[FetchedScan]:
        """Download scans in parallel; a failure does not stop the others.

        Raises:
            NoRoomError: the disk has no room for a scan.
            StoreGoneError: no server answers any more.
        """
        files = {scan.scan: scan for scan in scans}

        def done(count: int) -> None:
            progress(count, len(files))

        came = in_parallel((partial(self.fetch, scan) for scan in files.values()), done, AT_ONCE)
        of_file = dict(zip(files, came, strict=True))
        return [replace(of_file[scan.scan], scan=scan) for scan in scans]

    def fetch(self, scan: Scan, room: Callable[[int], object] | None = None) -> FetchedScan:
        """Download a scan and unpack its archive if needed; return the outcome, also if it is a failure.

        Args:
            scan: the scan.
            room: called with the expected size in bytes; raises an error if there is no room. None: a
                function that checks the free space of the disk.

        Raises:
            NoRoomError: there is no room.
            StoreGoneError: no server answers any more.
        """
        folder = self.out / scan.folder
        archive = self.out / scan.archive
        is_zip = archive.suffix == ".zip"
        try:
            if (scan.unpacked or is_zip) and folder.is_dir() and scan.file in self._locked:
                return FetchedScan(scan, False)
            check = (
                partial(unpack_archive, folder=folder)
                if scan.unpacked
                else _check_zip
                if is_zip
                else _no_check
            )
            came = self._bring(scan.file, archive, self.sources.bases, room=room, check=check)
            if is_zip and not self.is_read(archive):
                unpack_archive(archive, folder)
            if folder.is_dir():
                archive.unlink()
        except (NoRoomError, StoreGoneError):
            raise
        except KinectBenchError as error:
            return FetchedScan(scan, False, f"{scan.scan}: {error}")
        return FetchedScan(scan, came)

    def _bring(
        self,
        file: str,
        path: Path,
        bases: Sequence[str],
        sha256: str | None = None,
        *,
        check: Callable[[Path], object],
        most_bytes: int = MOST_FILE_BYTES,
        room: Callable[[int], object] | None = None,
    ) -> bool:
        """Download and check a missing file, and record its hash; return whether it was downloaded.

        `file` is the file's name below each of the URLs `bases`, which are tried in turn, and in
        sources.lock. `path` is its place on the disk. `sha256` is the expected hash, None if it is not known.
        """
        row = self._locked.get(file)
        if row is not None and sha256 not in (None, row.sha256):
            raise SettingsError(
                f"{self.folder / SourcesLock.FILE}: '{file}' has another hash than in {SOURCES_YAML}"
            )
        if path.exists():
            content = Content(path.stat().st_size, sha256_file(path))
            if content.sha256 != (row.sha256 if row else sha256 or content.sha256):
                raise _other_file(path)
            check(path)
            self._lock(file, path, content)
            return False
        downloaded = download(
            [f"{base}/{file}" for base in bases],
            path,
            row.sha256 if row else sha256,
            row.bytes if row else None,
            check=check,
            most_bytes=most_bytes,
            room=room or partial(_refuse_full, path),
        )
        self._lock(file, path, downloaded)
        return True

    def _lock(self, file: str, path: Path, content: Content) -> None:
        """Record the size and hash of a file as `file` in sources.lock, unless this name is there already.

        Raises:
            StorageError: a fetch to another folder has recorded a different hash under this name.
        """
        with self._writing, only_writer(self.folder):
            if file in self._locked:
                return
            # A fetch with another --out may have added entries since this one began.
            since = SourcesLock.read_if_there(self.folder) or SourcesLock()
            self._locked.update(since.files)
            row = self._locked.setdefault(file, LockedFile(bytes=content.size, sha256=content.sha256))
            if row.sha256 != content.sha256:
                raise _other_file(path)
            with replaced_file(self.folder / SourcesLock.FILE) as temporary:
                files = dict(sorted(self._locked.items()))
                temporary.write_text(SourcesLock(files=files).text(), encoding="utf-8")

    def add_to_benchmark(self, scans: Sequence[Scan]) -> None:
        """Add scans to recordings.yaml, which the recipe's benchmark.yaml includes; existing entries stay.

        Raises:
            SettingsError: benchmark.yaml is wrong, or does not include recordings.yaml; or recordings.yaml is
                unreadable, or written so that no entry can be added at its end.
            StorageError: a file cannot be written.
        """
        if not scans:
            return
        config, path = self.out / BENCHMARK, self.out / RECORDINGS
        text = _text(path) if path.exists() else HEADER
        known = _ids(text, str(path))
        text = text if text.endswith("\n") else f"{text}\n"
        text += "".join(_entry(self, scan) for scan in scans if scan.id not in known)
        if path.exists() and text == _text(path):
            return
        if not config.exists():
            with storage_errors(config):
                shutil.copyfile(self.folder / BENCHMARK, config)
        known_ids = set[str]()
        with contextlib.suppress(SettingsError):
            known_ids = _ids(text, str(path))
        if known_ids != known | {scan.id for scan in scans}:
            raise SettingsError(f"{path}: nothing can be added to it; begin each entry with '  - id: …'")
        with replaced_file(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
        missing = {scan.id for scan in scans} - load_benchmark(config).by_id().keys()
        if missing:
            raise SettingsError(f"{config}: does not include the scans; add `include: [{RECORDINGS}]` to it")

    def other_attribution(self, scans: Sequence[Scan]) -> list[str]:
        """Return a line if recordings.yaml and sources.yaml disagree on the licence or source of a scan.

        Raises:
            SettingsError: benchmark.yaml is wrong.
        """
        wanted = (self.sources.license, self.sources.source)
        rows = load_benchmark(self.out / BENCHMARK).by_id() if scans else {}
        others = [
            scan.id
            for scan in scans
            if (row := rows.get(scan.id)) and (row.license or wanted[0], row.source or wanted[1]) != wanted
        ]
        if not others:
            return []
        return [
            f"{self.out / RECORDINGS}: {len(others)} entries, such as {others[0]}, state another license or "
            f"source than {SOURCES_YAML}; fetch changes no entry: edit them there, or delete them and fetch "
            "again"
        ]


@contextlib.contextmanager
def opened_recipe(
    folder: Path,
    out: Path | None = None,
    waiting: Callable[[str], None] | None = None,
    *,
    is_read: Callable[[Path], bool],
) -> Iterator[Recipe]:
    """Open a recipe, and lock `scans/` in the benchmark's folder against other downloads.

    Args:
        folder: the folder that holds sources.yaml.
        out: the benchmark's folder; default: `folder`.
        waiting: called once before waiting, with the name of the other process that downloads there.
        is_read: function that returns whether a recording reader can open a file without unpacking it.

    Raises:
        SettingsError: sources.yaml or sources.lock is wrong, there is no benchmark.yaml, or `out` is a file.
        StorageError: the folder cannot be written.
    """
    sources = read_sources(folder)
    place = out or folder
    if not (folder / BENCHMARK).is_file() and not (place / BENCHMARK).is_file():
        raise SettingsError(
            f"{folder / BENCHMARK}: no such file; a recipe has one beside {SOURCES_YAML}", what="no-file"
        )
    if place.exists() and not place.is_dir():
        raise SettingsError(f"--out {place}: a file; name a folder", what="already-exists")
    with locked(place / SCANS, waiting=waiting):
        lock = SourcesLock.read_if_there(folder) or SourcesLock()
        yield Recipe(folder, place, sources, is_read, dict(lock.files))


def _refuse_full(path: Path, size: int) -> None:
    free = shutil.disk_usage(path.parent).free
    if size > free:
        raise NoRoomError(
            f"{path}: needs {size} bytes, and the disk has {free}; free some space, or use --stream"
        )


def _other_file(path: Path) -> StorageError:
    return StorageError(
        f"{path}: differs from the file of the first download; remove it to fetch it again",
        what="other-content",
    )


def _check_zip(path: Path) -> None:
    """Raise an error if a file lacks the end record of a zip archive, which is missing if it was cut off."""
    with open_plain(path) as file:
        if not zipfile.is_zipfile(file):
            raise StorageError(f"{path}: not a whole zip archive; download it again", what="not-fetched")


def _no_check(path: Path) -> None:
    """Do not check a file that is no archive; the readers of recordings check it later."""


def remove_scan(out: Path, scan: Scan) -> None:
    """Delete a scan's files and its partial downloads from the benchmark's folder `out`."""
    archive = out / scan.archive
    for each in (out / scan.path, out / scan.folder, archive, *partial_downloads(archive)):
        if each.is_dir():
            shutil.rmtree(each)
        else:
            each.unlink(missing_ok=True)


def _text(path: Path) -> str:
    try:
        return read_plain_text(path, INDEX_BYTES)
    except (OSError, UnicodeDecodeError) as error:
        raise SettingsError(
            f"{path}: cannot be read ({getattr(error, 'strerror', '') or error})", what="unreadable"
        ) from None


def _ids(text: str, source: str) -> set[str]:
    """Return the ids of the recordings in the text of a recordings.yaml."""
    entries = yaml_nodes.items(yaml_nodes.compose(text, source)).get("recordings")
    rows = entries.value if entries is not None and isinstance(entries.value, list) else []
    return {str(id_.value) for row in rows if (id_ := yaml_nodes.items(row).get("id"))}


def _entry(recipe: Recipe, scan: Scan) -> str:
    """Return the entry of a scan's recording in recordings.yaml, as lines of YAML."""
    sources = recipe.sources
    rows: dict[str, object] = {"path": recipe.place(scan), "category": scan.category, "split": scan.split}
    if scan.object != scan.id:
        rows["object"] = scan.object
    if scan.camera is not None:
        rows["camera"] = scan.camera.model_dump(exclude_unset=True)
    rows |= sources.entry.model_dump(exclude_none=True)
    rows |= {"license": sources.license, "source": sources.source}
    lines = [f"  - id: {yaml_text(scan.id)}", *(f"    {key}: {yaml_text(row)}" for key, row in rows.items())]
    return "\n".join(lines) + "\n"
