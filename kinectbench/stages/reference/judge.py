"""Judge whether a reference mesh is that of the built object; the mesh of another object is refused.

The rules are in docs/second-truth.md. docs/evidence/ground-truth.md has the measurements of right and wrong
meshes by which they were chosen.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinectbench.core.artefacts.reference import RunnerUpPart
from kinectbench.core.geometry import TriangleMesh, invert_rigid, rigid, rotation_angle_rad, transform_points
from kinectbench.core.types import Float64
from kinectbench.core.voxels.pair_file import FULL_CELLS
from kinectbench.core.voxels.solid import costs_too_much
from kinectbench.stages.reference.register import (
    JUDGED,
    LEAST_SHARE,
    SIZED,
    SIZED_OUT,
    Pose,
    Sampled,
    about,
    best_scale,
    mirror_image,
    poses,
    sampled,
    sampled_object,
)
from kinectbench.stages.segment.object_model import ObjectModel

# Largest residual, as a share of the object's diagonal. It was at most 0.28 % for right meshes, 0.84 % for a
# helmet whose hollow no camera saw, and at least 2.2 % for other objects of the same size.
MOST_RESIDUAL = 0.01
# The best scale of right meshes was off by at most 0.5 %, of meshes 5 % too large or small by 4.4 % or more;
# so is the scale beside which the surface may lie too far out: the two differed by 0.4 % at most, but by 5 %
# or more of bottles that were fused 2 mm too far out.
MOST_SCALE = 0.02
# The mirror image of a right mesh had 0.97 of its residual at least; that of a mirrored mesh 0.39 at most,
# where the object is not its own mirror image. Differences below `LEAST_SHARE` say nothing.
LEAST_MIRRORED = 0.7
# A mesh of another unit, or one with surroundings: nothing is searched for (chosen here).
MOST_SIZES = 2.0
# Another pose with a residual below this many of the best, and `LEAST_SHARE`, fits as well (chosen here).
AS_WELL = 1.1
# A mesh of rotational symmetry that is turned in this many steps stays where it was, within this share of its
# diagonal: simulated bottles, bins and stools within 0.13 %, pots with handles within 0.7 %.
STEPS, SYMMETRIC = 24, 0.003


@dataclass(frozen=True)
class RegisteredReference:
    """The registration of a reference mesh to a built object, and whether it is refused.

    Attributes:
        ours: samples of the object.
        theirs: samples of the reference, in its own frame.
        refused: why the mesh is not accepted as that of the object, in one line; None if it is accepted.
        pose: the best pose; None if the mesh was refused before the search.
        scale: the factor by which the reference would fit best. This and the next three are None if the mesh
            was refused before the search, or by the residual of the best pose.
        mirrored_m: residual of its mirror image, metres.
        runner_up: the second-best pose; None if the search ended in one pose.
        symmetric_axis_floor: (3,) unit, floor frame: the axis of its rotational symmetry; None if it has
            none.
        mirror_as_well: whether its mirror image, if that is another shape, fits as well.
    """

    ours: Sampled
    theirs: Sampled
    refused: str | None
    pose: Pose | None = None
    scale: float | None = None
    mirrored_m: float | None = None
    runner_up: RunnerUpPart | None = None
    symmetric_axis_floor: Float64 | None = None
    mirror_as_well: bool = False


def register_reference(model: ObjectModel, mesh: TriangleMesh) -> RegisteredReference:
    """Register a reference to a built object, and judge whether it is the mesh of this object.

    The mesh is in a frame of its own, metres, of one object alone, closed or open.
    """
    ours, theirs = sampled_object(model), sampled(mesh)
    if not ours.counted.any():
        return RegisteredReference(
            ours, theirs, "nothing of the object was measured, so that nothing can be compared"
        )
    sizes = theirs.diagonal_m / ours.diagonal_m
    if not 1 / MOST_SIZES < sizes < MOST_SIZES:
        return RegisteredReference(
            ours,
            theirs,
            f"its diagonal is {theirs.diagonal_m:.3g} m and the object's {ours.diagonal_m:.3g} m: another "
            "object, another unit than metres, or surroundings that are to be cut off",
        )
    if _lies_across(mesh):
        return RegisteredReference(
            ours, theirs, f"too many of its {len(mesh.faces)} faces lie across each other; simplify it"
        )
    T_floor_world = model.floor.T_floor_world
    found = poses(ours, theirs, T_floor_world)
    best, R_floor = found[0], T_floor_world[:3, :3] @ found[0].T[:3, :3]
    if best.residual_m > MOST_RESIDUAL * ours.diagonal_m:
        return RegisteredReference(ours, theirs, _refusal(best.residual_m, ours.diagonal_m), best)
    axis = symmetric_axis(theirs)
    runner_up = _runner_up(found, T_floor_world, LEAST_SHARE * ours.diagonal_m) if len(found) > 1 else None
    scales = [best_scale(ours, theirs, best.T, free) for free in (SIZED_OUT, SIZED)]
    mirror = mirror_image(theirs)
    mirrored = poses(ours, mirror, T_floor_world)[0]
    refused = _refusal(best.residual_m, ours.diagonal_m, mirrored.residual_m, scales)
    # It lies elsewhere than the mesh, where nothing was measured: the mesh is not its own mirror image.
    least_m = max(best.residual_m, LEAST_SHARE * ours.diagonal_m)
    as_well = LEAST_MIRRORED * mirrored.residual_m < least_m < _between(theirs, best.T, mirror, mirrored.T)
    axis_floor = None if axis is None else R_floor @ axis
    return RegisteredReference(
        ours, theirs, refused, best, scales[0], mirrored.residual_m, runner_up, axis_floor, as_well
    )


def _between(one: Sampled, T_one: Float64, other: Sampled, T_other: Float64) -> float:
    """Return the mean distance of samples of one mesh from another mesh, both at their poses, metres."""
    T = invert_rigid(T_other) @ T_one
    return float(other.distance_m(transform_points(T, one.points[one.few(JUDGED)])).mean())


def _lies_across(mesh: TriangleMesh) -> bool:
    """Whether so many faces of a mesh overlap that computing distances from it may take far too long."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    cells = (mesh.vertices - low) * (FULL_CELLS / max(float((high - low).max()), 1e-9))
    return costs_too_much(cells[:, :2], mesh.faces, (FULL_CELLS, FULL_CELLS))


