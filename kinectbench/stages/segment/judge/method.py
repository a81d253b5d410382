"""The constants of a solid, as quality.json records them."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.object import LEAST_UNDERSIDE_SHARE
from kinectbench.core.artefacts.solid_method import (
    AirMethod,
    CarriedLegs,
    Curve,
    EstimateMethod,
    FrontierMethod,
    SolidMethod,
)
from kinectbench.core.voxels.observation import (
    RAY_WIDTHS_VOXELS,
    TRUST_IN_VOTES,
    USUAL_FREE_SHARE,
    USUAL_FREE_SHARE_PER_VOXEL,
    VOXELS_PER_FREE_SHARE,
)
from kinectbench.stages.segment.judge import estimate, frontiers
from kinectbench.stages.segment.solid import evidence, grids, guess, solid
from kinectbench.stages.segment.solid.evidence import Rules


def _curve(at: NDArray[np.floating], share: NDArray[np.floating]) -> Curve:
    """Return an interpolated probability as pairs (x, probability), rounded for quality.json."""
    return tuple((round(float(x), 4), round(float(y), 4)) for x, y in zip(at, share, strict=True))


def _air(rules: Rules) -> AirMethod:
    limits = rules.limits
    return AirMethod(
        line_width_m=limits.line_width_m,
        near_m=limits.near_m,
        camera_size_m=limits.camera_size_m,
        camera_height_m=limits.camera_height_m,
        stands=rules.stands,
        underside=rules.underside,
        directions=evidence.FINE,
        narrower=evidence.NARROWER,
        narrowed_voxels=evidence.NARROWED_VOXELS,
        sheet_voxels=evidence.SHEET_VOXELS,
        blurred_m=round(rules.blurred_m, 4),
        receding_voxels=evidence.RECEDING_VOXELS,
        beside_leg_m=evidence.BESIDE_LEG_M,
    )


def _estimate() -> EstimateMethod:
    return EstimateMethod(
        off_m=estimate.OFF_M,
        off_if_thin_m=estimate.OFF_M_IF_THIN,
        off_per_sigma=estimate.OFF_PER_SIGMA,
        off_per_pose=estimate.OFF_PER_POSE,
        unknown_bias_m=estimate.UNKNOWN_BIAS_M,
        most_bias_m=estimate.MOST_BIAS_M,
        fitted_frames=estimate.FITTED_FRAMES,
        missed_more=estimate.MISSED_MORE,
        missed_less=estimate.MISSED_LESS,
        missed_least=estimate.MISSED_LEAST,
        coin_sigmas=estimate.COIN_SIGMAS,
        decided=estimate.DECIDED,
        edge_share=estimate.EDGE_SHARE,
        expected_of_thin=estimate.EXPECTED_OF_THIN,
        max_unresolved_share=estimate.MAX_UNRESOLVED_SHARE,
        max_volume_share_per_mm=estimate.MAX_VOLUME_SHARE_PER_MM,
        max_shifted_share=estimate.MAX_SHIFTED_SHARE,
    )


def method(rules: Rules) -> SolidMethod:
    """Return the constants by which a solid is made.

    Args:
        rules: the object's rules, not enlarged.
    """
    return SolidMethod(
        name="carving + air is what some camera could see + floor contact + smoothing",
        air=_air(rules),
        least_weight_share=evidence.LEAST_WEIGHT_SHARE,
        min_free_votes=evidence.MIN_FREE_VOTES,
        min_free_share=evidence.MIN_FREE_SHARE,
        free_by_noise=(USUAL_FREE_SHARE, USUAL_FREE_SHARE_PER_VOXEL),
        voxels_per_free_share=VOXELS_PER_FREE_SHARE,
        trust_in_votes=(RAY_WIDTHS_VOXELS, TRUST_IN_VOTES),
        smoothing_voxels=solid.SMOOTHING_VOXELS,
        speck_share=solid.SPECK_SHARE,
        carried_legs=CarriedLegs(
            min_height_m=solid.LEG_HEIGHT_M,
            max_gap_m=solid.LEG_GAP_M,
            end_layers=solid.LEG_END_LAYERS,
            min_share=solid.LEG_SHARE,
        ),
        shell_m=evidence.SHELL_M,
        shell_voxels=evidence.SHELL_VOXELS,
        measured_voxels=solid.MEASURED_VOXELS,
        ruled=(solid.RULED_SOLID, solid.RULED_AIR),
        least_field=(solid.LEAST_FIELD, solid.LEAST_SMOOTHED),
        probability_by_signed_voxels=_curve(guess.SIGNED_VOXELS, guess.SIGNED_INSIDE_SHARE),
        probability_roofed=_curve(guess.ENCLOSED, guess.ROOFED_SHARE),
        probability_sky=_curve(guess.ENCLOSED, guess.SKY_SHARE),
        probability_rim=tuple(round(float(share), 4) for share in guess.RIM_SHARE),
        probability_underside=(round(float(guess.UNDERSIDE_SHARE), 4), round(float(guess.OPEN_SHARE), 4)),
        lengths_at_voxel_m=grids.REFERENCE_VOXEL_M,
        voxel_size_by_recording=(grids.LEAST_VOXEL_M, grids.STEP_M, grids.VOXELS_LONG),
        frontiers=FrontierMethod(
            least_share=frontiers.LEAST_SHARE,
            least_underside_share=LEAST_UNDERSIDE_SHARE,
            least_narrow_share=frontiers.LEAST_NARROW_SHARE,
            least_area_m2=frontiers.LEAST_AREA_M2,
            least_probability=frontiers.LEAST_PROBABILITY,
            enough=frontiers.ENOUGH,
        ),
        estimate=_estimate(),
        chosen_on="simulated objects of the families looked at, seeds 31, 32 and 41",
    )
