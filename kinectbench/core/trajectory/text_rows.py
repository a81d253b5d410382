"""Reading small text files row by row, with the file and line of every complaint."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinectbench.core.errors import RecordingError
from kinectbench.core.types import Float64

# What stands around the numbers of a matrix in text.
PUNCTUATION = str.maketrans(dict.fromkeys(",;[]", " "))


def read_text(path: Path) -> str:
    """Read a UTF-8 text file, with or without a byte order mark.

    Raises:
        RecordingError: it cannot be read or is not text.
    """
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordingError(f"{path}: is not a text file (byte {error.start} is not UTF-8)") from error
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})") from error


def text_rows(path: Path) -> list[tuple[str, str]]:
    """The rows of a text file without comments (#) and empty lines, as ("FILE, line N", row).

    Raises:
        RecordingError: it cannot be read or is not text.
    """
    lines = enumerate(read_text(path).splitlines(), start=1)
    stripped = ((number, line.strip()) for number, line in lines)
    return [(f"{path}, line {n}", line) for n, line in stripped if line and not line.startswith("#")]


def parse_floats(words: Sequence[str], where: str) -> list[float]:
    """Turn words into floats; NaN and infinity pass.

    Raises:
        RecordingError: one is not a number.
    """
    numbers = []
    for word in words:
        try:
            numbers.append(float(word))
        except ValueError as error:
            raise RecordingError(f"{where}: '{word}' is not a number") from error
    return numbers


def read_numbers(path: Path) -> list[float]:
    """Every number of a text file, row by row; commas, semicolons and brackets are passed over.

    Raises:
        RecordingError: it cannot be read, or holds something else.
    """
    rows = [parse_floats(row.translate(PUNCTUATION).split(), where) for where, row in text_rows(path)]
    return [number for row in rows for number in row]


def read_matrix(path: Path, side: int) -> Float64:
    """Read a square matrix (side, side) from a text file, row by row; NaN and infinity pass.

    Raises:
        RecordingError: it cannot be read, or does not hold side x side numbers.
    """
    numbers = read_numbers(path)
    if len(numbers) != side * side:
        raise RecordingError(f"{path}: holds {len(numbers)} numbers, not the {side}x{side} of a matrix")
    return np.array(numbers).reshape(side, side)
