"""Protect a release's folder: one writer at a time, no leftovers of killed downloads, no other content."""

import contextlib
import errno
import fcntl
import os
import re
from collections.abc import Iterator, Set
from pathlib import Path

from kinectbench.core import ReleaseError, open_to_add, storage_errors
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON
from kinectbench.core.artefacts.targets import SHA256SUMS, parse_sums
from kinectbench.release.contents import release_files
from kinectbench.release.published import release_text

LOCK = ".lock"
# Names that `replaced_file` gives, also in earlier versions: .000.npz.1f2e3d4c.part
_LEFT = re.compile(r"\..+\.[0-9a-f]+\.part")
# Files that file managers write into a folder when somebody opens it.
OF_FILE_MANAGERS = (".DS_Store", "Thumbs.db", "desktop.ini")


def is_ours(name: str) -> bool:
    """Return whether a file of this name is the folder's lock, or an unfinished download."""
    return name == LOCK or _LEFT.fullmatch(name) is not None


def is_ignored(name: str) -> bool:
    """Return whether this name is of a lock, an unfinished download, or a file that a file manager leaves."""
    return is_ours(name) or name in OF_FILE_MANAGERS


def remains(folder: Path) -> list[Path]:
    """Return the lock and the unfinished downloads in a folder and below it; links are not followed."""
    return [Path(place, name) for place, _, names in os.walk(folder) for name in names if is_ours(name)]


def _unknown_file(folder: Path, known: Set[str]) -> str | None:
    """Return the first file or link in a folder that is neither `known` nor `is_ignored`; None if none is."""
    others = (p for p in release_files(folder) if p.relative_to(folder).as_posix() not in known)
    return next((path.relative_to(folder).as_posix() for path in others if not is_ignored(path.name)), None)


def refuse_other_content(out: Path) -> None:
    """Raise an error unless a folder may be replaced: it is missing, empty, or holds only a release.

    Raises:
        ReleaseError: the folder holds something else, which the message names; or its SHA256SUMS is missing
            or damaged, so that nobody knows which files belong to the release.
    """
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    if not (out.is_dir() and (out / BENCHMARK_JSON).is_file()):
        raise ReleaseError(
            f"{out}: holds something else than a release; move it away, then run the command again",
            what="other-content",
        )
    try:
        listed = set(parse_sums(release_text(out / SHA256SUMS), SHA256SUMS))
    except ReleaseError as error:
        raise ReleaseError(
            f"{out}: its {SHA256SUMS} is missing or damaged, so what is of the release is unknown; move the "
            "folder away, then run the command again",
            what="other-content",
        ) from error
    if other := _unknown_file(out, listed):
        raise ReleaseError(
            f"{out / other}: is not of the release; move it out of {out.name}/, then run the command again",
            what="other-content",
        )


@contextlib.contextmanager
def owned(folder: Path) -> Iterator[None]:
    """Lock a folder during a `with` block, after waiting for other writers; then remove leftover downloads.

    The folder is made if missing.
    On a file system without locks nothing is removed, because another fetch may be running.

    Raises:
        StorageError: the disk cannot be written.
    """
    with contextlib.ExitStack() as held:
        with storage_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            is_locked = _lock(folder / LOCK, held)
        try:
            for path in remains(folder) if is_locked else ():
                if path != folder / LOCK:
                    path.unlink(missing_ok=True)
            yield
        finally:
            with contextlib.suppress(OSError):
                (folder / LOCK).unlink()


def _lock(path: Path, held: contextlib.ExitStack) -> bool:
    """Lock a file, after waiting for its holder, until the stack closes; return False if there are no locks.

    If the last holder deleted the file meanwhile, a new one is made and locked.
    """
    while True:
        with contextlib.ExitStack() as closing:
            file = closing.enter_context(open_to_add(path))
            try:
                fcntl.flock(file, fcntl.LOCK_EX)
            except OSError as error:
                if error.errno not in (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS):
                    raise
                return False
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                    held.push(closing.pop_all())
                    return True
