"""Looking into a release, in a folder, a zip or a tar. What strangers packed is not trusted."""

import gzip
import stat
import tarfile
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import IO, cast

from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON
from kinectbench.core.artefacts.targets import SHA256SUMS
from kinectbench.core.errors import ReleaseError
from kinectbench.core.storage import storage_errors
from kinectbench.release.contents import DAMAGED, LINK, Contents, Entry, release_files

ZIP, GZIP = b"PK", b"\x1f\x8b"
# A release's own files are packed already: they shrink little.
MAX_INFLATION, SLACK_BYTES = 100, 64 << 20
CHUNK_BYTES = 1 << 20


@contextmanager
def open_contents(path: Path) -> Iterator[Contents]:
    """Look into a release.

    Args:
        path: its folder, or an archive: .zip, .tar, .tar.gz. In an archive it may lie in one folder.

    Raises:
        ReleaseError: there is no release, the archive is cut off, or it claims to hold far more than
            its size.
    """
    if path.is_file():
        with _open_archive(path) as contents:
            yield _rooted(contents, path)
        return
    contents = _folder(path)
    if not any(name in contents.entries for name in (BENCHMARK_JSON, SHA256SUMS)):
        raise ReleaseError(f"{path}: no release there; run publish or download one")
    yield contents


def _folder(path: Path) -> Contents:
    """The files of a folder, none where there is no folder; links are not followed."""
    entries = {file.relative_to(path).as_posix(): _entry(file) for file in release_files(path)}
    if (path / SHA256SUMS).is_symlink() or (path / SHA256SUMS).exists():
        entries[SHA256SUMS] = _entry(path / SHA256SUMS)
    return Contents(entries)


def _entry(file: Path) -> Entry:
    problem = LINK if file.is_symlink() else None if file.is_file() else "not a plain file"
    return Entry(0 if problem else file.stat().st_size, lambda: file.open("rb"), problem)


def _rooted(contents: Contents, path: Path) -> Contents:
    """The files of a release that lies at the top of an archive, or in a folder of it.

    Raises:
        ReleaseError: there is none, or there are several.
    """
    known = (BENCHMARK_JSON, SHA256SUMS)
    if any(name in contents.entries for name in known):
        return contents
    tops = {name.partition("/")[0] for name in contents.entries if name.partition("/")[2] in known}
    if len(tops) != 1:
        found = "several" if tops else "none"
        raise ReleaseError(f"{path}: must hold one release, at its top or in one folder; it holds {found}")
    top = f"{tops.pop()}/"
    inside = {name.removeprefix(top): e for name, e in contents.entries.items() if name.startswith(top)}
    outside = [
        f"{name}: beside the release's folder" for name in contents.entries if not name.startswith(top)
    ]
    return Contents(inside, (*contents.problems, *outside))


@contextmanager
def _open_archive(path: Path) -> Iterator[Contents]:
    """Look into a .zip, .tar or .tar.gz, whatever its name ends in.

    A zip or a tar is read where it is. A .tar.gz is inflated into one temporary file without a name, for
    its files cannot be reached otherwise.

    Raises:
        ReleaseError: it is none of these, cut off, or claims to hold over 100 times its size.
        StorageError: no room for the temporary file.
    """
    with ExitStack() as stack:
        try:
            contents = _opened(path, stack)
        except (*DAMAGED, gzip.BadGzipFile) as error:
            raise ReleaseError(
                f"{path}: cut off or damaged, or no .zip, .tar or .tar.gz ({error}); download it again"
            ) from error
        yield contents


def _opened(path: Path, stack: ExitStack) -> Contents:
    """An archive's files; what is to be closed goes onto the stack."""
    file: IO[bytes] = stack.enter_context(path.open("rb"))
    head = file.read(2)
    file.seek(0)
    if head == ZIP:
        return _zip_contents(stack.enter_context(zipfile.ZipFile(file)), path)
    if head == GZIP:
        with storage_errors(Path(tempfile.gettempdir())):
            inflated = stack.enter_context(tempfile.TemporaryFile())  # noqa: SIM115
            _inflate(file, inflated, path)
        file = inflated
    return _tar_contents(stack.enter_context(tarfile.open(fileobj=file, mode="r:")), file, path)


def _inflate(packed: IO[bytes], inflated: IO[bytes], path: Path) -> None:
    """Write what a gzip file holds, no more than a release can."""
    limit = _limit(path)
    with gzip.GzipFile(fileobj=packed) as source:
        while chunk := source.read(CHUNK_BYTES):
            inflated.write(chunk)
            if inflated.tell() > limit:
                raise _bomb(path)
    inflated.seek(0)


def _zip_contents(archive: zipfile.ZipFile, path: Path) -> Contents:
    members = []
    for info in archive.infolist():
        problem = LINK if stat.S_ISLNK(info.external_attr >> 16) else None
        if info.flag_bits & 1:
            problem = "encrypted"
        if not info.is_dir():
            members.append((info.filename, Entry(info.file_size, partial(archive.open, info), problem)))
    return _contents(members, path)


def _tar_contents(archive: tarfile.TarFile, file: IO[bytes], path: Path) -> Contents:
    members = []
    for info in archive:
        problem = None
        if info.issym() or info.islnk():
            problem = LINK
        elif not info.isfile() or info.issparse():
            problem = "not a plain file"
        # A plain file always opens; links and others are never asked for.
        opener = cast(Callable[[], IO[bytes]], partial(archive.extractfile, info))
        if not info.isdir():
            members.append((info.name, Entry(info.size, opener, problem)))
    # tarfile stops without a word where a header is damaged or the end is missing.
    file.seek(archive.offset)
    if file.read(tarfile.BLOCKSIZE) != bytes(tarfile.BLOCKSIZE):
        raise tarfile.ReadError("a header is damaged, or the end is missing")
    return _contents(members, path)


def _contents(members: Iterable[tuple[str, Entry]], path: Path) -> Contents:
    """An archive's files by name; names that lead elsewhere and doubles are told and not opened."""
    entries: dict[str, Entry] = {}
    problems = []
    for said, entry in members:
        inside = PurePosixPath(said)
        name = inside.as_posix()
        leads_out = inside.is_absolute() or ".." in inside.parts
        if leads_out or not said.isprintable() or set(said) & set("\\:"):
            problems.append(f"{said!r}: a name that leads out of the release or cannot be a file's")
        else:
            entries[name] = replace(entry, problem="twice in the archive") if name in entries else entry
    if sum(entry.size for entry in entries.values()) > _limit(path):
        raise _bomb(path)
    return Contents(entries, tuple(problems))


def _limit(path: Path) -> int:
    """The bytes that an archive of this size may hold."""
    return MAX_INFLATION * path.stat().st_size + SLACK_BYTES


def _bomb(path: Path) -> ReleaseError:
    return ReleaseError(
        f"{path}: claims to hold more than {MAX_INFLATION} times its size, which no release does; refused"
    )
