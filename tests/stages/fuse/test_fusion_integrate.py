"""The fusion kernel against plain numpy and against Open3D's VoxelBlockGrid."""

from typing import Any

import numpy as np
import pytest
from analytic_scenes import CAMERA, box, depth_of, plane, sphere
from numpy.typing import NDArray
from slow import slow

from kinectbench.core.geometry import (
    Camera,
    Grid,
    invert_rigid,
    rigid,
    rotation_from_quaternion_xyzw,
    transform_points,
)
from kinectbench.core.geometry.depth import depth_sigma_m
from kinectbench.core.voxels.observation import FADING_VOXELS, HALF_DIAGONAL, HIDDEN_SHARE
from kinectbench.lab.simulate.path import look_at
from kinectbench.stages.fuse import integrate as integration
from kinectbench.stages.fuse.blocks import (
    BLOCK_VOXELS,
    BlockVolume,
    blocks_of_grid,
    dense_grid,
    empty_volume,
    in_cubes,
    unique_blocks,
)
from kinectbench.stages.fuse.integrate import (
    BATCH_FRAMES,
    BEFORE_FAR_M,
    CLEAR_SIGMAS,
    SURFACE_SIGMAS,
    WINDOW_SIGMAS,
    DepthFrame,
    integrate,
)
from kinectbench.stages.fuse.visible_blocks import CLEAR, SEEN, blocks_near_surface, visible_blocks

SMALL = Camera(48, 36, 40.0, 41.0, 23.2, 17.6)
VOXEL_M, TRUNCATION_M, POSE_SIGMA_M = 0.012, 0.06, 0.005
T_WORLD_GRID = rigid(rotation_from_quaternion_xyzw([0.1, 0.2, -0.1, 0.9]), [-0.3, -0.35, 0.6])


def voxel_centers_world(volume: BlockVolume) -> np.ndarray:
    inner = np.stack(np.meshgrid(*[np.arange(BLOCK_VOXELS)] * 3, indexing="ij"), axis=-1)
    indices = volume.blocks[:, None, None, None] * BLOCK_VOXELS + inner
    return transform_points(volume.T_world_grid, (indices + 0.5) * volume.voxel_size_m)


def slants(depth_m: np.ndarray) -> np.ndarray:
    """Pixel by pixel: 1 / cos of the surface's slant, from pixels two to either side; at most 10."""
    height, width = depth_m.shape
    result = np.empty((height, width))
    for v, u in np.ndindex(height, width):
        d = max(float(depth_m[v, u]), 1e-3)
        left, right = depth_m[v, max(u - 2, 0)], depth_m[v, min(u + 2, width - 1)]
        above, below = depth_m[max(v - 2, 0), u], depth_m[min(v + 2, height - 1), u]
        across = (float(right) - float(left)) / 4 * SMALL.fx / d
        down = (float(below) - float(above)) / 4 * SMALL.fy / d
        result[v, u] = min(np.sqrt(1 + across**2 + down**2), 10.0)
    return result


