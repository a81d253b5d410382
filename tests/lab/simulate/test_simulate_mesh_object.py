"""Mesh files as objects: closed ones exactly, holes filled, open ones by voxels, and bad ones refused."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from object_checks import closed
from trimesh.base import Trimesh

from kinectbench.core.errors import RecordingError
from kinectbench.lab.simulate.objects import shapes
from kinectbench.lab.simulate.objects.mesh_object import load_mesh_object
from kinectbench.lab.simulate.objects.shapes import Subject

FURNITURE = Path(__file__).parents[4] / "shared/data/furniture_meshes"


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=[low, high])


def saved(tmp_path: Path, mesh: trimesh.Trimesh, name: str = "thing.ply") -> Path:
    path = tmp_path / name
    mesh.export(path)
    return path


def solid(subject: Subject) -> trimesh.Trimesh:
    """The subject's mesh, which must be closed and stand in its place."""
    mesh = closed(subject.mesh)
    low, high = mesh.bounds
    assert np.allclose((low + high)[:2], 0, atol=1e-4)
    assert low[2] == pytest.approx(0, abs=1e-9)
    return mesh


@pytest.mark.parametrize("name", ["thing.obj", "thing.ply", "thing.stl", "thing.glb", "thing.off"])
def test_a_closed_box_stays_as_it_is(tmp_path: Path, name: str) -> None:
    path = saved(tmp_path, box((1, 2, 3), (1.5, 2.25, 4)), name)
    subject = load_mesh_object(path, "z")
    assert subject.name == name
    assert subject.origin == "closed in its file: one body"
    mesh = solid(subject)
    assert np.allclose(mesh.extents, (0.5, 0.25, 1))
    assert mesh.volume == pytest.approx(0.125)
    assert np.allclose(subject.pieces[0].mesh.vertices.max(axis=0), (0.25, 0.125, 1))


def test_up_is_turned_to_z(tmp_path: Path) -> None:
    # A step: what is left (-x), low (-y) and near (+z) in the file stays left, low and in front (-y).
    path = saved(tmp_path, box((0, 0, 0), (0.2, 1, 0.3)) + box((-0.5, 0, 0.1), (0.1, 0.1, 0.9)))
    mesh = solid(load_mesh_object(path, "y"))
    assert np.allclose(mesh.extents, (0.7, 0.9, 1))
    top = mesh.vertices[mesh.vertices[:, 2] > 0.99]
    assert np.allclose((top.min(axis=0), top.max(axis=0)), ((0.15, 0.15, 1), (0.35, 0.45, 1)))


def test_closed_bodies_are_united_exactly(tmp_path: Path) -> None:
    parts = (
        box((0, 0, 0), (1, 1, 1))
        + box((0.5, 0.25, 0.25), (1.5, 0.75, 0.75))
        + box((2, 0, 0), (2.1, 0.5, 0.5))
    )
    subject = load_mesh_object(saved(tmp_path, parts), "z")
    assert subject.origin == "closed in its file: exact union of 3 bodies"
    assert solid(subject).volume == pytest.approx(1 + 0.125 + 0.025)


def test_a_body_inside_out_is_turned_and_a_cavity_is_kept(tmp_path: Path) -> None:
    inverted = box((0.25, 0.25, 0.25), (0.75, 0.75, 0.75))
    inverted.invert()
    cavity = load_mesh_object(saved(tmp_path, box((0, 0, 0), (1, 1, 1)) + inverted), "z")
    assert solid(cavity).volume == pytest.approx(1 - 0.125)
    alone = load_mesh_object(saved(tmp_path, inverted), "z")
    assert solid(alone).volume == pytest.approx(0.125)
    beside = load_mesh_object(saved(tmp_path, box((0.5, 0, 0), (1, 1, 1)) + inverted), "z")
    assert solid(beside).volume == pytest.approx(0.5 + 0.0625)


def test_boxes_that_share_an_edge_are_two_bodies(tmp_path: Path) -> None:
    parts = box((0, 0, 0), (0.5, 0.5, 0.5)) + box((0.5, 0.5, 0), (1, 1, 0.5))
    subject = load_mesh_object(saved(tmp_path, parts), "z")
    assert subject.origin.startswith("closed in its file")
    # Where they touch, no closed surface has two faces at each edge, unless they stay apart there.
    assert closed(subject.mesh).volume == pytest.approx(0.25)


def test_faces_of_any_winding_are_turned_the_same_way(tmp_path: Path) -> None:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.4)
    volume = mesh.volume
    mixed = mesh.faces.copy()
    mixed[::3] = mixed[::3, ::-1]
    subject = load_mesh_object(saved(tmp_path, trimesh.Trimesh(mesh.vertices, mixed, process=False)), "z")
    assert solid(subject).volume == pytest.approx(volume)


