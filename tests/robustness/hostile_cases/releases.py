"""Releases: texts that swell or nest, tables that are none, archives whose headers lie."""

import gzip
import json
import re
import struct
import tarfile
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

from fuzz.releases import seal

from hostile_cases.case import Case, in_turn, on

VERIFY = "verify release"
SCORE = "score predictions --benchmark release --jobs 1 --no-surface --no-baselines --no-gallery --out scored"
READERS = f"""{VERIFY}
{SCORE}
load release
baseline partial --benchmark release --jobs 1 --out made
export exported --layout bop --benchmark release
report --benchmark release --out page.html"""
OFFICIAL = (0, 1)


def bomb_yaml(key: str = "version") -> str:
    """A billion laughs: ten words, a list of ten of them, a list of ten of those, and so on."""
    rows = ["a0: &a0 [" + ",".join(["lol"] * 10) + "]"]
    rows += [f"a{n}: &a{n} [" + ",".join([f"*a{n - 1}"] * 10) + "]" for n in range(1, 11)]
    return "\n".join([*rows, f"{key}: *a10", ""])


def merge_bomb() -> str:
    """The same with merged maps."""
    rows = ["a0: &a0 {k0: 1, k1: 2}"]
    rows += [f"a{n}: &a{n} {{<<: [" + ",".join([f"*a{n - 1}"] * 10) + f"], x{n}: 1}}" for n in range(1, 11)]
    return "\n".join([*rows, "version: *a10", ""])


def cases() -> Iterator[Case]:
    yield from on(VERIFY, *(_citation(group, name, text) for group, name, text in CITATIONS))
    yield from in_turn(READERS, *(_file(group, name, file, text) for group, name, file, text in FILES))
    yield from on("verify release.tar", *(_tar(name, data) for name, data in TARS.items()))
    yield from on("verify release.tar.gz", *(_tar(name, data, packed=True) for name, data in TARS.items()))
    yield from on("verify release.zip", *(_archive(name, make) for name, make in ZIPS.items()))
    yield Case("H3", "a tar.gz of 3 GB of zeros", "verify release.tar.gz", _tar_bomb)
    yield from on(READERS, _release("M3", "benchmark.json without its recordings", _no_recordings))
    yield from on(READERS, _release("M3", "other recordings in benchmark.json", _other_recordings))
    yield from on(READERS, _release("M6", "250,000 rows in targets.csv", _many_rows))
    yield from on(READERS, _release("M6", "1,000,000 rows in SHA256SUMS", _many_sums))


def _release(group: str, name: str, make: Callable[[Path], object]) -> Case:
    return Case(group, name, "", make, "release", OFFICIAL, errors=25)


def _citation(group: str, name: str, text: str) -> Case:
    def make(folder: Path) -> None:
        release = folder / "release"
        content = json.loads((release / "benchmark.json").read_text(encoding="utf-8")) | {"version": "1.0.0"}
        (release / "benchmark.json").write_text(json.dumps(content), encoding="utf-8")
        (release / "CITATION.cff").write_text(text, encoding="utf-8")
        seal(release)

    return Case(group, f"CITATION.cff: {name}", "", make, "release", (1,), "CITATION.cff", errors=6)


