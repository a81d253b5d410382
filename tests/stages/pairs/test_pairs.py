"""Pairs of a simulated chair: every array against its definition, and the shape back in the world."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import pytest
from chair_model import Chair
from chair_model import chair as make_chair
from numpy.typing import NDArray
from references import shell_of
from scipy import ndimage
from typed import present

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.artefacts.views import PairsFile
from kinectbench.core.geometry import TriangleMesh, invert_rigid, transform_points
from kinectbench.core.geometry.camera import DepthRenderer
from kinectbench.core.geometry.depth import depth_sigma_m
from kinectbench.core.voxels.pair_file import Pair, pack, pair_bytes, read_pair, unpack
from kinectbench.settings.models import PairSettings, SegmentationSettings, ViewSettings
from kinectbench.stages.pairs import MadePair, full_shape, make_pair, pair_row
from kinectbench.stages.sample_views.views import View, sample_views
from kinectbench.stages.segment.object_model import ObjectModel

pytestmark = pytest.mark.xdist_group("chair_model")
PACKED = ("partial", "partial_256", "full", "shell", "known", "seen")


@pytest.fixture(scope="module")
def chair() -> Chair:
    return make_chair()


@pytest.fixture(scope="module")
def view(chair: Chair) -> View:
    settings = (ViewSettings(count=1, seed=1), SegmentationSettings(), PairSettings())
    return sample_views(chair.recorded.sequence, chair.trajectory, chair.model, *settings).views[0]


def made(chair: Chair, view: View, model: ObjectModel | None = None, **settings: Any) -> MadePair:
    return make_pair(
        view, chair.recorded.sequence, full_shape(model or chair.model), PairSettings(**settings)
    )


@pytest.fixture(scope="module", params=["object", "view"])
def pair(request: pytest.FixtureRequest, chair: Chair, view: View) -> Pair:
    result = made(chair, view, framing=request.param)
    assert result.pair is not None and result.reason is None
    return result.pair


@pytest.fixture(scope="module")
def cells() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (20_000, 3))


def world_of(pair: Pair, cells: np.ndarray) -> np.ndarray:
    return transform_points(pair.T_world_grid, (cells + 0.5) * pair.voxel_size_m)


def test_shapes_and_plain_values(pair: Pair, view: View, chair: Chair, tmp_path: Path) -> None:
    for name in PACKED:
        side = 64 if name == "partial" else 256
        assert getattr(pair, name).shape == (side, side, side // 8)
        assert getattr(pair, name).dtype == np.uint8 and getattr(pair, name).any()
    np.testing.assert_array_equal(pair.K, chair.recorded.sequence.camera.K)
    np.testing.assert_array_equal(pair.T_world_camera, view.alignment.T_world_camera)
    assert pair.surface_sigma_m == chair.model.surface_sigma_m
    path = tmp_path / "000.npz"
    path.write_bytes(pair_bytes(pair))
    again = read_pair(path)
    for field in fields(Pair):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(pair, field.name))


def test_axes_are_the_views(pair: Pair) -> None:
    np.testing.assert_allclose(pair.T_world_grid[:3, :3], pair.T_world_camera[:3, :3], atol=1e-12)
    T_camera_grid = invert_rigid(pair.T_world_camera) @ pair.T_world_grid
    np.testing.assert_allclose(T_camera_grid[:3, :3], np.eye(3), atol=1e-12)
    assert T_camera_grid[2, 3] > 0  # the cube is ahead of the camera


def test_the_partial_is_the_masked_depth(pair: Pair, view: View, chair: Chair) -> None:
    """Each pixel's point, straight from K, falls into a cell that is set; no other cell is."""
    depth_m = chair.recorded.sequence.depth_m(view.frame).astype(np.float64)
    v, u = np.nonzero(view.mask & (depth_m > 0))
    d = depth_m[v, u]
    points = np.stack([(u - pair.K[0, 2]) / pair.K[0, 0] * d, (v - pair.K[1, 2]) / pair.K[1, 1] * d, d], -1)
    in_grid = transform_points(invert_rigid(pair.T_world_grid) @ pair.T_world_camera, points)
    index = np.floor(in_grid / pair.voxel_size_m).astype(int)
    within = np.all((index >= 0) & (index < 256), axis=1)
    assert within.mean() > 0.98
    expected = np.zeros((256, 256, 256), bool)
    expected[tuple(index[within].T)] = True
    partial_256 = unpack(pair.partial_256)
    assert (partial_256 != expected).sum() <= 2  # on a border, by rounding


