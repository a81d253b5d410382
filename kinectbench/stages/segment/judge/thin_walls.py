"""Find the parts of a solid that are too thin for their thickness to be measured."""

from scipy import ndimage

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.stages.segment.solid.solid import SolidShape

# An opening takes this share from the edges of thick objects, too: of 22 families of parts of 10 mm and more,
# in voxels of 5 mm, at most .116 (docs/evidence/ground-truth.md, The estimate).
EDGE_SHARE = 0.12


def unresolved_share(shape: SolidShape) -> float:
    """Return the share of the known solid, in [0, 1], in parts whose thickness the voxels do not resolve.

    These are what an opening by a voxel and its six neighbours removes: walls of one or two voxels, and rods
    of up to about three. `EDGE_SHARE` of the known solid counts as edges.
    """
    known = shape.solid & (shape.labels != Label.UNKNOWN)
    removed = known & ~ndimage.binary_opening(shape.solid)
    share = int(removed.sum()) / max(1, int(known.sum()))
    return max(0.0, (share - EDGE_SHARE) / (1 - EDGE_SHARE))
