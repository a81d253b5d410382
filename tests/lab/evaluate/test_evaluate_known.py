"""Labels, probabilities and faces of builds whose errors are known, against values counted by hand."""

from dataclasses import replace

import manifold3d
import numpy as np
import pytest
from analytic_scenes import MemoryFrames
from known_builds import CAMERA, T_WORLD_OBJECT, Known, chair, known_build, mesh_of

from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import (
    Grid,
    OrientedBox,
    TriangleMesh,
    invert_rigid,
    rigid,
    transform_points,
)
from kinectbench.core.geometry.mesh import box_mesh, join
from kinectbench.core.sequence import Sequence
from kinectbench.core.types import Bools, Float64
from kinectbench.core.voxels.point_cells import sample_surface
from kinectbench.lab.evaluate.build import BuildRegistration, register_build
from kinectbench.lab.evaluate.known import (
    Voxels,
    calibration,
    calibration_error,
    called_air_beyond_m3,
    cells_around,
    equal_bins,
    gross_errors,
    seeable_distance_m,
    unknown_near_measured,
    voxels_beside,
)
from kinectbench.lab.evaluate.measured import (
    FaceBias,
    MeasuredSurface,
    edge_points,
    face_bias,
    measured_surface,
    returned,
)
from kinectbench.lab.evaluate.solid import solid_figures
from kinectbench.lab.evaluate.surface import errors_at_object, surface_figures
from kinectbench.lab.simulate.truth import SurfaceTruth, TrueCells, Truth
from kinectbench.stages.segment.solid.solid import SolidShape

VOXEL_M = 0.005
SIDE_M = 0.2
# A cube on a floor, and a grid of 64^3 voxels whose cells end at its faces.
CUBE = OrientedBox((0.0, 0.0, SIDE_M / 2), (SIDE_M, SIDE_M, SIDE_M))
GRID = Grid((64, 64, 64), VOXEL_M, rigid(np.eye(3), [-0.16, -0.16, -0.06]))
HERE = BuildRegistration(np.arange(60), np.ones(60, bool), np.eye(4), True)


def cube_truth(truth: Truth) -> Truth:
    return replace(truth, mesh_world=box_mesh(CUBE), T_world_object=np.eye(4))


def centres() -> Float64:
    """(64, 64, 64, 3) of the grid's cells."""
    return transform_points(GRID.T_world_grid, (np.moveaxis(np.indices(GRID.shape), 0, -1) + 0.5) * VOXEL_M)


def cube_distance_m(points: Float64) -> Float64:
    """Signed distance from the cube, > 0 outside, by hand."""
    beyond = np.abs(points - np.array(CUBE.center_m)) - SIDE_M / 2
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=-1)
    return np.asarray(np.where(outside > 0, outside, beyond.max(axis=-1)))


def cube_voxels(known: Known, solid: Bools, labels: np.ndarray, probability: np.ndarray) -> Voxels:
    assert known.build.model
    shape = SolidShape(
        GRID, solid, box_mesh(CUBE), labels, probability.astype(np.float32), np.zeros_like(solid)
    )
    truth = cube_truth(known.truth)
    return voxels_beside(replace(known.build.model, shape=shape), truth, HERE, everywhere(truth))


def everywhere(truth: Truth) -> MeasuredSurface:
    """Samples of the whole surface, all of them measured."""
    mesh = truth.mesh_world
    points, normals = sample_surface(mesh.vertices, mesh.faces, 20_000, np.random.default_rng(3))
    return MeasuredSurface(points, normals, np.ones(len(points), bool))


def test_voxels_lie_beside_the_truth(perfect: Known) -> None:
    signed_m = cube_distance_m(centres())
    inside = signed_m < 0
    labels = np.where(inside, Label.INTERIOR, Label.FREE).astype(np.uint8)
    voxels = cube_voxels(perfect, inside, labels, inside.astype(float))
    np.testing.assert_array_equal(voxels.true, inside)
    near = np.abs(signed_m) <= 0.03
    np.testing.assert_array_equal(np.isfinite(voxels.distance_m), near)
    np.testing.assert_allclose(voxels.distance_m[near], np.abs(signed_m)[near], atol=1e-6)
    assert voxels.known.all()


