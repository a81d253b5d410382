"""Checks of colour: exposure, blur, frames not in the order of time, and frames of another scene."""

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.images import image_sharpness, relative_blur
from kinectbench.core.trajectory.coverage import in_order_of_time
from kinectbench.doctor.finding import Finding
from kinectbench.doctor.probe import Probe, SmallFrame

WHITE, BLACK = 254, 8
MANY_SATURATED = 0.2
JUMP_RATIO = 1.25
FEW = 0.02
BLURRED, MANY_BLURRED = 2.5, 0.1
THUMB_PX = (40, 30)
# Depths whose ratio is below this show the same place.
SAME_DEPTH = 1.15
# A frame is of another scene if its neighbours agree with each other by this much more than with it.
ODD_BY, BESIDE_AGREE = 0.4, 0.55
# In seven ordered recordings, real and simulated, neighbouring frames agree in 0.90 to 1.00 of their pixels,
# at least 0.24 more than frames half the recording apart. In a shuffled recording they agree in 0.63, 0.03
# less than distant frames. In a static recording all frames agree. Short recordings are not judged.
MORE_SIMILAR, STILL_SIMILAR, FEWEST_IN_ORDER = 0.1, 0.9, 20


def check_light(probe: Probe) -> Iterator[Finding]:
    """Report faults of exposure, blur, frames not in the order of time, and frames of another scene."""
    yield from _exposure(probe)
    yield from _blur(probe)
    yield from _odd_frames(probe)


def _exposure(probe: Probe) -> Iterator[Finding]:
    grays = [frame.gray for frame in probe.frames if frame.gray is not None]
    if not grays:
        return
    for name, share, how in (
        ("overexposed", np.median([(gray >= WHITE).mean() for gray in grays]), "white"),
        ("underexposed", np.median([(gray <= BLACK).mean() for gray in grays]), "black"),
    ):
        if share > MANY_SATURATED:
            what = f"{share:.0%} of the colour pixels are {how}"
            yield Finding(name, "note", what, probe.where, "fix the exposure: colour helps to close loops")
    jumps = [
        second.index
        for first, second in probe.neighbours()
        if _brightness_ratio(first, second) > JUMP_RATIO and _match(_thumb(first), _thumb(second)) > 0.8
    ]
    if len(jumps) > FEW * len(grays):
        what = f"the brightness jumps before {len(jumps)} frames, such as {jumps[0]}"
        yield Finding("exposure_jumps", "note", what, probe.where, "fix the exposure and white balance")


def _brightness_ratio(first: SmallFrame, second: SmallFrame) -> float:
    if first.gray is None or second.gray is None:
        return 1.0
    a, b = float(first.gray.mean()) + 1, float(second.gray.mean()) + 1
    return max(a / b, b / a)


def _blur(probe: Probe) -> Iterator[Finding]:
    blurs = relative_blur(
        np.array([np.nan if f.gray is None else image_sharpness(f.gray) for f in probe.frames])
    )
    blurred = np.flatnonzero(blurs > BLURRED)
    if len(blurred) > MANY_BLURRED * max(int(np.isfinite(blurs).sum()), 1):
        few = f"under {1 / BLURRED:.0%} of the median detail"
        what = f"{len(blurred)} of {len(blurs)} frames have {few}: blur"
        yield Finding("blur", "note", what, probe.where, "move more slowly, or give it more light")


def _odd_frames(probe: Probe) -> Iterator[Finding]:
    thumbs = {frame.index: _thumb(frame) for frame in probe.frames}
    given = probe.recording.given_trajectory
    if given is not None and not in_order_of_time(given.T_world_camera):
        return  # views in no order of time do not resemble their neighbours
    if in_no_order(probe):
        what = "frames that follow each other are no more similar than any two: they are in no order of time"
        advice = "number them in the order in which they were recorded, or give their poses"
        yield Finding("frame_order", "warning", what, probe.where, advice)
        return
    odd = []
    for index, thumb in thumbs.items():
        before, after = thumbs.get(index - 1), thumbs.get(index + 1)
        if before is None or after is None:
            continue
        beside = _match(before, after)
        if beside > BESIDE_AGREE and max(_match(before, thumb), _match(thumb, after)) < beside - ODD_BY:
            odd.append(index)
    if odd:
        what = (
            f"{len(odd)} of {len(thumbs)} frames look nothing like those beside them, such as frame "
            f"{odd[0]}: another scene?"
        )
        yield Finding("odd_frames", "warning", what, f"{probe.where}: frame {odd[0]}", "remove them")


def in_no_order(probe: Probe) -> bool:
    """Whether frames without poses are in random order: neighbours hardly more similar than distant ones.

    The frames of the longest run are compared; distant frames are half that run apart. The result is False if
    the run has fewer than 20 frames, or if neighbours agree in 90 % of their pixels, as with a static camera.
    """
    thumbs = [_thumb(frame) for frame in probe.longest_run()]
    if probe.recording.given_trajectory is not None or len(thumbs) < FEWEST_IN_ORDER:
        return False
    beside, apart = (
        np.mean([_match(first, second) for first, second in zip(thumbs, thumbs[step:], strict=False)])
        for step in (1, len(thumbs) // 2)
    )
    return bool(beside < apart + MORE_SIMILAR and beside < STILL_SIMILAR)


def _thumb(frame: SmallFrame) -> NDArray[np.float32]:
    return np.asarray(cv2.resize(frame.depth_m, THUMB_PX, interpolation=cv2.INTER_NEAREST), np.float32)


def _match(first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    """Of the pixels with depth in both images, return the share that agrees to 15 %; 1 if there are none."""
    both = (first > 0) & (second > 0)
    if not both.any():
        return 1.0
    ratio = first[both] / second[both]
    return float(((ratio < SAME_DEPTH) & (ratio > 1 / SAME_DEPTH)).mean())
