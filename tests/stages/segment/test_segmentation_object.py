"""Choosing the object, its box, the masks of a view, and the rendered object."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from analytic_scenes import CAMERA, depth_of, ring, scene_of, sphere
from analytic_scenes import box as box_surface
from analytic_scenes import plane as plane_surface
from numpy.typing import NDArray
from raising import raises

from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import Grid, OrientedBox, TriangleMesh, rigid, transform_points
from kinectbench.core.geometry.boxes import yaw_rotation
from kinectbench.core.geometry.camera import DepthRenderer
from kinectbench.core.geometry.depth import depth_sigma_m
from kinectbench.core.trajectory.coverage import convergence_point
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.voxels.point_cells import surface_points
from kinectbench.lab.simulate.path import look_at
from kinectbench.settings.models import FusionSettings, SegmentationSettings
from kinectbench.stages.fuse import fuse
from kinectbench.stages.ingest.images import decode_mask
from kinectbench.stages.sample_views.masks import (
    agreement_mask,
    inner_silhouette,
    object_mask,
    override_mask,
    unused_masks,
)
from kinectbench.stages.sample_views.views import read_masks
from kinectbench.stages.segment.find.object import find_floor_and_object
from kinectbench.stages.segment.find.pieces import fit_box, select_object

pytestmark = pytest.mark.xdist_group("segmentation")


def box_points(
    low: tuple[float, float, float], high: tuple[float, float, float], step_m: float = 0.02
) -> NDArray[np.float64]:
    """Points on the surface of an upright box without its bottom."""
    axes = [np.arange(a, b + step_m / 2, step_m) for a, b in zip(low, high, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    edge = np.zeros(len(points), bool)
    for axis in range(3):
        edge |= points[:, axis] >= axes[axis][-1] - 1e-9
        if axis < 2:
            edge |= points[:, axis] <= axes[axis][0] + 1e-9
    return points[edge]


# --- select


def test_the_piece_nearest_to_the_target_is_chosen() -> None:
    floor = np.column_stack([np.random.default_rng(0).uniform(-1, 1, (3000, 2)), np.zeros(3000)])
    near, far = box_points((-0.2, -0.2, 0.0), (0.2, 0.2, 0.4)), box_points((0.5, -0.3, 0.0), (1.5, 0.3, 0.8))
    points = np.concatenate([floor, near, far])
    in_near = np.zeros(len(points), bool)
    in_near[3000 : 3000 + len(near)] = True
    above = points[:, 2] > 0.02
    chosen = select_object(points, 0.02, np.array([0.1, 0.0, 0.3]))
    np.testing.assert_array_equal(chosen, in_near & above)
    chosen = select_object(points, 0.02, np.array([0.9, 0.0, 0.3]))  # the larger one
    np.testing.assert_array_equal(chosen, ~in_near & above)


def test_specks_are_not_chosen() -> None:
    thing, speck = box_points((0.5, 0.5, 0.0), (0.9, 0.9, 0.5)), np.array([[0.0, 0.0, 0.3]])
    chosen = select_object(np.concatenate([thing, speck]), 0.02, np.array([0.0, 0.0, 0.3]))
    assert chosen[: len(thing)].sum() > 0 and not chosen[-1]


def test_nothing_on_the_floor() -> None:
    floor = np.column_stack([np.random.default_rng(0).uniform(-1, 1, (3000, 2)), np.full(3000, 0.01)])
    with raises(SegmentationError, "segmentation.no-object", match="nothing"):
        select_object(floor, 0.02, np.zeros(3))
    specks = np.column_stack([np.arange(100) * 0.2, np.zeros(100), np.full(100, 0.5)])
    with raises(SegmentationError, "segmentation.no-object", match="only specks"):
        select_object(np.concatenate([floor, specks]), 0.02, np.zeros(3))


def test_optical_axes_converge_where_the_cameras_look() -> None:
    target = (0.3, -0.2, 0.5)
    np.testing.assert_allclose(convergence_point(ring(9, 1.4, target, (0.2, 0.6))), target, atol=0.005)
    one = ring(1, 1.4, target)  # a single axis: a point ahead of the camera, not at infinity
    at = transform_points(np.linalg.inv(one[0]), convergence_point(one))
    np.testing.assert_allclose(at, [0, 0, 1.5], atol=1e-6)


def test_surface_points_weigh_area_not_vertices() -> None:
    """A square of few large triangles' vertices and a dense one give one point a cell either way."""
    a, b = np.meshgrid(np.arange(0, 0.3, 0.002), np.arange(0, 0.3, 0.002), indexing="ij")
    n = len(a)
    vertices = np.column_stack([a.ravel(), b.ravel(), np.full(n * n, 0.015)])
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate(
        [
            np.column_stack([corner, corner + n, corner + n + 1]),
            np.column_stack([corner, corner + n + 1, corner + 1]),
        ]
    )
    surface = surface_points(TriangleMesh(vertices, faces.astype(np.int32)), cell_m=0.03)
    assert len(surface.points) == 100
    np.testing.assert_allclose(surface.normals, np.tile([0, 0, 1.0], (100, 1)), atol=1e-9)
    np.testing.assert_allclose(surface.points[:, 2], 0.015)
    cells = np.floor(surface.points / 0.03)
    np.testing.assert_array_equal(cells[surface.owner], np.floor(vertices / 0.03))