def _refusal(
    residual_m: float,
    diagonal_m: float,
    of_mirror_m: float | None = None,
    scales: Sequence[float] = (1.0, 1.0),
) -> str | None:
    share = residual_m / diagonal_m
    if share > MOST_RESIDUAL:
        return (
            f"it is off by {residual_m * 1000:.1f} mm in the mean, {share:.1%} of the diagonal, more than "
            f"{MOST_RESIDUAL:.0%}: the mesh of another object, or no registration was found"
        )
    least_m = LEAST_SHARE * diagonal_m
    if of_mirror_m is not None and of_mirror_m + least_m < LEAST_MIRRORED * residual_m:
        return (
            f"its mirror image fits better, {of_mirror_m * 1000:.1f} mm off in the mean and not "
            f"{residual_m * 1000:.1f} mm: mirror it back"
        )
    off = [scale - 1 for scale in scales if abs(scale - 1) > MOST_SCALE]
    if len(off) == len(scales) and max(off) * min(off) > 0:
        return (
            f"it fits best {scales[0]:.3f} times as large, more than {MOST_SCALE:.0%} off: check its size "
            "and the depth scale of the camera"
        )
    if off:
        return (
            f"its size cannot be judged: it fits best {scales[1]:.3f} times as large, or {scales[0]:.3f} "
            "times if the surface was fused too far out or in, as that of a narrow thing is"
        )
    return None


def _runner_up(found: tuple[Pose, ...], T_floor_world: Float64, least_m: float) -> RunnerUpPart:
    best, other = found[:2]
    turn = other.T[:3, :3] @ best.T[:3, :3].T
    skew = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    if np.linalg.norm(skew) < 1e-3:  # half a turn, or none: the eigenvector of 1
        skew = np.linalg.eigh(turn + turn.T)[1][:, 2]
    axis = T_floor_world[:3, :3] @ skew
    as_well = other.residual_m <= AS_WELL * best.residual_m + least_m
    x, y, z = (round(float(value), 4) for value in axis / np.linalg.norm(axis))
    return RunnerUpPart(
        residual_m=round(other.residual_m, 6),
        turn_rad=float(rotation_angle_rad(turn)),
        axis_floor=(x, y, z),
        fits_as_well=as_well,
    )


def symmetric_axis(theirs: Sampled) -> Float64 | None:
    """Return the axis (3,) of a reference's rotational symmetry, in its frame; None if it has none."""
    points = theirs.points[theirs.few(1000)]
    middle = theirs.points.mean(axis=0)
    axes = np.linalg.eigh(np.cov(theirs.points.T))[1].T
    for axis in axes:
        turns = (rigid(about(axis, angle), 0.0) for angle in np.arange(1, STEPS) * 2 * np.pi / STEPS)
        off = (theirs.distance_m(transform_points(turn, points - middle) + middle).mean() for turn in turns)
        if all(far_m <= SYMMETRIC * theirs.diagonal_m for far_m in off):
            return np.asarray(axis, dtype=np.float64)
    return None
