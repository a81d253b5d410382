"""Candidate boxes: what stands on a floor, numbered, in the form and frame of benchmark.yaml."""

import functools
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from analytic_scenes import CAMERA, box, depth_of, health_of, ring, sequence_of, trajectory_of
from bad_scenes import FINE, FLOOR, OBJECT, SEGMENTATION, Recorded, recorded, table_of
from raising import raises
from read_pictures import read_picture

from kinectbench.core.artefacts.object import CandidatesFile
from kinectbench.core.artefacts.trajectory import FrameHealth
from kinectbench.core.box_pictures import COLORS_RGB, best_frame
from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import OrientedBox, invert_rigid, transform_points
from kinectbench.core.voxels.point_cells import cell_numbers
from kinectbench.lab.simulate.path import look_at
from kinectbench.settings.edit import box_line
from kinectbench.settings.models import BoxSettings
from kinectbench.stages.segment.find.candidates import (
    Candidate,
    Candidates,
    find_candidates,
    write_candidates,
)
from kinectbench.stages.segment.find.floor import Floor
from kinectbench.stages.segment.find.pieces import (
    Selection,
    choice_warnings,
    large_neighbours,
    nearest_within,
    separate_parts,
    things_beside,
)

pytestmark = pytest.mark.xdist_group("bad_scenes")
# A table 75 mm beside a chest, less once fused: one piece at 30 mm cells, two at 20 mm. And a stool.
CHEST, TABLE = ((-0.3, -0.15, 0), (0.02, 0.15, 0.4)), ((0.095, -0.2, 0), (0.5, 0.2, 0.4))
STOOL = ((0.1, 0.7, 0), (0.35, 0.95, 0.3))


@functools.cache
def three() -> Recorded:
    return recorded(
        [FLOOR, box(*CHEST), *table_of(*TABLE), box(*STOOL)],
        ring(16, 1.4, (-0.1, 0.0, 0.2), (0.5, 0.8)),
        **FINE,
    )


@functools.cache
def found() -> Candidates:
    return find_candidates(three().scene, three().trajectory, SEGMENTATION)


def is_of(candidate: Candidate, low: tuple[float, float, float], high: tuple[float, float, float]) -> bool:
    """The candidate's box is the thing's, with the margin of 20 mm on each side."""
    corners = candidate.box.corners_floor()
    near_low = np.abs(corners.min(axis=0)[:2] - np.array(low[:2]) + 0.02).max() < 0.03
    near_high = np.abs(corners.max(axis=0) - np.array(high) - 0.02).max() < 0.03
    return bool(near_low and near_high)


@pytest.mark.parametrize("thing", [CHEST, TABLE, STOOL])
def test_each_thing_has_a_box(thing: tuple[tuple[float, float, float], tuple[float, float, float]]) -> None:
    assert sum(is_of(candidate, *thing) for candidate in found().candidates) == 1


def test_the_automatic_choice_comes_first_and_once() -> None:
    marks = [candidate.automatic for candidate in found().candidates]
    assert marks[0] and sum(marks) == 1
    chosen = three().segment()
    first = found().candidates[0].box
    np.testing.assert_allclose(first.center_m[:2], chosen.box.center_m[:2], atol=0.01)
    distances = [candidate.distance_m for candidate in found().candidates[1:]]
    assert distances == sorted(distances)


def test_the_box_of_a_candidate_chooses_that_thing() -> None:
    (stool,) = (candidate for candidate in found().candidates if is_of(candidate, *STOOL))
    chosen = three().segment(stool.box)
    cells = (chosen.object_cells + 0.5) * 0.03
    assert cells[:, 1].min() > 0.65 and len(cells) > 100
    assert chosen.warnings == ()


def test_a_thing_counts_once_though_its_feet_turn_its_box() -> None:
    """Around a cross-shaped block with runners, too low for pieces, a box at 45 degrees is smaller."""
    block = [box((-0.3, -0.15, 0), (0.3, 0.15, 0.3)), box((-0.15, -0.3, 0), (0.15, 0.3, 0.3))]
    runners = [box((-0.34, -0.02, 0), (0.34, 0.02, 0.016)), box((-0.02, -0.34, 0), (0.02, 0.34, 0.016))]
    cross = recorded([FLOOR, *block, *runners], ring(16, 1.4, (0.0, 0.0, 0.15), (0.5, 0.8)), **FINE)
    (found_once,) = find_candidates(cross.scene, cross.trajectory, SEGMENTATION).candidates
    assert abs(found_once.box.yaw_rad) > 0.7


def test_nothing_to_choose() -> None:
    bare = recorded([FLOOR])
    with raises(SegmentationError, "segmentation.no-candidates"):
        find_candidates(bare.scene, bare.trajectory, SEGMENTATION)