def test_a_missing_face_is_filled_exactly(tmp_path: Path) -> None:
    whole = box((0, 0, 0), (0.5, 0.4, 0.6))
    whole.update_faces(whole.face_normals[:, 1] < 0.5)
    assert len(whole.faces) == 10
    subject = load_mesh_object(saved(tmp_path, whole), "z")
    assert subject.origin == "closed by filling 1 holes (4 open edges): one body"
    assert solid(subject).volume == pytest.approx(0.12)
    # The camera sees the filled face, too.
    seen = closed(subject.pieces[0].mesh)
    assert seen.area == pytest.approx(2 * (0.2 + 0.3 + 0.24))


def test_a_hole_that_is_not_convex_is_filled_exactly(tmp_path: Path) -> None:
    corner = shapes.box((0, 0, 0), (0.4, 0.4, 1)) - shapes.box((0.2, 0.2, -1), (1, 1, 2))
    found = shapes.surface(corner)
    mesh = trimesh.Trimesh(found.vertices, found.faces, process=False)
    mesh.update_faces(np.abs(mesh.face_normals[:, 2]) < 0.5)
    subject = load_mesh_object(saved(tmp_path, mesh), "z")
    assert subject.origin == "closed by filling 2 holes (12 open edges): one body"
    assert solid(subject).volume == pytest.approx(0.12)


def sheets() -> trimesh.Trimesh:
    """A seat of 0.2 x 0.2 m and a back of 0.2 x 0.25 m without thickness."""
    seat = [(-0.1, -0.1, 0.4), (0.1, -0.1, 0.4), (0.1, 0.1, 0.4), (-0.1, 0.1, 0.4)]
    back = [(-0.1, -0.1, 0.4), (0.1, -0.1, 0.4), (0.1, -0.1, 0.65), (-0.1, -0.1, 0.65)]
    return trimesh.Trimesh(seat + back, [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], process=False)


def test_open_sheets_become_a_thin_solid_that_the_camera_sees(tmp_path: Path) -> None:
    subject = load_mesh_object(saved(tmp_path, sheets()), "z")
    assert subject.origin.startswith("closed by voxelising at 2.0 mm: 6 open edges")
    mesh = solid(subject)
    # The solid is all within 0.9 voxels of 1.8 mm of the sheets.
    assert np.allclose(mesh.extents, (0.2036, 0.2036, 0.2536), atol=0.0015)
    thick = 2 * 0.0018
    assert mesh.volume == pytest.approx((0.04 + 0.05) * thick, rel=0.05)
    pieces = trimesh.util.concatenate(
        [trimesh.Trimesh(p.mesh.vertices, p.mesh.faces, process=False) for p in subject.pieces]
    )
    assert pieces.area == pytest.approx(mesh.area)
    assert np.allclose(pieces.bounds, mesh.bounds)


def test_a_box_without_a_large_face_is_no_solid_block(tmp_path: Path) -> None:
    # An open tray of 0.3 x 0.3 x 0.1 m: filling its rim would invent the water in it.
    tray = box((0, 0, 0), (0.3, 0.3, 0.1))
    tray.update_faces(tray.face_normals[:, 2] < 0.5)
    subject = load_mesh_object(saved(tmp_path, tray), "z")
    assert subject.origin.startswith("closed by voxelising at 2.0 mm: 4 open edges")
    assert solid(subject).volume == pytest.approx((0.09 + 4 * 0.03) * 0.0036, rel=0.05)


