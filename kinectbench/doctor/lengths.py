"""Check whether another depth scale or focal length fits the given poses better."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from kinectbench.core.types import Float64
from kinectbench.doctor.depth import check_intrinsics
from kinectbench.doctor.finding import Finding
from kinectbench.doctor.fit import FramePair, disagreements, pair_residual_m
from kinectbench.doctor.probe import Probe
from kinectbench.stages.ingest.recording import Recording

# Step factor of the search over depth scale and focal length, and the largest number of steps.
STEP, MOST_STEPS = 1.05, 4
# They are reported if other values lower the disagreement of poses and depth to less than this ratio.
# Measured: at least 0.985 remains for 22 real and simulated recordings with correct values. With the scale or
# the focal lengths 10 % off (11 recordings, both ways, 44 trials) less than 0.97 remains in all trials but
# one, with 5 % in 32.
MIN_RATIO_LEFT: Final = 0.97
# Name of the finding.
LENGTHS: Final = "lengths_doubtful"


@dataclass(frozen=True)
class Lengths:
    """Factors on depth and focal lengths with which the given poses fit best.

    Attributes:
        depth: factor on all depth values.
        focal: factor on both focal lengths.
        left: disagreement of poses and depth with these factors, divided by that without; 1 if no factors
            fit better.
    """

    depth: float
    focal: float
    left: float

    @property
    def implausible(self) -> bool:
        """Whether the factors fit so much better that the present values are implausible."""
        return self.left < MIN_RATIO_LEFT

    @property
    def at_limit(self) -> bool:
        """Whether `implausible` holds, and the factor on depth is at the limit of the search."""
        return self.implausible and abs(math.log(self.depth)) > (MOST_STEPS - 0.5) * math.log(STEP)


def fit_lengths(pairs: Sequence[FramePair], T_world_camera: Float64) -> Lengths:
    """Find the factors on depth and focal lengths with which given poses fit best, by descent in 5 % steps.

    The descent ends at a local minimum, at most four steps from 1 for each factor. Occluded surfaces add to
    the disagreement, too. So the factors are used only if they also reduce the median point-to-plane distance
    relative to the depth; otherwise both are 1.

    Args:
        pairs: the pairs of frames to compare.
        T_world_camera: (n, 4, 4), poses of the probe's frames, in the correct convention; those of paired
            frames are finite.
    """

    def cost(steps: tuple[int, int]) -> float:
        if steps not in known:
            depth, focal = (STEP**count for count in steps)
            changed = [_with(pair, depth, focal) for pair in pairs]
            known[steps] = float(disagreements(changed, T_world_camera[None]).mean())
        return known[steps]

    known: dict[tuple[int, int], float] = {}
    at = (0, 0)
    while True:
        beside = [(at[0] + i, at[1] + j) for i, j in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        best = min((steps for steps in beside if max(map(abs, steps)) <= MOST_STEPS), key=cost)
        if cost(best) >= cost(at):
            break
        at = best
    depth, focal = (STEP**count for count in at)
    changed_m = pair_residual_m([_with(pair, depth, focal) for pair in pairs], T_world_camera)
    if not changed_m / depth < pair_residual_m(pairs, T_world_camera):
        return Lengths(1.0, 1.0, 1.0)
    return Lengths(depth, focal, cost(at) / cost((0, 0)))


def _with(pair: FramePair, depth: float, focal: float) -> FramePair:
    """Return a pair with its depth and focal lengths multiplied by factors, and its points accordingly."""
    camera = replace(pair.camera, fx=pair.camera.fx * focal, fy=pair.camera.fy * focal)
    points = pair.points * (depth * np.array([1 / focal, 1 / focal, 1]))
    return replace(pair, points=points, depth_m=pair.depth_m * np.float32(depth), camera=camera)


def stated_scale(recording: Recording) -> float:
    """Return the units per metre of depth in the files, as the setting `depth_scale` has it."""
    return recording.depth_scale if recording.float_scale is None else recording.float_scale


def check_lengths(probe: Probe, lengths: Lengths) -> Iterator[Finding]:
    """Report a depth scale or focal lengths with which the given poses fit much better.

    Nothing is reported if another focal length fits and the intrinsics are implausible (`check_intrinsics`):
    they explain the misfit, and other lengths would only hide it.
    """
    if not lengths.implausible or (lengths.focal != 1 and any(check_intrinsics(probe))):
        return
    recording = probe.recording
    parts, values = [], dict[str, float]()
    if lengths.depth != 1:
        parts.append(f"depth {lengths.depth:.2f} times as far")
        values["depth_scale"] = stated_scale(recording) / lengths.depth
    if lengths.focal != 1:
        parts.append(f"focal lengths {lengths.focal:.2f} times as long")
        values |= {"fx": recording.camera.fx * lengths.focal, "fy": recording.camera.fy * lengths.focal}
    written = ", ".join(f"{key}: {value:.4g}" for key, value in values.items())
    yield Finding(
        LENGTHS,
        "warning",
        f"the given poses fit the depth better with {' and '.join(parts)} "
        f"({1 - lengths.left:.0%} less disagreement): the object's size or shape may be wrong",
        probe.where,
        f"look at depth_scale, at the intrinsics and at the poses' unit; of what was tried "
        f"`camera: {{{written}}}` fits best",
    )
