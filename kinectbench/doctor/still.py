"""Detect a static camera, such as one in front of a turntable, and report it with advice."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from kinectbench.core.sequence import Sequence
from kinectbench.core.still_camera import Watched, some_of, watch, watch_some
from kinectbench.doctor.color import in_no_order
from kinectbench.doctor.finding import Finding
from kinectbench.doctor.probe import Probe

TURNTABLE = "put `segment_by: turntable` of the recording into benchmark.yaml if an object turns on the spot"
MASKS = "if it is carried about, give a mask of every frame and `segment_by: masks`"
OWN_MASKS = "put `segment_by: masks` of the recording into benchmark.yaml: it brings masks of the object"
WALK = "walk around the object, or let it turn"
OBJECTS_POSES = "if the given poses are the camera's as seen from the object, `trajectory: trust` uses them"
# Findings about a static camera: all its poses are the same.
NO_MOTION = frozenset({"one_view", "turntable"})
# Poses of one place: their positions differ by less than this share of the median depth (our own bound).
ONE_PLACE = 0.01
PLAIN = "nothing but the object gives depth, so that it does not matter whether it turned or the camera moved"


def check_still(probe: Probe) -> Iterator[Finding]:
    """Report a static camera, or a background without depth.

    A static camera is reported as `turntable` if something moves in front of it, and as `one_view` if nothing
    does. A background without depth is reported as `plain_background`, and then nothing else is. Nothing is
    reported for fewer than six frames. Frames in no order of time are not from a static camera: all depth of
    a camera above a bare floor is the same where nothing stands on it.
    """
    frames = [probe.frames[index] for index in some_of(len(probe.frames))]
    shape = (probe.small_camera.height, probe.small_camera.width)
    frames = [frame for frame in frames if frame.depth_m.shape == shape]
    watched = watch([frame.depth_m for frame in frames], [frame.gray for frame in frames])
    if watched is None:
        return
    if watched.plain:
        advice = f"{TURNTABLE}: all of it is then the object, and no floor is needed"
        yield Finding("plain_background", "note", PLAIN, probe.where, advice)
    elif watched.camera_still and not watched.something_moves:
        what = "the camera stands still, and nothing moves before it: all frames show one view"
        yield Finding("one_view", "warning", what, probe.where, WALK)
    elif watched.camera_still and not in_no_order(probe):
        has_masks = probe.recording.frame(probe.frames[0].index).mask is not None
        yield Finding("turntable", "warning", _what(watched), probe.where, _advice(has_masks))


def with_objects_poses(still: list[Finding]) -> list[Finding]:
    """Add to the advice about a turning object that the given poses, which move, may be the object's."""
    return [
        replace(each, advice=f"{each.advice}; {OBJECTS_POSES}") if each.name == "turntable" else each
        for each in still
    ]


def wrong_at_one_place(probe: Probe) -> Iterator[Finding]:
    """Report given poses, known not to fit depth, that have one position: those of a mount or a turntable."""
    given = probe.recording.given_trajectory
    if given is None or not probe.frames:
        return
    measured = np.concatenate([frame.depth_m[frame.depth_m > 0] for frame in probe.frames])
    spread = np.ptp(given.T_world_camera[:, :3, 3], axis=0).max()
    if len(measured) and spread <= ONE_PLACE * np.median(measured):
        what = (
            "the given poses do not fit the depth, and all have one position, as a turntable's or a mount's"
        )
        yield Finding("trajectory_wrong", "stops", what, probe.where, f"`trajectory: ignore`; {TURNTABLE}")


def turntable_warning(sequence: Sequence) -> str:
    """Return the warning of `check_still` about a static camera and a moving object, one line; "" if none."""
    watched = watch_some(sequence).watched
    if watched is None or not (watched.camera_still and watched.something_moves):
        return ""
    return f"{_what(watched)}; {_advice(sequence.masks is not None)}"


def _what(watched: Watched) -> str:
    share = watched.moving_share
    return f"the camera stands still, and something moves before it, in {share:.0%} of the image"


def _advice(has_masks: bool) -> str:
    return OWN_MASKS if has_masks else f"{TURNTABLE}; {MASKS}"
