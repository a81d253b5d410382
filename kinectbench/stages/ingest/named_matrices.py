"""Read the matrices of a text or JSON file that stand under names: cameras, and the pose of each frame."""

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import RecordingError, open_plain, printable
from kinectbench.core.trajectory.text_rows import PUNCTUATION, read_text
from kinectbench.core.types import Float64
from kinectbench.core.voxels.npy import NpyError, NpyHeader, read_npy
from kinectbench.stages.ingest.json_values import JSON_BYTES, json_numbers, read_json_object

SHAPES = frozenset({(3, 3), (3, 4), (4, 4)})
# Most rows and columns of a matrix, and characters of a title that count (chosen by hand).
SIDE, LONGEST_TITLE = 4, 200
# Names that may count other things than frames, and words of matrices that are no poses of the camera.
SHORT_NUMBER = re.compile(r"\d{1,2}")
OF_SOMETHING_ELSE = re.compile(r"obj|joint|left|right|align|crop|imu|homograph|intrinsic", re.IGNORECASE)
SUFFIXES = frozenset({".json", ".txt"})
WHAT = "matrices under names"
# Levels of a JSON file to look at, and files to read of a folder (chosen by hand).
LEVELS, MOST_FILES = 3, 8
# A file holds the poses of a recording if it has one for this ratio of its frames (chosen by hand), so that
# one matrix under the name of one frame is none.
LEAST_POSED = 0.5


def named_matrices(file: Path) -> list[tuple[tuple[str, ...], Float64]]:
    """Return the matrices of a file, 3x3, 3x4 or 4x4, each behind its names; [] if it cannot be read.

    In JSON the names are the keys from the outermost on, in text the words of the line above the matrix. An
    array has the name of its file.

    Args:
        file: a .json or .npy file, or a text of titles and rows of numbers, such as APC's cam.info.txt:
            `# Camera-to-world extrinsic matrix (camera pose) for frame-000000`, and four rows.
    """
    with suppress(RecordingError, OSError, ValueError):
        if file.suffix.lower() == ".json":
            return list(_of_json(read_json_object(file, WHAT), ()))
        if file.suffix.lower() == ".npy":
            matrix = np.asarray(_small_array(file), np.float64)
            return [((file.stem,), matrix)] if matrix.shape in SHAPES else []
        return list(_of_text(read_text(file, JSON_BYTES)))
    return []


def poses_by_frame(
    beside: Sequence[Path], stems: Sequence[str]
) -> tuple[list[Float64 | None], tuple[Path, ...]] | None:
    """Find the poses that a file beside the images holds under the names of the frames, as camera.json may.

    Args:
        beside: files to look at, of which only texts and JSON count that are not of one frame, at most
            `MOST_FILES`.
        stems: names of the depth images without suffix.

    Returns:
        Each frame's 4x4 matrix as the first such file has it (None without one), and all such files; None if
            no file has poses of half of the frames, or, where short numbers name the frames, of all of them.
    """
    wanted, poses, files = set(stems), list[dict[str, Float64]](), list[Path]()
    least = len(stems) if any(map(SHORT_NUMBER.fullmatch, stems)) else LEAST_POSED * len(stems)
    looked_at = [file for file in beside if file.suffix.lower() in SUFFIXES and file.stem not in wanted]
    for file in looked_at[:MOST_FILES]:
        found = dict[str, list[Float64]]()
        for names, matrix in named_matrices(file):
            of = wanted.intersection(names)
            other = any(OF_SOMETHING_ELSE.search(name) for name in names)
            if len(of) == 1 and matrix.shape != (3, 3) and not other:
                found.setdefault(of.pop(), []).append(matrix)
        sure = {stem: each[0] for stem, each in found.items() if len(each) == 1}
        moves = any(not np.array_equal(T, np.eye(4)[: len(T)]) for T in sure.values())
        if moves and len(sure) >= max(2, least):
            poses.append(sure)
            files.append(file)
    return ([_square(poses[0].get(stem)) for stem in stems], tuple(files)) if poses else None


def taken_for_poses(files: Sequence[Path]) -> str:
    """Return the warning on poses that `poses_by_frame` took from the first file, and not from the others."""
    held = "holds a matrix under the name of each frame, which is taken for its pose, camera to world"
    others = f", and not from {', '.join(file.name for file in files[1:])}" if files[1:] else ""
    return printable(f"{files[0]}: {held}{others}; `trajectory: ignore` does without them", 500)


def _small_array(file: Path) -> NDArray[np.generic]:
    with open_plain(file) as opened:
        return read_npy(opened, file.stat().st_size, _refuse_other_shapes)


def _refuse_other_shapes(header: NpyHeader) -> None:
    if header.shape not in SHAPES or header.dtype.kind not in "fiu":
        raise NpyError("no matrix")


def _of_json(value: dict[str, object], names: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Float64]]:
    for key, below in value.items():
        if isinstance(below, dict) and len(names) < LEVELS:
            yield from _of_json(below, (*names, key))
        elif isinstance(below, list) and (matrix := json_numbers(below)).shape in SHAPES:
            yield (*names, key), matrix


def _of_text(text: str) -> Iterator[tuple[tuple[str, ...], Float64]]:
    title, rows = "", list[list[float]]()
    for line in (*text.splitlines(), ""):
        words = line.translate(PUNCTUATION).split(maxsplit=SIDE)
        numbers = list[float]()
        if SIDE - 1 <= len(words) <= SIDE:
            with suppress(ValueError):
                numbers = [float(word) for word in words]
        if numbers:
            rows = [*rows, numbers][: SIDE + 1]  # a longer block is no matrix
            continue
        if rows and title and len({len(row) for row in rows}) == 1 and np.shape(rows) in SHAPES:
            yield tuple(title.split()), np.array(rows)
        title, rows = (line[:LONGEST_TITLE].strip("#/ \t:") if words or rows else title), []


def _square(matrix: Float64 | None) -> Float64 | None:
    if matrix is None or matrix.shape == (4, 4):
        return matrix
    return np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])
