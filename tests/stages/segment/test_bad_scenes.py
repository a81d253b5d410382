"""Recordings with something wrong in them: each says what, and none becomes a silently wrong pair."""

import functools
import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from analytic_scenes import Surface, box, health_of, ring
from bad_scenes import AROUND, FINE, FLOOR, FUSION, OBJECT, Recorded, recorded, table_of
from numpy.typing import NDArray
from raising import raises
from typed import present

from kinectbench.core.artefacts.object import MAX_OFF_SHARE
from kinectbench.core.errors import KinectBenchError, SegmentationError
from kinectbench.core.geometry import OrientedBox, rotation_from_quaternion_xyzw, transform_points
from kinectbench.core.trajectory.coverage import convergence_point
from kinectbench.stages.fuse import fuse
from kinectbench.stages.segment.find.pieces import CELL_M, Selection, choice_warnings, select_in_box
from kinectbench.stages.segment.judge.coverage_report import unseen_side

pytestmark = pytest.mark.xdist_group("bad_scenes")


@functools.cache
def plain() -> Recorded:
    return recorded([FLOOR, OBJECT])


def warned(warnings: tuple[str, ...] | list[str], words: str) -> bool:
    return any(words in warning for warning in warnings)


def test_nothing_is_said_of_a_good_recording() -> None:
    seen = plain().coverage_report()
    assert seen.warnings == ()
    assert seen.unseen_side.share == 0
    assert seen.moving.json_value() == {"judged": 24, "frames": [], "largest_share": 0.0}


def test_poses_that_are_not_good_for_ground_truth_are_told_with_what_to_do() -> None:
    verdict = "not good for ground truth: frames agree within 14.0 mm (median)"
    health = health_of(24, grade="not good", verdict=verdict, recommended="refine")
    bad = replace(plain().trajectory, health=health)
    assert replace(plain(), trajectory=bad).coverage_report().warnings == (
        f"the trajectory is {verdict}; write `trajectory: refine` below its `id` in benchmark.yaml",
    )
    kept = replace(bad, health=health.model_copy(update={"recommended": "trust"}))
    (told,) = replace(plain(), trajectory=kept).coverage_report().warnings
    assert told.endswith("; if odd and even frames agree better with `trajectory: refine`, take that")
    # No setting is advised that is already so.
    for source, recommended, remedy in (
        ("refine", "refine", "; if odd and even frames agree better with `trajectory: ignore`, take that"),
        ("tracked", None, "; record again, slowly, with edges and corners in view, and end where it began"),
    ):
        figures = health.model_copy(update={"recommended": recommended})
        done = replace(bad, health=figures, source=source)
        (told,) = replace(plain(), trajectory=done).coverage_report().warnings
        assert told.startswith(f"the trajectory is {verdict}{remedy}") and "record again" in told
    good = replace(bad, health=health_of(24, grade="10 mm", recommended="trust"))
    assert replace(plain(), trajectory=good).coverage_report().warnings == ()


def shifted(surface_m: float, from_frame: int = 12) -> dict[int, list[Surface]]:
    """The object in each frame; from one of them on it stands elsewhere."""
    there = box((surface_m - 0.2, -0.15, 0.0), (surface_m + 0.2, 0.15, 0.5))
    return {k: [there if k >= from_frame else OBJECT] for k in range(len(AROUND))}


@pytest.mark.parametrize(("from_frame", "share"), [(6, 0.048), (12, 0.043), (20, 0.008)])
def test_depth_contradicts_an_object_that_was_moved(from_frame: int, share: float) -> None:
    seen = recorded([FLOOR], passing=shifted(0.08, from_frame)).coverage_report()
    assert seen.off_share == pytest.approx(share, rel=0.3)
    assert warned(seen.warnings, "of the depth on the object lies 2 cm and more off its surface")


@pytest.mark.parametrize(
    "surfaces",
    [
        [OBJECT],
        table_of((-0.3, -0.2, 0.0), (0.3, 0.2, 0.5)),
        [box((-0.02, -0.02, 0), (0.02, 0.02, 0.6)), OBJECT],
    ],
)
def test_no_depth_contradicts_what_stood_still(surfaces: list[Surface]) -> None:
    assert recorded([FLOOR, *surfaces]).coverage_report().off_share == 0


