"""Grade given poses as a basis for ground truth, with the stage `track` of a build."""

from collections.abc import Iterator

import numpy as np

from kinectbench.core.errors import RecordingError, TrackingError
from kinectbench.core.trajectory.association import poses_at
from kinectbench.core.trajectory.compare import has_pose
from kinectbench.doctor.finding import Finding, Severity
from kinectbench.doctor.probe import Probe
from kinectbench.settings.models import TrackingSettings, TrajectoryMode
from kinectbench.stages.ingest.in_memory import as_sequence
from kinectbench.stages.track import track
from kinectbench.stages.track.track import MIN_GOOD_FRAMES

# Largest number of compared frames, evenly spread: 5.4 CPU seconds at 640 x 480.
MOST_FRAMES = 150


def check_grade(
    probe: Probe, tracking: TrackingSettings, mode: TrajectoryMode | None = None
) -> Iterator[Finding]:
    """Grade a given trajectory as the stage `track` does; up to 150 frames the result is the same.

    Args:
        probe: at a recording whose given trajectory can be read.
        tracking: what counts as disagreement.
        mode: the trajectory mode of the build. Refined poses are graded only after refinement.
    """
    count = len(probe.recording)
    every = count <= MOST_FRAMES
    # Longer recordings are read in part; shorter ones without their damaged frames.
    indices = [frame.index for frame in probe.frames]
    if not every:
        indices = np.linspace(0, count - 1, MOST_FRAMES).round().astype(int).tolist()
    which = "" if every else f", by {MOST_FRAMES} of {count} frames"
    refined, given = mode == "refine", probe.recording.given_trajectory
    assert given is not None
    posed = has_pose(poses_at(given, probe.recording.stamps_ns, tracking.max_stamp_gap_s))
    # In a longer recording the compared frames are farther apart; missing poses are certain all the same.
    certain = every or posed.sum() < MIN_GOOD_FRAMES
    try:
        sequence = as_sequence(probe.recording, indices)
        health = track(sequence, "trust" if refined else mode, tracking).health
    except TrackingError as error:
        severity: Severity = "stops" if certain and not refined else "warning"
        yield Finding("trajectory_wrong", severity, f"{error}{which}", probe.where)
        return
    except RecordingError as error:
        what = f"the given trajectory could not be graded here, only a build will: {error}"
        yield Finding("trajectory_ungraded", "note", what, probe.where)
        return
    assert health is not None
    if health.grade == "good" and health.recommended == "trust":
        return
    what, advice = f"the given trajectory{which}: {health.verdict}", ""
    bad = health.grade == "not good" or health.recommended != "trust"
    if refined:
        what += "; a build refines it, and grades the result"
    elif health.recommended != "trust":
        advice = f"recommended is `trajectory: {health.recommended}`"
    yield Finding("trajectory_grade", "warning" if bad and not refined else "note", what, probe.where, advice)
    # Frame indices agree with the build only if all frames were compared.
    for line in health.warnings if every else ():
        yield Finding("trajectory_check", "note", line, probe.where)
