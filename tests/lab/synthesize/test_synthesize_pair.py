"""Depth, cells and pairs of one model: against analytic shapes and the plain rules."""

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from references import occupy, shell_of
from synthesis_shapes import asymmetric, inside_asymmetric, mesh_of, open_box

from kinectbench.core.geometry import Grid, TriangleMesh, rigid, transform_points
from kinectbench.core.voxels.pair_file import Pair, pair_bytes, unpack
from kinectbench.core.voxels.resample import reduce_blocks
from kinectbench.core.voxels.seen_cells import seen_cells
from kinectbench.core.voxels.view_grids import depth_cells, object_cube, partial_grids
from kinectbench.lab.synthesize.make import make_synthetic_pair
from kinectbench.lab.synthesize.mesh_check import CheckedMesh, as_seeable, check_mesh
from kinectbench.lab.synthesize.models import SynthesisSettings
from kinectbench.lab.synthesize.views import DepthCamera, ViewAngles, all_views, camera_pose, virtual_camera
from kinectbench.release.check.view_check import pair_problems

SETTINGS = SynthesisSettings(up="y")
CAMERA = virtual_camera(320)
VIEW = ViewAngles((1, 2, 4), 6)


def made(
    shape: trimesh.Trimesh, view: ViewAngles = VIEW, settings: SynthesisSettings = SETTINGS
) -> tuple[Pair, str | None]:
    checked = check_mesh(mesh_of(shape), 10**6)
    return make_synthetic_pair(checked, DepthCamera(checked.mesh, CAMERA), view, settings)


def pair_of(shape: trimesh.Trimesh, view: ViewAngles = VIEW) -> Pair:
    pair, refused = made(shape, view)
    assert refused is None
    return pair


@pytest.fixture(scope="module")
def pair() -> Pair:
    return pair_of(asymmetric())


@pytest.fixture(scope="module")
def seen() -> tuple[np.ndarray, np.ndarray, Grid]:
    """Depth of the asymmetric shape, the camera's pose, and its cube."""
    mesh = mesh_of(asymmetric())
    pose = camera_pose(mesh.vertices, VIEW, CAMERA, "y")
    return DepthCamera(mesh, CAMERA).depth_m(pose), pose, object_cube(mesh.vertices, pose)


def test_depth_of_a_ball_through_integer_pixel_centres() -> None:
    ball = trimesh.creation.icosphere(6, radius=0.5)
    pose = rigid(np.eye(3), [0.03, -0.02, -1.5])
    depth_m = DepthCamera(mesh_of(ball), CAMERA).depth_m(pose)
    rays = CAMERA.rays()
    along = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    middle = along @ -pose[:3, 3]
    gap = middle**2 - (pose[:3, 3] @ pose[:3, 3] - 0.25)
    expected = np.where(gap > 0, (middle - np.sqrt(np.maximum(gap, 0))) * along[..., 2], 0)
    sure = np.abs(gap) > 1e-3
    np.testing.assert_array_equal((depth_m > 0)[sure], (gap > 0)[sure])
    # The facets of the ball lie up to 0.1 mm within it; half a pixel aside would be 2 mm at its border.
    np.testing.assert_allclose(depth_m[sure], expected[sure], atol=6e-4)


def test_partial_is_depth_voxelised_and_reduced_by_any(
    seen: tuple[NDArray[np.float32], NDArray[np.float64], Grid],
) -> None:
    depth_m, pose, grid = seen
    fine, coarse = partial_grids(depth_m, CAMERA, pose, grid)
    expected = occupy(depth_cells(depth_m, depth_m > 0, CAMERA, pose, grid), grid.shape)
    # A point on the border of two cells may be rounded into either.
    assert np.count_nonzero(unpack(fine) != expected) <= 0.002 * expected.sum()
    np.testing.assert_array_equal(unpack(coarse), reduce_blocks(unpack(fine), "any"))


