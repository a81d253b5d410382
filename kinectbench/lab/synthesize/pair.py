"""Make one synthetic pair, from the depth of a virtual camera and the full shape."""

import numpy as np

from kinectbench.core.geometry import Grid, transform_points
from kinectbench.core.voxels.open_mesh import voxelize_open
from kinectbench.core.voxels.pair_file import Packed, Pair, pack, unpack
from kinectbench.core.voxels.recgan_file import recgan_file_bytes
from kinectbench.core.voxels.seen_cells import seen_cells
from kinectbench.core.voxels.solid import packed_shell, voxelize_solid
from kinectbench.core.voxels.view_grids import (
    MAX_CUT_SHARE,
    containment,
    object_cube,
    partial_grids,
    view_cube,
)
from kinectbench.lab.synthesize.mesh_check import CheckedMesh
from kinectbench.lab.synthesize.models import SynthesisSettings
from kinectbench.lab.synthesize.views import DepthCamera, ViewAngles, camera_pose

VOXELIZERS = {"winding": voxelize_solid, "seeable": voxelize_solid, "six-rays": voxelize_open}
NOTHING_SEEN = "the camera sees nothing of the shape"
NOTHING_MEASURED = "a Kinect measures nothing of it, from 0.4 to 4.5 m; give models in metres"


def make_synthetic_pair(
    checked: CheckedMesh, eye: DepthCamera, view: ViewAngles, settings: SynthesisSettings, name: str = ""
) -> tuple[Pair, str | None]:
    """Render a model's depth in one view, and voxelise the visible part and the full shape in one cube.

    In framing `object` (the paper's), the cube is placed around the full shape's box in the view's axes; in
    framing `view`, it is placed around the visible part alone. The world frame is the model's own, in metres.
    All cells of a mesh are known. In a `SeeableSolid`, gaps that only a finer sensor could see into and walls
    thinner than a voxel are unknown. `surface_sigma_m` is 0.

    Args:
        checked: the model.
        eye: the virtual camera in front of the model.
        view: the orientation.
        settings: `up_axis`, `framing`, `noise`, `seed` and `min_containment` are used.
        name: the model's name; name, view and seed determine the noise.

    Returns:
        The pair, and the reason why it must not be used, or None if it may be used.
    """
    camera = eye.camera
    T_world_camera = camera_pose(eye.corners_world, view, camera, settings.up_axis)
    noisy = settings.noise != "none"
    rng = np.random.default_rng([settings.seed, view.n, *view.steps, *name.encode()])
    depth_m = eye.kinect_depth_m(T_world_camera, rng) if noisy else eye.depth_m(T_world_camera)
    whole = grid = object_cube(eye.corners_world, T_world_camera)
    # One pixel makes a cube without a side.
    is_seen = np.count_nonzero(depth_m) >= (2 if settings.framing == "view" else 1)
    if settings.framing == "view" and is_seen:
        grid = view_cube(camera.backproject(depth_m)[depth_m > 0], T_world_camera)
    full, known = _solid(checked, grid)
    cut_share = 0.0 if grid is whole else _cut_share(grid, checked, whole)
    partial_256, partial = partial_grids(depth_m, camera, T_world_camera, grid)
    pair = Pair(
        partial=partial,
        partial_256=partial_256,
        full=full,
        shell=packed_shell(full),
        known=known,
        seen=seen_cells(depth_m, camera, T_world_camera, grid, noisy=noisy),
        T_world_grid=grid.T_world_grid,
        T_world_camera=T_world_camera,
        K=camera.K,
        voxel_size_m=grid.voxel_size_m,
        surface_sigma_m=0.0,
        framing=settings.framing,
        partial_rule="any",
        occupancy_rule=checked.rule,
    )
    if not is_seen:
        return pair, NOTHING_MEASURED if noisy else NOTHING_SEEN
    return pair, _reason(pair, settings.min_containment, cut_share)


def _solid(checked: CheckedMesh, grid: Grid) -> tuple[Packed, Packed]:
    """Return two packed bit grids: the cells in the solid, and the known cells.

    Gaps that only a finer sensor could see into, and walls thinner than a voxel (`slit`), are not known.
    """
    full = VOXELIZERS[checked.rule](checked.mesh.vertices, checked.mesh.faces, grid)
    if checked.seeable is None:
        return full, np.full_like(full, 255)
    solid = checked.seeable
    closed, slit = (pack(solid.on(grid, which)) for which in (solid.closed & ~solid.slit, solid.slit))
    return full | closed, ~(slit & ~full)


def _cut_share(grid: Grid, checked: CheckedMesh, whole: Grid) -> float:
    """Return the share of the shape that lies outside the cube `grid`, 0 to 1.

    `whole` is a grid around the whole shape, on which the shape is sampled.
    """
    corners = transform_points(grid.T_grid_world, checked.mesh.vertices)
    side_m = grid.shape[0] * grid.voxel_size_m
    if corners.min() >= 0 and corners.max() <= side_m:
        return 0.0
    cells = np.argwhere(unpack(_solid(checked, whole)[0]))
    centres = transform_points(grid.T_grid_world @ whole.T_world_grid, (cells + 0.5) * whole.voxel_size_m)
    outside = ((centres < 0) | (centres > side_m)).any(axis=1)
    return float(outside.mean()) if len(cells) else 0.0


def _reason(pair: Pair, min_containment: float, cut_share: float) -> str | None:
    """Return the reason why a pair must not be used; None if it may be."""
    if cut_share > MAX_CUT_SHARE:
        return f"the cube of framing view cuts off {cut_share:.1%} of it, more than {MAX_CUT_SHARE:.0%}"
    if not pair.full.any():
        return "no cell's centre lies in the shape: its walls are thinner than a cell"
    if not pair.partial.any():
        return NOTHING_SEEN
    inside = containment(pair.partial, pair.full)
    if inside < min_containment:
        return f"containment is {inside:.3f}, below {min_containment}"
    return None


def recgan_bytes(pair: Pair) -> tuple[bytes, bytes]:
    """Return a pair as the 3D-RecGAN authors' two files: visible part and full shape, at 256^3 cells.

    Both are cropped to the bounding box of all cells that are set in either. The key is `arr_0`, int8,
    (x, y, z, 1), with x to the left and y up: the authors' back-projection is x = -(u - w/2) z / f,
    y = -(v - h/2) z / f, so their grid is ours with x and y reversed.
    """
    seen, full = unpack(pair.partial_256), unpack(pair.full)
    occupied = seen | full
    box = tuple(
        slice(int(used[0]), int(used[-1]) + 1)
        for used in (np.flatnonzero(occupied.any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1)))
    )
    return recgan_file_bytes(seen[box]), recgan_file_bytes(full[box])
