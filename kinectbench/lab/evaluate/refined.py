"""Register the built mesh rigidly to the true one, and measure the error of shape that remains.

In a tracked recording, a smooth depth error may shift the object by a millimetre or two against the cameras.
Predictions that are scored in the camera frame are not affected by such a shift. The error that is left after
this registration is the error of the shape.
"""

from dataclasses import dataclass, replace

import numpy as np

from kinectbench.core.geometry import (
    TriangleMesh,
    invert_rigid,
    rigid,
    rigid_from_twist,
    rotation_angle_rad,
    transform_points,
)
from kinectbench.core.geometry.gauss_newton import descend, weighted_products
from kinectbench.core.types import Float64
from kinectbench.lab.evaluate.build import BuildRegistration
from kinectbench.lab.evaluate.measured import (
    LEAST_SAMPLES,
    REACH_M,
    FaceBias,
    MeasuredSurface,
    face_bias,
    on_faces,
)
from kinectbench.lab.evaluate.solid import canonical_cube, compare_on, overlap
from kinectbench.lab.evaluate.surface import ReferenceSurface
from kinectbench.lab.simulate.truth import Truth
from kinectbench.stages.segment.object_model import ObjectModel

# This number of samples fixes a motion to a hundredth of a millimetre; after five steps it changes by less.
SAMPLES, STEPS = 20_000, 6
# Motions that no surface fixes, such as the turn of a round bin, stay at zero: their eigenvalue is less than
# this share of the largest.
STIFFNESS = 1e-4


@dataclass(frozen=True)
class RefinedFigures:
    """Metrics of the built closed mesh before and after rigid registration to the true mesh.

    Distances are from measured samples of the true surface to the built mesh; those over 15 mm are ignored.

    Attributes:
        lifted_m: upward shift of the object's centre by the registration.
        moved_m: length of the whole shift of the object's centre.
        turned_rad: angle of the rotation.
        measured_distance_m: mean distance before registration; None if no distance is within 15 mm.
        refined_distance_m: mean distance after registration; None if no distance is within 15 mm.
        face_bias_m: face bias after registration.
        iou: IoU of the solids on 256^3 cells after registration.
        known_iou: the same IoU over known cells; None if no true cell is known.
    """

    lifted_m: float
    moved_m: float
    turned_rad: float
    measured_distance_m: float | None
    refined_distance_m: float | None
    face_bias_m: FaceBias
    iou: float
    known_iou: float | None


def refined_figures(
    model: ObjectModel, truth: Truth, registration: BuildRegistration, surface: MeasuredSurface
) -> RefinedFigures:
    """Register the built mesh to the measured true surface, and measure it before and after.

    The model is in its own world, whose registration is by the camera trajectories.
    """
    mesh = model.shape.mesh.transformed(registration.T_truth_built)
    T = _refining_motion(mesh, truth, surface)
    moved = replace(registration, T_truth_built=T @ registration.T_truth_built)
    refined = mesh.transformed(T)
    middle = truth.mesh_world.vertices.mean(axis=0)
    shift = transform_points(T, middle[None])[0] - middle
    solid = overlap(compare_on(canonical_cube(truth), model, truth, moved))
    return RefinedFigures(
        lifted_m=float(shift @ truth.T_world_object[:3, 2]),
        moved_m=float(np.linalg.norm(shift)),
        turned_rad=float(rotation_angle_rad(T[:3, :3])),
        measured_distance_m=measured_distance_m(mesh, surface),
        refined_distance_m=measured_distance_m(refined, surface),
        face_bias_m=face_bias(refined, truth, surface),
        iou=solid.iou,
        known_iou=solid.known_iou,
    )


def measured_distance_m(mesh_world: TriangleMesh, surface: MeasuredSurface) -> float | None:
    """Return the mean distance of measured samples from a mesh; None if there are none.

    Samples more than 15 mm from the mesh are ignored.
    """
    distance_m = ReferenceSurface(mesh_world).distance_m(surface.points_world[surface.measured])
    near = distance_m <= REACH_M
    return float(distance_m[near].mean()) if near.any() else None


def _refining_motion(mesh_world: TriangleMesh, truth: Truth, surface: MeasuredSurface) -> Float64:
    """Return the rigid motion (4, 4) that registers a closed mesh to the measured true surface.

    It minimises point-to-plane distances (Chen and Medioni 1992) by Gauss-Newton, over samples at most 15 mm
    from the mesh. Samples within 15 mm of sharp edges are left out if enough remain, because built edges are
    round. Without samples, the motion is the identity.
    """
    faces = on_faces(truth, surface)
    chosen = np.flatnonzero(faces if faces.sum() >= LEAST_SAMPLES else surface.measured)
    chosen = chosen[:: max(1, len(chosen) // SAMPLES)]
    points, normals = surface.points_world[chosen], surface.normals_world[chosen]
    built = ReferenceSurface(mesh_world)
    if not len(chosen):
        return np.eye(4)
    middle = points.mean(axis=0)
    # In units of the object's size, rotation and shift have equal weight.
    size_m = max(float(np.abs(points - middle).max()), 1e-3)
    about = rigid(np.eye(3), middle)

    def advance(T: Float64) -> tuple[Float64, float]:
        """Return the motion (4, 4) after one Gauss-Newton step, and inf as the step's size.

        So `descend` never stops early.
        """
        outward_m = built.signed_distance_m(transform_points(invert_rigid(T), points))
        near = np.abs(outward_m) <= REACH_M
        arms = np.cross(points[near] - middle, normals[near]) / size_m
        rows = np.column_stack([arms, normals[near], outward_m[near]])
        products = weighted_products(rows, np.ones(len(rows)))
        values, vectors = np.linalg.eigh(products[:6, :6])
        kept = values > STIFFNESS * values[-1]  # none, if nothing is near
        along = vectors[:, kept]
        step = along @ ((along.T @ products[:6, 6]) / values[kept])
        motion = rigid_from_twist(np.append(step[:3] / size_m, step[3:]))
        return about @ motion @ invert_rigid(about) @ T, np.inf

    return np.asarray(descend(advance, np.eye(4), STEPS)[0])