# --- box


@pytest.mark.parametrize("yaw_deg", [-44.0, -20.0, 0.0, 13.0, 44.0, 70.0, 135.0, -91.0])
def test_box_has_a_unique_yaw_and_the_right_size(yaw_deg: float) -> None:
    yaw = np.radians(yaw_deg)
    points = box_points((-0.3, -0.15, 0.02), (0.3, 0.15, 0.7), 0.01)
    points = points @ yaw_rotation(yaw).T + [1.0, -0.5, 0.0]
    fitted = fit_box(points)
    assert -np.pi / 4 <= fitted.yaw_rad < np.pi / 4
    quarter_turns = (fitted.yaw_rad - yaw) / (np.pi / 2)
    assert quarter_turns == pytest.approx(round(quarter_turns), abs=1e-3)
    wide = [0.6, 0.3] if round(quarter_turns) % 2 == 0 else [0.3, 0.6]
    np.testing.assert_allclose(fitted.size_m, [*wide, 0.7], atol=0.002)
    np.testing.assert_allclose(fitted.center_m, [1.0, -0.5, 0.35], atol=0.002)


def test_box_with_a_given_yaw_and_a_speck() -> None:
    points = box_points((-0.3, -0.15, 0.0), (0.3, 0.15, 0.7), 0.01)
    speck = np.array([[0.9, 0.9, 1.5]])
    fitted = fit_box(np.concatenate([points, speck]), yaw_rad=0.0)
    np.testing.assert_allclose(fitted.size_m, [0.6, 0.3, 0.7], atol=0.002)
    assert fitted.yaw_rad == 0.0


# --- segment


@pytest.fixture(scope="module")
def two_things() -> tuple[TriangleMesh, Trajectory]:
    """A box where the cameras look, another one beside it, on a floor."""
    surfaces = [
        box_surface((-0.15, -0.1, 0.0), (0.15, 0.1, 0.3)),
        box_surface((0.3, -0.1, 0.0), (0.5, 0.1, 0.2)),
        plane_surface((0, 0, 1), 0.0),
    ]
    poses = ring(16, 1.2, (0.0, 0.0, 0.15), (0.4, 0.8))
    sequence, trajectory = scene_of(surfaces, poses)
    return fuse(sequence, trajectory, FusionSettings(max_depth_m=1.7)).mesh, trajectory


def test_segment_finds_the_box_the_cameras_look_at(two_things: tuple[TriangleMesh, Trajectory]) -> None:
    mesh, trajectory = two_things
    found = find_floor_and_object(mesh, trajectory, None, SegmentationSettings())
    assert found.how == "automatic"
    np.testing.assert_allclose(found.box.size_m, [0.3, 0.2, 0.3], atol=0.04)
    np.testing.assert_allclose(found.box.center_m, [0, 0, 0.15], atol=0.02)
    assert abs(found.floor.plane_world[3]) < 0.002
    cells = (found.other_cells + 0.5) * 0.03
    neighbour = (cells[:, 0] > 0.25) & (cells[:, 0] < 0.55) & (np.abs(cells[:, 1]) < 0.15)
    assert neighbour.sum() > 50
    assert ((found.object_cells + 0.5) * 0.03)[:, 0].max() < 0.22


