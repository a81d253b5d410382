"""Ways to damage a file or a folder, drawn at random: bytes, words, values, and what lies in its place."""

import csv
import io
import json
import os
import re
import shutil
import socket
import struct
import tempfile
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

from fuzz.members import OPENERS

# No number or too large; out of the folder; for a terminal, a spreadsheet or YAML; the end of what it is in.
WORDS = (
    *("nan", "-inf", "1e308", "1e-308", "1e999", "-1", "0", "1", "9" * 40, "0x7fffffff", "2147483648"),
    *("9223372036854775808", "٣", "1_000", "-0.0", "True", "null", "", "..", "../..", "../../../etc/passwd"),
    *("/etc/passwd", "/dev/zero", "a/../../b", "\\..\\x", "~", ".", "\0", "\x1b]0;x\x07\x1b[2J", "a\nb"),
    *("\r", "ä" * 50, "\u202e\u2028", "x" * 300, "x" * 5000, "=cmd|calc", "'", '"', ",", "{}", "[" * 300),
    *("*x", "&a [*a]", "!!python/name:os.system", "<<: *a", "- - - -", "%00", "{{7*7}}", "<script>", "$HOME"),
    *("index.html", "con", "-rf", "\ud7ff", "\ufeff"),
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    *(None, True, 0, 1, -1, 10**6, 2**31, 2**63, 10**40, 1e308, -1e308, 1e-308, 0.5, "", "nan", "..", {}, []),
    *("/etc/passwd", [[]], [0] * 10000, "x" * 5000, "a\nb\x1b[2J", {"a": {"b": [1]}}, [None], [[0, 1], [2]]),
    "9" * 40,
)  # fmt: skip
NUMBERS = (
    0,
    1,
    2,
    0x7F,
    0x80,
    0xFF,
    0x7FFF,
    0xFFFF,
    2**31 - 1,
    2**31,
    2**32 - 1,
    2**62,
    2**63 - 1,
    2**64 - 1,
)
NAMES = (
    "a\nb",
    "\x1b[2Jx",
    "-rf",
    "x" * 200,
    "index.html",
    ".hidden",
    "ä ö",
    "a,b",
    "=1+1",
    "con",
    "x.png",
    "'\"",
)
TEXT_BYTES = 1 << 20
DEEP = 100_000
MANY = 2000


def of_bytes(draw: Random, content: bytes) -> tuple[bytes, str]:
    """Some bytes changed, lost, repeated or added; headers and ends more often than the rest."""
    data = bytearray(content)
    kind = draw.choice(
        ("flip", "number", "number", "number", "cut", "lose", "repeat", "insert", "fill", "large")
    )
    if not data:
        return b"\0" * draw.randint(1, 9), "bytes added"
    at = draw.choice(
        (draw.randrange(min(len(data), 64)), draw.randrange(len(data)), draw.randrange(len(data)))
    )
    if draw.random() < 0.15:
        at = len(data) - 1 - draw.randrange(min(len(data), 64))
    length = draw.choice((1, 2, 4, 8, 16, 100, 1000))
    if kind == "flip":
        for _ in range(draw.randint(1, 8)):
            data[(at + draw.randint(0, 16)) % len(data)] ^= 1 << draw.randrange(8)
    elif kind == "number":
        size, order = draw.choice((1, 2, 4, 8)), draw.choice(("little", "big"))
        value = draw.choice(NUMBERS) if draw.random() < 0.8 else draw.getrandbits(64)
        data[at : at + size] = (value % (1 << 8 * size)).to_bytes(size, order)
    elif kind == "cut":
        del data[at:]
    elif kind == "lose":
        del data[at : at + length]
    elif kind == "repeat":
        data[at:at] = data[at : at + length] * draw.choice((1, 2, 50))
    elif kind == "insert":
        data[at:at] = draw.randbytes(length)
    elif kind == "fill":
        data[at : at + length] = bytes([draw.choice((0, 255, 32, 10))]) * length
    else:
        size = draw.choice((4, 8))
        data[at : at + size] = struct.pack("<d", draw.choice((float("nan"), float("inf"), 1e308, -1.0)))[
            -size:
        ]
    return bytes(data), f"{kind} at byte {at}"