def test_visible_cells_are_those_before_the_depth_of_their_pixel(
    seen: tuple[NDArray[np.float32], NDArray[np.float64], Grid],
) -> None:
    depth_m, pose, grid = seen
    cells = unpack(seen_cells(depth_m, CAMERA, pose, grid, noisy=False))
    index = np.random.default_rng(0).integers(0, 256, (200_000, 3))
    centres = transform_points(grid.T_world_grid, (index + 0.5) * grid.voxel_size_m)
    points = (centres - pose[:3, 3]) @ pose[:3, :3]
    u, v = np.rint(CAMERA.project(points)).astype(int).T
    reach = np.where(depth_m > 0, depth_m.astype(float) + grid.voxel_size_m, 0)[
        np.clip(v, 0, 319), np.clip(u, 0, 319)
    ]
    expected = (points[:, 2] <= reach) & (u >= 0) & (u < 320) & (v >= 0) & (v < 320)
    np.testing.assert_array_equal(cells[tuple(index.T)], expected)
    assert 0.05 < expected.mean() < 0.95


def test_cells_outside_the_image_are_not_seen(
    seen: tuple[NDArray[np.float32], NDArray[np.float64], Grid],
) -> None:
    depth_m, pose, grid = seen
    near = Grid(grid.shape, grid.voxel_size_m, pose @ rigid(np.eye(3), [-0.5, -0.5, 0.05]))
    everywhere = np.full_like(depth_m, 9)
    cells = unpack(seen_cells(everywhere, CAMERA, pose, near, noisy=False))
    z = 0.05 + 0.5 * near.voxel_size_m
    x = -0.5 + (np.arange(256) + 0.5) * near.voxel_size_m
    u = np.rint(CAMERA.fx * x / z + CAMERA.cx)
    np.testing.assert_array_equal(cells[:, 128, 0], (u >= 0) & (u < 320))
    assert not cells[0, 128, 0] and cells[128, 128].all()


@pytest.mark.parametrize("off_m", [1e2, 8e3])
def test_a_model_far_from_its_origin_has_the_same_pair(off_m: float, pair: Pair) -> None:
    """Rays are cast in float32, whose steps 8 km off are 0.5 mm; a cell has 3.8 mm."""
    far = asymmetric()
    far.apply_translation([off_m, -off_m, 0])
    moved = pair_of(far)
    for name in ("partial_256", "full", "seen"):
        here, there = unpack(getattr(pair, name)), unpack(getattr(moved, name))
        assert np.count_nonzero(here != there) <= 0.002 * np.count_nonzero(here), name


def test_full_is_the_shape_in_the_views_axes(pair: Pair) -> None:
    index = np.random.default_rng(0).integers(0, 256, (500_000, 3))
    centres = transform_points(pair.T_world_grid, (index + 0.5) * pair.voxel_size_m)
    inside = inside_asymmetric(centres)
    assert np.count_nonzero(unpack(pair.full)[tuple(index.T)] != inside) <= 1 and inside.sum() > 10_000
    np.testing.assert_array_equal(pair.shell, shell_of(unpack(pair.full)))
    assert unpack(pair.known).all() and pair.surface_sigma_m == 0 and pair.occupancy_rule == "winding"


def test_a_pair_passes_the_checks_of_a_release(pair: Pair) -> None:
    problems = pair_problems(pair, min_containment=0.999, framing="object", partial_rule="any")
    assert list(problems) == []
    partial = unpack(pair.partial)
    assert partial.sum() > 500 and (unpack(pair.seen)[unpack(pair.partial_256)]).mean() > 0.98


def test_the_longest_side_spans_252_cells_of_256(pair: Pair) -> None:
    used = [np.flatnonzero(unpack(pair.full).any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1))]
    assert max(line[-1] - line[0] + 1 for line in used) == 252
    assert all(abs(line[0] + line[-1] - 255) <= 1 for line in used)


