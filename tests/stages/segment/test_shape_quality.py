"""What quality.json estimates, against values computed by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import Grid, TriangleMesh
from kinectbench.stages.segment.quality import _unsupported, estimated_iou, expected_iou, volume_share_per_mm
from kinectbench.stages.segment.solid import SolidShape


def shape_of(solid: np.ndarray, probability: np.ndarray) -> SolidShape:
    labels = np.full(solid.shape, Label.UNKNOWN, np.uint8)
    mesh = TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    return SolidShape(Grid(solid.shape, 0.01, np.eye(4)), solid, labels, probability.astype(np.float32), mesh)


@pytest.mark.parametrize(("low", "parted"), [(0, False), (6, False), (0, True), (6, True)])
def test_a_solid_that_hangs_or_falls_apart(low: int, parted: bool) -> None:
    """The floor is at z = 0, 10 mm a voxel: at 60 mm it hangs; a gap of a layer parts it."""
    solid = np.zeros((8, 8, 20), bool)
    solid[2:6, 2:6, low:16] = True
    solid[2:6, 2:6, 12] = not parted
    vertices = np.argwhere(solid) * 0.01
    mesh = TriangleMesh(vertices, np.zeros((0, 3), np.int64))
    shape = replace(shape_of(solid, solid), mesh=mesh)
    floor = SimpleNamespace(found=True, T_floor_world=np.eye(4))
    warnings = _unsupported(SimpleNamespace(floor=floor), shape)
    assert [line[:34] for line in warnings] == (
        ["the solid begins 0.06 m above the "] * (low > 0) + ["the solid is in 2 large pieces tha"] * parted
    )


def test_expected_iou_by_hand():
    solid = np.array([[[True, True, False, False]]])
    assert expected_iou(shape_of(solid, solid)) == 1
    # 0.9 + 0.7 of two voxels are inside; outside, 0.4 more are expected.
    assert expected_iou(shape_of(solid, np.array([[[0.9, 0.7, 0.4, 0.0]]]))) == pytest.approx(1.6 / 2.4)


def test_expected_iou_of_calibrated_voxels_is_the_actual_one():
    rng = np.random.default_rng(0)
    probability = rng.uniform(size=(60, 60, 60)) ** 3
    true, solid = rng.uniform(size=probability.shape) < probability, probability > 0.5
    actual = (true & solid).sum() / (true | solid).sum()
    assert expected_iou(shape_of(solid, probability)) == pytest.approx(actual, abs=0.01)


def test_estimated_iou():
    assert estimated_iou(1.0, 1.0, 0.0) == 1
    assert estimated_iou(0.8, 0.9, 0.02) == pytest.approx(1 - 0.044 - 0.092 - 0.046)
    assert estimated_iou(0.0, 0.0, 0.0) == 0
    better = ((0.8, 0.95, 0.02), (0.9, 0.95, 0.02), (0.9, 0.99, 0.02), (0.9, 0.99, 0.01))
    ascending = [estimated_iou(*figures) for figures in better]
    assert ascending == sorted(set(ascending))


def test_of_a_thin_board_a_millimetre_is_much():
    board = trimesh.creation.box((1.0, 0.6, 0.02))
    mesh = TriangleMesh(np.asarray(board.vertices), np.asarray(board.faces, np.int32))
    area_m2, volume_m3 = 2 * (0.6 + 0.02 + 0.012), 0.012
    assert volume_share_per_mm(mesh) == pytest.approx(0.001 * area_m2 / volume_m3)
