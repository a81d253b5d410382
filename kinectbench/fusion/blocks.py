"""A block-sparse voxel volume: 16x16x16 blocks where something is to be measured."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera, Grid, transform_points

BLOCK_VOXELS = 16

Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True)
class BlockVolume:
    """TSDF and visibility votes in blocks. Block b covers voxels `16 b ... 16 b + 15` of frame `grid`.

    Attributes:
        blocks: (n, 3) int32, block coordinates, sorted, unique.
        voxel_size_m: edge of a voxel; the centre of voxel i is `(i + 0.5) * voxel_size_m`.
        T_world_grid: (4, 4), maps the volume's own frame to the world.
        tsdf: (n, 16, 16, 16) float32, signed distance in metres along the viewing ray's z, weighted
            mean, positive in front of the surface, clipped to the truncation; 0 where weight is 0.
        weight: (n, 16, 16, 16) float32, sum of 1 / sigma(z)^2 in 1/mm^2; 0 = never observed.
        free: (n, 16, 16, 16) uint16, frames that saw through the voxel.
        surface: (n, 16, 16, 16) uint16, frames that measured a surface in the voxel.
    """

    blocks: NDArray[np.int32]
    voxel_size_m: float
    T_world_grid: NDArray[np.float64]
    tsdf: NDArray[np.float32]
    weight: NDArray[np.float32]
    free: NDArray[np.uint16]
    surface: NDArray[np.uint16]

    def dense(self, values: NDArray[Scalar], first_block: NDArray[np.int32], blocks: int) -> NDArray[Scalar]:
        """Copy a per-voxel array into a dense cube of `blocks`^3 blocks starting at `first_block`.

        Blocks that are not in the volume are 0.
        """
        side = blocks * BLOCK_VOXELS
        cube = np.zeros((side, side, side), dtype=values.dtype)
        local = self.blocks - first_block
        for b in np.flatnonzero(np.all((local >= 0) & (local < blocks), axis=1)):
            x, y, z = local[b] * BLOCK_VOXELS
            cube[x : x + BLOCK_VOXELS, y : y + BLOCK_VOXELS, z : z + BLOCK_VOXELS] = values[b]
        return cube


def empty_volume(
    blocks: NDArray[np.int32], voxel_size_m: float, T_world_grid: NDArray[np.float64]
) -> BlockVolume:
    """A volume of these blocks, nothing observed yet."""
    shape = (len(blocks), BLOCK_VOXELS, BLOCK_VOXELS, BLOCK_VOXELS)
    return BlockVolume(
        blocks,
        voxel_size_m,
        T_world_grid,
        tsdf=np.zeros(shape, np.float32),
        weight=np.zeros(shape, np.float32),
        free=np.zeros(shape, np.uint16),
        surface=np.zeros(shape, np.uint16),
    )


def blocks_of_grid(grid: Grid) -> NDArray[np.int32]:
    """All blocks that cover a dense grid whose sides are multiples of 16: (n, 3), sorted."""
    counts = [n // BLOCK_VOXELS for n in grid.shape]
    return np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), -1).reshape(-1, 3).astype(np.int32)


def dense_grid(values: NDArray[Scalar], shape: tuple[int, int, int]) -> NDArray[Scalar]:
    """Per-block values of all blocks of a dense grid, in `blocks_of_grid` order, as one array of `shape`."""
    bx, by, bz = (n // BLOCK_VOXELS for n in shape)
    cells = values.reshape(bx, by, bz, BLOCK_VOXELS, BLOCK_VOXELS, BLOCK_VOXELS)
    return np.ascontiguousarray(cells.transpose(0, 3, 1, 4, 2, 5)).reshape(shape)


def blocks_near_surface(
    depth_m: NDArray[np.float32],
    camera: Camera,
    T_world_camera: NDArray[np.float64],
    margin_m: float,
    voxel_size_m: float,
) -> NDArray[np.int32]:
    """Blocks of a world-aligned volume within `margin_m` of a frame's depth, along the viewing rays.

    Every fourth pixel is looked at: at 4 m these are 30 mm apart, less than half a block of 5 mm voxels.

    Returns:
        (n, 3) int32, unique, sorted.
    """
    step_px = 4
    sampled = depth_m[::step_px, ::step_px]
    valid = sampled > 0
    rays = camera.rays()[::step_px, ::step_px][valid]
    block_size_m = BLOCK_VOXELS * voxel_size_m
    found = []
    for offset_m in np.linspace(-margin_m, margin_m, max(2, int(np.ceil(4 * margin_m / block_size_m)) + 1)):
        points_world = transform_points(T_world_camera, rays * (sampled[valid] + offset_m)[:, None])
        found.append(np.floor(points_world / block_size_m).astype(np.int64))
    return unique_blocks(np.concatenate(found))


def unique_blocks(blocks: NDArray[np.int64]) -> NDArray[np.int32]:
    """Sorted unique rows of (n, 3) block coordinates, each within +-2^20."""
    half = 1 << 20
    keys = ((blocks[:, 0] + half) << 42) | ((blocks[:, 1] + half) << 21) | (blocks[:, 2] + half)
    keys = np.unique(keys)
    mask = (1 << 21) - 1
    rows = np.stack([(keys >> 42) - half, ((keys >> 21) & mask) - half, (keys & mask) - half], axis=-1)
    return rows.astype(np.int32)
