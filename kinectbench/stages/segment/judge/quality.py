"""Judge the solid by the recording itself: repeatability, estimated IoU, boxes and warnings."""

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from kinectbench.core.artefacts.object import (
    LEAST_UNDERSIDE_SHARE,
    BoxPart,
    FrontierPart,
    LabelCounts,
    QualityFile,
)
from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import OrientedBox, transform_points
from kinectbench.core.types import CLOSED_MEANS, OPEN_MEANS, Int32, Int64, Underside
from kinectbench.core.voxels.observation import Observation
from kinectbench.stages.segment.find.floor import Floor
from kinectbench.stages.segment.find.object import Segmentation
from kinectbench.stages.segment.find.pieces import LOOK, fit_box, nearest_within
from kinectbench.stages.segment.judge.coverage_report import CoverageReport
from kinectbench.stages.segment.judge.estimate import (
    MAX_VOLUME_SHARE_PER_MM,
    FloorCut,
    IouEstimate,
    PoseError,
    estimate_iou,
    unresolved_share,
    volume_share_per_mm,
)
from kinectbench.stages.segment.judge.frontiers import Frontier
from kinectbench.stages.segment.judge.method import method
from kinectbench.stages.segment.solid.evidence import Rules
from kinectbench.stages.segment.solid.solid import SolidBody, Solids, SolidShape

# Limits of a verdict without warnings.
GOOD_REPEATABILITY, MAX_UNKNOWN_SHARE, GOOD_ESTIMATED_IOU = 0.90, 0.15, 0.82
# A solid that begins higher above the floor hangs in the air; a piece with this share of it is a large one.
MAX_GAP_M, LARGE_PIECE_SHARE = 0.05, 0.1
# A smaller piece is detached if this many voxels lie between it and the rest: a smaller gap may be a joint
# too thin to be measured. Gaps are measured up to this distance (chosen by hand).
DETACHED_VOXELS, FARTHEST_DETACHED_M = 3, 0.5
# A handle or a speck that one half of the frames shows does not move a side of the box.
BOX_LEFT_OUT = 0.005
# A solid stands on the floor where it reaches one of this many layers of voxels above it, and as a whole if
# this share of its outline does. Measured on ten built objects: 0.01 to 0.32 on legs, wheels or a foot,
# 0.92 to 1 on a rim or a flat base.
RIM_LAYERS, STANDING_SHARE = 2, 0.5
# Values of the coverage report that quality.json has by the same names.
OF_REPORT = (
    "good_frames",
    "unseen_side",
    "moving",
    "max_depth_m",
    "beyond_share",
    "off_share",
    "inverse_depth_steps",
)
# Tenths of a millimetre, and less than that at a metre.
BOX_DECIMALS_M, BOX_DECIMALS_RAD = 4, 5


def surface_sigma_m(odd: Observation, even: Observation) -> float:
    """Return the standard deviation of the surface fused from all frames, metres.

    If the errors of the odd and the even half are independent, the difference of their signed distances
    deviates twice as much as their mean. The result is therefore half the robust deviation of the difference
    near the surface, or one voxel if the halves share no surface.
    """
    near = (odd.weight > 0) & (even.weight > 0)
    near &= np.abs(odd.tsdf + even.tsdf) < 2 * odd.grid.voxel_size_m
    if not near.any():
        return odd.grid.voxel_size_m
    return float(1.4826 * np.median(np.abs(odd.tsdf[near] - even.tsdf[near])) / 2)


