"""The code that a cluster's worker runs: check package versions, run a task, report progress."""

import contextlib
import ctypes
import pickle
import time
from collections.abc import Mapping
from functools import cache
from platform import python_version

from kinectbench._version import __version__
from kinectbench.core import ClusterError, package_version

# Packages besides kinectbench that determine the bytes of results.
PACKAGES = (
    *("numpy", "scipy", "numba", "open3d", "opencv-python-headless", "manifold3d", "trimesh"),
    *("zlib-ng", "zstandard", "lz4"),
)
# Shortest time, seconds, between two progress messages of a task: the scheduler receives those of all tasks.
SAY_S = 1.0
# glibc's numbers of two options of mallopt(3), and the values up to which glibc raises them itself on 64-bit
# machines.
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
MMAP_BYTES = 32 << 20


@cache
def package_versions() -> Mapping[str, str]:
    """Return the local versions of all packages that determine results, by name; "none" if not installed."""
    return {"kinectbench": __version__, "Python": python_version()} | {
        name: package_version(name) or "none" for name in PACKAGES
    }


@cache
def keep_freed_memory() -> None:
    """Let this process keep freed memory for later arrays, as glibc does by default.

    Dask starts workers with MALLOC_TRIM_THRESHOLD_=65536, which returns freed memory to the system at once.
    Builds of four simulated recordings took 141 s of CPU with it, 101 s without, and 93 s in kinectbench's
    own pool.
    """
    with contextlib.suppress(OSError, AttributeError):  # the C library is not glibc
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(M_MMAP_THRESHOLD, MMAP_BYTES)
        mallopt(M_TRIM_THRESHOLD, 2 * MMAP_BYTES)


def call(packed: bytes, topic: str, versions: Mapping[str, str]) -> object:
    """Run a pickled task on this worker.

    `packed` is the pickled function and task, `topic` that of the task's messages to the client, and
    `versions` are those of the client's packages.

    Raises:
        ClusterError: this worker's packages have other versions.
    """
    from distributed import get_worker

    keep_freed_memory()
    worker = get_worker()
    own = package_versions()
    differing = [
        f"{name} {own.get(name)} and not {wanted}"
        for name, wanted in versions.items()
        if own.get(name) != wanted
    ]
    if differing:
        raise ClusterError(
            f"the worker at {worker.address} has {', '.join(differing)}; install there what is here, so that "
            "it makes the same bytes",
            what="other-versions",
        )
    reported_s: dict[object, float] = {}

    def say(message: tuple[object, ...]) -> None:
        what, now = message[:2], time.monotonic()
        if now - reported_s.get(what, float("-inf")) >= SAY_S:
            reported_s[what] = now
            worker.log_event(topic, list(message))

    function, task = pickle.loads(packed)
    return function(task, say)
