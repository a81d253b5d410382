"""Extract a coloured triangle mesh from a TSDF: marching cubes where all eight corners were observed."""

import numba
import numpy as np

from kinectbench.core.geometry import TriangleMesh, invert_rigid, isosurface, three_corners, transform_points
from kinectbench.core.sequence import Sequence
from kinectbench.core.threads import ahead
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float64, Int32, Int64
from kinectbench.core.voxels.observation import evident_weight, without_fringe
from kinectbench.core.voxels.point_cells import cell_numbers
from kinectbench.stages.fuse.blocks import BLOCK_VOXELS, BlockVolume
from kinectbench.stages.fuse.depth_range import some_frames

# Marching cubes run on bricks of 128^3 voxels, whose dense arrays take 26 MB however large the scene is.
BRICK_BLOCKS = 16
# Colours are only looked at: more frames cost time, and a larger difference takes in other surfaces.
MAX_FRAMES, AGREEMENT_M = 24, 0.03
# Nearer vertices get no colour: hardly any depth camera measures there.
NEAREST_M = 0.1


def extract_mesh(volume: BlockVolume, min_weight: float, trust: float = 1.0) -> TriangleMesh:
    """Extract the zero surface of a block volume, in the world frame, brick by brick without seams.

    First, edge artefacts are removed from the TSDF by `without_fringe`.

    Args:
        volume: fused blocks.
        min_weight: voxels of at most this weight (`evident_weight`, 1/mm^2) count as not observed.
        trust: confidence in `free` votes, in [0, 1], from `trust_in_votes`.
    """
    of_blocks = volume.blocks // BRICK_BLOCKS
    bricks = of_blocks[np.unique(cell_numbers(of_blocks), return_index=True)[1]]
    parts, offset = [], 0
    vertices, faces = [], []
    free_votes, surface_votes = volume.free, volume.surface

    def surface_of(brick: Int32) -> tuple[Int32, TriangleMesh]:
        """Return a brick's first block (3,), and the surface in the brick, in voxels from its first voxel."""
        first = (brick * BRICK_BLOCKS).astype(np.int32)
        # One block more than the brick on the far sides: cells across the border belong to this brick.
        side = BRICK_BLOCKS * BLOCK_VOXELS + 1
        tsdf = volume.dense(volume.tsdf, first, BRICK_BLOCKS + 1)[:side, :side, :side]
        weight = volume.dense(volume.weight, first, BRICK_BLOCKS + 1)[:side, :side, :side]
        free = volume.dense(free_votes, first, BRICK_BLOCKS + 1)[:side, :side, :side]
        surface = volume.dense(surface_votes, first, BRICK_BLOCKS + 1)[:side, :side, :side]
        signed_m = without_fringe(tsdf, free, surface, volume.voxel_size_m, trust)
        evident = evident_weight(tsdf, weight, volume.voxel_size_m) > min_weight
        return first, isosurface(signed_m, evident)

    for first, part in ahead(surface_of, bricks):
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
    return TriangleMesh(points_world, joined).keep_faces(three_corners(joined))


def _edge_keys(vertices: Float64, first: Int64) -> Int64:
    """Return an integer for each vertex (n, 3) of marching cubes; vertices on one grid edge get the same.

    Vertices are in voxels from the voxel `first` (3,). A vertex on a grid corner gets that corner's integer.
    """
    low = np.floor(vertices)
    axis = np.argmax(vertices - low, axis=1)
    axis[np.all(vertices == low, axis=1)] = 3
    half = 1 << 19
    x, y, z = (low.astype(np.int64) + first + half).T
    keys: Int64 = (((x << 20 | y) << 20 | z) << 2) | axis
    return keys


def color_vertices(mesh: TriangleMesh, sequence: Sequence, trajectory: Trajectory) -> TriangleMesh:
    """Give each vertex the mean of its colours in up to 24 frames, evenly spread.

    Only frames whose depth agrees with the vertex within 30 mm count; a vertex without such a frame is grey.
    If colour is not registered to depth, the mesh is returned unchanged.
    """
    if not sequence.color_registered or len(mesh.vertices) == 0:
        return mesh
    intrinsics = sequence.camera.intrinsics
    total = np.zeros((len(mesh.vertices), 3))
    count = np.zeros(len(mesh.vertices))
    chosen = some_frames(trajectory.good_frames, MAX_FRAMES)
    images = ahead(lambda index: (sequence.depth_m(index), sequence.color_rgb(index)), chosen.tolist())
    for index, (depth_m, color) in zip(chosen, images, strict=True):
        if color is None:
            continue
        T_camera_world = invert_rigid(trajectory.T_world_camera[index])
        _add_colors(total, count, mesh.vertices, depth_m, color, T_camera_world, intrinsics)
    colors = np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], 128.0)
    return TriangleMesh(mesh.vertices, mesh.faces, np.rint(colors).astype(np.uint8))


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _add_colors(  # type: ignore[no-untyped-def]
    total, count, vertices, depth_m, color, T, intrinsics
):
    """For each vertex, add the colour of the pixel it projects to, if that pixel's depth agrees.

    `total` (n, 3) and `count` (n,) are the sums to add to, for `vertices` (n, 3) in the world frame, metres.
    `T` (4, 4) maps the world to the camera. `depth_m` (height, width), `color` (height, width, 3) and
    `intrinsics` (fx, fy, cx, cy) are the frame's.
    """
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
