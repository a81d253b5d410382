"""Walls whose thickness is not resolved: on solids of known thickness, and in the estimate."""

import numpy as np
import pytest
from evidence_by_hand import shape_of

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import Grid, TriangleMesh
from kinectbench.core.types import Bools
from kinectbench.stages.segment.judge.estimate import PoseError, estimate_iou
from kinectbench.stages.segment.judge.thin_walls import unresolved_share
from kinectbench.stages.segment.solid.solid import SolidShape

SIDE, VOXEL_M = 40, 0.005


def solid_of(
    cells: Bools, thickness_voxels: float, layer: int, *, unknown: Bools | None = None
) -> SolidShape:
    """A board over the whole grid, drawn exactly by a mesh, beside the cells of voxels."""
    half = SIDE * VOXEL_M
    z = (np.array([0.0, thickness_voxels]) + layer) * VOXEL_M
    steps = np.linspace(0, half, 41)
    vertices: list[tuple[float, float, float]] = []
    faces: list[tuple[int, int, int]] = []
    for height in z:
        first = len(vertices)
        vertices += [(x, y, height) for x in steps for y in steps]
        for i in range(40):
            for j in range(40):
                a = first + i * 41 + j
                faces += [(a, a + 1, a + 41), (a + 1, a + 42, a + 41)]
    labels = np.where(cells, Label.SURFACE, Label.FREE).astype(np.uint8)
    if unknown is not None:
        labels[unknown] = Label.UNKNOWN
    mesh = TriangleMesh(np.array(vertices), np.array(faces, np.int32))
    shape = shape_of(cells, labels=labels, mesh=mesh, voxel_m=VOXEL_M)
    assert isinstance(shape.grid, Grid)
    return shape


def board(layers: int) -> Bools:
    cells = np.zeros((SIDE, SIDE, SIDE), bool)
    cells[:, :, 20 : 20 + layers] = True
    return cells


@pytest.mark.parametrize(("layers", "share"), [(1, 1.0), (3, 0.0), (6, 0.0)])
def test_thin_boards_are_found(layers: int, share: float) -> None:
    shape = solid_of(board(layers), layers, 20)
    # At the grid's edge a block has fewer neighbours, but thickness is a ratio.
    assert unresolved_share(shape) == pytest.approx(share, abs=0.02)


def test_only_what_is_known_counts() -> None:
    cells = board(1)
    half = cells.copy()
    half[: SIDE // 2] = False
    assert unresolved_share(solid_of(cells, 1, 20, unknown=half)) == 1.0
    assert unresolved_share(solid_of(cells, 1, 20, unknown=cells)) == 0.0


def test_a_thick_body_beside_a_thin_wall() -> None:
    cells = board(1)
    thick = np.zeros_like(cells)
    thick[:12, :, :20] = True
    shape = solid_of(cells | thick, 1, 20)
    # What lies within a block and a half of the body is averaged with it.
    thin_cells = SIDE * (SIDE - 12) / (cells | thick).sum()
    assert 0.6 * thin_cells <= unresolved_share(shape) <= thin_cells


def test_the_estimate_expects_half_of_it() -> None:
    shape, certain = solid_of(board(1), 1, 20), PoseError(0.0)
    without = estimate_iou(shape, 0.0, certain, ())
    half, whole = (estimate_iou(shape, 0.0, certain, (), unresolved=share) for share in (0.5, 1.0))
    assert half.known == pytest.approx(0.75 * without.known) and half.value == pytest.approx(
        0.75 * without.value
    )
    assert half.known_low == pytest.approx(0.5 * without.known_low) and whole.known_low == whole.low == 0
    assert half.known_high == without.known_high and half.high == without.high
    assert "walls too thin for their thickness to be measured: 50% of what is known" in half.reasons
    assert not any("walls" in line for line in without.reasons)
