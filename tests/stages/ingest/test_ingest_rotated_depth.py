"""Depth whose bits are rotated: recognised where its values can be nothing else, undone, said by hand."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ingest_writers import png, write_bag, write_folder, write_seven_scenes
from kinectbench_plugins.formats.scene_folders import rotated
from numpy.typing import NDArray
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.depth_codes import find_pattern, unrotated
from kinectbench.stages.ingest.readers import open_recording

Depth = NDArray[np.uint16]


def room(near_mm: int, far_mm: int, step_mm: int = 1) -> Depth:
    """A slanted wall, rough by some mm as sensors are, with holes."""
    rng = np.random.default_rng(5)
    wall = np.linspace(near_mm, far_mm, 64)[None, :] + rng.normal(0, 4, (48, 64))
    depth = (np.rint(wall / step_mm) * step_mm).astype(np.uint16)
    depth[:6, :8] = 0
    return depth


def rewrite(folder: Path, depth: Depth) -> None:
    """Every depth image of a recording becomes this one."""
    for file in [*folder.glob("*.depth.png"), *folder.glob("depth/*.png")]:
        file.write_bytes(png(depth))


@given(st.integers(0, 65535))
def test_rotating_back_gives_the_value(value: int) -> None:
    depth = np.array([value], np.uint16)
    assert unrotated(rotated(depth)) == depth and rotated(unrotated(depth)) == depth
    # By the description: the low three bits of what is stored are the high ones of the depth.
    assert int(unrotated(depth)[0]) == (value >> 3 | value << 13) & 0xFFFF


@pytest.mark.parametrize("layout", ["folder", "7scenes"])
@pytest.mark.parametrize(("near_mm", "far_mm"), [(600, 1100), (800, 3500), (1500, 8500)])
def test_rotated_depth_is_recognised_and_put_back(
    tmp_path: Path, layout: str, near_mm: int, far_mm: int
) -> None:
    folder = write_folder(tmp_path / "r") if layout == "folder" else write_seven_scenes(tmp_path / "r")
    depth = room(near_mm, far_mm)
    rewrite(folder, rotated(depth))
    recording = open_recording(folder)
    np.testing.assert_array_equal(recording.frame(1).depth, depth)
    assert recording.depth_scale == 1000.0
    (warning,) = recording.warnings
    assert "its bits are rotated" in warning and "`depth_code: plain`" in warning
    as_stored = open_recording(folder, CameraSettings(depth_code="plain"))
    np.testing.assert_array_equal(as_stored.frame(1).depth, rotated(depth))
    assert as_stored.warnings == ()


@pytest.mark.parametrize(
    "depth",
    [
        room(600, 3500),  # mm
        room(3000, 20000),  # 0.2 mm
        room(800, 3500, step_mm=4),
        room(800, 3500, step_mm=16),
        (room(800, 3500) // 16).astype(np.uint16) * np.uint16(8),  # 8 bits
        np.zeros((48, 64), np.uint16),
        np.full((48, 64), 8000, np.uint16),
    ],
)
def test_other_depth_is_left_as_it_is(tmp_path: Path, depth: Depth) -> None:
    folder = write_folder(tmp_path / "r")
    rewrite(folder, depth)
    recording = open_recording(folder)
    np.testing.assert_array_equal(recording.frame(0).depth, depth)
    assert recording.warnings == ()
    assert not find_pattern([depth]).found


def test_what_may_be_either_is_left_and_said(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    # In steps of 8 mm, or rotated depth of 0.3 to 0.5 m: the values are the same.
    depth = rotated(room(300, 500))
    rewrite(folder, depth)
    recording = open_recording(folder)
    np.testing.assert_array_equal(recording.frame(0).depth, depth)
    (warning,) = recording.warnings
    assert "give `depth_code: rotated`" in warning
    by_hand = open_recording(folder, CameraSettings(depth_code="rotated"))
    np.testing.assert_array_equal(by_hand.frame(0).depth, unrotated(depth))
    assert by_hand.warnings == ()


def test_a_depth_scale_by_hand_is_believed(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    depth = rotated(room(800, 3500))
    rewrite(folder, depth)
    recording = open_recording(folder, CameraSettings(depth_scale=8000.0))
    np.testing.assert_array_equal(recording.frame(0).depth, depth)
    assert recording.warnings == ()


def test_a_damaged_image_does_not_hide_the_code(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r", ("0", "1", "2", "3", "4", "5"))
    depth = room(800, 3500)
    rewrite(folder, rotated(depth))
    (folder / "depth/0.png").write_bytes(png(depth)[:-30])
    np.testing.assert_array_equal(open_recording(folder).frame(3).depth, depth)


def test_a_code_for_depth_that_is_no_png_is_refused(tmp_path: Path) -> None:
    with raises(RecordingError, "recording.unused-setting"):
        open_recording(write_bag(tmp_path / "r.bag"), CameraSettings(depth_code="rotated"))


def shelf(far_share: float) -> Depth:
    """Depth in 0.1 mm of a shelf at 0.3 to 0.7 m; behind it a wall at 0.9 to 1.3 m, and a gap to 2 m."""
    rng = np.random.default_rng(7)
    depth = rng.uniform(3000, 7000, (48, 64)).astype(np.uint16)
    wall = rng.random(depth.shape) < far_share
    depth[wall] = rng.uniform(9000, 13000, int(wall.sum())).astype(np.uint16)
    depth.ravel()[rng.choice(depth.size, 4, replace=False)] = 20000
    return depth


@pytest.mark.parametrize("layout", ["folder", "7scenes"])
@pytest.mark.parametrize("settings", [CameraSettings(), CameraSettings(depth_code="rotated")])
def test_rotated_tenths_of_mm_are_recognised_by_depth_beyond_the_range(
    tmp_path: Path, layout: str, settings: CameraSettings
) -> None:
    folder = write_folder(tmp_path / "r") if layout == "folder" else write_seven_scenes(tmp_path / "r")
    rewrite(folder, rotated(shelf(0.01)))
    recording = open_recording(folder, settings)
    np.testing.assert_array_equal(recording.frame(1).depth, shelf(0.01))
    assert recording.depth_scale == 10000.0
    (warning,) = recording.warnings
    assert "its unit is" in warning and "0.1 mm" in warning


def test_more_than_a_twentieth_beyond_is_no_pattern() -> None:
    assert find_pattern([rotated(shelf(0.04))]).found and not find_pattern([rotated(shelf(0.07))]).found


def test_a_few_odd_values_do_not_change_the_unit(tmp_path: Path) -> None:
    """Low bits of all kinds, as of interpolated edges, are not those of farther depth."""
    depth = rotated(room(800, 3500))
    depth[10, :40] |= np.arange(40, dtype=np.uint16) % 7 + 1
    pattern = find_pattern([depth])
    assert pattern.found and pattern.units == 1000.0


def test_codes_for_no_measurement_do_not_change_the_unit() -> None:
    """Of a room in mm with depth beyond 8.2 m, whose least part a code for 0.1 mm would be."""
    depth = rotated(room(3100, 5000))
    depth[10, :20], depth[11, :10] = rotated(np.full(20, 9000, np.uint16)), 65535
    pattern = find_pattern([depth])
    assert pattern.found and pattern.units == 1000.0


def test_numbers_of_people_in_the_low_bits_do_not_make_tenths_of_mm() -> None:
    """As the Kinect SDK packs them: eight times the mm, and a number from 1 to 6."""
    depth = room(2000, 2900) << np.uint16(3)
    depth[10, :40] += 1
    depth[11, :20] += 2
    pattern = find_pattern([depth])
    assert pattern.units == 1000.0


def test_both_units_are_named_where_the_values_do_not_say(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    rewrite(folder, rotated(room(4500, 5900)))
    recording = open_recording(folder)
    assert recording.depth_scale == 1000.0
    (warning,) = recording.warnings
    assert "in mm its median is 5.2" in warning and "`depth_scale: 10000`" in warning


def test_a_plain_scale_for_rotated_depth_gets_a_warning(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    rewrite(folder, rotated(shelf(0.01)))
    recording = open_recording(folder, CameraSettings(depth_scale=10000.0))
    np.testing.assert_array_equal(recording.frame(0).depth, rotated(shelf(0.01)))
    (warning,) = recording.warnings
    assert "give `depth_code: rotated, depth_scale: 10000`" in warning
