"""Triangle meshes as values."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry.box import OrientedBox
from kinectbench.geometry.rigid import transform_points

# Two triangles a side, by the order of `OrientedBox.corners_floor`.
BOX_FACES = np.array(
    [
        [0, 2, 6],
        [6, 4, 0],
        [0, 4, 5],
        [5, 1, 0],
        [4, 6, 5],
        [5, 6, 7],
        [3, 2, 0],
        [0, 1, 3],
        [3, 6, 2],
        [7, 6, 3],
        [1, 5, 3],
        [3, 5, 7],
    ],
    dtype=np.int32,
)


@dataclass(frozen=True)
class TriangleMesh:
    """Triangles over shared vertices.

    Attributes:
        vertices: (n, 3) float64, metres, in the frame its owner says (`world` if not said).
        faces: (m, 3) int32, counter-clockwise seen from outside.
        colors: (n, 3) uint8 RGB, or None.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    colors: NDArray[np.uint8] | None = None

    @property
    def volume_m3(self) -> float:
        """Volume enclosed by a closed mesh (divergence theorem), cubic metres."""
        a, b, c = (self.vertices[self.faces[:, corner]] for corner in range(3))
        return float((a * np.cross(b, c)).sum() / 6.0)

    def keep_faces(self, mask: NDArray[np.bool_]) -> "TriangleMesh":
        """The mesh of the faces where mask (m,) is true, without vertices that no face uses."""
        faces = self.faces[mask]
        used = np.zeros(len(self.vertices), dtype=bool)
        used[faces] = True
        renumber = np.cumsum(used, dtype=np.int32) - 1
        colors = None if self.colors is None else self.colors[used]
        return TriangleMesh(self.vertices[used], renumber[faces], colors)

    def transformed(self, T: NDArray[np.float64]) -> "TriangleMesh":
        """The mesh with its vertices mapped by a rigid transform (4, 4)."""
        return replace(self, vertices=transform_points(T, self.vertices))


def join(meshes: Sequence[TriangleMesh]) -> TriangleMesh:
    """One mesh of all the triangles of several, one after the other; colours are left out."""
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=True)]
    return TriangleMesh(
        np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces).astype(np.int32)
    )


def box_mesh(box: OrientedBox) -> TriangleMesh:
    """The closed mesh of a box, in the frame of the box's centre (z up), metres."""
    corners = box.corners_floor()
    return TriangleMesh(corners, BOX_FACES)
