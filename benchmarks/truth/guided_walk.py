"""A walker in the simulator who does what the guide says, against a plain orbit of the same length.

Both recordings are fused with true poses, so that what is unknown of the truth is left by the walk alone.
"""

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from figures import Figure, at_least, at_most, stated
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from kinectbench.core.geometry import transform_points
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float64
from kinectbench.lab.simulate.path import CameraPath, look_at
from kinectbench.lab.simulate.simulate import Simulation, prepare, record_frame
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.record.guide.guide import Guide
from kinectbench.record.guide.sentences import STAYS_S, Advice
from kinectbench.record.interface import Frame, Setup
from kinectbench.settings.models import FusionSettings, ObjectCuts
from kinectbench.stages.fuse import fuse
from kinectbench.stages.segment.segment import segment

FRAMES, RATE_HZ, SCALE = 300, 5.0, 5000.0
# How fast a person follows: 40 cm a second at 1.5 m, and half of it up and down, or to and fro.
TURN_RAD_PER_S, RISE_RAD_PER_S, STEP_MPS = np.radians(15.0), np.radians(15.0), 0.3
# How high a person holds a camera, and how low.
HIGHEST_RAD, LOWEST_M = np.radians(70.0), 0.25
NEAREST_M, SHARE = 0.25, 0.5
# Less is left unknown by chance: a voxel's layer of a bottle is as much.
LITTLE = 0.01
# Coarser than a build's: what nobody saw is large.
FUSION = FusionSettings(voxel_size_m=0.01, scene_voxel_size_m=0.015)


class Walk:
    """A path that is made while it is walked; it has the interface of `CameraPath`, a frame at a time."""

    def __init__(self, orbit: CameraPath) -> None:
        """It begins where the orbit does."""
        first = orbit.poses(np.zeros(1))[0, :3, 3] - orbit.target_room
        self.orbit, self.poses_room = orbit, list[Float64]()
        self.turn = float(np.arctan2(first[1], first[0]))
        self.distance_m = float(np.linalg.norm(first))
        self.rise = float(np.arcsin(first[2] / self.distance_m))
        self.back = 0
        self.advice: Advice | None = None
        self.turn_left = self.rise_left = np.inf

    def poses(self, time_s: Float64) -> Float64:
        """The pose of the frame that is walked now, for all times."""
        return np.repeat(self.poses_room[-1][None], len(time_s), axis=0)

    def step(self, advice: Advice) -> None:
        """Do for one frame what a sentence says; the camera looks at the object, and shakes."""
        kind, by_s = advice.kind, 1 / RATE_HZ
        self.back = self.back + 2 if kind == "lost" else 0
        if self.back:
            self.poses_room.append(self.poses_room[max(len(self.poses_room) - self.back, 0)])
            return
        if advice is not self.advice:
            self.advice = advice
            self.turn_left = np.inf if advice.turn_rad is None else advice.turn_rad
            self.rise_left = np.inf if advice.rise_rad is None else advice.rise_rad
        turn, rise = min(TURN_RAD_PER_S * by_s, self.turn_left), min(RISE_RAD_PER_S * by_s, self.rise_left)
        self.turn += turn * {"right": 1, "begin": 1, "left": -1}.get(kind, 0)
        self.rise += rise * {"higher": 1, "top": 1, "lower": -1}.get(kind, 0)
        self.turn_left, self.rise_left = self.turn_left - turn, self.rise_left - rise
        if advice.distance_m is not None:
            most_m = STEP_MPS * by_s
            self.distance_m += float(np.clip(advice.distance_m - self.distance_m, -most_m, most_m))
        target = self.orbit.target_room
        lowest = np.arcsin(np.clip((LOWEST_M - target[2]) / self.distance_m, -1, 1))
        self.rise = float(np.clip(self.rise, lowest, HIGHEST_RAD))
        flat = np.cos(self.rise)
        way = np.array([flat * np.cos(self.turn), flat * np.sin(self.turn), np.sin(self.rise)])
        shake = self.orbit.shake.at(np.array([len(self.poses_room) * by_s]))[0, :3]
        position = target + self.distance_m * way + self.orbit.settings.shake_m * shake
        self.poses_room.append(look_at(position, target))


