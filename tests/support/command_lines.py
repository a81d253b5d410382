"""A benchmark of one recording for commands that are to fail, and the one line that they are to print."""

import re
from collections.abc import Callable

from small_benchmark import Run

Command = Callable[..., Run]
ONE = """\
name: one
recordings:
  - {id: chair, path: recordings/chair, category: chair, underside: closed}
fusion: {voxel_size_m: 0.015, scene_voxel_size_m: 0.03}
views: {count: 3, min_pixels: 100}
tracking: {check_stride_px: 4}
"""
# What may be said beside the error.
SAID_TOO = re.compile(r"warning: |: do this first: |note: |^failed: [0-9]+ of ")


def check_line(run: Run, status: int, words: str) -> str:
    """One error line that holds all the words, and no traceback."""
    errors = [line for line in run.err.splitlines() if not SAID_TOO.search(line)]
    assert run.status == status, run
    assert len(errors) == 1, run.err
    assert "error: " in errors[0]
    assert "Traceback" not in run.err and "internal error" not in run.err
    for word in words.split("|"):
        assert word in errors[0], (word, errors[0])
    return errors[0]