def test_who_walks_by_does_not_contradict_the_object() -> None:
    """Somebody stands in the notch of an L in one frame; the shape is as it was."""
    parts = [FLOOR, box((-0.3, -0.3, 0), (0.3, -0.1, 0.5)), box((-0.3, -0.1, 0), (-0.1, 0.3, 0.5))]
    seen = recorded(parts, passing={4: [box((0.0, 0.0, 0), (0.25, 0.25, 0.5))]}).coverage_report()
    assert seen.moving.frames == (4,) and present(seen.off_share) <= MAX_OFF_SHARE


def test_depth_contradicts_the_object_if_poses_are_off() -> None:
    good = plain()
    poses = good.trajectory.T_world_camera.copy()
    poses[12:, 0, 3] += 0.05
    off = replace(good.trajectory, T_world_camera=poses)
    scene = fuse(good.sequence, off, FUSION).mesh
    seen = replace(good, trajectory=off, scene=scene).coverage_report()
    assert warned(seen.warnings, "2 cm and more off its surface")


@pytest.mark.parametrize("arc_deg", [300.0, 180.0, 120.0])
def test_the_side_never_seen_is_the_middle_of_the_gap(arc_deg: float) -> None:
    turns = np.radians(np.linspace(-arc_deg / 2, arc_deg / 2, 13) + 70.0)
    poses = np.tile(np.eye(4), (13, 1, 1))
    poses[:, :3, 3] = np.array([2.0, -1.0, 0.3]) + np.column_stack([np.cos(turns), np.sin(turns), turns])
    gap_rad, towards_rad, share = unseen_side(poses, np.array([2.0, -1.0, 0.3]))
    assert np.degrees(gap_rad) == pytest.approx(360 - arc_deg)
    # The widest gap is the arc's own: 180 degrees from its middle, unless steps are wider.
    assert np.degrees(towards_rad) == pytest.approx(-110.0)
    assert share == pytest.approx(max(0.0, 360 - arc_deg - 150) / 360)


def test_one_side_never_seen() -> None:
    half = recorded([FLOOR, OBJECT], AROUND[:11])
    seen = half.coverage_report()
    assert warned(seen.warnings, "no frame looks at the object's side 110 degrees to the left of where")
    assert warned(seen.warnings, " degrees of arc: what is there is inferred")
    # 11 of 24 cameras leave a gap of 14 steps of 15 degrees, and around it 75 degrees on both sides are seen.
    assert np.degrees(seen.unseen_side.gap_rad) == pytest.approx(210.0, abs=3)
    assert seen.unseen_side.share == pytest.approx(60 / 360, abs=0.01)


def test_two_objects_in_the_box() -> None:
    two = [FLOOR, box((-0.3, -0.1, 0), (-0.1, 0.1, 0.4)), box((0.1, -0.1, 0), (0.3, 0.1, 0.4))]
    pair = recorded(two)
    around_both = OrientedBox((0, 0, 0.25), (0.8, 0.4, 0.5))
    assert warned(pair.coverage_report(around_both).warnings, "the box holds 2 things that stand apart")
    around_one = OrientedBox((0.2, 0, 0.25), (0.3, 0.4, 0.5))
    assert pair.coverage_report(around_one).warnings == ()
    # Without a box the cameras look between them.
    assert warned(pair.coverage_report().warnings, "as near to where the cameras look")


def test_a_box_that_cuts_the_object() -> None:
    whole, half = OrientedBox((0, 0, 0.3), (1.0, 1.0, 0.6)), OrientedBox((-0.25, 0, 0.3), (0.5, 1.0, 0.6))
    assert plain().coverage_report(whole).warnings == ()
    assert warned(plain().coverage_report(half).warnings, "the box cuts through what it holds")


def test_a_flat_thing_a_finger_beside_the_box_s_is_not_cut_off_it() -> None:
    def sheet(low_m: float, high_m: float) -> np.ndarray:
        steps = (np.arange(low_m, high_m, 0.005), np.arange(0, 0.27, 0.005), [0.012])
        return np.array(np.meshgrid(*steps)).reshape(3, -1).T

    def warns(length_m: float, right_m: float = 0.0) -> bool:
        """Of a box of this length that ends at `length_m + right_m`, with a margin on the other sides."""
        box = OrientedBox((right_m + length_m / 2 - 0.01, 0.135, 0.01), (length_m + 0.02, 0.31, 0.05))
        points = np.concatenate([board, card])
        held = box.contains(points)
        chosen = Selection(points[held], points[~held], box, given=True, focus=np.zeros(3))
        return warned(choice_warnings(chosen), "the box cuts through")

    board, card = sheet(0.0, 0.33), sheet(0.353, 0.47)
    # Without the card, with a strip of it, with all of it; and with half of the board.
    assert [warns(length_m) for length_m in (0.34, 0.36, 0.5, 0.16)] == [False, False, False, True]
    # All of the board and most of the card, and all of the card and half of the board: one of two is cut.
    assert warns(0.44)
    assert warns(0.26, right_m=0.25)


