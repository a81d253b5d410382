"""Solids from analytic observations: what the cameras cannot have seen is unseen."""

import numpy as np
import pytest
import trimesh
from object_checks import closed
from observed_boxes import (
    CUT_LAYERS,
    FLOOR_LAYERS,
    GRID,
    LAYERS,
    SHAPE,
    T_WORLD_GRID,
    TRUNCATION_M,
    VOXEL_M,
    box_distance,
    centers,
    observation,
)
from raising import raises

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.errors import ShapeError
from kinectbench.core.voxels.observation import Observation
from kinectbench.stages.segment.judge.quality import surface_sigma_m
from kinectbench.stages.segment.solid.evidence import (
    FloorLayers,
    Rules,
    _signed_distance_m,
    classify_voxels,
)
from kinectbench.stages.segment.solid.solid import SolidShape, make_solid, solidify

# From 10 mm on what goes on above the cut is the object's.
LOW_LAYERS = FloorLayers(FLOOR_LAYERS, CUT_LAYERS - 2, 2)


def solid_of(
    observed: Observation, excluded: np.ndarray | None = None, layers: FloorLayers = LAYERS
) -> SolidShape:
    none = np.zeros(SHAPE, bool)
    shape = shape_of(observed, none, Rules(layers), excluded)
    check_invariants(shape, observed, none if excluded is None else excluded)
    alone = solidify(observed, none, Rules(layers), excluded)
    assert np.array_equal(alone.solid, shape.solid)
    assert np.array_equal(alone.mesh.vertices, shape.mesh.vertices)
    return shape


def shape_of(
    observed: Observation, neighbours: np.ndarray, rules: Rules, beyond: np.ndarray | None = None
) -> SolidShape:
    """The labelled solid of the rough evidence by which the halves are compared."""
    return make_solid(observed, classify_voxels(observed, neighbours, rules, beyond, roughly=True), rules)


def check_invariants(shape: SolidShape, observed: Observation, excluded: np.ndarray) -> None:
    labels, solid = shape.labels, shape.solid
    assert labels.dtype == np.uint8 and labels.shape == solid.shape == shape.probability.shape == SHAPE
    assert np.isin(labels, list(Label)).all()
    assert not solid[np.isin(labels, [Label.FREE, Label.OTHER])].any()
    assert solid[np.isin(labels, [Label.SURFACE, Label.INTERIOR])].all()
    assert not solid[excluded].any() and not solid[:, :, :FLOOR_LAYERS].any()
    assert (labels[:, :, :FLOOR_LAYERS] == Label.OTHER).all()
    assert ((shape.probability > 0.5) == solid).all()
    assert shape.probability.min() >= 0 and shape.probability.max() <= 1
    mesh = closed(shape.mesh)
    assert mesh.volume == pytest.approx(solid.sum() * VOXEL_M**3, rel=0.06)


def assert_is(shape: SolidShape, distance_m: np.ndarray) -> None:
    """The solid is where the distance is negative, above the floor; smoothing may round edges by a voxel."""
    truth = (distance_m < 0) & (centers()[..., 2] > 0)
    wrong = shape.solid != truth
    assert not wrong[np.abs(distance_m) > VOXEL_M].any()
    assert wrong.sum() < 0.02 * truth.sum()


BOX = ((0.06, 0.05, 0.0), (0.26, 0.19, 0.3))


def test_a_box_seen_from_outside_is_filled() -> None:
    distance_m = box_distance(*BOX)
    shape = solid_of(observation(distance_m))
    assert_is(shape, distance_m)
    deep = distance_m < -TRUNCATION_M - VOXEL_M
    deep &= centers()[..., 2] > CUT_LAYERS * VOXEL_M
    assert (shape.labels[deep] == Label.INTERIOR).mean() > 0.98  # no camera could see it
    near = (np.abs(distance_m) < VOXEL_M) & shape.solid & (centers()[..., 2] > 0.03)
    assert near.sum() > 5000 and (shape.labels[near] == Label.SURFACE).all()
    high = centers()[..., 2] > VOXEL_M
    assert (shape.labels[(distance_m > VOXEL_M) & high] == Label.FREE).all()


