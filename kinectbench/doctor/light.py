"""Checks of colour as pictures: exposure, blur, and a frame that belongs to another scene."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from kinectbench.doctor.finding import Finding
from kinectbench.doctor.look import Look, SmallFrame
from kinectbench.tracking.sharpness import image_sharpness, relative_blur

WHITE, BLACK = 254, 8
MANY_SATURATED = 0.2
JUMP_RATIO = 1.25
FEW = 0.02
BLURRED, MANY_BLURRED = 2.5, 0.1
THUMB_PX = (40, 30)
# Depths that agree this closely, as a ratio, show the same place.
SAME_DEPTH = 1.15
# A frame is of another scene where those beside it agree this much more with each other than with it.
ODD_BY, BESIDE_AGREE = 0.4, 0.55


def check_light(look: Look) -> Iterator[Finding]:
    """Judge the colour images, and whether each frame looks like those beside it."""
    yield from _exposure(look)
    yield from _blur(look)
    yield from _odd_frames(look)


def _exposure(look: Look) -> Iterator[Finding]:
    grays = [frame.gray for frame in look.frames if frame.gray is not None]
    if not grays:
        return
    for name, share, how in (
        ("overexposed", np.median([(gray >= WHITE).mean() for gray in grays]), "white"),
        ("underexposed", np.median([(gray <= BLACK).mean() for gray in grays]), "black"),
    ):
        if share > MANY_SATURATED:
            what = f"{share:.0%} of the colour pixels are {how}"
            yield Finding(name, "note", what, look.where, "fix the exposure: colour helps to close loops")
    jumps = [
        second.index
        for first, second in look.neighbours()
        if _brightness_ratio(first, second) > JUMP_RATIO and _alike(_thumb(first), _thumb(second)) > 0.8
    ]
    if len(jumps) > FEW * len(grays):
        what = f"the brightness jumps before {len(jumps)} frames, such as {jumps[0]}"
        yield Finding("exposure_jumps", "note", what, look.where, "fix the exposure and white balance")


def _brightness_ratio(first: SmallFrame, second: SmallFrame) -> float:
    if first.gray is None or second.gray is None:
        return 1.0
    a, b = float(first.gray.mean()) + 1, float(second.gray.mean()) + 1
    return max(a / b, b / a)


def _blur(look: Look) -> Iterator[Finding]:
    blurs = relative_blur(
        np.array([np.nan if f.gray is None else image_sharpness(f.gray) for f in look.frames])
    )
    blurred = np.flatnonzero(blurs > BLURRED)
    if len(blurred) > MANY_BLURRED * max(int(np.isfinite(blurs).sum()), 1):
        what = f"{len(blurred)} of {len(blurs)} frames have under {1 / BLURRED:.0%} of the usual detail: blur"
        yield Finding("blur", "note", what, look.where, "move more slowly, or give it more light")


def _odd_frames(look: Look) -> Iterator[Finding]:
    thumbs = {frame.index: _thumb(frame) for frame in look.frames}
    odd = []
    for index, here in thumbs.items():
        before, after = thumbs.get(index - 1), thumbs.get(index + 1)
        if before is None or after is None:
            continue
        beside = _alike(before, after)
        if beside > BESIDE_AGREE and max(_alike(before, here), _alike(here, after)) < beside - ODD_BY:
            odd.append(index)
    if odd:
        what = (
            f"{len(odd)} frames look nothing like those beside them, such as frame {odd[0]}: another scene?"
        )
        yield Finding("odd_frames", "warning", what, f"{look.where}: frame {odd[0]}", "remove them")


def _thumb(frame: SmallFrame) -> NDArray[np.float32]:
    import cv2

    return np.asarray(cv2.resize(frame.depth_m, THUMB_PX, interpolation=cv2.INTER_NEAREST), np.float32)


def _alike(first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    """Share of the pixels measured in both whose depths agree; 1 where none is."""
    both = (first > 0) & (second > 0)
    if not both.any():
        return 1.0
    ratio = first[both] / second[both]
    return float(((ratio < SAME_DEPTH) & (ratio > 1 / SAME_DEPTH)).mean())