CITATIONS = (
    ("H1", "a billion laughs", bomb_yaml()),
    ("H1", "a billion laughs in lists of authors", bomb_yaml("authors")),
    ("H1", "merged maps without end", merge_bomb()),
    ("H1", "itself", "version: &a [*a, *a]\n"),
    ("H1", "200 kB of anchors", "".join(f"a{n}: &a{n} 1\n" for n in range(10_000)) + "version: 1\n"),
    ("H1", "a version of a million digits", "version: " + "9" * 250_000 + "\n"),
    ("M3", "a Python tag", "version: !!python/object/apply:os.system ['id > pwned']\n"),
    ("M3", "no YAML", "version: [1\nx: }"),
    ("M3", "100,000 brackets", "[" * 100_000),
    ("M3", "not UTF-8", "version: '\x00\x1b[2J'"),
    ("M3", "2 MB", "#" * (2 << 20)),
)
VIEWS = "views/chair_01/views.json"
DEEP = "[" * 100_000
HUGE_NUMBER = '{"format_version": ' + "9" * 100_000 + "}"
LONG_KEY = json.dumps({"k" * 100_000: 1, "\x1b[2J": 2})
FILES = (
    ("M3", "targets.csv with a field of 200 kB", "targets.csv", "recording," + "x" * 200_000),
    ("M3", "targets.csv with a lone CR", "targets.csv", "recording,object\rview\n"),
    ("M3", "targets.csv with a quote that never ends", "targets.csv", '"' * 3 + "a\n" * 100_000),
    ("M3", "targets.csv of NUL bytes", "targets.csv", "\0" * 100_000),
    ("M3", "benchmark.json of brackets", "benchmark.json", DEEP),
    ("M3", "benchmark.json is a list", "benchmark.json", "[1]"),
    ("M3", "benchmark.json with a long number", "benchmark.json", HUGE_NUMBER),
    ("M3", "benchmark.json with a long key", "benchmark.json", LONG_KEY),
    ("M3", "splits.json of brackets", "splits.json", DEEP),
    ("M3", "splits.json of other types", "splits.json", '{"test": {"a": [1e999]}}'),
    ("M3", "splits.json of a million names", "splits.json", json.dumps({"test": ["a"] * 1_000_000})),
    ("M3", "croissant.json of brackets", "croissant.json", DEEP),
    ("M3", "lineage.json of brackets", "lineage.json", DEEP),
    ("M3", "privacy.json of other types", "privacy.json", "[]"),
    ("M3", "quality.json of brackets", "objects/chair_01/quality.json", DEEP),
    (
        "M3",
        "quality.json of a text of 1 MB",
        "objects/chair_01/quality.json",
        json.dumps({"verdict": "x" * 10**6}),
    ),
    ("M3", "floor.json of a word", "objects/chair_01/floor.json", '{"plane_world": "\\u001b[2J"}'),
    ("M3", "views.json of brackets", VIEWS, DEEP),
    ("M3", "views.json of a million numbers", VIEWS, '{"views": [' + "0," * 1_000_000 + "0]}"),
    ("M3", "README.md not UTF-8", "README.md", b"\xff\xfe\x00"),
    ("M3", "LICENSE of 300 MB", "LICENSE", 300 << 20),
    ("M3", "mesh.ply is garbage", "objects/chair_01/mesh.ply", "ply or not"),
    ("M3", "mesh.ply of no bytes", "objects/chair_01/mesh.ply", ""),
    ("M3", "volume.npz is garbage", "objects/chair_01/volume.npz", "PK\3\4" + "x" * 99),
    (
        "L",
        "views.json of a camera of zeros",
        VIEWS,
        lambda said: re.sub(r'"K": \[[^"]*\]\]', '"K": [[0,0,0],[0,0,0],[0,0,0]]', said),
    ),
    (
        "L",
        "views.json of a width of 10^9",
        VIEWS,
        lambda said: re.sub(r'"width": \d+', '"width": 1000000000', said),
    ),
    ("L", "views.json of a height of -5", VIEWS, lambda said: re.sub(r'"height": \d+', '"height": -5', said)),
    (
        "L",
        "views.json of a focal length of 1e-300",
        VIEWS,
        lambda said: re.sub(r'"K": \[\s*\[\s*[0-9.]+', '"K": [[1e-300', said),
    ),
    (
        "L",
        "views.json of poses of 1e300",
        VIEWS,
        lambda said: re.sub(r'"T_world_camera": \[\s*\[\s*[-0-9.e]+', '"T_world_camera": [[1e300', said),
    ),
    ("M3", "mesh.ply with NaN", "objects/chair_01/mesh.ply", float("nan")),
    ("M3", "mesh.ply with 1e38", "objects/chair_01/mesh.ply", 1e38),
)


def _file(group: str, name: str, file: str, content: object) -> Case:
    """A release, all of whose checksums agree, with another content of a file."""

    def make(folder: Path) -> None:
        release = folder / "release"
        path = release / file
        _put(path, content)
        if not isinstance(content, int):
            seal(release)

    return _release(group, name, make)


def _put(path: Path, content: object) -> None:
    import os

    if isinstance(content, float):
        from kinectbench.core.geometry.mesh import read_own_ply, write_ply

        mesh = read_own_ply(path)
        mesh.vertices[0, 0] = content
        write_ply(mesh, path)
    elif isinstance(content, int):
        os.truncate(path, content)
    elif isinstance(content, str | bytes):
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    else:
        assert callable(content)
        path.write_text(content(path.read_text(encoding="utf-8")), encoding="utf-8")


def _no_recordings(folder: Path) -> None:
    path = folder / "release/benchmark.json"
    path.write_text(
        json.dumps(json.loads(path.read_text(encoding="utf-8")) | {"recordings": {}}), encoding="utf-8"
    )
    seal(folder / "release")


def _other_recordings(folder: Path) -> None:
    path = folder / "release/benchmark.json"
    path.write_text(
        path.read_text(encoding="utf-8").replace('"chair_02"', '"chair_0\\u001b[2J"'), encoding="utf-8"
    )
    seal(folder / "release")


def _many_rows(folder: Path) -> None:
    path = folder / "release/targets.csv"
    head, first, *_ = path.read_text(encoding="utf-8").splitlines()
    rows = (first.replace("000", f"{n:06d}") for n in range(250_000))
    path.write_text("\n".join([head, *rows, ""]), encoding="utf-8")
    seal(folder / "release")


