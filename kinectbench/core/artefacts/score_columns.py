"""rows.npz: the rows of a score table that are too many for scores.json, as one array per column.

A row takes 0.95 kB as JSON and 4.8 kB while it is read, but 0.4 kB as columns. A null value is NaN. A text
is an index into a list of the different texts, since a hundred thousand pairs have few categories.
"""

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, is_dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, TypeAdapter, ValidationError

from kinectbench.core.artefacts.score_figures import ByThreshold, InSpace, ScoredPair, ScoreRow, fields_of
from kinectbench.core.artefacts.score_marks import Sha256
from kinectbench.core.artefacts.stored import StoredPart
from kinectbench.core.errors import StorageError, pydantic_message
from kinectbench.core.storage import canonical_json, replaced_file, sha256_file, storage_errors
from kinectbench.core.types import Arrays
from kinectbench.core.untrusted import open_plain, size_of
from kinectbench.core.voxels.npz import UNREADABLE, arrays_of, npz_bytes

ROWS_NPZ = "rows.npz"
# More rows than these, 10,000 pairs under three protocols, lie in rows.npz.
ROWS_IN_JSON = 30_000
# 100,000 pairs under all five protocols.
MOST_ROWS = 500_000
# Rows of predictions in space state up to 1,020 bytes of JSON more (measured, of ten votes a view), and may
# state 1,440: 16,000 views under both protocols, 5,500 of several hypotheses.
MOST_ROWS_IN_SPACE = 200_000
# For the largest number of rows: 360 bytes each, and as much again for long names.
MOST_BYTES = 2 * 360 * MOST_ROWS
(CURVE,) = fields_of(ByThreshold)
TEXTS = tuple(name for name in fields_of(ScoredPair) if name != "threshold")
NUMBERS = tuple(name for name in fields_of(ScoreRow) if name not in (*TEXTS, CURVE, *fields_of(InSpace)))
# What rows of predictions in the camera frame state beside: as JSON, "" where there is nothing.
IN_SPACE = "in_space"
WORDS = "{}_words"
# Figures that the first files of rows lack.
LATER = ("chamfer_l1_m", "chamfer_l2_m2", "f_score_5mm", "f_score_5pct")
# Number of thresholds of a curve, as in `scoring.counts`.
THRESHOLDS = 17
# Rows that are made from columns at once: their plain values take 30 MB.
AT_ONCE = 10_000
_PLAIN_ROW, _PLAIN_IN_SPACE = TypeAdapter(ScoreRow), TypeAdapter(InSpace)


class RowsFile(StoredPart):
    """The description in scores.json of the rows beside it."""

    rows: int = Field(ge=0, le=MOST_ROWS, description="number of rows")
    sha256: Sha256 = Field(description="SHA-256 of rows.npz")


def rows_as_json(rows: Sequence[ScoreRow]) -> Iterator[str]:
    """Yield a canonical JSON list of the rows in pieces: half a million rows as one text take gigabytes."""
    for at, row in enumerate(rows):
        yield f"{',' if at else '['}{canonical_json(_PLAIN_ROW.dump_python(row, mode='json'))}"
    yield "]" if rows else "[]"


def write_rows(rows: Sequence[ScoreRow], folder: Path, *, over: bool) -> RowsFile | None:
    """Write the rows of a score table as rows.npz if there are more than `ROWS_IN_JSON`.

    Args:
        rows: rows of the table.
        folder: folder of the table's JSON file.
        over: whether an existing rows.npz that holds other rows may be replaced.

    Returns:
        The entry for the JSON file; None if the rows are few, and belong in the JSON file itself.

    Raises:
        StorageError: a rows.npz with other rows must not be replaced, or the disk is full or read-only.
    """
    path = folder / ROWS_NPZ
    if len(rows) <= ROWS_IN_JSON:
        return None
    content = npz_bytes(_columns(rows), level=1)
    entry = RowsFile(rows=len(rows), sha256=hashlib.sha256(content).hexdigest())
    with storage_errors(path):
        if not over and path.exists() and sha256_file(path) != entry.sha256:
            raise StorageError(
                f"{path}: holds the rows of scores.json; move this table to a folder of its own",
                what="other-content",
            )
    with replaced_file(path) as temporary:
        temporary.write_bytes(content)
    return entry


def remove_rows(folder: Path) -> None:
    """Delete the rows.npz of an earlier table, if there is one.

    Raises:
        StorageError: the disk is read-only.
    """
    with storage_errors(folder / ROWS_NPZ):
        (folder / ROWS_NPZ).unlink(missing_ok=True)


def _columns(rows: Sequence[ScoreRow]) -> Arrays:
    """Convert rows to the arrays of rows.npz, by name."""
    arrays: Arrays = {}
    for name in (*TEXTS, IN_SPACE):
        positions: dict[str, int] = {}
        places = [positions.setdefault(_text(row, name), len(positions)) for row in rows]
        arrays[name], words = np.array(places, np.int32), [*positions]
        arrays[WORDS.format(name)] = _as_bytes(words) if name == IN_SPACE else np.array(words, np.str_)
    for name in NUMBERS:
        values = (getattr(row, name) for row in rows)
        arrays[name] = np.fromiter((math.nan if of is None else of for of in values), np.float64, len(rows))
    curves = np.full((len(rows), THRESHOLDS), np.nan)
    for at, row in enumerate(rows):
        if row.iou_by_threshold is not None:
            curves[at] = row.iou_by_threshold
    arrays[CURVE] = curves
    return arrays


