"""Files that hold others, or claim what they hold: zip and npz, npy, PNG, SQLite, gzip and zstd."""

import io
import re
import sqlite3
import struct
import tempfile
import warnings
import zipfile
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from random import Random

# Damages the content of a member by its name.
Inner = Callable[[str, bytes], tuple[bytes, str]]
Opener = Callable[[Random, bytes, Inner], tuple[bytes, str]]

SIZES = (0, 1, 2, 3, 8, 64, 512, 4096, 10**5, 2**31 - 1, 2**31, 2**32 - 1, 10**12)
DTYPES = (
    "<f2",
    ">f4",
    "<f8",
    "|b1",
    "|u1",
    "<i4",
    "<c8",
    "|O",
    "|S8",
    "<M8[s]",
    "f2,f2",
    "",
    "|V99999999",
    "<U9",
)
MEMBERS = ("../../x.npy", "/etc/x", "a.txt", "a/b.npy", "\x1b[2J", "x" * 300, "arr_0.npy", "a\nb.npy")
SQL_VALUES = (
    *("NULL", "-1", "9223372036854775807", "''", "'a\x1b[2J\nb'", "zeroblob(1000)", "1e308", "x'00'"),
    *("zeroblob(700000000)", "replace(hex(zeroblob(5000)),'00','x')"),
)
PAX = (
    *(
        ("size", "9" * 19),
        ("size", "-51200"),
        ("size", "x"),
        ("path", "../x"),
        ("path", "a\0b"),
        ("mtime", "nan"),
    ),
    *(("GNU.sparse.map", "1,2"), ("GNU.sparse.realsize", "9" * 15), ("hdrcharset", "x")),
)
BOMB_MB = 1200


@cache
def zeros(megabytes: int = BOMB_MB) -> bytes:
    """Raw deflate of so many MB of zeros: a piece that ends at a byte, many times."""
    piece = zlib.compressobj(9, zlib.DEFLATED, -15)
    one = piece.compress(bytes(1 << 20)) + piece.flush(zlib.Z_FULL_FLUSH)
    return one * megabytes + piece.flush(zlib.Z_FINISH)


def of_zip(draw: Random, content: bytes, inner: Inner) -> tuple[bytes, str]:
    """A member lost, doubled, renamed, added, damaged, or one that swells or claims too much."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    at = draw.randrange(len(members)) if members else 0
    kind = draw.choice(
        ("inner", "inner", "inner", "lose", "twice", "name", "add", "many", "claim", "bomb", "flags")
    )
    said, packing = kind, zipfile.ZIP_DEFLATED
    if kind == "inner" and members:
        changed, how = inner(members[at][0], members[at][1])
        members[at], said = (members[at][0], changed), f"{members[at][0]}: {how}"
    elif kind == "lose":
        del members[at : at + 1]
    elif kind == "twice":
        members += members[at : at + 1]
    elif kind == "name" and members:
        members[at] = (draw.choice(MEMBERS), members[at][1])
    elif kind == "add":
        members.append((draw.choice(MEMBERS), draw.randbytes(20)))
    elif kind == "many":
        members += [(f"m{number}.npy", b"") for number in range(3000)]
    elif kind == "flags":
        packing = draw.choice((zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2, zipfile.ZIP_STORED))
    packed = _zip(members, packing, draw, at if kind in ("claim", "bomb") else None, kind)
    return (_flagged(draw, packed), said) if kind == "flags" else (packed, said)


def _zip(members: list[tuple[str, bytes]], packing: int, draw: Random, at: int | None, kind: str) -> bytes:
    """An archive; the member `at` claims another size, or swells."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", packing) as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a name may be there twice
        for number, (name, data) in enumerate(members):
            info = zipfile.ZipInfo(name.replace("\0", "?"))
            info.compress_type = packing
            if number == at and kind == "bomb":
                add_bomb(archive, buffer, info, data[:128] if data[:6] == b"\x93NUMPY" else b"")
                continue
            archive.writestr(info, data)
            if number == at:
                info.file_size = draw.choice((0, 1, 10**9, 2**31, 2**32 - 2, 10**12))
    return buffer.getvalue()


def add_bomb(archive: zipfile.ZipFile, buffer: io.BytesIO, info: zipfile.ZipInfo, head: bytes) -> None:
    """A member of a head and zeros; its checksum is not right, which is known only once all is read."""
    first = zlib.compressobj(9, zlib.DEFLATED, -15)
    data = first.compress(head) + first.flush(zlib.Z_FULL_FLUSH) + zeros()
    info.compress_type, info.compress_size = zipfile.ZIP_DEFLATED, len(data)
    info.file_size, info.header_offset, info.CRC = len(head) + (BOMB_MB << 20), buffer.tell(), 1
    buffer.write(info.FileHeader(zip64=False) + data)
    archive.filelist.append(info)
    archive.NameToInfo[info.filename] = info
    archive.start_dir = buffer.tell()
    archive._didModify = True  # type: ignore[attr-defined]  # of the standard library, not public