def of_text(draw: Random, content: bytes) -> tuple[bytes, str]:
    """Words replaced, lines lost, repeated, joined or added, or the text ends otherwise."""
    text = content.decode(errors="surrogateescape")
    kind = draw.choice(
        ("word", "word", "word", "word", "line", "twice", "many", "join", "insert", "deep", "ends", "aliases")
    )
    said = kind
    if kind in ("word", "insert"):
        words = list(re.finditer(r"[^\s,:{}\[\]\"']+", text))
        word = draw.choice(WORDS)
        found = draw.choice(words) if words else None
        start, end = (found.start(), found.end()) if found else (0, 0)
        text = text[:start] + word + text[start if kind == "insert" else end :]
        said = f"{kind} {word[:20]!r} at {start}"
    elif kind in ("line", "twice", "many", "join"):
        lines = text.splitlines(keepends=True) or ["\n"]
        at = draw.randrange(len(lines))
        count = {"line": 0, "twice": 2, "many": 20_000, "join": 1}[kind]
        lines[at : at + 1] = [lines[at].rstrip("\n") if kind == "join" else lines[at]] * count
        text, said = "".join(lines), f"{kind} line {at + 1}"
    elif kind == "deep":
        text = draw.choice(("[", "{", '{"a":', "- ", "(", "!", "&a ")) * draw.choice((100, DEEP)) + text
    elif kind == "ends":
        text = draw.choice(
            (text.replace("\n", "\r"), text + "\0", "\ufeff" + text, text.replace(" ", "\t"), text * 3)
        )
    else:
        laughs = "".join(f"a{i + 1}: &a{i + 1} [{','.join([f'*a{i}'] * 10)}]\n" for i in range(12))
        text = f"a0: &a0 [x, x]\n{laughs}{text}"
    return text.encode(errors="surrogateescape"), said


def of_json(draw: Random, content: bytes) -> tuple[bytes, str]:
    """A value replaced, taken out, added or repeated anywhere in a tree."""
    tree = json.loads(content)
    holders = list(_holders(tree))
    if not holders:
        return json.dumps(draw.choice(VALUES)).encode(), "another value"
    holder = draw.choice(holders)
    key = draw.choice(list(holder) if isinstance(holder, dict) else range(len(holder)))
    kind = draw.choice(("value", "value", "value", "swap", "lose", "add", "repeat", "nan"))
    if kind == "value":
        value = draw.choice((draw.choice(VALUES), draw.choice(WORDS)))
        holder[key] = (
            [value] * len(holder[key]) if isinstance(holder[key], list) and draw.random() < 0.5 else value
        )
    elif kind == "swap":
        holder[key] = draw.choice(holders)
    elif kind == "lose":
        del holder[key]
    elif kind == "add" and isinstance(holder, dict):
        holder[draw.choice(WORDS)] = draw.choice(VALUES)
    elif kind == "repeat" and isinstance(holder[key], list):
        holder[key] = holder[key] * draw.choice((0, 2, 1000))
    else:
        holder[key] = draw.choice((float("nan"), float("inf"), -float("inf")))
    try:
        return json.dumps(tree, ensure_ascii=draw.random() < 0.5).encode(
            errors="replace"
        ), f"{kind} of {str(key)[:20]!r}"
    except (ValueError, RecursionError):  # it holds itself
        return b"[" * DEEP, "a tree without end"


def _holders(tree: Any) -> Any:
    if isinstance(tree, dict | list) and tree:
        yield tree
        for value in tree.values() if isinstance(tree, dict) else tree[:50]:
            yield from _holders(value)


def of_csv(draw: Random, content: bytes) -> tuple[bytes, str]:
    """A cell replaced, a column or a row lost, repeated or exchanged."""
    rows = list(csv.reader(io.StringIO(content.decode())))
    row = draw.randrange(len(rows))
    column = draw.randrange(len(rows[row]) or 1)
    kind = draw.choice(("cell", "cell", "cell", "column", "row", "long", "copy"))
    if kind == "cell" and rows[row]:
        rows[row][column] = draw.choice(WORDS)
    elif kind == "column":
        rows = [cells[:column] + cells[column + 1 :] for cells in rows]
    elif kind == "row":
        rows[row : row + 1] = [rows[row]] * draw.choice((0, 2, 3000))
    elif kind == "long":
        rows[row] = [*rows[row], "x" * 200_000]
    else:
        rows[row] = list(draw.choice(rows))
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode(errors="replace"), f"{kind} {row},{column}"


def of_content(draw: Random, name: str, content: bytes, depth: int = 0) -> tuple[bytes, str]:
    """A file's content damaged in a way of its kind, or as plain bytes."""
    if draw.random() < 0.2:
        return of_bytes(draw, content)
    suffix = name.rpartition(".")[2].lower()
    ways: dict[str, Callable[[Random, bytes], tuple[bytes, str]]] = {
        "json": of_json,
        "csv": of_csv,
        "cff": of_text,
    }
    try:
        if suffix in OPENERS and depth < 2 and draw.random() < 0.8:
            return OPENERS[suffix](
                draw, content, lambda inner, data: of_content(draw, inner, data, depth + 1)
            )
        if suffix in ways and draw.random() < 0.7:
            return ways[suffix](draw, content)
    except Exception:  # of any library that opens it: it is damaged already
        return of_bytes(draw, content)
    sample = content[:4096]
    if len(content) < TEXT_BYTES and b"\0" not in sample and not _binary(sample):
        return of_text(draw, content)
    return of_bytes(draw, content)