def test_a_void_that_nobody_can_have_looked_into_is_filled_but_not_known() -> None:
    distance_m = box_distance(*BOX)
    seen = observation(distance_m)
    pocket = box_distance((0.12, 0.1, 0.14), (0.2, 0.14, 0.18)) < 0
    seen.free[pocket] = 20
    shape = solid_of(seen)
    assert shape.solid[pocket].all() and (shape.labels[pocket] == Label.UNKNOWN).mean() > 0.9
    assert_is(shape, distance_m)
    pieces = trimesh.Trimesh(shape.mesh.vertices, shape.mesh.faces, process=False).split()
    assert len(pieces) == 1
    assert not solid_of(seen, excluded=pocket).solid[pocket].any()


@pytest.mark.parametrize(("frames", "carved"), [(2, False), (15, True)])
def test_a_few_frames_see_through_the_last_millimetres_of_a_board(frames: int, carved: bool) -> None:
    """Of 200 frames two do so by their noise, all along an underside that no other frame saw."""
    within_m = box_distance((0.06, 0.05, 0.0), (0.26, 0.19, 0.3))
    height_m = centers()[..., 2]
    hidden = (within_m < -2 * VOXEL_M) & (height_m > 0.09) & (height_m < 0.13)
    seen = observation(box_distance((0.06, 0.05, 0.1), (0.26, 0.19, 0.15)), hidden)
    seen.free[:], seen.surface[:] = 10 * seen.free, 10 * seen.surface
    last = hidden & (height_m > 0.1) & (height_m < 0.115)
    seen.free[last], seen.free[hidden & (height_m < 0.1)] = frames, 60
    solid = solid_of(seen).solid[last]
    assert solid.mean() < 0.05 if carved else solid.all()


def test_mesh_volume_and_place() -> None:
    """Smooth where measured: the volume within 2 %, vertices on the box but at its rounded edges."""
    shape = solid_of(observation(box_distance(*BOX)))
    mesh = trimesh.Trimesh(shape.mesh.vertices, shape.mesh.faces, process=False)
    assert mesh.volume == pytest.approx(0.2 * 0.14 * 0.3, rel=0.02)
    local = shape.mesh.vertices @ np.linalg.inv(T_WORLD_GRID)[:3, :3].T + np.linalg.inv(T_WORLD_GRID)[:3, 3]
    local -= [0, 0, FLOOR_LAYERS * VOXEL_M]
    low, high = local.min(axis=0), local.max(axis=0)
    np.testing.assert_allclose(low[:2], BOX[0][:2], atol=0.0005)
    np.testing.assert_allclose(high, BOX[1], atol=0.0005)
    assert abs(low[2]) < 0.001  # it stands on the floor


def test_a_sphere_is_filled() -> None:
    """Held up in the air, seen from all around."""
    distance_m = np.linalg.norm(centers() - [0.16, 0.12, 0.2], axis=-1) - 0.1
    shape = solid_of(observation(distance_m))
    assert_is(shape, distance_m)
    mesh = trimesh.Trimesh(shape.mesh.vertices, shape.mesh.faces, process=False)
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 0.1**3, rel=0.02)
    error_mm = 1000 * (np.linalg.norm(_local(shape) - [0.16, 0.12, 0.2], axis=1) - 0.1)
    # Smoothing by a Gaussian of one voxel draws a sphere in by voxel^2 / radius, 0.25 mm here.
    assert abs(error_mm.mean()) < 0.4 and error_mm.std() < 0.3


def _local(shape: SolidShape) -> np.ndarray:
    T = np.linalg.inv(T_WORLD_GRID)
    local: np.ndarray = shape.mesh.vertices @ T[:3, :3].T + T[:3, 3] - [0, 0, FLOOR_LAYERS * VOXEL_M]
    return local


