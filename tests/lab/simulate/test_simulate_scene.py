"""Surroundings: they hide nothing of the subject, and hold what the settings say."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kinectbench.core.geometry import OrientedBox
from kinectbench.core.geometry.mesh import box_mesh
from kinectbench.lab.simulate.objects.shapes import Piece, Subject
from kinectbench.lab.simulate.scene import CLEARANCE_M, Item, make_scene
from kinectbench.lab.simulate.spec import SceneSettings

BOX = box_mesh(OrientedBox((0, 0, 0.4), (0.8, 0.5, 0.8)))
SUBJECT = Subject("box", (Piece("box", BOX, (0.5, 0.4, 0.3), 0.2),), BOX, "exact")
REACH_M = 2.4


def scene_of(seed: int = 0, **settings: Any) -> list[Item]:
    return make_scene(SUBJECT, 0.7, REACH_M, SceneSettings(**settings), np.random.default_rng(seed))


def outline(item: Item) -> NDArray[np.float64]:
    """Points on the outline of a box seen from above, (n, 2)."""
    corners = item.mesh.vertices[[0, 2, 6, 4], :2]
    share = np.linspace(0, 1, 41)[:, None, None]
    return (corners * share + np.roll(corners, 1, axis=0) * (1 - share)).reshape(-1, 2)


def radius(items: list[Item]) -> float:
    return float(np.linalg.norm(np.concatenate([item.mesh.vertices for item in items])[:, :2], axis=1).max())


@pytest.mark.parametrize("seed", range(10))
def test_clutter_is_low_and_apart_or_behind_the_camera(seed: int) -> None:
    items = scene_of(seed, clutter=4)
    subject = [item for item in items if item.role == "subject"]
    assert [item.albedo for item in subject] == [0.2]
    things = [item for item in items if item.role == "clutter"]
    walls = [item for item in items if item.role == "wall"]
    assert 2 <= len(walls) <= 3
    assert 4 + len(walls) <= len(things) <= 4 + 2 * len(walls)
    for item in things:
        near_m = np.linalg.norm(outline(item), axis=1).min()
        if item.mesh.vertices[:, 2].max() > 0.3:
            assert near_m > REACH_M
        else:
            assert near_m >= radius(subject) + CLEARANCE_M - 1e-9
    for wall in walls:
        assert np.linalg.norm(outline(wall), axis=1).min() >= max(3.0, REACH_M + 0.5) - 1e-9


def test_outdoors_there_are_no_walls() -> None:
    items = scene_of(place="outdoor", clutter=0)
    assert {item.role for item in items} == {"subject", "floor"}
    assert {item.role for item in scene_of(walls=0, clutter=0)} == {"subject", "floor"}
    assert sum(item.role == "wall" for item in scene_of(walls=4)) == 4


@pytest.mark.parametrize("seed", range(5))
def test_a_neighbour_touches(seed: int) -> None:
    items = scene_of(seed, touching=True, clutter=0, walls=0)
    assert [item.role for item in items] == ["subject", "floor", "clutter"]
    turned, box = items[0].mesh.vertices, items[2].mesh.vertices
    # The neighbour's face is 5 mm inside the subject's outermost vertex along its own direction.
    middle = box[:, :2].mean(axis=0)
    sides = np.array([box[4, :2] - box[0, :2], box[2, :2] - box[0, :2]])
    outward = sides / np.linalg.norm(sides, axis=1, keepdims=True)
    gaps = [(box[:, :2] @ d).min() - (turned[:, :2] @ d).max() for d in outward]
    assert any(gap == pytest.approx(-0.005, abs=1e-9) for gap in gaps)
    assert np.linalg.norm(middle) < radius(items[:1]) + 0.5


CUP = box_mesh(OrientedBox((0, 0, 0.06), (0.1, 0.14, 0.12)))
SMALL = Subject("cup", (Piece("cup", CUP, (0.5, 0.4, 0.3), 0.2),), CUP, "exact")


@pytest.mark.parametrize("seed", range(10))
def test_a_table_carries_the_subject_and_the_clutter(seed: int) -> None:
    settings = SceneSettings(stands_on="table", clutter=4, walls=0)
    cup, floor, top, *rest = make_scene(SMALL, 0.7, REACH_M, settings, np.random.default_rng(seed))
    legs, things = rest[:4], rest[4:]
    assert floor.role == "floor" and floor.mesh.vertices[:, 2].max() == pytest.approx(-0.74)
    assert top.mesh.vertices[:, 2].max() == 0 and len(things) == 4
    assert all(leg.mesh.vertices[:, 2].min() == pytest.approx(-0.74) for leg in legs)
    # The subject stands on the top, with a hand's breadth around it, and no thing touches it.
    corners = top.mesh.vertices[[0, 2, 6, 4], :2]
    ahead = np.roll(corners, -1, axis=0) - corners
    inward = np.array([-ahead[:, 1], ahead[:, 0]]).T / np.linalg.norm(ahead, axis=1, keepdims=True)
    depths_m = ((cup.mesh.vertices[:, None, :2] - corners) * inward).sum(axis=2)
    assert (depths_m > 0).all() or (depths_m < 0).all()
    assert np.abs(depths_m).min() > 0.08
    for thing in things:
        assert thing.mesh.vertices[:, 2].min() == pytest.approx(0, abs=1e-12)
        assert np.linalg.norm(outline(thing), axis=1).min() > radius([cup]) + 0.04


def test_the_seed_decides() -> None:
    first, again, other = scene_of(3), scene_of(3), scene_of(4)
    assert all(np.array_equal(a.mesh.vertices, b.mesh.vertices) for a, b in zip(first, again, strict=True))
    assert len(first) != len(other) or any(
        not np.array_equal(a.mesh.vertices, b.mesh.vertices) for a, b in zip(first, other, strict=True)
    )