def test_a_box_under_a_table_top_holds_what_ends_in_it() -> None:
    """A stool beside a table: more of the table's top than of the stool lies in the box, but it runs on."""

    def plate(side_m: float, height_m: float) -> np.ndarray:
        steps = np.arange(0.015, side_m, 0.03)
        return np.array(np.meshgrid(steps, steps, [height_m])).reshape(3, -1).T

    stool, top = plate(0.3, 0.4), plate(0.9, 0.7)
    points = np.concatenate([stool, top])
    in_box = np.asarray((points[:, :2] < 0.4).all(axis=1))
    chosen = select_in_box(points, in_box)
    assert (top[:, :2] < 0.4).all(axis=1).sum() > len(stool)
    np.testing.assert_array_equal(np.flatnonzero(chosen), np.arange(len(stool)))
    # Without the stool the box cuts the table's top, and holds that part of it.
    np.testing.assert_array_equal(select_in_box(top, in_box[len(stool) :]), in_box[len(stool) :])


def test_cameras_whose_axes_part_look_ahead() -> None:
    """Turned away from each other, they all come from a point behind them; what they look at is ahead."""
    T_world_camera = np.tile(np.eye(4), (9, 1, 1))
    for pose, turn in zip(T_world_camera, np.linspace(-0.5, 0.5, 9), strict=True):
        c, s = np.cos(turn), np.sin(turn)
        pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
        pose[:3, 3] = pose[:3, 2]
    np.testing.assert_allclose(convergence_point(T_world_camera)[:2], 0, atol=1e-9)
    assert 2.0 < convergence_point(T_world_camera)[2] < 2.5


def test_things_that_hardly_touch_are_not_one_object() -> None:
    """A gap of 75 mm between edges is bridged by cells of 30 mm."""
    close = [FLOOR, box((-0.3, -0.15, 0), (0.02, 0.15, 0.4)), *table_of((0.095, -0.2, 0), (0.5, 0.2, 0.4))]
    doubtful = recorded(close, ring(16, 1.3, (0, 0, 0.2), (0.5, 0.8)), **FINE)
    doubts = doubtful.segment().warnings
    assert warned(doubts, "stand side by side") or warned(doubts, "beside the object")
    assert all("kinectbench segment --suggest" in line for line in doubts)


def test_an_object_too_large_to_be_one() -> None:
    long = recorded([FLOOR, box((-1.4, -0.2, 0), (1.4, 0.2, 0.4))], ring(24, 2.2, (0, 0, 0.2), (0.4, 0.7)))
    doubts = long.segment().warnings
    # It is 2.8 m long; at its ends a pixel is 17 mm wide.
    assert warned(doubts, "2.8 m long") or warned(doubts, "2.9 m long")