def test_gross_errors_by_hand(perfect: Known) -> None:
    inside = cube_distance_m(centres()) < 0
    labels = np.where(inside, Label.INTERIOR, Label.FREE).astype(np.uint8)
    solid = inside.copy()
    # The lower half of the cube is called air; of it 36 x 36 x 18 cells are more than 10 mm inside.
    solid[:, :, 12:32] = False
    labels[:, :, 12:32] = Label.FREE
    # Above it a slab of 40 x 40 x 6 cells is called solid; all but its two lowest layers are farther off.
    solid[12:52, 12:52, 52:58] = True
    labels[12:52, 12:52, 52:58] = Label.SURFACE
    gross = gross_errors(cube_voxels(perfect, solid, labels, solid.astype(float)), SIDE_M**3)
    assert gross.solid_called_air == pytest.approx(36 * 36 * 18 / 40**3)
    assert gross.air_called_solid == pytest.approx(40 * 40 * 4 / 40**3)
    assert gross.known_gross_share == pytest.approx((36 * 36 * 18 + 40 * 40 * 4) / 40**3)
    # What is called unknown is no error, whatever is guessed of it.
    labels[:, :, 12:32] = Label.UNKNOWN
    gross = gross_errors(cube_voxels(perfect, solid, labels, solid.astype(float)), SIDE_M**3, 0.0008)
    assert gross.solid_called_air == pytest.approx(0.1)  # 0.8 l of 8 l, beyond the voxels
    assert gross.known_gross_share == pytest.approx(0.1 + 40 * 40 * 4 / 40**3)


def test_what_lies_beyond_the_voxels(perfect: Known) -> None:
    inside = cube_distance_m(centres()) < 0
    voxels = cube_voxels(perfect, inside, np.full(GRID.shape, Label.FREE, np.uint8), inside.astype(float))
    truth = cube_truth(perfect.truth)
    # Nothing lies beyond the whole grid; beyond its lower 32 layers lies the upper half of the cube.
    assert called_air_beyond_m3(GRID, inside, voxels, truth) == 0
    lower = replace(voxels, grid=Grid((64, 64, 32), VOXEL_M, GRID.T_world_grid))
    found_m3 = called_air_beyond_m3(GRID, inside, lower, truth)
    assert found_m3 == pytest.approx(36 * 36 * 18 * VOXEL_M**3)


def test_unknown_near_measured_by_hand(perfect: Known) -> None:
    signed_m = cube_distance_m(centres())
    inside = signed_m < 0
    labels = np.where(inside, Label.INTERIOR, Label.FREE).astype(np.uint8)
    labels[12:52, 12:52, 52] = Label.UNKNOWN  # one layer right above the cube
    labels[12:52, 12:52, 51] = Label.UNKNOWN  # the uppermost of the cube
    labels[:, :, 60:] = Label.UNKNOWN  # far from the surface
    # Beside the exact cube: the edge that it makes with the floor is not judged otherwise.
    voxels = cube_voxels(perfect, inside, labels, inside.astype(float)).against_exact
    surface = everywhere(cube_truth(perfect.truth))
    found = unknown_near_measured(voxels, surface)
    assert found.air == pytest.approx(1600 / np.count_nonzero((signed_m > 0) & (signed_m <= 0.01)))
    assert found.solid == pytest.approx(1600 / (40**3 - 36**3))
    # Only the top was measured: beside it two layers each count, and of both one is unknown.
    top = replace(surface, measured=surface.normals_world[:, 2] > 0.7)
    found = unknown_near_measured(voxels, top)
    assert found.solid == pytest.approx(0.5, abs=0.03)  # along the edges the sides are nearer
    assert found.air == pytest.approx(0.5, abs=0.06)  # beyond the edges, nothing is unknown
    none = unknown_near_measured(voxels, replace(surface, measured=surface.measured & False))
    assert (none.solid, none.air) == (None, None)


def test_calibration_by_hand(perfect: Known) -> None:
    signed_m = cube_distance_m(centres())
    inside = signed_m < 0
    probability = np.where(inside, 0.9, 0.2)
    labels = np.where(inside, Label.INTERIOR, Label.FREE).astype(np.uint8)
    labels[:, :, 63] = Label.UNKNOWN
    bins = calibration(cube_voxels(perfect, inside, labels, probability).against_exact)
    asked = np.abs(signed_m) <= 0.03
    asked[:, :, 63] = True
    assert sum(each.count for each in bins) == np.count_nonzero(asked)
    # All but the bin across the border are 0.2 against 0 or 0.9 against 1.
    share = np.count_nonzero(asked & inside) / np.count_nonzero(asked)
    pure = int(10 * (1 - share))
    assert [each.inside_share for each in bins[:pure]] == [0] * pure
    assert bins[0].mean_probability == pytest.approx(0.2)
    assert bins[-1].mean_probability == pytest.approx(0.9)
    mixed = 10 * share % 1
    expected = (0.2 * pure + abs(0.2 * (1 - mixed) - 0.1 * mixed) + 0.1 * (9 - pure)) / 10
    assert calibration_error(bins) == pytest.approx(expected, abs=1e-3)