def test_an_enclosed_room_of_loose_sheets_is_filled(tmp_path: Path) -> None:
    # Six faces that share no vertex by 1 mm gaps: no hole can be filled, yet all six rays hit.
    whole = box((0, 0, 0), (0.2, 0.2, 0.2))
    loose = trimesh.Trimesh(
        whole.vertices[whole.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False
    )
    normals = np.repeat(loose.face_normals, 3, axis=0)
    loose.vertices = loose.vertices + 0.001 * normals
    subject = load_mesh_object(saved(tmp_path, loose), "z")
    assert "by voxelising" in subject.origin
    assert solid(subject).volume == pytest.approx((0.202 + 2 * 0.0018) ** 3, rel=0.01)


def test_colours_become_pieces(tmp_path: Path) -> None:
    both = trimesh.Scene()
    for low, color in ((0, (200, 30, 40)), (1, (10, 90, 250))):
        part = box((low, 0, 0), (low + 1, 0.5, 0.5))
        part.visual = trimesh.visual.TextureVisuals(
            material=trimesh.visual.material.SimpleMaterial(diffuse=color)
        )
        both.add_geometry(part)
    path = tmp_path / "both.obj"
    both.export(path)
    colors = {tuple(np.round(np.array(p.color_rgb) * 255)) for p in load_mesh_object(path, "z").pieces}
    assert colors == {(200, 30, 40), (10, 90, 250)}
    # Without its materials it is drawn in one colour each, and is the same solid.
    for extra in tmp_path.glob("*.mtl"):
        extra.unlink()
    subject = load_mesh_object(path, "z")
    assert solid(subject).volume == pytest.approx(0.5)

    painted = box((0, 0, 0), (0.5, 0.5, 0.5))
    painted.visual.face_colors = np.where(
        painted.face_normals[:, 2:] > 0.5, (255, 0, 0, 255), (0, 0, 255, 255)
    )
    subject = load_mesh_object(saved(tmp_path, painted), "z")
    assert [len(piece.mesh.faces) for piece in subject.pieces] == [10, 2]
    assert [piece.color_rgb for piece in subject.pieces] == [(0, 0, 1), (1, 0, 0)]


def test_a_voxelised_solid_keeps_the_colours_of_the_nearest_faces(tmp_path: Path) -> None:
    mesh = sheets()
    mesh.visual.face_colors = [(255, 0, 0, 255)] * 2 + [(0, 255, 0, 255)] * 2
    subject = load_mesh_object(saved(tmp_path, mesh), "z")
    areas = {
        piece.color_rgb: trimesh.Trimesh(piece.mesh.vertices, piece.mesh.faces).area
        for piece in subject.pieces
    }
    assert areas[1, 0, 0] == pytest.approx(2 * 0.04, rel=0.05)
    assert areas[0, 1, 0] == pytest.approx(2 * 0.05, rel=0.05)


@pytest.mark.parametrize(
    ("mesh", "says"),
    [
        (
            box((0, 0, 0), (500, 400, 800)),
            "its largest side is 800 m, not 0.01 to 5 m; scale the mesh to metres",
        ),
        (box((0, 0, 0), (0.001, 0.002, 0.005)), "its largest side is 0.005 m"),
        (trimesh.Trimesh([(0, 0, 0), (1, 0, 0), (1, 1, 0)], [(0, 1, 2)], process=False), "has no volume"),
    ],
)
def test_meshes_of_no_use_are_refused(tmp_path: Path, mesh: Trimesh, says: str) -> None:
    refused(saved(tmp_path, mesh), says)


def refused(path: Path, says: str) -> None:
    with pytest.raises(RecordingError, match=says) as caught:
        load_mesh_object(path, "z")
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_files_of_no_use_are_refused(tmp_path: Path) -> None:
    refused(tmp_path / "none.obj", "no such file")
    bad = {
        "empty.obj": b"",
        "points.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\n",
        "text.ply": b"this is not a mesh",
        "cut.glb": b"glTF\x02\x00\x00\x00\xff\xff\x00\x00",
        "cut.stl": b"solid x\nfacet normal 0 0",
        "notes.txt": b"chair",
        "far.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
    }
    for name, content in bad.items():
        (tmp_path / name).write_bytes(content)
        refused(tmp_path / name, "mesh")
    nan = tmp_path / "nan.off"
    nan.write_text("OFF\n4 4 0\n0 0 0\n1 0 0\n0 nan 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n")
    refused(nan, "not finite")


def test_the_same_file_gives_the_same_mesh(tmp_path: Path) -> None:
    path = saved(tmp_path, sheets())
    first, second = load_mesh_object(path, "z"), load_mesh_object(path, "z")
    assert first.mesh.vertices.tobytes() == second.mesh.vertices.tobytes()
    assert first.mesh.faces.tobytes() == second.mesh.faces.tobytes()


@pytest.mark.skipif(not FURNITURE.is_dir(), reason="real meshes are not there")
def test_real_meshes_are_closed() -> None:
    volumes_m3 = {}
    for name in ("ChairA", "KitchenTable", "BalconyTable", "SofaB"):
        subject = load_mesh_object(FURNITURE / f"aws_{name}_01.obj", "z")
        volumes_m3[name] = solid(subject).volume
        assert subject.origin.startswith("closed ")
    # The divergence theorem on the files themselves, whose bodies overlap by less than 3 %.
    assert volumes_m3["ChairA"] == pytest.approx(0.0198, rel=0.03)
    assert volumes_m3["KitchenTable"] == pytest.approx(0.0916, rel=0.03)
