"""Openings that nobody looked into: by hand on voxels, and in little scenes."""

from typing import Any

import numpy as np
import pytest
from evidence_by_hand import evidence_of, shape_of
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
)

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import rigid, rotation_from_quaternion_xyzw
from kinectbench.core.voxels.observation import Observation
from kinectbench.stages.segment.evidence import weigh
from kinectbench.stages.segment.frontiers import (
    LEAST_AREA_M2,
    LEAST_PROBABILITY,
    LEAST_SHARE,
    Frontier,
    find_frontiers,
    where_to_stand,
)
from kinectbench.stages.segment.openings import OPENING_M
from kinectbench.stages.segment.solid import make_solid

CELLS, CELL_M = (40, 40, 40), 0.01
# A solid beside everything else, large enough that what lies behind small frontiers counts.
SOLID = np.s_[0:5, 0:20, 0:20]
OPENING_CELLS = round(OPENING_M / CELL_M)
FLAT = np.eye(4)


def mask(*boxes: tuple[slice, ...]) -> np.ndarray:
    cells = np.zeros(CELLS, bool)
    for box in boxes:
        cells[box] = True
    return cells


def found_of(
    unseen: np.ndarray,
    carved: np.ndarray,
    probability: float | np.ndarray = 0.3,
    T_floor_grid: np.ndarray = FLAT,
    labels: np.ndarray | None = None,
    solid: np.ndarray | None = None,
    **evidence: Any,
) -> tuple[Frontier, ...]:
    """Frontiers of unseen voxels from which all ways up lead out, if nothing else is said."""
    evidence = {"ups": (9 * unseen).astype(np.uint8), "opening_cells": OPENING_CELLS, **evidence}
    solid = mask(SOLID) if solid is None else solid
    shape = shape_of(solid, np.where(unseen, probability, 0.0), labels, voxel_m=CELL_M)
    return find_frontiers(shape, evidence_of(CELLS, open=unseen, carved=carved, **evidence), T_floor_grid)


PIT, ABOVE_PIT = np.s_[10:30, 12:24, 5:15], np.s_[10:30, 12:24, 15:25]


def test_of_a_pit_by_hand() -> None:
    (found,) = found_of(mask(PIT), mask(ABOVE_PIT))
    assert found.direction == "up" and found.look_from == (0, 0, 1)
    assert found.area_m2 == pytest.approx(0.2 * 0.12)
    assert found.size_m == pytest.approx((0.2, 0.12))
    # On the boundary between the two, in the middle.
    assert found.center_m == pytest.approx((0.2, 0.18, 0.15))
    assert found.volume_m3 == pytest.approx(0.2 * 0.12 * 0.1)
    assert found.advice == "nobody looked into the opening at the top, 20 x 12 cm: record from above"


def test_what_is_expected_behind_one() -> None:
    unseen, solid = mask(PIT), mask(SOLID, np.s_[10:20, 12:24, 5:15])
    probability = np.where(solid, 0.7, 0.2)
    (found,) = found_of(unseen, mask(ABOVE_PIT), probability, solid=solid)
    assert found.inside_share == pytest.approx((0.7 + 0.2) / 2)
    assert found.solid_share == pytest.approx(0.5)
    assert found.inside_solid_share == pytest.approx(0.7 / 2)


@pytest.mark.parametrize(
    ("ways", "direction"),
    [
        ({"ups": 9, "levels": 8}, "up"),
        ({"ups": 3, "levels": 8}, "side"),
        ({"ups": 0, "levels": 2, "downs": 1}, "side"),
        ({"ups": 0, "levels": 2, "downs": 9}, "down"),
        ({"ups": 5, "levels": 0, "downs": 9}, "up"),
    ],
)
def test_the_direction_in_which_most_ways_lead_out(ways: dict[str, int], direction: str) -> None:
    """A block in the air: a way up counts twice, and a level one one and a half times."""
    block = mask(np.s_[15:25, 15:25, 15:25])
    rays = {name: (value * block).astype(np.uint8) for name, value in ways.items()}
    (found,) = found_of(block, ~block, **rays)
    assert found.direction == direction
    assert found.area_m2 == pytest.approx(0.01)
    assert found.size_m == pytest.approx((0.1, 0.1))
    sign = {"up": 1, "side": 0, "down": -1}[direction]
    assert found.look_from[2] == sign
    words = {
        "up": "at the top, 10 x 10 cm",
        "side": "at the side, 10 x 10 cm",
        "down": "underside, 10 x 10 cm",
    }
    assert words[direction] in found.advice


