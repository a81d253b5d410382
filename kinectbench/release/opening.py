"""Read a release from a folder, a zip or a tar, as untrusted input."""

import errno
import gzip
import io
import stat
import tarfile
import tempfile
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import IO, cast

from kinectbench.core import (
    COPIED_BYTES,
    MOST_RATIO,
    ReleaseError,
    SettingsError,
    copy_bounded,
    open_plain,
    printable,
    size_of,
    storage_errors,
    unpacked_bound,
)
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON
from kinectbench.core.artefacts.targets import SHA256SUMS
from kinectbench.core.store.address import other_scheme
from kinectbench.core.zip_files import open_zip
from kinectbench.release.contents import (
    DAMAGED,
    EMPTY_FOLDER,
    LINK,
    MOST_FILES,
    Contents,
    Entry,
    no_release,
    release_files,
)
from kinectbench.release.unpack import TarMember

ZIP, GZIP = b"PK", b"\x1f\x8b"
# Largest number of bytes of a tar member's headers: its block, names of 4096 characters, times, attributes.
MOST_HEADER_BYTES = 128 << 10
# Largest number of global headers of a tar; git writes one.
MOST_GLOBALS = 64


@contextmanager
def open_contents(path: Path) -> Iterator[Contents]:
    """Open a release for reading; yield its files.

    Args:
        path: the release's folder, or an archive: .zip, .tar, .tar.gz. In an archive, the release may be
            inside one folder.

    Raises:
        ReleaseError: there is no release, the archive is cut off, or its stated content is far larger than
            the archive (a decompression bomb).
        SettingsError: the path is a URL of a scheme that is not supported.
        StorageError: there is no room for the unpacked .tar.gz.
    """
    if path.is_file():
        with _open_archive(path) as contents:
            yield _rooted(contents, path)
        return
    if problem := other_scheme(path):
        raise SettingsError(problem, what="bad-url")
    contents = _folder(path)
    if not any(name in contents.entries for name in (BENCHMARK_JSON, SHA256SUMS)):
        raise no_release(path)
    yield contents


def _folder(path: Path) -> Contents:
    """Return the files of a folder; links to files are followed, links to folders are not.

    Download caches consist of links to files. Following links is safe, because each file is checked by its
    SHA-256.
    """
    entries: dict[str, Entry] = {}
    for file in release_files(path, with_empty=True):
        name, entry = file.relative_to(path).as_posix(), _entry(file)
        entries[f"{name}/" if entry.problem == EMPTY_FOLDER else name] = entry
    if (path / SHA256SUMS).is_symlink() or (path / SHA256SUMS).exists():
        entries[SHA256SUMS] = _entry(path / SHA256SUMS)
    return Contents(entries)


def _entry(file: Path) -> Entry:
    problem, size = None, 0
    try:
        state = file.stat()
        size = state.st_size
        if not stat.S_ISREG(state.st_mode):
            is_folder = stat.S_ISDIR(state.st_mode) and not file.is_symlink()
            problem = EMPTY_FOLDER if is_folder else "not a plain file"
    except OSError as error:
        leads_nowhere = file.is_symlink() and error.errno in (errno.ENOENT, errno.ELOOP)
        problem = "a link that leads nowhere" if leads_nowhere else f"cannot be read ({error.strerror})"
    return Entry(0 if problem else size, partial(open_plain, file), problem)


def _rooted(contents: Contents, path: Path) -> Contents:
    """Return only the files of the release in an archive, by their paths relative to the release.

    The release is at the top of the archive or in one folder. Files beside that folder become `problems`.

    Raises:
        ReleaseError: there is no release, or several folders hold one.
    """
    known = (BENCHMARK_JSON, SHA256SUMS)
    if any(name in contents.entries for name in known):
        return contents
    tops = {name.partition("/")[0] for name in contents.entries if name.partition("/")[2] in known}
    if len(tops) != 1:
        count = "several" if tops else "none"
        raise ReleaseError(
            f"{path}: must hold one release, at its top or in one folder; it holds {count}", what="not-one"
        )
    top = f"{tops.pop()}/"
    inside = {name.removeprefix(top): e for name, e in contents.entries.items() if name.startswith(top)}
    outside = [
        f"{name}: beside the release's folder" for name in contents.entries if not name.startswith(top)
    ]
    return Contents(inside, (*contents.problems, *outside))


