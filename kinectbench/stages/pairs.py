"""The stage `pairs`: voxelise each view's partial shape, and the full shape in the view's axes."""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.artefacts.stored import known
from kinectbench.core.artefacts.views import PairRow, PairsFile, Refused
from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.sequence import Sequence
from kinectbench.core.threads import ahead
from kinectbench.core.types import Progress
from kinectbench.core.voxels.known_cells import KnownGrid, known_grid, known_in
from kinectbench.core.voxels.pair_file import BLOCK, Pair, pack, packed_count, pair_bytes, unpack
from kinectbench.core.voxels.resample import reduce_blocks
from kinectbench.core.voxels.seen_cells import seen_cells
from kinectbench.core.voxels.solid import packed_shell, voxelize_solid
from kinectbench.core.voxels.view_grids import (
    MAX_CUT_SHARE,
    containment_of_cells,
    depth_cells,
    object_cube,
    partial_grids,
    view_cube,
)
from kinectbench.settings.models import PairSettings
from kinectbench.stages.sample_views.views import View
from kinectbench.stages.segment.object_model import ObjectModel

# The fine grid around the object, and the coarse grid around the fine one.
KnownGrids = tuple[KnownGrid, KnownGrid]


@dataclass(frozen=True)
class MadePair:
    """A pair made from a view, or the reason why it was refused.

    Attributes:
        pair: the pair; None if refused.
        cut_share: share of the full shape's volume outside the pair's cube.
        reason: why the pair was refused; None if it was not.
    """

    pair: Pair | None
    cut_share: float
    reason: str | None


@dataclass(frozen=True)
class FullShape:
    """The data that all pairs of one object share; computed once.

    Attributes:
        mesh: closed mesh of the object.
        volume_m3: volume of the mesh, cubic metres.
        known: cells whose content is known (not labelled UNKNOWN), on the object's fine grid and
            on the coarse grid around it.
        interior: the known cells labelled INTERIOR, which were not measured; none on the coarse grid.
        said: the known cells that are known only from the user's statement about an unseen underside; none
            on the coarse grid.
        surface_sigma_m: standard deviation of the mesh's surface, metres.
    """

    mesh: TriangleMesh
    volume_m3: float
    known: KnownGrids
    interior: KnownGrids
    said: KnownGrids
    surface_sigma_m: float


def full_shape(model: ObjectModel) -> FullShape:
    """Compute the data that all pairs of one object share."""
    mesh = model.shape.mesh
    shape, coarse = model.shape, model.surround_labels != Label.UNKNOWN
    known, interior = shape.labels != Label.UNKNOWN, shape.labels == Label.INTERIOR
    around, nowhere = known_grid(model.surround, coarse), known_grid(model.surround, np.zeros_like(coarse))
    return FullShape(
        mesh,
        mesh.volume_m3,
        known=(known_grid(shape.grid, known), around),
        interior=(known_grid(shape.grid, interior), nowhere),
        said=(known_grid(shape.grid, known & shape.underside), nowhere),
        surface_sigma_m=model.surface_sigma_m,
    )


