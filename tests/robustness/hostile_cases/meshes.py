"""Predictions: meshes that cost more than their size, arrays that claim more than they hold."""

import io
import os
import struct
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from fuzz.members import zeros

from hostile_cases.case import NOT_ROOT, Case, on

PREDICTION = "predictions/chair_01/000"
CORNERS = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 3 4\n"
CHECK = "check predictions --benchmark release --jobs 1"
SCORE = "score predictions --benchmark release --jobs 1 --no-baselines --no-gallery --out scored"
BOTH = f"{CHECK}\n{SCORE}"
# `score` goes on without one prediction; `check` names what is wrong, and the file that is too many.
REFUSED = (1, 3)
PLY = (
    b"ply\nformat binary_little_endian 1.0\n%selement vertex %d\nproperty float x\nproperty float y\n"
    b"property float z\nelement face %d\nproperty list int int vertex_indices\nend_header\n"
)


def cases() -> Iterator[Case]:
    yield from on(BOTH, *(_mesh(group, name, kind, data) for group, name, kind, data in MESHES))
    yield from on(BOTH, *(_mesh(group, name, kind, data) for group, name, kind, data in ARRAYS))
    yield from on(BOTH, _of("M1", "an npz that claims 2 GB", _bomb_npz))
    yield from on(BOTH, _of("M6", "an npz of a million members", _many_members))
    yield from on(BOTH, _of("M1", "an npz packed by lzma", _lzma_npz))
    yield from on(BOTH, _of("M1", "an npz that is encrypted", _encrypted_npz))
    yield from on(BOTH, _of("H4", "a mesh whose materials are a pipe", _mtl_pipe, (0, 1, 3)))
    for name, grid in GRIDS.items():
        case = _of("H0", f"a grid that costs most: {name}", _grid(grid), (0, 3))
        yield from on(BOTH, replace(case, most_mb=LARGEST_MB if name.startswith("512") else case.most_mb))
    yield from on(CHECK, _of("M6", "2,000 strays, 2,000 targets missing", _strays_of_many, errors=2100))
    yield from on(BOTH, _of("M6", "100,000 strays", _many_strays, (0, 1, 3), errors=30))
    yield from on(BOTH, _of("L", "a folder without permission", _forbidden, before=NOT_ROOT, errors=3))
    yield from on(BOTH, _of("L", "a file without permission", _forbidden_file, before=NOT_ROOT))
    yield from on(BOTH, _of("L", "a bool of 2", _bad_bool, REFUSED))
    yield from on(
        BOTH, _of("M6", "files whose names differ in case alone", _many_cases, (0, 1, 3), errors=30)
    )


def _of(
    group: str,
    name: str,
    make: Callable[[Path], object],
    statuses: tuple[int, ...] = REFUSED,
    *,
    errors: int = 2,
    before: str = "",
) -> Case:
    return Case(group, name, "", make, "release", statuses, errors=errors, before=before)


def _mesh(group: str, name: str, kind: str, data: Callable[[], bytes]) -> Case:
    def make(folder: Path) -> None:
        (folder / f"{PREDICTION}.npy").unlink()
        (folder / f"{PREDICTION}.{kind}").write_bytes(data())

    return _of(group, name, make, (0, 1, 3) if name.startswith("harmless") else REFUSED)


