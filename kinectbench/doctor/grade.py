"""Grade given poses as a basis for ground truth, by running the stage `track` on some frames."""

from collections.abc import Callable, Iterator
from collections.abc import Sequence as Items
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import RecordingError, TrackingError
from kinectbench.core.even_choice import evenly
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.association import poses_at
from kinectbench.core.trajectory.compare import has_pose
from kinectbench.doctor.finding import Finding, Severity
from kinectbench.doctor.probe import Probe
from kinectbench.doctor.still import wrong_at_one_place
from kinectbench.settings.models import TrackingSettings, TrajectoryMode
from kinectbench.stages.ingest.images import decode_color_bgr
from kinectbench.stages.ingest.plausibility import check_color, check_size, trajectory_problem
from kinectbench.stages.ingest.recording import RawFrame, Recording
from kinectbench.stages.ingest.sequence_writer import onto_depth
from kinectbench.stages.track import track
from kinectbench.stages.track.track import MIN_GOOD_FRAMES

# Largest number of frames that are compared, evenly spread: 5.4 CPU seconds at 640 x 480.
MOST_FRAMES = 150


def check_grade(
    probe: Probe, tracking: TrackingSettings, mode: TrajectoryMode | None = None
) -> Iterator[Finding]:
    """Grade a given trajectory by the stage `track`, on at most 150 frames.

    Report a grade that is not good, a recommended trajectory mode other than `trust`, or that the trajectory
    could not be graded. Poses to be refined, by the build's trajectory mode, are graded as given; the build
    grades them after refinement.
    """
    count = len(probe.recording)
    every = count <= MOST_FRAMES
    indices = [index for index in evenly(count, MOST_FRAMES).tolist() if _is_whole(probe.recording, index)]
    which = "" if every else f", by {len(indices)} of {count} frames"
    refined, given = mode == "refine", probe.recording.given_trajectory
    assert given is not None
    posed = has_pose(poses_at(given, probe.recording.stamps_ns, tracking.max_stamp_gap_s))
    # In a longer recording compared frames are farther apart, but missing poses are certain.
    certain = every or posed.sum() < MIN_GOOD_FRAMES
    try:
        sequence = _as_sequence(probe.recording, indices)
        health = track(sequence, "trust" if refined else mode, tracking).health
    except TrackingError as error:
        severity: Severity = "stops" if certain and not refined else "warning"
        general = Finding("trajectory_wrong", severity, f"{error}{which}", probe.where)
        yield replace(next(wrong_at_one_place(probe), general), severity=severity)
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


def _is_whole(recording: Recording, index: int) -> bool:
    """Return whether a frame is neither damaged nor of another size; builds leave such frames out."""
    try:
        frame = recording.frame(index)
        check_size(frame, recording)
        check_color(frame, recording)
        if frame.color is not None:
            decode_color_bgr(frame.color[1], f"colour of {frame.name}")
    except RecordingError:
        return False
    return True


def _as_sequence(recording: Recording, indices: Items[int]) -> Sequence:
    """Return some frames of a recording as a sequence, with the depth and colour of a build's sequence.

    The frames must be in increasing order, undamaged and of one size. Colour is left out if it is neither
    registered to depth nor can be registered by a calibration.
    """
    problem = trajectory_problem(recording)
    register = onto_depth(recording)
    return Sequence(
        camera=recording.camera,
        depth_scale=recording.depth_scale,
        stamps_ns=recording.stamps_ns[list(indices)],
        color_registered=recording.color_registered or register is not None,
        given_trajectory=None if problem else recording.given_trajectory,
        trajectory_error=problem,
        frames=_RecordedFrames(recording, indices, register),
    )


class _RecordedFrames:
    """Reads a sequence's frames from an open recording; caches the last, whose colour is often read next."""

    def __init__(
        self, recording: Recording, indices: Items[int], register: Callable[[RawFrame], RawFrame] | None
    ) -> None:
        self._recording, self._indices, self._register = recording, indices, register
        self._last: tuple[int, RawFrame] | None = None

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        """Return the recorded depth of a frame: (height, width) uint16, 0 = no measurement."""
        return self._frame(index).depth

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        """Return the encoded colour of a frame, registered to depth: (suffix, bytes); None if impossible."""
        if self._register is not None:
            return self._register(self._frame(index)).color
        return self._frame(index).color if self._recording.color_registered else None

    def _frame(self, index: int) -> RawFrame:
        if self._last is None or self._last[0] != index:
            self._last = (index, self._recording.frame(self._indices[index]))
        return self._last[1]