def test_a_given_box_wins(two_things: tuple[TriangleMesh, Trajectory]) -> None:
    mesh, trajectory = two_things
    given = OrientedBox((0.4, 0.0, 0.15), (0.24, 0.24, 0.3), 0.1)
    found = find_floor_and_object(mesh, trajectory, given, SegmentationSettings())
    assert found.how == "box" and found.box == given
    assert ((found.object_cells + 0.5) * 0.03)[:, 0].min() > 0.24
    elsewhere = OrientedBox((5.0, 0.0, 0.15), (0.24, 0.24, 0.3), 0.1)
    with raises(SegmentationError, "segmentation.empty-box"):
        find_floor_and_object(mesh, trajectory, elsewhere, SegmentationSettings())


@pytest.mark.parametrize("given", [None, OrientedBox((0.02, 0.0, 0.2), (0.5, 0.3, 0.36), 0.4)])
def test_excluded_against_a_walk_over_voxels(
    two_things: tuple[TriangleMesh, Trajectory], given: OrientedBox | None
) -> None:
    """A turned upright grid; every voxel is judged by its own centre."""
    mesh, trajectory = two_things
    found = find_floor_and_object(mesh, trajectory, given, SegmentationSettings())
    T_floor_grid = rigid(yaw_rotation(0.3), [-0.25, -0.3, -0.04])
    grid = Grid((64, 48, 32), 0.0125, found.floor.T_world_floor @ T_floor_grid)
    excluded, beyond = found.neighbours(grid), found.beyond_box(grid)
    assert (beyond is None) is (given is None)
    excluded = excluded if beyond is None else excluded | beyond
    index = np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), -1)
    centers_floor = transform_points(T_floor_grid, (index + 0.5) * grid.voxel_size_m)
    around = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)
    own, other = (
        {tuple(c) for c in (cells[:, None] + around).reshape(-1, 3).tolist()}
        for cells in (found.object_cells, found.other_cells)
    )
    cells = np.floor(centers_floor / 0.03).astype(int).reshape(-1, 3).tolist()
    expected = np.array([tuple(c) in other and tuple(c) not in own for c in cells]).reshape(grid.shape)
    if given is not None:
        expected |= ~given.contains(centers_floor)
    assert (excluded != expected).mean() < 1e-4
    assert 0.01 < excluded.mean() < 0.99


# --- masks


def test_agreement_tolerance_is_the_larger_of_five_sigma_and_the_setting() -> None:
    rendered = np.array([[1.0, 1.0, 1.0, 1.0, 0.0, 2.5, 2.5]], np.float32)
    sigma = depth_sigma_m(2.5)
    assert 5 * sigma > 0.03
    measured = np.array([[1.029, 1.031, 0.971, 0.0, 1.0, 2.5 + 4.9 * sigma, 2.5 - 5.1 * sigma]], np.float32)
    expected = [[True, False, True, False, False, True, False]]
    np.testing.assert_array_equal(agreement_mask(measured, rendered, 0.03), expected)


@pytest.mark.parametrize("beside_px", [0, 1, 2])
def test_agreement_with_pixels_beside(beside_px: int) -> None:
    rng = np.random.default_rng(0)
    measured, rendered = rng.choice([0, 1, 1.02, 1.5, 2], (2, 12, 17)).astype(np.float32)
    found = agreement_mask(measured, rendered, 0.03, beside_px)
    for (row, column), agrees in np.ndenumerate(found):
        near = rendered[max(row - beside_px, 0) : row + beside_px + 1]
        near = near[:, max(column - beside_px, 0) : column + beside_px + 1]
        close = (near > 0) & (np.abs(near - measured[row, column]) <= 0.03)
        assert agrees == (measured[row, column] > 0 and close.any())
    assert found.any() and not found.all()


