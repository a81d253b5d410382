"""Find what the floor cut took from the object: surface beside it, too low to differ from the floor."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from kinectbench.core.artefacts.object import FLOOR_CUT
from kinectbench.core.types import Bools
from kinectbench.stages.segment.find.floor import FLOOR_SIGMAS, Floor
from kinectbench.stages.segment.judge.estimate import IouEstimate
from kinectbench.stages.segment.solid.evidence import FloorLayers, VoxelEvidence

# Share of the solid's volume from which the cut is reported. Measured: 0 to 0.001 for boards of 15 to 50 mm,
# chairs, a lamp, the cabinet and the kitchen; 0.03 for a ramp, 0.15 for a phone's board of 19 mm, whose rim
# is blurred, and 0.37 for a block on a plate of 12 mm.
LEAST_CUT_SHARE = 0.02
# The object's or a mat's: nobody knows which, so half of it is expected to be the object.
EXPECTED_SHARE = 0.5
# The least value of `segmentation.low_cut_m`, metres.
LEAST_LOW_M = 0.002


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
    nothing is looked at.

    Args:
        evidence: classes of the voxels.
        solid: bool, the solid on the same upright grid.
        others: bool, voxels near other things, or outside a given box.
        layers: of the floor on that grid.
        voxel_m: edge of a voxel, metres.
        floor: the floor.
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
