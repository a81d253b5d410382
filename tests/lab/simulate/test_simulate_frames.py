"""Frames and sheets: watertight, standing, of true size, nowhere thin, with open gaps, and varied."""

import functools

import numpy as np
import open3d as o3d
import pytest
import trimesh
from kinectbench_plugins.families import lamps, lattices
from numpy.typing import NDArray
from object_checks import check_solid
from trimesh.base import Trimesh
from trimesh.caching import TrackedArray

from kinectbench.core.geometry.mesh import TriangleMesh
from kinectbench.lab.simulate.objects import make_object, shapes
from kinectbench.lab.simulate.objects.shapes import Subject

SEEDS = range(10)
# Width, depth and height, metres, least and most; and volume of the solid in litres, least and most.
BOUNDS = {
    "rack": ((0.40, 0.20, 0.25), (1.40, 0.60, 1.70), (2.0, 60.0)),
    "lamp": ((0.18, 0.18, 0.34), (0.75, 0.70, 1.70), (1.0, 20.0)),
    "crate": ((0.28, 0.24, 0.18), (1.25, 0.80, 0.65), (3.0, 45.0)),
    "bookshelf": ((0.38, 0.23, 0.59), (1.15, 0.40, 1.70), (10.0, 150.0)),
    "ladder": ((0.34, 0.33, 0.38), (0.65, 1.40, 1.95), (3.0, 30.0)),
    "wire_basket": ((0.26, 0.26, 0.15), (0.80, 0.50, 0.75), (0.7, 6.0)),
    "tray_stand": ((0.30, 0.30, 0.44), (0.80, 0.65, 0.85), (2.0, 16.0)),
}
# Least share of the front's outline box through which one looks from front to back, in the median object.
OPEN_SHARE = {"rack": 0.4, "crate": 0.12, "ladder": 0.35, "wire_basket": 0.3, "tray_stand": 0.45}
LEAST_M = 0.012


@functools.cache
def subject_of(family: str, seed: int) -> Subject:
    return make_object(family, seed)


@functools.cache
def checked(family: str, seed: int) -> trimesh.Trimesh:
    """The mesh as it is, without merging its vertices."""
    mesh = subject_of(family, seed).mesh
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def cast(
    mesh: Trimesh | TriangleMesh, origins: TrackedArray | NDArray[np.float64], directions: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Distance (n,) along rays to a mesh's surface, infinite where they leave, and its normals (n, 3)."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(np.asarray(mesh.vertices, np.float32)),
        o3d.core.Tensor.from_numpy(np.asarray(mesh.faces, np.uint32)),
    )
    rays = np.concatenate([origins, np.broadcast_to(directions, origins.shape)], axis=1)
    met = scene.cast_rays(o3d.core.Tensor.from_numpy(rays.astype(np.float32)))
    return met["t_hit"].numpy(), met["primitive_normals"].numpy()


