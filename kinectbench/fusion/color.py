"""Colour for the vertices of a mesh, from the frames that see them."""

import numpy as np

from kinectbench.geometry import TriangleMesh, invert_rigid, transform_points
from kinectbench.sequence import Sequence
from kinectbench.tracking.trajectory import Trajectory

MAX_FRAMES = 24
AGREEMENT_M = 0.03


def color_vertices(mesh: TriangleMesh, sequence: Sequence, trajectory: Trajectory) -> TriangleMesh:
    """Give each vertex the mean colour of up to 24 frames whose depth agrees with it within 30 mm.

    Without colour registered to depth the mesh comes back as it is; vertices that no frame sees are grey.
    """
    if not sequence.color_registered or len(mesh.vertices) == 0:
        return mesh
    good = trajectory.good_frames
    total = np.zeros((len(mesh.vertices), 3))
    count = np.zeros(len(mesh.vertices))
    for index in good[np.unique(np.linspace(0, len(good) - 1, MAX_FRAMES).astype(int))]:
        color = sequence.color_rgb(int(index))
        if color is None:
            continue
        camera = sequence.camera
        points_camera = transform_points(invert_rigid(trajectory.T_world_camera[index]), mesh.vertices)
        ahead = np.flatnonzero(points_camera[:, 2] > 0.1)
        u, v = np.rint(camera.project(points_camera[ahead])).astype(np.int64).T
        inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        ahead, u, v = ahead[inside], u[inside], v[inside]
        depth_m = sequence.depth_m(int(index))[v, u]
        agree = np.abs(depth_m - points_camera[ahead, 2]) < AGREEMENT_M
        total[ahead[agree]] += color[v[agree], u[agree]]
        count[ahead[agree]] += 1
    colors = np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], 128.0)
    return TriangleMesh(mesh.vertices, mesh.faces, np.rint(colors).astype(np.uint8))
