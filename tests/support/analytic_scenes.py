"""Exact depth of spheres, boxes and the floor, simulated furniture in memory, and sequences made of them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.trajectory import TrajectoryHealth
from kinectbench.core.geometry import Camera, Grid, TriangleMesh, rigid
from kinectbench.core.sequence import GivenTrajectory, Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.lab.simulate.path import look_at
from kinectbench.lab.simulate.simulate import Simulation, prepare, record_frame
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.lab.simulate.truth import floor_plane, mesh_occupancy

# 20 units a millimetre: depth is exact to 0.025 mm, up to 3.27 m.
SCALE = 20000.0
CAMERA = Camera(320, 240, 262.5, 262.5, 159.5, 119.5)

Float64 = NDArray[np.float64]
# Origin (3,) and directions (..., 3) to the ray parameter of the first hit, inf for none.
Surface = Callable[[Float64, Float64], Float64]


def sphere(center: tuple[float, float, float], radius_m: float) -> Surface:
    def hit(origin: Float64, rays: Float64) -> Float64:
        offset = origin - np.array(center)
        a, b, c = (rays * rays).sum(-1), rays @ offset, offset @ offset - radius_m**2
        root = b * b - a * c
        t = (-b - np.sqrt(np.maximum(root, 0))) / a
        return np.where((root >= 0) & (t > 0), t, np.inf)

    return hit


def plane(normal: tuple[float, float, float], offset_m: float) -> Surface:
    """Points p with normal . p = offset."""

    def hit(origin: Float64, rays: Float64) -> Float64:
        towards = rays @ np.array(normal)
        t = (offset_m - origin @ np.array(normal)) / np.where(towards == 0, 1e-300, towards)
        return np.where(t > 0, t, np.inf)

    return hit


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> Surface:
    def hit(origin: Float64, rays: Float64) -> Float64:
        # Axis by axis: sorting all crossings of all rays takes ten times as long.
        near, far = np.full(rays.shape[:-1], -np.inf), np.full(rays.shape[:-1], np.inf)
        for axis in range(3):
            along = rays[..., axis]
            safe = np.where(along == 0, 1e-300, along)
            ends = (low[axis] - origin[axis]) / safe, (high[axis] - origin[axis]) / safe
            np.maximum(near, np.minimum(*ends), out=near)
            np.minimum(far, np.maximum(*ends), out=far)
        return np.where((near <= far) & (near > 0), near, np.inf)

    return hit


def depth_of(surfaces: list[Surface], camera: Camera, T_world_camera: Float64) -> NDArray[np.float32]:
    """Exact depth through integer pixel centres: rays have z = 1, so the ray parameter is the depth."""
    rays = camera.rays() @ T_world_camera[:3, :3].T
    first = np.full(rays.shape[:-1], np.inf)
    for surface in surfaces:
        np.minimum(first, surface(T_world_camera[:3, 3], rays), out=first)
    return np.where(np.isfinite(first), first, 0).astype(np.float32)


@dataclass(frozen=True)
class MemoryFrames:
    """Frames without colour, made on demand by a function: index -> (height, width) uint16."""

    make_depth: Callable[[int], NDArray[np.uint16]]

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        return self.make_depth(index)

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        return None


def sequence_of(
    depths_m: list[NDArray[np.float32]], camera: Camera = CAMERA, given: Float64 | None = None
) -> Sequence:
    """A sequence without colour; with `given` (n, 4, 4) as its trajectory."""
    stamps_ns = np.arange(len(depths_m), dtype=np.int64) * 10**8
    native = [np.where(d * SCALE > 65535, 0, np.rint(d * SCALE)).astype(np.uint16) for d in depths_m]
    trajectory = None if given is None else GivenTrajectory(stamps_ns, given)
    return Sequence(camera, SCALE, stamps_ns, False, trajectory, MemoryFrames(lambda i: native[i]))


def trajectory_of(T_world_camera: Float64) -> Trajectory:
    stamps_ns = np.arange(len(T_world_camera), dtype=np.int64) * 10**8
    return Trajectory(stamps_ns, np.asarray(T_world_camera), "trust")


def health_of(frames: int, **changes: Any) -> TrajectoryHealth:
    """Health of poses that were found, of which nothing else is known but what is given."""
    plain = {"source": "tracked", "verdict": "not judged", "grade": "5 mm", "tracked": frames}
    return TrajectoryHealth(**{"frames": frames, **plain, **changes})


def scene_of(surfaces: list[Surface], poses: Float64, camera: Camera = CAMERA) -> tuple[Sequence, Trajectory]:
    return sequence_of([depth_of(surfaces, camera, T) for T in poses], camera, poses), trajectory_of(poses)


def ring(
    count: int,
    distance_m: float,
    target: tuple[float, float, float] = (0, 0, 0),
    elevations_rad: tuple[float, ...] = (0.4,),
) -> Float64:
    """Level cameras around a target, (n, 4, 4); elevations take turns."""
    poses = []
    for k in range(count):
        turn, rise = 2 * np.pi * k / count + 0.1, elevations_rad[k % len(elevations_rad)]
        outward = np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
        poses.append(look_at(np.array(target) + distance_m * outward, np.array(target)))
    return np.stack(poses)


def displaced(T_world_camera: Float64, shift_m: tuple[float, float, float], turn_deg: float) -> Float64:
    """A pose moved by a shift and a turn about the vertical image axis, both in the camera's frame."""
    turn = cv2.Rodrigues(np.array([0.0, np.radians(turn_deg), 0.0]))[0]
    return np.asarray(T_world_camera @ rigid(turn, shift_m))


