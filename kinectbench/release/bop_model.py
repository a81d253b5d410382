"""An object's mesh as a BOP model: millimetres, z up, the origin in the middle of its box."""

import io
import json
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.errors import ReleaseError
from kinectbench.geometry import TriangleMesh, invert_rigid, rigid
from kinectbench.mesh_file import parse_ply
from kinectbench.release.release import Release

MM_PER_M = 1000.0
# Rows of distances that are held at once.
CHUNK = 512


@dataclass(frozen=True)
class BopModel:
    """An object in the world, and BOP's model frame in it.

    Attributes:
        mesh: closed, world frame, metres.
        T_world_model: (4, 4); the model frame has the floor's axes, z up, and its origin in the middle of
            the mesh's box in them; metres.
    """

    mesh: TriangleMesh
    T_world_model: NDArray[np.float64]

    @property
    def mesh_mm(self) -> TriangleMesh:
        """The mesh in the model frame, millimetres."""
        mesh = self.mesh.transformed(invert_rigid(self.T_world_model))
        return TriangleMesh(mesh.vertices * MM_PER_M, mesh.faces)


def read_model(release: Release, recording: str) -> BopModel:
    """The object of a recording.

    Raises:
        ReleaseError: its files are missing or damaged.
    """
    folder = f"objects/{recording}"
    try:
        mesh = parse_ply(io.BytesIO(release.content(f"{folder}/mesh.ply")))
        floor = json.loads(release.content(f"{folder}/floor.json"))
        T_floor_world = np.array(floor["T_floor_world"], dtype=np.float64).reshape(4, 4)
    except (ValueError, KeyError, IndexError, AttributeError, TypeError) as error:
        raise ReleaseError(f"{release.folder / folder}: the object cannot be read ({error})") from error
    vertices_floor = mesh.transformed(T_floor_world).vertices
    middle = (vertices_floor.min(axis=0) + vertices_floor.max(axis=0)) / 2
    return BopModel(mesh, invert_rigid(T_floor_world) @ rigid(np.eye(3), middle))


def model_ply(mesh: TriangleMesh) -> bytes:
    """A binary PLY file with vertex normals, float and int as the toolkit's reader knows them."""
    import trimesh

    shell = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    return bytes(trimesh.exchange.ply.export_ply(shell, vertex_normal=True))


def model_info(mesh: TriangleMesh) -> dict[str, float]:
    """A row of models_info.json: the largest distance between two vertices, and the box; the mesh's unit."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    info = {"diameter": _diameter(mesh.vertices)}
    info |= {f"min_{axis}": float(value) for axis, value in zip("xyz", low, strict=True)}
    return info | {f"size_{axis}": float(value) for axis, value in zip("xyz", high - low, strict=True)}


def _diameter(vertices: NDArray[np.float64]) -> float:
    """The largest distance between two of the points, which are corners of the convex hull."""
    from scipy.spatial import ConvexHull
    from scipy.spatial.distance import cdist

    corners = vertices[ConvexHull(vertices).vertices]
    return max(float(cdist(corners[i : i + CHUNK], corners).max()) for i in range(0, len(corners), CHUNK))
