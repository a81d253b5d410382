"""Read the triangles of an untrusted .glb: glTF 2.0 in its binary form, in the frame of its scene.

Only the shape is read: nodes with their transforms, and triangles of meshes with float32 positions and
plain indices. Each size is checked against the file before use. Source: the glTF 2.0 specification
(Khronos), sections 3.5 to 3.7 and 4.4.
"""

import json
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import rigid, rotation_from_quaternion_xyzw, transform_points
from kinectbench.core.mesh_files import MAX_TRIANGLES, MAX_VERTICES, Triangles
from kinectbench.core.types import Float64
from kinectbench.core.untrusted_text import strict_json

JSON_CHUNK, BIN_CHUNK = 0x4E4F534A, 0x004E4942
# Limit of values in the JSON part; the files of generators have some hundred (chosen here).
MOST_VALUES = 100_000
# Limits of the depth of nested nodes, and of the number of nodes (chosen here).
DEEPEST, MOST_NODES = 32, 1000
TRIANGLES_MODE, STRIP_AND_FAN_MODES = 4, (5, 6)
Types = dict[int, np.dtype[np.generic]]
# glTF's component types for indices.
INDICES: Types = {5121: np.dtype("u1"), 5123: np.dtype("<u2"), 5125: np.dtype("<u4")}
POSITIONS: Types = {5126: np.dtype("<f4")}