def test_bins_of_equal_count_by_hand() -> None:
    # 20 voxels, two a bin; the six of 0.5 have the same share inside, wherever a border divides them.
    probability = np.array([0.0] * 7 + [0.5] * 6 + [1.0] * 7)
    inside = np.array([False] * 7 + [True, True, True, False, False, False] + [True] * 7)
    bins = equal_bins(probability, inside)
    assert [each.count for each in bins] == [2] * 10
    assert [each.mean_probability for each in bins] == [0, 0, 0, 0.25, 0.5, 0.5, 0.75, 1, 1, 1]
    assert [each.inside_share for each in bins] == [0, 0, 0, 0.25, 0.5, 0.5, 0.75, 1, 1, 1]
    assert calibration_error(bins) == 0
    assert equal_bins(probability[::-1], inside[::-1]) == bins
    assert calibration_error(equal_bins(probability, ~inside)) == pytest.approx((3 + 0.5 + 0.5 + 3) / 10)
    assert len(equal_bins(probability[:3], inside[:3])) == 3
    assert calibration_error(equal_bins(probability[:0], inside[:0])) is None


def test_cells_around_points() -> None:
    points = np.array([[-0.16 + 0.0125, 0.0, 0.1], [0.5, 0.5, 0.5], [-0.17, -0.16, -0.06]])
    around = cells_around(GRID, points, 0.01)
    near = np.linalg.norm(centres()[..., None, :] - points, axis=-1).min(axis=-1) <= 0.01
    assert near.any()
    assert not (near & ~around).any()
    assert np.count_nonzero(around) <= 2 * 7**3


def test_depth_that_was_returned_by_hand() -> None:
    # A wall at 1 m, of which the left half gave no depth; a camera in the origin looks along z.
    depth_m = np.ones((CAMERA.height, CAMERA.width), np.float32)
    depth_m[:, :160] = 0
    towards = [0.0, 0.0, -1.0]
    slanted = [np.sin(np.radians(82)), 0.0, -np.cos(np.radians(82))]
    rows = [
        ([0.1, 0.0, 1.0], towards, True),
        ([0.1, 0.0, 1.024], towards, True),
        ([0.1, 0.0, 1.026], towards, False),  # 25 mm at 1 m
        ([0.1, 0.0, 0.97], towards, False),
        ([-0.1, 0.0, 1.0], towards, False),  # no depth
        ([0.1, 0.0, 1.0], [0.0, 0.0, 1.0], False),  # looks away
        ([0.0, 0.0, 1.0], slanted, False),
        ([0.7, 0.0, 1.0], towards, False),  # beyond the image
        ([0.1, 0.0, -1.0], [0.0, 0.0, 1.0], False),  # behind the camera
    ]
    points, normals = (np.array([row[k] for row in rows]) for k in (0, 1))
    found = returned(points, normals, CAMERA, np.eye(4), depth_m)
    assert found.tolist() == [row[2] for row in rows]


def test_measured_surface_of_a_chair(perfect: Known) -> None:
    surface = measured_surface(perfect.build, perfect.truth, register_build(perfect.build, perfect.truth))
    points = transform_points(invert_rigid(T_WORLD_OBJECT), surface.points_world)
    up = surface.normals_world @ T_WORLD_OBJECT[:3, 2]
    seat = (np.abs(points[:, 2] - 0.47) < 1e-6) & (up > 0.9)
    assert surface.measured[seat].mean() > 0.99
    # Cameras are higher than the seat: it hides its underside, and the feet stand on the floor.
    assert not surface.measured[up < -0.7].any()
    # What depth tells is what the cameras see, but for slanted views.
    from scipy.spatial import cKDTree

    truth = perfect.truth.surface
    nearest = cKDTree(truth.points_world).query(surface.points_world)[1]
    seen = truth.frames_seen[nearest] > 0
    assert (surface.measured & ~seen).mean() < 0.01
    assert (seen & ~surface.measured).mean() < 0.03
    blind = replace(perfect.build, depth_m=_blind().depth_m)
    assert not measured_surface(blind, perfect.truth, HERE).measured.any()


