"""What nobody saw is orange, and arrows show from where it would be seen: on boxes worked out by hand."""

import base64
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from raising import raises
from read_pictures import decoded_picture
from report_fake_build import FRONTIER, cameras_floor

from kinectbench.core import pictures
from kinectbench.core.artefacts.object import FrontierPart, QualityFile, with_interval
from kinectbench.core.artefacts.object_grids import Label, ObjectVolume, unmeasured_faces
from kinectbench.core.errors import StorageError
from kinectbench.core.geometry import Grid, TriangleMesh, rigid
from kinectbench.core.geometry.boxes import OrientedBox
from kinectbench.core.geometry.mesh import box_mesh, write_ply
from kinectbench.engine.stages import Job
from kinectbench.report import figures, recording
from kinectbench.report.page import write_report
from kinectbench.report.plan import draw_plan, look_arrows
from kinectbench.report.recording import RecordingPart, collect
from kinectbench.settings.models import BenchmarkSettings

VOXEL_M = 0.1
T_WORLD_GRID = rigid([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [3.0, -2.0, 0.5])
# A cube of six voxels, in the middle of a grid of ten: [2, 8) along each axis.
CUBE = slice(2, 8)


def frontier(**changes: object) -> FrontierPart:
    return FrontierPart.model_validate({**FRONTIER, **changes})


def cube_volume(measured: tuple[slice | int, ...]) -> ObjectVolume:
    """The cube, with these of its voxels labelled as measured."""
    solid = np.zeros((10, 10, 10), bool)
    solid[CUBE, CUBE, CUBE] = True
    labels = np.where(solid, Label.INTERIOR, Label.FREE).astype(np.uint8)
    labels[measured] = Label.SURFACE
    return ObjectVolume(
        Grid(solid.shape, VOXEL_M, T_WORLD_GRID),
        solid,
        labels,
        solid.astype(np.float16),
        np.zeros_like(solid),
    )


def cube_mesh() -> TriangleMesh:
    """Its surface in small triangles, in the world."""
    side = np.argwhere(np.ones((6, 6))) * VOXEL_M + 0.2
    vertices = []
    for axis in range(3):
        for at_m in (0.2, 0.8):
            for u, v in side:
                corners = np.array([[u, v], [u + VOXEL_M, v], [u, v + VOXEL_M]])
                vertices.append(np.insert(corners, axis, at_m, axis=1))
    faces = np.arange(3 * len(vertices), dtype=np.int32).reshape(-1, 3)
    return TriangleMesh(np.concatenate(vertices), faces).transformed(T_WORLD_GRID)


def unmeasured(mesh: TriangleMesh, volume: ObjectVolume) -> np.ndarray:
    return unmeasured_faces(mesh, volume.grid, volume.labels)


def test_a_mesh_without_faces_is_a_line(tmp_path: Path) -> None:
    write_ply(TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), tmp_path / "mesh.ply")
    with raises(StorageError, "storage.damaged", match=r"mesh\.ply: has no faces"):
        recording._mesh(tmp_path, np.eye(4))


def test_what_is_near_no_measured_voxel_was_not_seen() -> None:
    mesh = cube_mesh()
    hidden = unmeasured(mesh, cube_volume((CUBE, CUBE, 7)))
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    height_m = (middles - T_WORLD_GRID[:3, 3])[:, 2]
    # The uppermost layer was measured, from 0.7 to 0.8 m, its middles at 0.75 m: what is seen goes on for 1.5
    # voxels below them, to 0.6 m.
    assert hidden.tolist() == (height_m < 0.6).tolist()
    assert 0 < hidden.sum() < len(hidden)
    assert not unmeasured(mesh, cube_volume((CUBE, CUBE, CUBE))).any()
    assert unmeasured(mesh, cube_volume((0, 0, 0))).all()


def test_the_far_side_of_a_thin_wall_was_not_seen() -> None:
    """A wall of two voxels, both measured from above; below it nobody looked, but for a half of x."""
    labels = np.full((10, 10, 10), Label.FREE, np.uint8)
    labels[:, :, 4:6] = Label.SURFACE
    labels[5:, :, :4] = Label.UNKNOWN
    grid = Grid(labels.shape, VOXEL_M, T_WORLD_GRID)
    volume = ObjectVolume(
        grid,
        labels == Label.SURFACE,
        labels,
        np.zeros(labels.shape, np.float16),
        np.zeros(labels.shape, bool),
    )
    upward = np.array([[0.0, 0, 0], [0.06, 0, 0], [0, 0.06, 0]])
    corners: list[np.ndarray] = []
    for x in (0.22, 0.72):
        corners.extend((upward + np.array([x, 0.5, 0.6]), upward[[0, 2, 1]] + np.array([x, 0.5, 0.4])))
    faces = np.arange(12, dtype=np.int32).reshape(4, 3)
    mesh = TriangleMesh(np.concatenate(corners), faces).transformed(T_WORLD_GRID)
    assert unmeasured(mesh, volume).tolist() == [False, False, False, True]


