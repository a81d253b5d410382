"""How flat the faces of a box-shaped object are in a mesh of it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import OrientedBox, invert_rigid, transform_points

REACH_M = 0.025
EDGE_M = 0.030
SIDES = {"top": (2, 1), "+x": (0, 1), "-x": (0, -1), "+y": (1, 1), "-y": (1, -1)}


@dataclass(frozen=True)
class Face:
    """One face, as a plane fitted to the vertices near one side of the box.

    Attributes:
        side: "top", "+x", "-x", "+y" or "-y", in the box's frame.
        vertices: how many there are.
        rms_m: of their distances from the plane of least squares, all of them, metres.
        trimmed_rms_m: the same after leaving out, repeatedly, what is farther than 3 robust deviations.
        kept: share of the vertices that is left then.
    """

    side: str
    vertices: int
    rms_m: float
    trimmed_rms_m: float
    kept: float


def measure_faces(
    vertices_world: NDArray[np.float64], box: OrientedBox, T_floor_world: NDArray[np.float64]
) -> list[Face]:
    """The top and the four sides of a box-shaped object.

    A face has the vertices within 25 mm of its side of the box that are at least 30 mm from the planes
    of the other sides (of the floor too, for the four).

    Args:
        vertices_world: (n, 3) of a mesh, metres.
        box: around the object, floor frame.
        T_floor_world: (4, 4).
    """
    T_box_world = invert_rigid(box.T_floor_box) @ T_floor_world
    points = transform_points(T_box_world, vertices_world)
    half = np.array(box.size_m) / 2
    within = np.abs(points) <= half - EDGE_M
    faces = []
    for side, (axis, sign) in SIDES.items():
        others = within[:, [a for a in range(3) if a != axis]].all(axis=1)
        near = np.abs(sign * points[:, axis] - half[axis]) <= REACH_M
        faces.append(_face(side, points[others & near]))
    return faces


def _face(side: str, points: NDArray[np.float64]) -> Face:
    if len(points) < 100:
        return Face(side, len(points), float("inf"), float("inf"), 0.0)
    distances = _plane_distances(points, points)
    kept = np.ones(len(points), bool)
    for _ in range(10):
        found = _plane_distances(points, points[kept])
        deviation = 1.4826 * np.median(np.abs(found[kept]))
        kept = np.abs(found) <= 3 * deviation
    trimmed = _plane_distances(points[kept], points[kept])
    return Face(side, len(points), _rms(distances), _rms(trimmed), float(kept.mean()))


def _plane_distances(points: NDArray[np.float64], fitted: NDArray[np.float64]) -> NDArray[np.float64]:
    """Signed distances (n,) from the plane of least squares through `fitted`."""
    centre = fitted.mean(axis=0)
    normal = np.linalg.eigh(np.cov((fitted - centre).T))[1][:, 0]
    distances: NDArray[np.float64] = (points - centre) @ normal
    return distances


def _rms(distances: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(distances**2)))
