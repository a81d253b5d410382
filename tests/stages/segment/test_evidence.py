"""What is open, in little scenes whose openings are known: seals, cracks, cavities, and the floor."""

from dataclasses import replace

import numpy as np
import pytest
from observed_boxes import (
    BODY,
    FLOOR_LAYERS,
    LAYERS,
    SHAPE,
    VOXEL_M,
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
from kinectbench.core.voxels.observation import Observation
from kinectbench.stages.segment.evidence import (
    LEAST_WEIGHT_SHARE,
    SHELL_M,
    Evidence,
    FloorLayers,
    weigh,
)
from kinectbench.stages.segment.openings import (
    OPENING_M,
    STAND_M,
    _cavity,
    _sealed,
    opening_cells,
)
from kinectbench.stages.segment.probability import (
    AMONG_INSIDE_SHARE,
    CAVITY_INSIDE_SHARE,
    HUNG_INSIDE_SHARE,
)
from kinectbench.stages.segment.rays import INSIDE, OUTSIDE, SEALED, UNSEEN
from kinectbench.stages.segment.solid import SolidShape, make_solid

NOTHING = np.zeros(SHAPE, bool)
# What of the body no wall reaches, and what of that lies higher than where it may stand on its edges.
CORE = within((0.085, 0.075, 0.0), (0.235, 0.165, 0.275))
HIGH_CORE = CORE & (centers()[..., 2] > STAND_M)


def weighed(observed: Observation) -> tuple[Evidence, SolidShape]:
    evidence = weigh(observed, NOTHING, LAYERS, 0.0)
    return evidence, make_solid(observed, evidence, LAYERS)


@pytest.mark.parametrize(
    "distance_m",
    [bin_seen_to(0.1), body_with_a_crack(0.04), box_distance((0.06, 0.05, 0.02), (0.26, 0.19, 0.3))],
)
def test_what_was_seen_is_not_open(distance_m: np.ndarray) -> None:
    evidence, _ = weighed(observation(distance_m))
    assert not (evidence.openings.open & ~(evidence.unseen | evidence.behind)).any()


@pytest.mark.parametrize("height_m", [0.24, 0.1])
def test_below_the_mouth_of_an_open_box_nothing_is_known(height_m: float) -> None:
    evidence, shape = weighed(observation(bin_seen_to(height_m)))
    unseen = within((0.08, 0.07, 0.0), (0.24, 0.17, height_m))
    assert evidence.openings.open[unseen].all() and evidence.openings.cavity[unseen].all()
    assert (shape.labels[unseen] == Label.UNKNOWN).all() and not shape.solid[unseen].any()
    assert shape.probability[unseen].max() <= CAVITY_INSIDE_SHARE.max()
    # Its walls were measured from outside: so far they are known, and free space is, too.
    wall = within((0.06, 0.05, 0.02), (0.26, 0.19, height_m)) & ~within((0.07, 0.06, 0), (0.25, 0.18, 1))
    assert shape.solid[wall].all() and (shape.labels[wall] != Label.UNKNOWN).all()
    looked_at = within((0.09, 0.08, height_m), (0.23, 0.16, 0.3))
    assert (shape.labels[looked_at] == Label.FREE).all()


def test_the_same_box_closed_is_known_to_be_solid() -> None:
    evidence, shape = weighed(observation(box_distance(*BODY)))
    assert HIGH_CORE.sum() > 20_000 and not evidence.openings.open[HIGH_CORE].any()
    assert shape.solid[HIGH_CORE].all() and (shape.labels[HIGH_CORE] == Label.INTERIOR).all()
    assert not evidence.openings.cavity.any()


@pytest.mark.parametrize(
    ("width_m", "is_open", "is_cavity"),
    [
        (0.02, False, False),
        (0.025, False, False),
        (0.03, True, False),
        (0.04, True, False),
        (0.08, True, True),
    ],
)
def test_a_crack_a_wide_crack_and_a_cavity(width_m: float, is_open: bool, is_cavity: bool) -> None:
    """All of them were looked into as far. Through the first two no cube of 30 mm passes."""
    assert is_open == (width_m >= OPENING_M)
    evidence, shape = weighed(observation(body_with_a_crack(width_m)))
    below = within((0.16 - width_m / 2, 0.08, 0.03), (0.16 + width_m / 2, 0.16, 0.24))
    assert (evidence.openings.open[below] == is_open).all() and (
        evidence.openings.cavity[below] == is_cavity
    ).all()
    assert (shape.labels[below] == (Label.UNKNOWN if is_open else Label.INTERIOR)).all()
    # Below a crack the body goes on, as between cushions; a cavity is empty.
    assert (shape.solid[below] == (not is_cavity)).mean() > 0.95
    if is_open and not is_cavity:
        # What is closed beside it says so, too, but not right below its mouth.
        assert shape.probability[below].min() < AMONG_INSIDE_SHARE[1]
        assert shape.probability[below].max() > AMONG_INSIDE_SHARE[0]
    # What was seen through is free all the same.
    assert (shape.labels[within((0.155, 0.07, 0.26), (0.165, 0.17, 0.3))] == Label.FREE).all()


def test_a_shallow_layer_that_nobody_saw_is_open_but_no_cavity() -> None:
    """The bin was looked into down to 20 mm above its bottom, which some frames measured."""
    bottom_m = 0.08
    cavity_m = box_distance((0.08, 0.07, bottom_m), (0.24, 0.17, 1.0))
    whole_m = np.maximum(box_distance(*BODY), -cavity_m)
    layer = within((0.08, 0.07, bottom_m + VOXEL_M), (0.24, 0.17, bottom_m + 0.02))
    evidence, shape = weighed(observation(whole_m, layer))
    inner = layer & within((0.1, 0.09, 0), (0.22, 0.15, 1))
    assert evidence.openings.open[inner].all() and not evidence.openings.cavity.any()
    assert (shape.labels[inner] == Label.UNKNOWN).all()


def test_what_lies_beside_a_cavity_is_open_as_the_toe_of_a_shoe() -> None:
    """The mouth is over one end of the body, and the other end is as hollow for all that is known."""
    shaft_m = box_distance((0.08, 0.07, 0.02), (0.14, 0.17, 1.0))
    seen = centers()[..., 2] > 0.24
    evidence, shape = weighed(observation(looked_into(box_distance(*BODY), shaft_m, seen)))
    shaft, toe = (
        within((0.08, 0.07, 0.0), (0.14, 0.17, 0.24)),
        within((0.145, 0.075, 0.0), (0.235, 0.165, 0.1)),
    )
    assert evidence.openings.cavity[shaft].all() and not evidence.openings.cavity[toe].all()
    # From hardly any voxel of the toe a ray leads out of the mouth.
    assert (evidence.openings.ups[toe] == 0).mean() > 0.9 and not evidence.openings.levels[
        toe & HIGH_CORE
    ].any()
    assert evidence.openings.open[toe].all() and (shape.labels[toe] == Label.UNKNOWN).all()
    # Without a mouth the toe is closed.
    closed, _ = weighed(observation(box_distance(*BODY)))
    assert not closed.openings.open[toe & HIGH_CORE].any()


def test_an_opening_at_the_side() -> None:
    evidence, shape = weighed(observation(cupboard_seen_to(0.15)))
    unseen = within((0.08, 0.07, 0.02), (0.24, 0.15, 0.27))
    assert evidence.openings.open[unseen].all() and not evidence.openings.cavity.any()
    assert (evidence.openings.levels[unseen] > 0).all() and (shape.labels[unseen] == Label.UNKNOWN).all()
    beside = unseen & (evidence.openings.ups == 0)
    assert beside.sum() > 500
    # It is a guess, whichever.
    assert shape.probability[beside].min() > 0.2 and shape.probability[beside].max() < 0.9


@pytest.mark.parametrize("truncation_m", [0.02, 0.04])
def test_deep_behind_a_wall_a_surface_says_nothing_of_a_cavity(truncation_m: float) -> None:
    """However far depth was fused: what lies farther behind the outer face than a wall is thick is open."""
    evidence, shape = weighed(observation(bin_seen_to(0.24), truncation_m=truncation_m))
    high = (centers()[..., 2] > STAND_M) & (centers()[..., 2] < 0.23)
    outer_m = box_distance(*BODY)
    shell = high & (outer_m < 0) & (outer_m > -SHELL_M)
    deep = high & (outer_m < -SHELL_M - 1.5 * VOXEL_M)
    assert evidence.behind[deep & (outer_m > -truncation_m)].all()
    assert not evidence.openings.open[shell].any() and shape.solid[shell & (outer_m < -VOXEL_M)].all()
    assert evidence.openings.open[deep].all() and (shape.labels[deep] == Label.UNKNOWN).all()
    assert not shape.solid[deep].any()
    # In a closed body it is interior all the same.
    closed, solid = weighed(observation(outer_m, truncation_m=truncation_m))
    assert not closed.openings.open[deep].any() and (solid.labels[deep] == Label.INTERIOR).all()


def test_a_void_at_the_floor_may_be_what_a_body_stands_around() -> None:
    """A ring under a bottom lifts it by millimetres that nobody sees; a leg is too thin to be hollow."""
    low_m, high_m = (0.28, 0.05), (0.305, 0.075)
    leg_m = box_distance((*low_m, -1.0), (*high_m, 0.36))
    outer_m = box_distance(*BODY)
    evidence, shape = weighed(observation(np.minimum(outer_m, leg_m)))
    height_m = centers()[..., 2]
    low = CORE & (height_m > 0) & (height_m < STAND_M)
    assert low.sum() > 2000 and evidence.openings.open[low].all()
    # It is more likely solid, but that is not known.
    assert shape.solid[low].all() and (shape.labels[low] == Label.UNKNOWN).all()
    assert not evidence.openings.open[HIGH_CORE].any()
    # What was measured from outside goes on down to the floor, and so does a leg.
    foot = (
        (height_m > 0) & (height_m < STAND_M) & ((outer_m < 0) & (outer_m > -SHELL_M + VOXEL_M) | (leg_m < 0))
    )
    assert (
        not evidence.openings.open[foot].any() and (shape.labels[foot & shape.solid] != Label.UNKNOWN).all()
    )
    assert shape.solid[foot & (np.minimum(outer_m, leg_m) < -VOXEL_M)].all()


def test_next_to_the_floor_it_is_as_open_as_above() -> None:
    """A box without a bottom that stands on two thick walls: nobody looked in along the floor."""
    tunnel_m = box_distance((0.08, -1.0, -1.0), (0.24, 1.0, 0.25))
    y_m = centers()[..., 1]
    distance_m = looked_into(box_distance(*BODY), tunnel_m, (y_m < 0.08) | (y_m > 0.16))
    evidence, shape = weighed(observation(distance_m))
    inner = within((0.1, 0.09, 0.0), (0.22, 0.15, 0.2))
    assert evidence.openings.open[inner].all() and (shape.labels[inner] == Label.UNKNOWN).all()
    above = evidence.openings.open[:, :, [LAYERS.first]]
    contact = evidence.openings.open[:, :, evidence.contact]
    assert evidence.contact == slice(FLOOR_LAYERS, LAYERS.first) and contact[above.repeat(4, axis=2)].all()


def test_a_narrow_gap_is_sealed_and_a_wide_one_is_not() -> None:
    """Two plates; only where a cube of six voxels passes between them it is free."""
    for gap in (5, 6):
        state = np.full((24, 24, 24), OUTSIDE, np.uint8)
        state[4:20, 4:9], state[4:20, 9 + gap : 20] = INSIDE, INSIDE
        sealed = _sealed(state, round(OPENING_M / VOXEL_M))
        assert sealed[4:20, 9 : 9 + gap].all() if gap == 5 else not sealed.any()
        # Beside the plates, and at the border of the grid, anything passes.
        assert not sealed[:4].any() and not sealed[:, :4].any() and not sealed[:, 20:].any()
    # What is unseen is not sealed: that is a word for free space.
    state = np.where(state == OUTSIDE, np.uint8(UNSEEN), state)
    assert not _sealed(state, round(OPENING_M / VOXEL_M)).any() and SEALED not in state


def test_a_mouth_is_where_most_ways_up_lead_out_in_a_whole_cube() -> None:
    open_above = np.zeros((30, 30, 30), bool)
    open_above[2:14, 2:14, 2:20] = open_above[16:28, 16:28, 2:20] = True
    ups = open_above.astype(np.uint8)
    # The one has a mouth of six voxels; the other sees most of the sky from five layers only.
    ups[4:10, 4:10, 14:20] = ups[16:28, 16:28, 15:20] = 4
    found = _cavity(open_above, ups, round(OPENING_M / VOXEL_M))
    assert found[2:14, 2:14, 2:20].all() and not found[16:28].any()
    ups[16:28, 16:28, 14] = 3
    assert not _cavity(open_above, ups, round(OPENING_M / VOXEL_M))[16:28].any()


@pytest.mark.parametrize(("share", "observed"), [(0.5, False), (2.0, True)])
def test_what_a_few_rays_grazed_is_unseen(share: float, observed: bool) -> None:
    seen = observation(box_distance(*BODY))
    grazed = within((0.12, 0.1, 0.14), (0.2, 0.14, 0.18))
    weight, tsdf = seen.weight.copy(), seen.tsdf.copy()
    weight[grazed], tsdf[grazed] = share * LEAST_WEIGHT_SHARE * 5, 0.01
    evidence = weigh(replace(seen, weight=weight, tsdf=tsdf), NOTHING, LAYERS, 0.0)
    assert (evidence.observed[grazed] == observed).all() and (evidence.carved[grazed] == observed).all()
    assert (evidence.unseen[grazed] == (not observed)).all()


@pytest.mark.parametrize(
    ("bottom_m", "top_m", "hung"), [(0.1, 0.36, True), (0.06, 0.36, False), (0.16, 0.34, False)]
)
def test_what_hangs_high_and_is_open_below_may_be_a_shade(bottom_m: float, top_m: float, hung: bool) -> None:
    """80 mm wide: the first hangs higher than that and is 0.26 m thick, then one hangs lower, one is thin."""
    body_m = box_distance((0.12, 0.08, bottom_m), (0.20, 0.16, top_m))
    inner = within((0.125, 0.085, bottom_m - VOXEL_M), (0.195, 0.155, top_m - 0.005))
    pole_m = box_distance((0.01, 0.01, -1.0), (0.03, 0.03, 0.36))
    evidence, shape = weighed(observation(np.minimum(body_m, pole_m), hidden=inner))
    core = within((0.14, 0.10, bottom_m + 0.02), (0.18, 0.14, top_m - 0.05))
    assert (evidence.openings.hung[core] == hung).all()
    if hung:
        assert (shape.labels[core] == Label.UNKNOWN).all()
        assert (shape.probability[core] == HUNG_INSIDE_SHARE).all()


@pytest.mark.parametrize(("height_mm", "is_plate"), [(21.0, True), (18.0, False)])
@pytest.mark.parametrize("starts_m", [0.06, 0.12])
def test_a_plate_that_hardly_rises_above_the_floor(height_mm: float, is_plate: bool, starts_m: float) -> None:
    """It ends above the contact layers, at 20 mm, and below the middle of the next."""
    post_m = box_distance((0.06, 0.05, -1.0), (0.10, 0.19, 0.3))
    plate_m = box_distance((starts_m, 0.05, -1.0), (0.26, 0.19, height_mm / 1000))
    plate = within((0.14, 0.06, 0.0), (0.25, 0.18, 0.02))
    evidence, shape = weighed(observation(np.minimum(post_m, plate_m)))
    of_object = is_plate and starts_m < 0.1
    assert (evidence.raised[plate.any(axis=2)] == of_object).all()
    assert (shape.solid[plate] == of_object).all()
    # Farther below its surface than that tells it may stand on its edges.
    if of_object:
        assert (shape.labels[plate & (centers()[..., 2] > 0.01)] != Label.UNKNOWN).all()


def test_layers_about_the_floor() -> None:
    layers = FloorLayers(below=4, contact=2, low=3)
    assert (layers.first, layers.cut) == (6, 9)


@pytest.mark.parametrize(
    ("ray_width_m", "voxel_m", "cells"),
    [(0, 0.005, 6), (0.003, 0.005, 6), (0.0012, 0.005, 2), (0.003, 0.05, 1)],
)
def test_an_opening_is_narrower_for_a_sensor_that_is_near(
    ray_width_m: float, voxel_m: float, cells: int
) -> None:
    assert opening_cells(ray_width_m, voxel_m) == cells
