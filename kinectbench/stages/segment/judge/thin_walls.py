"""Find the walls of a solid that are too thin for their thickness to be measured."""

import numpy as np
from scipy import ndimage

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import transform_points
from kinectbench.core.types import Bools, Float64
from kinectbench.stages.segment.solid.solid import SolidShape

# The thickness of a wall below this many voxels is not resolved. Of walls of 1.5 to 4 mm in voxels of 3.75 to
# 5 mm, 54 to 75 % come out thinner, whatever their thickness; of one of 8 mm in voxels of 3.75 mm 5 %, of one
# of 12 mm in voxels of 5 mm 12 % (docs/evidence/ground-truth.md, The estimate).
RESOLVED_VOXELS = 2.0
# Thickness is measured in blocks of this many voxels along each axis, each with the blocks around it.
BLOCK_VOXELS = 4


def unresolved_share(shape: SolidShape) -> float:
    """Return the share of the known solid, in [0, 1], that is in walls thinner than `RESOLVED_VOXELS`.

    The local thickness is twice the solid's volume over the area of its mesh, within 3 x 3 x 3 blocks of
    4 x 4 x 4 voxels.
    """
    known = _by_block(shape.solid & (shape.labels != Label.UNKNOWN))
    volume = ndimage.uniform_filter(_by_block(shape.solid), 3, mode="constant")
    area = ndimage.uniform_filter(_area_by_block(shape), 3, mode="constant")
    thin = 2 * volume < RESOLVED_VOXELS * area
    return float(known[thin].sum() / max(1.0, known.sum()))


def _by_block(cells: Bools) -> Float64:
    """Return the number of set cells in each block."""
    padded = np.pad(cells, [(0, -side % BLOCK_VOXELS) for side in cells.shape])
    nx, ny, nz = (side // BLOCK_VOXELS for side in padded.shape)
    blocks = padded.reshape(nx, BLOCK_VOXELS, ny, BLOCK_VOXELS, nz, BLOCK_VOXELS)
    return np.asarray(blocks.sum(axis=(1, 3, 5), dtype=np.float64))


def _area_by_block(shape: SolidShape) -> Float64:
    """Return the area of the mesh in each block, in faces of a voxel."""
    grid, faces = shape.grid, shape.mesh.faces
    vertices = (
        transform_points(np.linalg.inv(grid.T_world_grid).astype(np.float64), shape.mesh.vertices)
        / grid.voxel_size_m
    )
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    sides = tuple(-(-side // BLOCK_VOXELS) for side in grid.shape)
    block = np.clip(((a + b + c) / 3 // BLOCK_VOXELS).astype(np.int64), 0, np.array(sides) - 1)
    flat = np.ravel_multi_index(tuple(block.T), sides)
    return np.bincount(flat, areas, int(np.prod(sides))).reshape(sides).astype(np.float64)