def test_the_partial_has_no_sampling_holes() -> None:
    """A wall seen face on: every 64-cell of its front is hit, at the far side of the image too."""
    wall = trimesh.creation.box([1.0, 1.0, 0.02])
    front = pair_of(wall, ViewAngles((0, 0, 0), 5))
    covered = reduce_blocks(unpack(front.full), "any").any(axis=2)
    assert covered.sum() == 64**2
    np.testing.assert_array_equal(unpack(front.partial).any(axis=2), covered)


def test_an_open_mesh_is_filled_by_the_authors_rule() -> None:
    pair = pair_of(open_box(), ViewAngles((0, 0, 0), 5))
    assert pair.occupancy_rule == "six-rays"
    # Walls of one or two cells, not the box's volume.
    volume = unpack(pair.full).sum() * pair.voxel_size_m**3
    area = open_box().area
    assert 0.8 * area * pair.voxel_size_m < volume < 2.5 * area * pair.voxel_size_m < 0.2 * 0.06


def test_a_seeable_solid_holds_what_no_camera_could_see() -> None:
    """A box upside down, open below: its inside is of the object as it stands on its rim, not on its side."""
    walls = trimesh.boolean.difference(
        [
            trimesh.creation.box([0.5, 0.4, 0.6]),
            trimesh.creation.box(bounds=[[-0.2, -0.3, -0.25], [0.2, 0.15, 0.25]]),
        ]
    )
    checked = check_mesh(mesh_of(walls), 10**6)
    eye = DepthCamera(checked.mesh, CAMERA)
    view = ViewAngles((0, 0, 0), 6)
    by = {
        "mesh": make_synthetic_pair(checked, eye, view, SETTINGS)[0],
        "standing": make_synthetic_pair(as_seeable(checked, "y"), eye, view, SETTINGS)[0],
        "lying": make_synthetic_pair(as_seeable(checked, "z"), eye, view, SynthesisSettings(up="z"))[0],
    }
    hollow = (0.4 * 0.35 * 0.5) / (0.5 * 0.4 * 0.6)
    box = 1 / by["mesh"].voxel_size_m ** 3 * 0.5 * 0.4 * 0.6
    shares = {name: unpack(pair.full).sum() / box for name, pair in by.items()}
    assert shares["mesh"] == pytest.approx(1 - hollow, abs=0.01)
    assert shares["standing"] == pytest.approx(1, abs=0.01)
    assert shares["lying"] == pytest.approx(1 - hollow, abs=0.02)
    assert {name: pair.occupancy_rule for name, pair in by.items()} == {
        "mesh": "winding", "standing": "seeable", "lying": "seeable",
    }  # fmt: skip
    assert not list(pair_problems(by["standing"], min_containment=0.85, framing="object", partial_rule="any"))


def test_an_open_mesh_has_no_seeable_solid() -> None:
    checked = as_seeable(check_mesh(mesh_of(open_box()), 10**6), "y")
    assert (checked.rule, checked.seeable) == ("six-rays", None)
    assert checked.notes[-1] == "is not closed: what a camera could see of it is not asked"


def test_walls_thinner_than_a_cell_are_refused() -> None:
    sheet = mesh_of(trimesh.creation.box([1.0, 1.0, 1e-5]))
    checked = CheckedMesh(TriangleMesh(sheet.vertices, sheet.faces), "winding")
    eye = DepthCamera(checked.mesh, CAMERA)
    reasons = {make_synthetic_pair(checked, eye, view, SETTINGS)[1] for view in all_views(2)}
    assert reasons and all(reason for reason in reasons)