@contextmanager
def _open_archive(path: Path) -> Iterator[Contents]:
    """Open a .zip, .tar or .tar.gz, recognised by its content instead of its name; yield its files.

    A zip or a tar is read in place. A .tar.gz is inflated into an unnamed temporary file first, because it
    allows no random access.

    Raises:
        ReleaseError: the file is no such archive, is cut off, or states a content beyond `unpacked_bound` (64
            MiB, and 100 times its size).
        StorageError: there is no room for the temporary file.
    """
    with ExitStack() as stack:
        try:
            contents = _opened(path, stack)
        except OSError as error:
            if not isinstance(error, gzip.BadGzipFile):
                raise ReleaseError(f"{path}: cannot be read ({error.strerror or error})") from error
            raise _damaged(path, error) from error
        except DAMAGED as error:
            raise _damaged(path, error) from error
        yield contents


def _opened(path: Path, stack: ExitStack) -> Contents:
    """Open an archive and return its files; the opened files are added to `stack`, which closes them."""
    file: IO[bytes] = stack.enter_context(open_plain(path))
    head, packed_bytes = file.read(2), size_of(file)
    file.seek(0)
    if head == ZIP:
        members = _zip_members(stack.enter_context(open_zip(file, MOST_FILES)))
        return _contents(members, path, packed_bytes)
    if head == GZIP:
        with storage_errors(Path(tempfile.gettempdir())):
            inflated = stack.enter_context(tempfile.TemporaryFile())  # noqa: SIM115
            _inflate(file, inflated, path)
        file = inflated
    return _contents(_tar_members(file), path, packed_bytes)


def _inflate(packed: IO[bytes], inflated: IO[bytes], path: Path) -> None:
    """Write the unpacked content of a gzip file to `inflated`; raise an error if it is far too large."""
    with gzip.GzipFile(fileobj=packed) as source:
        try:
            copy_bounded(cast(IO[bytes], source), inflated, unpacked_bound(size_of(packed)))
        except OSError as error:
            if error.errno != errno.EFBIG or error.filename is not None:
                raise
            raise _bomb(path) from error
    inflated.seek(0)


def _zip_members(archive: zipfile.ZipFile) -> list[tuple[str, Entry]]:
    """Return (name, entry) of each member of a zip; the entry has the size of the member and opens it."""
    members = list[tuple[str, Entry]]()
    for info in archive.infolist():
        problem = LINK if stat.S_ISLNK(info.external_attr >> 16) else None
        if info.flag_bits & 1:
            problem = "encrypted"
        if info.is_dir():
            problem = EMPTY_FOLDER
        members.append((info.filename, Entry(info.file_size, partial(archive.open, info), problem)))
    return members


def _tar_members(file: IO[bytes]) -> list[tuple[str, Entry]]:
    """Return (name, entry) of each member of a tar; the entry has the size of the member and opens it.

    Raises:
        tarfile.TarError, ValueError, OverflowError: the tar is damaged, or has too large headers or too many
            members.
    """
    members = list[tuple[str, Entry]]()
    headers = _Headers(file)
    with tarfile.open(fileobj=headers, mode="r:", tarinfo=TarMember) as archive:
        before = -1
        while info := archive.next():
            headers.read_bytes = 0
            archive.members.clear()  # type: ignore[attr-defined] # it keeps all
            # A negative size, which pax allows, leads back to the same header.
            if info.offset <= before or info.size < 0 or len(members) == MOST_FILES:
                raise tarfile.ReadError(f"more than {MOST_FILES} members, or one without end")
            if len(archive.pax_headers) > MOST_GLOBALS:
                raise tarfile.ReadError(f"more than {MOST_GLOBALS} global headers")
            before, problem = info.offset, None
            if info.isdir():
                problem = EMPTY_FOLDER
            elif info.issym() or info.islnk():
                problem = LINK
            elif not info.isfile() or info.issparse():
                problem = "not a plain file"
            opener = partial(_member, file, info.offset_data, info.size)
            members.append((info.name, Entry(info.size, opener, problem)))
    return members


