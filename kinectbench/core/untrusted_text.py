"""Parse untrusted JSON and CSV, with cost bounded before parsing.

Readers limit the length of a text (`untrusted.py`). This module limits the parsed size of a short text: a
list in JSON takes three characters of text and fifty bytes of memory.
"""

import csv
import io
import json
import re
from collections import Counter
from collections.abc import Callable
from typing import Any, NoReturn

from kinectbench.core.untrusted import printable

# Largest number of values in a text: those of targets.csv with a quarter of a million lines, or of a
# benchmark.json with eleven thousand recordings. In a model a value takes 150 bytes, and an object 700: it
# counts as three values.
MOST_VALUES = 2_000_000
OBJECT_VALUES = 3
# Largest number of different keys: ids of recordings or pairs. A new key takes 330 bytes.
MOST_KEYS = 300_000
# Limit of texts with wide characters: one escaped character beyond U+FFFF makes a string four bytes wide.
WIDE_CHARACTERS = 16 << 20
# Largest number of characters of one text or key in a JSON file: a book that a person may read (chosen here).
# Longer ones would be printed, compared and put on pages.
MOST_TEXT = 1_000_000
# Text and end of a JSON string, in C.
_scanned: Callable[[str, int], tuple[str, int]] = json.decoder.scanstring  # type: ignore[attr-defined]
_COLON = re.compile(r"\s*:")
_FOUR_BYTES = re.compile(r"\\u[dD][89abAB]")


def strict_json(text: str, most_values: int = MOST_VALUES) -> Any:
    """Parse JSON, but refuse NaN, infinities and repeated keys; see `parsed_json`."""
    return parsed_json(text, constants=False, most_values=most_values)


def parsed_json(text: str, *, constants: bool, most_values: int = MOST_VALUES) -> Any:
    """Parse JSON of bounded size.

    Args:
        text: JSON.
        constants: accept NaN, Infinity and -Infinity, which many programs write; the last of repeated keys is
            then used.
        most_values: largest number of values in the text; an object counts as three.

    Raises:
        ValueError: malformed, or too many values or keys. RecursionError: nested too deeply.
    """
    _check_values(text, ",[" + "{" * OBJECT_VALUES, most_values)
    if len(text) > WIDE_CHARACTERS and _FOUR_BYTES.search(text):
        raise ValueError(f"it has more than {WIDE_CHARACTERS} characters, some beyond U+FFFF")
    if len(text) <= MOST_KEYS:  # too short for more keys
        return (_PARSER if constants else _STRICT_PARSER).decode(text)
    counted = _counting(dict if constants else _object)
    return json.JSONDecoder(object_pairs_hook=counted, parse_constant=None if constants else _refuse).decode(
        text
    )


def long_text(text: str, most: int) -> str | None:
    """Return a line on a text or key of over `most` characters in well-formed JSON; None if there is none."""
    if not (_runs_without_quote(text, most) or '\\"' in text):
        return None
    key, end = "", 0
    while (start := text.find('"', end) + 1) > 0:
        value, end = _scanned(text, start)
        if _COLON.match(text, end):
            key = value
        if len(value) > most:
            return f"'{printable(key)}' has {len(value)} characters; at most {most} are read; shorten it"
    return None


def _runs_without_quote(text: str, most: int) -> bool:
    """Return whether a text has more than `most` characters in a row without a quotation mark."""
    place = -1
    while place + 1 + most < len(text):
        before, place = place, text.rfind('"', place + 1, place + 2 + most)
        if place < 0:
            return before + 1 + most < len(text)
    return False


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not JSON")


def _object(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Make a dict from the pairs of a JSON object; refuse repeated keys."""
    values = dict(pairs)
    if len(values) < len(pairs):
        twice = Counter(key for key, _ in pairs).most_common(1)[0][0]
        raise ValueError(f"it has the key '{printable(twice)}' twice")
    return values


def _counting(
    to_object: Callable[[list[tuple[str, object]]], dict[str, object]],
) -> Callable[..., dict[str, object]]:
    """Wrap `to_object` to refuse a text whose objects have more than `MOST_KEYS` different keys in all."""
    keys = set[str]()

    def counted(pairs: list[tuple[str, object]]) -> dict[str, object]:
        if len(pairs) <= MOST_KEYS:
            keys.update(key for key, _ in pairs)
        if max(len(keys), len(pairs)) > MOST_KEYS:
            raise ValueError(f"it has more than {MOST_KEYS} keys")
        return to_object(pairs)

    return counted


# Kept, because making a parser takes as long as parsing a short text.
_PARSER = json.JSONDecoder()
_STRICT_PARSER = json.JSONDecoder(object_pairs_hook=_object, parse_constant=_refuse)


def csv_rows(text: str) -> list[list[str]]:
    """Parse the rows of a CSV text; lines end in LF or CR LF.

    Raises:
        ValueError: malformed, or too many values; the message names the line, from 1.
    """
    _check_values(text, ",\n")
    reader, rows, first_line = csv.reader(io.StringIO(text), strict=True), list[list[str]](), 0
    try:
        for row in reader:
            rows.append(row)
            first_line = reader.line_num
    except csv.Error as error:
        message = {
            "unexpected end of data": "a quote that is opened there is not closed",
            "',' expected after '\"'": "a quote is followed by neither a comma nor the end of the line",
        }.get(str(error), str(error))
        raise ValueError(f"line {first_line + 1}: {message}") from error
    return rows


def _check_values(text: str, signs: str, most: int = MOST_VALUES) -> None:
    """Refuse a text with more than `most` of the characters `signs`, which separate its values."""
    if len(text) > most and sum(text.count(sign) for sign in signs) > most:
        raise ValueError(f"it has more than {most} values")