@pytest.mark.parametrize(
    ("look_from", "words"),
    [
        ((0.0, 0.0, 1.0), "from above"),
        ((0.6, 0.0, 0.8), "from the direction (0.6, 0.0) of the floor frame, obliquely from above"),
        ((0.0, -1.0, 0.0), "from the direction (0.0, -1.0) of the floor frame, at the height of 45 cm"),
        (
            (-0.7, -0.01, -0.7),
            "from the direction (-0.7, 0.0) of the floor frame, lower than 45 cm, looking up",
        ),
        ((0.0, 0.0, -1.0), "from below, lower than 45 cm"),
    ],
)
def test_words_say_where_the_look_is_from(look_from: tuple[float, float, float], words: str) -> None:
    """The underside of an inner shelf, say, is seen from its open side and not from the floor."""
    assert where_to_stand(look_from, 0.45) == words


def test_where_most_ways_lead_it_may_end_at_no_free_space() -> None:
    """A pit with a cracked bottom: most of its voxels see less of its mouth than of what is below it."""
    unseen = mask(PIT)
    ways = {"ups": unseen.astype(np.uint8), "downs": (9 * unseen).astype(np.uint8)}
    (found,) = found_of(unseen, mask(ABOVE_PIT), **ways)
    assert found.direction == "up" and found.size_m == pytest.approx((0.2, 0.12))
    # Nor is it the larger opening that counts, as long as both are ones.
    below, cell = np.s_[10:30, 12:14, 0:5], np.s_[10, 12, 0:5]
    (found,) = found_of(unseen, mask(ABOVE_PIT, below), **ways)
    assert found.direction == "down" and found.area_m2 == pytest.approx(0.2 * 0.02)
    (found,) = found_of(unseen, mask(ABOVE_PIT, cell), **ways)
    assert found.direction == "up"


def level(unseen: np.ndarray) -> dict[str, np.ndarray]:
    return {"ups": np.zeros(CELLS, np.uint8), "levels": (8 * unseen).astype(np.uint8)}


@pytest.mark.parametrize(("axis", "sign"), [(0, 1), (0, -1), (1, 1), (1, -1)])
def test_at_the_side_one_looks_in_where_it_is_open(axis: int, sign: int) -> None:
    """A niche 20 cm wide, 10 cm high and 12 cm deep, open on one side."""
    unseen = mask(np.s_[10:22, 10:30, 5:15]) if axis == 0 else mask(np.s_[10:30, 10:22, 5:15])
    carved = np.roll(unseen, sign * 12, axis)
    (found,) = found_of(unseen, carved & ~unseen, **level(unseen))
    expected, centre = np.zeros(3), np.array([0.2, 0.2, 0.1])
    expected[axis], centre[axis] = sign, 0.22 if sign > 0 else 0.1
    np.testing.assert_allclose(found.look_from, expected, atol=1e-12)
    np.testing.assert_allclose(found.center_m, centre)
    assert found.size_m == pytest.approx((0.2, 0.1)) and found.area_m2 == pytest.approx(0.02)
    x, y = expected[:2] + 0.0
    assert f"record from the direction ({x:.1f}, {y:.1f}) of the floor frame" in found.advice.replace(
        "-0.0", "0.0"
    )
    assert found.advice.endswith("at the height of 10 cm")


def test_a_direction_is_written_without_a_minus_before_zero() -> None:
    found = Frontier("side", 0.1, (0.2, 0.1), (0.0, 0.0, 0.1), (-0.02, -1.0, 0.0), 0.1, 0.5, 0.5, 0.3)
    assert "(0.0, -1.0)" in found.advice


