"""Read small text files row by row; errors name the file and the line."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinectbench.core.errors import RecordingError
from kinectbench.core.types import Float64
from kinectbench.core.untrusted import printable, read_plain_text

# An hour of poses at 100 Hz, 80 characters each, is 29 MB in 360,000 lines.
MOST_BYTES, MOST_ROWS, MOST_COLUMNS = 64 << 20, 500_000, 10_000
# A matrix with comments.
MATRIX_BYTES = 1 << 20
# The line ends of `str.splitlines`.
LINE_ENDS = "\n\r\v\f\x1c\x1d\x1e\x85\u2028\u2029"

# Characters that may surround the numbers of a matrix.
PUNCTUATION = str.maketrans(dict.fromkeys(",;[]", " "))


def read_text(path: Path, most_bytes: int = MOST_BYTES) -> str:
    """Read a UTF-8 text file of at most `most_bytes`, with or without a byte order mark.

    Raises:
        RecordingError: the file cannot be read, is too large, or is not text.
    """
    try:
        return read_plain_text(path, most_bytes)
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path}: is not a text file (byte {error.start} is not UTF-8)") from error
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})", what="unreadable") from error


def text_rows(path: Path, most_bytes: int = MOST_BYTES) -> list[tuple[str, str]]:
    """Return the rows of a text file, without comments (#) and empty lines, as pairs ("FILE, line N", row).

    Raises:
        RecordingError: the file cannot be read, is not text, or is too large.
    """
    text = read_text(path, most_bytes)
    if sum(map(text.count, LINE_ENDS)) - text.count("\r\n") > MOST_ROWS:
        raise RecordingError(
            f"{path}: holds more than the {MOST_ROWS} lines that such a file may have", what="too-large"
        )
    lines = enumerate(text.splitlines(), start=1)
    stripped = ((number, line.strip()) for number, line in lines)
    rows = [(f"{path}, line {n}", line) for n, line in stripped if line and not line.startswith("#")]
    long = next((where for where, line in rows if len(line) > MOST_COLUMNS), None)
    if long is not None:
        raise RecordingError(
            f"{long}: is longer than the {MOST_COLUMNS} characters that a line may have", what="too-large"
        )
    return rows


def parse_floats(words: Sequence[str], where: str) -> list[float]:
    """Convert words to floats; NaN and infinity are accepted.

    Raises:
        RecordingError: a word is not a number.
    """
    numbers = []
    for word in words:
        try:
            numbers.append(float(word.replace("_", "?")))  # Python would take 1_0 for 10
        except ValueError as error:
            raise RecordingError(f"{where}: '{printable(word)}' is not a number") from error
    return numbers


def read_numbers(path: Path) -> list[float]:
    """Read all numbers of a small text file, row by row; commas, semicolons and brackets are ignored.

    Raises:
        RecordingError: the file cannot be read, is too large, or contains anything but numbers.
    """
    rows = [
        parse_floats(row.translate(PUNCTUATION).split(), where)
        for where, row in text_rows(path, MATRIX_BYTES)
    ]
    return [number for row in rows for number in row]


def read_matrix(path: Path, side: int) -> Float64:
    """Read a (side, side) matrix from a text file, stored row by row; NaN and infinity are accepted.

    Raises:
        RecordingError: the file cannot be read, or does not hold side x side numbers.
    """
    numbers = read_numbers(path)
    if len(numbers) != side * side:
        raise RecordingError(f"{path}: holds {len(numbers)} numbers, not the {side}x{side} of a matrix")
    return np.array(numbers).reshape(side, side)
