"""What the recording itself says about how good its ground truth is."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from kinectbench.fusion.reconstruction import Observation
from kinectbench.geometry import OrientedBox, TriangleMesh, transform_points
from kinectbench.segmentation.segment import Segmentation
from kinectbench.segmentation.select import fit_box
from kinectbench.shape.labels import Label
from kinectbench.shape.solid import METHOD, SolidShape
from kinectbench.shape.witness import Witness

GOOD_REPEATABILITY = 0.90
MAX_UNKNOWN_SHARE = 0.15
MAX_DOUBTFUL_SHARE = 0.1
# What is missing from an IoU of 1 to the truth, fitted on simulated objects of 4 families (seeds 18 to 27):
# of what the probabilities expect to be missing, of what halves disagree by, and of what changes if the
# surface is off by as much as a usual pose.
MISSING_PER_EXPECTED, MISSING_PER_DISAGREEMENT, MISSING_PER_SHIFT = 0.22, 0.92, 2.3
GOOD_ESTIMATED_IOU = 0.82
# A surface that is off by 1 mm changes so much of the volume of parts that are 20 mm thick.
MAX_VOLUME_SHARE_PER_MM = 0.1
# A solid that begins higher above the floor hangs in the air; a piece with this share of it is a large one.
MAX_GAP_M, LARGE_PIECE_SHARE = 0.05, 0.1
# So that a handle or a speck that one half of the frames shows does not move a side of the box.
BOX_LEFT_OUT = 0.005


@dataclass(frozen=True)
class Quality:
    """The object's box and the figures of quality.json."""

    box: OrientedBox
    figures: dict[str, Any]


def surface_sigma_m(odd: Observation, even: Observation) -> float:
    """Standard deviation of the surface fused from all frames, metres.

    The two halves' signed distances differ by twice the deviation of their mean, if their errors are
    independent: robust deviation of the difference near the surface, halved. One voxel where the
    halves have no surface in common.
    """
    near = (odd.weight > 0) & (even.weight > 0)
    near &= np.abs(odd.tsdf + even.tsdf) < 2 * odd.grid.voxel_size_m
    if not near.any():
        return odd.grid.voxel_size_m
    return float(1.4826 * np.median(np.abs(odd.tsdf[near] - even.tsdf[near])) / 2)


