"""Releases of strangers: made to hang, to fill the memory or to trip, each ends in one line, in time."""

import hashlib
import io
import json
import os
import shutil
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bounds import within
from raising import raises

import kinectbench
from kinectbench.core.artefacts.targets import benchmark_sha256
from kinectbench.core.errors import KinectBenchError, ReleaseError
from kinectbench.core.geometry.mesh import read_own_ply, write_ply
from kinectbench.core.voxels.npz import load_arrays, npz_bytes
from kinectbench.release.check.verify import verify
from kinectbench.release.exchange.bop import export_bop
from kinectbench.release.exchange.webdataset import export_webdataset
from kinectbench.release.release import Release, open_release
from kinectbench.scoring.truth import read_packed_truth

PAIR, RECORDING = "pairs/chair_01/000.npz", "chair_01"
MESH, VOLUME = f"objects/{RECORDING}/mesh.ply", f"objects/{RECORDING}/volume.npz"


@pytest.fixture
def copy(release: Release, tmp_path: Path) -> Path:
    return Path(shutil.copytree(release.folder, tmp_path / "release"))


def seal(folder: Path) -> Path:
    """Make every checksum right again, as whoever forged it would."""

    def sha256(name: str) -> str:
        return hashlib.sha256((folder / name).read_bytes()).hexdigest()

    old = dict(line.split("  ")[::-1] for line in (folder / "SHA256SUMS").read_text().splitlines())
    for table in (folder / "targets.csv", *folder.glob("targets/*.csv"), *folder.glob("previews/*/*.jsonl")):
        text = table.read_bytes().decode()
        for name, was in old.items():
            if name.startswith("pairs/"):
                text = text.replace(was, sha256(name))
        table.write_bytes(text.encode())
    croissant = json.loads((folder / "croissant.json").read_text())
    for file in croissant["distribution"]:
        if "sha256" in file:
            file["sha256"] = sha256(file["contentUrl"])
    (folder / "croissant.json").write_text(json.dumps(croissant))
    lines = {name: f"{sha256(name)}  {name}\n" for name in sorted(old)}
    metadata = json.loads((folder / "benchmark.json").read_text())
    metadata["benchmark_sha256"] = benchmark_sha256("".join(lines.values()), json.dumps(metadata))
    (folder / "benchmark.json").write_text(json.dumps(metadata))
    lines["benchmark.json"] = f"{sha256('benchmark.json')}  benchmark.json\n"
    (folder / "SHA256SUMS").write_text("".join(lines[name] for name in sorted(lines)))
    return folder


def bomb_yaml() -> str:
    rows = ["a0: &a0 [" + ",".join(["lol"] * 10) + "]"]
    rows += [f"a{n}: &a{n} [" + ",".join([f"*a{n - 1}"] * 10) + "]" for n in range(1, 11)]
    return "\n".join([*rows, "version: *a10", ""])


CITATIONS = {
    "a bomb of aliases": (bomb_yaml(), "CITATION.cff: no version where benchmark.json has '1.0.0'"),
    "a python tag": ("version: !!python/object/apply:os.getcwd []\n", "CITATION.cff: no version where"),
    "no YAML": ("version: [1\nx: }", "CITATION.cff:2: not valid YAML"),
    "nested": ("[" * 100_000, "CITATION.cff: nested too deeply"),
    "another version": ("version: 2.0\n", "CITATION.cff: version '2.0' where"),
    "a list": ("- 1\n", "CITATION.cff: no version where"),
    "escapes": ('version: "\\e[2J"\n', "CITATION.cff: version '?[2J' where"),
    "large": ("#" * (300 << 10), "CITATION.cff: 307200 bytes are more than such a file can have"),
}


@pytest.mark.parametrize("name", CITATIONS)
def test_a_citation_is_never_written_out(copy: Path, name: str) -> None:
    text, line = CITATIONS[name]
    metadata = json.loads((copy / "benchmark.json").read_text()) | {"version": "1.0.0"}
    (copy / "benchmark.json").write_text(json.dumps(metadata))
    (copy / "CITATION.cff").write_text(text)
    seal(copy)
    # Errors at a great depth take a minute where memory is traced.
    with within(10, None if name == "nested" else 100):
        lines = verify(copy)
    assert [found for found in lines if found.startswith(line)] and len(lines) < 5, lines


