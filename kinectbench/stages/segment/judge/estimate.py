"""Estimate the IoU of the solid with the unknown truth, with an interval and the causes of its width.

Among them are parts that are too thin for their thickness to be measured, and what the floor cut took from
the object: surface beside it, too low to differ from the floor.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from kinectbench.core.artefacts.object import FLOOR_CUT
from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.trajectory.trajectory import UNCHECKED_POSE_SIGMA_M, Trajectory
from kinectbench.core.types import Bools
from kinectbench.stages.segment.find.floor import FLOOR_SIGMAS, Floor
from kinectbench.stages.segment.judge.frontiers import Frontier
from kinectbench.stages.segment.solid.evidence import FloorLayers, VoxelEvidence
from kinectbench.stages.segment.solid.solid import SolidShape

# The surface error: a constant, a term times the share of the volume that changes with each millimetre (thin
# parts wear away), a share of the deviation between the halves of odd and even frames, and a share of the
# median pose error. Fitted to what is missing from an IoU of 1 among the known voxels of 54 simulated objects
# of the families looked at (seeds 31 and 32).
OFF_M, OFF_M_IF_THIN, OFF_PER_SIGMA, OFF_PER_POSE = 0.00005, 0.00064, 0.95, 0.25
# Each of these objects had this many frames. More of them make the halves agree better, but the surface no
# better: with 540 in place of 180 of the same path the deviation of a chair and a lamp falls by a factor of
# 1.71 (the root of 3 is 1.73), and the IoU on known voxels changes by +0.003 and -0.016. So it is taken as if
# there were no more.
FITTED_FRAMES = 180
# What else a surface is off by where depth is not a Kinect v1's, as by time of flight: expected, and at the
# lower end of the interval. Of 1 to 2.5 mm and of 1.5 to 3.3 mm, the least mean error, and the narrowest that
# holds in as many of 23 recordings by a simulated Azure Kinect and a simulated phone
# (docs/evidence/ground-truth.md, The estimate).
UNKNOWN_BIAS_M, MOST_BIAS_M = 0.0015, 0.0025
# The interval of the IoU loss: a share of the estimated loss, and a constant besides. Of the intervals that
# hold in at least 95 % of these objects, this one is the narrowest on furniture.
MISSED_MORE, MISSED_LESS, MISSED_LEAST = 1.2, 0.7, 0.02
# Unknown voxels of a region depend on one another: the region counts as one draw. The interval spans this
# many standard deviations of all draws on both sides. A voxel within this of 0 or 1 is decided.
COIN_SIGMAS, DECIDED = 2.0, 0.05
# An error of 1 mm changes this much of the volume of parts that are 20 mm thick.
MAX_VOLUME_SHARE_PER_MM = 0.1
# Of the measured thickness of walls that are too thin to be resolved, half is expected; nothing is possible.
# They are a reason from this share of the known solid on (chosen by hand).
EXPECTED_OF_THIN, MAX_UNRESOLVED_SHARE = 0.5, 0.1
# Poses are a reason if their median error moves more of the volume than this (chosen by hand).
MAX_SHIFTED_SHARE = 0.03
# An opening takes this share from the edges of thick objects, too: of 22 families of parts of 10 mm and more,
# in voxels of 5 mm, at most .116 (docs/evidence/ground-truth.md, The estimate).
EDGE_SHARE = 0.12
# Share of the solid's volume from which the cut is reported. Measured: 0 to 0.001 for boards of 15 to 50 mm,
# chairs, a lamp, the cabinet and the kitchen; 0.03 for a ramp, 0.15 for a phone's board of 19 mm, whose rim
# is blurred, and 0.37 for a block on a plate of 12 mm.
LEAST_CUT_SHARE = 0.02
# The object's or a mat's: nobody knows which, so half of it is expected to be the object.
EXPECTED_SHARE = 0.5
# The least value of `segmentation.low_cut_m`, metres.
LEAST_LOW_M = 0.002


@dataclass(frozen=True)
class PoseError:
    """The median error of the poses.

    Attributes:
        median_m: metres; 0 for given poses that are trusted.
        checked: whether other frames could check the poses.
    """

    median_m: float
    checked: bool = True


def pose_error_of(trajectory: Trajectory) -> PoseError:
    """Return the median error of the poses: 0 for trusted given poses, an assumed one if none was checked."""
    median_m = trajectory.median_pose_sigma_m
    if trajectory.source == "trust":
        return PoseError(0.0, median_m is not None)
    return PoseError(UNCHECKED_POSE_SIGMA_M if median_m is None else median_m, median_m is not None)


@dataclass(frozen=True)
class IouEstimate:
    """The IoU of the solid to the unknown truth, in [0, 1].

    Attributes:
        value: the estimate.
        low: lower end of the interval, which allows for wrong guesses behind openings that no frame saw into.
        high: upper end; at most the IoU if all these guesses are right.
        measured_low: lower end if all these guesses are right, so that only the surface may be wrong.
        known: the IoU over known voxels alone, which only the error of the surface lowers.
        known_low: lower end of its interval.
        known_high: upper end of its interval.
        reasons: what widens the interval, a line each.
    """

    value: float
    low: float
    high: float
    measured_low: float
    known: float
    known_low: float
    known_high: float
    reasons: tuple[str, ...]


def volume_share_per_mm(mesh: TriangleMesh) -> float:
    """Return the share of a closed mesh's volume (metres) that changes if its surface moves by 1 mm."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    area_m2 = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
    return 0.001 * area_m2 / max(mesh.volume_m3, 1e-9)


