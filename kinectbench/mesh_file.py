"""Triangle meshes as binary PLY, by trimesh."""

from pathlib import Path
from typing import IO

import numpy as np

from kinectbench.errors import StorageError
from kinectbench.geometry import TriangleMesh


def write_ply(mesh: TriangleMesh, path: Path) -> None:
    """Write vertices (float32, metres), faces and colours; the same bytes for the same mesh."""
    import trimesh

    shell = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=mesh.colors, process=False)
    path.write_bytes(trimesh.exchange.ply.export_ply(shell, vertex_normal=False))


def read_ply(path: Path) -> TriangleMesh:
    """Read a mesh that `write_ply` wrote; colours are left out.

    Raises:
        StorageError: the file is missing or damaged.
    """
    try:
        with path.open("rb") as file:
            return parse_ply(file)
    except (OSError, ValueError, KeyError, IndexError, AttributeError) as error:
        raise StorageError(
            f"{path}: not a readable mesh ({error}); `kinectbench build --force` makes it again"
        ) from error


def parse_ply(file: IO[bytes]) -> TriangleMesh:
    """Read a mesh from an open PLY file; colours are left out.

    Raises:
        ValueError, KeyError, IndexError, AttributeError: it is damaged.
    """
    import trimesh

    loaded = trimesh.load(file, file_type="ply", process=False, force="mesh")
    vertices = np.asarray(loaded.vertices, dtype=np.float64)
    return TriangleMesh(vertices, np.asarray(loaded.faces, dtype=np.int32))