def test_depth_that_wandered_along_an_edge_is_the_objects() -> None:
    """A post before a chair's back: up to two pixels beside it the sensor took the one for the other."""
    rendered = np.full((5, 9), 2.0, np.float32)
    rendered[:, 4] = 1.5
    measured = np.full((5, 9), 2.0, np.float32)
    measured[:, [1, 2, 3, 6]] = 1.5
    measured[0, 8] = 3.0
    mask = object_mask(measured, rendered, np.full((5, 9), 0.5, np.float32), 0.03, 0.01)
    expected = np.ones((5, 9), bool)
    expected[:, 1] = expected[0, 8] = False
    np.testing.assert_array_equal(mask, expected)


def test_the_fringe_of_a_mask() -> None:
    """A pixel beside the silhouette is the object's if its depth agrees and it is clear of the floor."""
    rendered = np.zeros((5, 7), np.float32)
    rendered[1:4, 1:3] = 1.0
    measured = np.full((5, 7), 1.0, np.float32)
    measured[1, 3] = 1.2  # what lies behind
    measured[2, 1] = 1.2  # inside the silhouette, but not of the object
    measured[3, 3] = 0.0
    heights = np.full((5, 7), 0.5, np.float32)
    heights[4] = 0.01  # the floor at its foot
    expected = np.zeros((5, 7), bool)
    expected[0:4, 0:4] = True
    expected[1, 3] = expected[2, 1] = expected[3, 3] = False
    np.testing.assert_array_equal(object_mask(measured, rendered, heights, 0.03, 0.02), expected)
    # Farther off the floor's own noise is larger: 25 mm are clear of it at 1 m, not at 3 m.
    heights[:] = 0.025
    far, near = (object_mask(z * measured, z * rendered, heights, 0.03, 0.02) for z in (3, 1))
    assert near[0, 0] and not far[0, 0] and far[1, 1]
    heights[4] = 0.015
    assert not object_mask(measured, rendered, heights, 0.03, 0.02)[4, 1]
    assert object_mask(measured, rendered, heights, 0.03, 0.01)[4, 1]
    # Where the object was drawn but the floor was measured, the floor is.
    heights[3, 1:3] = [0.0015, 0.0025]
    np.testing.assert_array_equal(object_mask(measured, rendered, heights, 0.03, 0.02)[3, 1:3], [False, True])


def test_inner_silhouette_is_two_pixels_smaller() -> None:
    rendered = np.zeros((20, 30), np.float32)
    rendered[4:16, 5:25] = 1.3
    rendered[10, 15] = 0  # a hole grows by two pixels as well
    expected = np.zeros((20, 30), bool)
    expected[6:14, 7:23] = True
    expected[8:13, 13:18] = False
    np.testing.assert_array_equal(inner_silhouette(rendered), expected)


def save(path: Path, mask: np.ndarray) -> None:
    assert cv2.imwrite(str(path), mask.astype(np.uint8) * 255)


