"""Fused simulated scans against their truth: the object's surface with true poses and with tracked ones."""

from collections.abc import Sequence as Rows
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from figures import Figure, at_least, at_most, stated
from numpy.typing import NDArray
from tracking_recordings import ingested, object_spec, sequence_in, simulated, true_poses

from kinectbench.core.geometry import TriangleMesh, invert_rigid, transform_points
from kinectbench.core.sequence import FrameStore, Sequence
from kinectbench.core.trajectory.compare import align_worlds
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float64
from kinectbench.lab.evaluate.surface import SurfaceFigures, surface_errors, surface_figures
from kinectbench.lab.simulate.truth import Truth, read_truth, truth_folder
from kinectbench.settings.models import LEAST_RANGE_M, FusionSettings, TrackingSettings
from kinectbench.stages.fuse import fuse
from kinectbench.stages.track import track

CUBE_M, VOXEL_M = 2.0, 0.005
# One range for both rivals: that of what is recorded from less than 2 m.
SETTINGS = FusionSettings(scene_voxel_size_m=VOXEL_M, max_depth_m=LEAST_RANGE_M)
# What is judged: the object's box and this much around it, but not the floor that it stands on.
MARGIN_M, FLOOR_M = 0.03, 0.015
TRUE_F, TRACKED_F, TRUE_MEAN_M = 0.98, 0.95, 0.001
# A Kinect gives no depth of what every camera looks at flatter than 80 degrees, as of a top's underside.
LEAST_COSINE = np.cos(np.radians(80.0))


@dataclass(frozen=True)
class InCube:
    """The frames of a sequence without what they measure outside of a cube: object scale.

    Attributes:
        whole: the sequence.
        T_world_camera: (n, 4, 4), true poses.
        middle_world: (3,), of the cube.
        size_m: of its edges.
    """

    whole: Sequence
    T_world_camera: Float64
    middle_world: Float64
    size_m: float = CUBE_M

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        points_camera = self.whole.camera.backproject(self.whole.depth_m(index))
        points_world = transform_points(self.T_world_camera[index], points_camera.reshape(-1, 3))
        outside = np.abs(points_world - self.middle_world).max(axis=1) > self.size_m / 2
        depth = self.whole.frames.depth_native(index).copy()
        depth.reshape(-1)[outside] = 0
        return depth

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        return self.whole.frames.color_encoded(index)


def at_object_scale(sequence: Sequence, truth: Truth) -> Sequence:
    """The sequence with what it measures in a 2 m cube around the object."""
    vertices = truth.mesh_world.vertices
    middle_world = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    frames: FrameStore = InCube(sequence, true_poses(sequence), middle_world)
    return replace(sequence, frames=frames)


def object_figures(fused_world: TriangleMesh, truth: Truth) -> SurfaceFigures:
    """A fused scene against the true object: above the floor, near the object, not at a slant only."""
    T_object_world = invert_rigid(truth.T_world_object)
    true = transform_points(T_object_world, truth.mesh_world.vertices)
    low, high = true.min(axis=0) - MARGIN_M, true.max(axis=0) + MARGIN_M
    low[2] = FLOOR_M

    def judged(points_world: Float64) -> NDArray[np.bool_]:
        points = transform_points(T_object_world, points_world)
        return np.asarray(np.all((points > low) & (points < high), axis=1))

    faces = judged(fused_world.vertices)[fused_world.faces].all(axis=1)
    errors = surface_errors(fused_world.keep_faces(faces), truth)
    kept = judged(truth.surface.points_world) & _faced(truth)
    return surface_figures(
        replace(errors, true_m=errors.true_m[kept], true_visible=errors.true_visible[kept])
    )


def _faced(truth: Truth) -> NDArray[np.bool_]:
    """Which points of the true surface some camera faces by less than 80 degrees, hidden or not."""
    faced = np.zeros(len(truth.surface.points_world), dtype=bool)
    for center_world in truth.T_world_camera[:, :3, 3]:
        towards = center_world - truth.surface.points_world
        along = (towards * truth.surface.normals_world).sum(axis=1)
        faced |= along >= LEAST_COSINE * np.linalg.norm(towards, axis=1)
    return faced


def trajectories(sequence: Sequence, truth: Truth) -> tuple[Trajectory, Trajectory]:
    """The true one, given to the tracker to be trusted; and the tracker's own laid onto it as for ATE."""
    true = track(sequence, "trust", TrackingSettings())
    tracked = track(sequence, "ignore", TrackingSettings())
    both = np.intersect1d(true.good_frames, tracked.good_frames)
    T_true_tracked = align_worlds(tracked.T_world_camera[both], true.T_world_camera[both])
    return true, replace(tracked, T_world_camera=T_true_tracked @ tracked.T_world_camera)


def scan_figures(objects: Rows[tuple[str, int]], cache: Path) -> list[Figure]:
    """Fuse each object's scan twice and hold the worst ones against the bars."""
    rows: dict[str, list[SurfaceFigures]] = {"true": [], "tracked": []}
    lines = []
    for family, seed in objects:
        recording = simulated(object_spec(family, seed, "orbit-v1"), cache / f"{family}{seed}")
        truth = read_truth(truth_folder(recording))
        with ingested(recording) as folder:
            sequence = sequence_in(folder)
            for name, trajectory in zip(rows, trajectories(sequence, truth), strict=True):
                calibrated = sequence.calibrated(trajectory.depth_calibration)
                mesh = fuse(at_object_scale(calibrated, truth), trajectory, SETTINGS).mesh
                found = object_figures(mesh, truth)
                rows[name].append(found)
                lines.append(f"{family}{seed}, {name} poses: {_line(found)}")
    true, tracked = rows["true"], rows["tracked"]
    return [
        stated("scans, 2 m cube at 5 mm", lines),
        at_least("true poses: F at 5 mm, least", min(map(_f, true)), TRUE_F),
        at_most("true poses: mean error, greatest, mm", 1000 * max(map(_mean_m, true)), 1000 * TRUE_MEAN_M),
        at_least("tracked: F at 5 mm, least", min(map(_f, tracked)), TRACKED_F),
    ]


def _f(found: SurfaceFigures) -> float:
    return found.visible.scores[0].f


def _mean_m(found: SurfaceFigures) -> float:
    assert found.visible.accuracy
    return found.visible.accuracy.mean_m


def _line(found: SurfaceFigures) -> str:
    score = found.visible.scores[0]
    return (
        f"F {score.f:.3f} (precision {score.precision:.3f}, recall {score.recall:.3f}), "
        f"mean {1000 * _mean_m(found):.2f} mm, outward {1000 * found.mean_signed_m:+.2f} mm"
    )
