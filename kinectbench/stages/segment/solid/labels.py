"""Label each voxel by how it is known: free, surface, interior, other, or unknown."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.types import Bools
from kinectbench.stages.segment.solid.evidence import VoxelEvidence

# A voxel this near to a measured surface, in voxels, is measured.
MEASURED_VOXELS = 1.5


def voxel_labels(evidence: VoxelEvidence, solid: Bools, voxel_m: float, below: int) -> NDArray[np.uint8]:
    """Return a label (`Label`) for each voxel by its evidence: (i, j, k) uint8.

    If smoothing removed a voxel behind a measured surface from the solid, it is UNKNOWN, because no frame saw
    it empty.

    Args:
        evidence: the class of each voxel.
        solid: (i, j, k) bool, the voxels of the object.
        voxel_m: edge of a voxel, metres.
        below: number of layers below the floor.
    """
    near = np.abs(evidence.signed_m) <= MEASURED_VOXELS * voxel_m
    measured = evidence.observed & near & ~evidence.free
    labels = np.full(solid.shape, Label.UNKNOWN, np.uint8)
    labels[~solid & evidence.free] = Label.FREE
    labels[~solid & evidence.excluded] = Label.OTHER
    labels[solid & evidence.closed] = Label.INTERIOR
    labels[solid & (evidence.near_surface | measured) & ~evidence.unknown] = Label.SURFACE
    labels[:, :, :below] = Label.OTHER
    return labels
