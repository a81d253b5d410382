"""What some camera could still see, and from where: by hand on voxels, and in little scenes."""

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
from scipy import ndimage

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import rigid, rotation_from_quaternion_xyzw
from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.voxels.observation import Observation
from kinectbench.core.voxels.open_below import without_rising
from kinectbench.core.voxels.sight import line_space
from kinectbench.stages.segment.judge.frontiers import (
    LEAST_AREA_M2,
    LEAST_NARROW_SHARE,
    LEAST_PROBABILITY,
    LEAST_SHARE,
    Frontier,
    find_frontiers,
    where_to_stand,
)
from kinectbench.stages.segment.solid.evidence import Rules, classify_voxels, narrow
from kinectbench.stages.segment.solid.solid import make_solid

CELLS, CELL_M = (40, 40, 40), 0.01
# A solid beside everything else, large enough that what lies behind small frontiers counts.
SOLID = np.s_[0:5, 0:20, 0:20]
LIMITS = SensorLimits(near_m=0.0)
FLAT = np.eye(4)


def mask(*boxes: tuple[slice | int, ...]) -> np.ndarray:
    cells = np.zeros(CELLS, bool)
    for box in boxes:
        cells[box] = True
    return cells


def found_of(
    unknown: np.ndarray,
    free: np.ndarray,
    probability: float | np.ndarray = 0.3,
    T_floor_grid: np.ndarray = FLAT,
    labels: np.ndarray | None = None,
    solid: np.ndarray | None = None,
    surface: np.ndarray | None = None,
    **evidence: Any,
) -> tuple[Frontier, ...]:
    """Frontiers of unknown voxels, which are walled in but for where they border on free space."""
    solid = mask(SOLID) if solid is None else solid
    shape = shape_of(solid, np.where(unknown, probability, 0.0), labels, voxel_m=CELL_M)
    walls = ndimage.binary_dilation(unknown, np.ones((3, 3, 3))) & ~unknown & ~free
    space = line_space(walls if surface is None else surface, None, CELL_M, narrow(LIMITS, CELL_M))
    lines = {"space": space, "lower": without_rising(space, free)}
    said = evidence_of(CELLS, unseen=unknown, free=free, **lines, **evidence)
    return find_frontiers(shape, said, LIMITS, T_floor_grid)


PIT, ABOVE_PIT = np.s_[10:30, 12:24, 5:15], np.s_[10:30, 12:24, 15:40]


def test_of_a_pit_by_hand() -> None:
    (found,) = found_of(mask(PIT), mask(ABOVE_PIT))
    assert found.direction == "up" and found.look_from[2] > 0.7 and not found.underside
    assert not found.from_inside
    assert found.area_m2 == pytest.approx(0.2 * 0.12)
    assert found.size_m == pytest.approx((0.2, 0.12))
    # On the boundary between the two, in the middle.
    assert found.center_m == pytest.approx((0.2, 0.18, 0.15))
    assert found.volume_m3 == pytest.approx(0.2 * 0.12 * 0.1)
    assert found.advice(0.0).startswith("nobody looked into the opening at the top, 20 x 12 cm: record from ")


def test_what_is_expected_behind_one() -> None:
    unknown, solid = mask(PIT), mask(SOLID, np.s_[10:20, 12:24, 5:15])
    probability = np.where(solid, 0.7, 0.2)
    (found,) = found_of(unknown, mask(ABOVE_PIT), probability, solid=solid)
    assert found.inside_share == pytest.approx((0.7 + 0.2) / 2)
    assert found.solid_share == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("look_from", "words"),
    [
        ((0.0, 0.0, 1.0), "from above"),
        ((0.0, -0.6, 0.8), "from where the recording begins, obliquely from above"),
        (
            (1.0, 0.0, 0.0),
            "from 90 degrees to the right of where the recording begins, at the height of 45 cm",
        ),
        (
            (-0.7, -0.01, -0.7),
            "from 90 degrees to the left of where the recording begins, lower than 45 cm, looking up",
        ),
        ((0.0, 0.9, -0.1), "from opposite to where the recording begins, lower than 45 cm, looking up"),
        ((0.0, 0.0, -1.0), "from below, lower than 45 cm"),
    ],
)
def test_words_say_where_the_look_is_from(look_from: tuple[float, float, float], words: str) -> None:
    """The underside of an inner shelf, say, is seen from its open side and not from the floor."""
    # The first camera stands in the south and looks north: east is to its right.
    assert where_to_stand(look_from, 0.45, -np.pi / 2) == words


