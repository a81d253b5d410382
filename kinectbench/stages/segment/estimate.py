"""How near the solid is to the truth that nobody knows: an estimate, an interval, and what widens it."""

from dataclasses import dataclass

import numpy as np

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.trajectory.trajectory import UNCHECKED_POSE_SIGMA_M
from kinectbench.stages.segment.frontiers import Frontier
from kinectbench.stages.segment.solid import SolidShape

# By how much the surface may be off, of what was measured: so much; more, the more of the volume changes with
# each millimetre, since thin parts wear away; of the deviation between the halves that odd and even frames
# make; and of what a usual pose may be off by. Fitted to what is missing from an IoU of 1 among the known
# voxels of 54 simulated objects of the families looked at (seeds 31 and 32).
OFF_M, OFF_M_IF_THIN, OFF_PER_SIGMA, OFF_PER_POSE = 0.00005, 0.00064, 0.95, 0.25
# By how much more or less may be missing: a share of what is estimated, and so much beside. Of intervals that
# hold in at least 95 % of these objects, that with the least width on furniture.
MISSED_MORE, MISSED_LESS, MISSED_LEAST = 1.2, 0.7, 0.02
# What is unknown is not independent from voxel to voxel: a region of it is one coin. The interval has so many
# standard deviations of all coins together on both sides, and no voxel counts that is as good as decided.
COIN_SIGMAS, DECIDED = 2.0, 0.05
# A surface that is off by 1 mm changes so much of the volume of parts that are 20 mm thick.
MAX_VOLUME_SHARE_PER_MM = 0.1
# So much of the volume moves with a usual pose before poses are a reason (own choice).
MAX_SHIFTED_SHARE = 0.03


@dataclass(frozen=True)
class PoseError:
    """By how much a usual pose may be off.

    Attributes:
        usual_m: metres; 0 if given poses are taken at their word.
        checked: other frames could check the poses.
    """

    usual_m: float
    checked: bool = True


@dataclass(frozen=True)
class IouEstimate:
    """The IoU of the solid to the unknown truth, in [0, 1].

    Attributes:
        value: the estimate.
        low: the lower end of an interval; behind an opening that nobody looked into the other guess may be
            right.
        high: its upper end; the guess behind every opening is right.
        reasons: what widens the interval, a line each.
    """

    value: float
    low: float
    high: float
    reasons: tuple[str, ...]


