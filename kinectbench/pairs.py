"""The stage `pairs`: for each view the partial shape, and the full shape turned into the view's axes."""

from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.config import PairSettings
from kinectbench.geometry import Grid
from kinectbench.sequence import Sequence
from kinectbench.shape.labels import Label
from kinectbench.shape.object_model import ObjectModel
from kinectbench.views import View
from kinectbench.voxels.framing import object_cube, view_cube
from kinectbench.voxels.morphology import shell_of
from kinectbench.voxels.pair_file import Pair, pack, unpack
from kinectbench.voxels.resample import reduce_blocks
from kinectbench.voxels.solid import voxelize_solid
from kinectbench.voxels.view_grids import depth_cells, occupy, seen_cells

MAX_CUT_SHARE = 0.05
UNKNOWN = int(Label.UNKNOWN)


@dataclass(frozen=True)
class MadePair:
    """A pair and its figures, or why it was refused.

    Attributes:
        pair: the pair, or None if refused.
        cut_share: share of the full shape's volume outside the cube.
        reason: why it was refused, or None.
    """

    pair: Pair | None
    cut_share: float
    reason: str | None


def make_pair(view: View, sequence: Sequence, model: ObjectModel, settings: PairSettings) -> MadePair:
    """Voxelise a view's depth and the full shape in one cube, in the view's optical axes.

    The closed mesh is voxelised anew for each view (paper, Sec. 4.1: the full shape is turned into the
    view's camera orientation); resampling one volume would be slower and less exact.
    """
    camera = sequence.camera
    T_world_camera = view.alignment.T_world_camera
    depth_m = sequence.depth_m(view.frame)
    mesh = model.shape.mesh
    if settings.framing == "object":
        grid = object_cube(mesh.vertices, T_world_camera)
    else:
        grid = view_cube(camera.backproject(depth_m)[view.mask & (depth_m > 0)], T_world_camera)
    full = voxelize_solid(mesh.vertices, mesh.faces, grid)
    solid = unpack(full)
    cut_share = max(0.0, 1.0 - int(solid.sum()) * grid.voxel_size_m**3 / mesh.volume_m3)
    if settings.framing == "view" and cut_share > MAX_CUT_SHARE:
        return MadePair(None, cut_share, f"the cube of framing view cuts off {cut_share:.0%} of the shape")
    cells = depth_cells(depth_m, view.mask, camera, T_world_camera, grid)
    partial_256 = occupy(cells, grid.shape)
    pair = Pair(
        partial=pack(reduce_blocks(partial_256, settings.partial_rule)),
        partial_256=pack(partial_256),
        full=full,
        shell=shell_of(solid),
        known=known_cells(model, grid),
        seen=seen_cells(depth_m, camera, T_world_camera, grid),
        T_world_grid=grid.T_world_grid,
        T_world_camera=T_world_camera,
        K=camera.K,
        voxel_size_m=grid.voxel_size_m,
        surface_sigma_m=model.surface_sigma_m,
        framing=settings.framing,
        partial_rule=settings.partial_rule,
    )
    return MadePair(pair, cut_share, None)


def pair_row(view: View, made: MadePair) -> dict[str, Any]:
    """The figures of a pair as pairs.json keeps them; shares in [0, 1], metres."""
    return {
        "view": view.name,
        "frame": view.frame,
        "containment": round(view.fit.containment, 4),
        "residual_m": round(view.fit.residual_m, 6),
        "dropped_share": round(view.fit.dropped_share, 4),
        "visible_share": round(view.fit.visible_share, 4),
        "moved_m": round(view.alignment.moved_m, 6),
        "turned_rad": round(view.alignment.turned_rad, 6),
        "cut_share": round(made.cut_share, 4),
    }


def known_cells(model: ObjectModel, grid: Grid) -> NDArray[np.uint8]:
    """Cells of a pair's grid whose label is not UNKNOWN, by the nearest voxel of the object's labels.

    Beyond the fine grid the coarse surround is asked; beyond that, nothing is known.

    Returns:
        (256, 256, 32) uint8, packed along z.
    """
    fine, coarse = model.shape.grid, model.surround
    return np.asarray(
        _known(
            model.shape.labels,
            _index_map(fine, grid),
            model.surround_labels,
            _index_map(coarse, grid),
            grid.shape[0],
        )
    )


def _index_map(to: Grid, grid: Grid) -> NDArray[np.float64]:
    """(3, 4) affine map from half-integer cell coordinates of one grid to cell coordinates of another."""
    T = to.T_grid_world @ grid.T_world_grid
    scale = grid.voxel_size_m / to.voxel_size_m
    return np.concatenate([T[:3, :3] * scale, T[:3, 3:] / to.voxel_size_m], axis=1)


@numba.njit(cache=True, error_model="numpy")
def _known(fine, to_fine, coarse, to_coarse, side):  # type: ignore[no-untyped-def]
    """Walks every column of cells along z through both label grids, the fine one last: it wins."""
    packed = np.zeros((side, side, side // 8), np.uint8)
    column = np.empty(side, np.uint8)
    for i in range(side):
        for j in range(side):
            column[:] = UNKNOWN
            for level in range(2):
                labels, M = (coarse, to_coarse) if level == 0 else (fine, to_fine)
                x, y, z = M[:, 0] * (i + 0.5) + M[:, 1] * (j + 0.5) + M[:, 2] * 0.5 + M[:, 3]
                dx, dy, dz = M[:, 2]
                first, last = _span(x, dx, labels.shape[0], 0, side)
                first, last = _span(y, dy, labels.shape[1], first, last)
                first, last = _span(z, dz, labels.shape[2], first, last)
                for k in range(first, last):
                    column[k] = labels[int(x + k * dx), int(y + k * dy), int(z + k * dz)]
            for byte in range(side // 8):
                bits = 0
                for k in range(byte * 8, byte * 8 + 8):
                    bits = (bits << 1) | (1 if column[k] != UNKNOWN else 0)
                packed[i, j, byte] = bits
    return packed


@numba.njit(cache=True, error_model="numpy")
def _span(start, step, count, first, last):  # type: ignore[no-untyped-def]
    """The steps k in [first, last) with 0 <= start + k step < count, as a range."""
    while first < last and not 0.0 <= start + first * step < count:
        first += 1
    while last > first and not 0.0 <= start + (last - 1) * step < count:
        last -= 1
    return first, last