def test_a_corner_is_looked_into_across_and_a_gap_from_its_larger_side() -> None:
    block = mask(np.s_[15:25, 15:25, 10:20])
    corner = mask(np.s_[25:35, 15:25, 10:20], np.s_[15:25, 25:35, 10:20])
    (found,) = found_of(block, corner, **level(block))
    np.testing.assert_allclose(found.look_from, (np.sqrt(0.5), np.sqrt(0.5), 0))
    assert found.area_m2 == pytest.approx(np.sqrt(2) * 0.01)
    assert found.size_m == pytest.approx((np.sqrt(2) * 0.1, 0.1), abs=0.015)
    # Half-way between the middles of both faces.
    assert found.center_m == pytest.approx((0.225, 0.225, 0.15))
    gap = mask(np.s_[25:35, 15:25, 10:20], np.s_[5:15, 15:22, 10:20])
    (found,) = found_of(block, gap, **level(block))
    assert found.look_from == (1, 0, 0) and found.area_m2 == pytest.approx(0.01)


def test_above_a_slope_one_looks_in_aslant_but_at_least_half_from_above() -> None:
    block = mask(np.s_[15:25, 15:25, 10:20])
    (found,) = found_of(block, mask(np.s_[15:25, 15:25, 20:], np.s_[25:, 15:25, 15:20]))
    np.testing.assert_allclose(found.look_from, np.array([1, 0, 2]) / np.sqrt(5))
    assert found.area_m2 == pytest.approx(0.01)
    (found,) = found_of(block, mask(np.s_[15:25, 15:20, 20:], np.s_[25:, 15:25, 10:20]))
    np.testing.assert_allclose(found.look_from, np.array([1, 0, 1]) / np.sqrt(2))
    assert found.area_m2 == pytest.approx(0.005)


def test_in_another_frame_of_the_floor() -> None:
    turn = np.radians(30)
    rotation = rotation_from_quaternion_xyzw([0, 0, np.sin(turn / 2), np.cos(turn / 2)])
    T_floor_grid = rigid(rotation, [1.0, -2.0, 0.3])
    (above,) = found_of(mask(PIT), mask(ABOVE_PIT), T_floor_grid=T_floor_grid)
    # The smallest box around it is turned with it.
    assert above.size_m == pytest.approx((0.2, 0.12), abs=0.004)
    np.testing.assert_allclose(above.look_from, (0, 0, 1), atol=1e-12)
    np.testing.assert_allclose(above.center_m, rotation @ (0.2, 0.18, 0.15) + [1.0, -2.0, 0.3])
    niche = mask(np.s_[10:22, 10:30, 5:15])
    (beside,) = found_of(niche, mask(np.s_[22:, 10:30, 5:15]), T_floor_grid=T_floor_grid, **level(niche))
    np.testing.assert_allclose(beside.look_from, (np.cos(turn), np.sin(turn), 0), atol=1e-12)
    assert beside.size_m == pytest.approx((0.2, 0.1))
    assert "at the height of 40 cm" in beside.advice and "(0.9, 0.5)" in beside.advice


def test_the_largest_volume_comes_first() -> None:
    pits = [np.s_[10:20, 0:10, 5:10], np.s_[10:20, 15:25, 2:10], np.s_[10:20, 30:40, 4:10]]
    found = found_of(mask(*pits), mask(np.s_[10:20, :, 10:20]))
    assert [one.volume_m3 for one in found] == pytest.approx([8e-4, 6e-4, 5e-4])
    assert [one.center_m[1] for one in found] == pytest.approx([0.2, 0.35, 0.05])


def test_pieces_that_touch_at_a_corner_are_one() -> None:
    touching = mask(np.s_[10:20, 10:20, 5:10], np.s_[20:30, 20:30, 5:10])
    (found,) = found_of(touching, mask(np.s_[10:30, 10:30, 10:20]))
    assert found.area_m2 == pytest.approx(0.02) and found.size_m[0] == pytest.approx(
        0.2 * np.sqrt(2), abs=0.02
    )


@pytest.mark.parametrize("thick", [OPENING_CELLS - 1, OPENING_CELLS])
def test_a_layer_thinner_than_an_opening_has_none(thick: int) -> None:
    unseen = mask(np.s_[10:30, 12:24, 15 - thick : 15])
    assert len(found_of(unseen, mask(ABOVE_PIT))) == (thick == OPENING_CELLS)


