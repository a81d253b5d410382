"""The stage `pairs`: for each view the partial shape, and the full shape turned into the view's axes."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.config import PairSettings
from kinectbench.geometry import Grid, TriangleMesh
from kinectbench.sequence import Sequence
from kinectbench.shape.labels import Label
from kinectbench.shape.object_model import ObjectModel
from kinectbench.views import View
from kinectbench.voxels.framing import object_cube, view_cube
from kinectbench.voxels.known_cells import KnownGrid, known_grid, known_in
from kinectbench.voxels.packed_containment import packed_containment, packed_count
from kinectbench.voxels.packed_shell import packed_shell
from kinectbench.voxels.pair_file import Pair, pack, unpack
from kinectbench.voxels.resample import reduce_blocks
from kinectbench.voxels.seen_cells import seen_cells
from kinectbench.voxels.solid import voxelize_solid
from kinectbench.voxels.view_grids import partial_grids

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


@dataclass(frozen=True)
class FullShape:
    """An object as all its pairs need it, made once.

    Attributes:
        mesh: closed.
        volume_m3: of the mesh.
        known: where its truth is trusted: not labelled UNKNOWN, on the fine grid and the coarse one around.
        surface_sigma_m: standard deviation of its surface, metres.
    """

    mesh: TriangleMesh
    volume_m3: float
    known: tuple[KnownGrid, KnownGrid]
    surface_sigma_m: float


def full_shape(model: ObjectModel) -> FullShape:
    """What the pairs need of an object."""
    mesh = model.shape.mesh
    return FullShape(mesh, mesh.volume_m3, _known_grids(model), model.surface_sigma_m)


def make_pair(
    view: View, sequence: Sequence, shape: FullShape | ObjectModel, settings: PairSettings
) -> MadePair:
    """Voxelise a view's depth and the full shape in one cube, in the view's optical axes.

    The closed mesh is voxelised anew for each view (paper, Sec. 4.1: the full shape is turned into the
    view's camera orientation); resampling one volume would be slower and less exact.

    Args:
        view: frame, pose and mask.
        sequence: the recording.
        shape: the object; as `full_shape` where several pairs are made of it.
        settings: framing, partial rule and least containment.
    """
    if isinstance(shape, ObjectModel):
        shape = full_shape(shape)
    camera = sequence.camera
    T_world_camera = view.alignment.T_world_camera
    depth_m = sequence.depth_m(view.frame)
    object_m = np.where(view.mask, depth_m, np.float32(0))
    mesh = shape.mesh
    if not object_m.any():
        return MadePair(None, 0.0, "no pixel of the mask has depth: draw another mask")
    if settings.framing == "object":
        grid = object_cube(mesh.vertices, T_world_camera)
    else:
        grid = view_cube(camera.backproject(depth_m)[object_m > 0], T_world_camera)
    full = voxelize_solid(mesh.vertices, mesh.faces, grid)
    partial_256, partial = partial_grids(object_m, camera, T_world_camera, grid)
    cut_share = max(0.0, 1.0 - packed_count(full) * grid.voxel_size_m**3 / shape.volume_m3)
    reason = _refusal(settings, cut_share, packed_containment(partial, full))
    if reason:
        return MadePair(None, cut_share, reason)
    if settings.partial_rule != "any":
        partial = pack(reduce_blocks(unpack(partial_256), settings.partial_rule))
    pair = Pair(
        partial=partial,
        partial_256=partial_256,
        full=full,
        shell=packed_shell(full),
        known=known_in(*shape.known, grid),
        seen=seen_cells(depth_m, camera, T_world_camera, grid),
        T_world_grid=grid.T_world_grid,
        T_world_camera=T_world_camera,
        K=camera.K,
        voxel_size_m=grid.voxel_size_m,
        surface_sigma_m=shape.surface_sigma_m,
        framing=settings.framing,
        partial_rule=settings.partial_rule,
    )
    return MadePair(pair, cut_share, None)


def _refusal(settings: PairSettings, cut_share: float, inside: float) -> str | None:
    """Why a pair must not be used, or None."""
    if settings.framing == "view" and cut_share > MAX_CUT_SHARE:
        return (
            f"the cube of framing view cuts off {cut_share:.1%} of the shape, more than {MAX_CUT_SHARE:.0%}"
        )
    if inside < settings.min_containment:
        # The view itself has passed: its mask was drawn by a person, or the cube cuts the shape.
        least = f"less than {settings.min_containment:.0%}"
        return f"only {inside:.1%} of the masked partial lies in the shape, {least}: see the view's mask"
    return None


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
    """Cells of a grid whose label is not UNKNOWN, by the nearest voxel of the object's labels.

    Beyond the fine grid the coarse surround is asked; beyond that, nothing is known.

    Returns:
        (nx, ny, nz / 8) uint8, packed along z.
    """
    return known_in(*_known_grids(model), grid)


def _known_grids(model: ObjectModel) -> tuple[KnownGrid, KnownGrid]:
    fine, coarse = model.shape.labels != UNKNOWN, model.surround_labels != UNKNOWN
    return known_grid(model.shape.grid, fine), known_grid(model.surround, coarse)
