"""Check that the mesh, volume and GLB of a recording's object are valid files, as docs/format.md defines."""

import json
import struct
from collections.abc import Iterator
from typing import IO

import numpy as np

from kinectbench.core import ReleaseError, printable, strict_json
from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import TriangleMesh, is_rigid, parse_ply, transform_points
from kinectbench.core.mesh_files import read_ply
from kinectbench.core.types import Arrays, Float64
from kinectbench.core.voxels.npy import NpyHeader, read_npy, read_npy_header
from kinectbench.core.voxels.npz import NPY, UNREADABLE, open_npz
from kinectbench.core.voxels.pair_file import as_float64
from kinectbench.release.contents import GLB, OBJECT_FILES, VOLUME_BYTES, Contents, surface_name
from kinectbench.release.publish.object_glb import T_GLTF_FLOOR

MESH = OBJECT_FILES[0]
SLAB_BYTES = 1 << 20
MOST_SMALL_BYTES = 4096
KINDS: dict[str, np.dtype[np.generic]] = {
    "solid": np.dtype(np.bool_),
    "labels": np.dtype(np.uint8),
    "probability": np.dtype(np.float16),
    "underside": np.dtype(np.bool_),
}
OPTIONAL = "underside"
# Head of a GLB: magic, version, length; then length and kind of the first chunk. A chunk's head has eight
# bytes (glTF 2.0, section 4.4).
GLB_HEAD, GLB_VERSION = struct.Struct("<4sIII4s"), 2
CHUNK_HEAD_BYTES = 8
# Largest difference of boxes, as a share of the longest side. 26 GLBs, which have fewer triangles than their
# meshes, differed by at most 0.03 %.
MOST_BOX_SHARE = 0.005
GRID_KEYS = ("voxel_size_m", "T_world_grid")


def object_problems(contents: Contents, name: str) -> Iterator[str]:
    """Yield a message if a mesh.ply, a volume.npz or a GLB of a release is not a valid file of its kind.

    Args:
        contents: the release.
        name: `objects/<recording>/mesh.ply`, `volume.npz` beside it, or `objects/<recording>.glb`.
    """
    try:
        if name.endswith(GLB):
            if fault := _glb_fault(contents.read(name)):
                yield f"{name}: {fault}"
            return
        if name.endswith(".ply"):
            if not len(parse_ply(contents.read(name)).faces):
                yield f"{name}: has no faces"
            return
        with contents.stream(name) as file:
            fault = _volume_fault(file)
        if fault:
            yield f"{name}: {fault}"
    except ReleaseError as error:
        yield str(error)
    except UNREADABLE as error:
        yield f"{name}: cannot be read ({error})"


def recording_of(name: str) -> str:
    """Return the id of the recording to which a file in `objects/` belongs."""
    part, folder, _ = name.removeprefix("objects/").partition("/")
    return part if folder else part.removesuffix(GLB)


def _glb_fault(content: bytes) -> str | None:
    """Return a message if the header or JSON chunk of a GLB is invalid, else None; the rest is not checked.

    Source: glTF 2.0 (ISO/IEC 12113:2022), section 4.4.
    """
    if len(content) < GLB_HEAD.size:
        return "cut short in its head"
    magic, version, length, json_bytes, kind = GLB_HEAD.unpack_from(content)
    if magic != b"glTF" or version != GLB_VERSION or kind != b"JSON":
        return "not a binary glTF 2.0 file"
    if length != len(content) or GLB_HEAD.size + json_bytes > length:
        return f"{len(content)} bytes where its head claims {length}"
    try:
        header = strict_json(content[GLB_HEAD.size :][:json_bytes].decode())
    except (ValueError, RecursionError) as error:
        return f"what it says of itself is not valid JSON ({error})"
    if not isinstance(header, dict) or not header.get("meshes"):
        return "holds no mesh"
    if '"uri": ' in json.dumps(header):  # a key, of a buffer, an image or an extension
        return "names other files by a URI, which whoever shows it would open"
    return None