def _flagged(draw: Random, content: bytes) -> bytes:
    """Encrypted, of an unknown packing, or of another version, as the central directory says."""
    data = bytearray(content)
    at = data.rfind(b"PK\x01\x02")
    if at >= 0:
        place, value = draw.choice(((8, 1), (10, 99), (10, 12), (6, 255), (42, 2**31), (38, 0o120777 << 16)))
        size = 4 if place in (38, 42) else 2
        data[at + place : at + place + size] = value.to_bytes(size, "little")
    return bytes(data)


def of_npy(draw: Random, content: bytes, inner: Inner) -> tuple[bytes, str]:
    """A header that claims anything."""
    del inner
    length = struct.unpack("<H", content[8:10])[0]
    header = content[10 : 10 + length].decode("latin1")
    kind = draw.choice(("shape", "shape", "shape", "dtype", "order", "length", "deep", "text", "values"))
    if kind == "shape":
        shape = draw.choice(
            ([draw.choice(SIZES)] * 3, [draw.choice(SIZES) for _ in range(draw.randint(0, 40))], [-1] * 3)
        )
        header = re.sub(r"\([^)]*\)", str(tuple(shape)), header)
    elif kind == "dtype":
        header = re.sub(r"'descr': '[^']*'", f"'descr': {draw.choice(DTYPES)!r}", header)
    elif kind == "order":
        header = header.replace("False", draw.choice(("True", "None", "1", "'x'")))
    elif kind == "deep":
        header = draw.choice(("(", "[", "-", "{1:")) * 5000
    elif kind == "text":
        header = draw.choice(
            ("", "x", "{'descr': __import__('os')}", "{**{}}", header[:20], "\0" * 20, header * 3)
        )
    data = content[10 + length :]
    if kind == "values" and len(data) > 8:
        at = draw.randrange(len(data) - 8)
        data = data[:at] + draw.choice((b"\xff\x7f" * 4, b"\xff" * 8, b"\x00\x7c" * 4)) + data[at + 8 :]
    text = header.encode("latin1", "replace")
    claimed = draw.choice((0, 1, 65535)) if kind == "length" else min(len(text), 65535)
    return content[:8] + struct.pack("<H", claimed) + text + data, f"npy {kind}"