@pytest.mark.parametrize(("axis", "sign"), [(0, 1), (0, -1), (1, 1), (1, -1)])
def test_at_the_side_one_looks_in_where_it_is_open(axis: int, sign: int) -> None:
    """A niche 20 cm wide, 10 cm high and 12 cm deep, open on one side."""
    unknown = mask(np.s_[14:26, 10:30, 15:25]) if axis == 0 else mask(np.s_[10:30, 14:26, 15:25])
    end = slice(26, 40) if sign > 0 else slice(0, 14)
    free = mask(np.s_[end, 10:30, 15:25] if axis == 0 else np.s_[10:30, end, 15:25])
    (found,) = found_of(unknown, free, solid=mask(np.s_[0:8, 0:20, 26:36]))
    expected, centre = np.zeros(3), np.full(3, 0.2)
    expected[axis], centre[axis] = sign, 0.26 if sign > 0 else 0.14
    assert found.direction == "side" and np.dot(found.look_from, expected) > 0.8
    np.testing.assert_allclose(found.center_m, centre)
    assert found.size_m[1] == pytest.approx(0.1) and found.area_m2 == pytest.approx(0.02)
    # Seen along the look, a little askew.
    assert 0.15 < found.size_m[0] <= 0.21
    assert "at the side" in found.advice(0.0) and "where the recording begins" in found.advice(0.0)


def test_of_an_underside_one_is_told_the_word_that_says_it() -> None:
    """A plate hidden from below: only lines that look up reach it."""
    plate = mask(np.s_[10:30, 10:30, 25:30])
    (found,) = found_of(plate, mask(np.s_[0:40, 0:40, 0:25]), underside=plate)
    assert found.underside and found.direction == "down" and found.look_from[2] < 0
    assert "underside` is closed or open" in found.advice(0.0) and "looking up" in found.advice(0.0)
    stated = found.advice(0.0, "open")
    assert "looking up" in stated and "benchmark.yaml" not in stated


def test_of_a_thin_underside_below_which_all_is_unseen() -> None:
    """A board thinner than a line of sight, hidden from below down to the floor: 20 mm on voxels of 10."""
    board, below = mask(np.s_[10:30, 10:30, 28:30]), mask(np.s_[10:30, 10:30, 0:28])
    around = ndimage.binary_dilation(board, np.ones((3, 3, 3))) & ~board & (np.arange(CELLS[2]) >= 28)
    found = found_of(board | below, mask(), 0.7, underside=board, surface=around)
    (one,) = [each for each in found if each.underside]
    assert one.direction == "down" and one.volume_m3 == pytest.approx(20 * 20 * 2 * CELL_M**3)
    assert one.size_m == pytest.approx((0.2, 0.2)) and one.center_m[2] == pytest.approx(0.28)


def test_in_another_frame_of_the_floor() -> None:
    turn = np.radians(30)
    rotation = rotation_from_quaternion_xyzw([0, 0, np.sin(turn / 2), np.cos(turn / 2)])
    (flat,) = found_of(mask(PIT), mask(ABOVE_PIT))
    (turned,) = found_of(mask(PIT), mask(ABOVE_PIT), T_floor_grid=rigid(rotation, [1.0, -2.0, 0.3]))
    # The smallest box around it is turned with it.
    assert turned.size_m == pytest.approx((0.2, 0.12), abs=0.004)
    np.testing.assert_allclose(turned.look_from, rotation @ flat.look_from, atol=1e-12)
    np.testing.assert_allclose(turned.center_m, rotation @ (0.2, 0.18, 0.15) + [1.0, -2.0, 0.3])


def test_the_largest_volume_comes_first() -> None:
    pits = [np.s_[10:20, 0:10, 5:10], np.s_[10:20, 15:25, 2:10], np.s_[10:20, 30:40, 4:10]]
    found = found_of(mask(*pits), mask(np.s_[10:20, :, 10:40]))
    assert [one.volume_m3 for one in found] == pytest.approx([8e-4, 6e-4, 5e-4])
    assert [one.center_m[1] for one in found] == pytest.approx([0.2, 0.35, 0.05])


@pytest.mark.parametrize("thick", [2, 3])
def test_a_layer_thinner_than_a_line_of_sight_has_none(thick: int) -> None:
    unknown = mask(np.s_[10:30, 12:24, 15 - thick : 15])
    found = found_of(unknown, mask(ABOVE_PIT), solid=mask((slice(0, 8),)))
    assert len(found) == (thick >= LIMITS.line_width_m / CELL_M)


