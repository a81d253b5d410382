"""What a program takes of memory in a process of its own, its libraries counted."""

import os
import re
import subprocess
import sys

# The children of a process begin with its peak, so each asks /proc for its own.
TELL = """
from pathlib import Path
print(Path("/proc/self/status").read_text())
"""


def peak_mb(program: str, *arguments: str) -> int:
    """Most memory of a Python program, MB; Linux only."""
    done = subprocess.run(
        [sys.executable, "-c", program + TELL, *arguments],
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
        env={**os.environ, "PYTHONWARNINGS": "ignore"},
    )
    found = re.search(r"VmHWM:\s+(\d+) kB", done.stdout)
    assert found, done.stdout
    return int(found[1]) >> 10
