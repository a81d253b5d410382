"""Meshes of strangers: every form is the same mesh, and what would cost too much is refused in time."""

import struct
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from peak_memory import peak_mb
from raising import raises

from kinectbench.core.errors import PredictionError
from kinectbench.core.mesh_files import MAX_TRIANGLES, read_obj, read_ply
from kinectbench.scoring.mesh_prediction import MAX_MESH_BYTES
from kinectbench.scoring.prediction_file import load_prediction

VOXEL_M = 0.004
BOX = trimesh.creation.box(bounds=[[0.1, 0.2, 0.3], [0.5, 0.4, 0.9]])
# The same box with one side as a polygon of four corners.
SIDES = [[0, 1, 3], [4, 1, 0], [0, 3, 2], [2, 4, 0], [1, 7, 3], [5, 1, 4], [5, 7, 1], [3, 7, 2], [6, 4, 2]]
SIDES += [[2, 7, 6], [6, 5, 4], [7, 5, 6]]
POLYGONS = [face for face in SIDES if face not in ([0, 1, 3], [0, 3, 2])] + [[0, 1, 3, 2]]
CORNERS = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
INSIDE = b"v .1 .1 .1\nv .9 .1 .1\nv .1 .9 .1\nv .1 .1 .9\n"


def test_the_box_is_trimeshs() -> None:
    assert sorted(map(sorted, SIDES)) == sorted(sorted(map(int, face)) for face in BOX.faces)


def ply_of(vertices: NDArray[Any], faces: list[list[int]], order: str) -> bytes:
    """A .ply with more properties than are needed, in bytes of an order, or as text."""
    form = {"<": "binary_little_endian", ">": "binary_big_endian", " ": "ascii"}[order]
    header = (
        f"ply\nformat {form} 1.0\ncomment none\nelement vertex {len(vertices)}\nproperty uchar red\n"
        "property double x\nproperty float32 y\nproperty double z\n"
        f"element face {len(faces)}\nproperty short flag\nproperty list uchar float texcoord\n"
        "property list ushort int vertex_index\nproperty uchar blue\nend_header\n"
    )
    rows: list[tuple[str, tuple[Any, ...]]] = [("Bdfd", (7, *map(float, point))) for point in vertices]
    for face in faces:
        uv = [0.5] * (2 * len(face))
        rows.append((f"hB{len(uv)}fH{len(face)}iB", (3, len(uv), *uv, len(face), *face, 9)))
    if order == " ":
        return (header + "".join(" ".join(map(str, values)) + "\n" for _, values in rows)).encode()
    return header.encode() + b"".join(struct.pack(order + code, *values) for code, values in rows)


@pytest.mark.parametrize("faces", [SIDES, POLYGONS], ids=["triangles", "polygons"])
@pytest.mark.parametrize("order", ["<", ">", " "])
def test_every_ply_is_the_same_mesh(order: str, faces: list[list[int]]) -> None:
    """Lists before and behind other properties, polygons of several sizes, both orders of bytes, text."""
    vertices, triangles = read_ply(ply_of(BOX.vertices, faces, order))
    np.testing.assert_allclose(vertices, BOX.vertices, atol=1e-7)
    check_box(vertices, triangles)


@pytest.mark.parametrize("faces", [SIDES, POLYGONS], ids=["triangles", "polygons"])
def test_every_obj_is_the_same_mesh(faces: list[list[int]]) -> None:
    """Colours, textures, materials, corners counted from either end, lines that go on, Windows' line ends."""
    text = "mtllib a.mtl\r\n" + "".join(f"v\t{x} {y} {z} 0.5 0.5 0.5\r\n" for x, y, z in BOX.vertices)
    for n, face in enumerate(faces):
        corners = [f"{c - 8}/1/2" if n % 2 else f"{c + 1}//7" for c in face]
        text += f"usemtl m{n}\r\nvt 0 0\r\n  f {corners[0]} \\\r\n{' '.join(corners[1:])} \r\n"
    vertices, triangles = read_obj(text.encode())
    np.testing.assert_array_equal(vertices, BOX.vertices)
    check_box(vertices, triangles)


def check_box(vertices: NDArray[Any], triangles: NDArray[Any]) -> None:
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    assert len(triangles) == 12 and mesh.is_watertight and mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(BOX.volume, rel=1e-6)


def ply(
    vertices: int, faces: int, data: bytes, more: str = "", count: str = "uchar", form: str = ""
) -> bytes:
    """A header that claims so much, and any data."""
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    of_faces = f"element face {faces}\nproperty list {count} int vertex_indices\n"
    header = f"ply\nformat {form or 'binary_little_endian'} 1.0\n{more}element vertex {vertices}\n{axes}"
    return f"{header}{of_faces}end_header\n".encode() + data


