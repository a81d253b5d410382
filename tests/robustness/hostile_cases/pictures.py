"""Pictures and packed depth: of gigabytes by their heads, in many scans, with parts that swell."""

import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

from fuzz.releases import seal

from hostile_cases.case import Case, in_turn, on

READ = "inspect r\ningest --jobs 1"
SIGNATURE = b"\x89PNG\r\n\x1a\n"
ADVICE = (0, 1, 3)
OF_RELEASE = """export exported --layout bop --benchmark release
verify release
export exported --layout webdataset --benchmark release
report --benchmark release --out page.html"""


def cases() -> Iterator[Case]:
    for name, data in PICTURES.items():
        yield from on(READ, _first("tum", f"colour: {name}", "recording/rgb/*", data))
        yield from on("ingest --jobs 1", _first("tum", f"depth: {name}", "recording/depth/*", data))
        yield from on("ingest --jobs 1", _first("tum", f"a mask: {name}", "recording/masks/*", data))
    depth = "views/chair_01/000.depth.png"
    released = [_released(f"depth of a release: {name}", depth, data) for name, data in PICTURES.items()]
    yield from in_turn(OF_RELEASE, *released)
    yield from on(
        READ,
        _first("redwood", "colour: 30,000 a side", "recording/*/*.jpg", PICTURES["a PNG of 30,000 a side"]),
    )
    yield from on(
        READ,
        _first(
            "polycam",
            "depth: 30,000 a side",
            "recording/keyframes/depth/*",
            PICTURES["a PNG of 30,000 a side"],
        ),
    )
    yield from on(
        READ,
        _first(
            "stray", "confidence: 30,000 a side", "recording/confidence/*", PICTURES["a PNG of 30,000 a side"]
        ),
    )
    for whole, name in (
        ("redwood_zip", "depth/"),
        ("redwood_zip", "rgb/"),
        ("record3d", ".depth"),
        ("record3d", ".jpg"),
    ):
        yield from on(
            READ,
            Case("M2", f"{whole}: a member {name} that swells", "", _swelling_member(name), whole, ADVICE),
        )
    yield from on(
        READ, Case("M6", "redwood_zip: 1,000,000 members", "", _many_members, "redwood_zip", ADVICE)
    )
    yield from on(READ, Case("M2", "sens: packed depth that swells", "", _swelling_zlib, "sens", ADVICE))
    yield from on(READ, Case("M2", "klg: packed depth that swells", "", _swelling_zlib, "klg", ADVICE))
    for whole in ("sens", "klg", "azure_kinect", "bag", "ros2_mcap", "realsense"):
        yield from on(
            READ, Case("M6", f"{whole}: 300 MB of zeros behind it", "", _zeros_behind, whole, ADVICE)
        )
        yield from on(READ, Case("M6", f"{whole}: numbers of 2^32", "", _large_numbers, whole, ADVICE))
    for name, video in VIDEOS.items():
        yield from on(READ, _video(f"rgb.mp4: {name}", video))
    for name, said in CAMERAS.items():
        yield from on("inspect r\nbuild --jobs 1", _camera(name, said))
    yield from on(READ, Case("L", "JPEGs with bits flipped", "", _flipped, "tum", ADVICE))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _png(
    width: int, height: int, before: bytes = b"", depth: int = 8, color: int = 2, laced: int = 0
) -> bytes:
    """All of it is there: rows of zeros, packed."""
    head = struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, laced)
    row_bytes = 1 + width * depth * (3 if color == 2 else 1) // 8
    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(bytes(row_bytes)) for _ in range(height)) + packer.flush()
    return SIGNATURE + _chunk(b"IHDR", head) + before + _chunk(b"IDAT", rows) + _chunk(b"IEND", b"")


def _jpeg(width: int, height: int, frame: int = 0xC0, scans: int = 1) -> bytes:
    size = height.to_bytes(2, "big") + width.to_bytes(2, "big")
    sof = b"\xff" + bytes([frame]) + b"\0\x11\x08" + size + b"\x03\1\x11\0\2\x11\0\3\x11\0"
    return b"\xff\xd8" + sof + b"\xff\xda\0\x0c\x03\1\0\2\0\3\0\0\x3f\0" * scans + b"\xff\xd9"


def _deflated(megabytes: int) -> bytes:
    packer = zlib.compressobj(9)
    return b"".join(packer.compress(bytes(1 << 20)) for _ in range(megabytes)) + packer.flush()


PICTURES: dict[str, Callable[[], bytes]] = {
    "a PNG of 30,000 a side": lambda: _png(30_000, 30_000),
    "a PNG of 16 bits, 20,000 a side": lambda: _png(20_000, 20_000, depth=16, color=0),
    "a PNG of 8,192 a side in seven passes": lambda: _png(8192, 8192, depth=16, color=0, laced=1),
    "a PNG of 2^31 a side": lambda: (
        SIGNATURE + _chunk(b"IHDR", struct.pack(">IIBBBBB", 2**31 - 1, 2**31 - 1, 8, 2, 0, 0, 0))
    ),
    "a PNG with a profile of 1 GB": lambda: _png(64, 48, _chunk(b"iCCP", b"a\0\0" + _deflated(1000))),
    "a PNG with a text of 1 GB": lambda: _png(64, 48, _chunk(b"zTXt", b"a\0\0" + _deflated(1000))),
    "a PNG of a million chunks": lambda: _png(64, 48, _chunk(b"tESt", b"") * 1_000_000),
    "a JPEG of 60,000 a side": lambda: _jpeg(60_000, 60_000),
    "a JPEG of 5,000 scans": lambda: _jpeg(8192, 8192, 0xC2, 5000),
    "another kind of picture": lambda: b"II*\0" + struct.pack("<I", 8) + bytes(99),
    "an OpenEXR": lambda: b"\x76\x2f\x31\x01" + bytes(99),
    "a PNM of 10^9 a side": lambda: b"P6\n1000000000 1000000000\n255\n",
}