@dataclass(frozen=True)
class _Volumes:
    """Expected volumes, as shares of a solid's volume.

    Attributes:
        known: the known part of the solid.
        inside: expected part of the object in the unknown part of the solid.
        outside: expected part of the object in the unknown voxels outside the solid.
    """

    known: float
    inside: float
    outside: float

    def iou(self, missing: float) -> float:
        """Return the IoU to the truth if the known part alone has the IoU 1 - `missing`."""
        # Half of the error is missing, half is excess: (1 - half) / (1 + half) is 1 - missing.
        half = min(missing, 1.0) / (2 - min(missing, 1.0))
        inside = self.known * (1 - half) + self.inside
        return float(np.clip(inside / (1 + self.known * half + self.outside), 0, 1))


def estimate_iou(
    shape: SolidShape,
    sigma_m: float,
    pose_error: PoseError,
    frontiers: tuple[Frontier, ...],
    frames: int = FITTED_FRAMES,
    unresolved: float = 0.0,
    *,
    bias_known: bool = True,
) -> IouEstimate:
    """Estimate the IoU to the unknown truth, and an interval.

    In the known part, only the surface error lowers the IoU. This error is the sum of a constant, a term for
    thin parts, the deviation between the halves of odd and even frames, and the poses' errors, which both
    halves share. Where the sensor's bias is unknown, a usual one is expected; the upper end of the interval
    has none. Of parts too thin to be resolved, half of the measured thickness is expected, and for the
    interval's lower end nothing. In the unknown part, the voxels' probabilities give the expected volumes.
    For the interval, each unknown region is inside or outside as a whole.

    Args:
        shape: the solid.
        sigma_m: standard deviation of the fused surface, metres.
        pose_error: the median error of the poses.
        frontiers: openings that no frame saw into.
        frames: how many frames were fused.
        unresolved: `unresolved_share` of the solid, in [0, 1].
        bias_known: whether depth is by a sensor like the one for which the error was fitted, a Kinect v1.
    """
    sigma_m *= max(1.0, frames / FITTED_FRAMES) ** 0.5
    per_mm = volume_share_per_mm(shape.mesh)
    median_m = pose_error.median_m if pose_error.checked else UNCHECKED_POSE_SIGMA_M
    shifted = 1000 * median_m * per_mm
    off_m = OFF_M + OFF_M_IF_THIN * per_mm + OFF_PER_SIGMA * sigma_m + OFF_PER_POSE * pose_error.median_m
    least_missing = 1000 * off_m * per_mm
    missing, most = least_missing, least_missing * (1 + MISSED_MORE) + MISSED_LEAST
    if not bias_known:
        missing, most = missing + 1000 * UNKNOWN_BIAS_M * per_mm, most + 1000 * MOST_BIAS_M * per_mm
    # Trusted poses that no frame could check cost nothing in the estimate, but widen the interval.
    most += 1000 * OFF_PER_POSE * (median_m - pose_error.median_m) * per_mm
    least = max(0.0, least_missing * (1 - MISSED_LESS) - MISSED_LEAST)
    # Of a part that is thinner than it was measured, what is left is the IoU.
    usual_left, least_left = 1 - (1 - EXPECTED_OF_THIN) * unresolved, 1 - unresolved
    expected = _expected(shape)
    value = expected.iou(1 - max(0.0, 1 - missing) * usual_left)
    spread = COIN_SIGMAS * _regions_sigma(shape, expected)
    worst = 1 - max(0.0, 1 - most) * least_left
    guessed = _Volumes(expected.known, 1 - expected.known, 0.0)
    # Over known voxels alone the same error acts on the known surface, and counts by the known volume.
    of_known = _known_surface_share(shape) / max(expected.known, 1e-9)
    return IouEstimate(
        value,
        max(0.0, expected.iou(worst) - spread),
        min(guessed.iou(least), expected.iou(least) + spread),
        guessed.iou(worst),
        max(0.0, 1 - missing * of_known) * usual_left,
        max(0.0, 1 - (most - MISSED_LEAST) * of_known - MISSED_LEAST) * least_left,
        min(1.0, 1 - least_missing * of_known * (1 - MISSED_LESS) + MISSED_LEAST),
        _reasons(frontiers, per_mm, unresolved, shifted, pose_error.checked, bias_known),
    )