# Made by the test that takes it: together they are 200 MB.
COSTLY: dict[str, tuple[str, Callable[[], bytes], str]] = {
    "groups": (
        "obj",
        lambda: INSIDE + b"".join(b"usemtl m%d\nf 1 2 4\n" % n for n in range(100_000)),
        "faces across each other",
    ),
    "polygon": ("obj", lambda: CORNERS + b"f " + b"1 " * 2_000_000, "a polygon of more than 1024 corners"),
    "points of faces": ("obj", lambda: CORNERS + b"f 1\n" * 3_000_000, "more than 2097152 lines"),
    "long number": ("obj", lambda: b"v " + b"1" * 10**7, "the line 'v 1111"),
    "long corner": ("obj", lambda: CORNERS + b"f 1 2 " + b"3" * 10**7, "the line 'f 1 2 333"),
    "empty lines": ("obj", lambda: b"\n" * (60 << 20), "a mesh without faces"),
    "spaces": ("obj", lambda: b" " * (60 << 20), "a mesh without faces"),
    "many vertices": ("obj", lambda: b"v 0 0 0\n" * 2_000_000, "more than 1048576 vertices"),
    "two numbers": ("obj", lambda: b"v 0 0\nv 0 1 1\n", "the line 'v 0 0'"),
    "too large": ("obj", lambda: bytes(65 << 20), "67108864 is the most accepted"),
    "many triangles": ("ply", lambda: ply(4, 2_000_000, bytes(48 + 26_000_000)), "more than 1048576 faces"),
    "claims": ("ply", lambda: ply(10**9, 10**9, bytes(99)), "claims more than the file holds"),
    "nothing claimed": ("ply", lambda: ply(3, 1, bytes(99), "element a 1000000000000\n"), "claims more than"),
    "negative": ("ply", lambda: ply(-1, 1, bytes(99)), "claims more than"),
    "elements": ("ply", lambda: ply(3, 1, bytes(99), "element a 0\n" * 6000), "a malformed header"),
    "lists of a face": (
        "ply",
        lambda: ply(4, 2**20, bytes(2**23)).replace(
            b"end_header", b"property list uchar int a\n" * 2 + b"end_header"
        ),
        "more than 2 lists or 16 properties of a face",
    ),
    "numbers of a face": (
        "ply",
        lambda: ply(4, 2**20, bytes(2**25)).replace(
            b"end_header", b"property uchar a\n" * 16 + b"end_header"
        ),
        "more than 2 lists or 16 properties of a face",
    ),
    "no first line": ("ply", lambda: b"end_header\n", "a malformed header"),
    "empty first line": ("ply", lambda: b"\nend_header\n", "a malformed header"),
    "no number for a corner": (
        "ply",
        lambda: ply(3, 1, b"0 0 0 1 0 0 0 1 0 3 0 1 nan", form="ascii"),
        "no vertex",
    ),
    "an endless corner": (
        "ply",
        lambda: ply(3, 1, b"0 0 0 1 0 0 0 1 0 3 0 1 1e300", form="ascii"),
        "no vertex",
    ),
    "long header": ("ply", lambda: b"ply\n" + b"comment\n" * 10**6, "a malformed header"),
    "long polygon": (
        "ply",
        lambda: ply(4, 1, bytes(48) + (10**7).to_bytes(4, "little") + bytes(4 * 10**7), count="int"),
        r"a polygon of 1e\+07 corners",
    ),
    "no polygon": (
        "ply",
        lambda: ply(4, 1, bytes(48) + b"\xff" * 99, count="int"),
        "a polygon of -1 corners",
    ),
    "cut off": ("ply", lambda: ply(4, 9, bytes(48) + b"\x03" * 20), "cut short in its faces"),
    "corners of no vertex": (
        "ply",
        lambda: ply(4, 1, bytes(48) + b"\x03" + b"\x09" * 12),
        "a corner that is no vertex",
    ),
    "words": ("ply", lambda: ply(4, 1, b"a " * 3_000_000, form="ascii"), "a word that is no number"),
    "few numbers": ("ply", lambda: ply(4, 1, b"1000000 " * 11, form="ascii"), "cut short in its 'vertex'"),
    "faces first": (
        "ply",
        lambda: (
            b"ply\nformat ascii 1.0\nelement face 1\n"
            b"property list uchar int vertex_index\nend_header\n3 0 0 0\n"
        ),
        "lists of 'face' before the faces",
    ),
}


@pytest.mark.parametrize("name", COSTLY)
def test_what_costs_too_much_is_refused_in_time(name: str, tmp_path: Path) -> None:
    kind, content, message = COSTLY[name]
    path = tmp_path / f"000.{kind}"
    path.write_bytes(content())
    started = time.process_time()
    with pytest.raises(PredictionError, match=message) as caught:
        load_prediction(path, "chair_01/000", VOXEL_M)
    assert time.process_time() - started < 10
    assert len(str(caught.value)) < 250 and str(caught.value).isprintable()


