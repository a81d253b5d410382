"""The constants that made a solid, as quality.json keeps them under `method`."""

from pydantic import Field

from kinectbench.core.artefacts.stored import StoredPart
from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.types import Underside

Curve = tuple[tuple[float, float], ...]


class AirMethod(StoredPart):
    """The space that a camera could see, which defines air; lengths in metres."""

    line_width_m: float = Field(description="a line of sight is as wide")
    narrower: float = Field(description="lines of so much of that width are asked: slits are unknown")
    near_m: float = Field(description="a camera is at least so far from what it sees")
    camera_size_m: float = Field(description="diameter of the ball that is moved without crossing the object")
    camera_height_m: float = Field(description="its centre is at least so high above the plane")
    stands: bool = Field(description="false: without a plane that blocks lines and cameras")
    underside: Underside = Field(description="what a person says of it")
    directions: int = Field(description="of the lines that are tried")
    sheet_voxels: float = Field(description="a line ends so near to a surface, on both sides, voxels")

    @property
    def limits(self) -> SensorLimits:
        """The same lengths as `SensorLimits`."""
        return SensorLimits(self.line_width_m, self.near_m, self.camera_size_m, self.camera_height_m)


class CarriedLegs(StoredPart):
    """Rule for pieces on the floor that are legs with a hidden upper end; they are extended to the object."""

    min_height_m: float = Field(description="least height of such a piece, metres")
    max_gap_m: float = Field(description="most distance from its upper end to the object above, metres")
    end_layers: int = Field(description="layers that are its upper end, voxels")
    min_share: float = Field(description="least share of its columns there that have the object above them")


class FrontierMethod(StoredPart):
    """Which unseen regions that a camera could see are reported, and from where to look into them."""

    least_share: float = Field(description="least share of the solid's volume behind a frontier")
    least_underside_share: float | None = Field(None, description="the same for an underside")
    least_area_m2: float = Field(description="least area of a frontier, square metres")
    least_probability: float = Field(description="least probability that a voxel behind one is solid")
    enough: float | None = Field(
        None, description="a direction is good enough if it shows this share of what the best one shows"
    )


class EstimateMethod(StoredPart):
    """The estimate of the IoU to the unknown truth, and the terms of its interval."""

    off_m: float = Field(description="how far the surface is off whatever was measured, metres")
    off_if_thin_m: float = Field(
        description="how much farther, times the share of the volume that 1 mm of surface is, metres"
    )
    off_per_sigma: float = Field(description="how much farther, of the surface's standard deviation")
    off_per_pose: float = Field(description="how much farther, of what a usual pose may be off by")
    fitted_frames: int | None = Field(
        None, description="of each recording it was fitted to: more of them are taken for so many"
    )
    missed_more: float = Field(description="of what is estimated to be missing, that may be missing, too")
    missed_less: float = Field(description="of what is estimated to be missing, that may not be missing")
    missed_least: float = Field(description="of the solid, that may be missing or not, besides")
    coin_sigmas: float | None = Field(
        None, description="standard deviations of all unknown regions, each a coin, on both sides"
    )
    decided: float | None = Field(None, description="a voxel that is less probable, or more than 1 minus it")
    max_volume_share_per_mm: float = Field(
        description="of the volume, that 1 mm of surface is before thin parts are a reason"
    )
    max_shifted_share: float = Field(
        description="of the volume, that a usual pose's error moves before poses are a reason"
    )


class SolidMethod(StoredPart):
    """The constants that made a solid from the frames' votes; older files have further ones."""

    name: str = Field(description="its steps, in words")
    air: AirMethod | None = Field(None, description="the definition of air")
    least_weight_share: float | None = Field(
        None, description="of the surface's median weight: a voxel with less was not observed"
    )
    min_free_votes: int | None = Field(None, description="frames that must see through to carve a voxel")
    min_free_share: float | None = Field(None, description="of the frames that look there, that must do so")
    free_by_noise: tuple[float, float] | None = Field(
        None, description="share of frames that may see through what lies behind, and its growth a voxel"
    )
    voxels_per_free_share: float | None = Field(
        None, description="how far the other frames that see through move the surface inward, voxels"
    )
    trust_in_votes: tuple[tuple[float, ...], tuple[float, ...]] | None = Field(
        None, description="widths of the frames' rays in voxels, and what part of the votes is believed"
    )
    smoothing_voxels: float | None = Field(None, description="sigma of the Gaussian, voxels")
    speck_share: float | None = Field(
        None, description="of the largest piece's volume: pieces with less are dropped"
    )
    carried_legs: CarriedLegs | None = Field(None, description="of legs whose upper end was hidden")
    shell_m: float | None = Field(
        None, description="a surface tells what lies so far behind it, metres; deeper it is unseen"
    )
    shell_voxels: float | None = Field(None, description="the same in voxels, where that is more")
    measured_voxels: float | None = Field(
        None, description="a voxel is measured up to so far from a surface, voxels"
    )
    ruled: tuple[float, float] | None = Field(
        None, description="probability of a voxel that a rule calls solid, and air, against what was measured"
    )
    least_field: tuple[float, float] | None = Field(
        None, description="least absolute value of the field before it is smoothed, and after, voxels"
    )
    probability_by_signed_voxels: Curve | None = Field(
        None, description="[signed distance in voxels, probability] of observed voxels"
    )
    probability_roofed: Curve | None = Field(
        None, description="[share of 26 enclosing directions, probability] of unknown voxels under a roof"
    )
    probability_sky: Curve | None = Field(
        None, description="the same where straight up one leaves the object"
    )
    probability_rim: tuple[float, ...] | None = Field(
        None,
        description="of those right under the object that only a line's rim touches, by how many of eight "
        "level directions lead out",
    )
    probability_underside: tuple[float, float] | None = Field(
        None, description="of those seen only from below; and if a person says that it is open"
    )
    lengths_at_voxel_m: float | None = Field(
        None,
        description="edge of the voxels that these lengths are for, metres; where no setting gave voxels, "
        "smaller ones make them smaller in proportion, but for the lengths of `air`",
    )
    voxel_size_by_recording: tuple[float, float, int] | None = Field(
        None,
        description="where no setting gave it: least edge, and steps, metres; how many an object is long",
    )
    frontiers: FrontierMethod | None = Field(None, description="of what some camera could still see")
    estimate: EstimateMethod | None = Field(None, description="of the IoU to the unknown truth")
    chosen_on: str | None = Field(None, description="the data that the constants were chosen on")
