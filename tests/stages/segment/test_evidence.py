"""What is unknown, and what is known by definition, in little scenes: cracks, cavities, undersides."""

from dataclasses import replace

import numpy as np
import pytest
from observed_boxes import (
    BODY,
    FLOOR_LAYERS,
    LAYERS,
    SHAPE,
    VOXEL_M,
    Room,
    bin_seen_to,
    body_with_a_crack,
    box_distance,
    centers,
    cupboard_seen_to,
    looked_into,
    observation,
    within,
)

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.types import Underside
from kinectbench.core.voxels.line_kernels import FROM_ABOVE, FROM_BELOW
from kinectbench.core.voxels.observation import Observation
from kinectbench.core.voxels.seeable import seen_from_outside
from kinectbench.stages.segment.judge.frontiers import find_frontiers
from kinectbench.stages.segment.solid.evidence import (
    LEAST_WEIGHT_SHARE,
    SHELL_M,
    FloorLayers,
    Rules,
    VoxelEvidence,
    classify_voxels,
)
from kinectbench.stages.segment.solid.solid import SolidShape, make_solid

NOTHING = np.zeros(SHAPE, bool)
RULES = Rules(LAYERS)
# What of the body no wall reaches.
CORE = within((0.085, 0.075, 0.0), (0.235, 0.165, 0.275))


def classified(observed: Observation, rules: Rules = RULES) -> tuple[VoxelEvidence, SolidShape]:
    evidence = classify_voxels(observed, NOTHING, rules)
    return evidence, make_solid(observed, evidence, rules)


@pytest.mark.parametrize(
    "distance_m",
    [bin_seen_to(0.1), body_with_a_crack(0.04), box_distance((0.06, 0.05, 0.02), (0.26, 0.19, 0.3))],
)
def test_every_voxel_is_one_thing(distance_m: np.ndarray) -> None:
    evidence, shape = classified(observation(distance_m))
    kinds = [evidence.free & ~evidence.excluded, evidence.near_surface, evidence.excluded, evidence.unseen]
    above_floor = np.s_[:, :, FLOOR_LAYERS:]
    assert (np.sum(kinds, axis=0)[above_floor] == 1).all()
    assert not (evidence.closed & ~evidence.unseen).any() and not (evidence.closed & evidence.underside).any()
    # What no line of sight reaches is of the object, unless it is told from the floor by what is above it.
    high = np.s_[:, :, LAYERS.first :]
    assert (evidence.closed[high] == (evidence.unseen & (evidence.sight == 0))[high]).all()
    assert evidence.underside[high][(evidence.unseen & (evidence.sight == FROM_BELOW))[high]].all()
    assert (evidence.unseen & (evidence.sight > 0))[evidence.underside & (evidence.sight > 0)].all()
    assert not (shape.labels[evidence.closed & shape.solid] == Label.UNKNOWN).any()


@pytest.mark.parametrize("height_m", [0.24, 0.1])
def test_below_the_mouth_of_an_open_box_nothing_is_known(height_m: float) -> None:
    evidence, shape = classified(observation(bin_seen_to(height_m)))
    unseen = within((0.085, 0.075, 0.02), (0.235, 0.165, height_m))
    assert (evidence.sight[unseen] & FROM_ABOVE).all()
    assert (shape.labels[unseen] == Label.UNKNOWN).all() and not shape.solid[unseen].any()
    # Its walls were measured from outside: so far they are known, and free space is, too.
    wall = within((0.06, 0.05, 0.02), (0.26, 0.19, height_m)) & ~within((0.07, 0.06, 0), (0.25, 0.18, 1))
    assert shape.solid[wall].all() and (shape.labels[wall] == Label.SURFACE).all()
    looked_at = within((0.09, 0.08, height_m), (0.23, 0.16, 0.3))
    assert (shape.labels[looked_at] == Label.FREE).all()


