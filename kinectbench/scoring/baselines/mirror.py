"""The baseline `mirror`: the partial view, and its mirror image in the best-supported vertical plane."""

import numpy as np

from kinectbench.core.types import Bools, Float64
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.core.voxels.resample import reduce_blocks
from kinectbench.scoring.baselines.inputs import Inputs

# Planes that are tried: every 5 degrees over half a turn; for each direction, offsets over three times the
# extent of the partial view, a sixteenth of the extent apart (chosen by hand).
ANGLES, OFFSETS = 36, 49
BLOCK = 4
SAMPLED = 1500


def mirror(inputs: Inputs) -> Bools:
    """Return the partial view together with its mirror image: (256, 256, 256) bool.

    The mirror plane is the one that `best_plane` finds among vertical planes of 36 directions x 49 offsets.
    """
    partial = inputs.partial
    points = np.argwhere(partial).astype(np.float64) + 0.5
    if not len(points):
        return partial
    seen_empty = reduce_blocks(unpack(inputs.pair.seen) & ~partial, "majority")
    normal, offset = best_plane(points, unpack(inputs.pair.partial), seen_empty, inputs.up_grid)
    cells = np.floor(mirrored(points, normal, offset)).astype(int)
    inside = ((cells >= 0) & (cells < len(partial))).all(axis=1)
    result = partial.copy()
    result[tuple(cells[inside].T)] = True
    return result


def best_plane(points: Float64, partial: Bools, seen_empty: Bools, up: Float64) -> tuple[Float64, float]:
    """Return the best vertical mirror plane n . x = offset: unit normal n (3,), offset in 256-grid cells.

    36 directions x 49 offsets are tried. The score of a plane is the number of mirrored points that lie on
    the partial view, minus the number that lie in observed free space or outside the grid. Only every k-th
    point is mirrored: at most 3,000 points. Of equally good planes, the first is taken.

    Args:
        points: (n, 3) centres of the partial view's cells, in cells of the 256-grid.
        partial: (64, 64, 64) bool, the partial view.
        seen_empty: (64, 64, 64) bool, observed free space.
        up: (3,) unit vector away from the floor, in grid axes.
    """
    from kinectbench.scoring.baselines.kernels import mirror_gain

    sampled = points[:: max(1, len(points) // SAMPLED)]
    first = np.cross(up, np.eye(3)[int(np.abs(up).argmin())])
    first /= np.linalg.norm(first)
    second = np.cross(up, first)
    gain = partial.astype(np.int8) - (seen_empty & ~partial).astype(np.int8)
    best, chosen = -len(points) - 1, (first, 0.0)
    for angle in np.arange(ANGLES) * np.pi / ANGLES:
        normal = np.cos(angle) * first + np.sin(angle) * second
        along = sampled @ normal
        length = np.ptp(along)  # planes on both sides, as normals cover half a circle
        for offset in np.linspace(along.min() - length, along.max() + length, OFFSETS):
            score = mirror_gain(sampled, along, normal, offset, BLOCK, gain)
            if score > best:
                best, chosen = score, (normal, float(offset))
    return chosen


def mirrored(points: Float64, normal: Float64, offset: float) -> Float64:
    """Return points (n, 3) mirrored in the plane normal . x = offset; `normal` (3,) has unit length."""
    return points - 2 * ((points @ normal) - offset)[:, None] * normal