def test_a_bottom_that_no_camera_saw() -> None:
    """A box whose lower side is hidden, in the air: filled down to about its bottom, not to the floor."""
    low, high = (0.06, 0.05, 0.12), (0.26, 0.19, 0.3)
    distance_m = box_distance(low, high)
    p = centers()
    hidden = (
        (p[..., 2] < 0.12)
        & (p[..., 2] > 0.07)
        & np.all((p[..., :2] > np.array(low[:2]) + 0.02) & (p[..., :2] < np.array(high[:2]) - 0.02), axis=-1)
    )
    hidden |= (distance_m < 0) & (p[..., 2] < 0.14) & (distance_m < -VOXEL_M) & hidden[:, :, [20]]
    shape = solid_of(observation(distance_m, hidden))
    truth = distance_m < 0
    iou = (shape.solid & truth).sum() / (shape.solid | truth).sum()
    assert iou > 0.85
    wrong = (shape.solid != truth) & (np.abs(distance_m) > VOXEL_M)
    assert not (wrong & (shape.labels != Label.UNKNOWN) & (shape.labels != Label.INTERIOR)).any()


def test_legs_grow_back_to_the_floor() -> None:
    """A table: near the floor its legs cannot be told from the floor."""
    top = box_distance((0.04, 0.03, 0.25), (0.28, 0.21, 0.3))
    legs = [box_distance((x, y, 0.0), (x + 0.03, y + 0.03, 0.26)) for x in (0.05, 0.24) for y in (0.04, 0.17)]
    distance_m = np.minimum.reduce([top, *legs])
    shape = solid_of(observation(distance_m))
    truth = (distance_m < 0) & (centers()[..., 2] > 0)
    contact = slice(FLOOR_LAYERS, FLOOR_LAYERS + CUT_LAYERS)
    feet = truth & (distance_m < -0.6 * VOXEL_M) & (centers()[..., 2] < CUT_LAYERS * VOXEL_M)
    assert (
        feet.sum() > 4 * 9 * CUT_LAYERS and shape.solid[feet].all()
    )  # also the layer that touches the floor
    assert np.isin(shape.labels[feet], [Label.SURFACE, Label.INTERIOR]).all()
    assert not shape.solid[:, :, contact][distance_m[:, :, contact] > VOXEL_M].any()
    # Smoothing rounds the edges of legs of 30 mm.
    assert (shape.solid != truth).sum() < 0.06 * truth.sum()
    assert not (shape.solid != truth)[np.abs(distance_m) > 1.5 * VOXEL_M].any()
    assert not shape.solid[30:34, 20:28, FLOOR_LAYERS:50].any()  # the air between the legs


COLUMN = ((0.14, 0.10, 0.0), (0.18, 0.14, 0.3))
DISC = ((0.06, 0.04, 0.0), (0.26, 0.20, 0.016))
BUMP = ((0.02, 0.02, 0.0), (0.05, 0.22, 0.016))


def test_a_low_disc_belongs_to_its_column() -> None:
    """A foot of 16 mm lies below the floor cut of 20 mm: it is kept, because the column stands on it."""
    distance_m = np.minimum(box_distance(*COLUMN), box_distance(*DISC))
    disc = (box_distance(*DISC) < -0.6 * VOXEL_M) & (centers()[..., 2] > 0)
    seen = observation(distance_m)
    shape = solid_of(seen, layers=LOW_LAYERS)
    assert shape.solid[disc].all() and np.isin(shape.labels[disc], [Label.SURFACE, Label.INTERIOR]).all()
    assert not shape.solid[distance_m > 1.5 * VOXEL_M].any()
    cut_off = solid_of(seen).solid
    assert cut_off[disc].mean() < 0.2