def test_the_same_box_closed_is_known_to_be_solid() -> None:
    evidence, shape = classified(observation(box_distance(*BODY)))
    assert CORE.sum() > 20_000 and evidence.closed[CORE].all()
    assert shape.solid[CORE].all() and (shape.labels[CORE] == Label.INTERIOR).all()
    assert not evidence.unknown.any()


@pytest.mark.parametrize(
    ("width_m", "reached"), [(0.01, False), (0.02, False), (0.03, True), (0.04, True), (0.08, True)]
)
def test_a_crack_that_lines_of_half_the_width_pass(width_m: float, reached: bool) -> None:
    """All of them were looked into as far. Lines are 30 mm wide, and asked with half of that."""
    evidence, shape = classified(observation(body_with_a_crack(width_m)))
    below = within((0.16 - width_m / 2, 0.08, 0.03), (0.16 + width_m / 2, 0.16, 0.24))
    assert ((evidence.sight[below] > 0) == reached).mean() > 0.95
    expected = Label.UNKNOWN if reached else Label.INTERIOR
    assert (shape.labels[below] == expected).mean() > 0.95
    # What was seen through is free all the same.
    if width_m >= 0.02:
        assert (shape.labels[within((0.157, 0.07, 0.26), (0.163, 0.17, 0.3))] == Label.FREE).all()


def test_lines_are_as_wide_as_the_benchmark_says() -> None:
    narrow = replace(RULES, limits=SensorLimits(line_width_m=0.01))
    below = within((0.155, 0.08, 0.03), (0.165, 0.16, 0.24))
    for rules, known in ((RULES, True), (narrow, False)):
        evidence, _ = classified(observation(body_with_a_crack(0.02)), rules)
        assert (evidence.closed[below] == known).mean() > 0.95


def test_around_the_corner_of_a_shaft_it_is_known_but_what_a_line_reaches_is_not() -> None:
    """A shoe: the mouth is over one end of the body. Lines that come in obliquely reach into the toe."""
    shaft_m = box_distance((0.08, 0.07, 0.02), (0.14, 0.17, 1.0))
    seen = centers()[..., 2] > 0.24
    evidence, shape = classified(observation(looked_into(box_distance(*BODY), shaft_m, seen)))
    shaft = within((0.085, 0.075, 0.02), (0.135, 0.165, 0.24))
    assert (shape.labels[shaft] == Label.UNKNOWN).all()
    # Nobody measured a wall between the shaft and the toe: obliquely one would look in through the mouth.
    toe = within((0.15, 0.10, 0.05), (0.19, 0.14, 0.1))
    assert (evidence.sight[toe] > 0).all() and (shape.labels[toe] == Label.UNKNOWN).all()
    # Right under the measured top no line from the mouth leads.
    under_top = within((0.17, 0.08, 0.255), (0.23, 0.16, 0.28))
    assert evidence.closed[under_top].all() and (shape.labels[under_top] == Label.INTERIOR).all()


def test_an_opening_at_the_side() -> None:
    evidence, shape = classified(observation(cupboard_seen_to(0.15)))
    unseen = within((0.085, 0.075, 0.03), (0.235, 0.145, 0.265))
    assert (evidence.sight[unseen] & FROM_ABOVE).all() and (shape.labels[unseen] == Label.UNKNOWN).all()


