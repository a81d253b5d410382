"""The order in which good frames are tried as views."""

from collections.abc import Sequence as Rows
from itertools import zip_longest

import numpy as np

from kinectbench.core.geometry import DepthRenderer, transform_points
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float64
from kinectbench.settings.models import MaskCuts, ViewSettings
from kinectbench.stages.sample_views.masks import agreement_mask
from kinectbench.stages.segment.object_model import ObjectModel

# Size of the strata (chosen by hand); smaller ones would hold a frame or two of a usual recording.
SECTOR_DEG, BAND_DEG = 30, 15
# Bounds of the three classes of the visible share.
SHARES = (0.0, 0.5, 0.8, 1.0)
# The share only needs one of three classes, so every eighth pixel along rows and columns suffices.
STRIDE_PX = 8

Stratum = tuple[int, int, int]


def frame_order(
    sequence: Sequence,
    trajectory: Trajectory,
    model: ObjectModel,
    renderer: DepthRenderer,
    settings: ViewSettings,
    segmentation: MaskCuts,
) -> list[tuple[int, str]]:
    """Order all good frames for trying them as views; return each frame with the reason for its rank.

    `random` (paper, Sec. 3.6): a seeded permutation. `coverage`: frames are grouped by azimuth around the
    object in sectors of 30 degrees, within a sector by elevation in bands of 15 degrees ("height"), and
    within a band by three classes of the visible share (below 50 %, below 80 %, more). Sectors take turns;
    within each sector its bands take turns, and within each band its classes. Frames of one class are in the
    order of `random`.
    """
    order = np.random.default_rng(settings.seed).permutation(trajectory.good_frames).tolist()
    if settings.strategy == "random":
        return [(frame, "random") for frame in order]
    poses = trajectory.T_world_camera
    strata = {
        frame: (
            *direction(poses[frame], model),
            share_class(visible_share(sequence, frame, poses[frame], renderer, segmentation)),
        )
        for frame in order
    }
    return [(frame, stratum_text(strata[frame])) for frame in taking_turns(order, strata)]


def direction(T_world_camera: Float64, model: ObjectModel) -> tuple[int, int]:
    """Return a camera's azimuth sector (0 to 11, 30 degrees) and elevation band (-6 to 5, 15 degrees).

    Both are seen from the centre of the object's box. Sectors count from the floor's x axis.
    """
    x, y, z = transform_points(model.floor.T_floor_world, T_world_camera[:3, 3]) - model.box.center_m
    azimuth_rad, height_rad = np.arctan2(y, x) % (2 * np.pi), np.arctan2(z, np.hypot(x, y))
    sector = int(azimuth_rad / np.radians(SECTOR_DEG))
    band = int(np.floor(height_rad / np.radians(BAND_DEG)))
    return sector % (360 // SECTOR_DEG), min(band, 90 // BAND_DEG - 1)


def visible_share(
    sequence: Sequence, frame: int, T_world_camera: Float64, renderer: DepthRenderer, segmentation: MaskCuts
) -> float:
    """Estimate the visible share of a view (`ViewFit`) at every 8th pixel, before the pose is corrected."""
    depth_m = sequence.depth_m(frame)[::STRIDE_PX, ::STRIDE_PX]
    rendered_m = renderer.depth_m(sequence.camera.every(STRIDE_PX), T_world_camera)
    silhouette = int((rendered_m > 0).sum())
    agreeing = int(agreement_mask(depth_m, rendered_m, segmentation.mask_tolerance_m).sum())
    return agreeing / silhouette if silhouette else 0.0


def share_class(share: float) -> int:
    """Return the class of a visible share, given in [0, 1]: 0 below 50 %, 1 below 80 %, else 2."""
    return int(np.searchsorted(SHARES[1:-1], share, side="right"))


def stratum_text(stratum: Stratum) -> str:
    """Describe sector, height and visible share in words."""
    sector, band, share = stratum
    return (
        f"coverage: azimuth {SECTOR_DEG * sector} to {SECTOR_DEG * (sector + 1)} deg, "
        f"height {BAND_DEG * band} to {BAND_DEG * (band + 1)} deg, "
        f"{SHARES[share]:.0%} to {SHARES[share + 1]:.0%} visible"
    )


def taking_turns(frames: Rows[int], strata: dict[int, Stratum], depth: int = 0) -> list[int]:
    """Order frames: sectors take turns, within each sector its heights, and within each height its classes.

    Args:
        frames: the frames to order.
        strata: {frame: (sector, height, class)}.
        depth: 0 to start with sectors, 1 with heights, 2 with classes.
    """
    if depth == 3:
        return list(frames)
    groups: dict[int, list[int]] = {}
    for frame in frames:
        groups.setdefault(strata[frame][depth], []).append(frame)
    queues = [taking_turns(groups[key], strata, depth + 1) for key in sorted(groups)]
    return [frame for turn in zip_longest(*queues) for frame in turn if frame is not None]