def make_pair(view: View, sequence: Sequence, shape: FullShape, settings: PairSettings) -> MadePair:
    """Voxelise a view's depth and the full shape in one cube, in the view's optical axes.

    The closed mesh is voxelised for each view (paper, Sec. 3.6: the full shape is rotated into the view's
    camera orientation). Resampling one volume would be slower and less exact. The shape is `full_shape` of
    the object.
    """
    camera = sequence.camera
    T_world_camera = view.alignment.T_world_camera
    depth_m = sequence.depth_m(view.frame)
    object_m = np.where(view.mask, depth_m, np.float32(0))
    mesh = shape.mesh
    pixels = np.count_nonzero(object_m)
    if pixels < 2:  # one makes a cube without a side
        what = "only one pixel" if pixels else "no pixel"
        return MadePair(None, 0.0, f"{what} of the mask has depth: draw another mask")
    if settings.framing == "object":
        grid = object_cube(mesh.vertices, T_world_camera)
    else:
        grid = view_cube(camera.backproject(depth_m)[object_m > 0], T_world_camera)
    full = voxelize_solid(mesh.vertices, mesh.faces, grid)
    partial_256, partial = partial_grids(object_m, camera, T_world_camera, grid)
    cut_share = max(0.0, 1.0 - packed_count(full) * grid.voxel_size_m**3 / shape.volume_m3)
    # Not those of `partial`: depth beyond the cube is not in the shape, either.
    cells = depth_cells(depth_m, view.mask, camera, T_world_camera, grid.coarser(BLOCK))
    reason = _refusal(settings, cut_share, containment_of_cells(cells, full))
    if reason:
        return MadePair(None, cut_share, reason)
    if settings.partial_rule != "any":
        partial = pack(reduce_blocks(unpack(partial_256), settings.partial_rule))
    if not partial.any():
        return MadePair(None, cut_share, _no_input(settings.partial_rule))
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
        interior=known_in(*shape.interior, grid),
        said=known_in(*shape.said, grid),
    )
    return MadePair(pair, cut_share, None)


def _refusal(settings: PairSettings, cut_share: float, inside: float) -> str | None:
    """Return the reason why a pair must be refused, by its cut share and containment; None if it is good."""
    if settings.framing == "view" and cut_share > MAX_CUT_SHARE:
        return (
            f"the cube of framing view cuts off {cut_share:.1%} of the shape, more than {MAX_CUT_SHARE:.0%}"
        )
    if inside < settings.min_containment:
        # The view itself was accepted; its mask was drawn by the user, or the cube cuts the shape.
        least = f"less than {settings.min_containment:.0%}"
        return f"only {inside:.1%} of the masked partial lies in the shape, {least}: see the view's mask"
    return None


def _no_input(partial_rule: str) -> str:
    """Return the reason why a pair with an empty partial grid must be refused."""
    if partial_rule == "any":
        return "nothing of the masked partial lies in the cube: see the view's mask"
    return "its depth fills no block of 4³ cells by more than half: set `pairs.partial_rule` to any"


def write_pairs(
    views: Collection[View],
    sequence: Sequence,
    shape: FullShape,
    settings: PairSettings,
    folder: Path,
    progress: Progress,
) -> None:
    """Write one pair file for each view whose pair is not refused, and pairs.json.

    Args:
        views: views of one recording.
        sequence: the recording.
        shape: `full_shape` of the object.
        settings: framing, partial rule, and minimum containment.
        folder: the folder to fill.
        progress: called with (views done, views in all).
    """
    made, refused = [], []

    def pack_pair(view: View) -> tuple[View, MadePair, bytes]:
        result = make_pair(view, sequence, shape, settings)
        return view, result, b"" if result.pair is None else pair_bytes(result.pair)

    for done, (view, result, data) in enumerate(ahead(pack_pair, views), start=1):
        if result.reason is not None:
            refused.append(Refused(view=view.name, frame=view.frame, reason=result.reason))
        if result.pair is not None:
            (folder / f"{view.name}.npz").write_bytes(data)
            made.append(pair_row(view, result))
        progress(done, len(views))
    PairsFile(pairs=tuple(made), refused=tuple(refused)).write(folder)


def pair_row(view: View, made: MadePair) -> PairRow:
    """Return a pair's row of pairs.json, rounded; shares are in [0, 1], lengths in metres."""
    return PairRow(
        view=view.name,
        frame=view.frame,
        containment=known(view.fit.containment, 4),
        residual_m=known(view.fit.residual_m, 6),
        dropped_share=known(view.fit.dropped_share, 4),
        visible_share=known(view.fit.visible_share, 4),
        moved_m=known(view.alignment.moved_m, 6),
        turned_rad=known(view.alignment.turned_rad, 6),
        cut_share=round(made.cut_share, 4),
        unknown_share=None if made.pair is None else made.pair.stated_unknown_share,
    )
