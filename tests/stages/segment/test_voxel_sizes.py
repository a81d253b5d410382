"""Rules in metres say the same on voxels of 5, 10 and 20 mm: scenes large enough for the coarsest."""

import numpy as np
import pytest
from observed_boxes import Room, looked_into
from slow import slow

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.voxels.observation import Observation
from kinectbench.stages.segment.evidence import Evidence, weigh
from kinectbench.stages.segment.frontiers import find_frontiers
from kinectbench.stages.segment.morphology import carried_up
from kinectbench.stages.segment.openings import STAND_M
from kinectbench.stages.segment.solid import SolidShape, make_solid

LOW, HIGH = (0.1, 0.1, -1.0), (0.54, 0.38, 0.6)


# Hollows are looked for deeper than depth was fused: by four voxels of 20 mm nearly none would be left.
FUSED_M = 0.04


@pytest.fixture(params=[slow(0.005), 0.01, 0.02], ids=["5 mm", "10 mm", "20 mm"])
def room(request: pytest.FixtureRequest) -> Room:
    voxel_m: float = request.param
    return Room(voxel_m, (0.64, 0.48, 0.8))


def weighed(room: Room, observed: Observation) -> tuple[Evidence, SolidShape]:
    evidence = weigh(observed, room.nothing(), room.layers, 0.0)
    return evidence, make_solid(observed, evidence, room.layers)


def core(room: Room, bottom_m: float, top_m: float) -> np.ndarray:
    """What of the body between two heights no wall of 60 mm reaches."""
    return room.within((LOW[0] + 0.08, LOW[1] + 0.08, bottom_m), (HIGH[0] - 0.08, HIGH[1] - 0.08, top_m))


def test_a_closed_body_is_known_but_for_what_it_may_stand_on(room: Room) -> None:
    evidence, shape = weighed(room, room.observation(room.box_distance(LOW, HIGH)))
    high, low = core(room, STAND_M, HIGH[2] - 0.1), core(room, 0.0, STAND_M)
    assert shape.solid[high].all() and (shape.labels[high] == Label.INTERIOR).all()
    assert shape.solid[low].all() and (shape.labels[low] == Label.UNKNOWN).all()
    assert not evidence.openings.cavity.any() and not evidence.openings.hung.any()
    assert find_frontiers(shape, evidence, np.eye(4)) == ()


@pytest.mark.parametrize("height_m", [0.2, 0.4])
def test_a_bin_is_unknown_below_where_one_looked(room: Room, height_m: float) -> None:
    hole_m = room.box_distance((LOW[0] + 0.04, LOW[1] + 0.04, 0.04), (HIGH[0] - 0.04, HIGH[1] - 0.04, 1.0))
    seen = room.centers()[..., 2] > height_m
    body_m = looked_into(room.box_distance(LOW, HIGH), hole_m, seen)
    evidence, shape = weighed(room, room.observation(body_m))
    inner = core(room, STAND_M, height_m)
    assert evidence.openings.open[inner].all() and evidence.openings.cavity[inner].all()
    assert (shape.labels[inner] == Label.UNKNOWN).all() and not shape.solid[inner].any()
    (found,) = find_frontiers(shape, evidence, np.eye(4))
    assert found.direction == "up"
    # The grid's own frame begins below the floor.
    assert found.center_m == pytest.approx((0.32, 0.24, height_m + 0.02), abs=0.001)


def test_a_compartment_is_open_at_the_side(room: Room) -> None:
    inner_m = room.box_distance((LOW[0] + 0.04, LOW[1] + 0.04, 0.04), (HIGH[0] - 0.04, 1.0, HIGH[2] - 0.04))
    seen = room.centers()[..., 1] > 0.3
    body_m = looked_into(room.box_distance(LOW, HIGH), inner_m, seen)
    evidence, shape = weighed(room, room.observation(body_m))
    inner = room.within((LOW[0] + 0.1, LOW[1] + 0.1, 0.1), (HIGH[0] - 0.1, 0.28, HIGH[2] - 0.12))
    assert evidence.openings.open[inner].all() and not evidence.openings.cavity[inner].any()
    assert (shape.labels[inner] == Label.UNKNOWN).all()
    (found,) = find_frontiers(shape, evidence, np.eye(4))
    assert found.direction == "side" and found.look_from == pytest.approx((0, 1, 0))