def _known_surface_share(shape: SolidShape) -> float:
    """Return the share of the solid's voxel faces that have known voxels on both sides."""
    solid, known = shape.solid, shape.labels != Label.UNKNOWN
    faces = of_known = 0
    for axis in range(3):
        pairs = [np.moveaxis(grid, axis, 0) for grid in (solid, known)]
        crossed = pairs[0][:-1] != pairs[0][1:]
        faces += int(crossed.sum())
        of_known += int((crossed & pairs[1][:-1] & pairs[1][1:]).sum())
    return of_known / max(faces, 1)


def _expected(shape: SolidShape) -> _Volumes:
    """Expected volumes of a solid, by the probabilities of its unknown voxels."""
    unknown, volume = shape.labels == Label.UNKNOWN, int(shape.solid.sum())
    inside, outside = (
        float(shape.probability[unknown & part].sum(dtype=np.float64)) / volume
        for part in (shape.solid, ~shape.solid)
    )
    return _Volumes(1 - int((unknown & shape.solid).sum()) / volume, inside, outside)


def _regions_sigma(shape: SolidShape, expected: _Volumes) -> float:
    """Standard deviation of the IoU if each region of unknown voxels is inside or outside as a whole.

    A region is a 26-connected piece of unknown voxels whose probability is near neither 0 nor 1. Those of
    the underside are one region.
    """
    unknown, p = shape.labels == Label.UNKNOWN, shape.probability
    undecided = unknown & (p > DECIDED) & (p < 1 - DECIDED)
    pieces, count = ndimage.label(undecided & ~shape.underside, np.ones((3, 3, 3)))
    pieces[undecided & shape.underside] = count + 1
    inside = expected.known + expected.inside
    iou = inside / (1 + expected.outside)
    variance = 0.0
    for part, weight in ((shape.solid, 1.0), (~shape.solid, iou)):
        of = pieces[undecided & part]
        volumes = np.bincount(of, minlength=1)
        mean = np.bincount(of, p[undecided & part], minlength=1) / np.maximum(volumes, 1)
        shares = volumes / int(shape.solid.sum())
        variance += weight**2 * float((shares**2 * mean * (1 - mean)).sum())
    return float(np.sqrt(variance)) / (1 + expected.outside)


def _reasons(
    frontiers: tuple[Frontier, ...],
    per_mm: float,
    unresolved: float,
    shifted_share: float,
    checked: bool,
    bias_known: bool,
) -> tuple[str, ...]:
    """Return a line for each cause of a wider interval."""
    biased_mm = 0.0 if bias_known else 1000 * UNKNOWN_BIAS_M
    reasons = (
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
            unresolved > MAX_UNRESOLVED_SHARE,
            f"parts too thin for their thickness to be measured: {unresolved:.0%} of what is known",
        ),
        (
            shifted_share > MAX_SHIFTED_SHARE,
            f"poses: what they may be off by moves {shifted_share:.0%} of the volume"
            + ("" if checked else ", and other frames could not check them"),
        ),
        (
            biased_mm * per_mm > MAX_SHIFTED_SHARE,
            "depth that is not known to be a Kinect v1's: all of it may be off by millimetres, as by time of "
            f"flight, and {biased_mm:g} mm change {biased_mm * per_mm:.0%} of the volume",
        ),
    )
    return tuple(line for holds, line in reasons if holds)


def unresolved_share(shape: SolidShape) -> float:
    """Return the share of the known solid, in [0, 1], in parts whose thickness the voxels do not resolve.

    These are what an opening by a voxel and its six neighbours removes: walls of one or two voxels, and rods
    of up to about three. `EDGE_SHARE` of the known solid counts as edges.
    """
    known = shape.solid & (shape.labels != Label.UNKNOWN)
    removed = known & ~ndimage.binary_opening(shape.solid)
    share = int(removed.sum()) / max(1, int(known.sum()))
    return max(0.0, (share - EDGE_SHARE) / (1 - EDGE_SHARE))


