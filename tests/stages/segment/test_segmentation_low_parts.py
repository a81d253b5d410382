"""Feet that hardly rise above the floor belong to what stands on them."""

from dataclasses import replace

import numpy as np
import pytest
from analytic_scenes import box
from bad_scenes import FINE, FLOOR, recorded

from kinectbench.core.geometry import OrientedBox
from kinectbench.settings.models import SegmentationSettings
from kinectbench.stages.segment.find.floor import Floor
from kinectbench.stages.segment.find.object import low_parts, low_pieces
from kinectbench.stages.segment.find.planes import floor_frame

SETTINGS = SegmentationSettings()
PLANE = np.array([0.0, 0, 1, 0])
FOUND = Floor(PLANE, floor_frame(PLANE), noise_m=0.0005, inlier_share=0.5)
BOX = OrientedBox((0, 0, 0.25), (0.4, 0.4, 0.5))


@pytest.mark.parametrize(
    ("noise_m", "cut_m"), [(0.0, 0.010), (0.0025, 0.010), (0.004, 0.016), (0.006, 0.020), (0.015, 0.020)]
)
def test_the_low_cut_lies_above_the_noise_of_the_floor(noise_m: float, cut_m: float) -> None:
    assert replace(FOUND, noise_m=noise_m).low_cut_m(SETTINGS) == pytest.approx(cut_m)


def test_without_a_floor_there_is_no_low_cut() -> None:
    assert replace(FOUND, noise_m=0.0, found=False).low_cut_m(SETTINGS) == SETTINGS.floor_cut_m


def line(start: float, stop: float) -> np.ndarray:
    """Points 15 mm above the floor along x, 10 mm apart."""
    x = np.arange(start, stop, 0.01)
    return np.column_stack([x, np.zeros_like(x), np.full_like(x, 0.015)])


def test_only_what_is_connected_is_a_low_part() -> None:
    post = np.array([[0.0, 0.0, z] for z in np.arange(0.025, 0.5, 0.01)])
    foot, apart = line(0.0, 0.3), line(0.36, 0.45)
    found = low_parts(np.concatenate([foot, apart]), post, BOX, 0.02)
    np.testing.assert_array_equal(found, np.repeat([True, False], [len(foot), len(apart)]))
    assert not low_parts(apart, post, BOX, 0.02).any() and not len(low_parts(apart[:0], post, BOX, 0.02))
    # Half the box and 0.3 m beyond it.
    far = line(0.0, 2.0)
    assert far[low_parts(far, post, BOX, 0.02), 0].max() == pytest.approx(0.5, abs=0.011)


def test_bits_of_a_tube_on_the_floor_are_low_and_a_stool_is_not() -> None:
    tube = line(0.0, 0.3)
    tube[:, 2] = 0.025
    stool = np.array([[1.0, 0.0, z] for z in np.arange(0.025, 0.4, 0.01)])
    low = low_pieces(np.concatenate([tube, stool]), 0.03)
    np.testing.assert_array_equal(low, np.repeat([True, False], [len(tube), len(stool)]))
    assert not len(low_pieces(tube[:0], 0.03))


def test_a_runner_that_rises_above_the_cut_in_places_is_the_objects() -> None:
    """Its higher bits hang together with the object only by what lies below the cut."""
    column, runner = box((-0.08, -0.08, 0), (0.08, 0.08, 0.4)), box((0.05, -0.02, 0), (0.36, 0.02, 0.016))
    bit = box((0.22, -0.02, 0), (0.32, 0.02, 0.035))
    chosen = recorded([FLOOR, column, runner, bit], **FINE).segment()
    assert chosen.box.size_m[0] > 0.42
    assert not len(chosen.other_cells)
    apart = recorded([FLOOR, column, bit], **FINE).segment()
    assert apart.box.size_m[0] < 0.2 and len(apart.other_cells)


def test_the_box_holds_a_foot_that_reaches_beyond_what_it_carries() -> None:
    column, plate = box((-0.08, -0.08, 0), (0.08, 0.08, 0.4)), box((-0.2, -0.2, 0), (0.2, 0.2, 0.016))
    chosen = recorded([FLOOR, column, plate]).segment()
    assert chosen.box.size_m[0] > 0.36 and chosen.box.size_m[1] > 0.36
    suggested = next(c for c in recorded([FLOOR, column, plate]).suggest().candidates if c.automatic)
    assert suggested.box.size_m[0] > 0.36
    alone = recorded([FLOOR, column]).segment()
    assert max(alone.box.size_m[:2]) < 0.2
