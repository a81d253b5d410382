"""Containers: watertight, standing, truly hollow, open at the top, nowhere thin, of true size, and varied."""

import functools

import numpy as np
import open3d as o3d
import pytest
import trimesh
from kinectbench_plugins.families import vessels
from numpy.typing import NDArray
from object_checks import check_solid, checked
from open3d.pybind.t.geometry import RaycastingScene
from trimesh.caching import TrackedArray

from kinectbench.core.geometry.mesh import join
from kinectbench.lab.simulate.objects import make_object, shapes
from kinectbench.lab.simulate.objects.shapes import Subject

SEEDS = range(10)
# Width, depth and height, metres, least and most; and volume of the solid in litres, least and most.
BOUNDS = {
    "bin": ((0.24, 0.16, 0.29), (0.55, 0.60, 1.20), (2.0, 25.0)),
    "bucket": ((0.24, 0.24, 0.19), (0.50, 0.60, 0.75), (2.0, 12.0)),
    "basket": ((0.33, 0.21, 0.21), (0.80, 0.70, 0.75), (2.0, 30.0)),
    "pot": ((0.24, 0.17, 0.10), (0.70, 0.50, 0.56), (1.5, 20.0)),
    "open_box": ((0.25, 0.15, 0.13), (1.05, 1.00, 0.70), (1.5, 25.0)),
    "drawer": ((0.33, 0.35, 0.09), (0.90, 0.65, 0.28), (2.0, 20.0)),
    "sink": ((0.37, 0.38, 0.75), (1.20, 0.85, 1.30), (10.0, 350.0)),
}
CONTAINERS = tuple(BOUNDS)
LEAST_M = 0.012


@functools.cache
def container(family: str, seed: int) -> Subject:
    return make_object(family, seed)


def scene(subject: Subject) -> RaycastingScene:
    found = o3d.t.geometry.RaycastingScene()
    found.add_triangles(
        o3d.core.Tensor.from_numpy(subject.mesh.vertices.astype(np.float32)),
        o3d.core.Tensor.from_numpy(subject.mesh.faces.astype(np.uint32)),
    )
    return found


def cast(
    subject: Subject, origins: NDArray[np.float64] | TrackedArray, directions: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Distance (n,) along rays to the solid's surface, infinite where they leave, and its normals (n, 3)."""
    rays = np.concatenate([origins, np.broadcast_to(directions, origins.shape)], axis=1)
    met = scene(subject).cast_rays(o3d.core.Tensor.from_numpy(rays.astype(np.float32)))
    return met["t_hit"].numpy(), met["primitive_normals"].numpy()


def floor_seen(subject: Subject) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Heights that rays straight down over the object's middle half meet, and where they start."""
    low, high = subject.mesh.vertices.min(axis=0), subject.mesh.vertices.max(axis=0)
    side = np.linspace(0.25, 0.75, 21)
    x, y = np.meshgrid(low[0] + side * (high - low)[0], low[1] + side * (high - low)[1])
    start = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, high[2] + 0.1)])
    return high[2] + 0.1 - cast(subject, start, np.array([0.0, 0.0, -1.0]))[0], start


@pytest.mark.parametrize("family", CONTAINERS)
@pytest.mark.parametrize("seed", SEEDS)
def test_a_container_is_one_watertight_solid_of_true_size(family: str, seed: int) -> None:
    subject = container(family, seed)
    check_solid(subject, *BOUNDS[family])
    mesh = checked(subject)
    # Its hull would hold much more: it is hollow. A cabinet under a sink is closed, and solid.
    assert mesh.volume < (0.9 if family == "sink" else 0.6) * mesh.convex_hull.volume