def test_reduction_by_any(pair: Pair) -> None:
    assert pair.partial_rule == "any"
    blocks = unpack(pair.partial_256).reshape(64, 4, 64, 4, 64, 4)
    np.testing.assert_array_equal(unpack(pair.partial), blocks.any(axis=(1, 3, 5)))


def test_seen_by_its_definition(pair: Pair, view: View, chair: Chair, cells: NDArray[np.int64]) -> None:
    x, y, z = transform_points(invert_rigid(pair.T_world_camera), world_of(pair, cells)).T
    u, v = pair.K[0, 0] * x / z + pair.K[0, 2], pair.K[1, 1] * y / z + pair.K[1, 2]
    column, row = np.rint(u).astype(int), np.rint(v).astype(int)
    depth_m = chair.recorded.sequence.depth_m(view.frame)  # the whole image, unmasked
    height, width = depth_m.shape
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height) & (z > 0)
    d = np.where(inside, depth_m[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)], 0)
    limit = d + 2 * depth_sigma_m(d) + pair.voxel_size_m
    expected = (d > 0) & (z <= limit)
    tie = np.minimum(np.abs(u % 1 - 0.5), np.abs(v % 1 - 0.5)) < 1e-6
    tie |= np.abs(z - limit) < 1e-6
    np.testing.assert_array_equal(unpack(pair.seen)[tuple(cells.T)][~tie], expected[~tie])
    assert 0.05 < expected.mean() < 0.95


def test_known_by_its_definition(pair: Pair, chair: Chair, cells: NDArray[np.int64]) -> None:
    """The label of the voxel that a cell's centre lies in: fine, else coarse, else unknown.

    `interior` is that label; that the underside of this chair is closed was said.
    """
    shape, points = chair.model.shape, world_of(pair, cells)
    labels = np.full(len(cells), int(Label.UNKNOWN))
    tie = np.zeros(len(cells), bool)
    for grid, values in ((chair.model.surround, chair.model.surround_labels), (shape.grid, shape.labels)):
        local = transform_points(grid.T_grid_world, points) / grid.voxel_size_m
        index = np.floor(local).astype(int)
        within = np.all((index >= 0) & (index < grid.shape), axis=1)
        labels[within] = values[tuple(index[within].T)]
        tie |= (np.abs(local - np.rint(local)) < 1e-6).any(axis=1)
    known = unpack(pair.known)[tuple(cells.T)]
    np.testing.assert_array_equal(known[~tie], (labels != Label.UNKNOWN)[~tie])
    assert known.mean() > 0.1
    interior = unpack(present(pair.interior))[tuple(cells.T)]
    np.testing.assert_array_equal(interior[~tie], (labels == Label.INTERIOR)[~tie])
    for packed in (present(pair.interior), present(pair.said)):
        assert packed.any() and not (packed & ~pair.known).any()


def test_known_without_what_was_said_is_known_without_the_word(chair: Chair, view: View) -> None:
    """Of an underside that nobody saw: with the word it is inside and known, without it unknown."""
    shape = chair.model.shape
    inside = shape.labels == Label.INTERIOR
    unseen = inside & (np.arange(shape.grid.shape[0]) % 8 < 4)[:, None, None]
    labels = np.where(unseen, Label.UNKNOWN, shape.labels).astype(np.uint8)
    with_word = replace(shape, underside=unseen)
    without = replace(with_word, labels=labels)
    said, unsaid = (
        present(made(chair, view, replace(chair.model, shape=of)).pair) for of in (with_word, without)
    )
    np.testing.assert_array_equal(said.known & ~present(said.said), unsaid.known)
    inside, inside_unsaid = present(said.interior), present(unsaid.interior)
    np.testing.assert_array_equal(said.known & ~inside, unsaid.known & ~inside_unsaid)
    word = present(said.said)
    assert word.any() and not (word & ~inside).any() and (inside & ~word).any()
    assert not present(unsaid.said).any()


def test_shell_is_the_surface_of_full(pair: Pair) -> None:
    full, shell = unpack(pair.full), unpack(pair.shell)
    np.testing.assert_array_equal(pair.shell, shell_of(full))
    assert not (shell & ~full).any() and shell.sum() < full.sum()


