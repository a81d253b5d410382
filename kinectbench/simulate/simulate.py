"""Simulate a recording: an orbit around a piece of furniture, with the exact truth beside it."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from kinectbench.errors import SettingsError
from kinectbench.geometry import (
    Camera,
    OrientedBox,
    invert_rigid,
    rigid,
    rotation_from_quaternion_xyzw,
)
from kinectbench.simulate.furniture import check_family, make_object
from kinectbench.simulate.kinect import KinectNoise, kinect_depth
from kinectbench.simulate.orbit import orbit_around, orbit_poses
from kinectbench.simulate.render import Renderer
from kinectbench.simulate.scene import make_scene
from kinectbench.simulate.texture import make_texture
from kinectbench.simulate.truth import ObjectTruth, truth_folder, write_object_truth
from kinectbench.simulate.writers import WRITERS, RecordedFrame
from kinectbench.simulate.writers.frame import png_bytes
from kinectbench.simulate.writers.tum import camera_json, tum_line
from kinectbench.workspace import replaced_file, replaced_folder

Format = Literal["tum", "bag"]
WorldFrame = Literal["upright", "first_camera", "random"]
Progress = Callable[[int, int], None]

FIRST_STAMP_NS = 1_400_000_000 * 10**9
COLOR_SIGMA = 1.5
# One random stream for each thing that is drawn, so that a new one changes none of the others.
SCENE, ORBIT, WORLD, SENSOR = range(4)


@dataclass(frozen=True)
class SimulationSpec:
    """What to simulate. Same spec, same bytes.

    Attributes:
        family: of furniture.
        seed: draws the object and everything else.
        frames: number of frames.
        width: of the images, pixels.
        height: of the images, pixels.
        arc_rad: angle walked around the object, radians.
        rate_hz: frames per second.
        format: "tum" (folder) or "bag" (ROS 1).
        noise: Kinect v1 noise and drop-outs on depth, slight noise on colour; without it both are exact.
        world: "upright" (z up, floor at z = 0, object at the origin), "first_camera" (world = the first
            camera's frame) or "random" (any rigid offset).
        save_depth: write noise-free depth (mm) beside the truth.

    Raises:
        SettingsError: a value is out of range.
    """

    family: str
    seed: int = 0
    frames: int = 72
    width: int = 320
    height: int = 240
    arc_rad: float = 2.2 * np.pi
    rate_hz: float = 5.0
    format: Format = "tum"
    noise: bool = True
    world: WorldFrame = "upright"
    save_depth: bool = False

    def __post_init__(self) -> None:
        check_family(self.family)
        ranges = {
            "seed": (0, 10**9),
            "frames": (2, 100_000),
            "width": (16, 4096),
            "height": (16, 4096),
            "arc_rad": (0.01, 100.0),
            "rate_hz": (0.1, 1000.0),
        }
        for name, (low, high) in ranges.items():
            if not low <= getattr(self, name) <= high:
                raise SettingsError(f"simulation: {name} is {getattr(self, name)}; choose {low} to {high}")
        for name, known in (("format", get_args(Format)), ("world", get_args(WorldFrame))):
            if getattr(self, name) not in known:
                raise SettingsError(
                    f"simulation: {name} is '{getattr(self, name)}'; choose one of {', '.join(known)}"
                )

    @property
    def camera(self) -> Camera:
        """A Kinect's camera (525 px at 640 pixels' width) scaled to this size, centred."""
        focal_px = 525.0 * self.width / 640
        return Camera(
            self.width, self.height, focal_px, focal_px, (self.width - 1) / 2, (self.height - 1) / 2
        )

    def rng(self, stream: int, index: int = 0) -> np.random.Generator:
        """The random numbers of one stream (and one frame)."""
        return np.random.default_rng([self.seed, stream, index])

    def stamp_ns(self, index: int) -> int:
        """Time of one frame in nanoseconds, whole microseconds."""
        return FIRST_STAMP_NS + round(index * 10**6 / self.rate_hz) * 1000


@dataclass(frozen=True)
class Simulation:
    """A scene, a camera path and the truth, before anything is rendered.

    Attributes:
        spec: what was asked for.
        renderer: of the scene, in frame `room`.
        T_world_room: (4, 4) float64.
        T_room_camera: (n, 4, 4) float64.
        truth: the object in the world.
    """

    spec: SimulationSpec
    renderer: Renderer
    T_world_room: NDArray[np.float64]
    T_room_camera: NDArray[np.float64]
    truth: ObjectTruth

    @property
    def T_world_camera(self) -> NDArray[np.float64]:
        """(n, 4, 4) float64: the true trajectory."""
        return np.asarray(self.T_world_room @ self.T_room_camera)


def prepare(spec: SimulationSpec) -> Simulation:
    """Draw the object, the room, the orbit and the world frame."""
    solid = make_object(spec.family, spec.seed)
    rng = spec.rng(SCENE)
    yaw_rad = float(rng.uniform(0, 2 * np.pi))
    renderer = Renderer(make_scene(solid, yaw_rad, rng), make_texture(rng))
    orbit = orbit_around(solid, spec.camera, spec.frames, spec.arc_rad)
    T_room_camera = orbit_poses(orbit, spec.rng(ORBIT))
    T_world_room = _world(spec, T_room_camera[0])
    T_room_object = OrientedBox((0, 0, 0), (1, 1, 1), yaw_rad).T_floor_box
    truth = ObjectTruth(solid, T_world_room @ T_room_object)
    return Simulation(spec, renderer, T_world_room, T_room_camera, truth)


def simulate(spec: SimulationSpec, out: Path, progress: Progress = lambda done, total: None) -> Path:
    """Write a simulated recording to `out` and its truth beside it; returns the folder of the truth.

    Truth: `trajectory.txt` (TUM text), `object.ply` (closed parts, world frame, metres), `floor.json`
    (plane_world), `masks/<frame>.png` (255 = subject, from noise-free silhouettes, in depth pixels),
    `truth.json`, and with `save_depth` `depth/<frame>.png` (noise-free, mm); `<frame>` is the frame's index
    in six digits.

    Args:
        spec: what to simulate.
        out: a folder (format "tum") or a bag's path (format "bag", ends in .bag).
        progress: told (frames done, frames in all).

    Raises:
        SettingsError: the path does not fit the format, or something else lies there.
        StorageError: it cannot be written.
    """
    _check_place(spec, out)
    simulation = prepare(spec)
    folder = truth_folder(out)
    writer = WRITERS[spec.format]
    with replaced_folder(folder) as truth:
        frames = _frames(simulation, truth, progress)
        if spec.format == "bag":
            with replaced_file(out) as path:
                writer(path, spec.camera, frames)
        else:
            with replaced_folder(out) as path:
                writer(path, spec.camera, frames)
        poses = zip(range(spec.frames), simulation.T_world_camera, strict=True)
        lines = [tum_line(spec.stamp_ns(i), T) for i, T in poses]
        (truth / "trajectory.txt").write_text("\n".join(lines) + "\n")
        description = {"spec": asdict(spec), "camera": camera_json(spec.camera)}
        write_object_truth(truth, simulation.truth, description)
    return folder


def _check_place(spec: SimulationSpec, out: Path) -> None:
    """Refuse a path that does not fit the format, or that holds anything but a simulated recording."""
    if not out.name or (out.suffix == ".bag") != (spec.format == "bag"):
        raise SettingsError(f"{out}: a bag's name must end in .bag, and no other recording's may")
    if out.exists() and not (truth_folder(out) / "truth.json").is_file():
        raise SettingsError(f"{out}: exists and is no simulated recording; choose another name or remove it")


def record(
    simulation: Simulation, index: int
) -> tuple[RecordedFrame, NDArray[np.float32], NDArray[np.bool_]]:
    """Render one frame: what the sensor delivers, noise-free depth in metres, the subject's silhouette."""
    spec = simulation.spec
    exact = simulation.renderer.render(spec.camera, simulation.T_room_camera[index])
    depth_m, color_rgb = exact.depth_m, exact.color_rgb
    if spec.noise:
        rng = spec.rng(SENSOR, index)
        depth_m = kinect_depth(exact.depth_m, exact.cos_incidence, KinectNoise(), rng)
        grain = rng.standard_normal(color_rgb.shape, dtype=np.float32) * COLOR_SIGMA
        color_rgb = np.clip(np.round(color_rgb + grain), 0, 255).astype(np.uint8)
    T_world_camera = simulation.T_world_room @ simulation.T_room_camera[index]
    frame = RecordedFrame(spec.stamp_ns(index), depth_m, color_rgb, T_world_camera)
    return frame, exact.depth_m, exact.mask


def _frames(simulation: Simulation, truth: Path, progress: Progress) -> Iterator[RecordedFrame]:
    """Render frame by frame; masks and noise-free depth go to the folder of the truth on the way."""
    spec = simulation.spec
    (truth / "masks").mkdir()
    if spec.save_depth:
        (truth / "depth").mkdir()
    for index in range(spec.frames):
        frame, depth_m, mask = record(simulation, index)
        (truth / "masks" / f"{index:06d}.png").write_bytes(png_bytes(mask.astype(np.uint8) * np.uint8(255)))
        if spec.save_depth:
            depth_mm = np.round(depth_m * 1000).astype(np.uint16)
            (truth / "depth" / f"{index:06d}.png").write_bytes(png_bytes(depth_mm))
        yield frame
        progress(index + 1, spec.frames)


def _world(spec: SimulationSpec, T_room_first: NDArray[np.float64]) -> NDArray[np.float64]:
    """The room in the world, (4, 4)."""
    if spec.world == "first_camera":
        return invert_rigid(T_room_first)
    if spec.world == "random":
        rng = spec.rng(WORLD)
        return rigid(rotation_from_quaternion_xyzw(rng.standard_normal(4)), rng.uniform(-2, 2, 3))
    return np.eye(4)