def _as_bytes(words: Sequence[str]) -> NDArray[np.uint8]:
    """Convert ASCII texts to uint8 (n, length of the longest), a quarter of the memory of `np.str_`."""
    padded = np.array([word.encode() for word in words], np.bytes_)
    return padded.view(np.uint8).reshape(len(words), padded.itemsize)


def _text(row: ScoreRow, name: str) -> str:
    """Return a row's value in a text column; in the column `IN_SPACE`, its `InSpace` as JSON, or ""."""
    if name != IN_SPACE:
        return str(getattr(row, name))
    if row.part is None:
        return ""
    plain = _PLAIN_ROW.dump_python(row, mode="json")
    return canonical_json({key: plain[key] for key in fields_of(InSpace)})


def read_rows(folder: Path, stated: RowsFile) -> tuple[ScoreRow, ...]:
    """Read the untrusted rows.npz of a score table.

    Args:
        folder: folder of the file.
        stated: the entry for the file in scores.json.

    Raises:
        StorageError: the file is missing, damaged, too large, or not the one that scores.json names.
    """
    path, count = folder / ROWS_NPZ, stated.rows
    try:
        with open_plain(path) as file:
            if size_of(file) > MOST_BYTES:
                raise ValueError(f"larger than {MOST_BYTES} bytes")
            if hashlib.file_digest(file, "sha256").hexdigest() != stated.sha256:
                raise ValueError("another file than scores.json names")
            file.seek(0)
            arrays = arrays_of(file, MOST_BYTES)
        _check(arrays, count)
        return tuple(row for start in range(0, count, AT_ONCE) for row in _rows(arrays, start))
    except ValidationError as error:
        first = error.errors(include_input=False)[0]
        why = f"'{'.'.join(map(str, first['loc']))}': {pydantic_message(first)}"
    except (*UNREADABLE, ValueError) as error:
        why = str(error)
    raise StorageError(f"{path}: not the rows of a score table ({why}); score the predictions again")


def _check(arrays: Arrays, count: int) -> None:
    """Check the columns' shapes, types and text indices; in place, decode texts and add missing columns."""
    texts = (*TEXTS, *(name for name in (IN_SPACE,) if name in arrays))
    for name in (*texts, *NUMBERS, CURVE):
        # Tables of earlier versions lack figures of predictions in the camera frame.
        if name in LATER and name not in arrays:
            arrays[name] = np.full(count, math.nan)
        column = arrays[name]
        shape = (count, THRESHOLDS) if name == CURVE else (count,)
        if column.shape != shape or column.dtype != (np.int32 if name in texts else np.float64):
            raise ValueError(f"'{name}' is {column.dtype} {column.shape}, wanted {shape}")
    for name in texts:
        words, column = arrays[WORDS.format(name)], arrays[name]
        if name == IN_SPACE and words.dtype == np.uint8 and words.ndim == 2 and words.shape[1]:
            words = np.ascontiguousarray(words).view(f"S{words.shape[1]}")[:, 0]
            arrays[WORDS.format(name)] = words
        elif words.ndim != 1 or words.dtype.kind != "U":  # of all texts in earlier versions
            raise ValueError(f"'{WORDS.format(name)}' is no list of texts")
        if count and not (column.min() >= 0 and column.max() < len(words)):
            raise ValueError(f"'{name}' names texts that are not in '{WORDS.format(name)}'")


def _rows(arrays: Arrays, start: int) -> Iterator[ScoreRow]:
    """Yield up to `AT_ONCE` rows from index `start` on, of arrays that `_check` has accepted."""
    batch = slice(start, start + AT_ONCE)
    columns: dict[str, list[object]] = {}
    for name in TEXTS:
        words = arrays[WORDS.format(name)].tolist()
        columns[name] = [words[at] for at in arrays[name][batch].tolist()]
    for name in NUMBERS:
        columns[name] = [None if math.isnan(of) else of for of in arrays[name][batch].tolist()]
    columns["cells"] = [
        int(of) if isinstance(of, float) and of.is_integer() else of for of in columns["cells"]
    ]
    columns[CURVE] = [None if math.isnan(of[0]) else tuple(of) for of in arrays[CURVE][batch].tolist()]
    more = _in_space(arrays, batch) if IN_SPACE in arrays else [{}] * len(columns[CURVE])
    for *values, beside in zip(*columns.values(), more, strict=True):
        yield ScoreRow(**dict(zip(columns, values, strict=True)), **beside)


def _in_space(arrays: Arrays, batch: slice) -> list[dict[str, object]]:
    """Parse the values of `InSpace`, which have no columns of their own, for some rows: a dict per row."""
    words = arrays[WORDS.format(IN_SPACE)]
    used = {at: words[at] for at in set(arrays[IN_SPACE][batch].tolist())}
    read = {at: vars(_PLAIN_IN_SPACE.validate_json(text)) if text else {} for at, text in used.items()}
    return [read[at] for at in arrays[IN_SPACE][batch].tolist()]


def flat(value: object) -> object:
    """Convert a value to one cell of a CSV table; a dataclass of several values becomes JSON."""
    return canonical_json(asdict(value)) if is_dataclass(value) and not isinstance(value, type) else value
