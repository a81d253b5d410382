"""Simpler ways to make a solid of the same observations, to hold ours against."""

from collections.abc import Callable

import numpy as np

from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.types import Bools
from kinectbench.core.voxels.observation import Observation
from kinectbench.lab.simulate.truth import mesh_occupancy
from kinectbench.stages.segment.solid.guess import INSIDE, OUTSIDE, UNSEEN, cast_26_rays

POISSON_DEPTH = 8
# Frames that saw through, so many times as many as measured a surface there, carve a voxel.
FREE_OVER_SURFACE = 3


def shell(observation: Observation) -> Bools:
    """The measured surface, a voxel to either side."""
    return np.asarray((observation.weight > 0) & (np.abs(observation.tsdf) < observation.grid.voxel_size_m))


def negative(observation: Observation) -> Bools:
    """TSDF < 0."""
    return (observation.weight > 0) & (observation.tsdf < 0)


def carving(observation: Observation) -> Bools:
    """All that no frame saw through."""
    return ~_seen_through(observation)


def unseen_or_negative(observation: Observation) -> Bools:
    """(TSDF < 0 or unseen) and not carved."""
    return np.asarray(((observation.weight == 0) | (observation.tsdf < 0)) & ~_seen_through(observation))


def winding(observation: Observation) -> Bools:
    """Enclosed in most of 26 directions by voxels behind the surface: a winding number on a lattice."""
    state = np.full(observation.grid.shape, UNSEEN, np.uint8)
    state[(observation.weight > 0) & (observation.tsdf <= 0)] = INSIDE
    state[((observation.weight > 0) & (observation.tsdf > 0)) | _seen_through(observation)] = OUTSIDE
    return np.asarray((state == INSIDE) | (cast_26_rays(state).enclosed > 0.5))


RECIPES: dict[str, Callable[[Observation], Bools]] = {
    "shell": shell,
    "TSDF < 0": negative,
    "carving": carving,
    "unseen or TSDF < 0, not carved": unseen_or_negative,
    "winding": winding,
}


def poisson(surface: TriangleMesh, observation: Observation, above: int) -> Bools:
    """Screened Poisson reconstruction (Kazhdan & Hoppe 2013, Open3D's) of the fused surface's vertices.

    Of the floor nothing is taken: so many layers of cells are left out.
    """
    import open3d as o3d

    low, high = np.array([0, 0, above * observation.grid.voxel_size_m]), observation.grid.size_m
    inside = observation.grid.T_grid_world[:3, :3] @ surface.vertices.T
    inside = inside.T + observation.grid.T_grid_world[:3, 3]
    kept = np.all((inside > low) & (inside < high), axis=1)
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(surface.vertices), o3d.utility.Vector3iVector(surface.faces)
    )
    mesh.compute_vertex_normals()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(surface.vertices[kept]))
    cloud.normals = o3d.utility.Vector3dVector(np.asarray(mesh.vertex_normals)[kept])
    made, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        cloud, depth=POISSON_DEPTH, n_threads=1
    )
    return mesh_occupancy(
        TriangleMesh(np.asarray(made.vertices), np.asarray(made.triangles).astype(np.int64)), observation.grid
    )


def _seen_through(observation: Observation) -> Bools:
    many = observation.free > FREE_OVER_SURFACE * observation.surface.astype(np.uint32)
    return (observation.free > 1) & many
