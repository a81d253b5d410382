"""Archives of releases, opened for reading in place. What strangers packed is not trusted."""

import gzip
import stat
import tarfile
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Any, cast

from kinectbench.errors import ReleaseError
from kinectbench.release.contents import LINK, Contents, Entry
from kinectbench.workspace import storage_errors

# What zipfile, tarfile and gzip raise for damaged files; RuntimeError: the entry is encrypted.
DAMAGED = (zipfile.BadZipFile, tarfile.TarError, zlib.error, EOFError, NotImplementedError, RuntimeError)
ZIP, GZIP = b"PK", b"\x1f\x8b"
# A release's own files are packed already: they shrink little.
MAX_INFLATION, SLACK_BYTES = 100, 64 << 20
CHUNK_BYTES = 1 << 20


@dataclass(frozen=True)
class _Member:
    """A file as an archive lists it, and what the archive's opener takes for it."""

    name: str
    entry: Entry
    handle: Any


@contextmanager
def open_archive(path: Path) -> Iterator[Contents]:
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
            members.append(_Member(info.filename, Entry(info.file_size, problem), info))
    return _contents(members, path, archive.open)


def _tar_contents(archive: tarfile.TarFile, file: IO[bytes], path: Path) -> Contents:
    members = []
    for info in archive:
        problem = None
        if info.issym() or info.islnk():
            problem = LINK
        elif not info.isfile() or info.issparse():
            problem = "not a plain file"
        if not info.isdir():
            members.append(_Member(info.name, Entry(info.size, problem), info))
    # tarfile stops without a word where a header is damaged or the end is missing.
    file.seek(archive.offset)
    if file.read(tarfile.BLOCKSIZE) != bytes(tarfile.BLOCKSIZE):
        raise tarfile.ReadError("a header is damaged, or the end is missing")
    # A plain file always opens; links and others are never asked for.
    return _contents(members, path, cast(Callable[[Any], IO[bytes]], archive.extractfile))


def _contents(members: Iterable[_Member], path: Path, opener: Callable[[Any], IO[bytes]]) -> Contents:
    """An archive's files by name; names that lead elsewhere and doubles are told and not opened."""
    entries: dict[str, Entry] = {}
    handles: dict[str, Any] = {}
    problems = []
    for member in members:
        name = PurePosixPath(member.name).as_posix()
        if not member.name.isprintable() or set(member.name) & set("\\:") or _leads_out(name):
            problems.append(f"{member.name!r}: a name that leads out of the release or cannot be a file's")
        elif name in entries:
            entries[name] = Entry(member.entry.size, "twice in the archive")
        else:
            entries[name], handles[name] = member.entry, member.handle
    if sum(entry.size for entry in entries.values()) > _limit(path):
        raise _bomb(path)
    return Contents(entries, tuple(problems), lambda name: opener(handles[name]))


def _leads_out(name: str) -> bool:
    return name.startswith("/") or ".." in PurePosixPath(name).parts


def _limit(path: Path) -> int:
    """The bytes that an archive of this size may hold."""
    return MAX_INFLATION * path.stat().st_size + SLACK_BYTES


def _bomb(path: Path) -> ReleaseError:
    return ReleaseError(
        f"{path}: claims to hold more than {MAX_INFLATION} times its size, which no release does; refused"
    )
