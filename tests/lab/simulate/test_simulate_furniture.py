"""Furniture: shapes with known volumes; watertight unions that stand, of true size, and vary."""

import functools
import hashlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from manifold3d import Manifold
from numpy.typing import NDArray
from object_checks import check_closed, closed
from raising import raises
from read_pictures import read_picture
from scipy.spatial import ConvexHull
from slow import first
from trimesh.base import Trimesh

from kinectbench.core.errors import SettingsError, StorageError
from kinectbench.core.geometry.mesh import TriangleMesh
from kinectbench.lab.simulate.objects import (
    PAPER_FURNITURE,
    families,
    make_object,
    parse_object,
    shapes,
)
from kinectbench.lab.simulate.objects.contact_sheets import contact_sheet, write_contact_sheets
from kinectbench.lab.simulate.objects.shapes import Subject

SEEDS = range(15)
FURNITURE = [name for name, family in families().items() if family.furniture]
# Width, depth and height of real furniture, metres: least and most of each.
SIZES_M = {
    "chair": ((0.38, 0.38, 0.75), (0.75, 0.80, 1.15)),
    "table": ((0.45, 0.40, 0.37), (1.85, 1.25, 0.79)),
    "bench": ((0.90, 0.30, 0.40), (1.85, 0.80, 1.05)),
    "couch": ((0.80, 0.70, 0.68), (2.15, 1.60, 1.10)),
    "sideboard": ((0.35, 0.34, 0.40), (1.80, 0.60, 1.50)),
    "piano": ((1.35, 0.35, 0.75), (1.65, 0.60, 1.40)),
    "stool": ((0.25, 0.20, 0.28), (0.90, 0.75, 0.85)),
    "bed": ((1.10, 0.60, 0.35), (2.20, 1.25, 1.30)),
}


@functools.cache
def furniture(family: str, seed: int) -> Subject:
    return make_object(family, seed)


def checked(mesh: TriangleMesh) -> trimesh.Trimesh:
    """The mesh as it is, without merging its vertices."""
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def least_width_m(points: NDArray[np.float64]) -> float:
    """Least distance of two parallel planes around points, over the planes of their hull's faces."""
    hull = ConvexHull(points)
    return float(-((hull.equations[:, :3] @ points.T).min(axis=1) + hull.equations[:, 3]).max())


def test_boxes_and_bars_have_their_exact_volume() -> None:
    assert shapes.box((-0.1, 0, 0.2), (0.3, 0.5, 0.5)).volume() == pytest.approx(0.4 * 0.5 * 0.3)
    assert shapes.bar_between((0, 0, 0), (0.3, 0, 0.4), 0.02, 0.03).volume() == pytest.approx(
        0.5 * 0.02 * 0.03
    )
    # A leaning, tapered leg is a frustum: (A1 + A2 + sqrt(A1 A2)) h / 3.
    leg = shapes.leg((0.1, 0, 0), (0, 0, 0.6), (0.02, 0.02), (0.04, 0.04))
    assert leg.volume() == pytest.approx((0.0004 + 0.0016 + 0.0008) * 0.6 / 3)
    plate = shapes.plate(shapes.rectangle((0.4, 0.3)), 0.1, 0.2)
    assert plate.volume() == pytest.approx(0.012)
    assert np.allclose(plate.bounding_box(), (-0.2, -0.15, 0.1, 0.2, 0.15, 0.2))


def test_round_shapes_have_their_volume_but_for_their_facets() -> None:
    def near(shape: Manifold, volume_m3: float, share: float) -> None:
        assert volume_m3 * (1 - share) < shape.volume() < volume_m3 * (1 + 1e-9)

    near(shapes.rod((0, 0, 0), (0, 0.3, 0.4), 0.05), np.pi * 0.0025 * 0.5, 0.02)
    near(shapes.plate(shapes.ellipse((0.8, 0.5)), 0, 0.03), np.pi * 0.1 * 0.03, 0.01)
    corners = 0.04**2 * (4 - np.pi)
    near(shapes.plate(shapes.rectangle((0.4, 0.3), 0.04), 0, 0.1), (0.12 - corners) * 0.1, 0.01)
    near(shapes.turned([(0, 0), (0.1, 0), (0.1, 0.5), (0, 0.5)]), np.pi * 0.005, 0.01)
    # Steiner: a rounded box is its core grown by r on all sides.
    core, r = np.array([0.4, 0.3, 0.1]), 0.05
    faces = 2 * (core[0] * core[1] + core[1] * core[2] + core[0] * core[2])
    volume = core.prod() + faces * r + np.pi * r**2 * core.sum() + 4 / 3 * np.pi * r**3
    near(shapes.cushion((0, 0, 0), tuple(core + 2 * r), r), volume, 0.03)