def read_glb(content: bytes) -> Triangles:
    """Read the vertices (n, 3) and triangles (m, 3) of all meshes of the default scene, y up.

    Raises:
        ValueError: the file is damaged, claims more than it holds, is compressed, has no triangle, or has too
            many nodes, vertices or triangles.
    """
    not_a_scene = KeyError, IndexError, TypeError, AttributeError, RecursionError, OverflowError
    try:
        gltf, binary = _chunks(content)
        with np.errstate(all="ignore"):  # callers check that points are finite
            parts = list(_parts(gltf, binary))
    except (*not_a_scene, json.JSONDecodeError) as error:
        raise ValueError("its JSON part is not that of a glTF 2.0 scene") from error
    if not parts:
        raise ValueError("a scene without triangles")
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    faces = [faces + offset for (_, faces), offset in zip(parts, offsets, strict=True)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def _chunks(content: bytes) -> tuple[dict[str, Any], bytes]:
    """Split a file into the JSON part and the binary part."""
    if len(content) < 20 or content[:4] != b"glTF" or struct.unpack_from("<I", content, 4)[0] != 2:
        raise ValueError("not a binary glTF 2.0 file")
    chunks, position = dict[int, bytes](), 12
    while position + 8 <= len(content) and len(chunks) < 2:
        length, kind = struct.unpack_from("<2I", content, position)
        if position + 8 + length > len(content):
            raise ValueError("cut short; write it again")
        chunks[kind] = content[position + 8 : position + 8 + length]
        position += 8 + length
    gltf = strict_json(chunks.get(JSON_CHUNK, b"").decode("utf-8"), MOST_VALUES)
    if not isinstance(gltf, dict):
        raise TypeError("no object")
    return gltf, chunks.get(BIN_CHUNK, b"")


def _parts(gltf: dict[str, Any], binary: bytes) -> Iterator[Triangles]:
    """Yield the vertices (in the scene's frame) and the triangles of each primitive."""
    vertices_left, triangles_left = MAX_VERTICES, MAX_TRIANGLES
    for mesh, T_scene_node in _placed(gltf):
        for primitive in gltf["meshes"][_index(mesh)]["primitives"]:
            if primitive.get("extensions"):
                raise ValueError("compressed geometry; write it without compression")
            mode = primitive.get("mode", TRIANGLES_MODE)
            if mode in STRIP_AND_FAN_MODES:
                raise ValueError("strips or fans of triangles; write plain triangles")
            if mode != TRIANGLES_MODE:
                continue
            vertices = _array(gltf, binary, primitive["attributes"]["POSITION"], POSITIONS, "VEC3", 3)
            if "indices" in primitive:
                corners = _array(gltf, binary, primitive["indices"], INDICES, "SCALAR", 1).astype(np.int64)
            else:
                corners = np.arange(len(vertices))
            faces = corners.ravel()[: len(corners) // 3 * 3].reshape(-1, 3)
            vertices_left, triangles_left = vertices_left - len(vertices), triangles_left - len(faces)
            if vertices_left < 0 or triangles_left < 0:
                raise ValueError(f"more than {MAX_TRIANGLES} vertices or triangles; simplify the mesh")
            if len(faces) and faces.max() >= len(vertices):
                raise ValueError("a face has a corner that is no vertex; write the mesh again")
            yield transform_points(T_scene_node, vertices), faces


def _placed(gltf: dict[str, Any]) -> Iterator[tuple[int, Float64]]:
    """Yield (mesh index, T_scene_node) of each node with a mesh in the default scene.

    Without scenes, every mesh of the file is yielded with the identity.
    """
    if not gltf.get("scenes"):
        yield from ((number, np.eye(4)) for number in range(len(gltf.get("meshes", ()))))
        return
    roots = gltf["scenes"][_index(gltf.get("scene", 0))].get("nodes", ())
    waiting, seen = [(node, np.eye(4), 0) for node in roots], 0
    while waiting:
        node, T_scene_parent, depth = waiting.pop()
        seen += 1
        if seen > MOST_NODES or depth > DEEPEST:
            raise ValueError(f"more than {MOST_NODES} nodes, or {DEEPEST} below each other; write one mesh")
        facts = gltf["nodes"][_index(node)]
        T_scene_node = T_scene_parent @ _T_parent_node(facts)
        if "mesh" in facts:
            yield facts["mesh"], T_scene_node
        waiting += [(child, T_scene_node, depth + 1) for child in facts.get("children", ())]


def _T_parent_node(facts: dict[str, Any]) -> Float64:
    """Return a node's transform (4, 4) to its parent, given by columns or as scale, rotation, translation."""
    if "matrix" in facts:
        return np.array(facts["matrix"], dtype=np.float64).reshape(4, 4).T
    rotation = rotation_from_quaternion_xyzw(np.array(facts.get("rotation", (0, 0, 0, 1)), float).reshape(4))
    T = rigid(rotation, np.array(facts.get("translation", (0, 0, 0)), float).reshape(3))
    T[:3, :3] *= np.array(facts.get("scale", (1, 1, 1)), float).reshape(3)
    return T


def _array(
    gltf: dict[str, Any], binary: bytes, number: object, types: Types, kind: str, width: int
) -> NDArray[Any]:
    """Read the values of an accessor, (count, width), from the binary part."""
    accessor = gltf["accessors"][_index(number)]
    if accessor["componentType"] not in types or accessor["type"] != kind or "sparse" in accessor:
        raise ValueError("positions or indices of an uncommon type; write float32 and plain indices")
    view = gltf["bufferViews"][_index(accessor["bufferView"])]
    dtype = types[accessor["componentType"]]
    row = dtype.itemsize * width
    stride = _index(view.get("byteStride", row))
    start = _index(view.get("byteOffset", 0)) + _index(accessor.get("byteOffset", 0))
    count = _index(accessor["count"])
    end = start + stride * (count - 1) + row
    if _index(view.get("buffer", 0)) != 0 or stride < row or (count and end > len(binary)):
        raise ValueError("its JSON part claims more than the file holds; write it again")
    if not count:
        return np.zeros((0, width), dtype)
    # Other values may lie between the rows.
    values = np.frombuffer(binary, np.uint8, end - start, start)
    rows = np.lib.stride_tricks.as_strided(values, (count, row), (stride, 1), writeable=False)
    return np.ascontiguousarray(rows).view(dtype)


def _index(value: object) -> int:
    """Check that a value is a whole number >= 0, and return it."""
    if type(value) is not int or value < 0:
        raise TypeError("not an index")
    return value
