"""Remove metadata from JPEG files, such as EXIF with a GPS position, without a change of the pixels."""

import re
from collections.abc import Iterator
from typing import Literal

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
# Those without a segment: TEM, RST0 to RST7, SOI.
ALONE = (0x01, *range(0xD0, 0xD9))


def without_metadata(data: bytes) -> tuple[bytes, list[str]]:
    """Remove metadata from a JPEG file: application segments, comments, and data after the picture.

    The pixels and the segments in `KEPT_SEGMENTS` (JFIF, colour profile, Adobe) are unchanged. Phones append
    a second picture or a film, which has metadata of its own.

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
