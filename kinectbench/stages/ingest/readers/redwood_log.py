"""Read the poses of a Redwood log: a block of five rows for each frame."""

import math
from contextlib import suppress
from pathlib import Path

import numpy as np

from kinectbench.core import GivenPosesError, printable, read_head
from kinectbench.core.trajectory.text_rows import PUNCTUATION, parse_floats, text_rows
from kinectbench.core.types import Float64
from kinectbench.stages.ingest.image_names import FRAME_NUMBER


def starts_like_a_log(file: Path) -> bool:
    """Whether a file, after comments, starts like a log for `read_log`: a frame's number, then numbers."""
    rows = read_head(file).decode("utf-8-sig", "replace").splitlines() if file.is_file() else []
    first = next((words for row in rows if (words := row.partition("#")[0].split())), [])
    return 0 < len(first) <= 3 and bool(FRAME_NUMBER.fullmatch(first[0])) and all(map(_is_number, first))


def _is_number(word: str) -> bool:
    with suppress(ValueError):
        return math.isfinite(float(word))
    return False


def read_log(file: Path, frames: int) -> list[Float64]:
    """Read a Redwood log; return camera to world (4, 4) of each of `frames` frames, NaN if it has none.

    The file has blocks of five rows: `i j k`, then a 4x4 matrix. Only i is used, the frame's index from 0.

    Raises:
        RecordingError: a block is incomplete, or names no frame.
    """
    rows = text_rows(file)
    if len(rows) % 5:
        raise GivenPosesError(f"{file}: holds {len(rows)} rows, not a multiple of 5 ('i j k' and four rows)")
    matrices = [np.full((4, 4), np.nan)] * frames
    for start in range(0, len(rows), 5):
        where, head = rows[start]
        index = head.split()[0]
        if not FRAME_NUMBER.fullmatch(index) or int(index) >= frames:
            raise GivenPosesError(
                f"{where}: '{printable(head)}' does not name one of the {frames} frames (0-{frames - 1})"
            )
        values = [
            parse_floats(row.translate(PUNCTUATION).split(), row_where)
            for row_where, row in rows[start + 1 : start + 5]
        ]
        if any(len(row) != 4 for row in values):
            raise GivenPosesError(f"{where}: the four rows after it are not four numbers each")
        matrices[int(index)] = np.array(values)
    return matrices
