"""Rooms wider than the doorway through which they were looked into, in little scenes."""

import numpy as np
from observed_boxes import (
    BODY,
    LAYERS,
    VOXEL_M,
    box_distance,
    centers,
    cupboard_seen_to,
    looked_into,
    observation,
)

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.stages.segment.evidence import Evidence, weigh
from kinectbench.stages.segment.frontiers import find_frontiers
from kinectbench.stages.segment.solid import make_solid

ROOM = ((0.08, 0.07, 0.02), (0.24, 0.17, 0.28))
DOOR_X, DOOR_TOP = (0.12, 0.2), 0.16


def kennel(looked_in: bool) -> tuple[np.ndarray, np.ndarray]:
    """Distance of what was measured of `BODY` with a room and a doorway towards y, and the room's unseen.

    Frames looked straight in: to the back wall behind the doorway, and not around its corners.
    """
    door_m = box_distance((DOOR_X[0], 0.16, 0.02), (DOOR_X[1], 1.0, DOOR_TOP))
    room_m = box_distance(*ROOM)
    x, z = centers()[..., 0], centers()[..., 2]
    seen = (x > DOOR_X[0]) & (x < DOOR_X[1]) & (z < DOOR_TOP) & looked_in
    return looked_into(box_distance(*BODY), np.minimum(room_m, door_m), seen), (room_m < 0) & ~seen


def weighed(distance_m: np.ndarray) -> Evidence:
    return weigh(observation(distance_m), np.zeros(distance_m.shape, bool), LAYERS, 0.0)


def test_what_lies_around_the_corner_of_a_doorway_is_open() -> None:
    distance_m, around_the_corner = kennel(looked_in=True)
    evidence = weighed(distance_m)
    assert evidence.openings.open[around_the_corner & evidence.unseen].mean() > 0.9


def test_it_is_unknown_and_one_is_told_to_look_through_the_doorway() -> None:
    distance_m, around_the_corner = kennel(looked_in=True)
    observed = observation(distance_m)
    evidence = weighed(distance_m)
    shape = make_solid(observed, evidence, LAYERS)
    assert (shape.labels[around_the_corner] == Label.UNKNOWN).mean() > 0.9
    found = find_frontiers(shape, evidence, np.eye(4))
    assert found and {one.direction for one in found} == {"side"}
    assert "nobody looked around the corners behind the opening at the side" in found[0].advice
    # Behind it lie the room, and the bottom below it, of which nobody saw how thick it is.
    volume_m3 = around_the_corner.sum() * VOXEL_M**3
    assert volume_m3 <= sum(one.volume_m3 for one in found) < 1.3 * volume_m3
    # It is looked into through the doorway.
    np.testing.assert_allclose(found[0].look_from, (0, 1, 0), atol=0.1)
    np.testing.assert_allclose(found[0].size_m, (DOOR_X[1] - DOOR_X[0], DOOR_TOP - 0.02), atol=0.035)


def test_a_body_that_nobody_could_look_into_is_not() -> None:
    distance_m, room = kennel(looked_in=False)
    assert not weighed(distance_m).openings.open[room].any()


def test_a_compartment_that_is_open_in_front_is_no_room() -> None:
    # All of its front is open: what was not seen of it lies behind its opening, and its boards are closed.
    assert weighed(kennel(looked_in=True)[0]).openings.room.any()
    assert not weighed(cupboard_seen_to(0.1)).openings.room.any()