def test_a_surface_at_the_edge_of_the_grid() -> None:
    volume = cube_volume((slice(None), slice(None), 9))
    mesh = TriangleMesh(np.array([[0.0, 0, 1.0], [1, 0, 1.0], [0, 1, 1.0]]), np.array([[0, 1, 2]], np.int32))
    assert not unmeasured(mesh.transformed(T_WORLD_GRID), volume).any()
    # Opposite, where the grid's far end would be if indices went round.
    below = replace(mesh, vertices=mesh.vertices - [0, 0, 1.2])
    assert unmeasured(below.transformed(T_WORLD_GRID), volume).all()


def decoded(side: recording.ObjectPicture) -> np.ndarray:
    return decoded_picture(base64.b64decode(side.picture.partition(",")[2]))[..., ::-1].astype(int)


def share(picture: np.ndarray, color: str) -> float:
    """Of the pixels, what is orange, grey or blue."""
    red, green, blue = np.moveaxis(picture, -1, 0)
    found = {
        "orange": (red - blue > 90) & (red > green + 25),
        "blue": (blue - red > 60),
        "grey": (abs(red - blue) < 12) & (red < 225),
    }
    return float(found[color].mean())


def test_what_nobody_saw_is_orange_and_an_arrow_shows_from_where() -> None:
    box = box_mesh(OrientedBox((0, 0, 0.5), (1.0, 1.0, 1.0), 0.0))
    first, second = (box.vertices[box.faces[:, k]] - box.vertices[box.faces[:, 0]] for k in (1, 2))
    normals = np.cross(first, second)
    top = normals[:, 2] > 0.5
    assert top.sum() == 2
    plain = recording.object_pictures(box, np.zeros(12, bool), ())
    assert [side.caption for side in plain] == ["", "", ""]
    assert all(share(decoded(side), "grey") > 0.3 for side in plain)
    assert all(share(decoded(side), "orange") == share(decoded(side), "blue") == 0 for side in plain)
    above = frontier(direction="up", center_m=(0, 0, 1.0), look_from=(0, 0, 1.0))
    sides = [decoded(side) for side in recording.object_pictures(box, top, (above,))]
    assert len(sides) == 4
    assert all(share(side, "orange") > 0.05 and share(side, "blue") > 0.005 for side in sides)
    # From where it would be seen, the unseen top is most of what is drawn.
    assert share(sides[3], "orange") > share(sides[3], "grey")
    # The arrow stands above the box, where nothing else is drawn.
    rows = np.flatnonzero(np.any(sides[0][..., 2] - sides[0][..., 0] > 60, axis=1))
    drawn = np.flatnonzero(np.any(np.ptp(sides[0], axis=2) > 60, axis=1))
    assert rows[0] == drawn[0] and rows[-1] - rows[0] > 60


def test_an_arrow_from_behind_is_left_out() -> None:
    box = box_mesh(OrientedBox((0, 0, 0.5), (1.0, 1.0, 1.0), 0.0))
    azimuth = np.deg2rad(70.0)  # of the second look
    beside = frontier(center_m=(0, 0, 0.5), look_from=(-float(np.cos(azimuth)), -float(np.sin(azimuth)), 0))
    sides = [decoded(side) for side in recording.object_pictures(box, np.zeros(12, bool), (beside,))]
    assert share(sides[1], "blue") == 0
    assert share(sides[2], "blue") > 0.005 and share(sides[3], "blue") > 0.005


@pytest.mark.parametrize(
    ("look_from", "expected"),
    [
        ((0.0, 0.0, 1.0), (-50.0, 62.0)),
        ((0.0, 1.0, 0.0), (90.0, 0.0)),
        ((-0.8, 0.0, 0.6), (180.0, 36.87)),
        ((0.0, 0.0, -1.0), (-50.0, -40.0)),
    ],
)
def test_from_where_a_frontier_is_drawn(
    look_from: tuple[float, float, float], expected: tuple[float, float]
) -> None:
    assert recording._look_deg(frontier(look_from=look_from)) == pytest.approx(expected, abs=0.01)


def test_pieces_keep_their_colours_and_their_depth() -> None:
    near, far = (box_mesh(OrientedBox((0, y, 0.5), (1.0, 0.1, 1.0), 0.0)) for y in (-1.0, 1.0))
    viewpoint = pictures.viewpoints_around(np.concatenate([near.vertices, far.vertices]), [(-90.0, 0.0)])[0]
    red, blue = (200, 0, 0), (0, 0, 200)
    empty = TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    picture = pictures.render_pieces([(empty, blue), (far, blue), (near, red)], viewpoint, 40)
    assert picture[20, 20, 0] > 90 and picture[20, 20, 2] < 10
    flat = pictures.render_pieces([(near, red)], viewpoint, 40, contrast=0.0)
    assert flat[20, 20].tolist() == list(red)
    assert (pictures.render_pieces([(empty, red)], viewpoint, 40) == pictures.PAPER).all()


