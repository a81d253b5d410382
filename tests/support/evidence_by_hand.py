"""Evidence and solids written down by hand, voxel by voxel."""

from typing import Any

import numpy as np

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import Grid, TriangleMesh
from kinectbench.stages.segment.solid.evidence import VoxelEvidence
from kinectbench.stages.segment.solid.solid import SolidShape

NO_MESH = TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))


def evidence_of(shape: tuple[int, int, int], **given: Any) -> VoxelEvidence:
    """Nothing is said of any voxel but what is given; there is no plane."""
    no = np.zeros(shape, bool)
    masks = ("observed", "free", "near_surface", "blurred", "excluded", "unseen", "closed", "underside")
    fields: dict[str, Any] = {
        "signed_m": np.zeros(shape, np.float32),
        "sight": np.zeros(shape, np.uint8),
        "contact": slice(0, 0),
        **dict.fromkeys(("space", "lower")),
        **dict.fromkeys(masks, no),
    }
    return VoxelEvidence(**{**fields, **given})


def shape_of(
    solid: np.ndarray,
    probability: np.ndarray | None = None,
    labels: np.ndarray | None = None,
    mesh: TriangleMesh = NO_MESH,
    voxel_m: float = 0.01,
) -> SolidShape:
    """All of it is unknown, and as probable as it is solid, if nothing else is given."""
    if labels is None:
        labels = np.full(solid.shape, Label.UNKNOWN, np.uint8)
    if probability is None:
        probability = solid
    grid = Grid(solid.shape, voxel_m, np.eye(4))
    underside = np.zeros_like(solid)
    return SolidShape(grid, solid, mesh, labels, probability.astype(np.float32), underside)
