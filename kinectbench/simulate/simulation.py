"""A scene, a camera's way through it, and what the sensor records there, frame by frame."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import (
    OrientedBox,
    invert_rigid,
    rigid,
    rotation_from_quaternion_xyzw,
)
from kinectbench.simulate.color import expose, exposure_gains
from kinectbench.simulate.kinect import Device, draw_device, measure
from kinectbench.simulate.objects.furniture import make_object, parse_object
from kinectbench.simulate.objects.subject import Subject
from kinectbench.simulate.path import CameraPath, draw_path
from kinectbench.simulate.plan import PlannedFrame, plan_frames
from kinectbench.simulate.render import Renderer
from kinectbench.simulate.scene import Scene, make_scene
from kinectbench.simulate.shading import Rendering
from kinectbench.simulate.spec import DEVICE, PATH, SCENE, SENSOR, WORLD, SimulationSpec
from kinectbench.simulate.texture import make_texture
from kinectbench.simulate.writers.frame import RecordedFrame, Rig

Float = NDArray[np.float64]

# A foreign frame shows another object in another scene: seeds this much farther on.
FOREIGN_SEED = 500_000
SUNLIGHT = {"indoor": 0.0, "outdoor": 0.6}


@dataclass(frozen=True)
class Simulation:
    """Everything about a recording before its frames are rendered.

    Attributes:
        spec: what was asked for.
        subject: the object.
        scene: what a ray can hit, frame `room`.
        renderer: of the scene.
        foreign: renderer of another scene, if the plan has frames of one.
        path: the camera's motion, frame `room`.
        device: this one sensor's own errors, or None for an ideal one.
        gains: of colour, one per frame.
        rig: the cameras that record.
        T_world_room: (4, 4) float64.
        T_room_object: (4, 4) float64.
        frames: what is recorded.
    """

    spec: SimulationSpec
    subject: Subject
    scene: Scene
    renderer: Renderer
    foreign: Renderer | None
    path: CameraPath
    device: Device | None
    gains: Float
    rig: Rig
    T_world_room: Float
    T_room_object: Float
    frames: tuple[PlannedFrame, ...]

    @property
    def T_world_object(self) -> Float:
        """(4, 4) float64: where the object stands."""
        return np.asarray(self.T_world_room @ self.T_room_object)

    @property
    def T_world_camera(self) -> Float:
        """(n, 4, 4) float64: the true pose of every recorded frame, wherever it looks."""
        times = np.array([frame.time_s for frame in self.frames])
        return np.asarray(self.T_world_room @ self.path.poses(times))


@dataclass(frozen=True)
class Recorded:
    """One frame of the recording, and the truth about it.

    Attributes:
        frame: what the sensor delivers.
        depth_m: (height, width) float32, noise-free, metres, 0 where no surface is hit.
        mask: (height, width) bool, the subject's silhouette.
    """

    frame: RecordedFrame
    depth_m: NDArray[np.float32]
    mask: NDArray[np.bool_]


def make_subject(spec: SimulationSpec) -> Subject:
    """The object of a spec: drawn by its family and seed, or read from a mesh file.

    Raises:
        SettingsError: there is no such family.
        RecordingError: the mesh cannot be used.
    """
    if spec.mesh is None:
        return make_object(*parse_object(spec.object))
    from kinectbench.simulate.objects.mesh_object import load_mesh_object

    return load_mesh_object(Path(spec.mesh), spec.mesh_up)


def prepare(spec: SimulationSpec) -> Simulation:
    """Draw the object, its surroundings, the camera's path, the sensor, and the plan of the recording.

    Raises:
        SettingsError, RecordingError: as `make_subject`.
    """
    subject = make_subject(spec)
    path = draw_path(spec.path, subject.mesh, spec.camera, spec.rng(PATH))
    rng = spec.rng(SCENE)
    yaw_rad = float(rng.uniform(0, 2 * np.pi))
    reach_m = path.distance_m * 1.1
    scene = make_scene(subject, yaw_rad, reach_m, spec.scene, rng)
    texture = make_texture(rng)
    walk_s = np.arange(spec.path.frames) / spec.path.rate_hz
    walk = path.poses(walk_s)
    T_world_room = _world(spec, walk[0])
    frames = plan_frames(spec, T_world_room @ walk)
    frames_s = np.array([frame.time_s for frame in frames])
    return Simulation(
        spec=spec,
        subject=subject,
        scene=scene,
        renderer=Renderer(scene, texture),
        foreign=_foreign(spec, reach_m) if spec.faults.foreign_frames else None,
        path=path,
        device=_device(spec),
        gains=exposure_gains(frames_s, spec.sensor.exposure_drift, spec.rng(DEVICE, 1)),
        rig=_rig(spec),
        T_world_room=T_world_room,
        T_room_object=OrientedBox((0, 0, 0), (1, 1, 1), yaw_rad).T_floor_box,
        frames=frames,
    )


def record(simulation: Simulation, index: int) -> Recorded:
    """Render one frame of the recording, and measure it.

    Args:
        simulation: made by `prepare`.
        index: position in `simulation.frames`.
    """
    spec, plan = simulation.spec, simulation.frames[index]
    renderer = simulation.foreign if plan.foreign and simulation.foreign else simulation.renderer
    T_room_camera = simulation.path.poses(np.array([plan.time_s]))[0]
    exact = renderer.render(spec.camera, T_room_camera)
    rng = spec.rng(SENSOR, plan.source)
    depth_m = exact.depth_m
    if simulation.device is not None:
        depth_m = measure(exact, spec.camera, simulation.device, rng)
    color_rgb = _color(simulation, renderer, exact, index, rng)
    frame = RecordedFrame(
        stamp_ns=plan.stamp_ns,
        depth_m=depth_m * np.float32(spec.faults.scale_error),
        color_stamp_ns=plan.color_stamp_ns,
        color_rgb=color_rgb,
        T_world_camera=plan.T_world_given,
        pose_stamp_ns=spec.stamp_ns(plan.source),
    )
    mask = np.zeros_like(exact.mask) if plan.foreign else exact.mask
    return Recorded(frame, exact.depth_m, mask)


def _color(
    simulation: Simulation, renderer: Renderer, exact: Rendering, index: int, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """The colour image of one frame; it is cast anew only if another camera takes it, or at another time."""
    sensor = simulation.spec.sensor
    middle_s = simulation.frames[index].time_s + sensor.color_delay_s
    times_s = middle_s + np.array([-0.5, 0.0, 0.5]) * sensor.exposure_s
    T_depth_color = invert_rigid(simulation.rig.T_color_depth)
    start, middle, end = simulation.path.poses(times_s) @ T_depth_color
    if not sensor.color_registered or sensor.color_delay_s:
        exact = renderer.render(simulation.rig.color, middle)
    if simulation.device is None:
        return exact.color_rgb
    return expose(exact, simulation.rig.color, (start, middle, end), float(simulation.gains[index]), rng)


def _device(spec: SimulationSpec) -> Device | None:
    """The sensor, and the light it works in."""
    if spec.sensor.model == "ideal":
        return None
    sunlight = spec.sensor.sunlight
    if sunlight is None:
        sunlight = SUNLIGHT[spec.scene.place]
    return draw_device(spec.camera, spec.sensor.distortion, sunlight, spec.rng(DEVICE))


def _rig(spec: SimulationSpec) -> Rig:
    """The cameras: colour registered to depth, or beside it."""
    if spec.sensor.color_registered:
        return Rig(spec.camera, spec.camera, True, np.eye(4))
    return Rig(spec.camera, spec.camera, False, rigid(np.eye(3), [-spec.sensor.color_baseline_m, 0.0, 0.0]))


def _foreign(spec: SimulationSpec, reach_m: float) -> Renderer:
    """Another object in other surroundings."""
    subject = make_object("table" if spec.object.startswith("chair") else "chair", spec.seed)
    rng = spec.model_copy(update={"seed": spec.seed + FOREIGN_SEED}).rng(SCENE)
    return Renderer(make_scene(subject, 0.0, reach_m, spec.scene, rng), make_texture(rng))


def _world(spec: SimulationSpec, T_room_first: Float) -> Float:
    """The room in the world, (4, 4)."""
    if spec.world == "first_camera":
        return invert_rigid(T_room_first)
    if spec.world == "random":
        rng = spec.rng(WORLD)
        return rigid(rotation_from_quaternion_xyzw(rng.standard_normal(4)), rng.uniform(-2, 2, 3))
    return np.eye(4)
