"""Rules in metres say the same on voxels of 5, 10 and 20 mm: scenes large enough for the coarsest."""

import numpy as np
import pytest
from observed_boxes import Room, looked_into
from slow import slow

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.voxels.line_kernels import FROM_ABOVE
from kinectbench.core.voxels.observation import Observation
from kinectbench.stages.segment.judge.frontiers import find_frontiers
from kinectbench.stages.segment.solid.evidence import Rules, VoxelEvidence, classify_voxels
from kinectbench.stages.segment.solid.solid import SolidShape, carried_up, make_solid

LOW, HIGH = (0.1, 0.1, -1.0), (0.54, 0.38, 0.6)


@pytest.fixture(params=[slow(0.005), 0.01, 0.02], ids=["5 mm", "10 mm", "20 mm"])
def room(request: pytest.FixtureRequest) -> Room:
    voxel_m: float = request.param
    return Room(voxel_m, (0.64, 0.48, 0.8))


def classified(room: Room, observed: Observation) -> tuple[VoxelEvidence, SolidShape]:
    rules = Rules(room.layers)
    evidence = classify_voxels(observed, room.nothing(), rules)
    return evidence, make_solid(observed, evidence, rules)


def core(room: Room, bottom_m: float, top_m: float) -> np.ndarray:
    """What of the body between two heights no wall of 60 mm reaches."""
    return room.within((LOW[0] + 0.08, LOW[1] + 0.08, bottom_m), (HIGH[0] - 0.08, HIGH[1] - 0.08, top_m))


def test_a_closed_body_is_known(room: Room) -> None:
    evidence, shape = classified(room, room.observation(room.box_distance(LOW, HIGH)))
    inner = core(room, 0.0, HIGH[2] - 0.1)
    assert shape.solid[inner].all() and (shape.labels[inner] == Label.INTERIOR).all()
    assert find_frontiers(shape, evidence, Rules(room.layers).limits, np.eye(4)) == ()


@pytest.mark.parametrize("height_m", [0.2, 0.4])
def test_a_bin_is_unknown_below_where_one_looked(room: Room, height_m: float) -> None:
    hole_m = room.box_distance((LOW[0] + 0.04, LOW[1] + 0.04, 0.04), (HIGH[0] - 0.04, HIGH[1] - 0.04, 1.0))
    seen = room.centers()[..., 2] > height_m
    body_m = looked_into(room.box_distance(LOW, HIGH), hole_m, seen)
    evidence, shape = classified(room, room.observation(body_m))
    inner = core(room, 0.06, height_m)
    assert (evidence.sight[inner] & FROM_ABOVE).all() and (shape.labels[inner] == Label.UNKNOWN).all()
    (found,) = find_frontiers(shape, evidence, Rules(room.layers).limits, np.eye(4))
    assert found.direction == "up"
    # The grid's own frame begins below the floor.
    assert found.center_m == pytest.approx((0.32, 0.24, height_m + 0.02), abs=room.voxel_m)


def test_a_compartment_is_open_at_the_side(room: Room) -> None:
    inner_m = room.box_distance((LOW[0] + 0.04, LOW[1] + 0.04, 0.04), (HIGH[0] - 0.04, 1.0, HIGH[2] - 0.04))
    seen = room.centers()[..., 1] > 0.3
    body_m = looked_into(room.box_distance(LOW, HIGH), inner_m, seen)
    evidence, shape = classified(room, room.observation(body_m))
    inner = room.within((LOW[0] + 0.1, LOW[1] + 0.1, 0.1), (HIGH[0] - 0.1, 0.28, HIGH[2] - 0.12))
    assert (evidence.sight[inner] > 0).all() and (shape.labels[inner] == Label.UNKNOWN).all()
    found = find_frontiers(shape, evidence, Rules(room.layers).limits, np.eye(4))
    assert found[0].direction == "side" and found[0].look_from[1] > 0.5


@pytest.mark.parametrize(("gap_m", "carried"), [(0.04, True), (0.08, True), (0.14, False)])
def test_a_leg_is_carried_up_over_a_gap(room: Room, gap_m: float, carried: bool) -> None:
    seat = room.within((0.1, 0.1, 0.44), (0.54, 0.38, 0.52))
    leg = room.within((0.2, 0.2, 0.0), (0.26, 0.26, 0.44 - gap_m))
    gap = room.within((0.2, 0.2, 0.44 - gap_m), (0.26, 0.26, 0.44))
    found = carried_up(seat | leg, room.nothing(), room.layers.first, room.voxel_m)
    assert (found == (seat | leg | gap if carried else seat | leg)).all()
