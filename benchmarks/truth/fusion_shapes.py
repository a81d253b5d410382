"""Exact depth of a sphere, a plane and a box, and how far from them the fused surface lies."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from analytic_scenes import MemoryFrames
from figures import Figure, at_most, stated

from kinectbench.core.geometry import Camera
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float64
from kinectbench.lab.simulate.path import look_at
from kinectbench.settings.models import FusionSettings
from kinectbench.stages.fuse import fuse

CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
# 20 units a millimetre: depth is exact to 0.025 mm.
SCALE = 20000.0
FRAMES, DISTANCE_M = 24, 0.9
SETTINGS = FusionSettings(scene_voxel_size_m=0.005)
STD_MM, BIAS_MM = 0.6, 0.2
RADIUS_M, HALF_M, OFFSET_M = 0.2, np.array([0.2, 0.15, 0.1]), 0.0123
# Of a box, what lies at least so far from its edges.
INNER_M = 0.02


@dataclass(frozen=True)
class Shape:
    """A surface: where rays meet it, and how far points lie outside of it.

    Attributes:
        hit: origin (3,) and directions (..., 3) to the ray parameter, inf for none.
        error_m: fused points (n, 3) to signed distances of those that are judged.
        elevations_rad: of the cameras, in turns.
    """

    hit: Callable[[Float64, Float64], Float64]
    error_m: Callable[[Float64], Float64]
    elevations_rad: tuple[float, ...]


def _hit_sphere(origin: Float64, rays: Float64) -> Float64:
    a, b, c = (rays * rays).sum(-1), rays @ origin, origin @ origin - RADIUS_M**2
    root = b * b - a * c
    return np.where(root >= 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)


def _hit_plane(origin: Float64, rays: Float64) -> Float64:
    with np.errstate(divide="ignore"):
        t = (OFFSET_M - origin[2]) / rays[..., 2]
    return np.where(t > 0, t, np.inf)


def _hit_box(origin: Float64, rays: Float64) -> Float64:
    safe = np.where(rays == 0, 1e-300, rays)
    t = np.sort(np.stack([(-HALF_M - origin) / safe, (HALF_M - origin) / safe]), axis=0)
    near, far = t[0].max(-1), t[1].min(-1)
    return np.where((near <= far) & (near > 0), near, np.inf)


def _box_error_m(points: Float64) -> Float64:
    beyond = np.abs(points) - HALF_M
    face = np.argmax(beyond, axis=1)
    others = np.sort(beyond, axis=1)[:, 1]
    return beyond[np.arange(len(points)), face][others < -INNER_M]


SHAPES = {
    "sphere": Shape(_hit_sphere, lambda p: np.linalg.norm(p, axis=1) - RADIUS_M, (0.3, -0.5, 0.9, -1.1)),
    "plane": Shape(_hit_plane, lambda p: p[:, 2] - OFFSET_M, (0.9, 1.2)),
    "box": Shape(_hit_box, _box_error_m, (0.7, -0.7)),
}


def cameras(elevations_rad: tuple[float, ...]) -> Float64:
    """Level cameras on a ring about the origin, (n, 4, 4); the elevations take turns."""
    poses = []
    for k in range(FRAMES):
        turn, rise = 2 * np.pi * k / FRAMES + 0.1, elevations_rad[k % len(elevations_rad)]
        outward = np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
        poses.append(look_at(DISTANCE_M * outward, np.zeros(3)))
    return np.stack(poses)


def recorded(shape: Shape) -> tuple[Sequence, Trajectory]:
    """The shape seen from a ring of cameras, through integer pixel centres."""
    T_world_camera = cameras(shape.elevations_rad)
    depths = []
    for T in T_world_camera:
        depth_m = shape.hit(T[:3, 3], CAMERA.rays() @ T[:3, :3].T)
        depths.append(np.where(depth_m < 3, np.rint(depth_m * SCALE), 0).astype(np.uint16))
    stamps_ns = np.arange(FRAMES, dtype=np.int64) * 10**8
    frames = MemoryFrames(lambda index: depths[index])
    return Sequence(CAMERA, SCALE, stamps_ns, False, None, frames), Trajectory(
        stamps_ns, T_world_camera, "trust"
    )


def shape_figures() -> list[Figure]:
    """Fuse each shape at 5 mm and hold its surface against the formula."""
    figures = []
    for name, shape in SHAPES.items():
        error_mm = 1000 * shape.error_m(fuse(*recorded(shape), SETTINGS).mesh.vertices)
        figures.append(stated(f"{name}: points judged", len(error_mm)))
        figures.append(at_most(f"{name}: standard deviation, mm", float(error_mm.std()), STD_MM))
        figures.append(at_most(f"{name}: |bias|, mm", abs(float(error_mm.mean())), BIAS_MM))
    return figures