def _many_sums(folder: Path) -> None:
    path = folder / "release/SHA256SUMS"
    line = "0" * 64 + "  pairs/chair_01/{:06d}.npz\n"
    path.write_text("".join(line.format(n) for n in range(1_000_000)), encoding="utf-8")


def _header(name: str, size: int, kind: bytes = tarfile.REGTYPE) -> bytes:
    info = tarfile.TarInfo(name)
    info.type, info.size = kind, size
    return info.tobuf(tarfile.GNU_FORMAT)


def _pax(records: bytes, kind: bytes = tarfile.XHDTYPE) -> bytes:
    return _header("x", len(records), kind) + records + bytes(-len(records) % 512)


def _record(key: str, value: str) -> bytes:
    text = f" {key}={value}\n"
    length = len(text) + len(str(len(text)))
    return f"{length + (len(str(length)) > len(str(len(text))))}{text}".encode()


END = bytes(1024)
TARS: dict[str, Callable[[], bytes]] = {
    "a tar of a size of 10^19": lambda: _pax(_record("size", "9999999999999999999")) + _header("a", 0) + END,
    "a tar of a size below 0": lambda: _pax(_record("size", "-51200")) + _header("a", 0) + END,
    "a tar that leads back": lambda: _pax(_record("size", "-1536")) + _header("a", 0) + END,
    "a tar of 2,000,000 keywords": lambda: _pax(_record("a", "b") * 2_000_000) + _header("a", 0) + END,
    "a tar of a name without end": lambda: _header("x", 1 << 33, tarfile.GNUTYPE_LONGNAME) + END,
    "a tar of 200,000 members": lambda: _header("a", 0) * 200_000 + END,
    "a tar of sparse files": lambda: (
        _pax(_record("GNU.sparse.realsize", "9" * 15) + _record("GNU.sparse.map", "0,1"))
        + _header("a", 0)
        + END
    ),
    "a tar of garbage": lambda: bytes(range(256)) * 8,
    "a tar of ways out": lambda: (
        _header("../../out", 0) + _header("/etc/out", 0) + _header("a\x1b[2J", 0) + END
    ),
}


def _tar(name: str, data: Callable[[], bytes], packed: bool = False) -> Case:
    def make(folder: Path) -> None:
        path = folder / ("release.tar.gz" if packed else "release.tar")
        path.write_bytes(gzip.compress(data(), 1) if packed else data())

    return Case("M6" if "000" in name else "M3", name, "", make)


def _tar_bomb(folder: Path) -> None:
    with gzip.open(folder / "release.tar.gz", "wb", 1) as file:
        file.write(_header("furniture/benchmark.json", 3 << 30))
        for _ in range(192):
            file.write(bytes(16 << 20))


def _archive(name: str, make: Callable[[Path], object]) -> Case:
    return Case("M6" if "000" in name else "H3", name, "", make, "release", errors=25)


def _million_rows(folder: Path) -> None:
    row = b"PK\1\2" + bytes(24) + struct.pack("<H", 1) + bytes(16) + b"a"
    large = struct.pack("<4sQ2H2L4Q", b"PK\6\6", 44, 45, 45, 0, 0, 10**6, 10**6, 10**6 * len(row), 0)
    locator = struct.pack("<4sLQL", b"PK\6\7", 0, 10**6 * len(row), 1)
    end = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 0xFFFF, 0xFFFF, 0xFFFFFFFF, 0xFFFFFFFF, 0)
    (folder / "release.zip").write_bytes(row * 10**6 + large + locator + end)


def _swelling(folder: Path) -> None:
    """SHA256SUMS of 1 GB that says 100 bytes."""
    path = folder / "release.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted((folder / "release").rglob("*")):
            if file.is_file() and file.name != "SHA256SUMS":
                archive.write(file, file.relative_to(folder / "release").as_posix())
        with archive.open("SHA256SUMS", "w", force_zip64=True) as member:
            for _ in range(64):
                member.write(bytes(16 << 20))
    content = bytearray(path.read_bytes())
    struct.pack_into("<I", content, content.rindex(b"PK\1\2") + 24, 100)
    path.write_bytes(content)


def _claims(folder: Path) -> None:
    with zipfile.ZipFile(folder / "release.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("benchmark.json", "{}")
        archive.writestr("SHA256SUMS", "")
        archive.filelist[0].file_size = 10**12


def _ways_out(folder: Path) -> None:
    with zipfile.ZipFile(folder / "release.zip", "w") as archive:
        for name in ("benchmark.json", "../../out", "/etc/out", "a\x1b[2J", "C:\\out", "a/../../out"):
            archive.writestr(name, "{}")


ZIPS: dict[str, Callable[[Path], object]] = {
    "a zip of 1,000,000 members": _million_rows,
    "a zip whose member swells": _swelling,
    "a zip that claims 1 TB": _claims,
    "a zip of ways out": _ways_out,
    "a zip that is cut off": lambda folder: (folder / "release.zip").write_bytes(b"PK\3\4" + bytes(99)),
}