@pytest.mark.parametrize("truncation_m", [0.02, 0.04])
def test_deep_behind_a_wall_a_surface_says_nothing_of_a_cavity(truncation_m: float) -> None:
    """However far depth was fused: what lies farther behind the outer face than a wall is thick is unseen."""
    evidence, shape = classified(observation(bin_seen_to(0.24), truncation_m=truncation_m))
    high = (centers()[..., 2] > 0.02) & (centers()[..., 2] < 0.23)
    outer_m = box_distance(*BODY)
    shell = high & (outer_m < 0) & (outer_m > -SHELL_M)
    beyond = high & (outer_m < -SHELL_M - 1.5 * VOXEL_M)
    assert evidence.near_surface[shell].all() and shape.solid[shell & (outer_m < -VOXEL_M)].all()
    assert evidence.unseen[beyond].all() and (shape.labels[beyond] == Label.UNKNOWN).all()
    assert not shape.solid[beyond].any()
    # In a closed body it is interior all the same.
    closed, solid = classified(observation(outer_m, truncation_m=truncation_m))
    assert closed.closed[beyond].all() and (solid.labels[beyond] == Label.INTERIOR).all()


# A slab in the air, seen from above and from its sides: nobody looked at its underside.
SLAB = ((0.05, 0.04, 0.2), (0.27, 0.20, 0.28))


def slab() -> Observation:
    leg_m = box_distance((0.02, 0.02, -1.0), (0.04, 0.04, 0.3))
    hidden = within((0.05, 0.04, 0.0), (0.27, 0.20, 0.2)) | within((0.07, 0.06, 0.0), (0.25, 0.18, 0.265))
    return observation(np.minimum(box_distance(*SLAB), leg_m), hidden=hidden)


@pytest.mark.parametrize("word", ["unseen", "open", "closed"])
def test_an_underside_that_nobody_saw_is_what_a_person_says(word: Underside) -> None:
    rules = replace(RULES, underside=word)
    evidence, shape = classified(slab(), rules)
    inner = within((0.08, 0.07, 0.23), (0.24, 0.17, 0.26))
    assert evidence.underside[inner].all()
    # Whatever is said, which voxels rest on the word is kept.
    assert shape.underside[inner].all() and (shape.underside_share > 0.2) == (word != "open")
    expected = Label.INTERIOR if word == "closed" else Label.UNKNOWN
    assert (shape.labels[inner] == expected).all()
    assert (shape.solid[inner] == (word != "open")).all()
    # Below it level lines pass: it is not known how far down it goes, whatever is said.
    below = within((0.08, 0.07, 0.1), (0.24, 0.17, 0.17))
    assert (shape.labels[below] == Label.UNKNOWN).all() and not shape.solid[below].any()


@pytest.mark.parametrize("lowest_m", [0.08, -1.0])
@pytest.mark.parametrize("said", ["unseen", "closed"])
def test_the_word_on_the_underside_is_none_on_what_lies_above_an_opening_in_a_side(
    said: Underside, lowest_m: float
) -> None:
    """A box that stands flat, with a window or a door: who looks in does not see what is above it.

    Only a camera that looks up sees that, through the window or the door.
    """
    inner = ((0.08, 0.07, 0.02), (0.24, 0.17, 0.28))
    window_m = box_distance((0.2, 0.08, lowest_m), (1.0, 0.16, 0.16))
    box_m = np.maximum(box_distance((0.06, 0.05, 0.0), (0.26, 0.19, 0.3)), -box_distance(*inner))
    small = SensorLimits(line_width_m=0.02, near_m=0.05, camera_size_m=0.15, camera_height_m=0.03)
    above = within((0.08, 0.07, 0.16), (0.24, 0.17, 0.28))
    observed = observation(np.maximum(box_m, -window_m), hidden=above)
    evidence, shape = classified(observed, replace(RULES, limits=small, underside=said))
    lit = within((0.1, 0.09, 0.19), (0.22, 0.15, 0.26)) & (evidence.sight == FROM_BELOW)
    assert lit.sum() > 2000
    assert not evidence.underside[above].any() and (shape.labels[lit] == Label.UNKNOWN).all()


