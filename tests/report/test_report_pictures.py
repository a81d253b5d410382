"""Pictures against shapes whose look is known."""

import base64
from pathlib import Path

import cv2
import numpy as np
import pytest
from raising import raises
from read_pictures import decoded_picture
from report_fake_build import T_FLOOR_WORLD, cameras_floor, make_pair

from kinectbench.core import images, pictures
from kinectbench.core.errors import StorageError
from kinectbench.core.geometry import TriangleMesh, invert_rigid
from kinectbench.core.voxels.pair_file import pack
from kinectbench.report import page_pictures

UP = np.array([0.0, 0, 1])


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> TriangleMesh:
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return TriangleMesh(
        np.array(low) + corners * (np.array(high) - np.array(low)), np.array(triangles, np.int32)
    )


def drawn(picture: np.ndarray) -> np.ndarray:
    """Which pixels are not paper."""
    drawn: np.ndarray = (np.abs(picture.astype(int) - np.array(pictures.PAPER)) > 8).any(axis=-1)
    return drawn


def test_look_along_is_right_handed_with_down_below() -> None:
    R = pictures.look_along(np.array([0.0, 2, 0]), UP)
    np.testing.assert_allclose(R.T, [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-12)
    # The optical camera itself: forward z, up -y.
    np.testing.assert_allclose(pictures.look_along(UP, np.array([0, -1.0, 0])), np.eye(3), atol=1e-12)


def test_what_is_high_is_drawn_high_and_what_is_right_right() -> None:
    # An L: a long foot along +x at the bottom, a post at its low-x end.
    foot, post = box((0, 0, 0), (1, 0.1, 0.2)), box((0, 0, 0), (0.2, 0.1, 1))
    whole = TriangleMesh(
        np.concatenate([foot.vertices, post.vertices]),
        np.concatenate([foot.faces, post.faces + 8]),
    )
    viewpoint = pictures.fit_viewpoint(
        whole.vertices, pictures.look_along(np.array([0, 1.0, 0]), UP), margin=1.0
    )
    seen = drawn(pictures.render(whole, viewpoint, 100))
    assert seen[90, 50] and seen[10, 10]
    assert not seen[10, 50] and not seen[50, 90]
    # 1 x 0.2 and 0.2 x 0.8 of the picture's 1 x 1.
    assert seen.mean() == pytest.approx(0.36, abs=0.02)


def test_a_near_face_hides_a_far_one_and_the_top_is_lit() -> None:
    cube = box((0, 0, 0), (1, 1, 1))
    forward = np.array([0, np.cos(0.6), -np.sin(0.6)])
    viewpoint = pictures.fit_viewpoint(cube.vertices, pictures.look_along(forward, UP))
    picture = pictures.render(cube, viewpoint, 80).astype(int)
    column = picture[:, 40].sum(axis=-1)
    top, front = column[22], column[60]
    assert top > front > 100


def test_silhouette_of_a_box_from_above() -> None:
    outlines = page_pictures.outlines(box((1, 2, 0), (1.5, 2.25, 1)))
    assert len(outlines) == 1
    np.testing.assert_allclose(outlines[0].min(axis=0), [1, 2], atol=0.006)
    np.testing.assert_allclose(outlines[0].max(axis=0), [1.5, 2.25], atol=0.006)


def test_voxel_mesh_lies_where_the_voxels_are() -> None:
    density = np.zeros((20, 20, 20), np.float32)
    density[2:5, 4:12, 10:20] = 1
    mesh = pictures.voxel_mesh(density, cell_m=0.1)
    np.testing.assert_allclose(mesh.vertices.min(axis=0), [0.2, 0.4, 1.0], atol=1e-6)
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [0.5, 1.2, 2.0], atol=1e-6)
    assert not len(pictures.voxel_mesh(np.zeros((4, 4, 4), np.float32), 0.1).faces)


def test_block_density_counts_every_cell() -> None:
    grid = np.random.default_rng(0).random((64, 64, 64)) < 0.3
    expected = grid.reshape(16, 4, 16, 4, 16, 4).mean(axis=(1, 3, 5))
    np.testing.assert_array_equal(pictures.block_density(pack(grid)), expected.astype(np.float32))


