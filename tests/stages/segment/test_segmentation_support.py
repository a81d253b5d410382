"""What the object stands on: the floor, a table above it, a shelf; furniture stands on the floor."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from analytic_scenes import CAMERA, Surface, box, plane, ring
from bad_scenes import FLOOR, Recorded, recorded
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from slow import slow
from typed import noted

from kinectbench.core.geometry import transform_points
from kinectbench.core.geometry.boxes import OrientedBox
from kinectbench.settings.models import FusionSettings, PairSettings, SegmentationSettings, ViewSettings
from kinectbench.stages.pairs import full_shape, make_pair
from kinectbench.stages.sample_views.views import sample_views
from kinectbench.stages.segment.find import planes
from kinectbench.stages.segment.find.hints import FloorHint
from kinectbench.stages.segment.find.object import find_floor_and_object, find_scene
from kinectbench.stages.segment.find.pieces import MIN_CELLS

TOP_M = 0.74
NEAR = FusionSettings()
# Corners of a thing 120 x 100 x 180 mm on a table, beside its middle.
THING = ((0.1, -0.05, TOP_M), (0.22, 0.05, TOP_M + 0.18))
BOOK = ((-0.25, -0.2, TOP_M), (-0.05, -0.05, TOP_M + 0.03))


def table() -> list[Surface]:
    legs = [box((x, y, 0), (x + 0.05, y + 0.05, 0.7)) for x in (-0.6, 0.55) for y in (-0.4, 0.35)]
    return [box((-0.6, -0.4, 0.7), (0.6, 0.4, TOP_M)), *legs]


def middle(low: tuple[float, float, float], high: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = (np.array(low) + np.array(high)) / 2
    return float(x), float(y), float(z)


def seen_from_near(
    things: list[Surface],
    target: tuple[float, float, float],
    elevations: tuple[float, ...] = (0.7, 1.0, 1.25),
    distance_m: float = 0.6,
) -> Recorded:
    return recorded(things, ring(16, distance_m, target, elevations), camera=CAMERA, fusion=NEAR)


@functools.cache
def on_a_table() -> Recorded:
    # A bag hangs from the table's edge, near the thing.
    bag = box((0.1, 0.4, 0.3), (0.3, 0.45, TOP_M + 0.03))
    return seen_from_near([FLOOR, *table(), box(*THING), box(*BOOK), bag], middle(*THING))


def height_of_floor_m(found: Recorded) -> float:
    return float(-found.segment().floor.plane_world[3])


def test_a_thing_on_a_table_stands_on_it() -> None:
    chosen = on_a_table().segment()
    assert height_of_floor_m(on_a_table()) == pytest.approx(TOP_M, abs=0.003)
    # The worlds differ by the height only, or by a turn about it.
    corners = transform_points(chosen.floor.T_world_floor, chosen.box.corners_floor())
    np.testing.assert_allclose(corners.min(axis=0), THING[0], atol=0.01)
    np.testing.assert_allclose(corners.max(axis=0), THING[1], atol=0.01)
    assert (chosen.object_cells[:, 2] >= 0).all()


def test_what_hangs_below_the_edge_is_no_object() -> None:
    heights_m = [float(c.points_floor[:, 2].min()) for c in on_a_table().suggest().candidates]
    assert len(heights_m) >= 2 and min(heights_m) > 0


@pytest.mark.parametrize("lower", [slow(True), False])
def test_with_and_without_the_floor_in_view(lower: bool) -> None:
    floor = [FLOOR] if lower else []
    found = seen_from_near([*floor, *table(), box(*THING)], middle(*THING), (1.0, 1.25))
    assert height_of_floor_m(found) == pytest.approx(TOP_M, abs=0.003)


def test_a_bin_that_fills_most_of_a_table_stands_on_it() -> None:
    """Longer than half of the table, which goes on around it; the cameras look at the bin."""
    bin_ = ((-0.33, -0.25, TOP_M), (0.33, 0.25, TOP_M + 0.3))
    found = recorded([FLOOR, *table(), box(*bin_)], ring(20, 1.0, middle(*bin_), (0.7, 1.0)))
    assert height_of_floor_m(found) == pytest.approx(TOP_M, abs=0.005)


def test_a_small_thing_that_the_cameras_look_at_is_no_speck() -> None:
    die = ((0.1, 0.0, TOP_M), (0.138, 0.038, TOP_M + 0.038))
    found = seen_from_near([FLOOR, *table(), box(*die), box(*BOOK)], middle(*die), distance_m=0.5)
    chosen = found.segment()
    corners = transform_points(chosen.floor.T_world_floor, chosen.box.corners_floor())
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], die, atol=0.012)
    assert len(chosen.object_cells) < MIN_CELLS


def chair() -> list[Surface]:
    legs = [box((x, y, 0), (x + 0.04, y + 0.04, 0.42)) for x in (-0.2, 0.16) for y in (-0.2, 0.16)]
    seat, back = box((-0.2, -0.2, 0.42), (0.2, 0.2, 0.46)), box((-0.2, 0.16, 0.46), (0.2, 0.2, 0.9))
    return [*legs, seat, back]


FURNITURE = {
    "chair": (chair(), (0.0, 0.0, 0.45)),
    # Its arms and back stand on the seat as far as anybody can see.
    "couch": (
        [
            box((-0.9, -0.4, 0), (0.9, 0.4, 0.42)),
            box((-0.9, 0.25, 0.42), (0.9, 0.4, 0.85)),
            box((-0.9, -0.4, 0.42), (-0.75, 0.25, 0.62)),
            box((0.75, -0.4, 0.42), (0.9, 0.25, 0.62)),
        ],
        (0.0, 0.0, 0.43),
    ),
    "lamp beside a table": (
        [
            *table(),
            box((-0.12, 0.5, 0), (0.12, 0.74, 0.04)),
            box((-0.03, 0.59, 0), (0.03, 0.65, 1.3)),
            box((-0.15, 0.47, 1.3), (0.15, 0.77, 1.6)),
        ],
        (0.0, 0.62, 0.8),
    ),
    "table with a book on it": ([*table(), box(*BOOK)], (0.0, 0.0, 0.37)),
    # The mattress is as high as the cameras' focus.
    "bed with a pillow": (
        [
            box((-0.7, -1, 0), (0.7, 1, 0.5)),
            box((-0.7, 1, 0), (0.7, 1.05, 1.0)),
            box((-0.3, 0.6, 0.5), (0.3, 0.9, 0.62)),
        ],
        (0.0, 0.0, 0.5),
    ),
}


@pytest.mark.parametrize("name", FURNITURE)
def test_furniture_stands_on_the_floor(name: str) -> None:
    surfaces, target = FURNITURE[name]
    far_m = 2.6 if "bed" in name or "couch" in name else 1.6
    found = recorded([FLOOR, *surfaces], ring(20, far_m, target, (0.35, 0.6)))
    assert height_of_floor_m(found) == pytest.approx(0, abs=0.01)


# A bottle 60 mm wide on the middle one of three boards, half a metre before a wall.
BOTTLE = ((-0.03, -0.18, 0.9), (0.03, -0.12, 1.12))
SHELF = [
    plane((0, -1, 0), 0.0),
    FLOOR,
    *(box((-0.5, -0.3, z - 0.02), (0.5, 0, z)) for z in (0.4, 0.9, 1.4)),
    *(box((x, -0.3, 0), (x + 0.02, 0, 1.4)) for x in (-0.52, 0.5)),
    box((0.15, -0.25, 0.9), (0.3, -0.1, 1.0)),
]


def before_it(count: int) -> np.ndarray:
    """Cameras in front of the shelf, half a metre from the bottle, to the left and to the right."""
    poses = ring(360, 0.5, middle(*BOTTLE), (0.35, 0.5, 0.2))
    before = poses[poses[:, 1, 3] < middle(*BOTTLE)[1] - 0.25]
    it: np.ndarray = before[np.linspace(0, len(before) - 1, count).astype(int)]
    return it


@functools.cache
def on_a_shelf() -> Recorded:
    return recorded([*SHELF, box(*BOTTLE)], before_it(30), camera=CAMERA, fusion=NEAR)


def is_the_bottle(candidate_box: OrientedBox, T_world_floor: NDArray[np.float64]) -> bool:
    corners = transform_points(T_world_floor, candidate_box.corners_floor())
    wrong_m = np.abs(np.stack([corners.min(axis=0), corners.max(axis=0)]) - np.array(BOTTLE))
    return bool(wrong_m.max() < 0.035)


def test_a_bottle_on_a_shelf_is_among_the_candidates() -> None:
    found = on_a_shelf().suggest()
    T_world_floor = found.scene.floor.T_world_floor
    assert height_of_floor_m(on_a_shelf()) == pytest.approx(0.9, abs=0.004)
    assert is_the_bottle(found.candidates[0].box, T_world_floor) and found.candidates[0].automatic


@pytest.mark.parametrize("with_box", [False, True])
def test_a_bottle_on_a_shelf_comes_to_pairs(with_box: bool) -> None:
    given = on_a_shelf().suggest().candidates[0].box if with_box else None
    model = on_a_shelf().model(given, FusionSettings())
    assert not any("larger" in warning for warning in model.quality.warnings)
    # Smaller voxels than those of furniture, and the solid is as wide as it is.
    assert model.shape.grid.voxel_size_m < 0.004
    np.testing.assert_allclose(sorted(model.box.size_m), [0.06, 0.06, 0.22], atol=0.006)
    settings = ViewSettings(count=5), SegmentationSettings(), PairSettings()
    scene = on_a_shelf()
    views = sample_views(scene.sequence, scene.trajectory, model, *settings)
    made = [make_pair(view, scene.sequence, full_shape(model), PairSettings()) for view in views.views]
    assert sum(one.pair is not None for one in made) >= 4


BY_HAND = FloorHint(plane_world=np.array([0.0, 0, 1, 0]))


@pytest.mark.parametrize(("share", "is_cut"), [(1.0, False), (0.5, True)])
def test_a_shelfs_board_is_not_cut_by_a_box_on_it(share: float, is_cut: bool) -> None:
    """In the frame of the real floor, by which the board is surface like any other."""
    scene, box = on_a_shelf(), on_a_shelf().suggest().candidates[0].box
    (x, y, z), (length, width, height) = box.center_m, box.size_m
    lower = replace(box, center_m=(x, y, z + 0.9 - (1 - share) * height / 2))
    given = replace(lower, size_m=(length, width, share * height))
    chosen = find_floor_and_object(scene.scene, scene.trajectory, given, SegmentationSettings(), BY_HAND)
    assert any("make it larger" in line for line in chosen.warnings) == is_cut


def test_a_plane_by_hand_wins() -> None:
    found = find_scene(on_a_table().scene, on_a_table().trajectory, SegmentationSettings(), False, BY_HAND)
    assert found.floor.plane_world.tolist() == [0, 0, 1, 0]


def test_of_many_planes_the_surface_is_measured_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[np.ndarray]] = []
    monkeypatch.setattr(planes, "cKDTree", noted(cKDTree, made))
    ground = np.stack([*np.meshgrid(np.arange(50.0), np.arange(50.0)), np.zeros((50, 50))], -1) / 100
    points = ground.reshape(-1, 3)
    up = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    surface = planes.SceneSurface(points, up, np.array([0.25, 0.25, 0.1]), 0.02)
    for height_m in (0.0, -0.1, -0.2):
        planes.carries_what_is_looked_at(np.array([0.0, 0.0, 1.0, height_m]), surface)
    assert [len(points) for (points,) in made] == [2500] and surface.spacing_m == pytest.approx(0.01)