def test_a_depth_image_that_came_twice_is_one_view() -> None:
    twice = recorded([FLOOR, OBJECT], AROUND.repeat(2, axis=0))
    views = twice.views(twice.model())
    assert len(views.views) == len({view.frame // 2 for view in views.views}) == 24
    again = [reason for _, reason in views.refused if reason.startswith("its depth image is that of view 0")]
    assert len(again) == 24


def test_a_person_walking_through() -> None:
    def person(k: int) -> list[Callable[..., NDArray[np.float64]]]:
        x = -1.2 + 0.1 * k
        return [box((x - 0.2, -0.9, 0), (x + 0.2, -0.6, 1.7))]

    walked = recorded([FLOOR, OBJECT], passing={k: person(k) for k in range(24)})
    seen = walked.coverage_report()
    assert warned(seen.warnings, "something stands before the scene")
    # The person is at y = -0.75, between the object and the cameras of frames 13 to 22.
    frames = list(seen.moving.frames)
    assert set(range(15, 20)) <= set(frames)
    model = walked.model()
    np.testing.assert_allclose(model.box.size_m, [0.4, 0.3, 0.5], atol=0.02)
    for view in walked.views(model).views:
        assert view.fit.containment >= 0.85


@pytest.mark.parametrize("beside", [[], [box((0.9, 0.5, 0), (1.2, 0.8, 0.4))]])
def test_an_object_without_depth(beside: list[Callable[..., NDArray[np.float64]]]) -> None:
    """Nothing where the cameras look; with clutter, that is not taken for the object."""
    with raises(SegmentationError, "segmentation.no-object", match=r"object found.*gives"):
        recorded([FLOOR, *beside]).segment()
    with pytest.raises(SegmentationError, match=r"holds nothing|nothing stands"):
        recorded([FLOOR, *beside]).segment(OrientedBox((0, 0, 0.25), (0.5, 0.4, 0.5)))


def test_an_object_cut_by_the_image_border() -> None:
    near = recorded([FLOOR, OBJECT], ring(12, 0.7, (0.0, 0.0, 0.1), (0.5,)))
    model = near.model()
    assert warned(near.views(model).warnings, "the image border cuts the object")


def test_no_floor() -> None:
    hovering = recorded([OBJECT])
    with raises(SegmentationError, "segmentation.no-floor", match=r"box.*--suggest"):
        hovering.segment()
    chosen = hovering.segment(OrientedBox((0, 0, 0.25), (0.5, 0.4, 0.6)))
    assert not chosen.floor.found
    assert warned(chosen.warnings, "no floor was found")
    # The cameras are level and the lowest surface is the box's own foot, at the world's z = 0.
    np.testing.assert_allclose(chosen.floor.plane_world, [0, 0, 1, 0], atol=0.06)


def test_a_slope_is_no_floor() -> None:
    """A ramp of 60 degrees: far from what the cameras call up."""
    from analytic_scenes import plane

    steep = recorded([plane((0.0, -np.sin(np.pi / 3), np.cos(np.pi / 3)), 0.0)])
    with raises(SegmentationError, "segmentation.no-floor", match=r"no floor found.*or a box"):
        steep.segment()


@pytest.mark.parametrize(("height_m", "told"), [(0.0, False), (-0.4, True), (-3.0, True)])
def test_a_persons_plane_on_which_nothing_lies_is_told(height_m: float, told: bool) -> None:
    chosen = plain().segment(plane_world=np.array([0, 0, 1, -height_m]))
    assert chosen.floor.found
    assert warned(chosen.warnings, "nothing that was measured lies on the plane of `floor`") is told


@pytest.mark.parametrize(
    ("plane_world", "said"),
    [
        ((0, 0, 1, 0.02), "a plane 20 mm above it, parallel"),
        ((0, 0, 1, -0.06), "a plane 60 mm below it, parallel"),
        ((np.sin(0.1), 0, np.cos(0.1), 0), "turned by 6 degrees"),
    ],
)
def test_a_plane_seen_right_beside_a_persons_is_told_with_its_numbers(
    plane_world: tuple[float, float, float, float], said: str
) -> None:
    model = plain().model(floor=plane_world)
    (line,) = [line for line in model.quality.doubts or () if "`floor`" in line]
    assert line in model.quality.warnings and said in line
    assert not warned(model.quality.warnings, "the floor found")
    right = present(re.search(r"plane_world: \[(.*?)\]", line))[1]
    np.testing.assert_allclose([float(number) for number in right.split(",")], [0, 0, 1, 0], atol=0.004)
    a, b, c, d = map(float, right.split(","))
    assert not warned(plain().model(floor=(a, b, c, d)).quality.warnings, "`floor`")


def test_of_a_table_and_its_floor_a_person_says_which() -> None:
    top = recorded([FLOOR, *table_of((-0.4, -0.4, 0.0), (0.4, 0.4, 0.08)), OBJECT])
    for height_m in (0.0, 0.08):
        assert top.segment(plane_world=np.array([0, 0, 1, -height_m])).floor.against == ()


def test_what_fails_on_a_persons_plane_names_the_plane_beside_it() -> None:
    fine = FUSION.model_copy(update={"voxel_size_m": 0.003})
    with raises(SegmentationError, "segmentation.too-large", match="60"):
        plain().model(floor=(0, 0, 1, 0.06), fusion=fine)


def test_what_scatters_about_a_persons_plane_is_told_of_that_plane() -> None:
    chosen = plain().segment(plane_world=np.array([0, 0, 1, 0.0]))
    rough = replace(chosen, floor=replace(chosen.floor, noise_m=0.019))
    (line,) = plain().coverage_report_of(rough).choice_warnings
    assert "gives as `floor` scatters by 19 mm" in line and "give a box" not in line


def test_a_floor_that_is_not_flat_may_be_something_else() -> None:
    chosen = plain().segment()
    rough = replace(chosen, floor=replace(chosen.floor, noise_m=0.019))
    for each, told in ((chosen, False), (rough, True)):
        found = plain().coverage_report_of(each)
        assert warned(found.warnings, "the floor found scatters by 19 mm") is told
        assert warned(found.choice_warnings, "the floor found scatters by 19 mm") is told


def test_what_is_doubted_of_object_and_floor_is_stored_as_doubts() -> None:
    """Each is a line of the warnings; the gate of `publish` counts them."""
    # The plane that is given lies below the true floor, where nothing was measured, and the object hangs.
    around = OrientedBox((0, 0, 0.67), (0.5, 0.4, 0.5))
    quality = plain().model(around, floor=(0, 0, 1, 0.4)).quality
    assert quality.doubts is not None
    for words in ("nothing that was measured lies on the plane of `floor`", "above the floor: what carries"):
        assert warned(quality.doubts, words)
    assert set(quality.doubts) < set(quality.warnings)
    # A line in words that nobody has thought of is a doubt by its place.
    chosen = replace(plain().segment(), warnings=("in words of its own",))
    assert plain().coverage_report_of(chosen).choice_warnings == ("in words of its own",)


def test_depth_of_the_object_that_is_out_of_range() -> None:
    """The box's middle is 1.4 m away from all cameras: what they see of it lies in part beyond 1.4 m."""
    chosen = plain().segment()
    whole, half = (plain().coverage_report_of(chosen, max_depth_m=each) for each in (3.0, 1.4))
    assert whole.beyond_share == 0 and not warned(whole.warnings, "makes no surface")
    assert 0.1 < half.beyond_share < 0.5
    assert warned(half.warnings, f"{half.beyond_share:.0%} of the depth around the object lies beyond 1.4 m")
    assert warned(half.warnings, "raise `fusion.max_depth_m`, or leave it out")
    left_out = plain().coverage_report_of(chosen, max_depth_m=1.4, range_is_set=False).warnings
    assert warned(left_out, "lies beyond 1.4 m") and not warned(left_out, "fusion.max_depth_m")
    quality = plain().model().quality
    assert (quality.max_depth_m, quality.beyond_share, quality.doubts) == (3.0, 0.0, ())


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_few_good_frames(frames: int) -> None:
    few = recorded([FLOOR, OBJECT], AROUND[:frames])
    try:
        model = few.model()
    except KinectBenchError as error:
        assert frames == 1 and "no solid shape" in str(error)
        return
    assert warned(model.quality.warnings, f"made from {frames} frames only")
    assert model.quality.good_frames == frames
    assert warned(few.views(model).warnings, f"all {frames} good frames were tried")


def test_a_box_outside_the_volume() -> None:
    with raises(SegmentationError, "segmentation.empty-box"):
        plain().segment(OrientedBox((4.0, 0, 0.25), (0.5, 0.4, 0.5)))


def test_axes_that_meet_by_chance_do_not_shrink_the_scene() -> None:
    """A camera that is moved sideways and shaken: its axes pass each other near it, the box is 1.4 m away."""
    middle = ring(1, 1.4, (0.0, 0.0, 0.25), (0.5,))[0]
    poses = np.tile(middle, (9, 1, 1))
    for k, (pose, aside_m) in enumerate(zip(poses, np.linspace(-0.15, 0.15, 9), strict=True)):
        half_turn = (0.1 * (-1) ** k - 0.5 * aside_m) / 2
        about_y = rotation_from_quaternion_xyzw([0.0, np.sin(half_turn), 0.0, np.cos(half_turn)])
        pose[:3, :3] = middle[:3, :3] @ about_y
        pose[:3, 3] += aside_m * middle[:3, 0]
    assert np.linalg.norm(convergence_point(poses) - middle[:3, 3]) < 0.5
    chosen = recorded([FLOOR, OBJECT], poses).segment()
    assert chosen.cell_m == CELL_M
    assert np.linalg.norm(chosen.floor.T_world_floor[:3, :3] @ np.array([0, 0, 1.0]) - [0, 0, 1]) < 0.01
    corners = transform_points(chosen.floor.T_world_floor, chosen.box.corners_floor())
    np.testing.assert_allclose(corners.max(axis=0)[2], 0.5, atol=0.03)
