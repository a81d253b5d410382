"""Read a reference mesh, from a scanner or a CAD program. The file is untrusted."""

from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

from kinectbench.core import RecordingError, printable, read_plain
from kinectbench.core.geometry import TriangleMesh, is_closed, joined_vertices
from kinectbench.core.glb_file import read_glb
from kinectbench.core.mesh_files import MAX_FILE_BYTES, read_obj, read_ply_surface

SUFFIXES = (".ply", ".obj", ".glb")
# Nothing of a room is farther away, in any unit.
FARTHEST_M = 1e6


@dataclass(frozen=True)
class Reference:
    """A reference mesh.

    Attributes:
        mesh: in a frame of its own, metres.
        closed: whether every edge has two faces, which run along it in opposite directions.
        sha256: of the file's bytes.
    """

    mesh: TriangleMesh
    closed: bool
    sha256: str


def read_reference(path: Path) -> Reference:
    """Read a mesh in metres.

    Raises:
        RecordingError: it is no readable .ply, .obj or .glb, or has no face with an area, or a vertex that is
            not finite or beyond 10^6 m.
    """
    where = printable(str(path), 300)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise RecordingError(
            f"{where}: not a mesh that is read; save it as .ply, .obj or .glb", what="bad-mesh"
        )
    try:
        content = read_plain(path, MAX_FILE_BYTES)
        if suffix == ".ply":
            points, triangles, _ = read_ply_surface(content)
        else:
            points, triangles = (read_obj if suffix == ".obj" else read_glb)(content)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise RecordingError(
            f"{where}: cannot be read as a mesh ({reason}); name a mesh (.ply, .obj or .glb)", what="bad-mesh"
        ) from error
    if not len(triangles):
        raise RecordingError(f"{where}: no mesh, as it has no faces; name one that has", what="bad-mesh")
    if not (np.abs(points) <= FARTHEST_M).all():  # nor NaN
        raise RecordingError(
            f"{where}: a vertex is not finite, or beyond {FARTHEST_M:g} m; export the mesh again",
            what="bad-mesh",
        )
    vertices, faces = joined_vertices(points, triangles.astype(np.int32))
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    if not np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() > 0:
        raise RecordingError(f"{where}: its faces have no area; export the mesh again", what="bad-mesh")
    return Reference(TriangleMesh(vertices, faces), is_closed(faces), sha256(content).hexdigest())
