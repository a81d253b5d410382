"""Whether a part of a solid stands alone, and the rest without it: a thing has merged with the object.

A box that stands against a chair leaves no gap in the depth, and the two are built as one thing. Such a box
is thick, and joined to the rest by less than its own width. It reaches the floor, and so does the rest.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from kinectbench.core.artefacts.object_grids import ObjectVolume
from kinectbench.core.errors import StorageError
from kinectbench.core.types import Bools

# Cells along the longest side; finer ones changed no share by more than 0.02.
CELLS = 80
# A thick part has room for a ball of this radius, as a share of the longest side: legs, seats and backs of
# simulated furniture are thinner, and so is the joint. The first finds small boxes, the second a box that
# shares 13 cm of a couch's side.
RADIUS_SHARES = (0.06, 0.08)
# What is that low, as a share of the longest side, stands on the floor: 6 cm of a chair.
LOW_SHARE = 0.06
# Of a part's core so much reaches the floor, and no more has the rest above it. The rest is no scrap of the
# part's own corners: of its pieces, each a share of the solid, those that are no crumbs. Chosen, with the
# radii, on two objects of each of 45 simulated families, alone and with a box against them, and on 70 builds;
# docs/evidence/releases.md counts what the rule names of others.
LEAST_GROUNDED, MOST_COVERED, LEAST_REST, LEAST_PIECE = 0.9, 0.25, 0.15, 0.01


def part_that_stands_alone(folder: Path) -> float | None:
    """The share of the solid in a part that stands alone; None without such a part.

    Args:
        folder: `object/`, with or without its volume; a damaged one says nothing, and is refused where it is
            published.
    """
    try:
        solid = ObjectVolume.read(folder).solid
    except StorageError:
        return None
    return share_standing_alone(solid) if solid.any() else None


def share_standing_alone(solid: Bools) -> float | None:
    """The share of the smallest part that stands alone, and without which the rest does; None without one.

    Args:
        solid: (nx, ny, nz), z up, with at least one cell set.
    """
    some = solid[ndimage.find_objects(solid.astype(np.int8))[0]]
    step = -(-max(some.shape) // CELLS)
    cells = np.pad(some[::step, ::step, ::step], 1)
    longest = max(cells.shape) - 2
    # The first layer is of the padding.
    low = 1 + max(2, round(LOW_SHARE * longest))
    shares = [
        float(part.sum() / cells.sum())
        for radius_share in RADIUS_SHARES
        for core, part in _thick_parts(cells, radius_share * longest)
        if _stands_beside(cells, core, part, low)
    ]
    return min(shares, default=None)


def _thick_parts(cells: Bools, radius: float) -> Iterator[tuple[Bools, Bools]]:
    """Each connected core of cells that are deeper inside than `radius`, and all cells around it."""
    labels, count = ndimage.label(ndimage.distance_transform_edt(cells) > radius)
    for number in range(1, count + 1):
        core = labels == number
        yield core, cells & (ndimage.distance_transform_edt(~core) <= radius + 1)


def _stands_beside(cells: Bools, core: Bools, part: Bools, low: int) -> bool:
    """Whether a part stands on the floor beside the rest, and each of the two without the other."""
    columns = core.any(axis=2)
    low_columns = np.asarray(cells[:, :, :low].any(axis=2))
    labels, count = ndimage.label(cells & ~part)
    if not count or low_columns[columns].mean() < LEAST_GROUNDED:
        return False
    pieces = np.bincount(labels.ravel()) >= LEAST_PIECE * cells.sum()
    pieces[0] = False
    rest = pieces[labels]
    covered = (_tops(cells & ~part) > _tops(part))[columns].mean()
    large = rest.sum() >= LEAST_REST * cells.sum()
    return bool(large and covered <= MOST_COVERED and _balances(part, low) and _balances(rest, low))


def _tops(cells: Bools) -> NDArray[np.int64]:
    """(nx, ny) of the highest cell of each column; -1 without one."""
    return np.asarray(np.where(cells, np.arange(cells.shape[2]), -1).max(axis=2))


def _balances(cells: Bools, low: int) -> bool:
    """Whether the middle of all cells lies above the convex hull of the lowest `low` layers."""
    feet = np.argwhere(cells[:, :, :low].any(axis=2)).astype(np.float64)
    try:
        hull = ConvexHull(feet)
    except (QhullError, ValueError):  # too few, or in a line
        return False
    middle = np.argwhere(cells)[:, :2].mean(axis=0)
    return bool((hull.equations[:, :2] @ middle + hull.equations[:, 2]).max() <= 0)
