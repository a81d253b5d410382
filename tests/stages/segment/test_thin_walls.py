"""Parts whose thickness is not resolved: on solids of known thickness, and in the estimate."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from evidence_by_hand import shape_of

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.types import Bools
from kinectbench.stages.segment.judge.estimate import EDGE_SHARE, PoseError, estimate_iou, unresolved_share
from kinectbench.stages.segment.solid.solid import SolidShape

SIDE, VOXEL_M = 40, 0.005


def known(cells: Bools) -> SolidShape:
    """All is known; the mesh is a board of 10 mm, of which no millimetre is off."""
    box = trimesh.creation.box([0.2, 0.2, 0.01])
    mesh = TriangleMesh(np.asarray(box.vertices), np.asarray(box.faces, np.int32))
    labels = np.where(cells, Label.SURFACE, Label.FREE).astype(np.uint8)
    return shape_of(cells, labels=labels, mesh=mesh, voxel_m=VOXEL_M)


def board(layers: int) -> Bools:
    cells = np.zeros((SIDE, SIDE, SIDE), bool)
    cells[:, :, 20 : 20 + layers] = True
    return cells


def rod(diameter_voxels: float, lean: float) -> Bools:
    """A rod along the third axis, which moves by `lean` along the first from layer to layer."""
    x, y, z = np.meshgrid(*[np.arange(SIDE) + 0.5] * 3, indexing="ij")
    return np.asarray((x - 10 - lean * z) ** 2 + (y - 20) ** 2 < (diameter_voxels / 2) ** 2)


@pytest.mark.parametrize(("layers", "share"), [(1, 1.0), (2, 1.0), (3, 0.0), (6, 0.0)])
def test_thin_boards_are_found(layers: int, share: float) -> None:
    assert unresolved_share(known(board(layers))) == pytest.approx(share, abs=0.02)


@pytest.mark.parametrize("lean", [0.0, 0.3])
def test_a_rod_is_resolved_if_it_is_four_voxels_thick(lean: float) -> None:
    assert unresolved_share(known(rod(2.0, lean))) > 0.7
    assert unresolved_share(known(rod(4.0, lean))) < 0.1


def test_edges_of_a_thick_body_do_not_count() -> None:
    cells = np.zeros((SIDE, SIDE, SIDE), bool)
    cells[5:35, 5:35, 5:12] = True
    assert unresolved_share(known(cells)) == 0.0


def test_only_what_is_known_counts() -> None:
    cells = board(1)
    half = cells.copy()
    half[: SIDE // 2] = False
    for unknown, share in ((half, 1.0), (cells, 0.0)):
        shape = known(cells)
        labels = np.where(unknown, np.uint8(Label.UNKNOWN), shape.labels)
        assert unresolved_share(replace(shape, labels=labels)) == share


def test_a_thick_body_beside_a_thin_wall() -> None:
    cells = board(1)
    cells[:10, :, 10:21] = True
    thin = SIDE * (SIDE - 10) / cells.sum()
    least = (thin - EDGE_SHARE) / (1 - EDGE_SHARE)
    assert least > 0.1 and least <= unresolved_share(known(cells)) <= least + 0.06  # and the body's edges


def test_the_estimate_expects_half_of_it() -> None:
    shape, certain = known(board(1)), PoseError(0.0)
    without = estimate_iou(shape, 0.0, certain, ())
    half, whole = (estimate_iou(shape, 0.0, certain, (), unresolved=share) for share in (0.5, 1.0))
    assert half.known == pytest.approx(0.75 * without.known) and half.value == pytest.approx(
        0.75 * without.value
    )
    assert half.known_low == pytest.approx(0.5 * without.known_low) and whole.known_low == whole.low == 0
    assert half.known_high == without.known_high and half.high == without.high
    assert "parts too thin for their thickness to be measured: 50% of what is known" in half.reasons
    assert not any("too thin" in line for line in without.reasons)