def volume_share_per_mm(mesh: TriangleMesh) -> float:
    """What share of the volume of a closed mesh (metres) changes if its surface moves by 1 mm."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    area_m2 = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
    return 0.001 * area_m2 / max(mesh.volume_m3, 1e-9)


def expected_iou(shape: SolidShape) -> float:
    """The IoU to the truth that the probabilities of the voxels expect: expected intersection over union."""
    solid, probability = shape.solid, shape.probability
    inside = float(probability[solid].sum(dtype=np.float64))
    return inside / (int(solid.sum()) + float(probability[~solid].sum(dtype=np.float64)))


def estimated_iou(expected: float, repeatability: float, shifted_share: float) -> float:
    """An estimate of the IoU to the unknown truth, in [0, 1].

    What is missing from 1 is a sum of what the voxels' probabilities expect to be missing, of what odd and
    even frames disagree by, and of what the poses' errors cost, which both share (own rule, fitted on
    simulated objects; docs/ground-truth.md has its errors).

    Args:
        expected: `expected_iou` of the solid.
        repeatability: IoU of the solids from odd and from even frames.
        shifted_share: of the volume, what changes if the surface moves by what a usual pose may be off.
    """
    missing = (
        MISSING_PER_EXPECTED * (1 - expected)
        + MISSING_PER_DISAGREEMENT * (1 - repeatability)
        + MISSING_PER_SHIFT * shifted_share
    )
    return float(np.clip(1 - missing, 0, 1))


def measure_quality(
    chosen: Segmentation,
    shapes: tuple[SolidShape, SolidShape, SolidShape],
    sigma_m: float,
    seen: Witness,
    pose_sigma_m: float,
) -> Quality:
    """Repeatability (IoU of the solids from odd and from even frames), estimated IoU, boxes, warnings.

    Args:
        chosen: floor and object.
        shapes: the solid from all, from the odd and from the even frames.
        sigma_m: standard deviation of the surface, metres.
        seen: what the recording could see of it; its warnings come first.
        pose_sigma_m: by how much a usual pose may be off, metres; 0 if the poses are taken at their word.
    """
    together, odd, even = shapes
    union = int((odd.solid | even.solid).sum())
    repeatability = int((odd.solid & even.solid).sum()) / union
    unknown = int((together.solid & (together.labels == Label.UNKNOWN)).sum()) / int(together.solid.sum())
    box = _box(together.mesh, chosen)
    warnings = list(seen.warnings)
    if repeatability < GOOD_REPEATABILITY:
        warnings.append(
            f"odd and even frames agree to IoU {repeatability:.3f} only: look at the trajectory and the mesh"
        )
    share_per_mm = volume_share_per_mm(together.mesh)
    estimated = estimated_iou(expected_iou(together), repeatability, 1000 * pose_sigma_m * share_per_mm)
    if estimated < GOOD_ESTIMATED_IOU:
        warnings.append(
            f"estimated IoU of the solid to the truth: {estimated:.2f} only; its parts are thin, hidden, "
            "without depth or cut off: record from closer, and from low down, too"
        )
    if share_per_mm > MAX_VOLUME_SHARE_PER_MM:
        warnings.append(
            f"the object's parts are thin: a surface that is off by 1 mm changes {share_per_mm:.0%} of the "
            "volume, and any IoU by as much"
        )
    warnings += _unsupported(chosen, together)
    never_seen = unknown - together.doubtful_share
    if never_seen > MAX_UNKNOWN_SHARE:
        warnings.append(
            f"{never_seen:.0%} of the solid was never measured nor enclosed: walk around the object"
        )
    if together.doubtful_share > MAX_DOUBTFUL_SHARE:
        warnings.append(
            f"{together.doubtful_share:.0%} of the solid is a thick slab, or a hollow that no frame looked "
            "into: it lies under a top, behind flush sides, and open below; record from low down, too"
        )
    figures = {
        "format_version": 1,
        "verdict": "good" if not warnings else "look at the warnings",
        "warnings": warnings,
        "repeatability_iou": round(repeatability, 4),
        "estimated_iou": round(estimated, 4),
        "surface_sigma_m": sigma_m,
        "unknown_share": round(unknown, 4),
        "doubtful_share": round(together.doubtful_share, 4),
        "volume_m3": round(int(together.solid.sum()) * together.grid.voxel_size_m**3, 6),
        "labels": {label.name.lower(): int((together.labels == label).sum()) for label in Label},
        "box": box_json(box),
        "box_odd": box_json(_box(odd.mesh, chosen, box.yaw_rad)),
        "box_even": box_json(_box(even.mesh, chosen, box.yaw_rad)),
        "selection": chosen.how,
        **seen.figures,
        "method": METHOD,
    }
    return Quality(box, figures)


def _unsupported(chosen: Segmentation, shape: SolidShape) -> list[str]:
    """Warnings of a solid that hangs in the air, or whose large pieces do: something of it is missing."""
    from scipy import ndimage

    warnings = []
    gap_m = float(transform_points(chosen.floor.T_floor_world, shape.mesh.vertices)[:, 2].min())
    if chosen.floor.found and gap_m > MAX_GAP_M:
        warnings.append(
            f"the solid begins {gap_m:.2f} m above the floor: what carries it gave no depth (black, glass or "
            "mirror-like), or the box cuts it off; all is well if it stands on something else"
        )
    sizes = np.bincount(ndimage.label(shape.solid, np.ones((3, 3, 3)))[0].reshape(-1))[1:]
    pieces = int((sizes >= LARGE_PIECE_SHARE * sizes.sum()).sum())
    if pieces > 1:
        warnings.append(
            f"the solid is in {pieces} large pieces that do not touch: what joins them gave no depth, or "
            "they are several things: look at object/mesh.ply"
        )
    return warnings


def box_json(box: OrientedBox) -> dict[str, Any]:
    """A box as benchmark.yaml writes it: floor frame, metres, radians."""
    return {
        "center_m": [round(value, 4) for value in box.center_m],
        "size_m": [round(value, 4) for value in box.size_m],
        "yaw_rad": round(box.yaw_rad, 5),
    }


def _box(mesh: TriangleMesh, chosen: Segmentation, yaw_rad: float | None = None) -> OrientedBox:
    return fit_box(transform_points(chosen.floor.T_floor_world, mesh.vertices), yaw_rad, BOX_LEFT_OUT)