MESHES = (
    (
        "H0",
        "300,000 materials",
        "obj",
        lambda: CORNERS + b"".join(b"usemtl m%d\nf 1 2 4\n" % n for n in range(300_000)),
    ),
    (
        "H0",
        "300,000 objects",
        "obj",
        lambda: CORNERS + b"".join(b"o m%d\nf 1 2 4\n" % n for n in range(300_000)),
    ),
    (
        "H0",
        "300,000 groups",
        "obj",
        lambda: CORNERS + b"".join(b"g m%d\nf 1 2 4\n" % n for n in range(300_000)),
    ),
    (
        "H0",
        "300,000 smoothing groups",
        "obj",
        lambda: CORNERS + b"".join(b"s %d\nf 1 2 4\n" % n for n in range(300_000)),
    ),
    (
        "H0",
        "300,000 libraries of materials",
        "obj",
        lambda: CORNERS + b"".join(b"mtllib /dev/zero\nf 1 2 4\n" for _ in range(300_000)),
    ),
    ("H0", "lines that go on", "obj", lambda: CORNERS + b"f 1 2 3 \\\n" * 3_000_000),
    (
        "H0",
        "a million normals and textures",
        "obj",
        lambda: CORNERS + b"vn 0 0 1\nvt 0 0\n" * 1_000_000 + b"f 1 2 4\n" * 200_000,
    ),
    ("M6", "one polygon of 6,000,000 corners", "obj", lambda: CORNERS + b"f " + b"1 " * 6_000_000 + b"\n"),
    ("M6", "3,000,000 polygons of one corner", "obj", lambda: CORNERS + b"f 1\n" * 3_000_000),
    ("M6", "a number of 60 MB", "obj", lambda: b"v " + b"1" * (60 << 20)),
    (
        "M6",
        "1,000,000 faces across the cube",
        "obj",
        lambda: b"v 0 0 0\nv 1 1 1\nv 1 0 1\n" + b"f 1 2 3\n" * 1_000_000,
    ),
    ("M6", "60 MB of empty lines", "obj", lambda: b"\n" * (60 << 20)),
    (
        "M6",
        "a polygon of 15,000,000 corners",
        "ply",
        lambda: PLY % (b"", 4, 1) + bytes(48) + struct.pack("<i", 15_000_000) + bytes(60_000_000),
    ),
    ("M6", "faces and vertices of a billion", "ply", lambda: PLY % (b"", 10**9, 10**9) + bytes(99)),
    ("M6", "100,000 elements", "ply", lambda: PLY % (b"element a 0\n" * 100_000, 3, 1) + bytes(99)),
    ("M6", "rows without bytes", "ply", lambda: PLY % (b"element a 1000000000000\n", 3, 1) + bytes(99)),
    (
        "M6",
        "a PLY of 60 MB of text",
        "ply",
        lambda: (PLY % (b"", 4, 1)).replace(b"binary_little_endian", b"ascii") + b"1 " * (30 << 20),
    ),
    ("M6", "a mesh of 1 TB", "ply", lambda: b"ply\n"),
)


def _npy(shape: tuple[int, ...], descr: str = "'|u1'", order: bool = False) -> bytes:
    header = f"{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header


ARRAYS = (
    ("M1", "an npy that claims 10^15 cells", "npy", lambda: _npy((10**5,) * 3)),
    ("M1", "an npy of objects", "npy", lambda: _npy((256,) * 3, "'|O'") + b"cos\nsystem\n(S'id'\ntR."),
    ("M1", "an npy of negative sides", "npy", lambda: _npy((-8, -8, 8)) + bytes(512)),
    ("M1", "an npy of sides of 10^30", "npy", lambda: _npy((10**30, 1, 1))),
    ("M1", "an npy whose head is a program", "npy", lambda: _npy((8, 8, 8), "__import__('os').system('id')")),
    (
        "M1",
        "an npy whose head is nested",
        "npy",
        lambda: b"\x93NUMPY\2\0" + struct.pack("<I", 200_000) + b"(" * 200_000,
    ),
    ("M1", "an npy that says npz", "npz", lambda: _npy((8, 8, 8)) + bytes(512)),
    (
        "M1",
        "not a number in a grid",
        "npy",
        lambda: _npy((8, 8, 8), "'<f4'") + np.full(512, np.nan, "<f4").tobytes(),
    ),
    (
        "M1",
        "numbers beyond all",
        "npy",
        lambda: _npy((8, 8, 8), "'<f8'") + np.full(512, 1e308, "<f8").tobytes(),
    ),
    ("M1", "no bytes", "npy", lambda: b""),
)


# Grids that are accepted: the largest, and those with the most surface. A grid of 512 float32 a side is no
# attack: its values alone are half a gigabyte, as docs/scoring.md says.
LARGEST_MB = 900.0
GRIDS: dict[str, Callable[[], np.ndarray]] = {
    "512 a side, float32, zeros": lambda: np.zeros((512,) * 3, np.float32),
    "512 a side, float32, ones": lambda: np.ones((512,) * 3, np.float32),
    "512 a side, float32, noise": lambda: np.random.default_rng(0).random((512,) * 3, np.float32),
    "512 a side, float32, Fortran order": lambda: np.zeros((512,) * 3, ">f4", "F"),
    "a chequerboard, 256 a side": lambda: np.indices((256,) * 3, np.uint8).sum(axis=0, dtype=np.uint8) % 2,
    "a chequerboard of bits, 512 a side": lambda: np.full((512, 512, 64), 0x55, np.uint8),
    "a side of 511": lambda: np.full((511,) * 3, 0.5, np.float16),
}


def _grid(make: Callable[[], np.ndarray]) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        (folder / f"{PREDICTION}.npy").unlink()
        np.savez_compressed(folder / f"{PREDICTION}.npz", make())

    return write


def _put(folder: Path, content: bytes) -> None:
    (folder / f"{PREDICTION}.npy").unlink()
    (folder / f"{PREDICTION}.npz").write_bytes(content)


def _bomb_npz(folder: Path) -> None:
    """Members of 2 GB in 2 MB; the sizes that are claimed are true."""
    from fuzz.members import add_bomb

    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in ("a.npy", "b.npy"):
            add_bomb(archive, buffer, zipfile.ZipInfo(name), _npy((1 << 20, 1 << 10)))
    assert len(zeros()) < len(buffer.getvalue())
    _put(folder, buffer.getvalue())


