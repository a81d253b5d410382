"""The constants that made a solid, as quality.json keeps them under `method`."""

from pydantic import Field

from kinectbench.core.artefacts.stored import StoredPart, optional
from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.types import Underside

Curve = tuple[tuple[float, float], ...]


class AirMethod(StoredPart):
    """The space that a camera could see, which defines air; lengths in metres."""

    line_width_m: float = Field(description="width of a line of sight")
    narrower: float = Field(
        description="share of that width that narrower lines have; what only they reach, such as slits, is "
        "unknown"
    )
    narrowed_voxels: float = Field(
        0.0, description="by how many voxels the camera is made smaller, as gaps are measured too narrow"
    )
    near_m: float = Field(description="least distance from a camera to what it sees")
    camera_size_m: float = Field(
        description="diameter of the ball that stands for a camera, and is moved without crossing the object"
    )
    camera_height_m: float = Field(description="least height of the camera's centre above the plane")
    stands: bool = Field(description="whether the object stands on a plane that blocks lines and cameras")
    underside: Underside = Field(description="what a person says of the object's underside")
    directions: int = Field(description="number of directions in which lines are tried")
    sheet_voxels: float = Field(
        description="distance from a measured surface at which a line ends, on both sides, voxels"
    )
    blurred_m: float | None = optional(
        "height up to which the sensor may close a gap between floor and object, metres"
    )
    receding_voxels: int | None = optional(
        "how far a side recedes below the object where it may be such a gap, voxels"
    )
    beside_leg_m: float | None = optional(
        "within this of an underside over open space, four level rays are enough, metres"
    )

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
    least_underside_share: float | None = optional("least share of the solid's volume behind an underside")
    least_narrow_share: float | None = optional(
        "the same of a region thinner than a line of sight, if there is no other"
    )
    least_area_m2: float = Field(description="least area of a frontier, square metres")
    least_probability: float = Field(
        description="least probability of being solid, of a voxel that counts as behind a frontier"
    )
    enough: float | None = optional(
        "share of what the best direction shows, from which on a direction is good enough"
    )


class EstimateMethod(StoredPart):
    """The estimate of the IoU to the unknown truth, and the terms of its interval."""

    off_m: float = Field(description="surface error: constant part, metres")
    off_if_thin_m: float = Field(
        description="surface error: part for thin objects, metres; multiplied by the share of the volume "
        "that 1 mm of surface is"
    )
    off_per_sigma: float = Field(
        description="surface error: part for each unit of the surface's standard deviation"
    )
    off_per_pose: float = Field(description="surface error: part for each unit of the median pose error")
    unknown_bias_m: float | None = optional("surface error: part for depth that is not a Kinect v1's, metres")
    most_bias_m: float | None = optional("the same at the interval's lower end, metres")
    fitted_frames: int | None = optional(
        "number of frames in each recording that the estimate was fitted to; with more, the "
        "surface's standard deviation is enlarged to what so many would give"
    )
    missed_more: float = Field(
        description="share of the estimated loss of IoU that is added to it for the interval's lower end"
    )
    missed_less: float = Field(
        description="share of the estimated loss of IoU that is taken from it for the interval's upper end"
    )
    missed_least: float = Field(description="loss of IoU that is added and taken besides, at both ends")
    coin_sigmas: float | None = optional(
        "half width of the interval by unknown regions, each wholly solid or air: in standard deviations"
    )
    decided: float | None = optional(
        "distance of a voxel's probability from 0 or 1 within which the voxel counts as decided"
    )
    edge_share: float | None = optional(
        "share of the known solid that an opening takes from edges; what it takes beyond is thin"
    )
    expected_of_thin: float | None = optional(
        "expected thickness of thin parts, as a share of the measured one"
    )
    max_unresolved_share: float | None = optional(
        "largest share of the known solid in thin parts; beyond it, they are a reason"
    )
    max_volume_share_per_mm: float = Field(
        description="largest share of the volume that 1 mm of surface may be; beyond it, thin parts are a "
        "reason"
    )
    max_shifted_share: float = Field(
        description="largest share of the volume that the median pose error may move; beyond it, poses are a "
        "reason"
    )


class SolidMethod(StoredPart):
    """The constants that made a solid from the frames' votes; older files have further ones."""

    name: str = Field(description="its steps, in words")
    air: AirMethod | None = optional("definition of air")
    least_weight_share: float | None = optional(
        "least weight of an observed voxel, as a share of the surface's median weight"
    )
    min_free_votes: int | None = optional("least number of frames that must see through a voxel to carve it")
    min_free_share: float | None = optional(
        "least share of the frames looking there that must see through it"
    )
    free_by_noise: tuple[float, float] | None = optional(
        "largest share of frames that may see through a surface voxel, and how much it grows for "
        "each voxel nearer to the surface"
    )
    voxels_per_free_share: float | None = optional(
        "shift of the surface inward if all other frames see through, voxels"
    )
    trust_in_votes: tuple[tuple[float, ...], tuple[float, ...]] | None = optional(
        "widths of the frames' rays in voxels, and the share of their votes that counts at each"
    )
    smoothing_voxels: float | None = optional("sigma of the Gaussian that smooths the field, voxels")
    speck_share: float | None = optional(
        "least volume of a piece that is kept, as a share of the largest piece's"
    )
    carried_legs: CarriedLegs | None = optional("rule for legs whose upper end was hidden")
    shell_m: float | None = optional(
        "largest depth behind a measured surface that is part of the object, metres; deeper is unseen"
    )
    shell_voxels: float | None = optional("the same depth in voxels, where that is more")
    measured_voxels: float | None = optional(
        "largest distance from a surface at which a voxel counts as measured, voxels"
    )
    ruled: tuple[float, float] | None = optional(
        "probabilities of voxels that a rule calls solid, and air, against what was measured"
    )
    least_field: tuple[float, float] | None = optional(
        "least absolute values of the field, before and after smoothing, voxels"
    )
    probability_by_signed_voxels: Curve | None = optional(
        "[signed distance in voxels, probability of being solid] of observed voxels"
    )
    probability_roofed: Curve | None = optional(
        "[share of 26 directions that meet the object, probability] of unknown voxels under a roof"
    )
    probability_sky: Curve | None = optional(
        "the same for unknown voxels without a roof: straight up leads out of the object"
    )
    probability_rim: tuple[float, ...] | None = optional(
        "probability of voxels right under the object that only a line's rim touches, by how "
        "many of eight level directions lead out"
    )
    probability_underside: tuple[float, float] | None = optional(
        "[probability of being solid of voxels that can be seen only from below, the same where "
        "a person says that the underside is open]"
    )
    lengths_at_voxel_m: float | None = optional(
        "voxel edge that these lengths are for, metres; where no setting gives the voxels, "
        "smaller ones shorten the lengths in proportion, except those of `air`"
    )
    voxel_size_by_recording: tuple[float, float, int] | None = optional(
        "[least voxel edge, step of the edge, voxels along an object] where no setting gives the "
        "voxels; metres"
    )
    frontiers: FrontierMethod | None = optional(
        "rule for frontiers: openings into unseen space that some camera could see"
    )
    estimate: EstimateMethod | None = optional("constants of the estimated IoU to the unknown truth")
    chosen_on: str | None = optional("data that the constants were chosen on")
