"""Find and remove private facts about people and devices in a release; list them in privacy.json."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import repeat
from typing import Any, TypeVar

from pydantic import BaseModel

from kinectbench.core import ReleaseError, pretty_json
from kinectbench.core.artefacts.provenance import ColorPublished, Privacy, Removed
from kinectbench.core.artefacts.stored import Stored
from kinectbench.core.jpeg_metadata import without_metadata

# Keys of JSON files whose values are always removed.
KEYS = re.compile(
    r"(?i)(^|_)(gps|latitude|longitude|altitude|location|serial|serial_number|serialnumber|device_id|imei|"
    r"mac_address|hostname|user|username|owner|email|phone)($|_)"
)
# Paths on somebody's disk, which name people: only the last part is kept. A folder with blanks counts below
# `home` or `users`, and in a path of Windows where more follows. A topic of ROS, /camera/depth/image_raw, is
# no path: it begins with no known folder, and its last part has no dot.
_PART = r"[^\s\"'<>|:;,/\\]"
_ROOTS = (
    r"home|homes|users|root|tmp|mnt|media|data|work|workspace|var|opt|srv|private|volumes|scratch|nfs|cluster|"
    r"lustre|gpfs|beegfs|afs|net|export|storage|projects?|run|cygdrive"
)
# Bounded, as a text of many slashes would take the square of its length.
_FOLDER = rf"/{_PART}{{1,255}}"
_MORE = rf"(?: {_PART}{{1,255}}){{1,2}}(?=[\"'<>|:;,/\\\n]|$)"
_OF_USER = rf"(?:{_FOLDER}){{0,9}}/(?i:homes?|users){_FOLDER}{_MORE}"
PATHS = re.compile(
    rf"(?:\bfile://|(?<![\w./]))(?:{_OF_USER}(?:/{_PART}*)*|/(?i:{_ROOTS})\d*(?![\w-])(?:/{_PART}*)*"
    rf"|(?:{_FOLDER}){{1,30}}/{_PART}*\.{_PART}+)"
    rf"|(?:\b[A-Za-z]:[\\/]|(?<!\\)\\\\(?=\w))(?:{_PART}+(?: {_PART}+){{0,2}}\\|{_PART}+/)*"
    rf"(?:(?<=(?i:users)[\\/]){_PART}+{_MORE}|{_PART}*)"
)
HOMES = ("home", "homes", "users")
EMAIL = re.compile(r"\b[\w.+-]+@[\w-]+(\.[\w-]+)+\b")
_ADDRESS = "(address removed)"
StoredFile = TypeVar("StoredFile", bound=Stored)
LOOKED_FOR = (
    "GPS positions",
    "serial numbers and identifiers of devices",
    "names of users and hosts, e-mail addresses",
    "paths on the disk of whoever published it",
    "EXIF, XMP, IPTC and comments in colour images",
)
LOOKED_IN = ("JSON files", "the settings in benchmark.json", "headers of colour images")
KEPT = (
    "capture times of the frames (stamp_ns), as the recording has them",
    "names of the recordings' files (lineage.json)",
    "what benchmark.yaml says of authors, source and contact",
    "depth images and masks: they show the shape of whatever stood before the camera",
)


def scrubbed(value: object, file: str, removals: list[Removed], model: object = None) -> Any:
    """Return a copy of a JSON value without private facts; what was removed is appended to `removals`.

    Args:
        value: a JSON value.
        file: name of the release's file that will hold the value.
        removals: a list to which removed facts are added.
        model: the pydantic model that gave `value`, or None. A key that looks private is kept if the model
            declares it, or if it is a key of a declared mapping (such as the name of a category).
    """
    removed: list[str] = []
    result = _scrubbed(value, "", removed, model)
    removals += _rows(file, removed)
    return result


def scrubbed_file(stored: StoredFile, file: str, removals: list[Removed]) -> StoredFile:
    """Return a copy of a file's content without private facts; what was removed is appended to `removals`.

    Raises:
        KinectBenchError: `stored.ERROR`, if the file is invalid without these facts.
    """
    removed: list[str] = []
    value = _scrubbed(stored.json_value(), "", removed, stored)
    removals += _rows(file, removed)
    return stored.parse(pretty_json(value), file) if removed else stored


def scrubbed_jpeg(data: bytes, file: str, removals: list[Removed]) -> bytes:
    """Return the bytes of a JPEG file without metadata; what was removed is appended to `removals`.

    Raises:
        ReleaseError: the data is no complete JPEG file.
    """
    try:
        clean, removed = without_metadata(data)
    except ValueError as error:
        raise ReleaseError(
            f"{file}: {error}; build this recording's views again", what="not-built"
        ) from error
    removals += _rows(file, removed)
    return clean


def privacy(color: ColorPublished, removals: list[Removed]) -> Privacy:
    """Return the content of privacy.json.

    Colour images are "left out", "published" or do not exist ("none").
    """
    return Privacy(
        format_version=1,
        color=color,
        looked_in=LOOKED_IN,
        looked_for=LOOKED_FOR,
        removed=tuple(removals),
        kept=KEPT,
    )


def removed_lines(rows: list[Removed]) -> Iterator[str]:
    """Yield one line for each kind of removed fact, with the number of files that had it."""
    for what, count in Counter(row.what for row in rows).items():
        yield f"removed from {count} file{'s' if count > 1 else ''}: {what}"


def _rows(file: str, removed: list[str]) -> list[Removed]:
    """Return rows of privacy.json for one file: one for each different text in `removed`."""
    return [Removed(file=file, what=what) for what in dict.fromkeys(removed)]


def _scrubbed(value: object, key: str, removed: list[str], model: object) -> object:
    """Return the value of JSON key `key` without private facts; append these to `removed`. Recursive."""
    if isinstance(value, Mapping):
        result, declared = {}, _declared(model)
        for name, child in value.items():
            said = EMAIL.sub(_ADDRESS, PATHS.sub(_last_part, str(name)))
            if name not in declared and (KEYS.search(str(name)) or said != str(name)):
                removed.append(f"the key '{said}'")
            else:
                result[name] = _scrubbed(child, str(name), removed, declared.get(name))
        return result
    if isinstance(value, list):
        parts = model if isinstance(model, list | tuple) and len(model) == len(value) else repeat(None)
        return [_scrubbed(child, key, removed, part) for child, part in zip(value, parts, strict=False)]
    if not isinstance(value, str):
        return value
    text = PATHS.sub(_last_part, value)
    if text != value:
        removed.append(f"a path in '{key}'")
    clean = EMAIL.sub(_ADDRESS, text)
    if clean != text:
        removed.append(f"an e-mail address in '{key}'")
    return clean


def _last_part(path: re.Match[str]) -> str:
    """Return the replacement of a matched path: its last part, or a placeholder if that is a user's name."""
    *above, last = re.split(r"[/\\]+", path[0].rstrip("/\\"))
    return "(path removed)" if above and above[-1].lower() in HOMES else last


def _declared(model: object) -> Mapping[str, object]:
    """Return {JSON key: value} of the keys that a model or `_Entries` declares; empty for other values."""
    if isinstance(model, BaseModel):
        fields = type(model).model_fields.items()
        return {field.serialization_alias or name: _below(getattr(model, name)) for name, field in fields}
    return model.entries if isinstance(model, _Entries) else {}


@dataclass(frozen=True)
class _Entries:
    """A mapping inside a model. Its keys are data, such as names of categories, so they are not scrubbed."""

    entries: Mapping[str, object]


def _below(value: object) -> object:
    """Return a field's value as `model` for `_scrubbed`; a mapping becomes `_Entries`, to keep its keys."""
    return _Entries(value) if isinstance(value, Mapping) else value
