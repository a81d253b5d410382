"""Colour for the vertices of a mesh, from the frames that see them."""

import numba
import numpy as np

from kinectbench.geometry import TriangleMesh, invert_rigid
from kinectbench.sequence import Sequence
from kinectbench.tracking.trajectory import Trajectory

MAX_FRAMES = 24
AGREEMENT_M = 0.03
NEAREST_M = 0.1


def color_vertices(mesh: TriangleMesh, sequence: Sequence, trajectory: Trajectory) -> TriangleMesh:
    """Give each vertex the mean colour of up to 24 frames whose depth agrees with it within 30 mm.

    Without colour registered to depth the mesh comes back as it is; vertices that no frame sees are grey.
    """
    if not sequence.color_registered or len(mesh.vertices) == 0:
        return mesh
    good = trajectory.good_frames
    camera = sequence.camera
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    total = np.zeros((len(mesh.vertices), 3))
    count = np.zeros(len(mesh.vertices))
    for index in good[np.unique(np.linspace(0, len(good) - 1, MAX_FRAMES).astype(int))]:
        color = sequence.color_rgb(int(index))
        if color is None:
            continue
        depth_m = sequence.depth_m(int(index))
        T_camera_world = invert_rigid(trajectory.T_world_camera[index])
        _add_colors(total, count, mesh.vertices, depth_m, color, T_camera_world, intrinsics)
    colors = np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], 128.0)
    return TriangleMesh(mesh.vertices, mesh.faces, np.rint(colors).astype(np.uint8))


@numba.njit(cache=True, error_model="numpy")
def _add_colors(  # type: ignore[no-untyped-def]
    total, count, vertices, depth_m, color, T, intrinsics
):
    """Add the colour of the nearest pixel to each vertex whose depth that pixel measured."""
    fx, fy, cx, cy = intrinsics
    height, width = depth_m.shape
    for n in range(len(vertices)):
        x, y, z = vertices[n]
        ahead_m = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
        if ahead_m > NEAREST_M:
            u = round(fx * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) / ahead_m + cx)
            v = round(fy * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) / ahead_m + cy)
            if 0 <= u < width and 0 <= v < height and abs(depth_m[v, u] - ahead_m) < AGREEMENT_M:
                for channel in range(3):
                    total[n, channel] += color[v, u, channel]
                count[n] += 1
