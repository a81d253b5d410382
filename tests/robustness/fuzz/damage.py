"""Ways to damage what a file holds, drawn at random: bytes, words, values, and what is packed in it."""

import csv
import io
import json
import re
import struct
from collections.abc import Callable
from random import Random
from typing import Any, Literal

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
NUMBERS = tuple(n - d for n in (1, 2**7, 2**8, 2**15, 2**16, 2**31, 2**32, 2**63, 2**64) for d in (0, 1))
TEXT_BYTES = 1 << 20
DEEP = 100_000


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
        orders: tuple[Literal["little", "big"], ...] = ("little", "big")
        size, order = draw.choice((1, 2, 4, 8)), draw.choice(orders)
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


def of_obj(draw: Random, content: bytes) -> tuple[bytes, str]:
    """More groups, materials, corners of a face, faces or vertices than an object has."""
    count = draw.choice((3, 1000, 50_000))
    kind = draw.choice(("usemtl", "group", "polygon", "lines", "faces", "far", "numbers"))
    more = {
        "usemtl": lambda: "".join(f"usemtl m{n}\nf 1 2 4\n" for n in range(count)),
        "group": lambda: "".join(f"{draw.choice('osg')} g{n}\nf 1 2 3\n" for n in range(count)),
        "polygon": lambda: "f " + " ".join(str(1 + n % 8) for n in range(10 * count)) + "\n",
        "lines": lambda: "".join(f"{draw.choice(('vn', 'vt', 'l', 'p', 'x'))} 1 2 3\n" for _ in range(count)),
        "faces": lambda: "f 1 2 3\n" * count,
        "far": lambda: f"f 1 2 {draw.choice((-1, 0, 9, 10**9, 10**30))}\n",
        "numbers": lambda: f"v {draw.choice(WORDS[:12])} 1e30 -1e30\nf 1 2 9\n",
    }[kind]()
    return content + more.encode(errors="replace"), f"obj {kind} {count}"


def of_ply(draw: Random, content: bytes) -> tuple[bytes, str]:
    """A header that claims other counts, types, elements or forms, or random corners and faces as text."""
    kind = draw.choice(("count", "type", "form", "element", "list", "random", "random"))
    head, end, data = content.partition(b"end_header\n")
    lines = head.decode("latin1").split("\n")
    if kind == "random" or not end:
        return _random_ply(draw).encode(), "ply of random faces"
    at = draw.randrange(1, len(lines))
    words = lines[at].split(" ")
    if kind == "count":
        elements = [number for number, line in enumerate(lines) if line.startswith("element")]
        at = draw.choice(elements)
        words = [*lines[at].split(" ")[:2], str(draw.choice((-1, 0, 1, 3, 10**6, 2**31, 10**11)))]
    elif kind == "type":
        words[1:2] = [draw.choice(("char", "ushort", "int", "float", "double", "int64", "x"))]
    elif kind == "form":
        at = 1
        words = ["format", draw.choice(("ascii", "binary_big_endian", "x")), "1.0"]
    lines[at] = " ".join(words)
    if kind == "element":
        lines.insert(at, f"element {draw.choice(('a', 'vertex', 'face'))} {draw.choice((0, 2, 10**12))}")
    elif kind == "list":
        lines.insert(at, f"property list {draw.choice(('uchar', 'int', 'double'))} int vertex_indices")
    return "\n".join(lines).encode("latin1") + end + data, f"ply {kind} in line {at + 1}"


def _random_ply(draw: Random) -> str:
    """A text of few vertices, anywhere, and polygons of any corners."""
    numbers = ("0", "0.1", "0.5", "1", "-3", "1e9", "1e300", "nan", "inf", "x")
    count, faces = draw.randint(0, 8), draw.randint(0, 12)
    rows = [" ".join(draw.choices(numbers, k=3)) for _ in range(count)]
    for _ in range(faces):
        corners = [draw.randint(-2, count + 1) for _ in range(draw.randint(0, 5))]
        rows.append(" ".join(map(str, [len(corners), *corners])))
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    of_faces = f"element face {faces}\nproperty list uchar int vertex_indices\n"
    return f"ply\nformat ascii 1.0\nelement vertex {count}\n{axes}{of_faces}end_header\n" + "\n".join(rows)


Way = Callable[[Random, bytes], tuple[bytes, str]]
# By how a name ends; other texts are damaged as such.
WAYS: dict[str, Way] = {"json": of_json, "csv": of_csv, "cff": of_text, "obj": of_obj, "ply": of_ply}


def of_content(draw: Random, name: str, content: bytes, depth: int = 0) -> tuple[bytes, str]:
    """A file's content damaged in a way of its kind, or as plain bytes."""
    if draw.random() < 0.2:
        return of_bytes(draw, content)
    suffix = name.rpartition(".")[2].lower()
    try:
        if suffix in OPENERS and depth < 2 and draw.random() < 0.8:
            return OPENERS[suffix](
                draw, content, lambda inner, data: of_content(draw, inner, data, depth + 1)
            )
        if suffix in WAYS and draw.random() < 0.7:
            return WAYS[suffix](draw, content)
    except Exception:  # of any library that opens it: it is damaged already
        return of_bytes(draw, content)
    sample = content[:4096]
    if len(content) < TEXT_BYTES and b"\0" not in sample and not _binary(sample):
        return of_text(draw, content)
    return of_bytes(draw, content)


def _binary(sample: bytes) -> bool:
    return sum(byte >= 0x80 or byte < 9 for byte in sample) > len(sample) / 5