READ = """
import sys
from pathlib import Path
from kinectbench.scoring.prediction_file import load_prediction
assert load_prediction(Path(sys.argv[1]), None, 0.004).any()
"""


def largest(layers: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """A million triangles: so many sheets of the grid's width, and small tetrahedra."""
    sheet = trimesh.creation.box(bounds=[[0, 0, 0], [1.024, 1.024, 0.002]])
    small = trimesh.creation.box(bounds=[[0, 0, 0], [0.002] * 3])
    count = (MAX_TRIANGLES - 12 * layers) // 12
    at = np.stack(np.unravel_index(np.arange(count), (50, 50, 50)), axis=1) * 0.02 + 0.001
    corners = [(sheet.vertices[None] + np.arange(layers)[:, None, None] * [0, 0, 0.012]).reshape(-1, 3)]
    corners.append((small.vertices[None] + at[:, None]).reshape(-1, 3))
    faces = [sheet.faces + 8 * n for n in range(layers)]
    faces.append((small.faces[None] + 8 * (layers + np.arange(count)[:, None, None])).reshape(-1, 3))
    return np.concatenate(corners), np.concatenate(faces)


@pytest.mark.skipif(sys.platform != "linux", reason="memory is told by Linux's /proc")
@pytest.mark.parametrize("order", ["<", " "])
def test_the_largest_mesh_takes_less_than_500_mb(order: str, tmp_path: Path) -> None:
    """With Python and its libraries, which take 160 MB of it; in bytes, and in a text of 64 MB."""
    vertices, faces = largest(layers=25)
    if order == "<":
        rows = np.zeros(len(faces), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
        rows["count"], rows["corners"] = 3, faces
        data = vertices.astype("<f4").tobytes() + rows.tobytes()
    else:
        data = "".join(f"{x:.4g} {y:.4g} {z:.4g}\n" for x, y, z in vertices).encode()
        data += "".join(f"3 {a} {b} {c}\n" for a, b, c in faces.tolist()).encode()
    content = ply(len(vertices), len(faces), data, form="" if order == "<" else "ascii")
    path = tmp_path / "000.ply"
    path.write_bytes(content + b" " * (MAX_MESH_BYTES - len(content)))
    assert peak_mb(READ, str(path)) < 450


def test_numbers_are_split_a_piece_at_a_time() -> None:
    points = np.random.default_rng(0).random((60_000, 3))
    text = "".join(f"{x!r} {y!r}\n{z!r}\t" for x, y, z in points.tolist()).encode()
    content = ply(len(points), 1, text + b" " * (3 << 20) + b"3 0 1 2", form="ascii")
    assert len(text) > 3 << 20
    vertices, triangles = read_ply(content)
    np.testing.assert_array_equal(vertices, points)
    np.testing.assert_array_equal(triangles, [[0, 1, 2]])
    with pytest.raises(ValueError, match="more than 12582912 numbers"):
        read_ply(ply(3, 1, b"0 " * (13 << 20), form="ascii"))


@pytest.mark.parametrize("seed", range(60))
def test_a_mesh_is_closed_as_trimesh_says(seed: int, tmp_path: Path) -> None:
    """Spheres and boxes, whole, or with a face lost, turned or added; corners at one place, or shared."""
    random = np.random.default_rng(seed)
    mesh = [BOX, trimesh.creation.icosphere(2, 0.3).apply_translation([0.5] * 3)][seed % 2].copy()
    vertices, faces = mesh.vertices, mesh.faces.copy()
    at = random.integers(len(faces))
    change = seed // 2 % 6
    if change == 1:
        faces = np.delete(faces, at, axis=0)
    elif change == 2:
        faces[at] = faces[at, ::-1]
    elif change == 3:
        faces = np.concatenate([faces, faces[[at]]])
    elif change == 4:
        faces = np.concatenate([faces, faces[[at], ::-1]])
    elif change == 5:
        faces = np.concatenate([faces, faces + len(vertices)])
        vertices = np.concatenate([vertices, 0.5 * vertices])
    if random.random() < 0.5:
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
        vertices = vertices + random.choice([-1e-10, 0, 1e-10], vertices.shape)
    expected = trimesh.Trimesh(vertices, faces, process=False)
    expected.merge_vertices()
    text = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in vertices.tolist())
    text += "".join(f"f {a} {b} {c}\n" for a, b, c in (faces + 1).tolist())
    (tmp_path / "000.obj").write_text(text)
    if expected.is_watertight and expected.is_winding_consistent:
        assert load_prediction(tmp_path / "000.obj", "a", VOXEL_M).any()
        return
    with raises(PredictionError, "prediction.open-mesh"):
        load_prediction(tmp_path / "000.obj", "a", VOXEL_M)
