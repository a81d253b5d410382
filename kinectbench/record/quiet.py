"""Libraries of cameras that print where they are imported or opened."""

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout

STDOUT = 1


@contextmanager
def quiet() -> Iterator[None]:
    """Within the block nothing is printed, neither by Python nor by a library of its own.

    Orbbec's SDK prints a line on standard output where it is imported, in the middle of `--json`; NumPy a
    page on standard error where a library was compiled for another version of it.
    """
    kept, nowhere = os.dup(STDOUT), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, STDOUT)
    os.close(nowhere)
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            yield
    finally:
        os.dup2(kept, STDOUT)
        os.close(kept)


def in_a_line(error: Exception) -> str:
    """The first sentence of what an error of a library says; its kind if it says nothing."""
    said = str(error).strip().partition("\n")[0].partition(". ")[0].rstrip(":. ")
    return said or type(error).__name__
