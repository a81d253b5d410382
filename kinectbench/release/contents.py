"""The files of a release, in a folder, a zip or a tar: read in place, nothing is unpacked."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from kinectbench.errors import ReleaseError
from kinectbench.release.layout import BENCHMARK_JSON, SHA256SUMS, release_files

LINK = "a link instead of the file that was published"
MAX_READ_BYTES = 64 << 20


@dataclass(frozen=True)
class Entry:
    """One file.

    Attributes:
        size: bytes, as the folder or archive says.
        problem: why it must not be opened, or None.
    """

    size: int
    problem: str | None = None


@dataclass(frozen=True)
class Contents:
    """What lies in a release's folder or archive.

    Attributes:
        entries: every file and link by its name, relative to the release, with "/".
        problems: one line each about what cannot be a file of a release, such as a way out of it.
        opener: opens an entry that has no problem.
    """

    entries: Mapping[str, Entry]
    problems: tuple[str, ...]
    opener: Callable[[str], IO[bytes]]

    def read(self, name: str, limit: int = MAX_READ_BYTES) -> bytes:
        """The bytes of a file.

        Raises:
            ReleaseError: missing, not a plain file, larger than `limit` bytes, or damaged.
        """
        entry = self.entries.get(name)
        if entry is None:
            raise ReleaseError(f"{name}: missing; make or download it again")
        if entry.problem:
            raise ReleaseError(f"{name}: {entry.problem}; make or download it again")
        if entry.size > limit:
            raise ReleaseError(f"{name}: {entry.size} bytes are more than such a file can have")
        with self.stream(name) as file:
            return file.read()

    @contextmanager
    def stream(self, name: str) -> Iterator[IO[bytes]]:
        """Open a file that has no problem.

        Raises:
            ReleaseError: its bytes are damaged, or cannot be read.
        """
        from kinectbench.release.archives import DAMAGED

        try:
            with self.opener(name) as file:
                yield file
        except OSError as error:
            reason = error.strerror or error
            raise ReleaseError(f"{name}: cannot be read ({reason}); make or download it again") from error
        except DAMAGED as error:
            raise ReleaseError(f"{name}: damaged in the archive ({error}); download it again") from error

    def text(self, name: str) -> str:
        """A UTF-8 text file.

        Raises:
            ReleaseError: as `read`, or it is no UTF-8.
        """
        try:
            return self.read(name).decode()
        except UnicodeDecodeError as error:
            raise ReleaseError(f"{name}: cannot be read ({error}); make or download it again") from error


@contextmanager
def open_contents(path: Path) -> Iterator[Contents]:
    """Look into a release.

    Args:
        path: its folder, or an archive: .zip, .tar, .tar.gz. In an archive it may lie in one folder.

    Raises:
        ReleaseError: there is no release, the archive is cut off, or it claims to hold far more than
            its size.
    """
    from kinectbench.release.archives import open_archive

    if path.is_dir():
        contents = _folder(path)
        if not any(name in contents.entries for name in (BENCHMARK_JSON, SHA256SUMS)):
            raise ReleaseError(f"{path}: no release there; run publish or download one")
        yield contents
    elif path.is_file():
        with open_archive(path) as contents:
            yield rooted(contents, path)
    else:
        raise ReleaseError(f"{path}: no release there; run publish or download one")


def _folder(path: Path) -> Contents:
    """The files of a folder; links are not followed."""
    entries = {}
    for file in release_files(path):
        entries[file.relative_to(path).as_posix()] = _entry(file)
    if (path / SHA256SUMS).is_symlink() or (path / SHA256SUMS).exists():
        entries[SHA256SUMS] = _entry(path / SHA256SUMS)
    return Contents(entries, (), lambda name: (path / name).open("rb"))


def _entry(file: Path) -> Entry:
    if file.is_symlink():
        return Entry(0, LINK)
    return Entry(file.stat().st_size) if file.is_file() else Entry(0, "not a plain file")


def rooted(contents: Contents, path: Path) -> Contents:
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
    return Contents(inside, (*contents.problems, *outside), lambda name: contents.opener(top + name))
