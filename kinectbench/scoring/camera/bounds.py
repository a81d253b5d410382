"""Best scores that the truth's uncertainty allows, and metrics as the code of other papers computes them."""

import math

import numpy as np

from kinectbench.core.artefacts.score_figures import AsPapers, Ceiling
from kinectbench.core.types import MM_PER_M, Float64
from kinectbench.scoring.camera.assignment import assigned_mean_m
from kinectbench.scoring.camera.nearest import Samples
from kinectbench.scoring.camera.surface import Surface

# Number of points of each surface that AdaPoinTr on PCN (2e53e72) and LaS-Comp (2301d7b) compare.
POINTS, SEED = 16_384, 0
# PCN and AdaPoinTr multiply distances by 1000; the tolerance of their F-score is 0.01 normalised units.
PCN_FACTOR, PCN_TOLERANCE = 1000.0, 0.01


def ceiling(
    sigma_m: float, tolerances_m: dict[str, float], area_m2: float, volume_m3: float
) -> Ceiling | None:
    """Return the best scores that a truth with surface error `sigma_m` allows; None if `sigma_m` is 0.

    These are the scores of a prediction that equals the real surface. The truth deviates from that surface
    along the normal by a distance d, which is normally distributed with standard deviation sigma. So the mean
    of |d| is sigma sqrt(2 / pi), the mean of d^2 is sigma^2, and the share of the surface within a tolerance
    tau is erf(tau / (sigma sqrt 2)). The truth lacks a volume of area x mean |d| / 2, and has the same volume
    in excess.

    Args:
        sigma_m: standard deviation of the truth's surface, metres.
        tolerances_m: {name of an F-score: its tolerance}, metres.
        area_m2: area of the known true surface of the scored part.
        volume_m3: volume of the known true cells of the part; if it is 0, the best IoU is None.
    """
    if not sigma_m > 0:
        return None
    mean_m = sigma_m * math.sqrt(2 / math.pi)
    off_m3 = area_m2 * mean_m / 2
    return Ceiling(
        chamfer_l1_m=mean_m,
        chamfer_l2_m2=sigma_m**2,
        iou=max(volume_m3 - off_m3, 0.0) / (volume_m3 + off_m3) if volume_m3 else None,
        **{name: math.erf(far / (sigma_m * math.sqrt(2))) for name, far in tolerances_m.items()},
    )


def as_papers(
    octmae: dict[str, float], ours: Surface, theirs: Surface, size_m: float, emd: bool = False
) -> AsPapers:
    """Return metrics as the code of OctMAE, PCN and SDS-Complete computes them.

    Args:
        octmae: OctMAE's metrics, computed by the caller: {field of `AsPapers`: value}.
        ours: the part of the predicted surface in known space, not empty.
        theirs: the known true surface, not empty.
        size_m: diagonal of the truth's bounding box, metres; PCN's distances are in thousandths of this
            diagonal.
        emd: whether to compute the earth mover's distance, which takes seven seconds.
    """
    one, other = points_by_area(ours), points_by_area(theirs)
    emd_m = None
    if emd:
        emd_m = assigned_mean_m(one, other)
    ways = [_nearest_distances(one, other), _nearest_distances(other, one)]
    l1_m, l2_m2 = sum(way.mean() for way in ways), sum((way**2).mean() for way in ways)
    near = [float((way < PCN_TOLERANCE * size_m).mean()) for way in ways]
    return AsPapers(
        **octmae,
        pcn_chamfer_l1=float(l1_m / 2 / size_m * PCN_FACTOR),
        pcn_chamfer_l2=float(l2_m2 / size_m**2 * PCN_FACTOR),
        pcn_f=2 * near[0] * near[1] / sum(near) if sum(near) else 0.0,
        sds_chamfer_l1_mm=float(l1_m / 2 * MM_PER_M),
        sds_chamfer_l2_mm2=float(l2_m2 * MM_PER_M**2),
        sds_emd_mm=None if emd_m is None else emd_m * MM_PER_M,
    )


def points_by_area(surface: Surface) -> Float64:
    """Draw 16,384 samples of a surface by area, with replacement and a fixed seed: (16384, 3), metres."""
    area = np.cumsum(surface.areas)
    places = np.sort(np.random.default_rng(SEED).random(POINTS)) * area[-1]
    found: Float64 = surface.points_m[np.minimum(np.searchsorted(area, places), len(area) - 1)]
    return found


def _nearest_distances(points_m: Float64, others_m: Float64) -> Float64:
    return Samples(others_m).nearest(points_m)[0]