@pytest.mark.parametrize("name", ["003", "frame_000024", "frame_24"])
def test_overrides_replace_add_and_take_away(name: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    automatic, replaced, include, exclude = rng.random((4, 12, 16)) < 0.5

    def overridden(view: str = "003", frame: int = 24) -> np.ndarray:
        return override_mask(automatic, read_masks(tmp_path), view, frame)

    np.testing.assert_array_equal(overridden(), automatic)
    save(tmp_path / f"{name}.include.png", include)
    np.testing.assert_array_equal(overridden(), automatic | include)
    save(tmp_path / f"{name}.exclude.png", exclude)
    np.testing.assert_array_equal(overridden(), (automatic | include) & ~exclude)
    save(tmp_path / f"{name}.png", replaced)
    np.testing.assert_array_equal(overridden(), (replaced | include) & ~exclude)
    np.testing.assert_array_equal(overridden("004", 3), automatic)


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_label_of_1_is_the_object(tmp_path: Path, dtype: type, channels: int) -> None:
    drawn = np.zeros((12, 16), bool)
    drawn[3:7, 4:9] = True
    pixels: NDArray[np.uint8 | np.uint16] = drawn.astype(dtype)
    if channels > 1:  # the faintest blue, and opaque everywhere
        pixels = np.stack([pixels, 0 * pixels, 0 * pixels, 0 * pixels + 255][:channels], axis=2)
    assert cv2.imwrite(str(tmp_path / "003.png"), pixels)
    read = override_mask(np.zeros((12, 16), bool), read_masks(tmp_path), "003", 24)
    np.testing.assert_array_equal(read, drawn)
    np.testing.assert_array_equal(decode_mask((tmp_path / "003.png").read_bytes(), "003.png"), drawn)


def test_two_masks_of_one_image_are_refused(tmp_path: Path) -> None:
    for name in ("003.exclude.png", "frame_24.exclude.png"):
        save(tmp_path / name, np.ones((12, 16), bool))
    with raises(SegmentationError, "segmentation.bad-mask", match="frame_24.exclude.png and 003.exclude.png"):
        override_mask(np.ones((12, 16), bool), read_masks(tmp_path), "003", 24)


def test_files_that_are_no_views_mask(tmp_path: Path) -> None:
    for name in ("000.png", "001.exclude.png", "000.PNG", "001.includes.png", "7.png", "002.jpg", ".cache"):
        (tmp_path / name).touch()
    for name in ("frame_7.png", "frame_8.exclude.png", "frame_x.png", "masks.json"):
        (tmp_path / name).touch()
    *stray, waiting = unused_masks(read_masks(tmp_path), {"000": 4, "001": 7, "002": 5})
    assert [Path(line.split(": ")[0]).name for line in stray] == sorted(
        ["000.PNG", "001.includes.png", "7.png", "002.jpg", "frame_x.png"]
    )
    assert waiting.endswith("not used, as their frames are no views: frame_8.exclude.png")


def test_override_of_another_size(tmp_path: Path) -> None:
    save(tmp_path / "000.png", np.ones((24, 32), bool))
    with raises(SegmentationError, "segmentation.mask-size", match=r"000\.png.*32x24.*16x12.*depth"):
        override_mask(np.ones((12, 16), bool), read_masks(tmp_path), "000", 0)


@pytest.mark.parametrize("content", [b"", b"not a picture", b"\x89PNG\r\n\x1a\n\x00\x00\x00\x0dIHDR"])
def test_damaged_override(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "000.exclude.png").write_bytes(content)
    with raises(SegmentationError, "segmentation.bad-mask", match=r"000\.exclude\.png.*not"):
        override_mask(np.ones((12, 16), bool), read_masks(tmp_path), "000", 0)


# --- render


def test_rendered_rectangle_is_analytic_at_pixel_centres() -> None:
    vertices = np.array([[-0.4, -0.3, 0.1], [0.4, -0.3, 0.1], [0.4, 0.3, 0.1], [-0.4, 0.3, 0.1]])
    renderer = DepthRenderer(TriangleMesh(vertices, np.array([[0, 1, 2], [0, 2, 3]], np.int32)))
    T = look_at(np.array([0.5, -0.9, 0.9]), np.array([0.0, 0.0, 0.1]))
    rays = CAMERA.rays() @ T[:3, :3].T
    t = (0.1 - T[2, 3]) / rays[..., 2]
    at = T[:3, 3] + t[..., None] * rays
    slack = np.minimum(0.4 - np.abs(at[..., 0]), 0.3 - np.abs(at[..., 1]))
    depth_m = renderer.depth_m(CAMERA, T)
    assert depth_m.dtype == np.float32 and depth_m.shape == (240, 320)
    np.testing.assert_allclose(depth_m[slack > 1e-5], t[slack > 1e-5], rtol=3e-6)
    assert not depth_m[slack < -1e-5].any()
    assert (slack > 0).sum() > 5000


def test_rendered_sphere_has_no_half_pixel_shift() -> None:
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=6, radius=0.2)
    renderer = DepthRenderer(
        TriangleMesh(ball.vertices + np.array([0.05, 0, 0]), ball.faces.astype(np.int32))
    )
    T = look_at(np.array([0.3, -1.0, 0.4]), np.zeros(3))
    exact = depth_of([sphere((0.05, 0, 0), 0.2)], CAMERA, T)
    depth_m = renderer.depth_m(CAMERA, T)
    both = (depth_m > 0) & (exact > 0)
    assert both.sum() > 5000
    assert ((depth_m > 0) != (exact > 0)).sum() < 30
    centre = [np.argwhere(image > 0).mean(axis=0) for image in (depth_m, exact)]
    np.testing.assert_allclose(centre[0], centre[1], atol=0.02)  # pixels
    assert np.median(np.abs(depth_m - exact)[both]) < 5e-5
