"""Frames whose depth agrees far worse with the frames around them than that of nearly all others."""

from collections.abc import Mapping

import numpy as np

from kinectbench.core.artefacts.trajectory import Source
from kinectbench.core.types import Bools, Float64

STANDS_OUT = "its depth lies farther from the frames around it than that of nearly all others"
ADVICE: dict[Source, str] = {
    "tracked": "turn and walk more slowly there",
    "refine": "turn and walk more slowly there",
    "trust": "the given poses are off there, as after a fast turn; `trajectory: refine` may bring them back",
}
# A frame stands out by its modified z-score, 0.6745 times its distance from the median over the median of all
# such distances (Iglewicz and Hoaglin 1993: above 3.5), and only if its residual is twice the median, too, as
# most frames may agree to a hair (own choice: frames of a fast turn 3.6 to 4.5 times; of 300 frames of three
# recordings without one 1.35 times at most).
MODIFIED_Z, Z_OF_MEDIAN, STANDING_OUT = 3.5, 0.6745, 2.0


def stand_out(residual: Float64, judged: Bools) -> Bools:
    """Which frames agree far worse with the others than nearly all do (own rule): (n,).

    A frame of a fast turn may be registered well enough to be believed, and centimetres off. What noise
    explains is no sign of it.

    Args:
        residual: (n,) of each frame to keyframes around it, over what noise alone makes of it; NaN: unknown.
        judged: (n,) which frames count.
    """
    known = judged & np.isfinite(residual)
    if not known.any():
        return known
    usual = np.median(residual[known])
    spread = np.median(np.abs(residual[known] - usual))
    far = Z_OF_MEDIAN * (residual - usual) > MODIFIED_Z * spread
    odd: Bools = known & far & (residual > np.maximum(STANDING_OUT * usual, 1.0))
    return odd


def odd_frames(reasons: Mapping[int, str], source: Source) -> list[str]:
    """A line for people about the frames that were left out because they stand out, if there are any.

    Args:
        reasons: why each lost frame has no pose, by frame.
        source: where the poses are from.
    """
    frames = sorted(frame for frame, reason in reasons.items() if reason == STANDS_OUT)
    if not frames:
        return []
    which = f"{len(frames)} frames ({frames[0]} to {frames[-1]})" if len(frames) > 1 else f"frame {frames[0]}"
    return [f"left out: {which}: {STANDS_OUT}; {ADVICE[source]}"]