@dataclass(frozen=True)
class FloorCut:
    """What the floor cut takes from an object.

    Attributes:
        share: volume of the columns of low surface beside the solid, divided by the solid's volume.
        is_whole: whether that surface ends within the object's grid; a carpet goes on beyond it.
        height_m: height above the floor up to which surface counts as floor, metres.
        lower_m: the value of `segmentation.low_cut_m` that lowers it by a voxel, metres; None: the floor's
            noise, or the setting's range, allows none.
        noise_m: standard deviation of the floor, metres.
    """

    share: float
    is_whole: bool
    height_m: float
    lower_m: float | None
    noise_m: float

    @property
    def counts(self) -> bool:
        """Whether so much is taken that it is reported."""
        return self.share >= LEAST_CUT_SHARE

    def warnings(self) -> tuple[str, ...]:
        """Return the warning, whose code is `floor_cut`; none if little is taken."""
        if not self.counts:
            return ()
        least = "" if self.is_whole else "at least "
        what = (
            f"{FLOOR_CUT}surface that touches the object, {least}{self.share:.0%} of its volume, lies lower "
            f"than {1000 * self.height_m:.0f} mm and counts as floor: all is well if it is a mat's; if it is "
            "the object's own, such as the rim of a board, solid and masks lack it"
        )
        if self.lower_m is not None:
            return (f"{what}: set `segmentation.low_cut_m: {self.lower_m:g}` (for all recordings)",)
        noise = f"a floor that scatters by {1000 * self.noise_m:.1f} mm"
        return (f"{what}, and differs too little from {noise}: record from nearer, on a smoother floor",)

    def applied(self, estimate: IouEstimate) -> IouEstimate:
        """Return the estimate with half of the cut volume missing, and at its lower end all of it.

        It is not changed by surface that goes on beyond the grid: most of that is carpet, and the volume of
        what is not would be unknown.
        """
        if not self.counts or not self.is_whole:
            return estimate
        usual, most = 1 / (1 + EXPECTED_SHARE * self.share), 1 / (1 + self.share)
        reason = (
            f"the floor cut: surface below it, {self.share:.0%} of the volume, may be the object's own; half "
            "of it is expected to be"
        )
        return replace(
            estimate,
            value=estimate.value * usual,
            low=estimate.low * most,
            measured_low=estimate.measured_low * most,
            known=estimate.known * usual,
            known_low=estimate.known_low * most,
            reasons=(*estimate.reasons, reason),
        )


def taken_by_floor_cut(
    evidence: VoxelEvidence, solid: Bools, others: Bools, layers: FloorLayers, voxel_m: float, floor: Floor
) -> FloorCut:
    """Measure the surface in the layers that count as floor that is connected to the solid, beside it.

    The lower half of these layers is not looked at: mats and the floor's noise are there. Of a single layer
    nothing is looked at. `solid` and `others`, voxels near other things or outside a given box, are bool in
    the shape of the evidence.
    """
    if layers.contact < 2:
        return FloorCut(0.0, True, layers.contact * voxel_m, None, floor.noise_m)
    skipped = layers.contact // 2
    low = slice(layers.below + skipped, layers.first)
    behind = evidence.observed[..., low] & ~evidence.free[..., low] & ~others[..., low]
    behind &= ~solid[..., layers.first, None]  # else the object itself goes on above
    pieces, _ = ndimage.label(behind | solid[..., low], np.ones((3, 3, 3)))
    taken = behind & np.isin(pieces, pieces[solid[..., low]])
    # A column of low surface has as many voxels as its top is high.
    columns = (taken * np.arange(skipped + 1, layers.contact + 1)).max(axis=2, initial=0)
    share = int(columns.sum()) / max(1, int(solid.sum()))
    is_whole = not any(side.any() for side in (columns[0], columns[-1], columns[:, 0], columns[:, -1]))
    lower_m = _lower_m((layers.contact - 1) * voxel_m, floor)
    return FloorCut(share, is_whole, layers.contact * voxel_m, lower_m, floor.noise_m)


def _lower_m(height_m: float, floor: Floor) -> float | None:
    """Return `segmentation.low_cut_m`, metres, by which surface up to a height is floor, not more; else None.

    `floor_cut_m` could be lowered further, but may then join the object and its neighbours.
    """
    value_m = round(height_m / floor.scale, 4)
    return value_m if height_m >= FLOOR_SIGMAS * floor.noise_m and value_m >= LEAST_LOW_M else None