def test_a_bump_of_the_floor_is_floor() -> None:
    """It is as high as the disc beside it, but nothing stands on it."""
    distance_m = np.minimum.reduce([box_distance(*COLUMN), box_distance(*BUMP)])
    shape = solid_of(observation(distance_m), layers=LOW_LAYERS)
    bump = (box_distance(*BUMP) < 0) & (centers()[..., 2] > 0)
    assert not shape.solid[bump].any() and (shape.labels[bump] != Label.SURFACE).all()
    assert shape.solid[(box_distance(*COLUMN) < -VOXEL_M) & (centers()[..., 2] > 0)].all()


def test_what_side_panels_enclose_under_a_shelf_is_not_solid() -> None:
    """Open in front and behind; no camera looked up under the shelf."""
    shelf = box_distance((0.03, 0.04, 0.2), (0.29, 0.20, 0.22))
    panels = [box_distance((x, 0.04, 0.0), (x + 0.02, 0.20, 0.3)) for x in (0.03, 0.27)]
    distance_m = np.minimum.reduce([shelf, *panels])
    p = centers()
    wedge = (p[..., 2] < 0.2) & (p[..., 2] > 0.2 - (0.06 - np.abs(p[..., 1] - 0.12)))
    wedge &= (p[..., 0] > 0.05) & (p[..., 0] < 0.27)
    shape = solid_of(observation(distance_m, hidden=wedge & (distance_m > 0)))
    inner = wedge & (distance_m > 1.5 * VOXEL_M)
    assert inner.sum() > 2000 and not shape.solid[inner].any()
    # No frame saw through it: however probably it is air, that is a guess.
    assert (shape.labels[inner] == Label.UNKNOWN).mean() > 0.9
    assert shape.probability[inner].mean() < 0.2


def test_specks_are_dropped() -> None:
    speck = box_distance((0.02, 0.02, 0.35), (0.03, 0.03, 0.36))
    distance_m = np.minimum(box_distance(*BOX), speck)
    shape = solid_of(observation(distance_m))
    assert not shape.solid[speck < 0].any()
    assert (shape.labels[speck < 0] == Label.UNKNOWN).all()  # measured, and in no solid
    assert_is(shape, box_distance(*BOX))


def test_neighbours_are_left_out() -> None:
    other = ((0.28, 0.05, 0.0), (0.31, 0.19, 0.2))
    distance_m = np.minimum(box_distance(*BOX), box_distance(*other))
    excluded = box_distance(*other) < 0.008
    shape = solid_of(observation(distance_m), excluded)
    assert_is(shape, box_distance(*BOX))
    assert (shape.labels[excluded] == Label.OTHER).all()


def test_a_neighbour_that_touches_is_cut_off() -> None:
    """Smoothing must not carry the object into what was excluded."""
    other = ((0.26, 0.05, 0.0), (0.31, 0.19, 0.2))
    distance_m = np.minimum(box_distance(*BOX), box_distance(*other))
    excluded = centers()[..., 0] > 0.26
    solid_of(observation(distance_m), excluded)
    corner = excluded & (centers()[..., 2] > 0.1)  # an excluded region with a concave edge
    solid_of(observation(distance_m), corner)


def test_what_is_left_out_and_was_not_seen_is_air() -> None:
    """Beside a person's box nothing is said of what no frame saw but that it is not the object's."""
    excluded = box_distance((0.0, 0.0, 0.0), (0.3, 0.03, 0.3)) < 0
    body_m = box_distance((0.06, 0.05, -1.0), (0.26, 0.19, 0.3))
    observed = observation(body_m, hidden=excluded)
    shape = shape_of(observed, np.zeros(SHAPE, bool), Rules(LAYERS), excluded)
    assert shape.probability[excluded].max() <= 0.05 and not shape.solid[excluded].any()


