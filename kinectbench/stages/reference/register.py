"""Register a reference mesh to the built object: a rigid motion, from many initial poses.

It is point-to-plane ICP (Chen and Medioni 1992) in both directions. A measured sample of the object is
matched to the nearest sample of the reference. A sample of the reference is matched to the nearest sample of
the object, if that was measured and faces the same way. Distant matches count less, and so do edges, which
fusion rounds. If the size is estimated, the object's surface may also lie too far out, as that of narrow
objects does. All samples have fixed seeds, and the initial poses are fixed: nothing is random.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations, product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import (
    Tensors,
    TriangleMesh,
    invert_rigid,
    raycaster,
    rigid,
    rotation_angle_rad,
    rotation_from_quaternion_xyzw,
    transform_points,
)
from kinectbench.core.geometry.gauss_newton import NormalEquations, descend, robust_weights, weighted_products
from kinectbench.core.types import Bools, Float64
from kinectbench.core.voxels.point_cells import sample_surface
from kinectbench.stages.segment.object_model import ObjectModel
from kinectbench.stages.segment.solid.solid import SolidShape

if TYPE_CHECKING:
    from open3d.t.geometry import RaycastingScene

# Samples of each surface that are found as the nearest: 9 mm apart on a chair of 1.5 m2 (chosen here). The
# object and the reference have seeds of their own: two equal meshes would else have equal samples.
SAMPLES, OBJECT_SEED, REFERENCE_SEED = 20_000, 0, 1
# Turns about up of each of the 24 ways to lay principal axes onto each other; and turns spread evenly over
# all turns, 27 degrees apart, for shapes whose principal axes say nothing (chosen here).
TURNS, SPREAD = 12, 576
# Poses, steps and samples: all starts are looked at, then the best are refined twice (chosen here).
LOOKED_AT, COARSE, FINE = 120, (32, 10, 300), (5, 30, 2000)
# A pose whose residual is this many times that of the best is not refined further. No residual counts as less
# than this share of the diagonal, as samples do not tell that (chosen here).
HOPELESS, LEAST_SHARE = 3.0, 0.0005
# Number of samples for the residual of a pose.
JUDGED = 4000
# Farther than this share of the diagonal all distances count equally.
MOST_SHARE = 0.05
# Steps that move no sample by more, metres, end it.
STILL_M = 1e-5
# Columns of a step: rotation (3), shift (3), logarithm of the size, and how far out the surface lies.
SIZE, OUT = 6, 7
RIGID, SIZED, SIZED_OUT = tuple(range(6)), tuple(range(7)), tuple(range(8))
# Weight of a prior that holds the last unknown at 0: what may be either, as on a ball, counts as size (chosen
# here).
HELD = 0.01
# A sample is weighted by the mean cosine of the normals about it (this many samples within this many voxels):
# 0 at the first value, 1 at a cosine of 1. Without weights, a mug, a vase and a pot came to lie 0.61 to 0.83
# mm too low, because their rims are rounded; with weights 0.06 to 0.62 mm. The other side of a sheet, beyond
# this cosine, is left out. An edge counts a little, because handles are all edge.
FLAT, ABOUT, ABOUT_VOXELS, SHEET_COSINE, LEAST_COUNT = 0.8, 48, 2.0, -0.5, 0.001
# Two poses are one if no more lies between them (chosen here).
SAME_RAD, SAME_SHARE = np.radians(8.0), 0.02


@dataclass(frozen=True)
class Sampled:
    """Samples of a surface in its own frame, metres.

    Attributes:
        mesh: the surface.
        points: (n, 3).
        normals: (n, 3) unit.
        counted: (n,) bool, whether a sample may be matched: for samples of the object, whether it was
            measured.
        flat: (n,) weight of a sample in the registration: 1 on a plane, nearly 0 at an edge.
    """

    mesh: TriangleMesh
    points: Float64
    normals: Float64
    counted: Bools
    flat: Float64

    @cached_property
    def tree(self) -> cKDTree:
        """The k-d tree of the samples."""
        return cKDTree(self.points)

    @cached_property
    def diagonal_m(self) -> float:
        """Diagonal of the samples' bounding box in their own frame, metres."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    @cached_property
    def _caster(self) -> tuple["RaycastingScene", Tensors, Float64]:
        middle = self.points.mean(axis=0)  # the library computes in float32
        scene, tensor = raycaster(TriangleMesh(self.mesh.vertices - middle, self.mesh.faces))
        return scene, tensor, middle

    def distance_m(self, points: Float64) -> Float64:
        """Distances (n,) of points (n, 3) from the nearest triangle."""
        scene, tensor, middle = self._caster
        near = tensor(np.ascontiguousarray(points - middle, dtype=np.float32))
        return np.asarray(scene.compute_distance(near).numpy(), dtype=np.float64)

    def few(self, most: int) -> NDArray[np.int64]:
        """Return indices of evenly chosen samples that may be matched, at most `most` of them."""
        places = np.flatnonzero(self.counted)
        return places[:: max(1, -(-len(places) // most))]

    def faced(self, points: Float64, normals: Float64) -> tuple[NDArray[np.int64], Bools]:
        """Find the samples nearest to points (n, 3) with normals (n, 3).

        Return their indices (n,), and which of them may be matched and face the same way.
        """
        nearest = self.tree.query(points)[1]
        return nearest, self.counted[nearest] & ((self.normals[nearest] * normals).sum(axis=1) > 0)


def sampled(mesh: TriangleMesh) -> Sampled:
    """Sample a reference mesh; all samples may be matched."""
    rng = np.random.default_rng(REFERENCE_SEED)
    points, normals = sample_surface(mesh.vertices, mesh.faces, SAMPLES, rng)
    return Sampled(mesh, points, normals, np.ones(len(points), bool), np.ones(len(points)))


def sampled_object(model: ObjectModel) -> Sampled:
    """Sample a built object, in its world; only measured samples may be matched.

    A sample is measured if the voxel below it is SURFACE and the voxel above it is neither UNKNOWN nor OTHER:
    if one side of a thin wall was measured, its other side does not count. If the object is itself a
    reference mesh, the voxel above does not matter.
    """
    shape, rng = model.shape, np.random.default_rng(OBJECT_SEED)
    points, normals = sample_surface(shape.mesh.vertices, shape.mesh.faces, SAMPLES, rng)
    step = shape.grid.voxel_size_m * normals
    below, above = (_labels(shape, points + voxels * step) for voxels in (-0.5, 1.0))
    counted = (below == Label.SURFACE) & ~np.isin(above, (Label.UNKNOWN, Label.OTHER))
    if model.quality.truth is not None:  # a reference mesh: it has no air, and all of it is true
        counted = below == Label.SURFACE
    drawn = Sampled(shape.mesh, points, normals, counted, np.ones(len(points)))
    return replace(drawn, flat=_flatness(drawn, ABOUT_VOXELS * shape.grid.voxel_size_m))


def _labels(shape: SolidShape, points: Float64) -> NDArray[np.uint8]:
    """Labels of the voxels that points (n, 3) lie in."""
    cells = np.floor(transform_points(shape.grid.T_grid_world, points) / shape.grid.voxel_size_m)
    inside = np.clip(cells, 0, np.array(shape.grid.shape) - 1).astype(np.int64)
    labels: NDArray[np.uint8] = shape.labels[tuple(inside.T)]
    return labels


def _flatness(drawn: Sampled, far_m: float) -> Float64:
    """Weight samples (n,) by the normals of others within `far_m`: 1 on a plane, nearly 0 at an edge."""
    far, near = drawn.tree.query(drawn.points, k=ABOUT, distance_upper_bound=far_m)
    here = np.isfinite(far)  # else there is none so near
    cosines = np.einsum("nki,ni->nk", drawn.normals[np.where(here, near, 0)], drawn.normals)
    here &= cosines > SHEET_COSINE
    mean = (cosines * here).sum(axis=1) / np.maximum(here.sum(axis=1), 1)
    return np.asarray(np.clip((mean - FLAT) / (1 - FLAT), LEAST_COUNT, 1.0))


@dataclass(frozen=True)
class Pose:
    """A pose of the reference on the object.

    Attributes:
        T: (4, 4) from the reference to the world; a similarity if its size was estimated.
        residual_m: mean distance between samples of object and reference, in both directions, metres; single
            distances are clipped at 5 % of the object's diagonal.
    """

    T: Float64
    residual_m: float


def poses(ours: Sampled, theirs: Sampled, T_floor_world: Float64) -> tuple[Pose, ...]:
    """Find the distinct poses to which registration converges from the best initial poses, best first.

    Args:
        ours: the object; at least one of its samples was measured.
        theirs: the reference.
        T_floor_world: (4, 4), from the object's world to the frame whose z is up.
    """
    starts = list(_starts(ours, theirs, T_floor_world[2, :3]))
    found = [Pose(T, residual_m(ours, theirs, T, LOOKED_AT, exact=False)) for T in starts]
    for (count, steps, samples), judged in ((COARSE, COARSE[2]), (FINE, JUDGED)):
        best = sorted(found, key=lambda pose: pose.residual_m)[:count]
        least_m = max(best[0].residual_m, LEAST_SHARE * ours.diagonal_m)
        near = [pose.T for pose in best if pose.residual_m <= HOPELESS * least_m]
        moved = [settled(ours, theirs, T, steps, samples)[0] for T in near]
        found = [Pose(T, residual_m(ours, theirs, T, judged)) for T in moved]
        found = _distinct(sorted(found, key=lambda pose: pose.residual_m), theirs)
    return tuple(found)


def best_scale(ours: Sampled, theirs: Sampled, T: Float64, free: Sequence[int]) -> float:
    """Return the factor by which the reference fits best, by registration from a pose (4, 4).

    The unknowns `free` are `SIZED`, the motion and the size, or `SIZED_OUT`, also how much too far out the
    object's surface lies.
    """
    found, _ = settled(ours, theirs, T, FINE[1], FINE[2], free)
    return float(np.cbrt(np.linalg.det(found[:3, :3])))


def mirror_image(theirs: Sampled) -> Sampled:
    """Return the reference's mirror image."""
    flip = np.array([-1.0, 1.0, 1.0])
    mesh = TriangleMesh(theirs.mesh.vertices * flip, theirs.mesh.faces[:, ::-1].copy())
    return replace(theirs, mesh=mesh, points=theirs.points * flip, normals=theirs.normals * flip)


def _starts(ours: Sampled, theirs: Sampled, up: Float64) -> Iterator[Float64]:
    """Yield initial poses (4, 4), which bring both centroids to one point.

    The rotations are all that align the principal axes, each combined with twelve turns about `up` (3,), and
    further rotations that are spread evenly.
    """
    here, there = (one.points.mean(axis=0) for one in (ours, theirs))
    axes_here, axes_there = (_principal(one.points) for one in (ours, theirs))
    turns: list[Float64] = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        change = np.zeros((3, 3))
        change[range(3), order] = signs
        if np.linalg.det(change) > 0:
            turned = axes_here @ change @ axes_there.T
            turns += [about(up, angle) @ turned for angle in np.arange(TURNS) * 2 * np.pi / TURNS]
    for turn in (*turns, *_spread()):
        yield rigid(turn, here - turn @ there)


def _principal(points: Float64) -> Float64:
    """Return the principal axes of points (n, 3) as the columns of a rotation (3, 3)."""
    axes: Float64 = np.linalg.eigh(np.cov(points.T))[1]
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    return axes


def _spread() -> Float64:
    """Return rotations (n, 3, 3) spread evenly. Source: M. Alexa, "Super-Fibonacci Spirals" (CVPR 2022)."""
    s = np.arange(SPREAD) + 0.5
    r, big = np.sqrt(s / SPREAD), np.sqrt(1 - s / SPREAD)
    a, b = 2 * np.pi * s / np.sqrt(2.0), 2 * np.pi * s / 1.533751168755204288118041
    return rotation_from_quaternion_xyzw(
        np.stack([r * np.sin(a), r * np.cos(a), big * np.sin(b), big * np.cos(b)], axis=1)
    )


def about(axis: Float64, angle_rad: float) -> Float64:
    """Return the rotation matrix (3, 3) of the rotation vector `angle_rad * axis`, with `axis` (3,)."""
    return np.asarray(Rotation.from_rotvec(angle_rad * axis).as_matrix())


def residual_m(ours: Sampled, theirs: Sampled, T: Float64, samples: int, exact: bool = True) -> float:
    """Return the mean distance between object and reference, where the object was measured, metres.

    It is the mean of two means: the distance of the object's measured samples from the reference, and the
    distance from the object of those samples of the reference whose nearest sample of the object was measured
    and faces the same way. The pose T (4, 4) is from the reference to the world; at most `samples` of each
    are taken. The distances are to triangles, or, if they need not be `exact`, to the nearest sample.
    """
    most_m = MOST_SHARE * ours.diagonal_m
    back = invert_rigid(T)
    few = theirs.few(samples)
    mine = transform_points(back, ours.points[ours.few(samples)])
    other = transform_points(T, theirs.points[few])
    nearest, which = ours.faced(other, theirs.normals[few] @ T[:3, :3].T)
    other, nearest = other[which], nearest[which]
    there = theirs.distance_m(mine) if exact else theirs.tree.query(mine)[0]
    here = ours.distance_m(other) if exact else np.linalg.norm(ours.points[nearest] - other, axis=1)
    ways = [np.minimum(way, most_m).mean() if len(way) else most_m for way in (there, here)]
    return float(np.mean(ways))


def settled(
    ours: Sampled, theirs: Sampled, T: Float64, steps: int, samples: int, free: Sequence[int] = RIGID
) -> tuple[Float64, float]:
    """Run registration steps; return the pose (4, 4), and how far the last step moved the samples, metres.

    It begins at a pose T (4, 4) from the reference to the world, and takes at most `steps`, with at most
    `samples` of each. The unknowns `free` are `RIGID`, or those of `best_scale`.
    """
    chosen, few = ours.few(samples), theirs.few(samples)

    def advance(T: Float64) -> tuple[Float64, float]:
        """Return the next pose, and how far the step to it moved the samples, metres."""
        back: Float64 = np.linalg.inv(T).astype(np.float64)
        turned = T[:3, :3] / np.cbrt(np.linalg.det(T[:3, :3]))
        far_there, there = theirs.tree.query(transform_points(back, ours.points[chosen]))
        places = transform_points(T, theirs.points[few])
        here, which = ours.faced(places, theirs.normals[few] @ turned.T)
        here, places = here[which], places[which]
        far_here = np.linalg.norm(ours.points[here] - places, axis=1)
        drawn = np.concatenate([transform_points(T, theirs.points[there]), places])
        targets = ours.points[np.concatenate([chosen, here])]
        normals = np.concatenate([theirs.normals[there] @ turned.T, ours.normals[here]])
        ways = (far_there, ours.flat[chosen]), (far_here, ours.flat[here])
        weights = np.concatenate([robust_weights(*way, power=2) for way in ways])
        change, moved = _step(drawn, targets, normals, weights, free)
        return change @ T, moved

    return descend(advance, T, steps, STILL_M)


def _step(
    places: Float64, targets: Float64, normals: Float64, weights: Float64, free: Sequence[int]
) -> tuple[Float64, float]:
    """Compute one step: a similarity (4, 4), and about how far it moves the outermost point, metres.

    It moves `places` (n, 3) towards planes with the points `targets` (n, 3) and the unit `normals` (n, 3),
    with `weights` (n,). The unknowns `free` are `RIGID`, `SIZED` or `SIZED_OUT`.
    """
    middle = places.mean(axis=0)
    arms = places - middle
    size_m = float(np.linalg.norm(arms, axis=1).max())
    # Lengths of about one, so that damping is fair.
    along = [(arms * normals).sum(axis=1, keepdims=True) / size_m, np.ones((len(arms), 1))]
    gap = ((targets - places) * normals).sum(axis=1, keepdims=True)
    rows = np.concatenate([np.cross(arms, normals) / size_m, normals, *along, gap], axis=1)
    all_of = NormalEquations.of_products(weighted_products(rows, weights)).damped()
    all_of.matrix[OUT, OUT] += HELD * weights.sum()
    step, chosen = np.zeros(OUT + 1), list(free)
    step[chosen] = NormalEquations(all_of.matrix[np.ix_(chosen, chosen)], all_of.gradient[chosen]).step()
    moved = float(np.linalg.norm(step[:3]) + np.linalg.norm(step[3:6]) + np.abs(step[SIZE]))
    turn = np.clip(step[:3] / size_m, -0.5, 0.5)
    R = about(turn, 1.0) * np.exp(np.clip(step[SIZE] / size_m, -0.1, 0.1))
    return rigid(R, middle + step[3:6] - R @ middle), moved


def _distinct(found: Sequence[Pose], theirs: Sampled) -> list[Pose]:
    kept: list[Pose] = []
    for pose in found:
        if all(apart(pose.T, other.T, theirs) for other in kept):
            kept.append(pose)
    return kept


def apart(T: Float64, other: Float64, theirs: Sampled) -> bool:
    """Whether two poses (4, 4) of the reference differ by more than a small turn or shift."""
    middle = theirs.points.mean(axis=0)
    far_m = float(np.linalg.norm((T - other)[:3, :3] @ middle + (T - other)[:3, 3]))
    turned = float(rotation_angle_rad(T[:3, :3].T @ other[:3, :3]))
    return turned > SAME_RAD or far_m > SAME_SHARE * theirs.diagonal_m