def glb_faults(content: bytes, mesh: TriangleMesh, T_floor_world: Float64) -> Iterator[str]:
    """Yield a message for each difference between a GLB and its mesh.

    Two facts are compared, because a GLB may have fewer triangles than its mesh: the bounding box, and the
    number of triangles in mesh.ply, which the GLB states.

    Args:
        content: bytes of the GLB; a damaged one gives a message.
        mesh: mesh.ply, world frame, metres.
        T_floor_world: (4, 4) of the recording's floor.
    """
    json_end = GLB_HEAD.size + GLB_HEAD.unpack_from(content)[3]
    try:
        header = strict_json(content[GLB_HEAD.size : json_end].decode())
        (shown,) = header["meshes"]
        accessor = header["accessors"][shown["primitives"][0]["attributes"]["POSITION"]]
        begin = int(header["bufferViews"][accessor["bufferView"]].get("byteOffset", 0))
        begin += json_end + CHUNK_HEAD_BYTES + int(accessor.get("byteOffset", 0))
        glb_vertices = np.frombuffer(content, "<f4", 3 * int(accessor["count"]), begin).reshape(-1, 3)
        triangles = shown["extras"]["triangles_of_mesh_ply"]
        low, high = glb_vertices.min(axis=0), glb_vertices.max(axis=0)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, RecursionError):
        yield "not as this package writes it"
        return
    if triangles != len(mesh.faces):
        yield f"is of a mesh of {printable(str(triangles), 20)} triangles where {MESH} has {len(mesh.faces)}"
    vertices = transform_points(T_GLTF_FLOOR @ T_floor_world, mesh.vertices)
    apart_m = max(np.abs(low - vertices.min(axis=0)).max(), np.abs(high - vertices.max(axis=0)).max())
    if not apart_m <= MOST_BOX_SHARE * np.ptp(vertices, axis=0).max():
        yield f"the box around it is {apart_m:.3g} m from that of {MESH}"


def _volume_fault(file: IO[bytes]) -> str | None:
    """Return a message on a volume.npz's fault; None if it has none. Grids are read in slabs to save memory.

    Raises:
        UNREADABLE: one of the exceptions in this tuple: the file is no npz, or is damaged.
    """
    with open_npz(file, VOLUME_BYTES) as archive:
        entries = {entry.filename.removesuffix(NPY): entry for entry in archive.infolist()}
        kinds = {key: kind for key, kind in KINDS.items() if key in entries or key != OPTIONAL}
        if missing := [key for key in (*kinds, *GRID_KEYS) if key not in entries]:
            return f"holds no '{missing[0]}'"
        small: Arrays = {}
        for key in GRID_KEYS:
            with archive.open(entries[key]) as stream:
                small[key] = read_npy(stream, entries[key].file_size, _check_small)
        size_m, T = small["voxel_size_m"], as_float64(small["T_world_grid"])
        if size_m.shape != () or not 0 < float(size_m) < np.inf:
            return "'voxel_size_m' is not a length in metres"
        if T.shape != (4, 4) or not is_rigid(T):
            return "'T_world_grid' is not a rotation and a shift"
        shapes = set()
        for key, kind in kinds.items():
            with archive.open(entries[key]) as stream:
                header = read_npy_header(stream)
                if len(header.shape) != 3 or header.dtype != kind:
                    return (
                        f"'{key}' is {header.dtype}{printable(str(header.shape), 60)}, not a grid of {kind}"
                    )
                shapes.add(header.shape)
                if fault := _grid_fault(key, header, stream):
                    return f"'{key}' {fault}"
        return None if len(shapes) == 1 else "its grids have different shapes"


def _check_small(header: NpyHeader) -> None:
    if header.data_bytes > MOST_SMALL_BYTES or header.dtype.kind != "f":
        raise ValueError("voxel_size_m or T_world_grid is something else")


def _grid_fault(key: str, header: NpyHeader, stream: IO[bytes]) -> str | None:
    """Return a message if a grid has invalid values or another size than its npy header states, else None."""
    done = 0
    while part := stream.read(SLAB_BYTES):
        done += len(part)
        # Slabs end between two cells, which have one or two bytes.
        raw = np.frombuffer(part, np.uint8)
        if KINDS[key] == np.bool_ and (raw > 1).any():
            return "is not of 0 and 1"
        if key == "labels" and (raw > max(Label)).any():
            return "holds labels that there are not"
        if key == "probability":
            values = raw[: len(raw) // 2 * 2].view(np.float16)
            if not ((values >= 0) & (values <= 1)).all():
                return "is not all in [0, 1]"
    if done != header.data_bytes:
        return f"has {done} bytes where its header claims {header.data_bytes}"
    return None


def surface_lines(contents: Contents, recording: str) -> list[str]:
    """Return a message if the open mesh that is a recording's truth is missing or unreadable, else []."""
    name = surface_name(recording)
    try:
        read_ply(contents.read(name))
    except (ReleaseError, ValueError) as error:
        return [str(error) if isinstance(error, ReleaseError) else f"{name}: not a readable mesh ({error})"]
    return []