def from_front(mesh: Trimesh, count: int = 61) -> NDArray[np.float32]:
    """How deep (n,) level rays from the front, +y, go behind the bounding box's front until they meet it."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    share = (np.arange(count) + 0.5) / count
    x, z = np.meshgrid(low[0] + share * (high - low)[0], low[2] + share * (high - low)[2])
    start = np.column_stack([x.ravel(), np.full(x.size, high[1] + 0.1), z.ravel()])
    return cast(mesh, start, np.array([0.0, -1.0, 0.0]))[0] - 0.1


def named(subject: Subject, name: str) -> list[TriangleMesh]:
    return [piece.mesh for piece in subject.pieces if piece.name == name]


@pytest.mark.parametrize("family", BOUNDS)
@pytest.mark.parametrize("seed", SEEDS)
def test_it_is_one_watertight_solid_of_true_size_that_stands(family: str, seed: int) -> None:
    check_solid(subject_of(family, seed), *BOUNDS[family], steady_m=0.02)


@pytest.mark.parametrize("family", BOUNDS)
@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_is_thin(family: str, seed: int) -> None:
    mesh = checked(family, seed)
    points, faces = trimesh.sample.sample_surface(mesh, 4000, seed=1)
    normals = mesh.face_normals[faces]
    thick_m, behind = cast(mesh, points - 1e-5 * normals, -normals)
    # A board has two faces that look in nearly opposite directions; at an edge they do not.
    board = (normals * behind).sum(axis=1) < -0.9
    assert board.mean() > 0.4
    assert (thick_m[board] < LEAST_M).mean() < 0.001, np.sort(thick_m[board])[:20]


@pytest.mark.parametrize("family", OPEN_SHARE)
def test_one_looks_through_its_gaps(family: str) -> None:
    shares = [float(np.isinf(from_front(checked(family, seed))).mean()) for seed in SEEDS]
    assert min(shares) > 0.08
    assert np.median(shares) > OPEN_SHARE[family], sorted(shares)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_shade_is_a_thin_wall_open_below_and_above(seed: int) -> None:
    subject, mesh = subject_of("lamp", seed), checked("lamp", seed)
    (shade,) = named(subject, "shade")
    low, high = shade.vertices.min(axis=0), shade.vertices.max(axis=0)
    middle = (low + high) / 2
    points, faces = trimesh.sample.sample_surface(trimesh.Trimesh(shade.vertices, shade.faces), 2000, seed=1)
    normals = trimesh.Trimesh(shade.vertices, shade.faces).face_normals[faces]
    thick_m = cast(shade, points - 1e-5 * normals, -normals)[0]
    # Most of its surface is its two faces.
    assert 0.012 < np.quantile(thick_m, 0.02) <= np.median(thick_m) < 0.0165
    # Straight down between the stem and the wall one sees what is below the shade.
    # The inner edge of the upper rim is the narrowest; of a square it is the corner that lies far out.
    rim = np.abs((shade.vertices - middle)[:, :2]).max(axis=1).min()
    turn = np.arange(90) * np.pi / 45 + 0.03
    ring = 0.9 * rim * np.column_stack([np.cos(turn), np.sin(turn)]) + middle[:2]
    start = np.column_stack([ring, np.full(90, high[2] + 0.3)])
    reached_m = high[2] + 0.3 - cast(mesh, start, np.array([0.0, 0.0, -1.0]))[0]
    assert np.mean(reached_m < low[2] - 0.02) > 0.6


def test_shades_have_the_volume_of_their_wall() -> None:
    # Guldin: the profile's area times the way of its centroid, for a polygon of n sides n sin(2 pi / n) r.
    radius, high, wall = 0.15, 0.2, 0.014
    slant = np.hypot(high, 0.06)
    area, middle = slant * wall, radius - 0.03 - wall / 2 * high / slant
    cone = lamps._Shade("cone", 1.0, 1.0 + high, radius, radius - 0.06, wall)
    assert cone.solid().volume() == pytest.approx(48 * np.sin(np.pi / 24) * area * middle, rel=1e-6)
    square = lamps._Shade("square", 1.0, 1.0 + high, radius, radius - 0.06, wall).solid()
    assert square.volume() == pytest.approx(8 * area * middle, rel=1e-6)
    assert square.bounding_box()[3] == pytest.approx(radius)
    assert (cone.solid().genus(), square.genus()) == (1, 1)


def test_the_slats_of_a_crate_fill_a_side_with_even_gaps() -> None:
    size = lattices._Crate(x=0.3, y=0.2, high=0.3, thick=0.015, broad=0.06, gap=0.03)
    # round(0.33 / 0.09) = 4 slats with three gaps of 3 cm between them: each (0.3 - 0.09) / 4 = 5.25 cm.
    assert np.allclose(size.rows(0.3), [(k * 0.0825, k * 0.0825 + 0.0525) for k in range(4)])
    assert len(size.rows(0.1)) == 2


@pytest.mark.parametrize("seed", SEEDS)
def test_a_crate_and_a_wire_basket_are_open_above(seed: int) -> None:
    for family in ("crate", "wire_basket"):
        mesh = checked(family, seed)
        (low, high), share = mesh.bounds, np.linspace(0.3, 0.7, 15)
        x, y = np.meshgrid(low[0] + share * (high - low)[0], low[1] + share * (high - low)[1])
        floor = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.035)])
        free = np.isinf(cast(mesh, floor, np.array([0.0, 0.0, 1.0]))[0])
        # A handle or a divider may cross it.
        assert free.mean() > 0.8


def test_bars_of_a_basket_are_evenly_spaced_and_end_in_its_ring() -> None:
    outline = shapes.ellipse((0.4, 0.4))
    assert lattices._reach(outline, 0, 0.1) == pytest.approx(np.sqrt(0.04 - 0.01), abs=1e-3)
    assert lattices._reach(shapes.rectangle((0.4, 0.2)), 1, 0.15) == pytest.approx(0.1)
    steps = np.linalg.norm(np.diff(lattices._along(outline, 12), axis=0), axis=1)
    assert np.allclose(steps, 0.4 * np.sin(np.pi / 12), rtol=1e-2)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_bookshelf_is_open_to_the_front(seed: int) -> None:
    subject, mesh = subject_of("bookshelf", seed), checked("bookshelf", seed)
    depth = np.ptp(mesh.vertices[:, 1])
    assert np.mean(from_front(mesh) > 0.5 * depth) > 0.25
    sides = named(subject, "side")
    # Its sides are closed: from the left none of it is seen but a side.
    middle = np.array([mesh.bounds[0, 0] - 1.0, 0.0, 0.5 * mesh.bounds[1, 2]])[None]
    first = cast(mesh, middle, np.array([1.0, 0.0, 0.0]))[0] - 1.0
    assert min(side.vertices[:, 0].min() for side in sides) == pytest.approx(
        mesh.bounds[0, 0] + first[0], abs=0.016
    )
    for book in named(subject, "book"):
        assert book.vertices[:, 1].max() < mesh.bounds[1, 1] + 1e-9


def test_some_bookshelves_hold_books_and_some_have_no_back() -> None:
    books = [len(named(subject_of("bookshelf", seed), "book")) for seed in SEEDS]
    assert min(books) == 0
    assert max(books) > 5
    through = [bool(np.isinf(from_front(checked("bookshelf", seed))).mean() > 0.1) for seed in SEEDS]
    assert 0 < sum(through) < len(through)


def test_treads_rise_evenly() -> None:
    counted = 0
    for seed in SEEDS:
        subject = subject_of("ladder", seed)
        steps = named(subject, "tread") + named(subject, "rung")
        if not named(subject, "platform"):
            # A double ladder may have others behind.
            steps = [step for step in steps if step.vertices[:, 1].mean() > 0]
        rises = np.diff(sorted(float(step.vertices[:, 2].max()) for step in steps))
        if len(rises) > 0:
            assert np.allclose(rises, rises[0], atol=1e-9)
            assert 0.2 < rises[0] < 0.32
            counted += 1
    assert counted >= 4


@pytest.mark.parametrize("seed", SEEDS)
def test_a_tray_has_a_rim(seed: int) -> None:
    subject = subject_of("tray_stand", seed)
    (tray,) = named(subject, "tray")
    middle = np.array([[0.0, 0.0, tray.vertices[:, 2].max() + 1.0]])
    depth_m = cast(checked("tray_stand", seed), middle, np.array([0.0, 0.0, -1.0]))[0][0] - 1.0
    assert 0.018 < depth_m < 0.053


@pytest.mark.parametrize("family", BOUNDS)
def test_the_same_seed_gives_the_same_and_others_differ(family: str) -> None:
    volumes = {round(float(checked(family, seed).volume), 9) for seed in SEEDS}
    assert len(volumes) == len(SEEDS)
    assert len({len(subject_of(family, seed).mesh.faces) for seed in SEEDS}) >= 8
    heights = [float(checked(family, seed).bounds[1, 2]) for seed in SEEDS]
    assert max(heights) > 1.3 * min(heights)
    albedo = np.array([p.albedo for seed in SEEDS for p in subject_of(family, seed).pieces])
    assert np.mean((albedo >= 0.4) & (albedo <= 0.8)) > 0.6
    again = make_object(family, 4)
    assert np.array_equal(again.mesh.vertices, subject_of(family, 4).mesh.vertices)
    assert np.array_equal(again.mesh.faces, subject_of(family, 4).mesh.faces)