def test_full_put_back_into_the_world_is_the_true_chair(pair: Pair, chair: Chair) -> None:
    grid = np.stack(np.meshgrid(*[np.arange(0, 256, 5)] * 3, indexing="ij"), -1).reshape(-1, 3)
    full = unpack(pair.full)[tuple(grid.T)]
    true = chair.recorded.mesh_world
    scene = o3d.t.geometry.RaycastingScene()
    tensor = o3d.core.Tensor.from_numpy
    scene.add_triangles(tensor(true.vertices.astype(np.float32)), tensor(true.faces.astype(np.uint32)))
    scores = []
    for moved_m in (0.0, 0.02):
        points = world_of(pair, grid) + np.array([moved_m, 0, 0])
        inside = scene.compute_occupancy(points.astype(np.float32)).numpy() > 0
        scores.append((full & inside).sum() / (full | inside).sum())
    assert scores[0] > 0.75
    assert scores[1] < scores[0] - 0.1  # and nowhere else


def test_full_is_the_stored_solid(pair: Pair, chair: Chair) -> None:
    """The mesh voxelised anew agrees with the object's own volume."""
    shape = chair.model.shape
    # Away from the surface, which runs through the outermost voxels.
    index = np.argwhere(ndimage.binary_erosion(shape.solid))
    points = transform_points(shape.grid.T_world_grid, (index + 0.5) * shape.grid.voxel_size_m)
    cells = np.floor(transform_points(invert_rigid(pair.T_world_grid), points) / pair.voxel_size_m).astype(
        int
    )
    within = np.all((cells >= 0) & (cells < 256), axis=1)
    assert within.mean() > (0.95 if pair.framing == "view" else 0.9999)
    assert unpack(pair.full)[tuple(cells[within].T)].mean() > 0.999


def test_partial_lies_on_full_where_the_view_fits(pair: Pair) -> None:
    inside = unpack(pair.full).reshape(64, 4, 64, 4, 64, 4).any(axis=(1, 3, 5))
    partial = unpack(pair.partial)
    assert (partial & inside).sum() / partial.sum() > 0.8


def test_the_object_cube_holds_the_whole_shape(chair: Chair, view: View) -> None:
    result = made(chair, view, framing="object")
    assert result.cut_share < 0.05
    grid = present(result.pair).grid
    local = transform_points(grid.T_grid_world, chair.model.shape.mesh.vertices) / grid.voxel_size_m
    assert local.min() == pytest.approx(2) and local.max() == pytest.approx(254)


def hidden_part_changed(chair: Chair, view: View) -> ObjectModel:
    """The same model, but what this view cannot see is pushed 40 mm deeper, along the view's rays.

    Only vertices move that lie 20 mm behind what is seen, as do all vertices of their faces: whatever is
    rendered into the view stays as it is.
    """
    mesh, T_world_camera = chair.model.shape.mesh, view.alignment.T_world_camera
    camera = chair.recorded.sequence.camera
    seen_m = DepthRenderer(mesh).depth_m(camera, T_world_camera)
    points = transform_points(invert_rigid(T_world_camera), mesh.vertices)
    u, v = np.rint(camera.project(points)).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    behind_m = seen_m[np.where(inside, v, 0), np.where(inside, u, 0)]
    hidden = inside & (behind_m > 0) & (points[:, 2] > behind_m + 0.02)
    hidden[mesh.faces[~hidden[mesh.faces].all(axis=1)]] = False
    points[hidden] *= 1 + 0.04 / points[hidden, 2:]
    changed = TriangleMesh(transform_points(T_world_camera, points), mesh.faces)
    np.testing.assert_allclose(DepthRenderer(changed).depth_m(camera, T_world_camera), seen_m, atol=1e-5)
    assert hidden.sum() > 500
    return replace(chair.model, shape=replace(chair.model.shape, mesh=changed))


