"""What quality.json warns of, of solids written down by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
from evidence_by_hand import shape_of

from kinectbench.core.geometry import TriangleMesh
from kinectbench.stages.segment.quality import _unsupported


@pytest.mark.parametrize(("low", "parted"), [(0, False), (6, False), (0, True), (6, True)])
def test_a_solid_that_hangs_or_falls_apart(low: int, parted: bool) -> None:
    """The floor is at z = 0, 10 mm a voxel: at 60 mm it hangs; a gap of a layer parts it."""
    solid = np.zeros((8, 8, 20), bool)
    solid[2:6, 2:6, low:16] = True
    solid[2:6, 2:6, 12] = not parted
    vertices = np.argwhere(solid) * 0.01
    mesh = TriangleMesh(vertices, np.zeros((0, 3), np.int64))
    shape = shape_of(solid, mesh=mesh)
    floor = SimpleNamespace(found=True, T_floor_world=np.eye(4))
    warnings = _unsupported(SimpleNamespace(floor=floor), shape)
    assert [line[:34] for line in warnings] == (
        ["the solid begins 0.06 m above the "] * (low > 0) + ["the solid is in 2 large pieces tha"] * parted
    )
