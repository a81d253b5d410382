"""What a JPEG file says besides its pixels: taken out without touching them."""

from collections.abc import Iterator
from typing import Literal

Order = Literal["little", "big"]

# Kept: JFIF, the colour profile and Adobe's mark, which say how the pixels are meant.
KEPT = ((0xE0, b"JFIF\0"), (0xE0, b"JFXX\0"), (0xE2, b"ICC_PROFILE\0"), (0xEE, b"Adobe"))
NAMES = ((b"Exif\0\0", "EXIF"), (b"http://ns.adobe.com/xap/1.0/\0", "XMP"), (b"Photoshop 3.0\0", "IPTC"))
APP0, APP15, COMMENT, START_OF_SCAN = 0xE0, 0xEF, 0xFE, 0xDA
ALONE = (0x01, *range(0xD0, 0xD9))


def without_metadata(data: bytes) -> tuple[bytes, list[str]]:
    """Take application segments and comments out of a JPEG file; its pixels stay as they are.

    Args:
        data: the file.

    Returns:
        The file without them, and what was taken out, in its order, such as "EXIF (GPS position)".

    Raises:
        ValueError: it is not a JPEG file, or ends too early.

    Source: ITU-T T.81, annex B (markers); Exif 2.32 (tags).
    """
    kept, removed = [data[:2]], []
    for marker, start, end, payload in _segments(data):
        is_metadata = APP0 <= marker <= APP15 or marker == COMMENT
        if is_metadata and not any(marker == m and payload.startswith(head) for m, head in KEPT):
            removed.append(_name(marker, payload))
        else:
            kept.append(data[start:end])
    return b"".join(kept), removed


def _segments(data: bytes) -> Iterator[tuple[int, int, int, bytes]]:
    """(marker, first byte, byte after the last, payload) of every segment; the scans come as one, last."""
    if data[:2] != b"\xff\xd8":
        raise ValueError("not a JPEG file")
    at = 2
    while True:
        start = at
        if data[at : at + 1] != b"\xff":
            raise ValueError("damaged or cut off")
        while data[at : at + 1] == b"\xff":  # markers may be padded
            at += 1
        marker = data[at] if at < len(data) else 0
        at += 1
        if marker in ALONE:
            yield marker, start, at, b""
            continue
        if marker == START_OF_SCAN:
            yield marker, start, len(data), b""
            return
        length = int.from_bytes(data[at : at + 2], "big")
        if length < 2 or at + length > len(data):
            raise ValueError("damaged or cut off")
        yield marker, start, at + length, data[at + 2 : at + length]
        at += length


def _name(marker: int, payload: bytes) -> str:
    """What a segment is, and what of a person's or a device's it holds."""
    if marker == COMMENT:
        return "comment"
    name = next((name for head, name in NAMES if payload.startswith(head)), f"APP{marker - APP0}")
    found = _exif_facts(payload[6:]) if name == "EXIF" else []
    return f"{name} ({', '.join(found)})" if found else name


def _exif_facts(tiff: bytes) -> list[str]:
    """Which personal facts a block of EXIF holds, by their tags."""
    order: Order = "little" if tiff[:2] == b"II" else "big"
    tags = {0x8825: "GPS position", 0xA431: "serial number", 0xA435: "serial number", 0xA430: "owner"}
    found = [name for tag, name in tags.items() if tag.to_bytes(2, order) in _tags(tiff, order)]
    return list(dict.fromkeys(found))


def _tags(tiff: bytes, order: Order) -> set[bytes]:
    """Tags of the first directory and of the EXIF directory below it; empty if damaged."""

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