def _first(whole: str, name: str, pattern: str, data: Callable[[], bytes]) -> Case:
    """A picture of a recording in the place of its first, whatever its suffix."""

    def make(folder: Path) -> None:
        path = min(folder.glob(pattern))
        path.write_bytes(data())

    return Case("M2", name, "", make, whole, ADVICE)


def _released(name: str, file: str, data: Callable[[], bytes]) -> Case:
    def make(folder: Path) -> None:
        (folder / "release" / file).write_bytes(data())
        seal(folder / "release")

    return Case("M2", name, "", make, "release", (0, 1), errors=4)


def _members(path: Path) -> list[tuple[str, bytes]]:
    with zipfile.ZipFile(path) as archive:
        return [(info.filename, archive.read(info)) for info in archive.infolist()]


def _swelling_member(part: str) -> Callable[[Path], None]:
    """All members whose name has a part become 1 GB of zeros."""

    def make(folder: Path) -> None:
        path = next(folder.glob("recording*"))
        members = _members(path)
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in members:
                if part not in name:
                    archive.writestr(name, data)
                    continue
                with archive.open(name, "w") as member:
                    member.write(data[:64])
                    for _ in range(64):
                        member.write(bytes(16 << 20))

    return make


def _many_members(folder: Path) -> None:
    path = next(folder.glob("recording*"))
    with zipfile.ZipFile(path, "a") as archive:
        for number in range(200_000):
            archive.writestr(f"depth/{number:07d}-{number:012d}.png", b"")


def _swelling_zlib(folder: Path) -> None:
    """Each stream of zlib in a file that is as long as another's head says becomes one of 1 GB."""
    path = next(folder.glob("recording*"))
    content = path.read_bytes()
    bomb = _deflated(1000)
    at = content.find(b"\x78")
    while at >= 0:
        unpacker = zlib.decompressobj()
        try:
            unpacker.decompress(content[at:], 1 << 24)
        except zlib.error:
            at = content.find(b"\x78", at + 1)
            continue
        end = len(content) - len(unpacker.unused_data)
        for code in ("<Q", "<I"):
            for back in (8, 12, 16, 20, 24):
                start = at - back
                if start >= 0 and struct.unpack_from(code, content, start)[0] == end - at:
                    head = bytearray(content[:at])
                    struct.pack_into(code, head, start, len(bomb))
                    path.write_bytes(bytes(head) + bomb + content[end:])
                    return
        at = content.find(b"\x78", end)


def _zeros_behind(folder: Path) -> None:
    import os

    path = _file(folder)
    os.truncate(path, path.stat().st_size + (300 << 20))


def _large_numbers(folder: Path) -> None:
    """Every length in the first part of a file is as large as it can be, one in eight of its words."""
    path = _file(folder)
    content = bytearray(path.read_bytes())
    for at in range(64, min(len(content) - 8, 4096), 32):
        content[at : at + 4] = b"\xff\xff\xff\x7f"
    path.write_bytes(content)


def _file(folder: Path) -> Path:
    path = next(folder.glob("recording*"))
    return (
        path if path.is_file() else next(p for p in sorted(path.rglob("*")) if p.suffix in (".db3", ".mcap"))
    )


VIDEOS: dict[str, bytes] = {
    "a list of files": b"#EXTM3U\nfile:///etc/passwd\n",
    "a list for ffmpeg": b"ffconcat version 1.0\nfile /etc/passwd\n",
    "a head alone": b"\0\0\0\x18ftypisom" + bytes(2000),
    "a page": b"<?xml version='1.0'?><MPD><BaseURL>http://127.0.0.1:1/</BaseURL></MPD>",
    "a session": b"v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 5004 RTP/AVP 96\n",
    "no bytes": b"",
}


def _video(name: str, data: bytes) -> Case:
    def make(folder: Path) -> None:
        (folder / "recording/rgb.mp4").write_bytes(data)

    return Case("L", name, "", make, "stray", ADVICE)


CAMERAS = {
    "fx of 1e-300": '"fx": 1e-300',
    "fx of 1e300": '"fx": 1e300',
    "a scale of 1e-300": '"depth_scale": 1e-300',
    "a scale of 1e300": '"depth_scale": 1e300',
    "a width of 10^9": '"width": 1000000000',
    "a height of -5": '"height": -5',
    "fx of not a number": '"fx": NaN',
    "a centre of 1e300": '"cx": 1e300',
}


def _camera(name: str, said: str) -> Case:
    def make(folder: Path) -> None:
        import json

        key, value = said.replace('"', "").split(": ")
        path = folder / "recording/camera.json"
        camera = json.loads(path.read_text(encoding="utf-8"))
        camera[key] = "@"
        path.write_text(json.dumps(camera).replace('"@"', value), encoding="utf-8")

    return Case("L", f"camera.json: {name}", "", make, "tum", ADVICE)


def _flipped(folder: Path) -> None:
    for path in (folder / "recording/rgb").iterdir():
        content = bytearray(path.read_bytes())
        for at in range(len(content) // 2, len(content) - 2, 50):
            content[at] ^= 0x55
        path.write_bytes(content[: -len(content) // 4])