def test_without_a_floor_there_are_candidates_none_of_them_automatic() -> None:
    hovering = recorded([OBJECT])
    without = find_candidates(hovering.scene, hovering.trajectory, SEGMENTATION)
    assert not without.scene.floor.found
    # Voxels of 20 mm leave gaps along the edges of so small a thing: at the finest its sides count apart.
    assert without.candidates and not any(candidate.automatic for candidate in without.candidates)
    np.testing.assert_allclose(without.candidates[0].box.size_m, [0.44, 0.34, 0.52], atol=0.03)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    to = tmp_path_factory.mktemp("candidates")
    write_candidates(found(), three().sequence, three().trajectory, to)
    return to


def test_folder(folder: Path, tmp_path: Path) -> None:
    listed = CandidatesFile.read(folder)
    assert [row.number for row in listed.candidates] == list(range(1, len(found().candidates) + 1))
    assert listed.floor_found
    # What is known in the world can be given as a box: the candidate's points lie in its box.
    assert listed.T_floor_world is not None
    world = transform_points(found().scene.floor.T_world_floor, found().candidates[0].points_floor)
    box = listed.candidates[0].box.box()
    assert box.grown(0.001).contains(transform_points(listed.T_floor_world, world)).mean() > 0.99
    for row, candidate in zip(listed.candidates, found().candidates, strict=True):
        pasted = yaml.safe_load(box_line(row.box))["box"]
        given = BoxSettings.model_validate(pasted).box()
        np.testing.assert_allclose(given.center_m, candidate.box.center_m, atol=0.00051)
        np.testing.assert_allclose(given.size_m, candidate.box.size_m, atol=0.00051)
        assert read_picture(folder / row.picture).shape == (240, 320, 3)
    assert read_picture(folder / listed.plan).std() > 10
    write_candidates(found(), three().sequence, three().trajectory, tmp_path)
    for path in folder.iterdir():
        assert path.read_bytes() == (tmp_path / path.name).read_bytes()


def test_the_box_is_drawn_where_it_stands(folder: Path) -> None:
    """The middle of each edge that is in the image has the box's colour, of depth there is none."""
    number = next(k for k, c in enumerate(found().candidates, start=1) if is_of(c, *CHEST))
    candidate, floor = found().candidates[number - 1], found().scene.floor
    frame = best_frame(candidate.shown(floor), three().sequence, three().trajectory)
    T_camera_floor = invert_rigid(three().trajectory.T_world_camera[frame]) @ floor.T_world_floor
    corners = transform_points(T_camera_floor, candidate.box.corners_floor())
    edges = [(a, b) for a in range(8) for b in range(a) if (a ^ b).bit_count() == 1]
    middles = CAMERA.project(np.stack([(corners[a] + corners[b]) / 2 for a, b in edges]))
    image = read_picture(folder / f"{number}.png")[..., ::-1].astype(int)
    color = np.array(COLORS_RGB[number - 1])
    checked = 0
    for (u, v), (a, b) in zip(middles, edges, strict=True):
        # Half-way in space is not half-way in the image; on the line it is all the same.
        if 50 < u < 310 and 50 < v < 230:
            patch = image[int(v) - 1 : int(v) + 3, int(u) - 1 : int(u) + 3]
            assert np.abs(patch - color).sum(axis=-1).min() < 60, (a, b)
            checked += 1
    assert checked >= 2


def test_the_best_frame_shows_the_whole_box_and_is_sharp() -> None:
    """A block whose top all frames see: one nearer by cuts its lower end, in one it is mostly hidden."""
    near = look_at(np.array([1.0, 0.0, 0.9]), np.array([0.0, 0.0, 0.72]))
    far = look_at(np.array([1.5, 0.0, 1.0]), np.array([0.0, 0.0, 0.25]))
    poses = np.stack([near, far, far, far])
    block, screen = box((-0.2, -0.15, 0.0), (0.2, 0.15, 0.5)), box((0.6, -0.05, 0.0), (0.62, 0.5, 1.2))
    in_view = ([block], [block], [block], [block, screen])
    depths_m = [depth_of([FLOOR, *s], CAMERA, T) for s, T in zip(in_view, poses, strict=True)]
    blur = (0.8, 2.0, 1.0, 0.5)
    rows = [FrameHealth(frame=k, blur=value) for k, value in enumerate(blur)]
    trajectory = replace(trajectory_of(poses), health=health_of(4, per_frame=rows))
    x, y = np.meshgrid(np.linspace(-0.19, 0.19, 20), np.linspace(-0.14, 0.14, 20))
    top = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.5)])
    candidate = Candidate(OrientedBox((0, 0, 0.25), (0.4, 0.3, 0.5)), top, False, 0.0)
    floor = Floor(np.array([0.0, 0, 1, 0]), np.eye(4), 0.0, 1.0)
    sequence = sequence_of(depths_m, CAMERA)
    assert best_frame(candidate.shown(floor), sequence, trajectory) == 2
    # What is hidden is not shown, though its box lies in the image.
    poses[1:3] = np.nan
    assert best_frame(candidate.shown(floor), sequence, trajectory) == 0


