"""From a TSDF to a triangle mesh: marching cubes where all eight corners were observed."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.fusion.blocks import BLOCK_VOXELS, BlockVolume
from kinectbench.fusion.vote_trust import without_fringe
from kinectbench.geometry import TriangleMesh, transform_points

BRICK_BLOCKS = 16


def isosurface(field: NDArray[np.float32], observed: NDArray[np.bool_] | None = None) -> TriangleMesh:
    """Marching cubes of a dense field at 0, positive outside, in index coordinates.

    Args:
        field: (nx, ny, nz) float32.
        observed: (nx, ny, nz); a cell with an unobserved corner gives no faces. None: all observed.

    Returns:
        A mesh whose vertex (i, j, k) lies on the centre of cell (i, j, k); faces look outward.
    """
    import open3d as o3d

    values = o3d.core.Tensor.from_numpy(np.ascontiguousarray(field))
    extracted = o3d.t.geometry.TriangleMesh.create_isosurfaces(values, [0.0])
    if "indices" not in extracted.triangle or len(extracted.triangle.indices) == 0:
        return TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    # The library counts the last array axis as x.
    vertices = extracted.vertex.positions.numpy()[:, ::-1].astype(np.float64)
    faces = extracted.triangle.indices.numpy().astype(np.int32)
    mesh = TriangleMesh(vertices, faces)
    if observed is None:
        return mesh
    cell = np.floor(vertices[mesh.faces].mean(axis=1)).astype(np.int64)
    x, y, z = np.clip(cell, 0, np.array(field.shape) - 2).T
    whole = np.ones(len(cell), dtype=bool)
    for corner in np.ndindex(2, 2, 2):
        whole &= observed[x + corner[0], y + corner[1], z + corner[2]]
    return mesh.keep_faces(whole)


def extract_mesh(volume: BlockVolume, min_weight: float, trust: float = 1.0) -> TriangleMesh:
    """The zero surface of a block volume in the world, brick by brick, joined without seams.

    It is that of the TSDF `without_fringe`.

    Args:
        volume: fused blocks.
        min_weight: voxels of less weight (1/mm^2) count as not observed.
        trust: what part of the votes is believed, `trust_in_votes`.
    """
    bricks = np.unique(volume.blocks // BRICK_BLOCKS, axis=0)
    parts, offset = [], 0
    vertices, faces = [], []
    free_votes, surface_votes = volume.free, volume.surface
    for brick in bricks:
        first = (brick * BRICK_BLOCKS).astype(np.int32)
        # One block more than the brick on the far sides: cells across the border belong to this brick.
        side = BRICK_BLOCKS * BLOCK_VOXELS + 1
        tsdf = volume.dense(volume.tsdf, first, BRICK_BLOCKS + 1)[:side, :side, :side]
        weight = volume.dense(volume.weight, first, BRICK_BLOCKS + 1)[:side, :side, :side]
        free = volume.dense(free_votes, first, BRICK_BLOCKS + 1)[:side, :side, :side]
        surface = volume.dense(surface_votes, first, BRICK_BLOCKS + 1)[:side, :side, :side]
        signed_m = without_fringe(tsdf, free, surface, volume.voxel_size_m, trust)
        part = isosurface(signed_m, weight > min_weight)
        parts.append(_edge_keys(part.vertices, first.astype(np.int64) * BLOCK_VOXELS))
        vertices.append(part.vertices + first * BLOCK_VOXELS)
        faces.append(part.faces + offset)
        offset += len(part.vertices)
    if offset == 0:
        return TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    _, first_of, merged = np.unique(np.concatenate(parts), return_index=True, return_inverse=True)
    indices = np.concatenate(vertices)[first_of]
    joined = merged.reshape(-1)[np.concatenate(faces)].astype(np.int32)
    points_world = transform_points(volume.T_world_grid, (indices + 0.5) * volume.voxel_size_m)
    distinct = (
        (joined[:, 0] != joined[:, 1]) & (joined[:, 1] != joined[:, 2]) & (joined[:, 2] != joined[:, 0])
    )
    return TriangleMesh(points_world, joined).keep_faces(distinct)


def _edge_keys(vertices: NDArray[np.float64], first: NDArray[np.int64]) -> NDArray[np.int64]:
    """One integer per grid edge (or corner) that a marching-cubes vertex lies on, equal across bricks."""
    low = np.floor(vertices)
    axis = np.argmax(vertices - low, axis=1)
    axis[np.all(vertices == low, axis=1)] = 3
    half = 1 << 19
    x, y, z = (low.astype(np.int64) + first + half).T
    keys: NDArray[np.int64] = (((x << 20 | y) << 20 | z) << 2) | axis
    return keys