def test_framing_view_tells_nothing_of_the_hidden_part(chair: Chair, view: View) -> None:
    changed = hidden_part_changed(chair, view)
    one = present(made(chair, view, framing="view").pair)
    other = present(made(chair, view, changed, framing="view").pair)
    np.testing.assert_array_equal(one.T_world_grid, other.T_world_grid)
    assert one.voxel_size_m == other.voxel_size_m
    for name in ("partial", "partial_256", "seen"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert np.count_nonzero(unpack(one.full) != unpack(other.full)) > 1000
    # The paper's framing does tell.
    one, other = (present(made(chair, view, *model).pair) for model in ((), (changed,)))
    assert not np.array_equal(one.T_world_grid, other.T_world_grid)


def test_a_view_is_the_same_whatever_it_cannot_see(chair: Chair, view: View) -> None:
    """Pose and mask, which the framing is made of, come from the visible surface alone."""
    settings = (ViewSettings(count=1, seed=1), SegmentationSettings(), PairSettings())
    changed = hidden_part_changed(chair, view)
    again = sample_views(chair.recorded.sequence, chair.trajectory, changed, *settings).views[0]
    assert again.frame == view.frame
    np.testing.assert_array_equal(again.mask, view.mask)
    np.testing.assert_allclose(again.alignment.T_world_camera, view.alignment.T_world_camera, atol=1e-6)


def test_a_mask_that_holds_something_else_is_refused(chair: Chair, view: View) -> None:
    """A person's mask of the whole image has the floor in it; an empty one has nothing."""
    whole = made(chair, replace(view, mask=np.ones_like(view.mask)))
    assert whole.pair is None and "of the masked partial lies in the shape" in present(whole.reason)
    empty = made(chair, replace(view, mask=np.zeros_like(view.mask)))
    assert empty.pair is None and "no pixel of the mask has depth" in present(empty.reason)


def test_a_cube_that_cuts_the_shape_is_refused(chair: Chair, view: View) -> None:
    """Seen through a keyhole: a small piece of the chair frames a small cube."""
    rows, columns = np.nonzero(view.mask)
    keyhole = np.zeros_like(view.mask)
    middle = (int(np.median(rows)), int(np.median(columns)))
    keyhole[middle[0] - 12 : middle[0] + 12, middle[1] - 12 : middle[1] + 12] = True
    small = replace(view, mask=view.mask & keyhole)
    refused = made(chair, small, framing="view")
    assert refused.pair is None and refused.cut_share > 0.05
    assert "framing view cuts off" in present(refused.reason)
    assert made(chair, small, framing="object").pair is not None


def test_same_input_same_bytes(chair: Chair, view: View) -> None:
    assert pair_bytes(present(made(chair, view).pair)) == pair_bytes(present(made(chair, view).pair))


def test_row_of_the_table(chair: Chair, view: View) -> None:
    result = made(chair, view)
    row = pair_row(view, result).json_value()
    assert row["view"] == "000" and row["frame"] == view.frame
    assert row["containment"] == pytest.approx(view.fit.containment, abs=1e-4)
    assert row["cut_share"] == pytest.approx(result.cut_share, abs=1e-4)
    full, known = unpack(present(result.pair).full), unpack(present(result.pair).known)
    assert row["unknown_share"] == pytest.approx((full & ~known).sum() / full.sum(), abs=1e-4)


def test_the_share_of_unknown_counts_cells_of_the_shape(pair: Pair) -> None:
    """A board of 256 x 256 x 4 cells, a quarter of it not known; what is empty does not count."""
    full, known = np.zeros((256,) * 3, bool), np.zeros((256,) * 3, bool)
    full[:, :, 100:104] = True
    known[64:, :, 100:104] = True
    assert replace(pair, full=pack(full), known=pack(known)).unknown_share == 0.25
    assert replace(pair, full=pack(full), known=pack(~full)).unknown_share == 1
    assert replace(pair, full=pack(full), known=pack(full)).unknown_share == 0
    assert replace(pair, full=pack(np.zeros_like(full))).unknown_share == 0


def test_files_without_the_share_of_unknown_stay_readable() -> None:
    text = '{"pairs": [{"view": "000", "cut_share": 0.1}], "refused": []}'
    (row,) = PairsFile.parse(text, "pairs.json").pairs
    assert row.unknown_share is None and "unknown_share" not in row.json_value()


def test_packing_of_full_is_along_z(pair: Pair) -> None:
    full = unpack(pair.full)
    np.testing.assert_array_equal(pack(full), pair.full)
    assert full[:, :, 8:16].any() == pair.full[:, :, 1].any()
