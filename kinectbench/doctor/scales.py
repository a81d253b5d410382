"""Solve for the depth scale with which given poses fit the depth."""

import math
from dataclasses import dataclass

import numpy as np

from kinectbench.core.types import Float64
from kinectbench.doctor.depth import depth_quantiles_m, is_likely
from kinectbench.doctor.fit import FramePair, disagreements, frames_of
from kinectbench.doctor.lengths import STEP
from kinectbench.doctor.probe import Probe
from kinectbench.doctor.trajectory import HOPELESS, LEAST_PAIRS, posed_pairs
from kinectbench.stages.ingest.plausibility import COMMON_SCALES

# Units per metre that are tried: those of metres to those of 0.01 mm.
SMALLEST, LARGEST = 1.0, 100000.0
# Besides the common ones: 0.5 mm, the RealSense L515's 0.25 mm, 65535 / 10 m (Replica's rendered depth), and
# 0.125 mm.
KNOWN_SCALES = (*COMMON_SCALES, 2000.0, 4000.0, 6553.5, 8000.0)
# A solved scale this near to a known one is rounded to it: the search's last step is 0.5 %, and the pixels of
# the small depth images leave about 1 %.
NEAR_KNOWN, LAST_STEP = 1.02, 1.005
# Another scale is offered only if it lowers the disagreement to this ratio. Measured: 0.99 or more remains
# for six recordings with correct scales, 0.60 with a scale 1.25 times too small, 0.38 to 0.46 with one 2 to
# 6.5 times too small.
CLEARLY = 0.75


@dataclass(frozen=True)
class SolvedScale:
    """The depth scale with which given poses fit the depth best.

    Attributes:
        units: units per metre: a known scale if one is within 2 %, else of three digits.
        factor: that scale / the recording's; the poses fit also with positions that many times as long.
    """

    units: float
    factor: float


def solve_scale(probe: Probe) -> SolvedScale | None:
    """Find the depth scale with which the poses, read as they are, disagree least with the depth.

    Scales from 1 to 100000 units a metre are tried if they make the depth plausible for a room, in steps of
    5 %, and near the best in steps of 0.5 %. The result is None if there are too few poses to judge, or if no
    scale fits clearly better than the recording's.
    """
    posed = posed_pairs(probe)
    if posed is None:
        return None
    poses, pairs = posed
    present = probe.recording.depth_scale
    _, median_m, far_m = depth_quantiles_m(probe).tolist()
    reach = round(math.log(LARGEST / SMALLEST) / math.log(STEP))
    factors = STEP ** np.arange(-reach, reach + 1.0)
    inside = (factors * present >= SMALLEST) & (factors * present <= LARGEST)
    likely = [is_likely(median_m / factor, far_m / factor) for factor in factors.tolist()]
    factors = factors[inside & likely]
    if not len(factors):
        return None
    table = _table(factors, pairs, poses)
    fitting = table.min(axis=0) < HOPELESS
    if fitting.sum() < LEAST_PAIRS:
        return None
    usable = [pair for pair, fits in zip(pairs, fitting, strict=True) if fits]
    rough = float(factors[table[:, fitting].mean(axis=1).argmin()])
    steps = math.ceil(math.log(STEP) / math.log(LAST_STEP))
    fine = rough * LAST_STEP ** np.arange(-steps, steps + 1.0)
    costs = _table(np.append(fine, 1.0), usable, poses).mean(axis=1)
    best = int(costs[:-1].argmin())
    if costs[best] > CLEARLY * costs[-1]:
        return None
    units = _rounded(present * float(fine[best]))
    return SolvedScale(units, units / present)


def _table(factors: Float64, pairs: tuple[FramePair, ...] | list[FramePair], poses: Float64) -> Float64:
    """Return the disagreement in each pair at so many times the depth scale: (factors, pairs).

    Positions that many times as long are compared instead: the disagreement is relative to the depth.
    """
    paired = np.full_like(poses, np.nan)
    paired[frames_of(pairs)] = poses[frames_of(pairs)]
    longer = np.repeat(paired[None], len(factors), axis=0)
    longer[..., :3, 3] *= factors[:, None, None]
    return disagreements(pairs, longer)


def _rounded(units: float) -> float:
    known = min(KNOWN_SCALES, key=lambda each: abs(math.log(each / units)))
    return known if 1 / NEAR_KNOWN <= units / known <= NEAR_KNOWN else float(f"{units:.3g}")