def test_unmeasured_parts_of_the_object_near_a_neighbour_are_kept() -> None:
    """Of a couch whose underside nobody saw, near what lies below it: the neighbour has measured voxels."""
    body_m = box_distance(*BOX)
    near = body_m < -0.02  # deep inside the object, where nothing was measured
    shape = shape_of(observation(body_m), near, Rules(LAYERS))
    alone = shape_of(observation(body_m), np.zeros(SHAPE, bool), Rules(LAYERS))
    assert near.sum() > 100 and np.array_equal(shape.solid, alone.solid)
    assert np.array_equal(shape.labels, alone.labels)
    # What was measured beside a neighbour is the neighbour's.
    half = np.zeros(SHAPE, bool)
    half[: SHAPE[0] // 2] = True
    cut, measured = shape_of(observation(body_m), half, Rules(LAYERS)), alone.labels == Label.SURFACE
    assert (alone.solid & measured & half).any() and not (cut.solid & measured & half).any()


def test_never_seen_is_unknown() -> None:
    """Only the upper half of the grid was ever in a frustum."""
    distance_m = box_distance(*BOX)
    shape = solid_of(observation(distance_m, hidden=centers()[..., 2] < 0.15))
    outside = (distance_m > 0.02) & (centers()[..., 2] < 0.1) & (centers()[..., 2] > 0)
    assert (shape.labels[outside] == Label.UNKNOWN).all()
    assert shape.solid[distance_m < -0.005][centers()[distance_m < -0.005][:, 2] > 0.16].all()


def test_seen_through_beats_a_wrong_surface() -> None:
    """A surface that two frames measured and twenty saw through is no surface."""
    seen = observation(box_distance(*BOX))
    ghost = box_distance((0.1, 0.1, 0.33), (0.2, 0.14, 0.35)) < 0
    seen.tsdf[ghost], seen.surface[ghost], seen.free[ghost] = -0.002, 2, 20
    shape = solid_of(seen)
    assert not shape.solid[ghost].any()
    assert (shape.labels[ghost] == Label.FREE).all()


def test_nothing_at_all() -> None:
    none = observation(np.full(SHAPE, 1.0), floor=False)
    with raises(ShapeError, "shape.no-solid", match="no solid shape"):
        solidify(none, np.zeros(SHAPE, bool), Rules(LAYERS))
    whole = observation(box_distance(*BOX))
    with raises(ShapeError, "shape.no-solid", match="no solid shape"):
        solidify(whole, np.ones(SHAPE, bool), Rules(LAYERS))


@pytest.mark.parametrize("sigma_m", [0.0005, 0.002])
def test_sigma_of_the_surface_from_noisy_halves(sigma_m: float) -> None:
    """Halves with independent errors s: their mean has s / sqrt(2)."""
    rng = np.random.default_rng(0)
    halves = []
    for _ in range(2):
        half = observation(box_distance(*BOX))
        half.tsdf[half.weight > 0] += rng.normal(0, sigma_m, int((half.weight > 0).sum())).astype(np.float32)
        halves.append(half)
    assert surface_sigma_m(*halves) == pytest.approx(sigma_m / np.sqrt(2), rel=0.05)


def test_sigma_without_a_common_surface() -> None:
    one = observation(box_distance(*BOX))
    blind = Observation(GRID, one.tsdf * 0, one.weight * 0, one.free * 0, one.surface * 0)
    assert surface_sigma_m(one, blind) == VOXEL_M


@pytest.mark.parametrize(("ray_width_voxels", "trust"), [(0.5, 1.0), (1.0, 0.45), (1.2, 0.225), (2.0, 0.0)])
def test_frames_that_saw_through_move_the_surface(ray_width_voxels: float, trust: float) -> None:
    every = np.full(SHAPE, 1.0, np.float32)
    # Of 100 frames 30 see through: 15 more than may.
    free = np.full(SHAPE, 30, np.uint16)
    seen = Observation(GRID, -np.float32(1.5 * VOXEL_M) * every, every, free=free, surface=100 - free)
    moved_m = _signed_distance_m(seen, ray_width_voxels * VOXEL_M)
    expected_voxels = -1.5 + 40 * trust * (0.30 - 0.15)
    np.testing.assert_allclose(moved_m, expected_voxels * VOXEL_M, rtol=1e-4)
