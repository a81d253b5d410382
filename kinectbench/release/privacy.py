"""What a release must not tell of people and devices: found, removed and listed in privacy.json."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from kinectbench.errors import ReleaseError
from kinectbench.release.jpeg import without_metadata

# Keys of JSON files whose values are removed, whatever they hold.
KEYS = re.compile(
    r"(?i)(^|_)(gps|latitude|longitude|altitude|location|serial|serial_number|serialnumber|device_id|imei|"
    r"mac_address|hostname|user|username|owner|email|phone)($|_)"
)
# Places on somebody's disk, which name people: only the last part is kept.
PATHS = re.compile(
    r"(?:(?<![\w./])/(?:home|Users|root|tmp|mnt|media|data|work|var|opt|srv|private|Volumes)|\b[A-Za-z]:\\)"
    r"[^\s\"'<>|:;,]*"
)
EMAIL = re.compile(r"\b[\w.+-]+@[\w-]+(\.[\w-]+)+\b")
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


@dataclass
class Found:
    """Collects what was removed.

    Attributes:
        rows: `file` and `what`, in the order they were found.
    """

    rows: list[dict[str, str]] = field(default_factory=list)

    def add(self, file: str, what: str) -> None:
        """Note that something was removed from a file of the release."""
        self.rows.append({"file": file, "what": what})


def scrubbed(value: Any, file: str, found: Found) -> Any:
    """A JSON value without what tells of people and devices; what is removed is noted."""
    result, removed = _scrubbed(value, "")
    for what in dict.fromkeys(removed):
        found.add(file, what)
    return result


def scrubbed_jpeg(data: bytes, file: str, found: Found) -> bytes:
    """A JPEG file without metadata; what is removed is noted.

    Raises:
        ReleaseError: it is not a whole JPEG file.
    """
    try:
        clean, removed = without_metadata(data)
    except ValueError as error:
        raise ReleaseError(f"{file}: {error}; build this recording's views again") from error
    for what in dict.fromkeys(removed):
        found.add(file, what)
    return clean


def privacy_json(color: str, found: Found) -> dict[str, Any]:
    """Content of privacy.json.

    Args:
        color: "left out", "published" or "none".
        found: what was removed.
    """
    return {
        "format_version": 1,
        "color": color,
        "looked_in": list(LOOKED_IN),
        "looked_for": list(LOOKED_FOR),
        "removed": found.rows,
        "kept": list(KEPT),
    }


def removed_lines(rows: list[dict[str, str]]) -> Iterator[str]:
    """One line for each kind of thing that was removed, with the number of files."""
    files: dict[str, int] = {}
    for row in rows:
        files[row["what"]] = files.get(row["what"], 0) + 1
    for what, count in files.items():
        yield f"removed from {count} file{'s' if count > 1 else ''}: {what}"


def _scrubbed(value: Any, key: str) -> tuple[Any, list[str]]:
    removed: list[str] = []
    if isinstance(value, Mapping):
        result = {}
        for name, child in value.items():
            if KEYS.search(str(name)):
                removed.append(f"the key '{name}'")
                continue
            result[name], inner = _scrubbed(child, str(name))
            removed += inner
        return result, removed
    if isinstance(value, list):
        children = [_scrubbed(child, key) for child in value]
        return [child for child, _ in children], [line for _, inner in children for line in inner]
    if not isinstance(value, str):
        return value, removed
    text = PATHS.sub(lambda match: re.split(r"[/\\]", match[0].rstrip("/\\"))[-1], value)
    if text != value:
        removed.append(f"a path in '{key}'")
    clean = EMAIL.sub("(address removed)", text)
    if clean != text:
        removed.append(f"an e-mail address in '{key}'")
    return clean, removed