def _binary(sample: bytes) -> bool:
    return sum(byte >= 0x80 or byte < 9 for byte in sample) > len(sample) / 5


def put(path: Path, content: bytes) -> None:
    """Write a file anew: the one that was there may be the corpus's."""
    path.unlink()
    path.write_bytes(content)


def of_place(draw: Random, path: Path, root: Path) -> str:
    """Something else in a file's place, or beside it."""
    kind = draw.choice(tuple(PLACES))
    try:
        PLACES[kind](draw, path, root)
    except OSError as error:
        return f"{kind}, not done: {error.strerror}"
    return kind


def _without(path: Path) -> Path:
    path.unlink()
    return path


def _renamed(draw: Random, path: Path, root: Path) -> None:
    del root
    path.rename(path.with_name(draw.choice(NAMES) + draw.choice(("", path.suffix))))


def _doubled(draw: Random, path: Path, root: Path) -> None:
    del root
    shutil.copy(path, path.with_name(draw.choice((*NAMES, f"0{path.name}", path.name.upper()))))


def _socket(draw: Random, path: Path, root: Path) -> None:
    del draw, root
    path.unlink()
    with tempfile.TemporaryDirectory() as short:  # the names of sockets are short
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(f"{short}/s")
        Path(short, "s").rename(path)


def _oversized(draw: Random, path: Path, root: Path) -> None:
    del root
    content = path.read_bytes()
    put(path, content)
    os.truncate(path, draw.choice((300 << 20, 3 << 30, 1 << 40)))


def _outside(draw: Random, path: Path, root: Path) -> None:
    elsewhere = root.parent / f"elsewhere{path.suffix}"
    path.rename(elsewhere)
    path.symlink_to(draw.choice((str(elsewhere), os.path.relpath(elsewhere, path.parent))))


def _many(draw: Random, path: Path, root: Path) -> None:
    del root
    for number in range(MANY):
        other = path.with_name(f"{number:06d}{draw.choice((path.suffix, '.x'))}")
        if not other.exists():
            os.link(path, other)


def _deep(draw: Random, path: Path, root: Path) -> None:
    del draw, root
    folder = path.parent
    for _ in range(100):
        folder = folder / "d"
    folder.mkdir(parents=True)
    (folder / path.name).write_bytes(b"x")


PLACES: dict[str, Callable[[Random, Path, Path], object]] = {
    "no file": lambda draw, path, root: path.unlink(),
    "an empty file": lambda draw, path, root: put(path, b""),
    "a pipe": lambda draw, path, root: os.mkfifo(_without(path)),
    "a pipe beside it": lambda draw, path, root: os.mkfifo(path.with_name(f"x{path.suffix}")),
    "a socket": _socket,
    "a folder": lambda draw, path, root: _without(path).mkdir(),
    "a link to a device": lambda draw, path, root: _without(path).symlink_to(
        draw.choice(("/dev/zero", "/dev/tty"))
    ),
    "a link to a device beside it": lambda draw, path, root: path.with_name(f"x{path.suffix}").symlink_to(
        "/dev/zero"
    ),
    "a link to itself": lambda draw, path, root: _without(path).symlink_to(path.name),
    "a link to everything": lambda draw, path, root: path.with_name("x").symlink_to(
        draw.choice(("/", "..", "/proc"))
    ),
    "a link to nothing": lambda draw, path, root: _without(path).symlink_to("nowhere"),
    "a link out": _outside,
    "a huge file": _oversized,
    "another name": _renamed,
    "a second one": _doubled,
    "many more": _many,
    "a deep folder": _deep,
}


def of_folder(draw: Random, root: Path, by_place: float = 0.2) -> list[str]:
    """One to three damages of a folder's files; each kind of file is as likely as another.

    Args:
        draw: of random numbers.
        root: the folder, or a file.
        by_place: the share of damages that put something else in a file's place.

    Returns:
        What was done, in words.
    """
    story = []
    for _ in range(draw.choice((1, 1, 1, 2, 3))):
        path = any_file(draw, root)
        if path is None:
            break
        name = path.relative_to(root.parent).as_posix()
        if draw.random() < by_place:
            story.append(f"{name}: {of_place(draw, path, root)}")
        else:
            content, said = of_content(draw, path.name, path.read_bytes())
            put(path, content)
            story.append(f"{name}: {said}")
    return story


def any_file(draw: Random, root: Path) -> Path | None:
    """A file below a folder: first one of its kinds is drawn, then one of these."""
    if root.is_file():
        return root
    kinds: dict[tuple[str, str], list[Path]] = {}
    for path in sorted(root.rglob("*")):
        if path.is_file() and not path.is_symlink() and path.stat().st_size < TEXT_BYTES * 64:
            kinds.setdefault((path.parent.name, path.suffix or path.name), []).append(path)
    return draw.choice(kinds[draw.choice(sorted(kinds))]) if kinds else None