def test_arrows_of_the_plan_begin_where_to_record_from() -> None:
    beside = frontier(center_m=(0.1, -0.2, 0.2), look_from=(0.6, -0.8, 0.0))
    above = frontier(center_m=(0.0, 0.1, 0.4), look_from=(0.1, 0.0, 0.995))
    cameras = cameras_floor()
    (tail, tip), ring = look_arrows(cameras, (beside, above))
    assert tip.tolist() == [0.1, -0.2]
    away_m = np.linalg.norm(cameras[:, :2, 3] - tip, axis=1).mean()
    np.testing.assert_allclose(tail, tip + away_m * np.array([0.6, -0.8]))
    assert ring.tolist() == [[0.0, 0.1], [0.0, 0.1]]
    svg = draw_plan(cameras, np.zeros((0, 3)), [], (beside, above))
    marks = [group for group in ElementTree.fromstring(svg) if group.get("class") == "look"]
    assert [mark.findtext("text") for mark in marks] == ["1", "2"]
    classes = [[part.get("class") for part in mark] for mark in marks]
    assert "head" in classes[0] and "ring" not in classes[0]
    assert "ring" in classes[1] and "head" not in classes[1]
    # The head's first corner is the arrow's tip.
    line, head = marks[0].findall("path")[:2]
    ends = re.findall(r"[-\d.]+,[-\d.]+", line.get("d") or "")
    assert re.findall(r"[-\d.]+,[-\d.]+", head.get("d") or "")[0] == ends[1]
    assert "look" not in draw_plan(cameras, np.zeros((0, 3)), [])


@pytest.mark.parametrize(
    ("ends", "words"),
    [((0.352, 0.8), "0.74 (0.35 to 0.80)"), ((None, None), "0.74"), ((None, 0.8), "0.74")],
)
def test_an_estimate_in_words(ends: tuple[float | None, float | None], words: str) -> None:
    quality = QualityFile(estimated_iou=0.7412, estimated_iou_low=ends[0], estimated_iou_high=ends[1])
    assert quality.estimated_iou_words() == words
    assert with_interval(None, *ends, 2) is None


def test_advice_is_no_warning_beside_itself() -> None:
    part = frontier()
    quality = QualityFile(
        warnings=(part.advice, "few frames"), frontiers=(part,), estimated_iou=0.9, volume_m3=0.1,
        estimated_iou_low=0.8, estimated_iou_high=0.95, estimated_iou_reasons=("thin parts",),
    )  # fmt: skip
    shown = figures.quality_figures(quality)
    assert (shown.warnings, shown.advice, shown.tone) == (("few frames",), (part.advice,), "warn")
    assert (shown.estimate, shown.reasons) == ("0.90 (0.80 to 0.95)", ("thin parts",))
    assert shown.rows == (("volume m3", "0.1"),)


def test_the_word_about_the_underside_and_what_it_decides_are_shown() -> None:
    shown = figures.quality_figures(QualityFile(underside="closed", underside_share=0.125, volume_m3=0.1))
    assert shown.rows[:2] == (
        ("underside, as stated by a person", "closed"),
        ("seen from below only, share of the solid: the word about the underside decides it", "0.125"),
    )
    older = figures.quality_figures(QualityFile(volume_m3=0.1, frontiers=(frontier(),)))
    assert older.rows == (("volume m3", "0.1"),)


@pytest.fixture(scope="module")
def part(settings: BenchmarkSettings, build: Path) -> RecordingPart:
    return collect(Job(settings, settings.recordings[0], build.parent), build / "chair_01")


def test_the_page_tells_the_person(
    part: RecordingPart, settings: BenchmarkSettings, build: Path, tmp_path: Path
) -> None:
    assert len(part.object_pictures) == 4 and part.object_pictures[3].caption
    # Seen from above the seat's top is grey; what it hides is orange.
    assert all(share(decoded(side), "orange") > 0.02 for side in part.object_pictures)
    assert all(share(decoded(side), "grey") > 0.02 for side in part.object_pictures)
    page = write_report(settings, build, [], tmp_path / "x.html").read_text(encoding="utf-8")
    assert page.count('<ol class="advice">') == 1
    assert "record from the front &lt;b&gt;" in page
    assert "estimated IoU <b>0.74 (0.35 to 0.80)</b>" in page
    assert "an opening that nobody looked into</li>" in page
    assert "nobody saw it" in page and "from where 1 would be seen" in page
    assert page.count('class="look"') == 1
