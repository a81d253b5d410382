"""Find and remove private facts about people and devices in a release; list them in privacy.json."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import repeat
from typing import Any, Literal, TypeVar

from pydantic import BaseModel

from kinectbench.core.artefacts.provenance import ColorPublished, Privacy, Removed
from kinectbench.core.artefacts.stored import Stored
from kinectbench.core.errors import ReleaseError
from kinectbench.core.storage import pretty_json

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
LOOKED_IN = (
    "JSON files",
    "the settings in benchmark.json",
    "headers of colour images",
)
KEPT = (
    "capture times of the frames (stamp_ns), as the recording has them",
    "names of the recordings' files (lineage.json)",
    "what benchmark.yaml says of authors, source and contact",
    "depth images and masks: they show the shape of whatever stood before the camera",
)
Order = Literal["little", "big"]
# Kept segments: JFIF, the colour profile and Adobe's mark, which say how pixels are decoded; the number of
# kept bytes, and what stands for the rest: JFIF's thumbnail of 0 x 0 pixels. ITU-T T.871 and T.872.
KEPT_SEGMENTS = (
    (0xE0, b"JFIF\0", 12, b"\0\0"),
    (0xE2, b"ICC_PROFILE\0", 1 << 16, b""),
    (0xEE, b"Adobe", 12, b""),
)
NAMES = (
    *((b"JFIF\0", "thumbnail"), (b"JFXX\0", "thumbnail")),
    *((b"Exif\0\0", "EXIF"), (b"http://ns.adobe.com/xap/1.0/\0", "XMP"), (b"Photoshop 3.0\0", "IPTC")),
)
# Markers of ITU-T T.81, table B.1.
APP0, APP15, COMMENT, START_OF_SCAN, END_OF_IMAGE = 0xE0, 0xEF, 0xFE, 0xDA, 0xD9
# Those that may follow a scan: tables, the next scan, the end, application segments, comments.
AFTER_SCAN = re.compile(rb"\xff[\xc4\xd9-\xdd\xe0-\xef\xfe]")
ALONE = (0x01, *range(0xD0, 0xD9))


def scrubbed(value: object, file: str, removals: list[Removed], model: object = None) -> Any:
    """Return a copy of a JSON value without private facts; removals are appended to `removals`.

    Args:
        value: a JSON value.
        file: the release's file that will hold the value.
        removals: a list to which removed facts are added.
        model: the pydantic model behind `value`, or None. A key that looks private is kept if the model
            declares it, or if it is a key of a declared mapping (such as the name of a category).
    """
    removed: list[str] = []
    result = _scrubbed(value, "", removed, model)
    removals += _rows(file, removed)
    return result


def scrubbed_file(stored: StoredFile, file: str, removals: list[Removed]) -> StoredFile:
    """Return the content of a file without private facts; removals are appended to `removals`.

    Raises:
        KinectBenchError: `stored.ERROR`, if the file is invalid without these facts.
    """
    removed: list[str] = []
    value = _scrubbed(stored.json_value(), "", removed, stored)
    removals += _rows(file, removed)
    return stored.parse(pretty_json(value), file) if removed else stored


def scrubbed_jpeg(data: bytes, file: str, removals: list[Removed]) -> bytes:
    """Return the bytes of a JPEG file without metadata; removals are appended to `removals`.

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

    Args:
        color: whether colour images are "left out", "published" or do not exist ("none").
        removals: the removed private facts.
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
    """Return rows of privacy.json for one file: one for each kind of fact in `removed`."""
    return [Removed(file=file, what=what) for what in dict.fromkeys(removed)]


def _scrubbed(value: object, key: str, removed: list[str], model: object) -> object:
    """Return the value of a JSON key without private facts; append removals to `removed`. Recursive."""
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
    """Return the text that replaces a matched path: its last part, unless that is a user's name."""
    *above, last = re.split(r"[/\\]+", path[0].rstrip("/\\"))
    return "(path removed)" if above and above[-1].lower() in HOMES else last


def _declared(model: object) -> Mapping[str, object]:
    """Return {JSON key: model's value} of the keys that a model declares; empty for other values."""
    if isinstance(model, BaseModel):
        fields = type(model).model_fields.items()
        return {field.serialization_alias or name: _below(getattr(model, name)) for name, field in fields}
    return model.entries if isinstance(model, _Entries) else {}


@dataclass(frozen=True)
class _Entries:
    """The `entries` of a mapping in a model; its keys are data, such as names of categories, and are kept."""

    entries: Mapping[str, object]


def _below(value: object) -> object:
    """Return a field's value as `model` for `_scrubbed`; a mapping is wrapped, so that its keys are kept."""
    return _Entries(value) if isinstance(value, Mapping) else value