def test_tubes_follow_their_path() -> None:
    area = 12 / 2 * np.sin(2 * np.pi / 12) * 0.01**2
    bent = shapes.tube([(0, 0, 0), (0.3, 0, 0), (0.3, 0.4, 0)], 0.01)
    # Mitred at the corner, a tube has the volume of its section times its middle line.
    assert bent.volume() == pytest.approx(area * 0.7)
    ring = shapes.tube([(0, 0, 0), (0, 0.3, 0), (0, 0.3, 0.2), (0, 0, 0.2), (0, 0, 0)], 0.01)
    assert ring.volume() == pytest.approx(area * 1.0)
    assert ring.genus() == 1
    strip = shapes.ribbon([(0, 0), (0.5, 0)], (-0.2, 0.2), 0.02)
    disc = 16 / 2 * np.sin(2 * np.pi / 16) * 0.01**2
    assert strip.volume() == pytest.approx((0.5 * 0.02 + disc) * 0.4, rel=1e-3)
    assert np.allclose(strip.bounding_box(), (-0.2, -0.01, -0.01, 0.2, 0.51, 0.01), atol=1e-5)


def test_bent_shapes_keep_their_volume() -> None:
    low, high = (-0.2, -0.01, 0), (0.2, 0.01, 0.5)
    assert shapes.bowed(low, high, 0.05).volume() == pytest.approx(0.004)
    assert shapes.bowed(low, high, 0.05).bounding_box()[1] == pytest.approx(-0.06, abs=1e-4)
    leaned = shapes.leaned(shapes.box(low, high), 0.1, 0.2)
    assert leaned.volume() == pytest.approx(0.004)
    assert leaned.bounding_box()[4] == pytest.approx(0.01 + 0.1 * 0.2)
    path = shapes.rounded_path([(0, 0), (1, 0), (1, 1)], 0.2)
    assert np.allclose(path[[0, 1, -2, -1]], [(0, 0), (0.8, 0), (1, 0.2), (1, 1)])
    flat = shapes.cushion((0, 0, 0), (0.6, 0.6, 0.15), 0.04)
    crowned = shapes.cushion((0, 0, 0), (0.6, 0.6, 0.15), 0.04, 0.03)
    assert crowned.bounding_box()[5] == pytest.approx(0.18, abs=2e-3)
    # The crown's mean over the square is (2/3)^2 of its middle.
    assert crowned.volume() - flat.volume() == pytest.approx(0.36 * 0.03 * 4 / 9, rel=0.1)


@pytest.mark.parametrize("family", FURNITURE)
@pytest.mark.parametrize("seed", first(4, SEEDS))
def test_furniture_is_one_watertight_solid(family: str, seed: int) -> None:
    subject = furniture(family, seed)
    mesh = check_closed(subject)
    litres = [1000 * closed(piece.mesh).volume for piece in subject.pieces]
    # Pieces overlap, so the union is smaller than their sum, and larger than the largest of them.
    assert max(litres) <= 1000 * mesh.volume < sum(litres)
    assert subject.mesh.vertices.dtype == np.float64
    assert subject.mesh.faces.dtype == np.int32


@pytest.mark.parametrize("family", FURNITURE)
@pytest.mark.parametrize("seed", SEEDS)
def test_furniture_stands_and_has_a_true_size(family: str, seed: int) -> None:
    subject = furniture(family, seed)
    low, high = subject.mesh.vertices.min(axis=0), subject.mesh.vertices.max(axis=0)
    assert low[2] == 0
    assert np.allclose((low + high)[:2], 0, atol=1e-12)
    least, most = SIZES_M[family]
    assert np.all(high - low >= least)
    assert np.all(high - low <= most)
    # It does not tip over: its centre of mass lies 2 cm or more inside the hull of what touches the floor.
    feet = subject.mesh.vertices[subject.mesh.vertices[:, 2] < 0.002, :2]
    sides = ConvexHull(feet).equations
    assert (sides[:, :2] @ checked(subject.mesh).center_mass[:2] + sides[:, 2]).max() < -0.02
    for piece in subject.pieces:
        assert least_width_m(piece.mesh.vertices) > 0.0149, piece.name
        assert np.all(piece.mesh.vertices >= low - 1e-9)
        assert np.all(piece.mesh.vertices <= high + 1e-9)


@pytest.mark.parametrize("family", FURNITURE)
def test_the_surface_of_the_pieces_is_the_surface_of_the_union(family: str) -> None:
    # Rays from outside meet the pieces where they meet the union: pictures and truth agree.
    subject = furniture(family, 3)
    pieces = trimesh.util.concatenate([checked(piece.mesh) for piece in subject.pieces])
    rng = np.random.default_rng(0)
    start = rng.normal(size=(300, 3))
    start = 3 * start / np.linalg.norm(start, axis=1, keepdims=True) + [0, 0, 0.4]
    aim = rng.uniform(subject.mesh.vertices.min(axis=0), subject.mesh.vertices.max(axis=0), (300, 3))
    depths = [first_hit_m(mesh, start, aim - start) for mesh in (pieces, checked(subject.mesh))]
    assert np.isfinite(depths[0]).sum() > 100
    assert np.allclose(depths[0], depths[1], atol=1e-5)