def test_little_behind_it_or_a_small_mouth_is_not_told() -> None:
    little = mask(np.s_[10:16, 12:18, 10:15])
    large = 180 / LEAST_SHARE
    for solid_cells, told in ((large - 400, True), (large + 400, False)):
        solid = mask(np.s_[0:8]).cumsum().reshape(CELLS) <= solid_cells
        assert solid.sum() == solid_cells
        assert bool(found_of(little, mask(np.s_[10:16, 12:18, 15:20]), solid=solid)) == told
    # The same volume behind a mouth of that area, and of one cell more.
    cells = round(LEAST_AREA_M2 / CELL_M**2)
    pit = mask(np.s_[10:30, 12:24, 5:15])
    for mouth, told in ((cells - 1, False), (cells, True)):
        assert bool(found_of(pit, mask(np.s_[10 : 10 + mouth, 12, 15:20]))) == told


def test_what_is_decided_or_hidden_is_no_frontier() -> None:
    unseen, above = mask(PIT), mask(ABOVE_PIT)
    for rule in ("under", "empty"):
        assert found_of(unseen, above, **{rule: unseen}) == ()
    assert found_of(unseen, above, labels=np.full(CELLS, Label.INTERIOR, np.uint8)) == ()
    assert found_of(unseen, above, probability=0.9 * LEAST_PROBABILITY) == ()
    assert len(found_of(unseen, above, probability=1.1 * LEAST_PROBABILITY)) == 1
    # What borders on no free space is behind nothing.
    assert found_of(unseen, mask()) == ()
    assert found_of(mask(), above) == ()


# The floor's frame is that of the grid, whose world is turned, but for its height.
T_FLOOR_GRID = rigid(np.eye(3), [0.0, 0.0, -FLOOR_LAYERS * VOXEL_M])


def scene(observed: Observation) -> tuple[Frontier, ...]:
    evidence = weigh(observed, np.zeros(SHAPE, bool), LAYERS, 0.0)
    return find_frontiers(make_solid(observed, evidence, LAYERS), evidence, T_FLOOR_GRID)


def test_a_closed_body_and_one_with_a_narrow_crack_have_none() -> None:
    assert scene(observation(box_distance(*BODY))) == ()
    assert scene(observation(body_with_a_crack(0.025))) == ()


@pytest.mark.parametrize("height_m", [0.24, 0.1])
def test_of_a_bin_nobody_looked_into(height_m: float) -> None:
    (found,) = scene(observation(bin_seen_to(height_m)))
    assert found.direction == "up" and found.solid_share == 0
    assert found.size_m == pytest.approx((0.16, 0.1)) and found.area_m2 == pytest.approx(0.016)
    assert found.center_m == pytest.approx((0.16, 0.12, height_m))
    assert found.look_from == pytest.approx((0, 0, 1))
    assert found.advice == "nobody looked into the opening at the top, 16 x 10 cm: record from above"
    # Inside of walls as thick as a surface tells of, down to the floor.
    assert found.volume_m3 == pytest.approx(0.17 * 0.11 * height_m, rel=0.1)


def test_of_a_vase_whose_neck_hides_nearly_all_of_it() -> None:
    """From hardly any voxel a way leads up and out, but only its mouth was open."""
    belly_m = box_distance((0.03, 0.03, -1.0), (0.29, 0.21, 0.24))
    neck_m = box_distance((0.11, 0.07, -1.0), (0.21, 0.17, 0.34))
    hole_m = box_distance((0.13, 0.09, 0.02), (0.19, 0.15, 1.0))
    (found,) = scene(observation(looked_into(np.minimum(belly_m, neck_m), hole_m, centers()[..., 2] > 0.28)))
    assert found.direction == "up" and found.size_m == pytest.approx((0.06, 0.06))
    assert found.center_m == pytest.approx((0.16, 0.12, 0.28)) and found.volume_m3 > 0.005


def test_of_a_wide_crack() -> None:
    (found,) = scene(observation(body_with_a_crack(0.04)))
    assert found.direction == "up" and found.size_m[1] == pytest.approx(0.04)
    # Beside it the body is closed: below a crack it goes on.
    assert found.solid_share > 0.9 and found.inside_share > 0.85


def test_of_a_compartment() -> None:
    (found,) = scene(observation(cupboard_seen_to(0.15)))
    assert found.direction == "side" and found.look_from == pytest.approx((0, 1, 0))
    assert found.size_m == pytest.approx((0.16, 0.26)) and found.center_m == pytest.approx((0.16, 0.15, 0.15))
    assert found.advice == (
        "nobody looked into the opening at the side, 16 x 26 cm: record from the direction (0.0, 1.0) of the "
        "floor frame, at the height of 15 cm"
    )
