"""Write `objects/<recording>.glb`: a small version of an object for viewers; the truth is mesh.ply.

Binary glTF 2.0, written by trimesh: metres, y up, the floor at y = 0. If mesh.ply has more triangles than a
viewer needs, the GLB has fewer, and states the distance of its surface from mesh.ply.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from kinectbench.core.artefacts.object import FloorFile
from kinectbench.core.geometry import TriangleMesh, decimated, read_own_ply, surface_distances_m
from kinectbench.core.turntable import surface_colors
from kinectbench.core.types import MM_PER_M, Float64, Rgb
from kinectbench.release.contents import GLB, MOST_GLB_BYTES, OBJECT_FILES

# The mesh of the whole scene in a build folder.
SCENE = "reconstruction/mesh.ply"
# Largest number of triangles: 24 bytes each in a closed mesh, 1.44 MB in all. Smallest: of a closed mesh.
MOST_TRIANGLES, LEAST_TRIANGLES = 60_000, 4
# Keeps x; z becomes y.
T_GLTF_FLOOR = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
# Number of vertices whose distance is measured; all of 60,000 triangles took half the file's time.
MEASURED = 5000
# Decimals of texts in the file: of matrices, and of millimetres.
MATRIX_DECIMALS, MM_DECIMALS = 12, 3


def write_glbs(folder: Path, recordings: Iterable[str], scenes: Path | None = None) -> None:
    """Write a GLB for each recording with a mesh.ply in the release; held-back recordings have none.

    Scene meshes in `scenes` (`build/`) give the objects' colours; None if no colour is published.

    Raises:
        StorageError: a mesh or a floor is damaged.
    """
    for name in recordings:
        objects = folder / "objects"
        if not (objects / name / OBJECT_FILES[0]).is_file():
            continue
        mesh = read_own_ply(objects / name / OBJECT_FILES[0])
        floor = FloorFile.read_if_there(objects / name)
        T_floor_world = np.eye(4) if floor is None else floor.T_floor_world
        content = glb_bytes(mesh, T_floor_world, colored_scene(scenes and scenes / name))
        if content is not None:
            (objects / f"{name}{GLB}").write_bytes(content)


def colored_scene(built: Path | None) -> TriangleMesh | None:
    """Read a recording's scene mesh with colours, world frame; None if there is no such mesh or no colour.

    `built` is `build/<recording>/`.
    """
    path = built and built / SCENE
    scene = read_own_ply(path, colors=True) if path and path.is_file() else None
    return scene if scene and scene.colors is not None else None


def glb_bytes(mesh: TriangleMesh, T_floor_world: Float64, scene: TriangleMesh | None = None) -> bytes | None:
    """Return an object's mesh as a GLB of at most 2 MB; the bytes are reproducible.

    The result is None if the mesh has no triangle, or has too many and cannot be simplified, because its
    triangles share no vertices.

    Args:
        mesh: the object, world frame, metres.
        T_floor_world: (4, 4), to the floor frame: z up, floor at z = 0.
        scene: coloured mesh, world frame, which gives the vertices their colours; None: no colours.
    """
    T_gltf_world = T_GLTF_FLOOR @ T_floor_world
    most = MOST_TRIANGLES
    while most >= LEAST_TRIANGLES and len((shown := decimated(mesh, most)).faces):
        colors = None if scene is None else surface_colors(shown.vertices, scene).astype(np.uint8)
        content = _glb(mesh, shown, T_gltf_world, colors)
        if len(content) <= MOST_GLB_BYTES:
            return content
        most //= 2  # an open mesh has more vertices
    return None


def _glb(whole: TriangleMesh, shown: TriangleMesh, T_gltf_world: Float64, colors: Rgb | None) -> bytes:
    import trimesh

    extras = {
        "T_gltf_world": np.round(T_gltf_world, MATRIX_DECIMALS).tolist(),
        "triangles": len(shown.faces),
        "triangles_of_mesh_ply": len(whole.faces),
        "from_mesh_ply_mm": _apart_mm(whole, shown),
        "to_mesh_ply_mm": _apart_mm(shown, whole),
    }
    placed = shown.transformed(T_gltf_world)
    shell = trimesh.Trimesh(
        placed.vertices,
        placed.faces,
        vertex_normals=placed.vertex_normals,
        vertex_colors=colors,
        process=False,
        metadata=extras,
    )
    return bytes(trimesh.exchange.gltf.export_glb(shell, include_normals=True))


def _apart_mm(of: TriangleMesh, to: TriangleMesh) -> dict[str, float]:
    """Return {"mean", "max"} of the distances from vertices of `of` to the surface of `to`, millimetres.

    Between `MEASURED` and 2 x `MEASURED` vertices are used, evenly spaced by index; if there are fewer, all.
    """
    if of is to:
        return {"mean": 0.0, "max": 0.0}
    measured = of.vertices[:: max(1, len(of.vertices) // MEASURED)]
    found_mm = surface_distances_m(measured, to).astype(np.float64) * MM_PER_M
    return {
        "mean": round(float(found_mm.mean()), MM_DECIMALS),
        "max": round(float(found_mm.max()), MM_DECIMALS),
    }
