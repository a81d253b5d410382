"""The stage `sample-views`: 50 frames of the recording, with the object's mask in each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.alignment import UNCHECKED_SIGMA_M, Alignment, align_view
from kinectbench.config import PairSettings, SegmentationSettings, ViewSettings
from kinectbench.errors import SegmentationError
from kinectbench.geometry import transform_points
from kinectbench.segmentation.low_parts import low_cut_m
from kinectbench.segmentation.masks import object_mask, override_mask, recorded_mask, stray_masks
from kinectbench.segmentation.render import DepthRenderer
from kinectbench.sequence import Sequence
from kinectbench.shape.object_model import ObjectModel
from kinectbench.tracking.trajectory import Trajectory
from kinectbench.view_fit import ViewFit, fit_of_view, refusal
from kinectbench.view_order import frame_order

Progress = Callable[[int, int], None]


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
        fit: figures of the mask before a person's PNGs.
        blur: of the colour against the recording's sharpest frames, as health.json has it; None if unknown.
        pose_residual_m: distance to other frames under the trajectory's pose, metres; None if unknown.
    """

    name: str
    frame: int
    stamp_ns: int
    reason: str
    alignment: Alignment
    mask: NDArray[np.bool_]
    fit: ViewFit
    blur: float | None = None
    pose_residual_m: float | None = None


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
    """Walk the good frames, in the order of the strategy, until enough of them fit the object.

    With `random` every good frame is equally likely (paper, Sec. 4.1: 50 random views of the trajectory).
    Refused frames do not shrink the set as long as others are left.

    Args:
        sequence: the recording.
        trajectory: its poses.
        model: floor, closed mesh.
        settings: how many, which strategy and seed; whether masks that came with the recording are the
            object's, in the frames that have one.
        segmentation: tolerance of the masks, and how near to the floor they reach.
        pairs: least containment, largest residual, least visible share.
        masks: folder of a person's PNGs, or None.
        progress: called with (views found, views wanted).

    Raises:
        SegmentationError: no frame fits, or a person's mask is unusable.
    """
    renderer = DepthRenderer(model.shape.mesh)
    order = frame_order(sequence, trajectory, model, renderer, settings, segmentation)
    health = {row["frame"]: row for row in trajectory.health.get("per_frame", [])}
    views: list[View] = []
    refused: list[tuple[int, str]] = []
    for frame, why in order:
        if len(views) == settings.count:
            break
        depth_m = sequence.depth_m(frame)
        recorded = sequence.masks(frame) if sequence.masks and settings.recorded_masks else None
        if recorded is not None:
            # What stands before the object or touches it says nothing of how well it fits.
            depth_m = np.where(recorded, depth_m, np.float32(0))
        pose_sigma_m = trajectory.pose_sigma_m(frame) or UNCHECKED_SIGMA_M
        alignment = align_view(
            depth_m, sequence.camera, trajectory.T_world_camera[frame], renderer, pose_sigma_m
        )
        T_world_camera = alignment.T_world_camera
        rendered_m = renderer.depth_m(sequence.camera, T_world_camera)
        mask = _mask(depth_m, rendered_m, sequence, T_world_camera, model, segmentation, recorded)
        fit = fit_of_view(depth_m, rendered_m, mask, sequence, T_world_camera, model, renderer)
        reason = refusal(fit, settings, pairs)
        if reason:
            refused.append((frame, reason))
            continue
        name = f"{len(views):03d}"
        if masks is not None:
            mask = override_mask(mask, masks, name)
        stamp_ns = int(sequence.stamps_ns[frame])
        figures = _health_figures(health.get(frame, {}))
        views.append(View(name, frame, stamp_ns, why, alignment, mask, fit, *figures))
        if progress:
            progress(len(views), settings.count)
    if not views:
        first = refused[0][1] if refused else "no frame has a pose"
        raise SegmentationError(f"no view fits the object: {len(refused)} frames refused ({first})")
    warnings = _warnings(views, settings, len(order))
    if masks is not None:
        warnings += stray_masks(masks, [view.name for view in views])
    return Views(views, refused, warnings)


def _mask(
    depth_m: NDArray[np.float32],
    rendered_m: NDArray[np.float32],
    sequence: Sequence,
    T_world_camera: NDArray[np.float64],
    model: ObjectModel,
    segmentation: SegmentationSettings,
    recorded: NDArray[np.bool_] | None,
) -> NDArray[np.bool_]:
    """The mask of a view by its recorded mask, or else by its depth."""
    tolerance_m = segmentation.mask_tolerance_m
    if recorded is None:
        heights_m = model.floor.heights_m(depth_m, sequence.camera, T_world_camera)
        clear_m = low_cut_m(model.floor, segmentation)
        return object_mask(depth_m, rendered_m, heights_m, tolerance_m, clear_m)
    points = sequence.camera.backproject(depth_m)
    points_floor = transform_points(model.floor.T_floor_world @ T_world_camera, points.reshape(-1, 3))
    return recorded_mask(depth_m, recorded, points_floor.reshape(points.shape), model.box, tolerance_m)


def _health_figures(row: Mapping[str, Any]) -> tuple[float | None, float | None]:
    """Blur and pose residual in metres of one frame's row of health.json."""
    residual_mm = row.get("residual_mm")
    return row.get("blur"), None if residual_mm is None else residual_mm / 1000


def _warnings(views: list[View], settings: ViewSettings, good_frames: int) -> list[str]:
    warnings = []
    if len(views) < settings.count:
        warnings.append(
            f"{len(views)} views instead of {settings.count}: all {good_frames} good frames were tried"
        )
    cut = sum(view.fit.truncated_share > 0.02 or view.fit.border_share > 0.01 for view in views)
    if cut > len(views) / 2:
        warnings.append(f"the image border cuts the object in {cut} of {len(views)} views: step back")
    return warnings