def test_the_word_closes_the_bottom_and_not_what_is_seen_through_a_slot() -> None:
    """A box on legs with a slot in its side: its bottom was not seen, nor what is above the slot."""
    inner = ((0.08, 0.07, 0.14), (0.24, 0.17, 0.28))
    slot_m = box_distance((0.2, 0.07, 0.14), (1.0, 0.17, 0.18))
    leg_m = box_distance((0.06, 0.05, 0.0), (0.08, 0.07, 0.13))
    box_m = np.maximum(box_distance((0.06, 0.05, 0.12), (0.26, 0.19, 0.3)), -box_distance(*inner))
    above = within((0.08, 0.07, 0.18), inner[1])
    observed = observation(
        np.minimum(np.maximum(box_m, -slot_m), leg_m),
        hidden=above | within((0.08, 0.07, 0.06), (0.24, 0.17, 0.15)),
    )
    small = SensorLimits(line_width_m=0.02, near_m=0.05, camera_size_m=0.06, camera_height_m=0.03)
    evidence, shape = classified(observed, replace(RULES, limits=small, underside="closed"))
    through_slot = within((0.1, 0.09, 0.19), (0.14, 0.15, 0.23))
    assert (shape.labels[through_slot] == Label.UNKNOWN).mean() > 0.9
    assert evidence.underside[through_slot].mean() < 0.1


def test_next_to_the_floor_it_is_as_above() -> None:
    """A box without a bottom that stands on two thick walls: nobody looked in along the floor."""
    tunnel_m = box_distance((0.08, -1.0, -1.0), (0.24, 1.0, 0.25))
    y_m = centers()[..., 1]
    distance_m = looked_into(box_distance(*BODY), tunnel_m, (y_m < 0.08) | (y_m > 0.16))
    evidence, shape = classified(observation(distance_m))
    inner = within((0.1, 0.09, 0.0), (0.22, 0.15, 0.2))
    assert (shape.labels[inner] == Label.UNKNOWN).all()
    assert evidence.contact == slice(FLOOR_LAYERS, LAYERS.first)
    # What stands goes on down, as known as it is above.
    leg = within((0.065, 0.06, 0.0), (0.07, 0.18, 0.1))
    assert shape.solid[leg].all() and (shape.labels[leg] != Label.UNKNOWN).all()
    # Beside it the floor is not the object, and that is known.
    beside = within((0.01, 0.01, 0.0), (0.04, 0.04, 0.02))
    assert not (shape.labels[beside] == Label.UNKNOWN).any()


@pytest.mark.parametrize(("said", "label"), [("unseen", Label.UNKNOWN), ("closed", Label.INTERIOR)])
def test_a_camera_that_would_rise_through_the_underside_does_not_see_past_it(
    said: Underside, label: Label
) -> None:
    """A sideboard on high legs: a camera fits below it, and nothing measured keeps it from rising inside."""
    walls_m = np.maximum(
        box_distance((0.06, 0.05, 0.12), (0.26, 0.19, 0.3)),
        -box_distance((0.08, 0.07, -1), (0.24, 0.17, 0.28)),
    )
    leg_m = box_distance((0.06, 0.05, 0.0), (0.08, 0.07, 0.2))
    hidden = within((0.08, 0.07, 0.0), (0.24, 0.17, 0.28))
    small = SensorLimits(line_width_m=0.02, near_m=0.05, camera_size_m=0.06, camera_height_m=0.03)
    inner = within((0.09, 0.08, 0.14), (0.23, 0.16, 0.27))
    observed = observation(np.minimum(walls_m, leg_m), hidden=hidden)
    evidence, shape = classified(observed, replace(RULES, limits=small, underside=said))
    assert (evidence.sight[inner] & FROM_ABOVE).mean() > 0.3 and evidence.underside[inner].all()
    assert (shape.labels[inner] == label).all()
    # Below it one looks level, whatever is said.
    beneath = within((0.12, 0.09, 0.05), (0.2, 0.15, 0.09))
    assert not evidence.underside[beneath].any() and (shape.labels[beneath] == Label.UNKNOWN).all()