@dataclass(frozen=True)
class Walked:
    """What one walk left: depth in units of 0.2 mm, poses in the world, and what was said, frame by frame."""

    depths: list[NDArray[np.uint16]]
    T_world_camera: Float64
    said: list[str]


def spec_of(family: str, seed: int) -> SimulationSpec:
    """A small recording; the plain orbit is at one height, but for the hand."""
    path = {"frames": FRAMES, "rate_hz": RATE_HZ, "swing_rad": 0.05}
    sensor = {"width": 320, "height": 240}
    given: dict[str, Any] = {"object": f"{family}:seed={seed}", "seed": seed, "path": path, "sensor": sensor}
    return SimulationSpec.model_validate(given)


def walked(simulation: Simulation, guided: bool) -> Walked:
    """Walk as the guide says, or the orbit."""
    walk = Walk(simulation.path)
    if guided:
        simulation = replace(simulation, path=walk)  # type: ignore[arg-type]
    guide = Guide(Setup(simulation.spec.camera, SCALE, True), beside=False)
    depths, poses, said = list[NDArray[np.uint16]](), list[Float64](), list[str]()
    advice = Advice("begin", "")
    for index in range(FRAMES):
        if guided:
            walk.step(advice)
        frame = record_frame(simulation, index).frame
        depth = np.rint(frame.depth_m * SCALE).astype(np.uint16)
        room = simulation.path.poses(np.array([simulation.frames[index].time_s]))[0]
        depths.append(depth)
        poses.append(simulation.T_world_room @ room)
        if guided:
            advice = guide.take(index, Frame(frame.stamp_ns, depth, frame.color_rgb)).advice
            said.append(advice.sentence)
    guide.close()
    return Walked(depths, np.array(poses), said)


class _Depths:
    def __init__(self, depths: list[NDArray[np.uint16]]) -> None:
        self.depths = depths

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        return self.depths[index]

    def color_encoded(self, index: int) -> None:
        return None


def unknown_share(simulation: Simulation, found: Walked) -> float:
    """The unknown volume, taken for inside or for air, as a share of the solid's."""
    stamps_ns = np.arange(FRAMES) * int(1e9 / RATE_HZ)
    store = _Depths(found.depths)
    sequence = Sequence(simulation.spec.camera, SCALE, stamps_ns, False, None, store)
    trajectory = Trajectory(stamps_ns, found.T_world_camera, "trust")
    scene = fuse(sequence, trajectory, FUSION).mesh
    model = segment(sequence, trajectory, scene, ObjectCuts(), FUSION)
    return float(model.quality.unknown_share or 0) + float(model.quality.unknown_air_share or 0)


def changes_apart_s(said: list[str]) -> float:
    """The least time between two changes of the sentence, seconds."""
    changed = [index for index in range(1, len(said)) if said[index] != said[index - 1]]
    return float(np.diff(changed).min() / RATE_HZ) if len(changed) > 1 else np.inf


def guided_figures(family: str, seed: int) -> list[Figure]:
    """Both walks around one object."""
    simulation = prepare(spec_of(family, seed))
    guided, plain = walked(simulation, True), walked(simulation, False)
    shares = [unknown_share(simulation, each) for each in (guided, plain)]
    vertices = transform_points(simulation.T_world_object, simulation.subject.mesh.vertices)
    nearest_m = float(cKDTree(vertices).query(guided.T_world_camera[:, :3, 3])[0].min())
    name = f"{family}:{seed}"
    return [
        stated(f"{name}: unknown share, guided and orbit", [round(share, 4) for share in shares]),
        at_most(f"{name}: unknown share, guided", shares[0], max(SHARE * shares[1], LITTLE)),
        at_least(f"{name}: camera from the object, m", nearest_m, NEAREST_M),
        at_least(f"{name}: seconds between changes", changes_apart_s(guided.said), STAYS_S),
        stated(f"{name}: sentences, frames", dict(Counter(guided.said).most_common(6))),
    ]
