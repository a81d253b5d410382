"""What quality.json warns of, of solids written down by hand."""

from dataclasses import replace

import numpy as np
import pytest
from evidence_by_hand import shape_of
from scipy import ndimage

from kinectbench.core.artefacts.object import LEAST_UNDERSIDE_SHARE
from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.geometry.boxes import OrientedBox
from kinectbench.core.types import Underside
from kinectbench.stages.segment.find.floor import Floor
from kinectbench.stages.segment.find.object import Segmentation
from kinectbench.stages.segment.judge.estimate import IouEstimate
from kinectbench.stages.segment.judge.quality import (
    _stands_on_its_rim,
    _underside_question,
    _unsupported,
    _warnings,
    detached_pieces,
)
from kinectbench.stages.segment.solid.evidence import FloorLayers, Rules

BELOW = 4
RULES = Rules(layers=FloorLayers(below=BELOW, contact=1))


@pytest.mark.parametrize(("low", "parted"), [(0, False), (6, False), (0, True), (6, True)])
def test_a_solid_that_hangs_or_falls_apart(low: int, parted: bool) -> None:
    """The floor is at z = 0, 10 mm a voxel: at 60 mm it hangs; a gap of a layer parts it."""
    solid = np.zeros((8, 8, 20), bool)
    solid[2:6, 2:6, low:16] = True
    solid[2:6, 2:6, 12] = not parted
    vertices = np.argwhere(solid) * np.float64(0.01)
    mesh = TriangleMesh(vertices, np.zeros((0, 3), np.int64))
    shape = shape_of(solid, mesh=mesh)
    no_cells = np.zeros((0, 3), np.int64)
    floor = Floor(np.array([0.0, 0, 1, 0]), np.eye(4), 0.001, 0.5)
    chosen = Segmentation(floor, OrientedBox((0, 0, 0), (1, 1, 1)), no_cells, no_cells, "automatic")
    warnings = _unsupported(chosen, shape, RULES)
    assert [line[:34] for line in warnings] == (
        ["the solid begins 0.06 m above the "] * (low > 0) + ["the solid is in 2 large pieces tha"] * parted
    )


@pytest.mark.parametrize("told", [False, True])
def test_where_an_opening_says_from_where_to_record_nothing_else_does(told: bool) -> None:
    solid = np.zeros((8, 8, 20), bool)
    solid[2:6, 2:6, :16] = True
    vertices = np.argwhere(solid) * np.float64(0.01)
    shape = shape_of(solid, mesh=TriangleMesh(vertices, np.zeros((0, 3), np.int64)))
    estimate = IouEstimate(0.7, 0.3, 0.9, 0.8, 0.9, 0.8, 1.0, ("an opening that nobody looked into",) * told)
    lines = _warnings([], shape, 0.95, estimate, ("record from above",) * told, 0.5)
    assert len(lines) == 2 and lines[0].startswith(
        "the estimated IoU of the solid to the truth is 0.70, lowered by: "
    )
    assert ("an opening that nobody" in lines[0]) == told
    remedies = [line for line in lines for words in ("closer", "all sides") if words in line]
    assert len(remedies) == (0 if told else 2)


@pytest.mark.parametrize(("measured_low", "lines"), [(0.83, 0), (0.75, 1)])
def test_a_surface_that_may_be_far_off_is_not_good_without_a_word(measured_low: float, lines: int) -> None:
    solid = np.zeros((40, 40, 40), bool)
    solid[5:35, 5:35, :30] = True
    mesh = TriangleMesh(np.argwhere(solid) * np.float64(0.01), np.zeros((0, 3), np.int64))
    estimate = IouEstimate(0.89, 0.7, 1.0, measured_low, 0.9, 0.8, 1.0, ())
    found = _warnings([], shape_of(solid, mesh=mesh), 0.95, estimate, (), 0.0)
    assert len(found) == lines and all("IoU of the solid to the truth is 0.75" in line for line in found)


def test_a_loose_piece_is_told_with_its_size_and_distance() -> None:
    """Of voxels of 5 mm: a body, a knob two voxels beside it, and a scrap of 184 (23 cm³) nine away."""
    solid = np.zeros((60, 40, 40), bool)
    solid[2:32, 5:35, 5:35] = True
    solid[34:37, 10:13, 10:13] = True  # a joint too thin to be measured
    solid[40:48, 10:33, 20] = True
    labels, _ = ndimage.label(solid, np.ones((3, 3, 3)))
    sizes = np.bincount(labels.reshape(-1))[1:]
    loose = np.array([int(labels[34, 10, 10]), int(labels[40, 10, 20])])
    (line,) = detached_pieces(labels, loose, sizes, 0.005)
    assert line.startswith("a loose piece of 23 cm³ lies 45 mm from the rest of the object:")
    assert detached_pieces(labels, loose[:1], sizes, 0.005) == []
    assert detached_pieces(labels, loose[:0], sizes, 0.005) == []


@pytest.mark.parametrize("word", ["unseen", "closed", "open"])
@pytest.mark.parametrize("over", [False, True])
def test_a_word_about_the_underside_is_asked_for_where_it_decides_much(word: Underside, over: bool) -> None:
    solid = np.ones((10, 10, 10), bool)
    underside = np.zeros_like(solid)
    underside.reshape(-1)[: round(1000 * LEAST_UNDERSIDE_SHARE) + over] = True
    lines = _underside_question(replace(shape_of(solid), underside=underside), word)
    assert len(lines) == (over and word == "unseen")
    assert not lines or lines[0].startswith("5% of the solid is a guess that one word decides")


@pytest.mark.parametrize("word", ["unseen", "closed", "open"])
@pytest.mark.parametrize("legs", [False, True])
@pytest.mark.parametrize("from_below", [False, True])
@pytest.mark.parametrize("stands", [False, True])
def test_open_is_said_to_have_no_effect_on_what_stands_on_its_rim(
    word: Underside, legs: bool, from_below: bool, stands: bool
) -> None:
    """A box upside down counts as solid, whatever is said: the floor closes it."""
    solid = np.zeros((20, 20, 20), bool)
    solid[4:16, 4:16, BELOW:] = True
    if legs:
        solid[5:15, :, : BELOW + 8] = False
    underside = np.zeros_like(solid)
    underside[5:15, 5:15, BELOW : BELOW + 3] = from_below
    rules = replace(RULES, underside=word, stands=stands)
    lines = _stands_on_its_rim(replace(shape_of(solid), underside=underside), rules)
    assert len(lines) == (word == "open" and stands and not legs and not from_below)
    assert not lines or lines[0].startswith("`underside: open` has no effect: 100% of the solid's outline")