def of_png(draw: Random, content: bytes, inner: Inner) -> tuple[bytes, str]:
    """Another size, depth of bits or colour in a header whose checksum is right; data that swells or ends."""
    del inner
    chunks, at = [], 8
    while at < len(content):
        size = struct.unpack(">I", content[at : at + 4])[0]
        chunks.append((content[at + 4 : at + 8], bytearray(content[at + 8 : at + 8 + size])))
        at += 12 + size
    kind = draw.choice(("size", "size", "bits", "color", "interlace", "swell", "text", "lose", "short"))
    head = chunks[0][1]
    if kind == "size":
        width, height = draw.choice(SIZES) % 2**32, draw.choice(SIZES) % 2**32
        head[:8] = struct.pack(">II", draw.choice((width, 64)), draw.choice((height, 48)))
    elif kind in ("bits", "color", "interlace"):
        head[{"bits": 8, "color": 9, "interlace": 12}[kind]] = draw.choice((0, 1, 2, 3, 4, 6, 8, 16, 255))
    elif kind == "swell":
        head[:10] = struct.pack(">IIBB", draw.choice((8192, 20000, 30000)), 30000, 8, 2)
        chunks[1:-1] = [(b"IDAT", bytearray(b"\x78\xda" + zeros()[: 1 << 20]))]
    elif kind == "text":
        chunks.insert(1, (b"zTXt", bytearray(b"a\0\0\x78\xda" + zeros())))
    elif kind == "lose":
        del chunks[draw.randrange(len(chunks))]
    else:
        chunks[-2] = (chunks[-2][0], chunks[-2][1][: len(chunks[-2][1]) // 2])
    made = [
        struct.pack(">I", len(data)) + n + data + struct.pack(">I", zlib.crc32(n + data))
        for n, data in chunks
    ]
    return content[:8] + b"".join(made), f"png {kind}"


def of_sqlite(draw: Random, content: bytes, inner: Inner) -> tuple[bytes, str]:
    """Values, rows, columns and tables changed by SQL; views that never end in a table's place."""
    endless = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x+1 FROM c) SELECT"
    value, blob = draw.choice(SQL_VALUES), "randomblob(900000000)"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.db3"
        path.write_bytes(content)
        database = sqlite3.connect(path)
        names = [row[0] for row in database.execute("SELECT name FROM sqlite_master WHERE type='table'")]
        table = draw.choice(names)
        columns = [row[1] for row in database.execute(f"PRAGMA table_info('{table}')")]
        column = draw.choice(columns)
        row = database.execute(f"SELECT {column} FROM {table} LIMIT 1").fetchone()
        changed = row[0] if row else None
        if isinstance(changed, bytes):
            changed, _ = inner("x.bin", changed)
        orders = {
            "value": f"UPDATE {table} SET {column} = {value}",
            "one value": f"UPDATE {table} SET {column} = {value} WHERE rowid = 1",
            "inner": f"UPDATE {table} SET {column} = ? WHERE rowid = 1",
            "rows": f"DELETE FROM {table} WHERE rowid > {draw.randint(0, 3)}",
            "doubled": f"CREATE TABLE t AS SELECT * FROM {table} UNION ALL SELECT * FROM {table}",
            "column": f"ALTER TABLE {table} RENAME COLUMN {column} TO z",
            "no table": f"DROP TABLE {table}",
            "a view": f"CREATE VIEW {table} AS {endless} {', '.join(f'x AS {c}' for c in columns)} FROM c",
            "a blob": f"CREATE VIEW {table} AS SELECT {', '.join(f'{blob} AS {c}' for c in columns)}",
            "a program": f"CREATE TRIGGER a AFTER UPDATE ON {table} BEGIN SELECT randomblob(9); END",
            "many rows": f"INSERT INTO {table}({column}) {endless} x FROM c LIMIT 200000",
        }
        kind = draw.choice(tuple(orders))
        try:
            if kind in ("a view", "a blob"):
                database.execute(f"DROP TABLE {table}")
            database.execute(orders[kind], (changed,) if kind == "inner" else ())
            database.commit()
        except sqlite3.Error:
            kind += ", refused"
        database.close()
        return path.read_bytes(), f"sqlite {kind} of {table}.{column}"


def of_gzip(draw: Random, content: bytes, inner: Inner) -> tuple[bytes, str]:
    """What is packed is damaged and packed again, or swells."""
    import gzip

    if draw.random() < 0.2:
        first = b"\x1f\x8b\x08\0\0\0\0\0\x02\xff"
        return first + zeros() + bytes(8), "gzip of zeros"
    changed, said = inner("x.tar", gzip.decompress(content))
    return gzip.compress(changed, 1, mtime=0), f"gzip: {said}"


def of_tar(draw: Random, content: bytes, inner: Inner) -> tuple[bytes, str]:
    """An entry of another name, size, kind or content, its checksum right; pax headers that lie."""
    blocks = [at for at in range(0, len(content) - 511, 512) if content[at + 257 : at + 262] == b"ustar"]
    at = draw.choice(blocks)
    head = bytearray(content[at : at + 512])
    size = int(bytes(head[124:135]).strip(b"\0 ") or b"0", 8)
    kind = draw.choice(("name", "size", "kind", "content", "pax", "pax", "link"))
    rest = content[at + 512 :]
    if kind == "name":
        name = draw.choice(
            ("../evil", "/evil", "a\x1b[2J", "", "x" * 99, "a/../../b", "furniture/.")
        ).encode()
        head[:100] = name.ljust(100, b"\0")
    elif kind == "size":
        head[124:136] = draw.choice(
            (b"77777777777\0", b"-0000000001\0", b"\x80" + b"\xff" * 11, b"00000000001\0", b"x" * 12)
        )
    elif kind in ("kind", "link"):
        head[156] = draw.choice(b"12345670KLxgSV\0")
        head[157:257] = draw.choice((b"/etc/passwd", b"../..", b"")).ljust(100, b"\0")
    elif kind == "content" and size:
        changed, said = inner("x", rest[:size])
        rest = (changed + bytes(size))[:size] + rest[size:]
        kind = f"content: {said}"
    elif kind == "pax":
        pairs = draw.choice(PAX)
        rest = bytes(head) + rest
        head, line = bytearray(head), _pax(*pairs)
        head[124:136], head[156] = b"%011o\0" % len(line), ord("x")
        rest = line.ljust(-(-len(line) // 512) * 512, b"\0") + rest
        kind = f"pax {pairs[0]}={pairs[1][:12]!r}"
    head[148:156] = b" " * 8
    head[148:156] = b"%06o\0 " % sum(head)
    return content[:at] + bytes(head) + rest, f"tar {kind}"


def _pax(key: str, value: str) -> bytes:
    body = f" {key}={value}\n".encode()
    length = len(body) + len(str(len(body) + len(str(len(body)))))
    return str(length).encode() + body


def of_zstd(draw: Random, content: bytes, inner: Inner) -> tuple[bytes, str]:
    """What is packed is damaged and packed again, or swells."""
    import zstandard

    if draw.random() < 0.2:
        block = zstandard.compress(bytes(64 << 20))
        return block * 20, "zstd of zeros"
    changed, said = inner("x.db3", zstandard.decompress(content, max_output_size=1 << 28))
    return zstandard.compress(changed), f"zstd: {said}"


OPENERS: dict[str, Opener] = {
    **dict.fromkeys(("zip", "npz", "r3d"), of_zip),
    **{"npy": of_npy, "png": of_png, "db3": of_sqlite, "gz": of_gzip, "tar": of_tar, "zstd": of_zstd},
}
