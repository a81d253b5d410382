"""Silence camera libraries that print when they are imported or opened."""

import ctypes
import io
import os
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout

STDOUT = 1


@contextmanager
def quiet() -> Iterator[None]:
    """Silence, within the block, Python's output and the standard output of native libraries.

    Orbbec's SDK prints a line on standard output when imported, in the middle of `--json`. NumPy prints a
    page on standard error if a library was compiled for another version of NumPy.
    """
    flush = ctypes.CDLL(None).fflush  # the buffers of C, whose lines may come from before the block
    flush(None)
    kept, nowhere = os.dup(STDOUT), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, STDOUT)
    os.close(nowhere)
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            yield
    finally:
        flush(None)
        os.dup2(kept, STDOUT)
        os.close(kept)


def in_a_line(error: Exception) -> str:
    """Return the first sentence of the first line of an error's message, or its class if that is empty."""
    said = str(error).strip().partition("\n")[0].partition(". ")[0].rstrip(":. ")
    return said or type(error).__name__
