"""Track a turned or carried object by its masked pixels: the world moves with the object."""

from dataclasses import replace

import numpy as np

from kinectbench.core import TrackingError
from kinectbench.core.own_pixels import Masks, by_own_pixels, frames_with_masks
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.association import poses_at
from kinectbench.core.trajectory.compare import compare_poses, has_pose
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Progress
from kinectbench.settings.models import TrackingSettings, TrajectoryMode
from kinectbench.stages.track.track import MIN_GOOD_FRAMES, track

# Trajectories whose distance is not this many times shorter than the path do not agree.
AT_REST_RATIO = 10.0


def track_own_pixels(
    sequence: Sequence,
    masks: Masks,
    mode: TrajectoryMode | None,
    settings: TrackingSettings,
    progress: Progress | None = None,
) -> Trajectory:
    """Run `track` on the pixels inside the masks; a frame without mask has no pose.

    Args:
        sequence: the recording, unmasked.
        masks: function from a frame's index to the object's mask, (height, width) bool; None if there is
            none.
        mode: "trust", "refine" or "ignore" a given trajectory, whose poses fit only if the object was at
            rest; None: trust it if there is one.
        settings: settings for the check of given poses.
        progress: called with (done, total).

    Raises:
        TrackingError: fewer than three frames have a mask, or `track` raises it.
    """
    has_mask = frames_with_masks(sequence, masks)
    if has_mask.sum() < MIN_GOOD_FRAMES:
        raise TrackingError(
            f"only {has_mask.sum()} of {len(sequence)} frames have a mask that is not empty, and "
            f"{MIN_GOOD_FRAMES} are needed; `segment_by: masks` needs one of every frame that is to count",
            what="too-few-masks",
        )
    trajectory = track(by_own_pixels(sequence, masks), mode, settings, progress)
    lines = _at_rest(sequence, trajectory, settings) if mode == "ignore" else []
    without = int(np.count_nonzero(~has_mask))
    if without:
        lines.append(f"{without} of {len(sequence)} frames have no mask, or an empty one, and are left out")
    if not lines or trajectory.health is None:
        return trajectory
    # First: what masks leave out looks like a bad trajectory in what follows.
    warnings = (*lines, *trajectory.health.warnings)
    return replace(trajectory, health=trajectory.health.model_copy(update={"warnings": warnings}))


def _at_rest(sequence: Sequence, trajectory: Trajectory, settings: TrackingSettings) -> list[str]:
    """Return a warning if the ignored given poses agree with those found: the object did not move."""
    given = sequence.given_trajectory
    if given is None:
        return []
    T_given = poses_at(given, sequence.stamps_ns, settings.max_stamp_gap_s)
    both = has_pose(T_given) & has_pose(trajectory.T_world_camera)
    if both.sum() < MIN_GOOD_FRAMES:
        return []
    apart_m = compare_poses(trajectory.T_world_camera[both], T_given[both]).ate_m.rmse
    way_m = float(np.ptp(T_given[both, :3, 3], axis=0).max())
    if apart_m > settings.max_disagreement_m or way_m < AT_REST_RATIO * apart_m:
        return []
    return [
        f"the given poses and those by the object's own pixels agree to {1000 * apart_m:.0f} mm: it was at "
        "rest; `trajectory: trust` takes the given ones"
    ]