def _many_members(folder: Path) -> None:
    """A million rows in the directory of a zip, and its end for large files."""
    row = b"PK\1\2" + bytes(24) + struct.pack("<H", 1) + bytes(16) + b"a"
    large = struct.pack("<4sQ2H2L4Q", b"PK\6\6", 44, 45, 45, 0, 0, 10**6, 10**6, 10**6 * len(row), 0)
    locator = struct.pack("<4sLQL", b"PK\6\7", 0, 10**6 * len(row), 1)
    end = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 0xFFFF, 0xFFFF, 0xFFFFFFFF, 0xFFFFFFFF, 0)
    _put(folder, row * 10**6 + large + locator + end)


def _lzma_npz(folder: Path) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("a.npy", _npy((8, 8, 8)) + bytes(512))
    _put(folder, buffer.getvalue())


def _encrypted_npz(folder: Path) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", _npy((8, 8, 8)) + bytes(512))
    content = bytearray(buffer.getvalue())
    content[content.rindex(b"PK\1\2") + 8] |= 1
    _put(folder, bytes(content))


def _mtl_pipe(folder: Path) -> None:
    os.mkfifo(folder / "predictions/chair_01/m.mtl")
    (folder / f"{PREDICTION}.npy").unlink()
    (folder / f"{PREDICTION}.obj").write_bytes(b"mtllib m.mtl\nusemtl a\n" + CORNERS)


def _strays_of_many(folder: Path) -> None:
    """A release of 2,000 test pairs, which all are one; no prediction has the right name."""
    more_targets(folder / "release", 2000)
    (folder / f"{PREDICTION}.npy").unlink()
    for number in range(2000):
        (folder / f"predictions/chair_01/{number:04d}.NPY").touch()


def more_targets(release: Path, count: int) -> None:
    """Give a release so many pairs of its first recording."""
    from fuzz.releases import seal

    for table in (release / "targets.csv", release / "targets" / "test.csv"):
        head, *rows = table.read_text(encoding="utf-8").splitlines(keepends=True)
        first = next(row for row in rows if "pairs/chair_01/000" in row)
        more = [first.replace(",000,", f",{n:03d},").replace("/000.", f"/{n:03d}.") for n in range(1, count)]
        table.write_text("".join([head, *sorted([*rows, *more])]), encoding="utf-8")
    for number in range(1, count):
        os.link(release / "pairs/chair_01/000.npz", release / f"pairs/chair_01/{number:03d}.npz")
    del seal
    _sums_again(release)


def _sums_again(release: Path) -> None:
    """Hashes of the tables that were changed, in SHA256SUMS and benchmark.json."""
    import hashlib
    import re

    from kinectbench.core.artefacts.targets import benchmark_sha256

    sums = release / "SHA256SUMS"
    pair = re.search(r"([0-9a-f]{64})  pairs/chair_01/000\.npz", sums.read_text(encoding="utf-8"))
    assert pair
    names = sorted(p.relative_to(release).as_posix() for p in release.rglob("*") if p.is_file() and p != sums)
    known: dict[str, str] = {}
    for name in names:
        one = name.startswith("pairs/chair_01/")
        known[name] = pair[1] if one else hashlib.sha256((release / name).read_bytes()).hexdigest()
    text = "".join(f"{sha}  {name}\n" for name, sha in known.items() if name != "benchmark.json")
    info = release / "benchmark.json"
    said = info.read_text(encoding="utf-8")
    whole = benchmark_sha256(text, said)
    info.write_text(re.sub(r'("benchmark_sha256": *")[0-9a-f]{64}', rf"\g<1>{whole}", said), encoding="utf-8")
    known["benchmark.json"] = hashlib.sha256(info.read_bytes()).hexdigest()
    sums.write_text("".join(f"{known[name]}  {name}\n" for name in sorted(known)), encoding="utf-8")


def _many_strays(folder: Path) -> None:
    for number in range(100_000):
        (folder / f"predictions/chair_01/{number:06d}.npy").touch()
    (folder / f"{PREDICTION}.npy").unlink()


def _forbidden(folder: Path) -> None:
    (folder / "predictions/chair_01").chmod(0)


def _forbidden_file(folder: Path) -> None:
    (folder / f"{PREDICTION}.npy").chmod(0)


def _bad_bool(folder: Path) -> None:
    (folder / f"{PREDICTION}.npy").write_bytes(_npy((8, 8, 8), "'|b1'") + b"\2" * 512)


def _many_cases(folder: Path) -> None:
    for number in range(2000):
        name = "".join(c.upper() if number >> place & 1 else c for place, c in enumerate("prediction000"))
        (folder / f"predictions/chair_01/{name}.npy").touch()
