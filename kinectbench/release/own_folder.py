"""A download folder with one writer at a time, and the remains of killed ones. The lock leaves no file."""

import contextlib
import errno
import fcntl
import os
import re
from collections.abc import Iterator
from pathlib import Path

from kinectbench.core.storage import open_to_add, storage_errors

LOCK = ".lock"
# The names that `replaced_file` gives, those of earlier versions included: .000.npz.1f2e3d4c.part
_LEFT = re.compile(r"\..+\.[0-9a-f]+\.part")


def is_ours(name: str) -> bool:
    """Whether a file is the lock, or an unfinished download."""
    return name == LOCK or _LEFT.fullmatch(name) is not None


def remains(folder: Path) -> list[Path]:
    """Files of a running or killed download that are not the release's. Links are not followed."""
    return [Path(place, name) for place, _, names in os.walk(folder) for name in names if is_ours(name)]


@contextlib.contextmanager
def owned(folder: Path) -> Iterator[None]:
    """Write to a folder exclusively; leftovers of killed downloads are removed first.

    Where the file system keeps no locks nothing is swept, as another fetch may be at work.

    Args:
        folder: made if it is not there.

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
    """Hold a lock until the stack ends; False if the file system has no locks.

    If its last holder removed the file, the lock is taken again.
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
