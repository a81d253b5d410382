"""Metrics under the protocols camera and aligned: surface distances, and voxel metrics (IoU) of solids."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kinectbench.core.artefacts.score_figures import (
    AsPapers,
    Ceiling,
    ShapePart,
    SurfaceMetrics,
    VoxelMetrics,
)
from kinectbench.core.types import MM_PER_M, Bools, Float64, Int64
from kinectbench.core.voxels.pair_file import FULL_CELLS, Packed, packed_count
from kinectbench.scoring.camera import bounds
from kinectbench.scoring.camera.solid import Solid
from kinectbench.scoring.camera.surface import Surface, point_surface
from kinectbench.scoring.camera.truth import PARTS, SpaceTruth
from kinectbench.scoring.prediction_file import blake3_of

# Number of samples of each surface whose distance is measured, without and with registration. If distances
# have a spread of 10 mm, their mean over the first number is accurate to 0.07 mm; the search takes 0.06 s in
# each direction (measured). A view has three registrations, which take three times as long; with the second
# number their means are accurate to 0.1 mm.
QUERIES, QUERIES_ALIGNED = 20_000, 10_000
# OctMAE reports 5, 10 and 20 mm; Tatarchenko et al. ("What do single-view 3D reconstruction networks
# learn?", 2019) 1 % of the size; coarser shares are for methods of low resolution.
F_SCORE_M = {"f_score_5mm": 0.005, "f_score_10mm": 0.01, "f_score_20mm": 0.02}
F_SCORE_SHARES = {"f_score_1pct": 0.01, "f_score_2pct": 0.02, "f_score_5pct": 0.05}


@dataclass(frozen=True)
class PartFigures:
    """The metrics of one part (whole, visible or occluded) of a view's shape.

    Attributes:
        surface: surface metrics; all None if the part has no known true surface.
        voxels: voxel metrics; all None if the part has no known true surface, or if there is no predicted
            solid.
        coverage_voxels: share of the grid's cells that are counted, that is, known and in the part.
        coverage_shape: share of the true shape's cells that are counted; 1 if the shape is empty.
        surface_unknown_share: share of the part's true surface area that is unknown and therefore left out;
            None if the part has no true surface.
        ceiling: the best scores that the truth's uncertainty allows; None if the truth states no uncertainty,
            or no true surface of the part is known.
        as_papers: metrics as other papers compute them, for the part "whole" under `camera`; None for other
            parts and protocols, and if no true or no predicted surface is in known space.
    """

    surface: SurfaceMetrics
    voxels: VoxelMetrics
    coverage_voxels: float
    coverage_shape: float
    surface_unknown_share: float | None
    ceiling: Ceiling | None = None
    as_papers: AsPapers | None = None


@dataclass(frozen=True)
class Way:
    """One direction of a comparison: the distances from one surface's samples to the other surface.

    Attributes:
        distances_m: (n,) distance of each sample to the other surface.
        cosines: (n,) |n . n'| of the sample's normal and the nearest sample's; None if one surface has no
            normals.
        areas: (n,) area that each sample represents.
        seen: (n,) whether the sample lies in space that the view saw.
        is_mesh: whether the samples are on a mesh's triangles, whose `areas` may be close to 0.
    """

    distances_m: Float64
    cosines: Float64 | None
    areas: Float64
    seen: Bools
    is_mesh: bool = False

    def of(self, part: str) -> "Way":
        """Return the comparison restricted to the samples of one part.

        Args:
            part: "whole", "visible" (samples that are `seen`) or "occluded" (the others).
        """
        if part == "whole":
            return self
        which = self.seen if part == "visible" else ~self.seen
        cosines = None if self.cosines is None else self.cosines[which]
        return Way(self.distances_m[which], cosines, self.areas[which], self.seen[which], self.is_mesh)

    def mean(self, values: Float64, worse: Callable[[float, float], float] = min) -> float:
        """Return the area-weighted mean of values (n,).

        For a mesh, return the worse of this mean and the unweighted mean. `worse` is min, or max if the
        values are distances. Otherwise a mesh could gain by scattering tiny triangles: each has a sample that
        may be near the truth, but almost no area that counts as wrong if it is not.
        """
        by_sample, area = float(values.mean()), float(self.areas.sum())
        if not area > 0:
            return by_sample
        # No dot product: its sum depends on the number of cores.
        by_area = float((self.areas * values).sum() / area)
        return worse(by_area, by_sample) if self.is_mesh else by_area

    def near(self, tolerance_m: float) -> float:
        """Return the share of the area within a tolerance of the other surface, averaged as in `mean`."""
        return self.mean((self.distances_m <= tolerance_m).astype(np.float64))


def figures_by_part(
    truth: SpaceTruth, surface: Surface | None, solid: Solid | None, in_camera: bool = True
) -> tuple[dict[ShapePart, PartFigures], float]:
    """Return {part: its metrics}, and the share of the predicted surface's area that lies in unknown space.

    Args:
        truth: the truth of the view.
        surface: the predicted surface in the truth's grid frame; None for an empty prediction.
        solid: the predicted solid in the cells of the truth's grid; None if the prediction has no inside.
        in_camera: whether the protocol is `camera`, without registration. Then more samples are measured, and
            metrics are also computed as in other papers.
    """
    if surface is None:
        surface = point_surface(np.zeros((0, 3)), None)
    is_known, seen = truth.at(surface.points_m)
    area = float(surface.areas.sum())
    left_out = float(surface.areas[~is_known].sum()) / area if area else 0.0
    true_known = truth.known_surface
    ours = surface if is_known.all() else surface.chosen(is_known)
    true_seen = truth.is_seen[truth.is_known]
    most = QUERIES if in_camera else QUERIES_ALIGNED
    there = _way(ours, seen[is_known], true_known, most)
    back = _way(true_known, true_seen, ours, most)
    found: dict[ShapePart, PartFigures] = {}
    for part in PARTS:
        true_area, of_known = truth.areas_m2[part]
        metrics = _metrics(truth, there.of(part), back.of(part))
        voxels, coverage_voxels, coverage_shape = _voxels(truth, solid, part)
        volume_m3 = coverage_shape * truth.solid_cells * truth.voxel_size_m**3
        papers = None
        if in_camera and part == "whole" and len(ours) and len(true_known):
            papers = bounds.as_papers(_as_octmae(there, back), ours, true_known, truth.size_m, truth.is_open)
        found[part] = PartFigures(
            metrics,
            VoxelMetrics() if metrics.chamfer_l1_m is None else voxels,
            coverage_voxels,
            coverage_shape,
            1 - of_known / true_area if true_area else None,
            bounds.ceiling(truth.sigma_m, _tolerances_m(truth), of_known, volume_m3) if of_known else None,
            papers,
        )
    return found, left_out


def _way(one: Surface, seen: Bools, other: Surface, most: int) -> Way:
    """Measure distances from up to `most` samples of `one` to `other`; infinite if either is empty.

    `seen` (n,) marks the samples of `one` that lie in space that the view saw.
    """
    which = _drawn(one, most)
    queries, is_mesh = one.chosen(which), one.is_triangle
    if not len(other) or not len(one):
        return Way(np.full(len(which), np.inf), None, queries.areas, seen[which], is_mesh)
    distances, found = other.nearest(queries.points_m)
    cosines = None
    if queries.normals is not None and other.normals is not None:
        first, second = queries.normals, other.normals[found]
        cosines = np.abs(np.einsum("ij,ij->i", first, second))
        # As in the grid protocols: two undefined normals agree.
        cosines[~first.any(axis=1) & ~second.any(axis=1)] = 1.0
    return Way(distances, cosines, queries.areas, seen[which], is_mesh)


def _drawn(surface: Surface, most: int) -> Int64:
    """Draw at most `most` samples at random and return their indices; the seed is a hash of all samples.

    So nobody can choose which samples are measured. For a transformed surface, the original's draw is used.
    """
    if len(surface) <= most:
        return np.arange(len(surface))
    before = surface.placed[0] if surface.placed else surface
    if most not in before.drawn:
        digest = blake3_of(np.ascontiguousarray(before.points_m).tobytes())
        rng = np.random.default_rng(int(digest.rpartition(":")[2], 16))
        before.drawn[most] = np.sort(rng.choice(len(surface), most, replace=False, shuffle=False))
    return before.drawn[most]


def _metrics(truth: SpaceTruth, there: Way, back: Way) -> SurfaceMetrics:
    """Return the surface metrics; `there` is measured from prediction to truth, `back` the other way."""
    if not len(back.areas):
        return SurfaceMetrics()
    if not len(there.areas) or not np.isfinite(back.distances_m).all():
        # As in the grid protocols: if there is only one surface, the Chamfer distance is the grid's diagonal.
        far_m = math.sqrt(3) * FULL_CELLS * truth.voxel_size_m
        shares = dict.fromkeys((*F_SCORE_M, *F_SCORE_SHARES, "normal_consistency"), 0.0)
        return SurfaceMetrics(chamfer_l1_m=far_m, chamfer_l2_m2=far_m**2, **shares)
    ways = (there, back)
    normals = None
    if there.cosines is not None and back.cosines is not None:
        normals = sum(way.mean(way.cosines) for way in ways if way.cosines is not None) / 2
    return SurfaceMetrics(
        chamfer_l1_m=sum(way.mean(way.distances_m, max) for way in ways) / 2,
        chamfer_l2_m2=sum(way.mean(way.distances_m**2, max) for way in ways) / 2,
        normal_consistency=normals,
        **{name: _f_score(there.near(far), back.near(far)) for name, far in _tolerances_m(truth).items()},
    )


def _tolerances_m(truth: SpaceTruth) -> dict[str, float]:
    return F_SCORE_M | {name: share * truth.size_m for name, share in F_SCORE_SHARES.items()}


def _as_octmae(there: Way, back: Way) -> dict[str, float]:
    """Return {name: value} of OctMAE's mean distances, and F-scores at 5 to 30 mm (its eval.py, 08c1be6)."""
    ways = (there, back)
    mm = MM_PER_M
    return {
        "octmae_chamfer_l1_mm": sum(way.mean(way.distances_m, max) for way in ways) / 2 * mm,
        "octmae_chamfer_l2_mm2": sum(way.mean(way.distances_m**2, max) for way in ways) / 2 * mm**2,
        **{
            f"octmae_f_{far}mm": _f_score(there.near(far / mm), back.near(far / mm))
            for far in (5, 10, 20, 30)
        },
    }