@dataclass(frozen=True)
class FurnitureFrames:
    """Frames of a simulated recording in memory, colour as PNG."""

    depth: list[NDArray[np.uint16]]
    color: list[bytes]

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        return self.depth[index]

    def color_encoded(self, index: int) -> tuple[str, bytes]:
        return ".png", self.color[index]


@dataclass(frozen=True)
class Furniture:
    """A simulated recording in memory, and its truth."""

    simulation: Simulation
    sequence: Sequence
    masks: list[NDArray[np.bool_]]

    @property
    def T_world_object(self) -> Float64:
        return self.simulation.T_world_object

    @property
    def mesh_world(self) -> TriangleMesh:
        return self.simulation.subject.mesh.transformed(self.T_world_object)

    @property
    def floor_plane_world(self) -> Float64:
        return floor_plane(self.T_world_object)

    def occupancy(self, grid: Grid) -> NDArray[np.bool_]:
        return mesh_occupancy(self.mesh_world, grid)

    @property
    def trajectory(self) -> Trajectory:
        return Trajectory(self.sequence.stamps_ns, self.simulation.T_world_camera, "trust")


def small_spec(
    name: str, frames: int, *, seed: int = 0, arc_rad: float = 2.2 * np.pi, world: str = "upright"
) -> SimulationSpec:
    """A recording of 320x240 pixels at 5 Hz."""
    return SimulationSpec.model_validate(
        {
            "object": name,
            "seed": seed,
            "world": world,
            "path": {"frames": frames, "rate_hz": 5.0, "arc_rad": arc_rad},
            # The true poses are judged against this depth: no distortion that they could make up for.
            "sensor": {"width": 320, "height": 240, "distortion": 0.0},
        }
    )


def furniture(spec: SimulationSpec, frames: int | None = None, depth_scale: float = 5000.0) -> Furniture:
    """Simulate in memory; with `frames`, only the first ones of the orbit."""
    simulation = prepare(spec)
    simulation = replace(simulation, frames=simulation.frames[:frames])
    recorded = [record_frame(simulation, index) for index in range(len(simulation.frames))]
    depth = [each.frame.depth_native(depth_scale) for each in recorded]
    color = [cv2.imencode(".png", each.frame.color_rgb[..., ::-1])[1].tobytes() for each in recorded]
    stamps_ns = np.array([each.frame.stamp_ns for each in recorded], np.int64)
    given = GivenTrajectory(stamps_ns, simulation.T_world_camera)
    sequence = Sequence(spec.camera, depth_scale, stamps_ns, True, given, FurnitureFrames(depth, color))
    return Furniture(simulation, sequence, [each.mask for each in recorded])
