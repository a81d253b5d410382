"""Texts of strangers as values, JSON and CSV: what they cost is known before they are parsed.

A text is bounded by who reads the file (`untrusted.py`). Here it is bounded what a short text becomes: a list
in JSON takes three characters and fifty bytes of memory.
"""

import csv
import io
import json
from typing import Any, NoReturn

# Values in one text: those of a quarter of a million lines of targets.csv, or of a hundred thousand pairs'
# scores. Two million keys with a number each take 205 MB (own choice).
MOST_VALUES = 2_000_000


def strict_json(text: str) -> Any:
    """Parse JSON without NaN and infinities.

    Raises:
        ValueError: it is malformed, or has too many values; RecursionError: it is nested without end.
    """

    def refuse(constant: str) -> NoReturn:
        raise ValueError(f"{constant} is not JSON")

    _check_values(text, ",[{")
    return json.loads(text, parse_constant=refuse)


def csv_rows(text: str) -> list[list[str]]:
    """The rows of a CSV text; a line ends in LF or CR LF.

    Raises:
        ValueError: it is malformed, or has too many values.
    """
    _check_values(text, ",\n")
    try:
        return list(csv.reader(io.StringIO(text)))
    except csv.Error as error:
        raise ValueError(str(error)) from error


def _check_values(text: str, signs: str) -> None:
    """Refuse a text with so many of the signs that stand between values."""
    if len(text) > MOST_VALUES and sum(text.count(sign) for sign in signs) > MOST_VALUES:
        raise ValueError(f"it has more than {MOST_VALUES} values")
