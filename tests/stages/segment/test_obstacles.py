"""Advice names no place where a camera cannot be: before it, what stands there is moved away from."""

import numpy as np
import pytest

from kinectbench.core.geometry import OrientedBox
from kinectbench.core.sensor_limits import DEFAULT_LIMITS
from kinectbench.stages.segment.find.floor import Floor
from kinectbench.stages.segment.find.object import Segmentation
from kinectbench.stages.segment.judge.frontiers import Frontier, is_obstructed

CELL_M = 0.03
# A cabinet 0.8 m wide, 0.4 m deep and 1.2 m high; its back, at y = 0.2, is looked at from y > 0.2.
CABINET = OrientedBox((0, 0, 0.6), (0.8, 0.4, 1.2))
BACK, FROM_BEHIND = np.array([0.0, 0.2, 0.6]), np.array([0.0, 1.0, 0.0])
AT_A_SLANT = np.array([0.5, 0.8, 0.33166248])


def surface(low: tuple[float, float, float], high: tuple[float, float, float]) -> np.ndarray:
    """Points (n, 3) that fill a flat box, one in each cell."""
    axes = [np.arange(a, b + CELL_M / 2, CELL_M) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def wall(gap_m: float) -> np.ndarray:
    """A wall behind the cabinet, as cameras in front see it: on both sides, and above it."""
    at = 0.2 + gap_m
    beside = [surface((low, at, 0.05), (high, at, 2.0)) for low, high in ((-1.5, -0.5), (0.5, 1.5))]
    return np.concatenate([*beside, surface((-0.5, at, 1.5), (0.5, at, 2.0))])


def obstructed(chosen: Segmentation, point: np.ndarray, look: np.ndarray) -> bool:
    return is_obstructed(chosen, point, look, DEFAULT_LIMITS)


def scene(*others: np.ndarray) -> Segmentation:
    points = np.concatenate([*others, np.zeros((0, 3))])
    floor = Floor(np.array([0, 0, 1.0, 0]), np.eye(4), 0.001, 0.5, 0.0, True)
    cells = np.floor(points / CELL_M).astype(np.int64)
    return Segmentation(floor, CABINET, np.zeros((0, 3), np.int64), cells, "automatic", cell_m=CELL_M)


@pytest.mark.parametrize("look", [FROM_BEHIND, AT_A_SLANT])
def test_a_wall_behind_the_object_is_in_the_way(look: np.ndarray) -> None:
    """No camera saw the part of the wall that the object hides."""
    assert obstructed(scene(wall(0.05)), BACK, look)
    assert obstructed(scene(wall(0.3)), BACK, look)
    # Of what lies deep in it, too.
    assert obstructed(scene(wall(0.3)), BACK - [0, 0.4, 0], look)
    assert not obstructed(scene(wall(0.7)), BACK, look)


def test_a_neighbour_is_in_the_way_where_it_stands() -> None:
    side = np.array([0.4, 0.0, 0.6])
    neighbour = surface((0.75, -0.3, 0.05), (0.75, 0.3, 0.9))
    assert obstructed(scene(neighbour), side, np.array([1.0, 0.0, 0.0]))
    assert not obstructed(scene(neighbour), BACK, FROM_BEHIND)
    # Specks within the object's own box are not.
    assert not obstructed(scene(surface((0.3, -0.1, 0.5), (0.3, 0.1, 0.7))), side - [0.3, 0, 0], np.eye(3)[0])
    # What is lower than the way to the camera is not in it.
    assert not obstructed(scene(neighbour), np.array([0.4, 0.0, 1.0]), np.array([0.8, 0.0, 0.6]))


def test_where_nothing_stands_nothing_is_in_the_way() -> None:
    assert not obstructed(scene(), BACK, FROM_BEHIND)
    assert not obstructed(scene(wall(0.05)), BACK, -FROM_BEHIND)
    assert not obstructed(scene(wall(0.05)), np.array([0, 0, 1.2]), np.array([0, 0, 1.0]))


def test_things_on_either_side_that_stand_in_no_line_are_no_wall() -> None:
    left, right = surface((-1.0, 0.5, 0.05), (-0.5, 0.5, 1.0)), surface((0.6, 0.2, 0.05), (1.1, 0.2, 1.0))
    assert not obstructed(scene(left, right), BACK, FROM_BEHIND)
    # The tops of two low boxes, in line behind the object.
    tops = [surface((low, 0.3, 0.9), (low + 0.7, 0.7, 0.9)) for low in (-1.2, 0.5)]
    assert not obstructed(scene(*tops), BACK, FROM_BEHIND)


def test_advice_says_to_move_it_first() -> None:
    frontier = Frontier(
        "side", 0.9, (0.8, 1.2), (0.0, 0.2, 0.6), (0.0, 1.0, 0.0), 0.2, 0.5, 0.5, obstructed=True
    )
    assert frontier.advice(-np.pi / 2) == (
        "nobody looked into the opening at the side, 80 x 120 cm: move it away from what stands behind it, "
        "and record from opposite to where the recording begins, at the height of 60 cm"
    )