def _blind() -> Sequence:
    empty = np.zeros((CAMERA.height, CAMERA.width), np.uint16)
    return Sequence(CAMERA, 1000.0, np.arange(60), True, None, MemoryFrames(lambda _index: empty))


def test_bias_of_faces(truth: Truth) -> None:
    surface = everywhere(truth)
    wide = mesh_of(chair(0.004)).transformed(T_WORLD_OBJECT)
    dilated = face_bias(wide, truth, surface)
    assert dilated.up == pytest.approx(0.004, abs=1e-5)
    assert dilated.side == pytest.approx(0.004, abs=1e-5)
    assert dilated.down == pytest.approx(0.004, abs=1e-5)
    higher = truth.mesh_world.transformed(rigid(np.eye(3), 0.002 * T_WORLD_OBJECT[:3, 2]))
    moved = face_bias(higher, truth, surface)
    assert moved.up == pytest.approx(0.002, abs=1e-5)
    assert moved.side == pytest.approx(0, abs=1e-5)
    assert moved.down == pytest.approx(-0.002, abs=1e-5)
    unseen = replace(surface, measured=surface.normals_world @ T_WORLD_OBJECT[:3, 2] > 0.7)
    seen = face_bias(higher, truth, unseen)
    assert seen == FaceBias(seen.up, None, None) and seen.up == pytest.approx(0.002, abs=1e-5)
    # Where the built surface is far away, it is not biased but missing.
    far = truth.mesh_world.transformed(rigid(np.eye(3), [5.0, 0, 0]))
    assert face_bias(far, truth, surface) == FaceBias(None, None, None)


def test_edges_of_a_cube() -> None:
    points = edge_points(box_mesh(CUBE))
    low, high = np.array([-0.1, -0.1, 0]), np.array([0.1, 0.1, 0.2])
    # Twelve edges, of 51 points each; no diagonal of a face.
    assert len(points) == 12 * 51
    on_faces = (np.isclose(points, low) | np.isclose(points, high)).sum(axis=1)
    assert on_faces.min() == 2


def test_the_scene_at_the_object(truth: Truth) -> None:
    T = truth.T_world_object
    # The floor and a thing 0.4 m beside the chair count for nothing.
    floor = box_mesh(OrientedBox((0, 0, 0.0), (3, 3, 0.01))).transformed(T)
    beside = box_mesh(OrientedBox((0.7, 0, 0.3), (0.2, 0.2, 0.6))).transformed(T)
    errors = errors_at_object(join([truth.mesh_world, floor, beside]), truth)
    assert errors is not None
    figures = surface_figures(errors)
    assert [score.f for score in figures.visible.scores] == [1, 1]
    # A sheet under the seat, 50 mm from everything, of both sides: so much less precision.
    sheet = box_mesh(OrientedBox((0, 0, 0.3), (0.15, 0.15, 1e-6)))
    wrong_m2 = 2 * 0.15**2
    errors = errors_at_object(join([truth.mesh_world, sheet.transformed(T)]), truth)
    assert errors is not None
    # Without the four feet: of each the sole and 15 mm of its sides.
    right_m2 = chair().surface_area() - 4 * (0.045**2 + 4 * 0.045 * 0.015)
    precision = surface_figures(errors).whole.scores[0].precision
    assert precision == pytest.approx(right_m2 / (right_m2 + wrong_m2), abs=0.01)
    assert errors_at_object(TriangleMesh(floor.vertices, floor.faces), truth) is None


@pytest.mark.parametrize(("high_m", "judged"), [(0.012, False), (0.02, True)])
def test_an_object_that_ends_within_the_floors_margin_has_no_figures_there(
    truth: Truth, high_m: float, judged: bool
) -> None:
    """A plate; of no true surface at all, shares and means would be NaN."""
    plate, built = (box_mesh(OrientedBox((0.0, 0.0, z / 2), (0.3, 0.2, z))) for z in (high_m, high_m + 0.006))
    points, normals = sample_surface(plate.vertices, plate.faces, 5000, np.random.default_rng(0))
    surface = SurfaceTruth(points, normals, np.ones(5000, np.uint16))
    flat = replace(truth, mesh_world=plate, T_world_object=np.eye(4), surface=surface)
    errors = errors_at_object(built, flat)
    assert (errors is not None) == judged