def first_hit_m(
    mesh: Trimesh, origins: NDArray[np.float64], directions: NDArray[np.float64]
) -> NDArray[np.float32]:
    import open3d as o3d

    tensor = o3d.core.Tensor.from_numpy
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(tensor(mesh.vertices.astype(np.float32)), tensor(mesh.faces.astype(np.uint32)))
    rays = np.concatenate([origins, directions], axis=1).astype(np.float32)
    return np.asarray(scene.cast_rays(tensor(rays))["t_hit"].numpy())


@pytest.mark.parametrize("family", ["chair", "bench", "couch"])
def test_backs_are_at_the_back(family: str) -> None:
    # Whoever sits there looks to +y: what is high up lies behind the middle.
    for seed in SEEDS:
        vertices = furniture(family, seed).mesh.vertices
        top = vertices[vertices[:, 2] > 0.97 * vertices[:, 2].max()]
        if vertices[:, 2].max() > 0.65:
            assert top[:, 1].mean() < -0.05, seed


@pytest.mark.parametrize("family", FURNITURE)
def test_furniture_varies(family: str) -> None:
    subjects = [furniture(family, seed) for seed in SEEDS]
    assert len({len(subject.mesh.faces) for subject in subjects}) >= 12
    assert len({tuple(sorted({piece.name for piece in subject.pieces})) for subject in subjects}) >= 6
    assert len({subject.pieces[0].color_rgb for subject in subjects}) >= 12
    heights = [subject.mesh.vertices[:, 2].max() for subject in subjects]
    assert max(heights) - min(heights) > 0.1


def test_some_pieces_are_dark_and_most_are_not() -> None:
    albedo = [p.albedo for family in FURNITURE for seed in SEEDS for p in furniture(family, seed).pieces]
    dark = np.array(albedo) <= 0.15
    assert 0.03 < dark.mean() < 0.35
    assert min(albedo) >= 0.05
    assert np.mean([0.4 <= value <= 0.8 for value in np.array(albedo)[~dark]]) == 1


def fingerprint() -> str:
    digest = hashlib.sha256()
    for family in FURNITURE:
        for seed in (0, 5):
            subject = make_object(family, seed)
            for mesh in (subject.mesh, *(piece.mesh for piece in subject.pieces)):
                digest.update(mesh.vertices.tobytes() + mesh.faces.tobytes())
    return digest.hexdigest()


def test_same_seed_same_vertices_in_every_process() -> None:
    here = fingerprint()
    assert fingerprint() == here
    code = "from test_simulate_furniture import fingerprint; print(fingerprint())"
    where = str(__import__("pathlib").Path(__file__).parent)
    environment = {
        "PYTHONHASHSEED": "7",
        "TBB_NUM_THREADS": "1",
        "PYTHONPATH": f"{where}:{':'.join(sys.path)}",
    }
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True
    )
    assert run.stdout.strip() == here


def test_other_seeds_and_families_differ() -> None:
    assert len(make_object("chair", 1).mesh.vertices) != len(make_object("chair", 2).mesh.vertices)
    assert make_object("chair", 3).name == "chair:seed=3"


def test_some_families_are_looked_at_and_others_only_reported() -> None:
    looked_at = {name for name, family in families().items() if family.looked_at}
    assert len(families()) > len(looked_at) > len(PAPER_FURNITURE)
    assert set(PAPER_FURNITURE) <= set(FURNITURE) & looked_at


def test_parse_object() -> None:
    assert parse_object("chair:seed=3") == ("chair", 3)
    assert parse_object("table") == ("table", 0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("chiar:seed=3", "did you mean 'chair'"),
        ("chair:sed=3", "such as chair:seed=3"),
        ("chair:seed=-1", "such as chair:seed=3"),
        ("", "such as chair:seed=3"),
    ],
)
def test_parse_object_refuses(text: str, says: str) -> None:
    with raises(SettingsError, "settings.wrong-value", match=says):
        parse_object(text)


def test_a_contact_sheet_shows_each_object_in_its_place() -> None:
    sheet = contact_sheet("table", (2, 7, 14, 9, 4), 60)
    assert sheet.shape == (2 * 82, 240, 3)
    assert sheet.dtype == np.uint8
    paper = (sheet == sheet[0, 0]).all(axis=-1)
    cells = [paper[r * 82 : r * 82 + 60, c * 60 : (c + 1) * 60].mean() for r in (0, 1) for c in range(4)]
    assert all(share < 0.9 for share in cells[:5])
    assert cells[5:] == [1, 1, 1]


def test_contact_sheets_are_written(tmp_path: Path) -> None:
    paths = write_contact_sheets(tmp_path / "sheets", count=1, size_px=40)
    assert [path.name for path in paths] == [f"{family}.png" for family in families()]
    assert read_picture(paths[0]).shape == (62, 160, 3)
    (tmp_path / "file").write_text("")
    with raises(StorageError, "storage.not-writable"):
        write_contact_sheets(tmp_path / "file", count=1, size_px=20)


@pytest.mark.parametrize("word", ["sofa", "Sofas"])
def test_another_word_for_a_family_is_understood(word: str) -> None:
    with raises(SettingsError, "settings.wrong-value", match=rf"'{word}': unknown; did you mean 'couch'\?"):
        parse_object(word)