@pytest.mark.parametrize("family", CONTAINERS)
@pytest.mark.parametrize("seed", SEEDS)
def test_its_cavity_is_open_and_deep(family: str, seed: int) -> None:
    subject = container(family, seed)
    seen_m, start = floor_seen(subject)
    heights_m, counts = np.unique(seen_m.round(3), return_counts=True)
    floor_m = float(heights_m[np.argmax(counts)])
    on_floor = np.abs(seen_m - floor_m) < 0.002
    assert on_floor.mean() > (0.25 if family == "sink" else 0.4)
    assert rim_m(subject) - floor_m > CAVITY_M[family]
    # A point over the floor is air by winding, and nothing is between it and the sky.
    inside = start[on_floor] * [1, 1, 0] + [0, 0, floor_m + 0.01]
    assert (
        not scene(subject)
        .compute_occupancy(o3d.core.Tensor.from_numpy(inside.astype(np.float32)), nsamples=3)
        .numpy()
        .any()
    )
    assert np.isinf(cast(subject, inside, np.array([0.0, 0.0, 1.0]))[0]).all()
    # Level rays from there meet walls, but for slots.
    turn = np.arange(64) * np.pi / 32
    around = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(64)])
    middle = np.tile(inside[len(inside) // 2], (64, 1))
    assert np.isfinite(cast(subject, middle, around)[0]).mean() > 0.7


def rim_m(subject: Subject) -> float:
    """Height of the top of the walls."""
    walls = next(piece.mesh for piece in subject.pieces if piece.name in ("body", "side"))
    return float(walls.vertices[:, 2].max())


# Least depth of the cavity below the rim, metres.
CAVITY_M = {
    "bin": 0.25,
    "bucket": 0.15,
    "basket": 0.17,
    "pot": 0.09,
    "open_box": 0.11,
    "drawer": 0.06,
    "sink": 0.08,
}


@pytest.mark.parametrize("family", CONTAINERS)
@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_is_thin(family: str, seed: int) -> None:
    subject = container(family, seed)
    points, faces = trimesh.sample.sample_surface(checked(subject), 6000, seed=1)
    normals = checked(subject).face_normals[faces]
    thick_m, behind = cast(subject, points - 1e-5 * normals, -normals)
    # A wall has two faces that look in nearly opposite directions; at an edge they do not.
    wall = (normals * behind).sum(axis=1) < -0.9
    assert wall.mean() > 0.4
    assert (thick_m[wall] < LEAST_M).mean() < 0.001, np.sort(thick_m[wall])[:20]
    # A cabinet under a sink is solid; of all others a large part is wall.
    assert family == "sink" or (thick_m[wall] < 0.021).mean() > 0.3


@pytest.mark.parametrize("family", CONTAINERS)
def test_rays_meet_the_pieces_where_they_meet_the_solid(family: str) -> None:
    # Pictures are drawn of the pieces, and the truth is the solid: they agree, inside the cavity too.
    subject = container(family, 3)
    pieces = Subject("pieces", (), join([piece.mesh for piece in subject.pieces]), "")
    rng = np.random.default_rng(0)
    low, high = subject.mesh.vertices.min(axis=0), subject.mesh.vertices.max(axis=0)
    aim, start = rng.uniform(low, high, (600, 3)), rng.normal(size=(600, 3))
    start[:, 2] = np.abs(start[:, 2]) + 0.3
    start *= 3 / np.linalg.norm(start, axis=1, keepdims=True)
    found_m = [cast(one, start, aim - start)[0] for one in (pieces, subject)]
    assert np.isfinite(found_m[0]).sum() > 200
    assert np.allclose(found_m[0], found_m[1], atol=1e-5)


@pytest.mark.parametrize("family", CONTAINERS)
def test_containers_vary_and_the_same_seed_gives_the_same(family: str) -> None:
    subjects = [container(family, seed) for seed in SEEDS]
    assert len({round(checked(subject).volume, 6) for subject in subjects}) == len(subjects)
    assert len({len(subject.mesh.faces) for subject in subjects}) >= 7
    assert len({tuple(sorted({piece.name for piece in subject.pieces})) for subject in subjects}) >= 3
    heights = [subject.mesh.vertices[:, 2].max() for subject in subjects]
    assert max(heights) > 1.2 * min(heights)
    albedo = np.array([piece.albedo for subject in subjects for piece in subject.pieces])
    assert np.mean((albedo >= 0.4) & (albedo <= 0.8)) > 0.75
    again = make_object(family, 4)
    assert np.array_equal(again.mesh.vertices, container(family, 4).mesh.vertices)
    assert np.array_equal(again.mesh.faces, container(family, 4).mesh.faces)


def test_a_grown_outline_lies_around_by_the_same_distance() -> None:
    square = vessels.grown(shapes.rectangle((0.4, 0.2)), 0.015)
    assert np.allclose(np.ptp(square, axis=0), (0.43, 0.23))
    # Sides of a polygon inscribed in a circle of radius r lie r cos(half its angle) from the middle.
    circle = vessels.grown(shapes.ellipse((0.3, 0.3)), 0.015)
    assert np.allclose(np.linalg.norm(circle, axis=1) * np.cos(np.pi / 48), 0.15 * np.cos(np.pi / 48) + 0.015)


def test_the_walls_of_a_vessel_have_their_thickness_and_its_cavity_its_volume() -> None:
    low, high = shapes.rectangle((0.2, 0.1)), shapes.rectangle((0.3, 0.2))
    tub = vessels.Vessel(low, high, base_m=0.0, floor_m=0.02, top_m=0.32, wall_m=0.015)
    assert np.allclose(np.ptp(tub.inner(0.17), axis=0), (0.25, 0.15))
    # A prismatoid: h / 6 (A1 + 4 Am + A2); above the rim the cut goes on for 5 cm.
    within = vessels.tub(low, high, 0.02, 0.32)
    assert within.volume() == pytest.approx(0.3 / 6 * (0.02 + 4 * 0.0375 + 0.06))
    filled = vessels.tub(tub.outer(0.0), tub.outer(0.32), 0.0, 0.32)
    assert tub.body().volume() == pytest.approx(filled.volume() - within.volume())
    # Faces lean by 5 cm in 30: the level distance is 15 mm / cos(lean), or a little more.
    assert tub.reach_m(0.17) - 0.125 >= 0.015 * np.hypot(1, 0.05 / 0.3)
    assert tub.reach_m(0.17) - 0.125 < 0.0156


def test_rims_hoops_and_handles_keep_out_of_the_cavity() -> None:
    ring = shapes.ellipse((0.3, 0.3))
    tub = vessels.Vessel(ring, 1.2 * ring, base_m=0.0, floor_m=0.02, top_m=0.3, wall_m=0.015)
    handle = vessels.loop_handle(tub, 0.25, 0.1, 0.05, 0.008)
    assert handle.bounding_box()[3] == pytest.approx(tub.reach_m(0.25) + 0.05 + 0.008, abs=1e-3)
    parts = [handle, tub.band(0.1, 0.12, 0.01), vessels.grip_handle(tub, 0.1, 0.06, 0.008)]
    below_rim = vessels.tub(tub.low, tub.high, tub.floor_m, tub.top_m)
    for shape in parts:
        assert (shape ^ below_rim).volume() < 1e-12
        assert (shape ^ tub.body()).volume() > 1e-6
    # A hole in the wall at +x opens it from inside to outside, and leaves the wall at -x alone.
    hole = vessels.slot(tub, (0.0, 0.2), 0.1, 0.03)
    cut = (tub.body() - hole).genus()
    assert (tub.body().genus(), cut) == (0, 1)
