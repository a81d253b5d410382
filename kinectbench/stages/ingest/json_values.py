"""Read JSON objects and their numbers from untrusted files, within limits of size."""

import math
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from kinectbench.core import RecordingError, parsed_json, quoted
from kinectbench.core.trajectory.text_rows import read_text
from kinectbench.core.types import Float64

# Limit for poses and intrinsics of 50,000 frames; the number of values has its own limit.
JSON_BYTES = 16 << 20
# Limit for the JSON of one frame: apps write a few kilobytes.
FRAME_JSON_BYTES = 256 << 10


def json_numbers(value: object) -> Float64:
    """Return a JSON number (shape ()) or nested list as an array, null as NaN; any other as shape (0,)."""
    try:
        return np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError):  # an integer may be too large
        return np.empty(0)


def read_json_object(path: Path, what: str, most_bytes: int = JSON_BYTES) -> dict[str, object]:
    """Read a JSON object of at most `most_bytes`; `what` is the expected content, for messages.

    Raises:
        RecordingError: the file is too large, not valid JSON, or no object.
    """
    return object_of(read_text(path, most_bytes), str(path), what)


def read_camera_of_frame(file: Path, what: str, keys: Sequence[str]) -> dict[str, object] | None:
    """Read the values of `keys` from a frame's JSON file, and add the file's path as "file".

    A missing file gives None. A list of numbers becomes an array, because nested Python lists for all frames
    would need far more memory than the JSON text. Any other list, and a JSON object, becomes an empty array.
    `what` is the expected content, for messages.

    Raises:
        RecordingError: the file is too large, not valid JSON, or no object.
    """
    if not file.is_file():
        return None
    content = read_json_object(file, what, FRAME_JSON_BYTES)
    kept = {key: content[key] for key in keys if key in content}
    lean = {key: json_numbers(v) if isinstance(v, list | dict) else v for key, v in kept.items()}
    return lean | {"file": str(file)}


def object_of(text: str | bytes, where: str, what: str) -> dict[str, Any]:
    """Parse a JSON object; `where` (the file) and `what` (its expected content) are for error messages.

    Raises:
        RecordingError: too large, not valid JSON, or no object.
    """
    if len(text) > JSON_BYTES:
        raise RecordingError(f"{where}: is larger than the {JSON_BYTES} bytes that it may have")
    try:
        # Python writes NaN for the pose of a lost frame.
        raw = parsed_json(text if isinstance(text, str) else text.decode("utf-8-sig"), constants=True)
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{where}: is not valid JSON ({error})") from error
    if not isinstance(raw, dict):
        raise RecordingError(f"{where}: must hold an object with {what}")
    return raw


def number_of(value: object, where: str) -> float:
    """Return a JSON value as a float if it is a finite number; `where` (file and key) is for the message.

    Raises:
        RecordingError: the value is not a finite number.
    """
    with suppress(OverflowError):  # an integer may be too large
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
    raise RecordingError(f"{where} must be a number, not {quoted(value)}")