@pytest.mark.parametrize(("bottom_m", "top_m", "hung"), [(0.3, 0.74, True), (0.1, 0.74, False)])
def test_what_hangs_high_may_be_a_shade(room: Room, bottom_m: float, top_m: float, hung: bool) -> None:
    """160 mm wide: the first hangs higher than that."""
    low, high = (0.24, 0.16, bottom_m), (0.4, 0.32, top_m)
    inner = room.within((0.26, 0.18, bottom_m - 0.02), (0.38, 0.3, top_m - 0.02))
    pole_m = room.box_distance((0.02, 0.02, -1.0), (0.08, 0.08, 0.74))
    body_m = np.minimum(room.box_distance(low, high), pole_m)
    evidence, shape = weighed(room, room.observation(body_m, hidden=inner))
    middle = room.within((0.3, 0.22, bottom_m + 0.06), (0.34, 0.26, top_m - 0.1))
    assert (evidence.openings.hung[middle] == hung).all()
    if hung:
        assert (shape.labels[middle] == Label.UNKNOWN).all()


@pytest.mark.parametrize(("height_m", "doubted"), [(0.12, True), (0.4, False)])
def test_what_looks_like_a_slab_is_doubtful_if_it_is_low(room: Room, height_m: float, doubted: bool) -> None:
    low, high = (0.1, 0.1, 0.3), (0.54, 0.38, 0.3 + height_m)
    pillar_m = room.box_distance((*low[:2], -1.0), high)
    hidden = (pillar_m < 0) & (room.centers()[..., 2] < low[2])
    _, shape = weighed(room, room.observation(pillar_m, hidden, truncation_m=FUSED_M))
    middle = room.within((0.2, 0.2, low[2] + 0.02), (0.44, 0.28, low[2] + 0.06))
    assert shape.solid[middle].all()
    assert (shape.labels[middle] == (Label.UNKNOWN if doubted else Label.INTERIOR)).all()


@pytest.mark.parametrize("juts_out", [True, False])
def test_behind_the_aprons_of_a_seat_is_a_hollow(room: Room, juts_out: bool) -> None:
    """A seat 40 mm thick on aprons of 80 mm: no camera looked at it from below."""
    inset_m = 0.04 if juts_out else 0.0
    low, high = (0.1 + inset_m, 0.1 + inset_m), (0.54 - inset_m, 0.38 - inset_m)
    seat_m = room.box_distance((0.1, 0.1, 0.42), (0.54, 0.38, 0.46))
    pillar_m = room.box_distance((*low, -1.0), (*high, 0.46))
    hidden = (pillar_m < 0) & (room.centers()[..., 2] < 0.34)
    observed = room.observation(np.minimum(seat_m, pillar_m), hidden, truncation_m=FUSED_M)
    evidence, shape = weighed(room, observed)
    middle = room.within((0.24, 0.22, 0.36), (0.4, 0.26, 0.4))
    assert (evidence.hollows.sure[middle] == juts_out).all()
    assert (shape.solid[middle] != juts_out).all() and (shape.labels[middle] == Label.UNKNOWN).all()


@pytest.mark.parametrize(("gap_m", "carried"), [(0.04, True), (0.08, True), (0.14, False)])
def test_a_leg_is_carried_up_over_a_gap(room: Room, gap_m: float, carried: bool) -> None:
    seat = room.within((0.1, 0.1, 0.44), (0.54, 0.38, 0.52))
    leg = room.within((0.2, 0.2, 0.0), (0.26, 0.26, 0.44 - gap_m))
    gap = room.within((0.2, 0.2, 0.44 - gap_m), (0.26, 0.26, 0.44))
    found = carried_up(seat | leg, room.nothing(), room.layers.first, room.voxel_m)
    assert (found == (seat | leg | gap if carried else seat | leg)).all()
