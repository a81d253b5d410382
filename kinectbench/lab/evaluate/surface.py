"""Compare the built surface with the true one: accuracy, completeness, precision, recall and F."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from kinectbench.core.geometry import TriangleMesh, invert_rigid, raycaster, transform_points
from kinectbench.core.types import Bools, Float64
from kinectbench.core.voxels.point_cells import sample_surface
from kinectbench.lab.simulate.truth import Truth

THRESHOLDS_M = (0.005, 0.010)
SAMPLES = 100_000
SEED = 0
# Surface is judged in the object's box and this margin around it, without the floor that it stands on.
MARGIN_M, FLOOR_M = 0.03, 0.015
# Number of rays that vote on which side of the true surface a point lies.
SIGN_RAYS = 3


@dataclass(frozen=True)
class SurfaceErrors:
    """Distances in metres between the built and the true surface, at points spread evenly over each.

    Attributes:
        built_m: (k,) signed distances of built points from the true surface, > 0 outside the true solid.
        built_visible: (k,) bool, the camera saw the true sample nearest to the built point.
        true_m: (m,) distances of the true samples from the built surface.
        true_visible: (m,) bool, the camera saw the true sample in at least one frame.
    """

    built_m: Float64
    built_visible: Bools
    true_m: Float64
    true_visible: Bools


@dataclass(frozen=True)
class DistanceStatistics:
    """Mean, root mean square and 90 % quantile of absolute distances, metres."""

    mean_m: float
    rms_m: float
    quantile_90_m: float


@dataclass(frozen=True)
class SurfaceScore:
    """Precision, recall and F-score at one distance threshold, in [0, 1].

    Attributes:
        threshold_m: the threshold.
        precision: share of the built surface within the threshold of the true one.
        recall: share of the true surface within the threshold of the built one.
        f: harmonic mean of precision and recall, 0 if both are 0.
    """

    threshold_m: float
    precision: float
    recall: float
    f: float


@dataclass(frozen=True)
class SurfaceComparison:
    """Accuracy, completeness and scores of the built surface, as a whole or only where the camera saw it.

    Attributes:
        accuracy: mean, RMS and 90 % quantile of built points' distances from the true surface; None if there
            are no built points.
        completeness: mean, RMS and 90 % quantile of true samples' distances from the built surface; None if
            there are no true samples.
        scores: precision, recall and F-score, one `SurfaceScore` for each distance threshold.
    """

    accuracy: DistanceStatistics | None
    completeness: DistanceStatistics | None
    scores: tuple[SurfaceScore, ...]


@dataclass(frozen=True)
class SurfaceFigures:
    """All metrics of the built surface against the true one.

    Attributes:
        whole: over all surface, including the underside, which rests on the floor and is never seen.
        visible: over surface that the camera saw: true samples seen in at least one frame, and built points
            whose nearest true sample was seen.
        visible_share: share of the true surface that the camera saw.
        mean_signed_m: mean signed distance of the built surface: > 0 if it is too far out.
    """

    whole: SurfaceComparison
    visible: SurfaceComparison
    visible_share: float
    mean_signed_m: float


class ReferenceSurface:
    """A mesh prepared for point-to-triangle distances and occlusion tests (Open3D's RaycastingScene).

    Distances are accurate to a micrometre; near long sliver triangles, to 0.3 mm.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        # The library computes in float32, which is most precise near the origin.
        self._center = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
        self._scene, self._tensor = raycaster(TriangleMesh(mesh.vertices - self._center, mesh.faces))

    def distance_m(self, points: Float64) -> Float64:
        """Return the distances (n,) of points (n, 3) from the nearest triangle."""
        return np.asarray(self._scene.compute_distance(self._local(points)).numpy(), dtype=np.float64)

    def signed_distance_m(self, points: Float64) -> Float64:
        """Return signed distances (n,) of points (n, 3) from a closed mesh, negative inside."""
        distances = self._scene.compute_signed_distance(self._local(points), nsamples=SIGN_RAYS)
        return np.asarray(distances.numpy(), dtype=np.float64)

    def hides(self, points: Float64, place: Float64) -> Bools:
        """Return whether the mesh occludes each point (n, 3) from a viewpoint `place` (3,): (n,) bool.

        The points must lie just off the surface.
        """
        starts = points - self._center
        rays = np.concatenate([starts, place - self._center - starts], axis=1).astype(np.float32)
        return np.asarray(self._scene.test_occlusions(self._tensor(rays), tnear=0.0, tfar=1.0).numpy())

    def _local(self, points: Float64) -> object:
        return self._tensor(np.ascontiguousarray(points - self._center, dtype=np.float32))


def surface_errors(
    mesh: TriangleMesh, truth: Truth, samples: int = SAMPLES, judged: Callable[[Float64], Bools] | None = None
) -> SurfaceErrors:
    """Measure distances of points on a built mesh from the true mesh, and of true points from the built mesh.

    Args:
        mesh: the built surface, in the truth's world, metres; it must have faces.
        truth: the true closed mesh, with samples of its surface.
        samples: number of points spread over the built mesh.
        judged: function that maps points (n, 3) to the mask (n,) of those to evaluate; None: all are
            evaluated.
    """
    points, _ = sample_surface(mesh.vertices, mesh.faces, samples, np.random.default_rng(SEED))
    true_points, seen = truth.surface.points_world, truth.surface.frames_seen > 0
    nearest = cKDTree(true_points).query
    if judged is not None:
        points, kept = points[judged(points)], judged(true_points)
    else:
        kept = np.ones(len(true_points), dtype=np.bool_)
    return SurfaceErrors(
        built_m=ReferenceSurface(truth.mesh_world).signed_distance_m(points),
        built_visible=seen[nearest(points)[1]],
        true_m=ReferenceSurface(mesh).distance_m(true_points[kept]),
        true_visible=seen[kept],
    )


def errors_at_object(mesh: TriangleMesh, truth: Truth) -> SurfaceErrors | None:
    """Measure the distances between a mesh and the true object, near the object and above the floor only.

    Only surface that lies in the true object's box, enlarged by 30 mm, and more than 15 mm above the floor
    counts. The result is None if the mesh or the object has no such surface.

    Args:
        mesh: a fused scene or a part of the built object, in the truth's world, metres.
        truth: the true closed mesh, with samples of its surface.
    """
    T_object_world = invert_rigid(truth.T_world_object)
    true = transform_points(T_object_world, truth.mesh_world.vertices)
    low, high = true.min(axis=0) - MARGIN_M, true.max(axis=0) + MARGIN_M

    def judged(points_world: Float64) -> Bools:
        points = transform_points(T_object_world, points_world)
        return np.asarray(np.all((points > low) & (points < high), axis=1) & (points[:, 2] > FLOOR_M))

    # Of a face that crosses the border, only the part inside counts.
    corners = transform_points(T_object_world, mesh.vertices)[mesh.faces]
    faces = np.all((corners.max(axis=1) > low) & (corners.min(axis=1) < high), axis=1)
    if not faces.any():
        return None
    errors = surface_errors(mesh.keep_faces(faces), truth, SAMPLES, judged)
    return errors if len(errors.built_m) and len(errors.true_m) else None


def surface_figures(errors: SurfaceErrors, thresholds_m: Sequence[float] = THRESHOLDS_M) -> SurfaceFigures:
    """Return accuracy, completeness, precision, recall and F-score, for all surface and for visible surface.

    Precision, recall and F-score are those of Knapitsch et al., "Tanks and Temples" (ACM TOG 2017), eqs. 2-4,
    but at points spread evenly over both surfaces, and with exact distances to the triangles.
    """
    built_m = np.abs(errors.built_m)
    return SurfaceFigures(
        whole=_compare(built_m, errors.true_m, thresholds_m),
        visible=_compare(built_m[errors.built_visible], errors.true_m[errors.true_visible], thresholds_m),
        visible_share=float(errors.true_visible.mean()),
        mean_signed_m=float(errors.built_m.mean()),
    )


def _compare(built_m: Float64, true_m: Float64, thresholds_m: Sequence[float]) -> SurfaceComparison:
    scores = []
    for threshold_m in thresholds_m:
        precision, recall = (float((d < threshold_m).mean()) if len(d) else 0.0 for d in (built_m, true_m))
        f = 2 * precision * recall / (precision + recall) if precision + recall else 0.0
        scores.append(SurfaceScore(threshold_m, precision, recall, f))
    return SurfaceComparison(_distances(built_m), _distances(true_m), tuple(scores))


def _distances(d: Float64) -> DistanceStatistics | None:
    if not len(d):
        return None
    return DistanceStatistics(float(d.mean()), float(np.sqrt(np.mean(d**2))), float(np.quantile(d, 0.9)))
