"""Estimate how well an attacker can rebuild held-back truth from an object's public views, as an IoU.

Anybody can register the views with each other. No registration finds better poses than the true ones, so a
solid carved from the views at their true poses shows about what an attack can reach.
benchmarks/scoring/held_back_attack.py compares both: registered views of a real cabinet were 0.02 below this
IoU (8 views) and 0.01 above it (5 views).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinectbench.core import images
from kinectbench.core.artefacts.benchmark import RecordingInfo
from kinectbench.core.even_choice import spread
from kinectbench.core.geometry import Camera, Grid, depth_sigma_m, invert_rigid, transform_points
from kinectbench.core.types import MM_PER_M, Bools, Float32, Float64
from kinectbench.core.voxels.convex_hull import filled_hull
from kinectbench.core.voxels.pair_file import BLOCK, Pair, unpack
from kinectbench.core.voxels.view_grids import depth_cells

# Number of views, evenly spread, whose cubes are filled. For 8 views of a real cabinet, the means over 4
# cubes and over all differ by at most 0.01, and 4 take 8 s of two shared cores.
CUBES = 4
# A cell is empty only if more than one in this many views sees through it, since depth may be wrong at a
# pixel. For 8 views of a real cabinet, carved within their hull, requiring a single view gives an IoU of
# 0.84, more than one view 0.96.
VIEWS_PER_ERROR = 8
# Selects the cell that represents each block of a cube.
MIDDLE = slice(BLOCK // 2, None, BLOCK)
# Decimals of a figure that says "up to about", from a few cubes.
DECIMALS = 2


@dataclass(frozen=True)
class PosedView:
    """One view and its camera's pose.

    Attributes:
        depth_m: (height, width) float32, metres, 0 = none.
        mask: (height, width) bool, the object.
        camera: the depth camera.
        T_world_camera: (4, 4), metres.
    """

    depth_m: Float32
    mask: Bools
    camera: Camera
    T_world_camera: Float64


def attack_line(infos: Mapping[str, RecordingInfo]) -> str | None:
    """Return a warning with the highest IoU of a rebuilt object, and the remedy; None if none was rebuilt."""
    results = {
        name: (info.rebuilt_iou, info.rebuilt_single_iou)
        for name, info in infos.items()
        if info.rebuilt_iou is not None
    }
    if not results:
        return None
    name = max(results, key=lambda each: results[each])
    most, single = results[name]
    return (
        f"the public views of a held-back object, registered with each other, rebuild its truth up to an IoU "
        f"of {most:.2f} ({name}; one view alone: {single:.2f}; `rebuilt_iou` in benchmark.json has all): "
        "`publish --hold-back … --isolate` publishes one view of each"
    )


def read_posed_view(folder: Path, view: str, camera: Camera, T_world_camera: Float64) -> PosedView:
    """Read a view from a folder of views, with its camera pose.

    Raises:
        StorageError: an image is damaged.
    """
    depth_mm = images.read_gray(folder / f"{view}.depth.png")
    mask = images.read_gray(folder / f"{view}.mask.png") > 0
    return PosedView(depth_mm.astype(np.float32) / np.float32(MM_PER_M), mask, camera, T_world_camera)


def attack_ious(views: Mapping[str, PosedView], pair_of: Callable[[str], Pair]) -> tuple[float, float]:
    """Return the IoU of an object rebuilt from its public views, by the best method of `solids`.

    `pair_of` returns the complete pair of a view, given its name.

    Returns:
        Two IoUs with the truth on known cells: of the solid rebuilt from all views, and of the solid rebuilt
        from one view alone. Both are means over the cubes of some views; the one view is that of the cube.
    """
    pairs = {name: pair_of(name) for name in spread(sorted(views), CUBES)}
    every = [_ious_in_cube(pair, list(views.values())) for pair in pairs.values()]
    single = [_ious_in_cube(pair, [views[name]]) for name, pair in pairs.items()]
    iou, single_iou = (round(float(np.mean(ious, axis=0).max()), DECIMALS) for ious in (every, single))
    return iou, single_iou


def _ious_in_cube(pair: Pair, views: Sequence[PosedView]) -> list[float]:
    """Return the IoU with the truth, in a pair's cube, of each of the three `solids` made from the views."""
    return [sampled_known_iou(solid, pair) for solid in solids(pair.grid, views)]


def sampled_known_iou(solid: Bools, pair: Pair) -> float:
    """Return the IoU of a solid (64, 64, 64) and the truth sampled by `every_fourth`, on known cells only.

    It is 1 if both are empty.
    """
    full, known = every_fourth(unpack(pair.full)), every_fourth(unpack(pair.known))
    union = int(((solid | full) & known).sum())
    return int((solid & full & known).sum()) / union if union else 1.0


def every_fourth(cells: Bools) -> Bools:
    """Sample a grid (256, 256, 256): return (64, 64, 64), one cell of each block of 4 x 4 x 4."""
    return cells[MIDDLE, MIDDLE, MIDDLE]


def solids(grid: Grid, views: Sequence[PosedView]) -> tuple[Bools, Bools, Bools]:
    """Return three solids from some views: carved, convex hull of the points, intersection of both.

    A view sees through a cell that projects outside its mask, or lies in front of its depth. Carving empties
    a cell if more than one view in eight sees through it. A view never sees through cells outside its image.

    Args:
        grid: the grid of a pair, 256 cells a side.
        views: the views, at least one.

    Returns:
        Three (64, 64, 64) bool grids, sampled by `every_fourth`.
    """
    side = np.arange(grid.shape[0])[MIDDLE]
    cells = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    centres = transform_points(grid.T_world_grid, (cells + 0.5) * grid.voxel_size_m)
    votes, occupied = np.zeros(len(centres), np.int64), np.zeros(grid.shape, np.bool_)
    for view in views:
        votes += _seen_through(centres, view, grid.voxel_size_m)
        cells = depth_cells(view.depth_m, view.mask, view.camera, view.T_world_camera, grid)
        inside = ((cells >= 0) & (cells < grid.shape)).all(axis=1)
        occupied[tuple(cells[inside].T)] = True
    hull = every_fourth(filled_hull(occupied))
    carved = (votes <= len(views) // VIEWS_PER_ERROR).reshape(hull.shape)
    return carved, hull, carved & hull


def _seen_through(points_world: Float64, view: PosedView, margin_m: float) -> Bools:
    """Return (n,) bool: which points (n, 3) project outside a view's mask, or lie in front of its depth.

    A point lies in front if it is nearer by more than `margin_m` and the depth's noise. Points that project
    outside the image are False.
    """
    points = transform_points(invert_rigid(view.T_world_camera), points_world)
    ahead = np.where(points[:, 2:] > 0, points, np.array([0.0, 0.0, 1.0]))
    column, row = np.rint(view.camera.project(ahead)).T.astype(np.int64)
    width, height = view.camera.width, view.camera.height
    inside = (points[:, 2] > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    column, row = np.where(inside, column, 0), np.where(inside, row, 0)
    depth_m, masked = view.depth_m[row, column], view.mask[row, column]
    before = points[:, 2] < depth_m - margin_m - 2 * depth_sigma_m(depth_m)
    return np.asarray(inside & (~masked | ((depth_m > 0) & before)))
