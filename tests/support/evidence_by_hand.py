"""Evidence and solids written down by hand, voxel by voxel."""

from typing import Any

import numpy as np

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import Grid, TriangleMesh
from kinectbench.stages.segment.enclosure import Hollows, Shadow
from kinectbench.stages.segment.evidence import Evidence
from kinectbench.stages.segment.openings import Openings
from kinectbench.stages.segment.solid import SolidShape

NO_MESH = TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))


def evidence_of(shape: tuple[int, int, int], **given: Any) -> Evidence:
    """Nothing is said of any voxel but what is given; fields of its parts are given by their own names."""
    no, none = np.zeros(shape, bool), np.zeros(shape, np.uint8)
    fields: dict[str, Any] = {
        "signed_m": np.zeros(shape, np.float32),
        "enclosed": np.zeros(shape, np.float32),
        "hollows": Hollows(given.pop("hollow", no), given.pop("doubtful", no)),
        "shadow": Shadow(given.pop("under", no), given.pop("empty", no)),
        "openings": Openings(
            **{name: given.pop(name, no) for name in ("open", "cavity", "hung", "room")},
            **{name: given.pop(name, none) for name in ("ups", "levels", "downs")},
        ),
        "contact": slice(0, 0),
        "raised": np.zeros(shape[:2], bool),
        "opening_cells": 6,
        "ray_width_m": 0.0,
        **dict.fromkeys(("observed", "carved", "behind", "excluded", "unseen"), no),
    }
    return Evidence(**{**fields, **given})


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
    return SolidShape(grid, solid, labels, probability.astype(np.float32), mesh)
