"""Whether most of a solid is one thick block in a corner: a thing beside the object has merged with it.

A box that stands against a chair leaves no gap in the depth, and the two are built as one thing. Most of the
volume is then the box, and the box is small beside the whole.
"""

from pathlib import Path

import numpy as np
from scipy import ndimage

from kinectbench.core.artefacts.object_grids import ObjectVolume
from kinectbench.core.errors import StorageError
from kinectbench.core.types import Bools

# Cells along the longest side; finer ones changed no share by more than 0.02.
CELLS = 80
# A block has room for a ball of this radius, as a share of the longest side. Chosen by hand: legs, seats
# and backs of simulated furniture are thinner.
RADIUS_SHARE = 0.06
# A block with more of the volume, in a box that has less of the whole box, is looked at. A simulated chair
# with a box against it has 0.71 and 0.16. Of 90 whole objects of 45 simulated families 5 are beyond both: a
# sink, a lamp, a fridge, a piano and a bed; of the 8 of the paper's furniture none is.
LEAST_VOLUME_SHARE, MOST_BOX_SHARE = 0.5, 0.2


def one_block(folder: Path) -> tuple[float, float] | None:
    """The largest block's share of the volume and of the overall box; None unless it needs a review.

    Args:
        folder: `object/`, with or without its volume; a damaged one says nothing, and is refused where it is
            published.
    """
    try:
        solid = ObjectVolume.read(folder).solid
    except StorageError:
        return None
    if not solid.any():
        return None
    volume_share, box_share = largest_block(solid)
    looked_at = volume_share > LEAST_VOLUME_SHARE and box_share < MOST_BOX_SHARE
    return (volume_share, box_share) if looked_at else None


def largest_block(solid: Bools) -> tuple[float, float]:
    """The largest thick block's share of a solid's volume, and of the box around it; 0 without one.

    Args:
        solid: (nx, ny, nz), with at least one cell set.
    """
    some = solid[ndimage.find_objects(solid.astype(np.int8))[0]]
    step = -(-max(some.shape) // CELLS)
    cells = np.pad(some[::step, ::step, ::step], 1)
    radius = RADIUS_SHARE * max(some.shape) / step
    core = ndimage.distance_transform_edt(cells) > radius
    labels, count = ndimage.label(core)
    if not count:
        return 0.0, 0.0
    largest = 1 + int(np.bincount(labels.ravel())[1:].argmax())
    block = cells & (ndimage.distance_transform_edt(labels != largest) <= radius)
    sides = [along.stop - along.start for along in ndimage.find_objects(block.astype(np.int8))[0]]
    whole = np.array(cells.shape) - 2
    return float(block.sum() / cells.sum()), float(np.prod(np.array(sides) / whole))