def test_without_a_plane_one_may_look_up_from_anywhere() -> None:
    """A bell that hangs, open below: with a plane right under it no camera fits there."""
    bell_m = np.maximum(
        box_distance((0.06, 0.05, 0.06), (0.26, 0.19, 0.3)),
        -box_distance((0.08, 0.07, -1), (0.24, 0.17, 0.28)),
    )
    inner = within((0.085, 0.075, 0.12), (0.235, 0.165, 0.26))
    hidden = within((0.08, 0.07, -1), (0.24, 0.17, 0.28))
    observed = observation(bell_m, hidden=hidden, floor=False)
    hanging = Rules(FloorLayers(0, 0, 0), stands=False)
    evidence, shape = classified(observed, hanging)
    assert (evidence.sight[inner] & FROM_BELOW).all() and (shape.labels[inner] == Label.UNKNOWN).all()


@pytest.mark.parametrize(("share", "observed"), [(0.5, False), (2.0, True)])
def test_what_a_few_rays_grazed_is_unseen(share: float, observed: bool) -> None:
    seen = observation(box_distance(*BODY))
    grazed = within((0.12, 0.1, 0.14), (0.2, 0.14, 0.18))
    weight, tsdf = seen.weight.copy(), seen.tsdf.copy()
    weight[grazed], tsdf[grazed] = share * LEAST_WEIGHT_SHARE * 5, 0.01
    evidence = classify_voxels(replace(seen, weight=weight, tsdf=tsdf), NOTHING, RULES)
    assert (evidence.observed[grazed] == observed).all() and (evidence.free[grazed] == observed).all()
    assert (evidence.unseen[grazed] == (not observed)).all()


# A body 45 mm above the floor, on a foot: its sides below lead inwards to the floor, 25 mm.
OVER_A_GAP = np.minimum(
    box_distance((0.06, 0.05, 0.045), (0.26, 0.19, 0.3)),
    np.maximum(
        box_distance((0.06, 0.05, -1), (0.26, 0.19, 0.05)),
        (box_distance((0.06, 0.05, -1), (0.26, 0.19, 1)) + (0.045 - centers()[..., 2]) * 25 / 45) * 0.87,
    ),
)
# On the floor of a larger room: round things, of which the sides lean in by themselves.
TABLE = Room(0.005, (0.64, 0.64, 0.4))
POINTS_M = TABLE.centers()
FROM_AXIS_M = np.linalg.norm(POINTS_M[..., :2] - 0.32, axis=-1)
POT = np.maximum((FROM_AXIS_M - 0.14 - 0.11 * POINTS_M[..., 2] / 0.3) * 0.94, POINTS_M[..., 2] - 0.3)
BALL = np.linalg.norm(POINTS_M - [0.32, 0.32, 0.15], axis=-1) - 0.15
LYING = np.maximum(
    np.linalg.norm(POINTS_M[..., 1:] - [0.32, 0.1], axis=-1) - 0.1, np.abs(POINTS_M[..., 0] - 0.32) - 0.2
)


@pytest.mark.parametrize(
    ("body_m", "blurred_m", "label"),
    [
        (OVER_A_GAP, 0.0, Label.INTERIOR),  # a camera of fine pixels measured that surface
        (OVER_A_GAP, 0.03, Label.INTERIOR),  # no line of sight enters so low a gap
        (OVER_A_GAP, 0.06, Label.UNKNOWN),
        (box_distance((0.06, 0.05, -1), (0.26, 0.19, 0.3)), 0.06, Label.INTERIOR),  # stands flat
        (box_distance((0.06, 0.05, -1), (0.26, 0.19, 0.05)), 0.06, Label.INTERIOR),  # a board
        (box_distance((0.06, 0.05, -1), (0.26, 0.19, 0.3)), 0.6, Label.INTERIOR),  # higher than the grid
    ],
)
def test_a_gap_below_the_object_that_blur_closes_is_unknown(
    body_m: np.ndarray, blurred_m: float, label: Label
) -> None:
    small = SensorLimits(near_m=0.05, camera_size_m=0.06, camera_height_m=0.03)
    evidence, shape = classified(observation(body_m), replace(RULES, limits=small, blurred_m=blurred_m))
    beneath = within((0.12, 0.1, 0.0), (0.2, 0.14, 0.02))
    assert (shape.labels[beneath] == label).mean() > 0.95
    assert evidence.unknown[beneath].any() == (label is Label.UNKNOWN)