def _f_score(precision: float, recall: float) -> float:
    # By rounding, a share of the area may exceed 1.
    return min(2 * precision * recall / (precision + recall), 1.0) if precision + recall else 0.0


def counted_cells(truth: SpaceTruth, part: str) -> Packed:
    """Return the known cells of a part ("whole", "visible" or "occluded"), packed."""
    if part == "whole":
        return truth.known
    return truth.known & (truth.seen if part == "visible" else ~truth.seen)


def _voxels(truth: SpaceTruth, solid: Solid | None, part: str) -> tuple[VoxelMetrics, float, float]:
    """Return the voxel metrics over the known cells of a part, and two shares of counted cells.

    The first is the share of the grid's cells that are counted, the second the share of the true shape's
    cells. Predicted volume outside the grid counts as wrong, except for the part "visible".
    """
    if part not in truth.counted:
        counted = counted_cells(truth, part)
        truth.counted[part] = counted, packed_count(counted), packed_count(counted & truth.full)
    counted, cells, true = truth.counted[part]
    shape = truth.solid_cells
    shares = cells / FULL_CELLS**3, true / shape if shape else 1.0
    if solid is None:
        return VoxelMetrics(), *shares
    inside = counted & solid.cells
    ours, both = packed_count(inside), packed_count(inside & truth.full)
    # Space outside the grid counts as not seen by the view.
    predicted = ours + (solid.outside if part != "visible" else 0.0)
    precision = both / predicted if predicted else 0.0
    return (
        VoxelMetrics(
            iou=both / (predicted + true - both) if predicted + true else 1.0,
            precision=precision,
            recall=both / true if true else 0.0,
            f1=2 * both / (predicted + true) if predicted + true else 1.0,
        ),
        *shares,
    )