class _Headers(io.RawIOBase):
    """A wrapper of a tar file that limits how many bytes tarfile reads for each member's headers.

    Without it, tarfile would read names and pax records of any size into memory.
    """

    def __init__(self, file: IO[bytes]) -> None:
        super().__init__()
        self._file = file
        self.read_bytes = 0

    def read(self, size: int = -1) -> bytes:
        self.read_bytes += size
        if size < 0 or self.read_bytes > MOST_HEADER_BYTES:
            raise tarfile.ReadError(f"a header of more than {MOST_HEADER_BYTES} bytes")
        return self._file.read(size)

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        if offset < 0:
            raise tarfile.ReadError("a member before the beginning")
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()


def _member(file: IO[bytes], start: int, size: int) -> io.BufferedReader:
    """Return one member of a tar as a readable file: the `size` bytes from offset `start`."""
    return io.BufferedReader(_Slice(file, start, size), COPIED_BYTES)


class _Slice(io.RawIOBase):
    """A readable file that is a range of bytes of another open file."""

    def __init__(self, file: IO[bytes], start: int, size: int) -> None:
        super().__init__()
        self._file, self._start, self._size, self._at = file, start, size, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._at = offset + (0, self._at, self._size)[whence]
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        """Fill a buffer with the next bytes; return their number, 0 at the end.

        Raises:
            EOFError: the file ends before the range does.
        """
        left = max(0, self._size - self._at)
        self._file.seek(self._start + self._at)
        part = self._file.read(min(len(buffer), left))
        if not part and left:
            raise EOFError("cut off")
        buffer[: len(part)] = part
        self._at += len(part)
        return len(part)


def _contents(members: Iterable[tuple[str, Entry]], path: Path, packed_bytes: int) -> Contents:
    """Return an archive's files, and its empty folders, by name.

    A name that leads out of the archive, or has characters that no name should have (control characters,
    backslash, colon), becomes a problem of the result. A name that occurs twice is a problem of its entry.
    """
    entries: dict[str, Entry] = {}
    folders: dict[str, Entry] = {}
    problems = []
    for stated_name, entry in members:
        inside = PurePosixPath(stated_name)
        name = inside.as_posix()
        leads_out = inside.is_absolute() or ".." in inside.parts
        if leads_out or not stated_name.isprintable() or set(stated_name) & set("\\:"):
            problems.append(
                f"'{printable(stated_name)}': a name that leads out of the release or cannot be a file's"
            )
        elif entry.problem == EMPTY_FOLDER:
            folders[name] = entry
        else:
            entries[name] = replace(entry, problem="twice in the archive") if name in entries else entry
    if folders:
        filled = {str(parent) for name in (*entries, *folders) for parent in PurePosixPath(name).parents}
        entries |= {f"{name}/": entry for name, entry in folders.items() if name not in filled}
    if sum(entry.size for entry in entries.values()) > unpacked_bound(packed_bytes):
        raise _bomb(path)
    return Contents(entries, tuple(problems))


def _damaged(path: Path, error: Exception) -> ReleaseError:
    return ReleaseError(
        f"{path}: cut off or damaged, or no .zip, .tar or .tar.gz ({error}); download it again"
    )


def _bomb(path: Path) -> ReleaseError:
    return ReleaseError(
        f"{path}: claims to hold more than {MOST_RATIO} times its size, which no release does; refused",
        what="too-large",
    )
