"""Folders that one process of a test run makes, and that all of its processes read."""

import fcntl
import os
from collections.abc import Callable
from pathlib import Path

import pytest


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """The folder `name` of this run; the first process that asks for it has it made, others wait for it.

    Args:
        factory: knows where this run's folders lie.
        name: of the folder, unique in the whole suite.
        make: fills an empty folder, which is not to be changed afterwards.
    """
    base = factory.getbasetemp()
    # A worker's own folder lies in that of the run.
    run = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    root, whole = run / name, run / f".{name}.whole"
    with (run / f".{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not whole.exists():
            root.mkdir()
            make(root)
            whole.touch()
    return root