def without_metadata(data: bytes) -> tuple[bytes, list[str]]:
    """Remove metadata from a JPEG file: application segments, comments, and data after the picture.

    The pixels and what `KEPT_SEGMENTS` keeps (of JFIF, colour profile, Adobe) are unchanged. Phones append
    a second picture or a film, which has metadata of its own.

    Args:
        data: bytes of the file.

    Returns:
        The bytes without metadata, and the names of the removed parts, such as "EXIF (GPS position)".

    Raises:
        ValueError: the data is no JPEG file, or ends too early.

    Source: ITU-T T.81, annex B (markers); Exif 2.32 (tags).
    """
    kept, removed, end = [data[:2]], list[str](), 2
    for marker, start, end, payload in _segments(data):
        if not (APP0 <= marker <= APP15 or marker == COMMENT):
            kept.append(data[start:end])
            continue
        rows = (row for row in KEPT_SEGMENTS if marker == row[0] and payload.startswith(row[1]))
        left = next((payload[:most] + rest for _, _, most, rest in rows), b"")
        if left != payload:
            removed.append(_name(marker, payload))
        if left:
            head = data[start : end - len(payload) - 2]
            kept.append(head + (len(left) + 2).to_bytes(2, "big") + left)
    if data[end:].strip(b"\0"):  # zeros alone say nothing
        removed.append("data after the picture")
    return b"".join(kept), removed


def _segments(data: bytes) -> Iterator[tuple[int, int, int, bytes]]:
    """Yield (marker, start, end, payload) of every JPEG segment; start and end are offsets in `data`."""
    if data[:2] != b"\xff\xd8":
        raise ValueError("not a JPEG file")
    at, has_scan = 2, False
    while at < len(data) or not has_scan:  # some cameras leave the end marker out
        start = at
        if data[at : at + 1] != b"\xff":
            raise ValueError("damaged or cut off")
        while data[at : at + 1] == b"\xff":  # extra 0xff bytes may precede a marker
            at += 1
        marker = data[at] if at < len(data) else 0
        at += 1
        if marker in ALONE:
            yield marker, start, at, b""
            continue
        if marker == END_OF_IMAGE and has_scan:
            yield marker, start, at, b""
            return
        length = int.from_bytes(data[at : at + 2], "big")
        if length < 2 or at + length > len(data):
            raise ValueError("damaged or cut off")
        payload = data[at + 2 : at + length]
        at += length
        if marker == START_OF_SCAN:
            has_scan, at = True, _end_of_scan(data, at)
        yield marker, start, at, payload


def _end_of_scan(data: bytes, at: int) -> int:
    """Return the offset of the end of the JPEG scan that contains offset `at`.

    A scan ends at the end of the image, at another scan, or at a marker whose segment is followed by a
    marker. A damaged byte in a scan may look like a marker, but is not followed by a segment and a marker.
    """
    for following in AFTER_SCAN.finditer(data, at):
        start = following.start()
        marker, length = data[start + 1], int.from_bytes(data[start + 2 : start + 4], "big")
        # The header of another scan has 8 to 14 bytes (T.81, B.2.3); what follows it is no marker.
        is_scan = marker == START_OF_SCAN and 8 <= length <= 14
        if marker == END_OF_IMAGE or is_scan or data[start + 2 + length : start + 3 + length] == b"\xff":
            return start
    return len(data)


def _name(marker: int, payload: bytes) -> str:
    """Return the name of a JPEG segment with the private facts in it, such as "EXIF (GPS position)"."""
    if marker == COMMENT:
        return "comment"
    name = next((name for head, name in NAMES if payload.startswith(head)), f"APP{marker - APP0}")
    facts = _exif_facts(payload[6:]) if name == "EXIF" else []
    return f"{name} ({', '.join(facts)})" if facts else name


def _exif_facts(tiff: bytes) -> list[str]:
    """Return the kinds of private facts in an EXIF block, such as "GPS position", found by their tags."""
    order: Order = "little" if tiff[:2] == b"II" else "big"
    tags = {0x8825: "GPS position", 0xA431: "serial number", 0xA435: "serial number", 0xA430: "owner"}
    facts = [name for tag, name in tags.items() if tag.to_bytes(2, order) in _tags(tiff, order)]
    return list(dict.fromkeys(facts))


def _tags(tiff: bytes, order: Order) -> set[bytes]:
    """Return the tags, two bytes each, of a TIFF's first directory and of its EXIF directory.

    The result is empty if the data is damaged.
    """

    def number(part: bytes) -> int:
        return int.from_bytes(part, order)

    tags: set[bytes] = set()
    todo, seen = [number(tiff[4:8])], set[int]()
    while todo:
        at = todo.pop()
        if at in seen or at + 2 > len(tiff):
            continue
        seen.add(at)
        for index in range(number(tiff[at : at + 2])):
            entry = tiff[at + 2 + 12 * index : at + 14 + 12 * index]
            if len(entry) < 12:
                break
            tags.add(entry[:2])
            if number(entry[:2]) == 0x8769:
                todo.append(number(entry[8:12]))
    return tags
