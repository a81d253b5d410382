"""The memory that a script has needed."""

import resource
import sys
from pathlib import Path


def peak_mb() -> float:
    """Peak resident memory of this process.

    Linux counts its parent's memory in `ru_maxrss`, so that it is asked for this process's own.
    """
    status = Path("/proc/self/status")
    if status.is_file():
        lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
        return int(lines["VmHWM"].split()[0]) / 1e3
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)
