"""Find the part of the true surface that some frame measured, and the built surface's mean error there."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from kinectbench.core.geometry import Camera, TriangleMesh, invert_rigid, transform_points
from kinectbench.core.types import Bools, Float32, Float64, Int64
from kinectbench.core.voxels.point_cells import sample_surface
from kinectbench.lab.evaluate.build import Build, BuildRegistration
from kinectbench.lab.evaluate.surface import ReferenceSurface
from kinectbench.lab.simulate.render import LIFT_M
from kinectbench.lab.simulate.truth import SurfaceTruth, Truth

# One sample for each 4 mm x 4 mm, less than a voxel; on a large couch one for each 5 mm x 5 mm.
SPACING_M, MAX_SAMPLES = 0.004, 250_000
SEED = 0
# Surface that every camera sees at more than 80 degrees of incidence gives hardly any depth, and noisy depth.
LEAST_COSINE = np.cos(np.radians(80.0))
# Depth is that of a sample if it is this near to it: 10 mm, and three standard deviations of a Kinect v1 (14
# mm at 3 m by Nguyen et al. 2012) with its distortion (0.4 %) beyond that.
AGREES_M, AGREES_SHARE = 0.010, 0.015
# Frames are tested in an order whose first few are spread all around, so that most samples are settled early.
GOLDEN = (np.sqrt(5.0) - 1) / 2
# Limits of a normal's z in the floor frame: upper faces, undersides (negative), and upright sides.
LEAST_UP, MOST_SIDEWAYS = 0.7, 0.5
# Near an edge the nearest surface may belong to the other face. Surface that is farther off is missing or
# excess, not a bias.
EDGE_M, EDGE_RAD, REACH_M = 0.015, np.radians(30.0), 0.015
# Fewer samples give no mean: they are 8 cm^2, and on one object a single sample decided.
LEAST_SAMPLES = 50


@dataclass(frozen=True)
class MeasuredSurface:
    """Samples spread evenly over the true surface, with a mask of those that were measured.

    Attributes:
        points_world: (m, 3), metres, truth's world.
        normals_world: (m, 3), unit, outward.
        measured: (m,) bool, at least one frame measured the sample's depth.
    """

    points_world: Float64
    normals_world: Float64
    measured: Bools

    @property
    def surface(self) -> SurfaceTruth:
        """The samples as a `SurfaceTruth` in which exactly the measured samples are marked as seen."""
        return SurfaceTruth(self.points_world, self.normals_world, self.measured.astype(np.uint16))


def measured_surface(build: Build, truth: Truth, registration: BuildRegistration) -> MeasuredSurface:
    """Sample the true surface evenly, and mark the samples that at least one recorded frame measured.

    A frame measured a sample if, from its true camera pose, the sample projects into the image, its angle of
    incidence is below 80 degrees, the object does not occlude it, and the recorded depth of its pixel agrees
    with the true depth to 10 mm + 1.5 %. So black, too distant or occluded surface is not measured. All
    frames of the scene count, with or without a pose in the build.

    Raises:
        StorageError: a frame's depth is missing or damaged.
    """
    mesh = truth.mesh_world
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    area_m2 = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
    count = min(int(np.ceil(area_m2 / SPACING_M**2)), MAX_SAMPLES)
    points, normals = sample_surface(mesh.vertices, mesh.faces, count, np.random.default_rng(SEED))
    obstacle = ReferenceSurface(mesh)
    measured = np.zeros(count, dtype=np.bool_)
    for frame in _spread(np.flatnonzero(registration.shown)):
        T_world_camera = truth.T_world_camera[registration.true_frame[frame]]
        left = np.flatnonzero(~measured)
        known = returned(points[left], normals[left], build.camera, T_world_camera, build.depth_m(int(frame)))
        some = left[known]
        some = some[~obstacle.hides(points[some] + LIFT_M * normals[some], T_world_camera[:3, 3])]
        measured[some] = True
    return MeasuredSurface(points, normals, measured)


def _spread(frames: Int64) -> Int64:
    """Reorder frames (n,) so that the first k, for any k, are spread evenly over the recording."""
    return frames[np.argsort((np.arange(len(frames)) * GOLDEN) % 1)]


def returned(
    points_world: Float64, normals_world: Float64, camera: Camera, T_world_camera: Float64, depth_m: Float32
) -> Bools:
    """Return whether a frame's depth image measured each of the points, ignoring occlusion: (n,) bool.

    Args:
        points_world: (n, 3), metres.
        normals_world: (n, 3), unit, outward.
        camera: intrinsics of the depth image.
        T_world_camera: (4, 4), pose of the depth camera.
        depth_m: (height, width), the frame's depth, metres, 0 = none.
    """
    towards = T_world_camera[:3, 3] - points_world
    cosine = np.einsum("ij,ij->i", towards, normals_world)
    faced = np.flatnonzero(cosine > LEAST_COSINE * np.linalg.norm(towards, axis=1))
    points_camera = transform_points(invert_rigid(T_world_camera), points_world[faced])
    ahead = points_camera[:, 2] > 0
    u, v = np.rint(camera.project(np.where(ahead[:, None], points_camera, 1.0))).astype(np.int64).T
    inside = ahead & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    found_m = depth_m[np.where(inside, v, 0), np.where(inside, u, 0)]
    off_m = np.abs(found_m - points_camera[:, 2])
    agrees = inside & (found_m > 0) & (off_m < AGREES_M + AGREES_SHARE * points_camera[:, 2])
    result = np.zeros(len(points_world), dtype=np.bool_)
    result[faced[agrees]] = True
    return result


@dataclass(frozen=True)
class FaceBias:
    """Mean signed distance of the built surface from measured true surface, metres, by face direction.

    Positive means that the built surface is too far out. The samples are measured, away from sharp edges and
    within 15 mm of the built surface. A value of fewer than 50 samples (8 cm^2) is None.

    Attributes:
        up: on faces that look up: the normal's z in the object's frame is over 0.7.
        side: on upright faces: the normal's z is between -0.5 and 0.5.
        down: on undersides: the normal's z is below -0.7.
    """

    up: float | None
    side: float | None
    down: float | None


def face_bias(mesh_world: TriangleMesh, truth: Truth, surface: MeasuredSurface) -> FaceBias:
    """Return a built mesh's mean signed error at measured samples at least 15 mm away from sharp edges.

    Samples more than 15 mm from the built surface are ignored: there, surface is missing or excess, which
    other metrics measure.

    Args:
        mesh_world: the built closed mesh, truth's world.
        truth: the exact truth.
        surface: samples of the true surface.
    """
    chosen = on_faces(truth, surface)
    # If the built surface is too far out, the true surface lies inside it.
    outward_m = -ReferenceSurface(mesh_world).signed_distance_m(surface.points_world[chosen])
    near = np.abs(outward_m) <= REACH_M
    height = surface.normals_world[chosen] @ truth.T_world_object[:3, 2]

    def mean_m(some: Bools) -> float | None:
        return float(outward_m[near & some].mean()) if (near & some).sum() >= LEAST_SAMPLES else None

    return FaceBias(
        up=mean_m(height > LEAST_UP),
        side=mean_m(np.abs(height) <= MOST_SIDEWAYS),
        down=mean_m(height < -LEAST_UP),
    )


def on_faces(truth: Truth, surface: MeasuredSurface) -> Bools:
    """Mark the samples (m,) that were measured and lie at least 15 mm from sharp edges of the true mesh."""
    chosen = surface.measured.copy()
    edges = edge_points(truth.mesh_world)
    if len(edges):
        nearest_m, _ = cKDTree(edges).query(surface.points_world[chosen], distance_upper_bound=EDGE_M)
        chosen[np.flatnonzero(chosen)[np.isfinite(nearest_m)]] = False
    return chosen


def edge_points(mesh: TriangleMesh) -> NDArray[np.float64]:
    """Return points (n, 3), at most 4 mm apart, along edges where face normals differ by over 30 degrees."""
    shell = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    shell.merge_vertices()
    ends = shell.face_adjacency_edges[shell.face_adjacency_angles > EDGE_RAD]
    start, end = np.asarray(shell.vertices)[ends[:, 0]], np.asarray(shell.vertices)[ends[:, 1]]
    steps = np.ceil(np.linalg.norm(end - start, axis=1) / SPACING_M).astype(np.int64) + 1
    edge = np.repeat(np.arange(len(ends)), steps)
    share = (np.arange(len(edge)) - np.repeat(np.cumsum(steps) - steps, steps)) / np.maximum(
        steps[edge] - 1, 1
    )
    return np.asarray(start[edge] + share[:, None] * (end - start)[edge], dtype=np.float64)