def fifo(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def zeros(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


@pytest.mark.parametrize("odd", [fifo, zeros])
@pytest.mark.parametrize("name", ["SHA256SUMS", "targets.csv", "benchmark.json", "splits.json"])
def test_small_files_that_are_no_files(copy: Path, name: str, odd: Callable[[Path], None]) -> None:
    odd(copy / name)
    with within(5, 50):
        with pytest.raises(ReleaseError, match=name):
            open_release(copy)
        assert any(line.startswith(f"{name}: ") for line in verify(copy))


@pytest.mark.parametrize("odd", [fifo, zeros])
def test_pairs_that_are_no_files(copy: Path, tmp_path: Path, odd: Callable[[Path], None]) -> None:
    release = open_release(copy)
    odd(copy / PAIR)
    with within(10):
        refused_everywhere(release, tmp_path, "not a plain file")
        assert [line.partition("; ")[0] for line in verify(copy)] == [f"{PAIR}: not a plain file"]


@pytest.mark.parametrize("name", ["LICENSE", MESH, PAIR, "index.html", "SHA256SUMS"])
def test_a_file_larger_than_any_of_a_release_is_not_hashed(copy: Path, name: str) -> None:
    os.truncate(copy / name, 1 << 40)
    with within(5, 50):
        lines = verify(copy)
    assert any(line.startswith(f"{name}: ") and "more than" in line for line in lines), lines


def refused_everywhere(release: Release, tmp_path: Path, line: str) -> None:
    """A pair is refused by whatever reads it."""
    target = next(target for target in release.targets if target.file == PAIR)
    dataset = kinectbench.load(release.folder)
    readers: list[Callable[[], object]] = [
        lambda: read_packed_truth(release.pair_path(target), target.sha256),
        lambda: dataset[dataset.targets.index(target)],
        lambda: export_webdataset(release, tmp_path / "shards"),
        lambda: export_bop(release, tmp_path / "bop"),
    ]
    for read in readers:
        with pytest.raises(KinectBenchError, match=line):
            read()


def npy_claiming(shape: tuple[int, ...]) -> bytes:
    header = f"{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header


def with_entry(path: Path, entry: bytes, flags: int = 0, method: int = zipfile.ZIP_DEFLATED) -> None:
    """The pair file with other bytes for `full.npy`."""
    arrays = {name: array for name, array in load_arrays(path).items() if name != "full"}
    buffer = io.BytesIO(npz_bytes(arrays))
    with zipfile.ZipFile(buffer, "a", method) as archive:
        archive.writestr("full.npy", entry)
    content = bytearray(buffer.getvalue())
    at = content.rindex(b"PK\1\2")
    content[at + 8] |= flags
    path.write_bytes(content)


PAIRS: dict[str, tuple[Callable[[Path], object], str]] = {
    "a bomb": (lambda path: with_entry(path, bytes(40 << 20)), "claims to unpack to"),
    "10^15 cells": (lambda path: with_entry(path, npy_claiming((10**5,) * 3)), "cut short"),
    "encrypted": (lambda path: with_entry(path, b"", flags=1), "encrypted"),
    "lzma": (lambda path: with_entry(path, b"", method=zipfile.ZIP_LZMA), "an uncommon compression"),
    "one array": (lambda path: path.write_bytes(npy_claiming((1,)) + b"1"), "a single array, not an npz"),
    "large": (lambda path: os.truncate(path, 1 << 33), "larger than the|more than such a file"),
}


@pytest.mark.parametrize("name", PAIRS)
def test_pairs_that_blow_up(copy: Path, tmp_path: Path, name: str) -> None:
    damage, line = PAIRS[name]
    damage(copy / PAIR)
    if name == "large":
        release = open_release(copy)
        os.truncate(copy / PAIR, 1 << 20)
        os.truncate(copy / PAIR, 1 << 33)
    else:
        release = open_release(seal(copy))
        with within(10, 100):
            lines = verify(copy)
        assert len(lines) == 1 and lines[0].startswith(f"{PAIR}: ")
    with within(10, 100):
        refused_everywhere(release, tmp_path, line)


def test_a_changed_pair_is_not_trained_on(copy: Path) -> None:
    dataset = kinectbench.load(copy)
    (copy / PAIR).write_bytes((copy / "pairs/table_01/000.npz").read_bytes())
    index = [target.file for target in dataset.targets].index(PAIR)
    with raises(ReleaseError, "release.changed", match=r"000\.npz"):
        dataset[index]


def test_a_release_of_links_is_as_good(copy: Path, tmp_path: Path) -> None:
    """Caches of downloads hold each file elsewhere, by its hash."""
    blobs = tmp_path / "blobs"
    blobs.mkdir()
    for path in [path for path in copy.rglob("*") if path.is_file()]:
        blob = blobs / hashlib.sha256(path.read_bytes()).hexdigest()
        path.rename(blob)
        path.symlink_to(os.path.relpath(blob, path.parent))
    assert verify(copy) == []
    release = open_release(copy)
    assert kinectbench.load(copy)[0]["partial"].any()
    assert export_webdataset(release, tmp_path / "shards") == len(release.targets)
    assert export_bop(release, tmp_path / "bop") == len(release.targets)
    (copy / PAIR).unlink()
    (copy / PAIR).symlink_to(tmp_path / "nowhere")
    assert [line.partition("; ")[0] for line in verify(copy)] == [f"{PAIR}: a link that leads nowhere"]


def test_recordings_that_benchmark_json_does_not_have(copy: Path) -> None:
    metadata = json.loads((copy / "benchmark.json").read_text())
    (copy / "benchmark.json").write_text(json.dumps(metadata | {"recordings": {}}))
    line = f"line 2: benchmark.json has no recording {RECORDING}"
    with raises(ReleaseError, "release.damaged", match=line):
        open_release(seal(copy))
    assert any(found.endswith(line) for found in verify(copy))


TABLES = {
    "a long field": ("recording," + "x" * 200_000, "field larger than field limit"),
    "a lone CR": ("recording,object\rview", "new-line character"),
    "too many values": ("," * 2_000_001, "more than 2000000 values"),
    "escapes": ("", "view '?[2J'"),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_that_are_none(copy: Path, name: str) -> None:
    text, line = TABLES[name]
    table = copy / "targets.csv"
    table.write_text(text or table.read_text().replace(",000,", ",\x1b[2J,"))
    seal(copy)
    with within(5, 100), pytest.raises(ReleaseError) as caught:
        open_release(copy)
    assert line in str(caught.value)
    assert any(line in found for found in verify(copy))


def set_vertices(path: Path, value: float) -> None:
    mesh = read_own_ply(path)
    mesh.vertices[0, 0] = value
    write_ply(mesh, path)


def set_cells(path: Path, **values: np.ndarray | np.generic) -> None:
    path.write_bytes(npz_bytes(load_arrays(path) | {key: np.asarray(values[key]) for key in values}))


ONES = np.ones((4, 5, 6))
OBJECTS: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "a vertex that is NaN": (MESH, lambda p: set_vertices(p, np.nan), "a vertex is not finite"),
    "garbage": (MESH, lambda p: p.write_bytes(b"ply or not"), "not a binary PLY file"),
    "a head that claims more": (
        MESH,
        lambda p: p.write_bytes(p.read_bytes().replace(b"vertex ", b"vertex 99", 1)),
        "bytes where its head claims",
    ),
    "a face beside": (
        MESH,
        lambda p: p.write_bytes(p.read_bytes()[:-4] + struct.pack("<i", 1 << 20)),
        "a face has none",
    ),
    "no volume": (VOLUME, lambda p: p.write_bytes(b"volume"), "not a zip file"),
    "NaN": (VOLUME, lambda p: set_cells(p, probability=np.float16(ONES * np.nan)), "not all in [0, 1]"),
    "labels": (VOLUME, lambda p: set_cells(p, labels=np.uint8(ONES * 9)), "holds labels that there are not"),
    "a shape": (VOLUME, lambda p: set_cells(p, solid=np.ones((1, 5, 6), bool)), "different shapes"),
    "a kind": (VOLUME, lambda p: set_cells(p, solid=ONES), "not a grid of bool"),
    "a grid": (VOLUME, lambda p: set_cells(p, T_world_grid=np.zeros((4, 4))), "'T_world_grid' is not"),
    "a size": (VOLUME, lambda p: set_cells(p, voxel_size_m=np.asarray(-1.0)), "'voxel_size_m' is not"),
}


@pytest.mark.parametrize("name", OBJECTS)
def test_objects_are_looked_at(copy: Path, tmp_path: Path, name: str) -> None:
    file, damage, line = OBJECTS[name]
    damage(copy / file)
    with within(5, 50):
        lines = verify(seal(copy))
    assert len(lines) == 1 and lines[0].startswith(f"{file}: ") and line in lines[0], lines
    if file == MESH:
        with raises(ReleaseError, "release.damaged", match="object cannot"):
            export_bop(open_release(copy), tmp_path / "bop")


def large_png(side: int) -> bytes:
    head = b"IHDR" + struct.pack(">IIBBBBB", side, side, 16, 0, 0, 0, 0)
    chunks = (bytes(3) + b"\r" + head, bytes(4) + b"IEND")
    return b"\x89PNG\r\n\x1a\n" + b"".join(c + struct.pack(">I", zlib.crc32(c[4:])) for c in chunks)


def test_a_depth_image_of_gigabytes_is_not_unpacked(copy: Path, tmp_path: Path) -> None:
    (copy / f"views/{RECORDING}/000.depth.png").write_bytes(large_png(30000))
    with within(10, 100), raises(ReleaseError, "release.damaged", match="30000x30000"):
        export_bop(open_release(seal(copy)), tmp_path / "bop")


VIEWS = {"K": [[0.0] * 3] * 3, "width": 10**9, "height": -5}


@pytest.mark.parametrize("key", VIEWS)
def test_views_that_no_camera_took(copy: Path, tmp_path: Path, key: str) -> None:
    path = copy / f"views/{RECORDING}/views.json"
    content = json.loads(path.read_text())
    content["views"][0][key] = VIEWS[key]
    path.write_text(json.dumps(content))
    lines = verify(seal(copy))
    assert lines and all(line.startswith(f"views/{RECORDING}/views.json: ") for line in lines)
    with raises(KinectBenchError, "storage.damaged", match=f"'views.0.{key}'"):
        export_bop(open_release(copy), tmp_path / "bop")


def test_many_wrong_values_cost_little(copy: Path) -> None:
    """Each would be half a kilobyte of errors, and a kilobyte more where it is told."""
    path = copy / f"views/{RECORDING}/views.json"
    path.write_text('{"format_version": 1, "refused": [], "views": [' + "0," * 900_000 + "0]}")
    with within(10, 200):
        lines = verify(seal(copy))
    assert lines and len(lines) < 5


def header(name: str, size: int, kind: bytes = tarfile.REGTYPE) -> bytes:
    info = tarfile.TarInfo(name)
    info.type = kind
    info.size = size
    return info.tobuf(tarfile.GNU_FORMAT)


def pax(records: bytes, kind: bytes = tarfile.XHDTYPE) -> bytes:
    return header("x", len(records), kind) + records + bytes(-len(records) % 512)


def record(key: str, value: str) -> bytes:
    text = f" {key}={value}\n"
    length = len(text) + len(str(len(text)))
    return f"{length + (len(str(length)) > len(str(len(text))))}{text}".encode()


END = bytes(1024)
TARS = {
    "an endless size": pax(record("size", "9999999999999999999")) + header("a", 0) + END,
    "a size below 0": pax(record("size", "-51200")) + header("a", 0) + END,
    "back to itself": pax(record("size", "-1536")) + header("a", 0) + END,
    "no number": pax(record("size", "x" * 100)) + header("a", 0) + END,
    "a keyword without end": header("x", 1 << 33, tarfile.XHDTYPE) + END,
    "two million keywords": pax(record("a", "b") * 400_000) + header("a", 0) + END,
    "keywords for all": pax(b"".join(record(f"k{n}", "v") for n in range(2000)), tarfile.XGLTYPE)
    + header("a", 0) * 2
    + END,
    "a name without end": header("x", 1 << 33, tarfile.GNUTYPE_LONGNAME) + END,
    "a name of a name": header("x", 10, tarfile.GNUTYPE_LONGNAME) + (b"a" * 10 + bytes(502)),
    "header in header": b"".join(pax(record("a", "b")) for _ in range(2000)) + header("a", 0) + END,
    "garbage": bytes(range(256)) * 8,
}


@pytest.mark.parametrize("packed", [False, True], ids=["tar", "tar.gz"])
@pytest.mark.parametrize("name", TARS)
def test_tars_that_are_none(tmp_path: Path, name: str, packed: bool) -> None:
    import gzip

    path = tmp_path / "release.tar"
    path.write_bytes(gzip.compress(TARS[name], 1) if packed else TARS[name])
    with within(10, 50), pytest.raises(ReleaseError) as caught:
        verify(path)
    assert "\n" not in str(caught.value)


def test_zips_of_more_files_than_a_release_has(tmp_path: Path) -> None:
    row = b"PK\1\2" + bytes(24) + struct.pack("<H", 1) + bytes(16) + b"a"
    large = struct.pack("<4sQ2H2L4Q", b"PK\6\6", 44, 45, 45, 0, 0, 10**6, 10**6, 10**6 * len(row), 0)
    locator = struct.pack("<4sLQL", b"PK\6\7", 0, 10**6 * len(row), 1)
    end = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 0xFFFF, 0xFFFF, 0xFFFFFFFF, 0xFFFFFFFF, 0)
    path = tmp_path / "release.zip"
    path.write_bytes(row * 10**6 + large + locator + end)
    with within(5, 20), raises(ReleaseError, "release.damaged", match="1000000"):
        verify(path)


def test_a_zip_entry_that_unpacks_to_more_than_it_says(copy: Path, tmp_path: Path) -> None:
    path = tmp_path / "release.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(copy.rglob("*")):
            if file.is_file() and file.name != "SHA256SUMS":
                archive.write(file, file.relative_to(copy).as_posix())
        archive.writestr("SHA256SUMS", bytes(200 << 20))
    content = bytearray(path.read_bytes())
    struct.pack_into("<I", content, content.rindex(b"PK\1\2") + 24, 100)
    path.write_bytes(content)
    with within(10, 50):
        assert verify(path)[0].startswith("SHA256SUMS: ")
