"""Temporary folders of this machine, which also disappear if the process is killed."""

import contextlib
import multiprocessing
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from kinectbench.core import StorageError, storage_errors
from kinectbench.engine.locks import locked

SCRATCH_VARIABLE = "KINECTBENCH_SCRATCH"
PREFIX = "kinectbench-scratch-"
# A process locks its folder within this time after making it.
YOUNG_S = 60.0


@contextlib.contextmanager
def scratch_folder() -> Iterator[Path]:
    """Yield a new folder below KINECTBENCH_SCRATCH or the temporary folder; remove it after the block.

    Folders that killed runs left there are removed first: their locks are free.

    Raises:
        StorageError: the parent is no folder, or is not writable.
    """
    base = Path(os.environ.get(SCRATCH_VARIABLE) or tempfile.gettempdir())
    if not base.is_dir():
        raise StorageError(
            f"{base}: no such folder; make it, or correct {SCRATCH_VARIABLE}", what="no-folder"
        )
    _sweep(base)
    with contextlib.ExitStack() as stack:
        with storage_errors(base):
            name = stack.enter_context(tempfile.TemporaryDirectory(prefix=_prefix(), dir=base))
        folder = Path(name)
        stack.enter_context(locked(folder))
        yield folder


def clear_scratch() -> None:
    """Remove scratch folders of this process's workers that have ended."""
    for folder in Path(os.environ.get(SCRATCH_VARIABLE) or tempfile.gettempdir()).glob(f"{_prefix()}*"):
        _remove(folder)


def _prefix() -> str:
    """Return the prefix of scratch folder names: it has the id of the main process, also in its workers."""
    parent = multiprocessing.parent_process()
    return f"{PREFIX}{os.getpid() if parent is None else parent.pid}-"


def _sweep(base: Path) -> None:
    """Remove scratch folders of kinectbench below `base` that no process uses, unless younger than 1 min."""
    for folder in base.glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):
            if time.time() - folder.lstat().st_mtime > YOUNG_S:
                _remove(folder)


def _remove(folder: Path) -> None:
    """Remove a scratch folder, unless a process uses it or it belongs to another user."""
    with contextlib.suppress(OSError, StorageError):
        status = folder.lstat()
        if stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid():
            with locked(folder, wait=False):
                shutil.rmtree(folder)
