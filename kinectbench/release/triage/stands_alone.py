"""Find a part of a solid that could stand by itself: probably another object, merged with the wanted one.

If a box touches a chair, the depth shows no gap, and both are built as one solid. Such a box is thick, and
wider than its joint with the chair. Box and chair both reach the floor.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from kinectbench.core import StorageError
from kinectbench.core.artefacts.object_grids import ObjectVolume
from kinectbench.core.types import Bools

# Cells along the longest side; finer ones changed no share by more than 0.02.
CELLS = 80
# Radius of a ball that fits in a thick part, as a share of the longest side. Legs, seats and backs of
# simulated furniture are thinner, and so is the joint. The first radius finds small boxes, the second a box
# that shares 13 cm of a couch's side.
RADIUS_SHARES = (0.06, 0.08)
# Cells below this share of the longest side stand on the floor: 6 cm for a chair.
LOW_SHARE = 0.06
# Least share of a part's core that stands on the floor; largest share of the core that lies below the rest of
# the solid; least share of the rest in the solid. Pieces of the rest below the last share do not count: they
# are scraps of the part's corners. Chosen, with the radii, on two objects of each of 45 simulated families,
# alone and with a box against them, and on 70 builds; docs/evidence/releases.md counts other finds.
LEAST_GROUNDED, MOST_COVERED, LEAST_REST, LEAST_PIECE = 0.9, 0.25, 0.15, 0.01
# Beside a large box, a thin chair may have less than LEAST_REST. So a rest that reaches this far from the
# part, as a share of the longest side, also suffices; scraps of corners lie nearer. Chosen on two objects of
# each of 23 families: of 0.1, 0.15 and 0.2 the least that finds no single object by mistake.
LEAST_AWAY = 0.15


def part_that_stands_alone(folder: Path) -> float | None:
    """Return the volume share of a solid's part that could stand alone; None if there is no such part.

    Args:
        folder: `build/<recording>/object/`; if its volume is missing or damaged, the result is None.
    """
    try:
        solid = ObjectVolume.read(folder).solid
    except StorageError:
        return None
    return share_standing_alone(solid) if solid.any() else None


def share_standing_alone(solid: Bools) -> float | None:
    """Return the smallest volume share of a part that could stand alone, if the rest could, too; else None.

    Args:
        solid: (nx, ny, nz) bool, z up, with at least one cell set.
    """
    some = solid[ndimage.find_objects(solid.astype(np.int8))[0]]
    step = -(-max(some.shape) // CELLS)
    cells = np.pad(some[::step, ::step, ::step], 1)
    longest = max(cells.shape) - 2
    # The first layer is padding.
    low = 1 + max(2, round(LOW_SHARE * longest))
    shares = [
        float(part.sum() / cells.sum())
        for radius_share in RADIUS_SHARES
        for core, part in _thick_parts(cells, radius_share * longest)
        if _stands_beside(cells, core, part, low)
    ]
    return min(shares, default=None)


def _thick_parts(cells: Bools, radius: float) -> Iterator[tuple[Bools, Bools]]:
    """Yield (core, part) for each thick part of the solid; both are masks shaped like `cells`.

    A core is a connected set of cells that are deeper than `radius` cells inside the solid. Its part has all
    cells within about `radius` of the core.
    """
    labels, count = ndimage.label(ndimage.distance_transform_edt(cells) > radius)
    for number in range(1, count + 1):
        core = labels == number
        yield core, cells & (ndimage.distance_transform_edt(~core) <= radius + 1)


def _stands_beside(cells: Bools, core: Bools, part: Bools, low: int) -> bool:
    """Return whether a part stands on the floor, and both it and the rest of the solid could stand alone.

    Args:
        cells: (nx, ny, nz) mask of the solid, with an empty layer below.
        core: mask of the part's cells deep inside.
        part: mask of the part.
        low: number of lowest layers, including the empty one, whose cells count as standing on the floor.
    """
    columns = core.any(axis=2)
    low_columns = np.asarray(cells[:, :, :low].any(axis=2))
    labels, count = ndimage.label(cells & ~part)
    if not count or low_columns[columns].mean() < LEAST_GROUNDED:
        return False
    pieces = np.bincount(labels.ravel()) >= LEAST_PIECE * cells.sum()
    pieces[0] = False
    rest = pieces[labels]
    if not rest.any():
        return False
    covered = (_tops(cells & ~part) > _tops(part))[columns].mean()
    if covered > MOST_COVERED or not (_balances(part, low) and _balances(rest, low)):
        return False
    if rest.sum() >= LEAST_REST * cells.sum():
        return True
    return bool(ndimage.distance_transform_edt(~part)[rest].max() >= LEAST_AWAY * max(cells.shape))


def _tops(cells: Bools) -> NDArray[np.int64]:
    """Return (nx, ny), the z index of the highest set cell of each column; -1 if none is set."""
    return np.asarray(np.where(cells, np.arange(cells.shape[2]), -1).max(axis=2))


def _balances(cells: Bools, low: int) -> bool:
    """Return whether the cells' centroid is above the convex hull of those in the `low` lowest layers."""
    feet = np.argwhere(cells[:, :, :low].any(axis=2)).astype(np.float64)
    try:
        hull = ConvexHull(feet)
    except (QhullError, ValueError):  # too few or collinear
        return False
    middle = np.argwhere(cells)[:, :2].mean(axis=0)
    return bool((hull.equations[:, :2] @ middle + hull.equations[:, 2]).max() <= 0)