class _Interval(QualityFile):
    """quality.json that says between what the IoU lies."""

    estimated_iou_low: float | None = None
    estimated_iou_high: float | None = None


@pytest.mark.parametrize(("low", "high", "inside"), [(0.8, 1.0, True), (0.8, 0.9, False)])
def test_the_estimate_and_its_interval(truth: Truth, low: float, high: float, inside: bool) -> None:
    known = known_build(truth)
    assert known.build.model
    box = known.build.model.quality.box
    quality = _Interval(
        box=box, surface_sigma_m=0.0, estimated_iou=0.93, estimated_iou_low=low, estimated_iou_high=high
    )
    model = replace(known.build.model, quality=quality)
    figures = solid_figures(model, truth, register_build(known.build, truth), everywhere(truth))
    assert figures.estimated_iou == 0.93
    assert (figures.estimated_iou_low, figures.estimated_iou_high) == (low, high)
    assert figures.iou_in_interval is inside  # the IoU is 1


def test_a_build_in_another_world(truth: Truth) -> None:
    T = rigid(T_WORLD_OBJECT[:3, :3].T, [1.0, -2.0, 0.5])
    known = known_build(truth, unknown_above_m=0.4, T_built_truth=T)
    assert known.build.model
    registration = register_build(known.build, truth)
    figures = solid_figures(known.build.model, truth, registration, everywhere(truth))
    assert figures.known_gross_share == 0
    # Of the shell around the surface, in and out, what lies above.
    near = figures.unknown_near_measured
    assert near.solid is not None and 0.4 < near.solid < 0.8
    assert near.air is not None and 0.4 < near.air < 0.8
    assert figures.calibration_error == pytest.approx(0, abs=1e-3)


def _block(box: OrientedBox) -> manifold3d.Manifold:
    return manifold3d.Manifold.cube(box.size_m, center=True).translate(box.center_m)


def test_what_no_camera_could_tell_is_solid_in_the_truth_too(perfect: Known) -> None:
    """A shell of 14 mm upside down, 18 mm above the floor, called a solid: right by definition."""
    outer = OrientedBox((0.0, 0.0, 0.118), (0.2, 0.2, 0.2))
    inner = OrientedBox((0.0, 0.0, 0.1), (0.172, 0.172, 0.208))  # open below
    shell = mesh_of(_block(outer) - _block(inner))
    truth = replace(perfect.truth, mesh_world=shell, T_world_object=np.eye(4))
    grid = Grid((64, 64, 64), VOXEL_M, rigid(np.eye(3), [-0.16, -0.16, 0.0]))
    points = transform_points(grid.T_world_grid, (np.moveaxis(np.indices(grid.shape), 0, -1) + 0.5) * VOXEL_M)
    solid = outer.contains(points)
    labels = np.where(solid, Label.INTERIOR, Label.FREE).astype(np.uint8)
    assert perfect.build.model
    shape = SolidShape(grid, solid, box_mesh(outer), labels, solid.astype(np.float32), np.zeros_like(solid))
    model = replace(perfect.build.model, shape=shape)
    figures = solid_figures(model, truth, HERE, everywhere(truth))
    assert figures.closed_by_definition_share > 1 and figures.line_width_m == 0.02
    assert figures.known_gross_share < 0.003 < 0.5 < figures.exact_known_gross_share
    assert figures.fine.iou > 0.97 and figures.exact_fine.iou < 0.6


def test_distances_from_what_is_solid_by_definition_are_counted(perfect: Known) -> None:
    """Beside it to half a voxel, elsewhere exactly."""
    exact, solid = np.zeros((2, 40, 8, 8), bool)
    exact[4:8], solid[4:20] = True, True  # a wall with a closed space behind it
    exact_m = np.full(exact.shape, np.inf, np.float32)
    exact_m[:4] = ((4 - np.arange(4)) * 0.01 - 0.005)[:, None, None]
    found = seeable_distance_m(TrueCells(exact, solid, np.ones_like(solid)), exact_m, 0.01)
    np.testing.assert_allclose(found[:, 4, 4][8:20], [np.inf] * 9 + [0.025, 0.015, 0.005], atol=1e-6)
    np.testing.assert_allclose(found[:, 4, 4][20:24], [0.005, 0.015, 0.025, np.inf], atol=1e-6)
    np.testing.assert_allclose(found[0:4, 4, 4], exact_m[0:4, 4, 4])