def test_parts_are_counted_where_they_come_apart() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(0, 0.3, 0.01)] * 3, indexing="ij"), -1).reshape(-1, 3)
    apart = grid + np.array([0.36, 0, 0])
    assert separate_parts(grid) == 1
    assert separate_parts(np.concatenate([grid, apart])) == 2
    assert separate_parts(np.concatenate([grid, grid + np.array([0.31, 0, 0])])) == 1
    # A lamp above it hangs, and a crumb beside it is small.
    crumb = grid[(grid < 0.055).all(axis=1)] + [0.36, 0, 0]
    assert separate_parts(np.concatenate([grid, grid + np.array([0, 0, 0.5]), crumb])) == 1
    assert separate_parts(np.zeros((0, 3))) == 0


def test_a_small_thing_that_stands_beside_the_rest_is_another_one_and_a_leg_below_it_is_not() -> None:
    top = np.stack(np.meshgrid(*[np.arange(0, 0.6, 0.01)] * 2, [0.01, 0.4], indexing="ij"), -1).reshape(-1, 3)
    post = np.stack(np.meshgrid([0.3], [0.3], np.arange(0, 0.4, 0.01), indexing="ij"), -1).reshape(-1, 3)
    block = np.stack(np.meshgrid(*[np.arange(0, 0.12, 0.01)] * 3, indexing="ij"), -1).reshape(-1, 3)
    table = np.concatenate([top, post])

    def beside(thing: np.ndarray, x: float, y: float = 0.0, z: float = 0.0) -> int:
        return things_beside(np.concatenate([table, thing + np.array([x, y, z])]))

    assert things_beside(table) == 0
    assert beside(block, 0.66) == 0  # 6 cm: perhaps a leg
    assert beside(block, 0.75) == 1
    assert beside(block, 0.2, 0.2, 0.1) == 0
    assert beside(block[::20], 0.75) == 0  # a crumb
    assert things_beside(np.zeros((0, 3))) == 0


def test_the_floor_below_a_table_that_fills_the_frames() -> None:
    """A table top of 1.6 x 1.6 m; of the floor a strip, a tenth as large, is in view."""
    rng = np.random.default_rng(0)
    from kinectbench.stages.segment.find.floor import find_floor

    a, b = np.meshgrid(np.arange(-0.8, 0.8, 0.03), np.arange(-0.8, 0.8, 0.03))
    top = np.column_stack([a.ravel(), b.ravel(), np.full(a.size, 0.7)])
    strip = top[(top[:, 0] > 0.68)] + [0.3, 0, -0.7]
    strip = strip[np.abs(strip[:, 1]) < 0.4]
    points = np.concatenate([top, strip]) + rng.normal(0, 0.002, (len(top) + len(strip), 3))
    assert 0.01 < len(strip) / len(points) < 0.05
    floor = find_floor(
        points, np.tile([0, 0, 1.0], (len(points), 1)), ring(12, 1.6, (0, 0, 0.7), (0.5,)),
        np.array([0.0, 0.0, 0.7]), 0,
    )  # fmt: skip
    np.testing.assert_allclose(floor.plane_world[2], 1, atol=1e-3)
    assert abs(floor.plane_world[3]) < 0.02


def test_nearest_within() -> None:
    rng = np.random.default_rng(0)
    points, asked = rng.uniform(-1, 1, (300, 3)), rng.uniform(1.05, 2, (9000, 3))
    from scipy.spatial import cKDTree

    apart_m, nearest = cKDTree(points).query(asked)
    least = int(np.argmin(apart_m))
    found = nearest_within(cKDTree(points), asked, apart_m[least])
    assert found == (apart_m[least], nearest[least])
    assert nearest_within(cKDTree(points), asked, apart_m[least] - 1e-6) == (np.inf, None)


def test_a_room_around_the_object_takes_no_time() -> None:
    """A surface as far away on all sides: without a bound each search visits all of it (9 s here)."""
    rng = np.random.default_rng(0)
    turn = rng.uniform(0, 2 * np.pi, 100_000)
    room = np.column_stack([2 * np.cos(turn), 2 * np.sin(turn), rng.uniform(0.02, 2, 100_000)])
    desk = rng.uniform((-0.1, -0.1, 0.02), (0.1, 0.1, 0.22), (6000, 3))
    selection = Selection(desk, room, OrientedBox((0, 0, 0.1), (0.2, 0.2, 0.2)), False, np.array([0, 0, 0.1]))
    assert len(large_neighbours(selection)) == len(room)
    began = time.process_time()
    assert choice_warnings(selection) == ()
    assert time.process_time() - began < 5


@pytest.mark.parametrize("columns", [2, 3])
def test_cells_have_numbers_in_their_order(columns: int) -> None:
    cells = np.random.default_rng(0).integers(-7, 9, (500, columns))
    for by_row, by_number in zip(
        np.unique(cells, axis=0, return_index=True, return_inverse=True, return_counts=True)[1:],
        np.unique(cell_numbers(cells), return_index=True, return_inverse=True, return_counts=True)[1:],
        strict=True,
    ):
        np.testing.assert_array_equal(by_row.reshape(-1), by_number.reshape(-1))
    assert len(cell_numbers(cells[:0])) == 0