@pytest.mark.parametrize(("body_m", "most_unknown"), [(POT, 0.001), (BALL, 0.0), (LYING, 0.2)])
def test_round_things_lose_nothing_by_a_blurred_gap(body_m: np.ndarray, most_unknown: float) -> None:
    """What lies on the floor as a roll does may have a gap below: unknown, but hardly taken for air (1 %)."""
    observed, true = TABLE.observation(body_m), (body_m < 0) & (POINTS_M[..., 2] > 0)
    rules = Rules(TABLE.layers)
    shapes = [
        make_solid(observed, classify_voxels(observed, TABLE.nothing(), each), each)
        for each in (rules, replace(rules, blurred_m=0.06))
    ]
    before, blurred = ((true & ~shape.solid).sum() / true.sum() for shape in shapes)
    assert blurred <= before + 0.02
    unknown = [(true & (shape.labels == Label.UNKNOWN)).sum() / true.sum() for shape in shapes]
    assert unknown[1] <= unknown[0] + most_unknown


def test_layers_about_the_floor() -> None:
    layers = FloorLayers(below=4, contact=2, low=3)
    assert (layers.first, layers.cut) == (6, 9)


def test_rules_of_a_small_thing_are_for_the_larger_world() -> None:
    small = Rules(LAYERS, ray_width_m=0.001, blurred_m=0.01, limits=SensorLimits(line_width_m=0.02))
    rules = small.enlarged(0.25)
    assert (
        rules.ray_width_m == pytest.approx(0.004)
        and rules.blurred_m == pytest.approx(0.04)
        and rules.limits.line_width_m == pytest.approx(0.08)
    )
    assert rules.limits.near_m == pytest.approx(1.6) and rules.layers == LAYERS


def test_a_camera_passes_where_the_measured_gap_is_a_little_too_narrow() -> None:
    # A corridor of 17 cm leads to a room around the corner. Sheets on both sides measure it as 14 cm.
    room = Room(0.01, (0.9, 0.9, 0.6))
    corridor = room.box_distance((0.12, -1.0, 0.02), (0.29, 0.78, 0.52))
    around_corner = room.box_distance((0.31, 0.12, 0.02), (0.78, 0.78, 0.52))
    doorway = room.box_distance((0.25, 0.58, 0.02), (0.35, 0.78, 0.52))
    body = room.box_distance((0.1, 0.1, -1.0), (0.8, 0.8, 0.54))
    hollow = np.minimum.reduce([corridor, around_corner, doorway])
    seen_there = room.centers()[..., 1] < 0.3
    observed = room.observation(looked_into(body, corridor, seen_there))
    evidence = classify_voxels(observed, room.nothing(), Rules(room.layers))
    # The part of the room that no line from outside reaches.
    corner = room.within((0.4, 0.16, 0.1), (0.74, 0.4, 0.45))
    obstacle, heights_m = np.maximum(body, -hollow) < 0, room.centers()[0, 0, :, 2].astype(np.float32)
    air = seen_from_outside(obstacle, heights_m, room.voxel_m, SensorLimits()) > 0
    assert air[corner].all()
    assert not evidence.closed[corner].any()
    shape = make_solid(observed, evidence, Rules(room.layers))
    first, *_ = find_frontiers(shape, evidence, SensorLimits(), np.eye(4))
    assert first.from_inside and "hold the camera inside, and record" in first.advice(0.0)