def volume_share_per_mm(mesh: TriangleMesh) -> float:
    """What share of the volume of a closed mesh (metres) changes if its surface moves by 1 mm."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    area_m2 = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
    return 0.001 * area_m2 / max(mesh.volume_m3, 1e-9)


@dataclass(frozen=True)
class _Volumes:
    """What is expected of a solid, as shares of its volume.

    Attributes:
        known: of the solid, what is known.
        inside: of its unknown part, what is expected to be inside.
        outside: of the unknown beside it, what is expected to be inside.
    """

    known: float
    inside: float
    outside: float

    def iou(self, missing: float) -> float:
        """The IoU to the truth if the known part misses so much of an IoU of 1."""
        # Half of what is wrong is missing, half too much: (1 - half) / (1 + half) is 1 - missing.
        half = min(missing, 1.0) / (2 - min(missing, 1.0))
        inside = self.known * (1 - half) + self.inside
        return float(np.clip(inside / (1 + self.known * half + self.outside), 0, 1))


def estimate_iou(
    shape: SolidShape, sigma_m: float, pose_error: PoseError, frontiers: tuple[Frontier, ...]
) -> IouEstimate:
    """An estimate of the IoU to the unknown truth, and an interval (own rule).

    The known part misses what a surface costs that is off by a sum: of what every surface is off by, thin
    parts more, of the deviation between the halves that odd and even frames make, and of the poses' errors,
    which both share. Of
    the unknown part its probabilities say what to expect; the interval takes each unknown region for a coin.

    Args:
        shape: the solid.
        sigma_m: standard deviation of the fused surface, metres.
        pose_error: of a usual pose.
        frontiers: openings that nobody looked into.
    """
    per_mm = volume_share_per_mm(shape.mesh)
    usual_m = pose_error.usual_m if pose_error.checked else UNCHECKED_POSE_SIGMA_M
    shifted = 1000 * usual_m * per_mm
    # Given poses that nobody could check are taken at their word, but for the worst.
    off_m = OFF_M + OFF_M_IF_THIN * per_mm + OFF_PER_SIGMA * sigma_m + OFF_PER_POSE * pose_error.usual_m
    missing = 1000 * off_m * per_mm
    most = missing * (1 + MISSED_MORE) + MISSED_LEAST
    # Given poses that nobody could check: what they were not charged for above.
    most += 1000 * OFF_PER_POSE * (usual_m - pose_error.usual_m) * per_mm
    least = max(0.0, missing * (1 - MISSED_LESS) - MISSED_LEAST)
    expected = _expected(shape)
    value = expected.iou(missing)
    coins = COIN_SIGMAS * _coins_sigma(shape, expected)
    guessed = _Volumes(expected.known, 1 - expected.known, 0.0)
    return IouEstimate(
        value,
        max(0.0, expected.iou(most) - coins),
        min(guessed.iou(least), expected.iou(least) + coins),
        _reasons(frontiers, per_mm, shifted, pose_error.checked),
    )


def _expected(shape: SolidShape) -> _Volumes:
    """What its probabilities expect of the unknown part of a solid."""
    unknown, volume = shape.labels == Label.UNKNOWN, int(shape.solid.sum())
    inside, outside = (
        float(shape.probability[unknown & part].sum(dtype=np.float64)) / volume
        for part in (shape.solid, ~shape.solid)
    )
    return _Volumes(1 - int((unknown & shape.solid).sum()) / volume, inside, outside)


def _coins_sigma(shape: SolidShape, expected: _Volumes) -> float:
    """Standard deviation of the IoU if each region of unknown voxels is inside or not as a whole.

    A region is a piece of unknown voxels that are not decided (26 neighbours); all of the underside is one.
    """
    from scipy import ndimage

    unknown, p = shape.labels == Label.UNKNOWN, shape.probability
    asked = unknown & (p > DECIDED) & (p < 1 - DECIDED)
    pieces, count = ndimage.label(asked & ~shape.underside, np.ones((3, 3, 3)))
    pieces[asked & shape.underside] = count + 1
    inside = expected.known + expected.inside
    iou = inside / (1 + expected.outside)
    variance = 0.0
    for part, weight in ((shape.solid, 1.0), (~shape.solid, iou)):
        of = pieces[asked & part]
        volumes = np.bincount(of, minlength=1)
        mean = np.bincount(of, p[asked & part], minlength=1) / np.maximum(volumes, 1)
        shares = volumes / int(shape.solid.sum())
        variance += weight**2 * float((shares**2 * mean * (1 - mean)).sum())
    return float(np.sqrt(variance)) / (1 + expected.outside)


def _reasons(
    frontiers: tuple[Frontier, ...], per_mm: float, shifted_share: float, checked: bool
) -> tuple[str, ...]:
    """A line for each thing that widens the interval."""
    told = (
        (
            any(not each.underside for each in frontiers),
            "an opening that nobody looked into: what is behind it is a guess",
        ),
        (
            any(each.underside for each in frontiers),
            "an underside that nobody saw: what is behind it is a guess",
        ),
        (per_mm > MAX_VOLUME_SHARE_PER_MM, f"thin parts: 1 mm of surface is {per_mm:.0%} of the volume"),
        (
            shifted_share > MAX_SHIFTED_SHARE,
            f"poses: what they may be off by moves {shifted_share:.0%} of the volume"
            + ("" if checked else ", and other frames could not check them"),
        ),
    )
    return tuple(line for holds, line in told if holds)
