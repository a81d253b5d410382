"""Random bytes for the readers of predictions, by Hypothesis, and what a reader owes whoever calls it.

Good files cut, joined and overwritten; npy headers that claim anything; archives of any number of entries,
names and flags; meshes of random vertices and faces. Each is read as a grid in [0, 1] or refused in one line.
"""

import io
import zipfile
from pathlib import Path

import numpy as np
import trimesh
from hypothesis import strategies as st

from kinectbench.core.errors import PredictionError
from kinectbench.scoring.prediction_file import load_prediction

VOXEL_M = 0.004
MAX_LINE = 300
KINDS = ("npy", "npz", "ply", "obj")
DTYPES = ("<f2", ">f2", "<f4", ">f4", "|b1", "|u1", "<f8", "<i4", "<c8", "|O", "|S8", "<M8[s]", "f2,f2", "")
FILE = tuple[str, bytes]

BOX = trimesh.creation.box(bounds=[[0.1, 0.2, 0.3], [0.5, 0.4, 0.9]])


def good_files() -> list[FILE]:
    """A small file of each kind that is accepted."""
    small = np.random.default_rng(0).random((5, 5, 5)).astype(np.float16)
    plain, packed, coded = io.BytesIO(), io.BytesIO(), io.BytesIO()
    np.save(plain, small)
    np.savez_compressed(packed, small)
    np.savez_compressed(coded, levels=small[0, 0], codes=(small * 5).astype(np.uint8))
    text = BOX.export(file_type="obj")
    grids = [("npy", plain.getvalue()), ("npz", packed.getvalue()), ("npz", coded.getvalue())]
    return [*grids, ("ply", BOX.export(file_type="ply")), ("obj", text.encode())]


@st.composite
def spliced(draw: st.DrawFn) -> FILE:
    """A good file with a part of it replaced, or its end lost."""
    kind, content = draw(st.sampled_from(good_files()))
    first, second = sorted(draw(st.integers(0, len(content))) for _ in "ab")
    rest = content[second:] if draw(st.booleans()) else b""
    return kind, content[:first] + draw(st.binary(max_size=40)) + rest


@st.composite
def npy_bytes(draw: st.DrawFn) -> bytes:
    """A header that claims anything, and any data."""
    side = draw(st.sampled_from([0, 1, 2, 5, 8, 16, 512, 513, 10**4, 10**12, -1]))
    cube, bits = (side, side, side), (side, side, side // 8)
    odd = tuple(draw(st.lists(st.integers(-2, 2**70), max_size=5)))
    shape = draw(st.sampled_from([cube, cube, cube, bits, odd]))
    words: dict[str, object] = {
        "descr": draw(st.sampled_from([*DTYPES, draw(st.text(max_size=6))])),
        "fortran_order": draw(st.sampled_from([False, True, None, 1])),
        "shape": shape,
    }
    if draw(st.booleans()):
        words[draw(st.text(max_size=4))] = draw(st.integers() | st.none())
    text = draw(st.sampled_from([repr(words), repr(words), "(" * 3000, draw(st.text(max_size=50))]))
    header = text.encode("utf-8", "replace")
    version = draw(st.sampled_from([b"\x01\x00", b"\x02\x00", b"\x03\x00", b"\x09\x00"]))
    width = 2 if version[0] == 1 else 4
    length = draw(st.sampled_from([len(header), 0, len(header) + 1, 2 ** (8 * width) - 1]))
    wanted = int(np.prod([max(n, 0) for n in cube])) if side <= 16 else 0
    data = draw(st.binary(max_size=64)) or bytes(2 * wanted)
    npy_bytes: bytes = b"\x93NUMPY" + version + length.to_bytes(width, "little") + header + data
    return npy_bytes


@st.composite
def archives(draw: st.DrawFn) -> FILE:
    """A zip of some entries under any names, one of its bytes changed now and then."""
    buffer = io.BytesIO()
    names = st.sampled_from(["arr_0.npy", "../../x.npy", "/etc/x.npy", "a.txt", "a/b.npy"]) | st.text(
        max_size=8
    )
    kinds = st.sampled_from([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA])
    with zipfile.ZipFile(buffer, "w", draw(kinds)) as archive:
        for name in draw(st.lists(names, max_size=3, unique=True)):
            archive.writestr(zipfile.ZipInfo(name), draw(npy_bytes()), draw(kinds))
    content = bytearray(buffer.getvalue())
    for _ in range(draw(st.integers(0, 3))):
        content[draw(st.integers(0, len(content) - 1))] = draw(st.integers(0, 255))
    return "npz", bytes(content)


@st.composite
def meshes(draw: st.DrawFn) -> FILE:
    """Random corners and faces, in either format."""
    number = st.sampled_from([0, 0.1, 0.5, 1, -3, 1e9, 1e300, float("nan"), float("inf")])
    corners = draw(st.lists(st.tuples(number, number, number), max_size=8))
    index = st.integers(-2, len(corners) + 1)
    faces = draw(st.lists(st.lists(index, min_size=1, max_size=5), max_size=12))
    if draw(st.booleans()):
        lines = [f"v {x} {y} {z}" for x, y, z in corners]
        lines += ["f " + " ".join(map(str, face)) for face in faces]
        lines += draw(st.lists(st.text(max_size=20), max_size=3))
        lines += draw(
            st.lists(st.sampled_from(["mtllib ../x.mtl", "usemtl a", "o b", "vn 0 0 1"]), max_size=2)
        )
        return "obj", "\n".join(lines).encode("utf-8", "replace")
    claimed = [draw(st.sampled_from([len(found), 0, 10**11, -1])) for found in (corners, faces)]
    head = f"ply\nformat ascii 1.0\nelement vertex {claimed[0]}\nproperty float x\nproperty float y\n"
    head += (
        f"property float z\nelement face {claimed[1]}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    body = [" ".join(map(str, corner)) for corner in corners]
    body += [" ".join(map(str, [len(face), *face])) for face in faces]
    return "ply", (head + "\n".join(body)).encode()


FILES = spliced() | archives() | meshes() | npy_bytes().map(lambda b: ("npy", b)) | st.tuples(
    st.sampled_from(KINDS), st.binary(max_size=200)
)  # fmt: skip


def read_one(path: Path, content: bytes) -> bool:
    """Whether a file is read; a refusal must be one short line, a grid one of values in [0, 1]."""
    path.write_bytes(content)
    try:
        loaded = load_prediction(path, "fuzz", VOXEL_M)
    except PredictionError as error:
        line = str(error)
        assert line.startswith("fuzz: ") and "\n" not in line and len(line) < MAX_LINE, line
        return False
    assert loaded.ndim == 3 and len(set(loaded.shape)) == 1
    assert loaded.dtype in (np.bool_, np.float16, np.float32) and 0 <= loaded.min() <= loaded.max() <= 1
    return True
