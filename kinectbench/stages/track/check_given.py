"""Check a given trajectory: compare each frame with similar views, and distant frames with each other."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from kinectbench.core import TrackingError
from kinectbench.core.artefacts.stored import known
from kinectbench.core.artefacts.trajectory import GivenFigures
from kinectbench.core.even_choice import evenly
from kinectbench.core.geometry import DepthCalibration
from kinectbench.core.sequence import Sequence, counts_frames
from kinectbench.core.trajectory.compare import compare_poses, has_pose
from kinectbench.core.types import Bools, Float64, Progress
from kinectbench.settings.models import TrackingSettings
from kinectbench.stages.track.depth_calibration import calibrate_posed
from kinectbench.stages.track.disagreement import distant_constraints, distant_residual_m
from kinectbench.stages.track.frame_check import COMPARED_FRAMES, FrameCheck, check_frames
from kinectbench.stages.track.frame_maps import MapCache
from kinectbench.stages.track.health_figures import median
from kinectbench.stages.track.map_kernels import MAX_DEPTH_M, MIN_DEPTH_M
from kinectbench.stages.track.outliers import OUTLIER_REASON
from kinectbench.stages.track.tracked import Constraint, State, Tracked

NO_POSE = "the given trajectory has no pose at its time"
NO_DEPTH = f"it has no depth between {MIN_DEPTH_M:g} and {MAX_DEPTH_M:g} m"
CAUSES = "are the poses camera to world, in optical axes, on the frames' clock, and is depth_scale right"
# Largest number of jumps to describe; further jumps are only counted.
MAX_JUMPS_REPORTED = 5
# If a larger ratio of frames disagrees, the cause affects all frames.
MANY = 0.2
# More drift than this is more likely a wrong scale or clock.
IMPLAUSIBLE_DRIFT_M = 0.1


@dataclass(frozen=True)
class GivenCheck:
    """A given trajectory, and its agreement with the depth.

    Attributes:
        T_given: (n, 4, 4), NaN where a frame has no given pose.
        frames: the comparison of each frame with frames of similar views.
        distant: constraints between distant frames, registered from the given poses.
        figures: statistics for health.json. `refined_distant_residual_m` is measured at the refined poses; if
            there are none, at the relative poses found by the pairwise registrations.
        sharpness: {frame index: sharpness of its colour}, of the frames whose colour was read.
        calibration: the depth correction under which the frames agree best; all statistics use it.
    """

    T_given: Float64
    frames: FrameCheck
    distant: tuple[Constraint, ...]
    figures: GivenFigures
    sharpness: Mapping[int, float]
    calibration: DepthCalibration

    @property
    def agrees(self) -> Bools:
        """Whether each frame (n,) was compared with others and does not disagree; True for outliers, too."""
        return np.isfinite(self.frames.shift_m) & ~self.frames.disagrees


def check_given(
    sequence: Sequence, T_given: Float64, settings: TrackingSettings, progress: Progress | None = None
) -> GivenCheck:
    """Check given poses by comparing the depth of frames that see the same place.

    Args:
        sequence: the recording, n frames.
        T_given: (n, 4, 4), NaN where a frame has no given pose.
        settings: stride of the points, number of similar views, and the limit for disagreement.
        progress: called with (frames compared, frames with a pose).
    """
    maps, every = MapCache(sequence), settings.check_stride_px
    posed = np.flatnonzero(has_pose(T_given))
    calibration = calibrate_posed(maps, T_given, posed[evenly(len(posed), COMPARED_FRAMES)])
    maps.calibrate(calibration)
    frames = check_frames(maps, T_given, settings, progress)
    sound = frames.compared[~(frames.disagrees | frames.outlier)[frames.compared]]
    distant, shifts_m, unmatched = distant_constraints(maps, T_given, sound, every)
    figures = GivenFigures(
        disagreeing=tuple(np.flatnonzero(frames.disagrees).tolist()),
        median_shift_m=known(median(frames.shift_m)),
        distant_shift_m=known(median(shifts_m)),
        distant_unmatched=known(unmatched, 4),
        refined_apart_m=None,
        largest_jump_m=max((by_m for _, by_m in frames.jumps), default=0.0),
        distant_residual_m=known(distant_residual_m(maps, distant, every, T_given)),
        refined_distant_residual_m=known(distant_residual_m(maps, distant, every)),
    )
    return GivenCheck(T_given, frames, distant, figures, maps.sharpness, calibration)


def as_refined(
    sequence: Sequence, checked: GivenCheck, T_refined: Float64, settings: TrackingSettings
) -> GivenCheck:
    """Return a copy of the check with two statistics of the refined poses (n, 4, 4) added.

    The first is the residual between distant frames at the refined poses. The second is the rms distance
    between refined and given camera centres after alignment; None if fewer than three frames have both.
    """
    maps, every = MapCache(sequence), settings.check_stride_px
    maps.calibrate(checked.calibration)
    found_m = distant_residual_m(maps, checked.distant, every, T_refined)
    both = has_pose(checked.T_given) & has_pose(T_refined)
    apart_m = compare_poses(T_refined[both], checked.T_given[both]).ate_m.rmse if both.sum() >= 3 else np.nan
    compared = {"refined_distant_residual_m": known(found_m), "refined_apart_m": known(apart_m)}
    return replace(checked, figures=GivenFigures(**{**dict(checked.figures), **compared}))


def trusted(checked: GivenCheck, settings: TrackingSettings) -> Tracked:
    """Return the given poses as a tracking result; some frames get no pose.

    These are frames that disagree with the depth, are outliers, or have no depth.

    Raises:
        TrackingError: more than half of the compared frames disagree.
    """
    posed, wrong, blind = has_pose(checked.T_given), checked.frames.disagrees, checked.frames.blind
    compared = int(np.isfinite(checked.frames.shift_m).sum())
    if wrong.sum() > 0.5 * compared:
        raise TrackingError(
            f"the given trajectory does not fit the depth: {wrong.sum()} of {compared} frames disagree by "
            f"more than {settings.max_disagreement_m * 1000:.0f} mm; {CAUSES}? `trajectory: ignore` does "
            "without them",
            what="given-disagrees",
        )
    odd = checked.frames.outlier
    kept = posed & ~wrong & ~blind & ~odd
    states: tuple[State, ...] = tuple("tracked" if each else "lost" for each in kept)
    return Tracked(
        T_world_camera=np.where(kept[:, None, None], checked.T_given, np.nan),
        states=states,
        reasons=dict.fromkeys(np.flatnonzero(~posed).tolist(), NO_POSE)
        | dict.fromkeys(np.flatnonzero(posed & blind).tolist(), NO_DEPTH)
        | dict.fromkeys(np.flatnonzero(odd).tolist(), OUTLIER_REASON),
        keyframes=checked.frames.compared[kept[checked.frames.compared]],
        constraints=checked.distant,
        refused=(),
        residual_m=checked.frames.residual_m,
        noise_m=checked.frames.noise_m,
        inlier_share=checked.frames.inlier_share,
        degenerate=checked.frames.degenerate,
        sharpness=checked.sharpness,
        calibration=checked.calibration,
    )


def warnings_of(sequence: Sequence, checked: GivenCheck) -> list[str]:
    """Return warnings: jumps, implausible drift, many frames that disagree or could not be checked."""
    jumps = checked.frames.jumps
    # Stamps that only count frames add no information.
    counted = counts_frames(sequence.stamps_ns)
    messages = [
        f"the given trajectory jumps by {by_m * 1000:.0f} mm before frame {frame}"
        + ("" if counted else f" ({sequence.stamps_ns[frame] / 1e9:.3f} s)")
        for frame, by_m in jumps[:MAX_JUMPS_REPORTED]
    ]
    if len(jumps) > MAX_JUMPS_REPORTED:
        messages.append(f"it jumps {len(jumps) - MAX_JUMPS_REPORTED} more times")
    drift_m = checked.figures.distant_shift_m
    if drift_m is not None and drift_m > IMPLAUSIBLE_DRIFT_M:
        messages.append(
            f"distant frames disagree by {drift_m * 1000:.0f} mm: if the given trajectory does not drift so "
            "much, depth_scale or the clock of its stamps is wrong"
        )
    disagreeing, compared = checked.frames.disagrees.sum(), np.isfinite(checked.frames.shift_m).sum()
    if disagreeing > MANY * compared:
        messages.append(f"{disagreeing} of {compared} frames disagree with the given trajectory: {CAUSES}?")
    posed = has_pose(checked.T_given)
    unchecked = int((posed & np.isnan(checked.frames.shift_m)).sum())
    if unchecked > 0.5 * posed.sum():
        messages.append(
            f"{unchecked} of {posed.sum()} poses could not be checked: too little of the frames overlaps; "
            "are the poses in metres?"
        )
    return messages
