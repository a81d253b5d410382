"""Meshes with fewer triangles, and how far apart two surfaces are."""

import numpy as np

from kinectbench.core.geometry.mesh import TriangleMesh, raycaster
from kinectbench.core.types import Float32, Float64


def decimated(mesh: TriangleMesh, most_triangles: int) -> TriangleMesh:
    """The mesh with as many triangles as wanted; the same mesh, if it has no more. Colours are left out.

    By quadric error metrics (Garland and Heckbert, SIGGRAPH 1997). It is Open3D's, which works in one thread:
    the same mesh gives the same. Triangles that share no edge cannot be joined: of them more may be left, or
    none.

    Args:
        mesh: any frame.
        most_triangles: at least 4.
    """
    import open3d as o3d

    if len(mesh.faces) <= most_triangles:
        return mesh
    whole = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.faces)
    )
    fewer = whole.simplify_quadric_decimation(most_triangles)
    return TriangleMesh(np.array(fewer.vertices), np.array(fewer.triangles, np.int32))


def surface_distances_m(points: Float64, mesh: TriangleMesh) -> Float32:
    """Distance of points (n, 3) from the surface of a mesh, in its frame; (n,) float32."""
    scene, tensor = raycaster(mesh)
    return np.asarray(scene.compute_distance(tensor(points.astype(np.float32))).numpy(), np.float32)