def test_a_thin_layer_has_one_if_it_is_much_of_the_object_and_there_is_no_other() -> None:
    thin, above = mask(np.s_[10:30, 12:24, 13:15]), mask(ABOVE_PIT)
    large = round(thin.sum() / LEAST_NARROW_SHARE)
    for solid_cells, expected in ((large - 100, 1), (large + 100, 0)):
        solid = mask((slice(0, 8),)).cumsum().reshape(CELLS) <= solid_cells
        assert len(found_of(thin, above, solid=solid)) == expected
    # A wide one elsewhere is reported alone.
    (found,) = found_of(thin | mask(np.s_[32:38, 12:30, 5:15]), above | mask(np.s_[32:38, 12:30, 15:40]))
    assert found.volume_m3 == pytest.approx(6 * 18 * 10 * CELL_M**3)


def test_little_behind_it_or_a_small_mouth_is_not_told() -> None:
    little = mask(np.s_[10:16, 12:18, 10:15])
    large = 180 / LEAST_SHARE
    for solid_cells, told in ((large - 400, True), (large + 400, False)):
        solid = mask((slice(0, 8),)).cumsum().reshape(CELLS) <= solid_cells
        assert solid.sum() == solid_cells
        assert bool(found_of(little, mask(np.s_[10:16, 12:18, 15:40]), solid=solid)) == told
    # The same volume behind a mouth of that area, and of one cell less.
    cells = round(LEAST_AREA_M2 / CELL_M**2)
    for mouth, told in ((cells - 1, False), (cells, True)):
        slot = mask(np.s_[10 : 10 + mouth, 12:15, 15:40])
        low = slot & (np.arange(CELLS[2]) < 16)
        free = slot & ~low | mask((slice(10, 10 + mouth), 12, slice(15, 16)))
        assert bool(found_of(mask(PIT), free)) == told


def test_what_is_decided_or_hidden_is_no_frontier() -> None:
    unknown, above = mask(PIT), mask(ABOVE_PIT)
    assert found_of(unknown, above, closed=unknown) == ()
    assert found_of(unknown, above, labels=np.full(CELLS, Label.INTERIOR, np.uint8)) == ()
    assert found_of(unknown, above, probability=0.9 * LEAST_PROBABILITY) == ()
    assert len(found_of(unknown, above, probability=1.1 * LEAST_PROBABILITY)) == 1
    # What borders on no free space is behind nothing.
    assert found_of(unknown, mask()) == ()
    assert found_of(mask(), above) == ()


# The floor's frame is that of the grid, whose world is turned, but for its height.
T_FLOOR_GRID = rigid(np.eye(3), [0.0, 0.0, -FLOOR_LAYERS * VOXEL_M])
RULES = Rules(LAYERS)


def scene(observed: Observation) -> tuple[Frontier, ...]:
    evidence = classify_voxels(observed, np.zeros(SHAPE, bool), RULES)
    return find_frontiers(make_solid(observed, evidence, RULES), evidence, RULES.limits, T_FLOOR_GRID)


def test_a_closed_body_and_one_with_a_narrow_crack_have_none() -> None:
    assert scene(observation(box_distance(*BODY))) == ()
    assert scene(observation(body_with_a_crack(0.02))) == ()


@pytest.mark.parametrize("height_m", [0.24, 0.1])
def test_of_a_bin_nobody_looked_into(height_m: float) -> None:
    (found,) = scene(observation(bin_seen_to(height_m)))
    assert found.direction == "up" and found.solid_share < 0.3
    assert found.size_m == pytest.approx((0.16, 0.1), abs=0.011)
    assert found.center_m == pytest.approx((0.16, 0.12, height_m), abs=0.006)
    assert found.look_from[2] > 0.7
    # Inside of walls as thick as a surface tells of, down to the floor.
    assert found.volume_m3 == pytest.approx(0.17 * 0.11 * height_m, rel=0.15)


def test_of_a_vase_whose_neck_hides_nearly_all_of_it() -> None:
    belly_m = box_distance((0.03, 0.03, -1.0), (0.29, 0.21, 0.24))
    neck_m = box_distance((0.11, 0.07, -1.0), (0.21, 0.17, 0.34))
    hole_m = box_distance((0.13, 0.09, 0.02), (0.19, 0.15, 1.0))
    (found,) = scene(observation(looked_into(np.minimum(belly_m, neck_m), hole_m, centers()[..., 2] > 0.28)))
    assert found.direction == "up" and found.size_m == pytest.approx((0.06, 0.06), abs=0.011)
    assert found.center_m == pytest.approx((0.16, 0.12, 0.28), abs=0.006) and found.look_from[2] > 0.85


def test_of_a_compartment() -> None:
    (found,) = scene(observation(cupboard_seen_to(0.15)))
    assert found.direction == "side" and found.look_from[1] > 0.8
    assert found.center_m == pytest.approx((0.16, 0.15, 0.15), abs=0.011)
    assert found.size_m[1] == pytest.approx(0.26, abs=0.011)
    assert found.advice(0.0).startswith("nobody looked into the opening at the side, ")