def test_smoothed_spreads_one_cell_over_its_neighbours() -> None:
    density = np.zeros((5, 5, 5), np.float32)
    density[2, 2, 2] = 1
    result = pictures.blurred_density(density)
    assert result[2, 2, 2] == 1 / 8 and result[1, 2, 2] == 1 / 16 and result[1, 1, 1] == 1 / 64
    assert result.sum() == 1 and density.sum() == 1


def test_pair_picture_shows_both_halves_alike_and_upright() -> None:
    T_world_camera = (invert_rigid(T_FLOOR_WORLD) @ cameras_floor())[0]
    pair = make_pair(T_world_camera)
    up_grid = T_FLOOR_WORLD[2, :3] @ pair.T_world_grid[:3, :3]
    picture = page_pictures.pair_picture(pair.partial, pair.full, pair.voxel_size_m, up_grid)
    assert picture.shape == (120, 240, 3) and picture.dtype == np.uint8
    partial, full = drawn(picture[:, :120]), drawn(picture[:, 120:])
    # All of the partial lies on the full shape, but for a cell of blur around it.
    grown = cv2.dilate(full.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    assert 0.4 < partial.sum() / full.sum() < 1.1
    assert (partial & ~grown).sum() < 0.01 * partial.sum()
    # Blue is the partial. The chair's wide back is above, its thin legs are below.
    blue = picture[:, :120][partial].astype(float).mean(axis=0)
    clay = picture[:, 120:][full].astype(float).mean(axis=0)
    assert blue[2] > blue[0] and clay[0] > clay[2]
    rows = np.flatnonzero(full.any(axis=1))
    quarter = len(rows) // 4
    assert full[rows[:quarter]].sum() > 1.5 * full[rows[-quarter:]].sum()


@pytest.mark.parametrize("up_grid", [(0, 0, -1.0), (0, 0, 1.0), (0, -1.0, 0), (1.0, 0, 0)])
def test_pair_picture_of_nothing_and_from_any_side(up_grid: tuple[float, float, float]) -> None:
    empty = np.zeros((64, 64, 8), np.uint8), np.zeros((256, 256, 32), np.uint8)
    assert not drawn(page_pictures.pair_picture(*empty, 0.004, np.array(up_grid))).any()


def test_depth_picture_near_is_bright_and_holes_are_grey() -> None:
    depth = np.full((20, 30), 2000, np.uint16)
    depth[:, 15:] = 1000
    depth[0] = 0
    picture = images.depth_picture(depth)
    assert picture[10, 20].sum() > picture[10, 5].sum()
    assert (picture[0] == images.NO_DEPTH).all()
    assert (images.depth_picture(np.zeros((4, 4), np.uint16)) == images.NO_DEPTH).all()


def test_overlay_leaves_its_input_and_draws_the_contour() -> None:
    picture = np.full((40, 40, 3), 200, np.uint8)
    mask = np.zeros((40, 40), bool)
    mask[10:30, 10:30] = True
    result = images.overlay_mask(picture, mask)
    assert (picture == 200).all()
    assert tuple(result[20, 20]) == (200, 200, 200)
    assert tuple(result[2, 2]) == (110, 110, 110)
    assert tuple(result[10, 20]) == images.CONTOUR_RGB


def test_data_uri_keeps_red_red_and_shrinking_keeps_the_shape() -> None:
    red = np.zeros((64, 128, 3), np.uint8)
    red[..., 0] = 250
    small = images.shrunk(red, 32)
    assert small.shape == (16, 32, 3) and images.shrunk(red, 128) is red
    encoded = base64.b64decode(images.data_uri(small).partition(",")[2])
    bgr = decoded_picture(encoded)
    assert bgr[8, 16, 2] > 240 and bgr[8, 16, 0] < 12


def test_images_of_another_kind_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.zeros((4, 4, 3), np.uint8))
    with raises(StorageError, "storage.damaged", match=r"a\.png"):
        images.read_gray(path)