def reference(
    volume: BlockVolume,
    frames: list[tuple[NDArray[np.float32], NDArray[np.float64]]],
    farthest_m: float = np.inf,
    closely: bool = True,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """tsdf, weight, free, surface by the definitions; and where rounding to a pixel or vote is a toss-up."""
    centers = voxel_centers_world(volume)
    shape = centers.shape[:-1]
    total, weight = np.zeros(shape), np.zeros(shape)
    free, surface, tie = np.zeros(shape, int), np.zeros(shape, int), np.zeros(shape, bool)
    for depth_m, T_world_camera in frames:
        points = transform_points(invert_rigid(T_world_camera), centers)
        z = points[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            uv = SMALL.project(points)
        u, v = np.moveaxis(np.rint(np.where(z[..., None] > 1e-3, uv, -1)).astype(int), -1, 0)
        inside = (u >= 0) & (v >= 0) & (u < SMALL.width) & (v < SMALL.height)
        d = np.where(inside, depth_m[np.where(inside, v, 0), np.where(inside, u, 0)].astype(float), 0.0)
        sdf = d - z
        measured = (d > 0) & (sdf >= np.where(d <= farthest_m, -TRUNCATION_M, BEFORE_FAR_M))
        sigma = np.sqrt(depth_sigma_m(d) ** 2 + POSE_SIGMA_M**2)
        slant = slants(depth_m)[np.where(inside, v, 0), np.where(inside, u, 0)]
        added = np.where(measured, 1e-6 / (sigma * slant) ** 2, 0)
        margin = np.maximum(SURFACE_SIGMAS * sigma, HALF_DIAGONAL * VOXEL_M)
        window = np.maximum((WINDOW_SIGMAS if closely else 2) * sigma, HALF_DIAGONAL * VOXEL_M)
        beyond_voxels = (np.abs(sdf / slant) - window) / VOXEL_M
        clear = sdf / slant > (CLEAR_SIGMAS * sigma if closely else 0)
        faded = added * np.where(clear, 1, np.clip(1 - beyond_voxels / FADING_VOXELS, HIDDEN_SHARE, 1))
        total += faded * np.minimum(sdf, TRUNCATION_M)
        weight += faded
        free += measured & (sdf > margin)
        surface += measured & (sdf <= margin)
        tie |= (np.abs(uv - np.floor(uv) - 0.5) < 1e-3).any(-1) | (np.abs(z) < 5e-3)
        for limit in (-TRUNCATION_M, BEFORE_FAR_M, margin):
            tie |= np.abs(sdf - limit) < 1e-5
        tie |= np.abs(sdf / slant - CLEAR_SIGMAS * sigma) < 1e-5
    return np.where(weight > 0, total / np.maximum(weight, 1e-30), 0), weight, free, surface, tie


def random_frames(count: int) -> list[tuple[NDArray[np.float32], NDArray[np.float64]]]:
    """Depth without any smoothness and with holes: a neighbour's pixel would be noticed."""
    rng = np.random.default_rng(5)
    frames = []
    for _ in range(count):
        depth_m = rng.uniform(0.5, 1.6, (SMALL.height, SMALL.width)).astype(np.float32)
        depth_m[rng.random(depth_m.shape) < 0.2] = 0
        turn = rotation_from_quaternion_xyzw(np.append(rng.normal(0, 0.15, 3), 1.0))
        frames.append((depth_m, rigid(turn, rng.normal(0, 0.1, 3))))
    return frames


def fused(
    frames: list[tuple[NDArray[np.float32], NDArray[np.float64]]],
    farthest_m: float = np.inf,
    closely: bool = True,
) -> BlockVolume:
    blocks = blocks_of_grid(Grid((48, 32, 48), VOXEL_M, T_WORLD_GRID))
    volume = empty_volume(blocks, VOXEL_M, T_WORLD_GRID)
    posed = [
        DepthFrame(depth_m, T_world_camera, POSE_SIGMA_M, POSE_SIGMA_M, closely)
        for depth_m, T_world_camera in frames
    ]
    integrate(volume, posed, SMALL, TRUNCATION_M, farthest_m)
    return volume


@pytest.mark.parametrize(
    ("count", "farthest_m", "closely"),
    [(4, np.inf, True), (4, 1.2, True), (4, 1.2, False), (BATCH_FRAMES + 3, 1.2, True)],
)
def test_kernel_against_numpy(count: int, farthest_m: float, closely: bool) -> None:
    frames = random_frames(count)
    volume = fused(frames, farthest_m, closely)
    tsdf, weight, free, surface, tie = reference(volume, frames, farthest_m, closely)
    sure = ~tie
    assert sure.mean() > 1 - 0.005 * count
    assert (weight > 0).mean() > 0.3 and surface.sum() > 1000 and free.sum() > 1000
    np.testing.assert_array_equal(volume.free[sure], free[sure])
    np.testing.assert_array_equal(volume.surface[sure], surface[sure])
    np.testing.assert_allclose(volume.weight[sure], weight[sure], rtol=3e-4, atol=1e-8)
    np.testing.assert_allclose(volume.tsdf[sure], tsdf[sure], atol=5e-6)


@pytest.mark.parametrize(("farthest_m", "closely"), [(np.inf, True), (2.9, True), (2.9, False)])
def test_blocks_that_are_wholly_clear_get_the_same_bytes(
    farthest_m: float, closely: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = [(depth_m * np.float32(2), T_world_camera) for depth_m, T_world_camera in random_frames(20)]
    kinds: list[int] = []

    def none_clear(*args: Any) -> NDArray[np.uint8]:
        seen = visible_blocks(*args)
        kinds.extend(seen.tolist())
        return np.minimum(seen, np.uint8(SEEN))

    volume = fused(frames, farthest_m, closely)
    monkeypatch.setattr(integration, "visible_blocks", none_clear)
    one_by_one = fused(frames, farthest_m, closely)
    assert kinds.count(CLEAR) > 100 and kinds.count(SEEN) > 100
    for name in ("tsdf", "weight", "votes"):
        assert getattr(volume, name).tobytes() == getattr(one_by_one, name).tobytes(), name


def test_camera_inside_the_volume_fuses_nothing_behind_it() -> None:
    T_world_camera = rigid(np.eye(3), [0.1, 0.0, 1.0])
    frames = [(np.full((SMALL.height, SMALL.width), 0.3, np.float32), T_world_camera)]
    volume = fused(frames)
    behind = voxel_centers_world(volume)[..., 2] < 0.999
    assert behind.any() and not volume.weight[behind].any()
    _, weight, _, _, tie = reference(volume, frames)
    np.testing.assert_allclose(volume.weight[~tie], weight[~tie], rtol=3e-4, atol=1e-8)


@pytest.mark.parametrize("slant_deg", [0.0, 40.0, 70.0])
def test_weight_of_a_slanted_plane(slant_deg: float) -> None:
    """At the principal point the weight is (cos / sigma)^2, in 1/mm^2."""
    camera = Camera(49, 37, 120.0, 120.0, 24.0, 18.0)
    normal = (np.sin(np.radians(slant_deg)), 0.0, np.cos(np.radians(slant_deg)))
    depth_m = depth_of([plane(normal, 1.0 * normal[2])], camera, np.eye(4))
    grid = Grid((16, 16, 16), 0.004, rigid(np.eye(3), [-0.03, -0.03, 0.97]))
    volume = empty_volume(blocks_of_grid(grid), grid.voxel_size_m, grid.T_world_grid)
    integrate(volume, [DepthFrame(depth_m, np.eye(4), 0.0, 0.0)], camera, 0.02)
    weight = volume.weight[0, 7, 7, 7]  # the centre lies on the optical axis at 1 m
    sigma_mm = 1000 * depth_sigma_m(1.0)
    assert weight == pytest.approx((normal[2] / sigma_mm) ** 2, rel=0.02)


def test_frames_without_depth_change_nothing() -> None:
    volume = fused([(np.zeros((SMALL.height, SMALL.width), np.float32), np.eye(4))])
    for values in (volume.tsdf, volume.weight, volume.free, volume.surface):
        assert not values.any()


def test_the_order_of_frames_does_not_matter() -> None:
    frames = random_frames(3)
    one, other = fused(frames), fused(frames[::-1])
    np.testing.assert_array_equal(one.free, other.free)
    np.testing.assert_allclose(one.tsdf, other.tsdf, atol=1e-6)


@pytest.mark.parametrize("seed", [0, slow(1)])
def test_open3d_agrees(seed: int) -> None:
    """One frame, the same truncation; Open3D's voxels lie on integers and its pixels begin at integers."""
    import open3d as o3d

    voxel_m = 0.01
    eye = np.array([0.2 - 0.5 * seed, -1.3, 0.9])
    T_world_camera = look_at(eye, np.array([0.0, 0.0, 0.2]))
    surfaces = [sphere((0, 0, 0.2), 0.2), box((-0.5, -0.1, 0.0), (-0.2, 0.3, 0.4)), plane((0, 0, 1), 0.0)]
    depth_m = depth_of(surfaces, CAMERA, T_world_camera)
    tensor = o3d.core.Tensor.from_numpy
    theirs = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight"),
        (o3d.core.float32, o3d.core.float32),
        (o3d.core.SizeVector([1]), o3d.core.SizeVector([1])),
        voxel_m,
        16,
        2000,
    )
    K = CAMERA.K
    K[:2, 2] += 0.5
    image = o3d.t.geometry.Image(tensor(depth_m[..., None]))
    extrinsic = tensor(invert_rigid(T_world_camera))
    blocks = theirs.compute_unique_block_coordinates(image, tensor(CAMERA.K), extrinsic, 1.0, 2.5, 4.0)
    theirs.integrate(blocks, image, tensor(K), extrinsic, 1.0, 2.5, 4.0)
    centers, flat = theirs.voxel_coordinates_and_flattened_indices()
    flat = flat.numpy()
    tsdf = theirs.attribute("tsdf").numpy().reshape(-1)[flat]
    weight = theirs.attribute("weight").numpy().reshape(-1)[flat]

    index = np.rint(centers.numpy() / voxel_m).astype(np.int64)
    ours = empty_volume(
        unique_blocks(index // BLOCK_VOXELS), voxel_m, rigid(np.eye(3), np.full(3, -voxel_m / 2))
    )
    fused_depth_m = np.where(depth_m < 2.5, depth_m, np.float32(0))
    integrate(ours, [DepthFrame(fused_depth_m, T_world_camera, 0.0, 0.0)], CAMERA, 4 * voxel_m)
    row = {tuple(block): n for n, block in enumerate(ours.blocks.tolist())}
    b = np.array([row[tuple(block)] for block in (index // BLOCK_VOXELS).tolist()])
    at = (b, *(index % BLOCK_VOXELS).T)
    both = (ours.weight[at] > 0) & (weight > 0)
    assert both.sum() > 20_000
    # They leave out what projects beyond the last pixel's centre.
    assert ((ours.weight[at] > 0) == (weight > 0)).mean() > 0.995
    same = np.abs(ours.tsdf[at] / (4 * voxel_m) - tsdf)[both] < 1e-3
    assert same.mean() > 0.999  # the rest: pixels chosen differently where a projection falls on a border


def test_blocks_of_grid_and_dense_grid_are_inverse() -> None:
    grid = Grid((48, 16, 32), 0.01, np.eye(4))
    blocks = blocks_of_grid(grid)
    dense = np.arange(48 * 16 * 32).reshape(grid.shape)
    cut = np.stack([dense[x : x + 8, y : y + 8, z : z + 8] for x, y, z in blocks * 8])
    np.testing.assert_array_equal(dense_grid(cut, grid.shape), dense)
    volume = empty_volume(blocks, 0.01, np.eye(4))
    cube = volume.dense(cut, np.array([2, -2, 0], np.int32), 4)
    np.testing.assert_array_equal(cube[:, 16:, :], dense[16:48, :16, :])
    assert not cube[:, :16].any()


def test_in_cubes_puts_each_block_in_its_place() -> None:
    cubes = np.array([[-2, 0, 1], [3, -1, 0]], np.int32)
    blocks = (cubes[:, None] * 2 + np.array(list(np.ndindex(2, 2, 2)), np.int32)).reshape(-1, 3)
    voxels = np.stack(np.meshgrid(*[np.arange(BLOCK_VOXELS)] * 3, indexing="ij"), -1)
    keys = ((blocks[:, None, None, None] * BLOCK_VOXELS + voxels) @ [10**6, 10**3, 1]).astype(np.int64)
    shuffled = np.random.default_rng(0).permutation(16)[:15]
    back, values = in_cubes(blocks[shuffled], keys[shuffled])
    np.testing.assert_array_equal(back, cubes)
    whole = np.stack(np.meshgrid(*[np.arange(16)] * 3, indexing="ij"), -1)
    expected = (cubes[:, None, None, None] * 16 + whole) @ [10**6, 10**3, 1]
    assert (values == expected).mean() == 15 / 16 and not values[values != expected].any()


def test_unique_blocks_sorts_and_keeps_signs() -> None:
    rows = np.array([[3, -2, 1], [-1000, 5, 0], [3, -2, 1], [3, -3, 900]])
    np.testing.assert_array_equal(unique_blocks(rows), np.unique(rows, axis=0))


@pytest.mark.parametrize("near_share", [0.0, 0.7])
def test_blocks_near_a_surface_hold_the_truncation_band(near_share: float) -> None:
    """Of all points within the margin of a pixel's depth, at most 1 % lie in a block that was missed.

    Also of a frame that mostly shows something near.
    """
    T_world_camera = look_at(np.array([0.9, 0.6, 0.8]), np.zeros(3))
    depth_m = depth_of([sphere((0, 0, 0), 0.25), plane((0, 0, 1), -0.3)], CAMERA, T_world_camera)
    depth_m[depth_m > 3] = 0
    depth_m[:, : int(near_share * CAMERA.width)] = 0.5
    blocks = blocks_near_surface(depth_m, CAMERA, T_world_camera, 0.02, 0.005)
    found = {tuple(block) for block in blocks.tolist()}
    rays = CAMERA.rays()[depth_m > 0]
    missed, total = 0, 0
    for offset_m in np.linspace(-0.02, 0.02, 9):
        points = transform_points(T_world_camera, rays * (depth_m[depth_m > 0] + offset_m)[:, None])
        needed, counts = np.unique(np.floor(points / 0.04).astype(int), axis=0, return_counts=True)
        missing = [tuple(block) not in found for block in needed.tolist()]
        missed += counts[missing].sum()
        total += counts.sum()
    assert missed <= 0.01 * total


def test_blocks_behind_the_surface_are_left_out_and_no_others() -> None:
    """A near wall before a far one: what the plain reference changes is in blocks that count as visible."""
    depth_m = np.full((SMALL.height, SMALL.width), 1.5, np.float32)
    depth_m[:, :20] = 0.7
    volume = empty_volume(blocks_of_grid(Grid((96, 96, 96), VOXEL_M, T_WORLD_GRID)), VOXEL_M, T_WORLD_GRID)
    seen = np.flatnonzero(visible_blocks(volume, depth_m, SMALL, T_WORLD_GRID, TRUNCATION_M, np.zeros_like))
    _, weight, _, _, tie = reference(volume, [(depth_m, np.eye(4))])
    told_about = np.flatnonzero(((weight > 0) & ~tie).any(axis=(1, 2, 3)))
    assert set(told_about) <= set(seen)
    assert len(told_about) > 20
    assert len(seen) < 1.5 * len(told_about) < len(volume.blocks)


def test_votes_stop_at_what_they_can_hold() -> None:
    """65,535 each: one more of `free` would be one of `surface`, and one more of that would be none."""
    volume = empty_volume(np.zeros((1, 3), np.int32), VOXEL_M, rigid(np.eye(3), [-0.08, -0.08, 0.9]))
    frames = [DepthFrame(np.ones((36, 48), np.float32), np.eye(4), 0.0, 0.0)] * (2 * BATCH_FRAMES)
    integrate(volume, frames, SMALL, TRUNCATION_M)
    free, surface = volume.free.copy(), volume.surface.copy()
    assert set(np.unique(free)) == set(np.unique(surface)) == {0, len(frames)}
    volume.votes[:] = 65_530 | (65_530 << 16)
    integrate(volume, frames, SMALL, TRUNCATION_M)
    assert volume.free.tolist() == np.where(free > 0, 65_535, 65_530).tolist()
    assert volume.surface.tolist() == np.where(surface > 0, 65_535, 65_530).tolist()