def test_the_cube_of_framing_view_tells_nothing_of_the_hidden_part() -> None:
    """Two boxes that look alike from the front, one of them twice as deep: the same cube before both."""
    settings = SynthesisSettings(up="y", framing="view")
    front = ViewAngles((0, 0, 0), 5)
    pairs = []
    for depth in (0.2, 0.4):
        shape = trimesh.creation.box([1.0, 1.0, depth])
        shape.apply_translation([0, 0, -depth / 2])  # fronts at z = 0
        pair, refused = made(shape, front, settings)
        assert refused is None and pair.framing == "view"
        assert list(pair_problems(pair, min_containment=0.99, framing="view", partial_rule="any")) == []
        pairs.append(pair)
    assert pairs[0].voxel_size_m * 256 == pytest.approx(1.4, rel=0.02)
    assert pairs[0].voxel_size_m == pytest.approx(pairs[1].voxel_size_m, rel=0.02)
    assert unpack(pairs[1].full).sum() == pytest.approx(2 * unpack(pairs[0].full).sum(), rel=0.05)


def test_a_view_whose_cube_cuts_the_shape_is_refused() -> None:
    beam = trimesh.creation.box([0.1, 0.1, 1.0])
    _, refused = made(beam, ViewAngles((0, 0, 0), 5), SynthesisSettings(up="y", framing="view"))
    assert refused is not None and "cuts off" in refused
    assert made(beam, ViewAngles((0, 0, 0), 5))[1] is None


def test_noise_is_that_of_the_simulated_kinect(pair: Pair) -> None:
    """Depth differs from the exact one by the sensor's sigma; shape and cube are the same."""
    noisy = SETTINGS.model_copy(update={"noise": "kinect"})
    shape = asymmetric()
    measured, refused = made(shape, settings=noisy)
    assert refused is None
    np.testing.assert_array_equal(measured.full, pair.full)
    np.testing.assert_array_equal(measured.T_world_grid, pair.T_world_grid)
    again, _ = made(shape, settings=noisy)
    assert pair_bytes(again) == pair_bytes(measured) != pair_bytes(pair)
    mesh = mesh_of(shape)
    pose = camera_pose(mesh.vertices, VIEW, CAMERA, "y")
    eye = DepthCamera(mesh, CAMERA)
    exact_m, kinect_m = eye.depth_m(pose), eye.kinect_depth_m(pose, np.random.default_rng(1))
    both = (exact_m > 0) & (kinect_m > 0)
    assert 0.5 < both.sum() / (exact_m > 0).sum() < 1
    # Nguyen et al. 2012: 1.2 mm + 1.9 mm/m^2 (z - 0.4 m)^2 face on; slanted and at edges more.
    sigma_m = 0.0012 + 0.0019 * (exact_m[both] - 0.4) ** 2
    spread = np.median(np.abs(kinect_m[both] - exact_m[both])) / 0.6745
    assert 0.7 < spread / np.median(sigma_m) < 2
    other = eye.kinect_depth_m(pose, np.random.default_rng(2))
    assert (other != kinect_m).any()


def test_without_noise_the_stored_settings_are_as_before() -> None:
    noisy = SETTINGS.model_copy(update={"noise": "kinect"})
    assert "noise" not in SETTINGS.stored(set()) and noisy.stored({"models"})["noise"] == "kinect"
    assert SETTINGS.stored(set()) == SETTINGS.model_dump(mode="json", exclude={"noise"})


def test_what_a_kinect_cannot_measure_is_refused_in_words() -> None:
    """A model in millimetres is hundreds of metres away."""
    large = asymmetric()
    large.apply_scale(1000)
    _, refused = made(large, settings=SETTINGS.model_copy(update={"noise": "kinect"}))
    assert refused is not None and "give models in metres" in refused


def test_a_needle_of_which_one_pixel_is_seen_is_refused() -> None:
    """Seen along its length, it makes a cube of framing view without a side."""
    needle = trimesh.creation.box([0.004, 0.004, 1.0])
    needle.apply_translation([0.002, 0.002, 0])
    settings = SynthesisSettings(up="y", framing="view")
    _, refused = made(needle, ViewAngles((0, 0, 0), 5), settings)
    assert refused == "the camera sees nothing of the shape"