def measure_quality(
    chosen: Segmentation,
    box: OrientedBox,
    solids: Solids,
    report: CoverageReport,
    pose_error: PoseError,
    frontiers: tuple[Frontier, ...],
    rules: Rules,
    floor_cut: FloorCut,
) -> QualityFile:
    """Measure repeatability (the IoU of the two halves' solids) and the estimated IoU; gather the warnings.

    `box` is the `solid_box` of the solid from all frames, and `rules` are those by which the solids were
    made.
    """
    together, odd, even, sigma_m = solids.whole, solids.odd, solids.even, solids.surface_sigma_m
    repeatability = int((odd.solid & even.solid).sum()) / int((odd.solid | even.solid).sum())
    unknown, unknown_air = _unknown_shares(together)
    unresolved = unresolved_share(together)
    counted = solids.frames, unresolved
    known = report.of_kinect
    estimate = estimate_iou(together, sigma_m, pose_error, frontiers, *counted, bias_known=known)
    estimate = floor_cut.applied(estimate)
    unsupported = _unsupported(chosen, together, rules)
    advice = tuple(f.advice(report.first_rad, rules.underside) for f in frontiers)
    fused = _warnings(unsupported, together, repeatability, estimate, advice, unknown)
    cut = floor_cut.warnings()
    warnings = (*cut, *report.warnings, *advice, *_underside_question(together, rules.underside), *fused)
    return QualityFile(
        format_version=1,
        verdict="look at the warnings" if warnings else "good",
        warnings=warnings,
        doubts=(*report.choice_warnings, *unsupported),
        repeatability_iou=round(repeatability, 4),
        estimated_iou=round(estimate.value, 4),
        estimated_iou_low=round(estimate.low, 4),
        estimated_iou_high=round(estimate.high, 4),
        estimated_iou_reasons=estimate.reasons,
        estimated_known_iou=round(estimate.known, 4),
        estimated_known_iou_low=round(estimate.known_low, 4),
        estimated_known_iou_high=round(estimate.known_high, 4),
        frontiers=tuple(_frontier_part(each, line) for each, line in zip(frontiers, advice, strict=True)),
        surface_sigma_m=sigma_m,
        unknown_share=round(unknown, 4),
        unknown_air_share=round(unknown_air, 4),
        underside=rules.underside,
        underside_share=round(together.underside_share, 4),
        volume_m3=round(int(together.solid.sum()) * together.grid.voxel_size_m**3, 6),
        labels=LabelCounts(**{each.name.lower(): int((together.labels == each).sum()) for each in Label}),
        box=_box_part(box),
        box_odd=_box_part(solid_box(odd, chosen.floor, box.yaw_rad)),
        box_even=_box_part(solid_box(even, chosen.floor, box.yaw_rad)),
        selection=chosen.how,
        **{key: getattr(report, key) for key in OF_REPORT},
        method=method(rules),
    )


def _box_part(box: OrientedBox) -> BoxPart:
    return BoxPart.of(box, BOX_DECIMALS_M, BOX_DECIMALS_RAD)


def _unknown_shares(shape: SolidShape) -> tuple[float, float]:
    """Return the unknown volume assumed inside, and that assumed air, as shares of the solid's volume."""
    unknown, volume = shape.labels == Label.UNKNOWN, int(shape.solid.sum())
    return int((shape.solid & unknown).sum()) / volume, int((~shape.solid & unknown).sum()) / volume


def _frontier_part(frontier: Frontier, advice: str) -> FrontierPart:
    """Return a frontier as quality.json writes it: rounded, and with advice where to stand."""
    (length, width), (x, y, z), (u, v, w) = (
        (round(value, 4) for value in vector)
        for vector in (frontier.size_m, frontier.center_m, frontier.look_from)
    )
    return FrontierPart(
        direction=frontier.direction,
        area_m2=round(frontier.area_m2, 5),
        size_m=(length, width),
        center_m=(x, y, z),
        look_from=(u, v, w),
        advice=advice,
        volume_m3=round(frontier.volume_m3, 6),
        inside_share=round(frontier.inside_share, 4),
        solid_share=round(frontier.solid_share, 4),
        underside=frontier.underside,
    )


def solid_box(shape: SolidBody, floor: Floor, yaw_rad: float | None = None) -> OrientedBox:
    """Return the upright box around a solid, floor frame, with 0.5 % of its vertices outside on each side.

    Without a yaw, it is the box of smallest ground area.
    """
    points_floor = transform_points(floor.T_floor_world, shape.mesh.vertices)
    return fit_box(points_floor, yaw_rad, BOX_LEFT_OUT)


def _underside_question(shape: SolidShape, underside: Underside) -> tuple[str, ...]:
    """Return a question about the underside if the user did not state it and much depends on it."""
    share = shape.underside_share
    if underside != "unseen" or share <= LEAST_UNDERSIDE_SHARE:
        return ()
    return (
        f"{share:.0%} of the solid is a guess that one word decides: say in benchmark.yaml "
        f"`underside: closed` if {CLOSED_MEANS}, and it is known; or `underside: open` if {OPEN_MEANS}",
    )


def _stands_on_its_rim(shape: SolidShape, rules: Rules) -> tuple[str, ...]:
    """Return a warning if `underside: open` has no effect, as the object stands on its rim on the floor."""
    lowest = shape.solid[..., : rules.layers.below + RIM_LAYERS].any(axis=2)
    standing = int(lowest.sum()) / max(1, int(shape.solid.any(axis=2).sum()))
    from_below = int(shape.underside.sum()) / max(1, int(shape.solid.sum()))
    is_said = rules.underside == "open" and rules.stands
    if not is_said or standing < STANDING_SHARE or from_below > LEAST_UNDERSIDE_SHARE:
        return ()
    return (
        f"`underside: open` has no effect: {standing:.0%} of the solid's outline stands on the floor, where "
        "no camera can look under it, so a space inside counts as solid; turn the object over to record its "
        "inside, or leave the word out",
    )


