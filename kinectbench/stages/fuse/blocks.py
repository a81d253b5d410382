"""A block-sparse voxel volume: blocks of 8x8x8 voxels near measured surfaces."""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Grid
from kinectbench.core.types import Float32, Float64, Int32, Int64
from kinectbench.core.voxels.point_cells import cell_numbers

# Voxels along a block: distance, weight and votes of 8^3 are 6 kB, which stay in a core's cache.
BLOCK_VOXELS = 8
# Blocks are stored in cubes of 2 x 2 x 2.
CUBE_VOXELS = 16
CUBE_BLOCKS = CUBE_VOXELS // BLOCK_VOXELS

Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True)
class BlockVolume:
    """TSDF and visibility votes in blocks: block b covers voxels 8 b to 8 b + 7 on each axis of frame `grid`.

    Attributes:
        blocks: (n, 3) int32, block coordinates, unique.
        voxel_size_m: edge of a voxel; the centre of voxel i is `(i + 0.5) * voxel_size_m`.
        T_world_grid: (4, 4), maps the volume's own frame to the world.
        tsdf: (n, 8, 8, 8) float32, weighted mean of signed distances along the cameras' z axes, metres,
            positive in front of the surface, clipped to the truncation; 0 where weight is 0.
        weight: (n, 8, 8, 8) float32, sum of 1 / sigma(z)^2 in 1/mm^2; 0 = never observed.
        votes: (n, 8, 8, 8) uint32, number of `free` votes in the lower 16 bits and of `surface` votes in the
            upper 16 bits; each saturates at 65,535.
    """

    blocks: Int32
    voxel_size_m: float
    T_world_grid: Float64
    tsdf: Float32
    weight: Float32
    votes: NDArray[np.uint32]

    @property
    def free(self) -> NDArray[np.uint16]:
        """Number of frames that saw through each voxel: (n, 8, 8, 8) uint16."""
        return (self.votes & 0xFFFF).astype(np.uint16)

    @property
    def surface(self) -> NDArray[np.uint16]:
        """Number of frames that measured a surface at each voxel, or just in front: (n, 8, 8, 8) uint16."""
        return (self.votes >> 16).astype(np.uint16)

    def dense(self, values: NDArray[Scalar], first_block: Int32, blocks: int) -> NDArray[Scalar]:
        """Copy a per-voxel array (n, 8, 8, 8) into a dense cube of `blocks`^3 blocks from `first_block` on.

        Blocks that are not in the volume are 0.
        """
        side = blocks * BLOCK_VOXELS
        cube = np.zeros((side, side, side), dtype=values.dtype)
        local = self.blocks - first_block
        inside = np.all((local >= 0) & (local < blocks), axis=1)
        x, y, z = local[inside].T
        cube.reshape((blocks, BLOCK_VOXELS) * 3)[x, :, y, :, z, :] = values[inside]
        return cube


def empty_volume(blocks: Int32, voxel_size_m: float, T_world_grid: Float64) -> BlockVolume:
    """Return a volume of the given blocks in which nothing has been observed yet."""
    shape = (len(blocks), BLOCK_VOXELS, BLOCK_VOXELS, BLOCK_VOXELS)
    return BlockVolume(
        blocks,
        voxel_size_m,
        T_world_grid,
        tsdf=np.zeros(shape, np.float32),
        weight=np.zeros(shape, np.float32),
        votes=np.zeros(shape, np.uint32),
    )


def in_cubes(blocks: Int32, values: NDArray[Scalar]) -> tuple[Int32, NDArray[Scalar]]:
    """Join the values (n, 8, 8, 8) of blocks into cubes of 2x2x2 blocks.

    Returns:
        Coordinates (m, 3) of the cubes, sorted; and their values (m, 16, 16, 16), 0 where a block does not
            exist.
    """
    of_blocks = blocks // CUBE_BLOCKS
    _, first, row = np.unique(cell_numbers(of_blocks), return_index=True, return_inverse=True)
    cubes = of_blocks[first]
    x, y, z = (blocks % CUBE_BLOCKS).T
    grouped = np.zeros((len(cubes), *(CUBE_BLOCKS, BLOCK_VOXELS) * 3), values.dtype)
    grouped[row.reshape(-1), x, :, y, :, z, :] = values
    return cubes, grouped.reshape(len(cubes), CUBE_VOXELS, CUBE_VOXELS, CUBE_VOXELS)


def blocks_of_grid(grid: Grid) -> Int32:
    """Return the sorted coordinates (n, 3) of the blocks of a dense grid.

    The grid's sides must be multiples of 8 cells.
    """
    counts = [n // BLOCK_VOXELS for n in grid.shape]
    return np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), -1).reshape(-1, 3).astype(np.int32)


def dense_grid(values: NDArray[Scalar], shape: tuple[int, int, int]) -> NDArray[Scalar]:
    """Join the values of all blocks of a dense grid, in `blocks_of_grid` order, into one array of `shape`."""
    bx, by, bz = (n // BLOCK_VOXELS for n in shape)
    cells = values.reshape(bx, by, bz, BLOCK_VOXELS, BLOCK_VOXELS, BLOCK_VOXELS)
    return np.ascontiguousarray(cells.transpose(0, 3, 1, 4, 2, 5)).reshape(shape)


def unique_blocks(blocks: Int64) -> Int32:
    """Return the sorted unique rows of (n, 3) block coordinates, each within +-2^20."""
    half = 1 << 20
    keys = ((blocks[:, 0] + half) << 42) | ((blocks[:, 1] + half) << 21) | (blocks[:, 2] + half)
    keys = np.unique(keys)
    mask = (1 << 21) - 1
    rows = np.stack([(keys >> 42) - half, ((keys >> 21) & mask) - half, (keys & mask) - half], axis=-1)
    return rows.astype(np.int32)
