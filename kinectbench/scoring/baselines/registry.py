"""The baselines: simple methods by name. To add one, write a function and a line of `BASELINES`."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Bools, Float64
from kinectbench.core.voxels.convex_hull import filled_hull
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.core.voxels.resample import reduce_blocks
from kinectbench.scoring.baselines.inputs import Inputs
from kinectbench.scoring.truth import read_parts

PIXELS = 512


def hull(inputs: Inputs) -> Bools:
    """Return the solid convex hull of `partial_256`: (256, 256, 256) bool.

    A cell is set if its centre lies in or on the hull of the set cells' centres. If the partial view is flat,
    or has fewer than four cells, it is returned unchanged.
    """
    return filled_hull(inputs.partial)


def carved_hull(inputs: Inputs) -> Bools:
    """Return the convex hull of `partial_256`, minus observed free space: (256, 256, 256) bool.

    This is the tightest solid that one view gives without a shape prior. It may contain unseen free space.
    """
    carved: Bools = filled_hull(inputs.partial) & ~unpack(inputs.pair.seen) | inputs.partial
    return carved


def silhouette(inputs: Inputs) -> Bools:
    """Return the partial view's cells and all cells behind them, seen from the camera: (256, 256, 256) bool.

    Rays go from the camera's centre to 512 x 512 points on the grid's far side. A cell is set if the ray
    nearest to its centre has met a cell of the partial view.
    """
    pair = inputs.pair
    centre = np.linalg.inv(pair.T_world_grid) @ pair.T_world_camera[:, 3]
    return extruded(inputs.partial, centre[:3] / pair.voxel_size_m - 0.5)


def extruded(partial: Bools, camera_cells: NDArray[np.float64]) -> Bools:
    """Return a partial view (n, n, n) with all cells behind it set, seen from a camera at `camera_cells`.

    The camera's position (3,) is in cells, with cell centres at integers. If the camera is not in front of
    the grid (its z is not negative), rays are parallel to z.
    """
    from kinectbench.scoring.baselines.kernels import sweep_plane, transposed

    count = len(partial)
    far = np.linspace(-0.5, count - 0.5, PIXELS)
    cells = np.arange(count)
    hit = np.zeros((PIXELS, PIXELS), np.bool_)
    filled = transposed(partial.view(np.uint8).reshape(-1, count)).reshape(partial.shape).view(np.bool_)
    for k, plane in enumerate(filled):
        # Where the rays that end at `far` on the last plane cross this plane.
        share = 1.0 if camera_cells[2] >= 0 else (k - camera_cells[2]) / (count - 1 - camera_cells[2])
        crossings = [camera_cells[axis] * (1 - share) + far * share for axis in (0, 1)]
        crossed = [np.clip(np.rint(at).astype(np.int64), 0, count - 1) for at in crossings]
        inside = [np.abs(found - at) <= 0.5 for found, at in zip(crossed, crossings, strict=True)]
        # Which of these rays passes nearest to each cell's centre.
        passing = [
            np.rint((((cells - camera_cells[a] * (1 - share)) / share) + 0.5) / count * (PIXELS - 1))
            for a in (0, 1)
        ]
        rays = [np.clip(found, 0, PIXELS - 1).astype(np.int64) for found in passing]
        within = [found == ray for found, ray in zip(passing, rays, strict=True)]
        sweep_plane(hit, plane, *crossed, *inside, *rays, *within)
    turned = transposed(filled.view(np.uint8).reshape(count, -1))
    return np.asarray(turned.reshape(partial.shape).view(np.bool_))


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


CONSTANT_CELLS = 16
# Limits of float16: smaller rates would lose digits, larger ones would become 1.
SMALLEST_RATE, LARGEST_RATE = 2.0**-14, 1 - 2.0**-11


def empty(inputs: Inputs) -> NDArray[np.bool_]:
    """Return an empty grid: (16, 16, 16) bool."""
    return np.zeros((CONSTANT_CELLS,) * 3, np.bool_)


def constant(inputs: Inputs) -> NDArray[np.float16]:
    """Return the category's base rate in every cell: (16, 16, 16) float16, accurate to 0.05 %.

    Rates near 0 and 1 are clipped to what float16 can hold.
    """
    return np.full((CONSTANT_CELLS,) * 3, np.clip(inputs.base_rate, SMALLEST_RATE, LARGEST_RATE), np.float16)


def partial(inputs: Inputs) -> NDArray[np.bool_]:
    """Return the input itself: `partial_256`, (256, 256, 256) bool."""
    return inputs.partial


def mean_shape(inputs: Inputs) -> NDArray[np.float16]:
    """Return the mean occupancy of the category's training shapes: (64, 64, 64) float16.

    The shapes are not aligned: each is taken as it lies in the grid of its own pair.
    """
    assert inputs.training is not None
    return inputs.training.mean.astype(np.float16)


def nearest(inputs: Inputs) -> NDArray[np.bool_]:
    """Return the true shape of the training pair whose partial view is most similar: (256, 256, 256) bool.

    Similarity is the IoU of the two partial views at 64^3. Of equally similar pairs, the first is taken.
    """
    assert inputs.training is not None
    partials = inputs.training.partials
    ious = []
    for other in partials:
        union = np.bitwise_count(other | inputs.pair.partial).sum(dtype=np.int64)
        shared = np.bitwise_count(other & inputs.pair.partial).sum(dtype=np.int64)
        ious.append(shared / union if union else 1.0)
    (full,) = read_parts(*inputs.training.files[int(np.argmax(ious))], ("full",))
    return unpack(full)


# Returns a prediction (n, n, n). It may read only the input of the pair.
Baseline = Callable[[Inputs], NDArray[np.bool_] | NDArray[np.float16]]

BASE_RATE = "base-rate"
BASELINES: Mapping[str, Baseline] = {
    "empty": empty,
    BASE_RATE: constant,
    "partial": partial,
    "hull": hull,
    "carved-hull": carved_hull,
    "mirror": mirror,
    "silhouette": silhouette,
    "mean-shape": mean_shape,
    "nearest": nearest,
}
# Baselines without a usable surface in space. `base-rate` is constant. `silhouette` becomes a comb of rays
# where depth pixels are farther apart than cells (3.8 to 9.1 million faces on four views of the sample's
# chairs and table).
WITHOUT_SURFACE = (BASE_RATE, "silhouette")
# Baselines that need training pairs of the category.
LEARNED = ("mean-shape", "nearest")
