"""The stage `sample-views`: 50 frames of the recording, with the object's mask in each."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.alignment import UNCHECKED_SIGMA_M, Alignment, align_view
from kinectbench.config import PairSettings, SegmentationSettings, ViewSettings
from kinectbench.errors import SegmentationError
from kinectbench.segmentation.masks import agreement_mask, inner_silhouette, override_mask, stray_masks
from kinectbench.segmentation.render import DepthRenderer
from kinectbench.sequence import Sequence
from kinectbench.shape.object_model import ObjectModel
from kinectbench.tracking.trajectory import Trajectory
from kinectbench.voxels.framing import object_cube
from kinectbench.voxels.morphology import containment_of_cells
from kinectbench.voxels.pair_file import BLOCK, unpack
from kinectbench.voxels.solid import voxelize_solid
from kinectbench.voxels.view_grids import depth_cells

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class ViewFit:
    """How well a view's depth fits the object. Shares are in [0, 1].

    Attributes:
        pixels: valid depth pixels on the object.
        visible_share: of the rendered silhouette, what carries valid depth of the object.
        border_share: of the silhouette's pixels, those within 1 px of the image border.
        dropped_share: valid depth inside the eroded silhouette that the mask leaves out.
        containment: share of partial cells (64^3, unmasked depth inside the eroded silhouette) that lie
            in the full shape, dilated once.
        residual_m: median absolute difference of measured and rendered depth there, metres.
    """

    pixels: int
    visible_share: float
    border_share: float
    dropped_share: float
    containment: float
    residual_m: float


@dataclass(frozen=True)
class View:
    """One sampled view.

    Attributes:
        name: zero-padded index, "000" on.
        frame: index of the frame in the sequence.
        stamp_ns: its depth stamp.
        reason: why it was chosen.
        alignment: its pose, corrected by its own depth.
        mask: (height, width) bool, the object, in depth pixels.
        fit: figures of the automatic mask.
    """

    name: str
    frame: int
    stamp_ns: int
    reason: str
    alignment: Alignment
    mask: NDArray[np.bool_]
    fit: ViewFit


@dataclass(frozen=True)
class Views:
    """The views of one recording, the frames that were refused (frame, why), and warnings."""

    views: list[View]
    refused: list[tuple[int, str]]
    warnings: list[str]


def sample_views(
    sequence: Sequence,
    trajectory: Trajectory,
    model: ObjectModel,
    settings: ViewSettings,
    segmentation: SegmentationSettings,
    pairs: PairSettings,
    masks: Path | None = None,
    progress: Progress | None = None,
) -> Views:
    """Walk a seeded permutation of the good frames until enough of them fit the object.

    So every good frame is equally likely (paper, Sec. 4.1: 50 random views of the trajectory), and
    refused frames do not shrink the set as long as others are left.

    Args:
        sequence: the recording.
        trajectory: its poses.
        model: floor, closed mesh.
        settings: how many, which seed.
        segmentation: tolerance of the masks.
        pairs: least containment, largest residual.
        masks: folder of a person's PNGs, or None.
        progress: called with (views found, views wanted).

    Raises:
        SegmentationError: no frame fits, or a person's mask is unusable.
    """
    renderer = DepthRenderer(model.shape.mesh)
    order = np.random.default_rng(settings.seed).permutation(trajectory.good_frames)
    views: list[View] = []
    refused: list[tuple[int, str]] = []
    for frame in map(int, order):
        if len(views) == settings.count:
            break
        depth_m = sequence.depth_m(frame)
        pose_sigma_m = trajectory.pose_sigma_m(frame) or UNCHECKED_SIGMA_M
        alignment = align_view(
            depth_m, sequence.camera, trajectory.T_world_camera[frame], renderer, pose_sigma_m
        )
        T_world_camera = alignment.T_world_camera
        rendered_m = renderer.depth_m(sequence.camera, T_world_camera)
        mask = agreement_mask(depth_m, rendered_m, segmentation.mask_tolerance_m)
        fit = _measure(depth_m, rendered_m, mask, sequence, T_world_camera, model)
        reason = _refusal(fit, settings, pairs)
        if reason:
            refused.append((frame, reason))
            continue
        name = f"{len(views):03d}"
        if masks is not None:
            mask = override_mask(mask, masks, name)
        stamp_ns = int(sequence.stamps_ns[frame])
        views.append(View(name, frame, stamp_ns, settings.strategy, alignment, mask, fit))
        if progress:
            progress(len(views), settings.count)
    if not views:
        first = refused[0][1] if refused else "no frame has a pose"
        raise SegmentationError(f"no view fits the object: {len(refused)} frames refused ({first})")
    warnings = _warnings(views, settings, len(order))
    if masks is not None:
        warnings += stray_masks(masks, [view.name for view in views])
    return Views(views, refused, warnings)


def _measure(
    depth_m: NDArray[np.float32],
    rendered_m: NDArray[np.float32],
    mask: NDArray[np.bool_],
    sequence: Sequence,
    T_world_camera: NDArray[np.float64],
    model: ObjectModel,
) -> ViewFit:
    silhouette = rendered_m > 0
    inner = inner_silhouette(rendered_m) & (depth_m > 0)
    pixels, area = int(mask.sum()), int(silhouette.sum())
    if pixels == 0 or not inner.any():
        return ViewFit(pixels, 0.0, 0.0, 1.0, 0.0, float("inf"))
    grid = object_cube(model.shape.mesh.vertices, T_world_camera)
    cells = depth_cells(depth_m, inner, sequence.camera, T_world_camera, grid.coarser(BLOCK))
    full = unpack(voxelize_solid(model.shape.mesh.vertices, model.shape.mesh.faces, grid))
    border = silhouette.copy()
    border[1:-1, 1:-1] = False
    return ViewFit(
        pixels=pixels,
        visible_share=pixels / area,
        border_share=int(border.sum()) / area,
        dropped_share=int((inner & ~mask).sum()) / int(inner.sum()),
        containment=containment_of_cells(cells, full, BLOCK),
        residual_m=float(np.median(np.abs(depth_m[inner] - rendered_m[inner]))),
    )


def _refusal(fit: ViewFit, settings: ViewSettings, pairs: PairSettings) -> str | None:
    """Why a frame is no view, or None if it is one."""
    if fit.pixels < settings.min_pixels:
        return f"only {fit.pixels} pixels on the object"
    if fit.residual_m > pairs.max_residual_m:
        return f"depth is {fit.residual_m * 1000:.1f} mm (median) off the object"
    if fit.containment < pairs.min_containment:
        return f"only {fit.containment:.0%} of the partial lies in the object"
    return None


def _warnings(views: list[View], settings: ViewSettings, good_frames: int) -> list[str]:
    warnings = []
    if len(views) < settings.count:
        warnings.append(
            f"{len(views)} views instead of {settings.count}: all {good_frames} good frames were tried"
        )
    cut = sum(view.fit.border_share > 0.01 for view in views)
    if cut > len(views) / 2:
        warnings.append(f"the image border cuts the object in {cut} of {len(views)} views: step back")
    return warnings
