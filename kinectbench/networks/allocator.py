"""Let the C library keep freed memory between the steps of a network."""

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager

# Parameters of mallopt: their numbers in glibc's malloc.h.
M_TRIM_THRESHOLD, M_MMAP_MAX = -1, -4
# glibc's defaults of both parameters, and the value of the first with which memory is never returned:
# mallopt(3).
TRIM_THRESHOLD_BYTES, MMAP_MAX = 128 * 1024, 65536
NEVER = -1


@contextmanager
def memory_kept() -> Iterator[None]:
    """Within the block, keep the memory of freed large arrays in this process, so that new arrays use it.

    Otherwise glibc requests the memory of every large array from the system, which clears it page by page.
    With this, a training step of `recae-small` takes 1.27 s instead of 1.9 s (batch of 4, beside another
    process), and 1.9 GB instead of 1.5 GB. Predicting a view takes 0.62 s of CPU instead of 0.81 s. Without
    glibc, this does nothing.
    """
    library = ctypes.CDLL(None) if sys.platform == "linux" else None
    if library is None or not hasattr(library, "mallopt") or not hasattr(library, "malloc_trim"):
        yield
        return
    library.mallopt(M_MMAP_MAX, 0)
    library.mallopt(M_TRIM_THRESHOLD, NEVER)
    try:
        yield
    finally:
        library.mallopt(M_MMAP_MAX, MMAP_MAX)
        library.mallopt(M_TRIM_THRESHOLD, TRIM_THRESHOLD_BYTES)
        library.malloc_trim(0)
