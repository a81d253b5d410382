"""Recordings of one object are found by their shapes, and those of two objects are not."""

from pathlib import Path

import numpy as np
import pytest
from same_object import scanned, size_m
from synthetic_release import FLOOR, write_json

from kinectbench.core.artefacts.object_grids import Label, ObjectVolume
from kinectbench.core.artefacts.triage import SameObject
from kinectbench.core.geometry import Grid
from kinectbench.core.geometry.boxes import yaw_rotation
from kinectbench.core.types import Bools
from kinectbench.lab.simulate.objects import make_object
from kinectbench.release.triage.triage import LEAST_AGREEMENT, Shape, same_objects, shape_agreement


@pytest.mark.parametrize("family", ["chair", "bench", "mug"])
def test_one_object_agrees_with_itself_and_not_with_another(family: str) -> None:
    one, other = (make_object(family, seed) for seed in (0, 1))
    first, again = (scanned(one, np.random.default_rng(seed)) for seed in (1, 2))
    assert shape_agreement(first, again) >= LEAST_AGREEMENT
    assert shape_agreement(first, scanned(other, np.random.default_rng(3))) < LEAST_AGREEMENT


def test_order_and_pose_do_not_matter() -> None:
    first, again = (scanned(make_object("chair", 0), np.random.default_rng(seed)) for seed in (1, 2))
    moved = Shape.of(*(p @ yaw_rotation(2.0).T + [3, -1, 0] for p in (again.measured, again.surface)))
    assert (
        shape_agreement(first, moved) >= LEAST_AGREEMENT and shape_agreement(moved, first) >= LEAST_AGREEMENT
    )


def write_object(folder: Path, solid: Bools) -> Path:
    """A built object of voxels of 1 cm, all of its surface measured."""
    folder.mkdir(parents=True)
    labels = np.where(solid, Label.SURFACE, Label.FREE).astype(np.uint8)
    grid = Grid(solid.shape, 0.01, np.eye(4))
    ObjectVolume(grid, solid, labels, solid.astype(np.float16), np.zeros_like(solid)).write(folder)
    write_json(folder / "floor.json", FLOOR)
    return folder


def test_built_objects_of_one_shape_and_two_names_are_found(tmp_path: Path) -> None:
    bench = np.zeros((60, 30, 40), bool)
    bench[5:55, 5:25, 30:34] = True
    bench[5:9, 5:25, :30] = bench[51:55, 5:9, :30] = True
    turned = np.ascontiguousarray(bench[::-1, ::-1])
    mirrored = np.ascontiguousarray(bench[::-1])
    solids = {"a": bench, "b": turned, "c": mirrored}
    folders = {name: write_object(tmp_path / name, solid) for name, solid in solids.items()}
    sizes = dict.fromkeys(solids, np.array([0.5, 0.2, 0.34]))
    found = {(a, b) for a, b, _ in same_objects(folders, sizes, {"a": "a", "b": "b", "c": "c"})}
    assert found == {("a", "b")}
    assert not list(same_objects(folders, sizes, dict.fromkeys(solids, "one")))
    sizes["b"] = np.array([0.6, 0.2, 0.34])
    assert not list(same_objects(folders, sizes, {"a": "a", "b": "b", "c": "c"}))


def test_the_line_to_write_says_object_and_split() -> None:
    pair = SameObject(
        recordings=("a", "b"), agreement=0.97, splits=("test", "train"), write="object: a, split: test"
    )
    assert (
        "in the splits test and train: if they are one object, write `object: a, split: test` to b"
        in pair.line
    )
    assert "splits" not in pair.model_copy(update={"splits": ("test", "test")}).line


def test_a_size_is_the_same_whichever_way_an_object_stands() -> None:
    length, width, height = size_m(make_object("bench", 0))
    assert length > width and height > 0