def _warnings(
    unsupported: list[str],
    shape: SolidShape,
    repeatability: float,
    estimate: IouEstimate,
    advice: tuple[str, ...],
    unknown: float,
) -> list[str]:
    """Return a line for each fault of a solid; `unsupported` lines among them.

    `advice` are lines on what to record again, which the result does not repeat or contradict.
    `repeatability` is the IoU of the solids from the odd and the even frames, `unknown` the unknown volume
    assumed inside, as a share of the solid's.
    """
    share_per_mm = volume_share_per_mm(shape.mesh)
    why = "; ".join(estimate.reasons) or "parts that are thin, hidden, without depth or cut off"
    closer = "" if advice else "; record from closer, and what was hidden from where it is seen"
    around = ", as said above" if advice else ": show the camera all sides of the object"
    lines = (
        (
            repeatability < GOOD_REPEATABILITY,
            f"odd and even frames agree to IoU {repeatability:.3f} only: look at the trajectory and the mesh",
        ),
        (
            estimate.value < GOOD_ESTIMATED_IOU,
            f"the estimated IoU of the solid to the truth is {estimate.value:.2f}, lowered by: {why}{closer}",
        ),
        (
            estimate.value >= GOOD_ESTIMATED_IOU > estimate.measured_low,
            f"the surface may be off by so much that the IoU of the solid to the truth is "
            f"{estimate.measured_low:.2f}, by: {why}{closer}",
        ),
        (
            share_per_mm > MAX_VOLUME_SHARE_PER_MM,
            f"the object's parts are thin: a surface that is off by 1 mm changes {share_per_mm:.0%} of the "
            "volume, and any IoU by as much",
        ),
        *((True, line) for line in unsupported),
        (
            unknown > MAX_UNKNOWN_SHARE,
            f"{unknown:.0%} of the solid was never measured, and some camera could see it{around}",
        ),
    )
    return [line for wrong, line in lines if wrong]


def _unsupported(chosen: Segmentation, shape: SolidShape, rules: Rules) -> list[str]:
    """Warnings if the solid or pieces of it are in the air, or if `underside: open` has no effect."""
    warnings = [*_stands_on_its_rim(shape, rules)]
    gap_m = float(transform_points(chosen.floor.T_floor_world, shape.mesh.vertices)[:, 2].min())
    if chosen.floor.found and gap_m > MAX_GAP_M:
        warnings.append(
            f"the solid begins {gap_m:.2f} m above the floor: what carries it gave no depth (black, glass or "
            "mirror-like), or the box or the `floor` in benchmark.yaml is wrong; all is well if it stands on "
            "something else"
        )
    labels, _ = ndimage.label(shape.solid, np.ones((3, 3, 3)))
    sizes = np.bincount(labels.reshape(-1))[1:]
    pieces = int((sizes >= LARGE_PIECE_SHARE * sizes.sum()).sum())
    if pieces > 1:
        warnings.append(
            f"the solid is in {pieces} large pieces that do not touch: what joins them gave no depth, or "
            "they are several things: look at object/mesh.ply"
        )
    small = np.flatnonzero(sizes < LARGE_PIECE_SHARE * sizes.sum()) + 1
    return warnings + detached_pieces(labels, small, sizes, shape.grid.voxel_size_m)


def detached_pieces(labels: Int32, small: Int64, sizes: Int64, voxel_size_m: float) -> list[str]:
    """Return a warning about the largest small piece that lies away from all large pieces; [] if none does.

    Args:
        labels: piece of each voxel, 0: none.
        small: (k,) labels of the small pieces.
        sizes: voxels of each piece, from label 1 on.
        voxel_size_m: edge of a voxel, metres.
    """
    large = (labels > 0) & ~np.isin(labels, small)
    if not len(small) or not large.any():
        return []
    outside = np.argwhere(large & ~ndimage.binary_erosion(large)) * voxel_size_m
    tree = cKDTree(outside)
    windows = ndimage.find_objects(labels)
    apart: list[tuple[int, float]] = []
    for piece in small.tolist():
        window = windows[piece - 1]
        first = np.array([part.start for part in window])
        points = (np.argwhere(labels[window] == piece) + first) * voxel_size_m
        gap_m, _ = nearest_within(tree, points, FARTHEST_DETACHED_M)
        if gap_m > (DETACHED_VOXELS + 0.5) * voxel_size_m:
            apart.append((int(sizes[piece - 1]), gap_m))
    if not apart:
        return []
    size, gap_m = max(apart)
    far = f"{1000 * gap_m:.0f} mm" if np.isfinite(gap_m) else f"more than {FARTHEST_DETACHED_M:g} m"
    what = f"a loose piece of {1e6 * size * voxel_size_m**3:.0f} cm³ lies {far} from the rest of the object"
    others = f", one of {len(apart)}" if len(apart) > 1 else ""
    return [
        f"{what}{others}: perhaps a scrap of a neighbour; look at object/mesh.ply, or give a box without it; "
        f"{LOOK}"
    ]
