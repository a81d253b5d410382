"""Rendering pictures of the built and of the true mesh, coloured by how far each is from the other."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from kinectbench.evaluate.surface import Surface
from kinectbench.geometry import TriangleMesh
from kinectbench.report.pictures import LIGHT, PAPER, Mesh, Viewpoint, cast, fit_viewpoint, look_along

Float64 = NDArray[np.float64]
Rgb = NDArray[np.uint8]
# Maps distances (n,) in metres to colours (n, 3) in [0, 1].
Colors = Callable[[Float64], Float64]

SIZE_PX = 320
SUPERSAMPLING = 2
UP = np.array([0.0, 0.0, 1.0])
# Two looks from a person's height and one from below: degrees.
LOOKS_DEG = ((-50.0, 24.0), (130.0, 24.0), (-50.0, -35.0))


def viewpoints(points_object: Float64) -> list[Viewpoint]:
    """The looks at an object (points (n, 3), frame `object`: z up) that all its pictures share."""
    found = []
    for azimuth, elevation in np.radians(LOOKS_DEG):
        level = np.array([-np.cos(azimuth), -np.sin(azimuth), 0.0])
        forward = np.cos(elevation) * level - np.sin(elevation) * UP
        found.append(fit_viewpoint(points_object, look_along(forward, UP)))
    return found


def render_errors(
    mesh: TriangleMesh, other: Surface, viewpoint: Viewpoint, signed: bool, colors: Colors
) -> Rgb:
    """Draw a mesh, each point coloured by its distance from another surface.

    Args:
        mesh: to draw, frame `object`.
        other: closed if signed, same frame.
        viewpoint: one of `viewpoints`.
        signed: colour signed distances, positive outside `other`; else absolute ones.
        colors: of these distances.

    Returns:
        (SIZE_PX, SIZE_PX, 3) uint8 RGB.
    """
    import cv2

    drawn = Mesh(mesh.vertices, mesh.faces.astype(np.int64))
    size_px = SIZE_PX * SUPERSAMPLING
    distance_m, normals_view = cast(drawn, viewpoint, size_px)
    hit = np.isfinite(distance_m)
    points = _points(viewpoint, distance_m, hit)
    error_m = other.signed_distance_m(points) if signed else other.distance_m(points)
    lit = 0.75 + 0.25 * np.clip(normals_view[hit] @ LIGHT, 0.0, 1.0)
    picture = np.empty((size_px, size_px, 3))
    picture[...] = PAPER
    picture[hit] = 255 * colors(error_m) * lit[:, None]
    small = cv2.resize(
        np.clip(picture, 0, 255).astype(np.uint8), (SIZE_PX, SIZE_PX), interpolation=cv2.INTER_AREA
    )
    return np.asarray(small, np.uint8)


def _points(viewpoint: Viewpoint, distance_m: Float64, hit: NDArray[np.bool_]) -> Float64:
    """Where the rays of `cast` hit: (n, 3), the mesh's frame."""
    right, down, forward = viewpoint.R_frame_view.T
    size_px = len(distance_m)
    offset_m = ((np.arange(size_px) + 0.5) / size_px * 2 - 1) * viewpoint.half_m
    rows, columns = np.nonzero(hit)
    across = offset_m[columns, None] * right + offset_m[rows, None] * down
    points: Float64 = viewpoint.center_m + across + (distance_m[hit] - viewpoint.depth_m)[:, None] * forward
    return points
