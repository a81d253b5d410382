"""The constants by which a solid is made, as quality.json keeps them."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.solid_method import (
    CarriedLegs,
    Curve,
    EstimateMethod,
    FrontierMethod,
    OpenProbabilities,
    RuleProbabilities,
    SolidMethod,
)
from kinectbench.core.voxels.observation import (
    RAY_WIDTHS_VOXELS,
    TRUST_IN_VOTES,
    USUAL_FREE_SHARE,
    USUAL_FREE_SHARE_PER_VOXEL,
    VOXELS_PER_FREE_SHARE,
)
from kinectbench.stages.segment.enclosure import (
    APRON_BENEATH,
    EMPTY_BESIDE,
    EMPTY_UNDER,
    ENCLOSED,
    FULL_OVERHANG,
    LEAN_REACH_M,
    LEVEL_ENCLOSED,
    MAX_DOUBTFUL_M,
    MAX_HOLLOW_M,
    MAX_LEAN,
    MIN_ENCLOSED_HOLLOW_M,
    MIN_HOLLOW_M,
    OPEN_BENEATH,
    OVERHANG_M,
)
from kinectbench.stages.segment.enclosure import OPEN_BELOW as HOLLOW_OPEN_BELOW
from kinectbench.stages.segment.estimate import (
    DOUBTED_SHARE,
    MAX_SHIFTED_SHARE,
    MAX_VOLUME_SHARE_PER_MM,
    MISSED_LEAST,
    MISSED_LESS,
    MISSED_MORE,
    OFF_M,
    OFF_M_IF_THIN,
    OFF_PER_POSE,
    OFF_PER_SIGMA,
)
from kinectbench.stages.segment.evidence import (
    APRON_M,
    LEAST_WEIGHT_SHARE,
    MIN_FREE_SHARE,
    MIN_FREE_VOTES,
    SHELL_M,
)
from kinectbench.stages.segment.frontiers import (
    ABOVE_FIRST,
    BESIDE_FIRST,
    LEAST_AREA_M2,
    LEAST_PROBABILITY,
    LEAST_SHARE,
    STRAIGHT_SHARE,
)
from kinectbench.stages.segment.morphology import END_LAYERS, MAX_GAP_M, MIN_HEIGHT_M, MIN_SHARE
from kinectbench.stages.segment.openings import (
    HUNG_COLUMNS,
    HUNG_M,
    HUNG_WIDTHS,
    OPENING_M,
    OPENING_RAYS,
    ROOM_AROUND,
    ROOM_DOORWAY,
    ROOM_M,
    ROOM_ROOFS,
    ROOM_SIDES,
    STAND_M,
    WIDE_OPEN_ABOVE,
)
from kinectbench.stages.segment.probability import (
    AMONG_INSIDE_SHARE,
    AMONG_M,
    AMONG_SHARE,
    BELOW_INSIDE_SHARE,
    BESIDE_INSIDE_SHARE,
    CAVITY_INSIDE_SHARE,
    CRACK_INSIDE_SHARE,
    DOUBTFUL_INSIDE_SHARE,
    EMPTY_BESIDE_SHARE,
    EMPTY_UNDER_SHARE,
    ENCLOSING,
    HOLLOW_INSIDE_SHARE,
    HUNG_INSIDE_SHARE,
    INSIDE_SHARE,
    INTERIOR_SHARE,
    OPEN_BELOW,
    RIGHT_BELOW_INSIDE_SHARE,
    RIGHT_BELOW_M,
    RIGHT_BELOW_MAX_RAY_M,
    SIGNED_INSIDE_SHARE,
    SIGNED_VOXELS,
    UNDER_INSIDE_SHARE,
)
from kinectbench.stages.segment.resolution import LEAST_VOXEL_M, STEP_M, USUAL_VOXEL_M, VOXELS_LONG
from kinectbench.stages.segment.solid import SMOOTHING_VOXELS, SPECK_SHARE


def _curve(at: NDArray[np.floating], share: NDArray[np.floating]) -> Curve:
    """Support points and values of an interpolated probability, for the record."""
    return tuple((round(float(x), 4), round(float(y), 4)) for x, y in zip(at, share, strict=True))


def _shares(table: NDArray[np.floating]) -> tuple[float, ...]:
    """A table of probabilities, for the record."""
    return tuple(round(float(share), 4) for share in table)


METHOD = SolidMethod(
    name="carving + openings + hollows behind aprons + 26-direction enclosure + floor contact + smoothing",
    occupied_share=round(float(np.interp(0.5, INSIDE_SHARE, ENCLOSING)), 4),
    hollow_enclosed_share=round(ENCLOSED, 4),
    interior_share=round(INTERIOR_SHARE, 4),
    level_enclosed=LEVEL_ENCLOSED,
    empty_under=EMPTY_UNDER,
    empty_share=round(EMPTY_BESIDE, 4),
    hollow_overhang_m=OVERHANG_M,
    hollow_full_overhang=FULL_OVERHANG,
    hollow_height_m=(MIN_HOLLOW_M, MAX_HOLLOW_M),
    doubtful_height_m=MAX_DOUBTFUL_M,
    hollow_enclosed_height_m=MIN_ENCLOSED_HOLLOW_M,
    hollow_beneath_share=(round(OPEN_BENEATH, 4), round(APRON_BENEATH, 4)),
    hollow_open_below=HOLLOW_OPEN_BELOW,
    hollow_apron_m=APRON_M,
    hollow_lean=(MAX_LEAN, LEAN_REACH_M),
    least_weight_share=LEAST_WEIGHT_SHARE,
    min_free_votes=MIN_FREE_VOTES,
    min_free_share=MIN_FREE_SHARE,
    free_by_noise=(USUAL_FREE_SHARE, USUAL_FREE_SHARE_PER_VOXEL),
    voxels_per_free_share=VOXELS_PER_FREE_SHARE,
    trust_in_votes=(RAY_WIDTHS_VOXELS, TRUST_IN_VOTES),
    smoothing_voxels=SMOOTHING_VOXELS,
    speck_share=SPECK_SHARE,
    carried_legs=CarriedLegs(
        min_height_m=MIN_HEIGHT_M, max_gap_m=MAX_GAP_M, end_layers=END_LAYERS, min_share=MIN_SHARE
    ),
    probability_by_enclosure=_curve(ENCLOSING, INSIDE_SHARE),
    probability_by_signed_voxels=_curve(SIGNED_VOXELS, SIGNED_INSIDE_SHARE),
    shell_m=SHELL_M,
    opening_m=OPENING_M,
    opening_rays=OPENING_RAYS,
    wide_open_above=WIDE_OPEN_ABOVE,
    hung=(HUNG_M, HUNG_WIDTHS, HUNG_COLUMNS),
    room=(ROOM_M, ROOM_SIDES, ROOM_ROOFS, *ROOM_DOORWAY, ROOM_AROUND),
    stand_m=STAND_M,
    probability_open=OpenProbabilities(
        among_m=AMONG_M,
        among=_curve(AMONG_SHARE, AMONG_INSIDE_SHARE),
        crack=_shares(CRACK_INSIDE_SHARE),
        beside=_shares(BESIDE_INSIDE_SHARE),
        below=_shares(BELOW_INSIDE_SHARE),
        open_below=OPEN_BELOW,
        cavity=_shares(CAVITY_INSIDE_SHARE),
        hung=round(float(HUNG_INSIDE_SHARE), 4),
        right_below_m=RIGHT_BELOW_M,
        right_below_max_ray_m=RIGHT_BELOW_MAX_RAY_M,
        right_below=_shares(RIGHT_BELOW_INSIDE_SHARE),
    ),
    probability_by_rule=RuleProbabilities(
        hollow=round(float(HOLLOW_INSIDE_SHARE), 4),
        doubtful=round(float(DOUBTFUL_INSIDE_SHARE), 4),
        under=round(float(UNDER_INSIDE_SHARE), 4),
        under_empty=round(float(EMPTY_UNDER_SHARE), 4),
        beside_empty=round(float(EMPTY_BESIDE_SHARE), 4),
    ),
    lengths_at_voxel_m=USUAL_VOXEL_M,
    voxel_size_by_recording=(LEAST_VOXEL_M, STEP_M, VOXELS_LONG),
    frontiers=FrontierMethod(
        least_share=LEAST_SHARE,
        least_area_m2=LEAST_AREA_M2,
        least_probability=LEAST_PROBABILITY,
        first=(ABOVE_FIRST, BESIDE_FIRST),
        around_corner_share=STRAIGHT_SHARE,
    ),
    estimate=EstimateMethod(
        off_m=OFF_M,
        off_if_thin_m=OFF_M_IF_THIN,
        off_per_sigma=OFF_PER_SIGMA,
        off_per_pose=OFF_PER_POSE,
        missed_more=MISSED_MORE,
        missed_less=MISSED_LESS,
        missed_least=MISSED_LEAST,
        doubted_share=DOUBTED_SHARE,
        max_volume_share_per_mm=MAX_VOLUME_SHARE_PER_MM,
        max_shifted_share=MAX_SHIFTED_SHARE,
    ),
    chosen_on="simulated objects: furniture of 4 families, seeds 1 to 42; openings on the families looked at",
)
