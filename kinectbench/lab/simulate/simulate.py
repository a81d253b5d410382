"""Simulate a recording: draw scene, camera path and sensor; write the sensor's frames and the truth."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import SettingsError, replaced_file, replaced_folder, sha256_file
from kinectbench.core.geometry import OrientedBox, invert_rigid, rigid, rotation_from_quaternion_xyzw
from kinectbench.core.types import Float64, Progress, no_progress
from kinectbench.core.voxels.point_cells import sample_surface
from kinectbench.engine.locks import sweep
from kinectbench.lab.simulate.color import expose, exposure_gains
from kinectbench.lab.simulate.objects import make_object, parse_object
from kinectbench.lab.simulate.objects.mesh_object import load_mesh_object
from kinectbench.lab.simulate.objects.shapes import Subject
from kinectbench.lab.simulate.path import REACH_PEAK, CameraPath, draw_path
from kinectbench.lab.simulate.plan import PlannedFrame, plan_frames
from kinectbench.lab.simulate.render import (
    Renderer,
    Rendering,
    StillRenderer,
    make_texture,
    still_renderer,
    turning_only,
)
from kinectbench.lab.simulate.scene import make_scene
from kinectbench.lab.simulate.sensors import SensorUnit, draw_sensor, measured
from kinectbench.lab.simulate.spec import DEVICE, MIN_RANGE_M, PATH, SCENE, SENSOR, WORLD, SimulationSpec
from kinectbench.lab.simulate.truth import (
    DEPTH_SCALE,
    SurfaceTruth,
    Truth,
    added_files,
    is_truth,
    truth_folder,
    write_truth,
)
from kinectbench.lab.simulate.writers import cut, formats
from kinectbench.lab.simulate.writers.frame import ColorImage, RecordedFrame, Rig, png_bytes

# A foreign frame shows another object in another scene, drawn with the seed plus this.
FOREIGN_SEED = 500_000
SURFACE_SAMPLES = 20_000
# Random numbers of a separate colour stream come after those of all frames.
OWN_COLORS = 1_000_000


@dataclass(frozen=True)
class Simulation:
    """A drawn recording, ready to be rendered frame by frame.

    Attributes:
        spec: the settings of the simulation.
        subject: the object.
        renderer: renderer of the scene, frame `room`.
        foreign: renderer of another scene, which some frames show as a fault; None if no frame does.
        path: the camera's motion, frame `room`.
        device: the individual sensor's errors; None for an ideal sensor.
        gains: (n,) brightness gains of the colour images, one per frame.
        rig: the cameras that record.
        T_world_room: (4, 4) float64, room to world.
        T_room_object: (4, 4) float64, object to room.
        frames: the n frames to record.
    """

    spec: SimulationSpec
    subject: Subject
    renderer: Renderer | StillRenderer
    foreign: Renderer | None
    path: CameraPath
    device: SensorUnit | None
    gains: Float64
    rig: Rig
    T_world_room: Float64
    T_room_object: Float64
    frames: tuple[PlannedFrame, ...]

    @property
    def T_world_object(self) -> Float64:
        """The object's pose in the world, (4, 4) float64."""
        return np.asarray(self.T_world_room @ self.T_room_object)

    @property
    def T_world_camera(self) -> Float64:
        """True camera poses of all recorded frames, (n, 4, 4) float64, in a world where the object rests."""
        times = np.array([frame.time_s for frame in self.frames])
        return np.asarray(self.T_world_room @ self.path.poses(times))


@dataclass(frozen=True)
class SimulatedFrame:
    """One recorded frame and its true images.

    Attributes:
        frame: the sensor's output.
        depth_m: (height, width) float32, noise-free depth, metres, 0 where no surface is hit.
        mask: (height, width) bool, the subject's silhouette; empty if the frame shows another scene.
    """

    frame: RecordedFrame
    depth_m: NDArray[np.float32]
    mask: NDArray[np.bool_]


def _make_subject(spec: SimulationSpec) -> Subject:
    """Make the object of a spec: drawn by its family and seed, or read from a mesh file."""
    if spec.mesh is None:
        return make_object(*parse_object(spec.object))
    return load_mesh_object(Path(spec.mesh), spec.mesh_up)


def prepare(spec: SimulationSpec) -> Simulation:
    """Draw the object, its surroundings, the camera path and the sensor, and plan the recording.

    Raises:
        SettingsError: the family is unknown.
        RecordingError: the mesh cannot be used.
    """
    subject = _make_subject(spec)
    min_range_m = MIN_RANGE_M[spec.sensor.model]
    path = draw_path(turning_only(spec.path), subject.mesh, spec.camera, spec.rng(PATH), min_range_m)
    rng = spec.rng(SCENE)
    yaw_rad = float(rng.uniform(0, 2 * np.pi))
    reach_m = path.distance_m * max(1.1, 1 + REACH_PEAK * spec.path.reach_share)
    scene = make_scene(subject, yaw_rad, reach_m, spec.scene, rng)
    texture = make_texture(rng)
    walk_s = np.arange(spec.path.frames) / spec.path.rate_hz
    walk = path.poses(walk_s)
    T_world_room = _world(spec, walk[0])
    renderer: Renderer | StillRenderer
    if spec.path.moves == "camera":
        renderer, T_room_given = Renderer(scene, texture), walk
    else:
        # A given trajectory is that of the camera, which does not move.
        renderer = still_renderer(scene, texture, walk[0], spec.path)
        T_room_given = np.repeat(renderer.T_room_still[None], len(walk), axis=0)
    frames = plan_frames(spec, T_world_room @ T_room_given)
    frames_s = np.array([frame.time_s for frame in frames])
    return Simulation(
        spec=spec,
        subject=subject,
        renderer=renderer,
        foreign=_foreign(spec, reach_m) if spec.faults.foreign_frames else None,
        path=path,
        device=draw_sensor(spec),
        gains=exposure_gains(frames_s, spec.sensor.exposure_drift, spec.rng(DEVICE, 1)),
        rig=_rig(spec),
        T_world_room=T_world_room,
        T_room_object=OrientedBox((0, 0, 0), (1, 1, 1), yaw_rad).T_floor_box,
        frames=frames,
    )


def record_frame(simulation: Simulation, index: int) -> SimulatedFrame:
    """Render the frame at `index` of `simulation.frames`, and simulate the sensor's measurement of it."""
    spec, plan = simulation.spec, simulation.frames[index]
    renderer = simulation.foreign if plan.foreign and simulation.foreign else simulation.renderer
    exact = renderer.render(spec.camera, _poses_of_rows(simulation, spec.camera.height, plan.time_s))
    rng = spec.rng(SENSOR, plan.source)
    depth_m = exact.depth_m
    if simulation.device is not None:
        depth_m = measured(exact, simulation.device, spec, rng)
    middle_s = plan.time_s + spec.sensor.color_delay_s
    color_rgb = _color(simulation, renderer, exact, index, middle_s, rng)
    mask = np.zeros_like(exact.mask) if plan.foreign else exact.mask
    frame = RecordedFrame(
        stamp_ns=plan.stamp_ns,
        depth_m=depth_m * np.float32(spec.faults.scale_error),
        color_stamp_ns=plan.color_stamp_ns,
        color_rgb=color_rgb,
        T_world_camera=plan.T_world_given,
        pose_stamp_ns=spec.stamp_ns(plan.source),
        mask=mask if spec.given.masks else None,
        own_colors=_own_colors(simulation, renderer, exact, index),
    )
    return SimulatedFrame(frame, exact.depth_m, mask)


def _poses_of_rows(simulation: Simulation, height: int, time_s: float) -> Float64:
    """Return the depth camera's pose (4, 4) at a time; for a rolling shutter (height, 4, 4), one per row."""
    readout_s = simulation.spec.sensor.readout_s
    if readout_s == 0:
        return np.asarray(simulation.path.poses(np.array([time_s]))[0])
    return simulation.path.poses(time_s + readout_s * np.linspace(-0.5, 0.5, height))


def _color(
    simulation: Simulation,
    renderer: Renderer | StillRenderer,
    exact: Rendering,
    index: int,
    middle_s: float,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """Return the colour image of frame `index`, exposed around the time `middle_s`.

    `exact` is the depth camera's rendering. It is used again if colour is registered and taken with depth.
    """
    sensor = simulation.spec.sensor
    times_s = middle_s + np.array([-0.5, 0.0, 0.5]) * sensor.exposure_s
    T_depth_color = invert_rigid(simulation.rig.T_color_depth)
    start, middle, end = simulation.path.poses(times_s) @ T_depth_color
    if not sensor.color_registered or middle_s != simulation.frames[index].time_s:
        T_room_rows = _poses_of_rows(simulation, simulation.rig.color.height, float(times_s[1]))
        exact = renderer.render(simulation.rig.color, T_room_rows, T_depth_color)
    if simulation.device is None:
        return exact.color_rgb
    return expose(exact, simulation.rig.color, (start, middle, end), float(simulation.gains[index]), rng)


def _own_colors(
    simulation: Simulation, renderer: Renderer | StillRenderer, exact: Rendering, index: int
) -> tuple[ColorImage, ...] | None:
    """Return the images of a separate colour stream since depth frame `index` - 1; None if there is none."""
    spec, plans = simulation.spec, simulation.frames
    rate_hz, delay_s = spec.sensor.color_rate_hz, spec.sensor.color_delay_s
    if rate_hz is None:
        return None

    def taken_until(time_s: float) -> int:
        return max(int(np.floor((time_s - delay_s) * rate_hz)) + 1, 0)

    images = []
    for number in range(
        taken_until(plans[index - 1].time_s) if index else 0, taken_until(plans[index].time_s)
    ):
        time_s = number / rate_hz + delay_s
        rng = spec.rng(SENSOR, OWN_COLORS + number)
        stamp_ns = spec.stamp_ns(0) + round(time_s * 10**6) * 1000
        images.append(ColorImage(stamp_ns, _color(simulation, renderer, exact, index, time_s, rng)))
    return tuple(images)


def _rig(spec: SimulationSpec) -> Rig:
    """Return the camera rig: colour registered to depth, or a colour camera beside the depth camera."""
    if spec.sensor.color_registered:
        return Rig(spec.camera, spec.camera, True, np.eye(4))
    return Rig(spec.camera, spec.camera, False, rigid(np.eye(3), [-spec.sensor.color_baseline_m, 0.0, 0.0]))


def _foreign(spec: SimulationSpec, reach_m: float) -> Renderer:
    """Return a renderer of another object in other surroundings, for foreign frames."""
    subject = make_object("table" if spec.object.startswith("chair") else "chair", spec.seed)
    rng = spec.model_copy(update={"seed": spec.seed + FOREIGN_SEED}).rng(SCENE)
    return Renderer(make_scene(subject, 0.0, reach_m, spec.scene, rng), make_texture(rng))


def _world(spec: SimulationSpec, T_room_first: Float64) -> Float64:
    """Return T_world_room (4, 4): the identity, random, or so that the world is the first camera's frame."""
    if spec.world == "first_camera":
        return invert_rigid(T_room_first)
    if spec.world == "random":
        rng = spec.rng(WORLD)
        return rigid(rotation_from_quaternion_xyzw(rng.standard_normal(4)), rng.uniform(-2, 2, 3))
    return np.eye(4)


def simulate(spec: SimulationSpec, out: Path, progress: Progress = no_progress) -> Path:
    """Write a simulated recording to `out`, and its truth beside it; return the folder of the truth.

    This folder has the files of `write_truth`, `masks/<frame>.png` (noise-free silhouettes in depth pixels,
    255 = subject) and, with `save_depth`, `depth/<frame>.png` (noise-free, 5000 units per metre); `<frame>`
    is the recorded frame's index in six digits. A simulated recording that lies at `out` already is replaced.

    Args:
        spec: the settings of the simulation.
        out: the folder to write; for formats of one file, the file's path with their suffix, such as .bag.
        progress: called with (frames done, frames in all).

    Raises:
        SettingsError: the path does not fit the format, or holds other content; or the family is unknown.
        RecordingError: the mesh cannot be used, or a folder without depth images is to be truncated.
        StorageError: the recording cannot be written.
    """
    _check_place(spec, out)
    simulation, folder = prepare(spec), truth_folder(out)
    sweep(out)
    sweep(folder)
    file_format = formats()[spec.format]
    replaced = replaced_file if file_format.suffix else replaced_folder
    with replaced_folder(folder) as temporary, replaced(out) as path:
        recorder = _Recorder(simulation, temporary, progress)
        if path.is_file():
            path.unlink()  # some writers refuse existing files
        file_format.write(path, simulation.rig, recorder.frames())
        if spec.faults.cut_share > 0:
            cut(path, spec.faults.cut_share)
        values = spec.model_dump(mode="json")
        if spec.mesh is not None:
            # By name and hash, without the path on this machine.
            values["mesh"] = {"name": Path(spec.mesh).name, "sha256": sha256_file(Path(spec.mesh))}
        write_truth(recorder.truth(), values, path)
    return folder


class _Recorder:
    """Renders the frames of a recording one by one, and writes each frame's true images to a folder."""

    def __init__(self, simulation: Simulation, folder: Path, progress: Progress) -> None:
        spec = simulation.spec
        self._simulation, self._folder, self._progress = simulation, folder, progress
        mesh = simulation.subject.mesh.transformed(simulation.T_room_object)
        # The samples do not depend on the spec's seed, so that two recordings of one object share them.
        self._samples = sample_surface(mesh.vertices, mesh.faces, SURFACE_SAMPLES, np.random.default_rng(0))
        self._frames_seen = np.zeros(SURFACE_SAMPLES, dtype=np.uint16)
        (folder / "masks").mkdir()
        if spec.save_depth:
            (folder / "depth").mkdir()

    def frames(self) -> Iterator[RecordedFrame]:
        """Yield every frame of the recording, after writing its true mask and depth."""
        simulation = self._simulation
        for index, plan in enumerate(simulation.frames):
            recorded = record_frame(simulation, index)
            mask = np.where(recorded.mask, np.uint8(255), np.uint8(0))
            (self._folder / "masks" / f"{index:06d}.png").write_bytes(png_bytes(mask))
            if simulation.spec.save_depth:
                native = np.round(recorded.depth_m.astype(np.float64) * DEPTH_SCALE)
                depth = np.where(native > 65535, 0, native).astype(np.uint16)
                (self._folder / "depth" / f"{index:06d}.png").write_bytes(png_bytes(depth))
            if not plan.foreign:
                T_room_camera = simulation.path.poses(np.array([plan.time_s]))[0]
                seen = simulation.renderer.visible(*self._samples, simulation.spec.camera, T_room_camera)
                self._frames_seen += seen & (self._frames_seen < np.iinfo(np.uint16).max)
            yield recorded.frame
            self._progress(index + 1, len(simulation.frames))

    def truth(self) -> Truth:
        """Return the truth, with the samples that were seen in the frames rendered until now."""
        simulation = self._simulation
        spec, R_world_room = simulation.spec, simulation.T_world_room[:3, :3]
        points, normals = self._samples
        points_world = points @ R_world_room.T + simulation.T_world_room[:3, 3]
        poses = simulation.T_world_camera
        poses[[plan.foreign for plan in simulation.frames]] = np.nan
        as_read = formats()[spec.format].stamp_as_read
        stamps = [as_read(index, plan.stamp_ns) for index, plan in enumerate(simulation.frames)]
        return Truth(
            folder=self._folder,
            subject=simulation.subject.name,
            origin=simulation.subject.origin,
            mesh_world=simulation.subject.mesh.transformed(simulation.T_world_object),
            T_world_object=simulation.T_world_object,
            camera=spec.camera,
            stamps_ns=np.array(stamps, dtype=np.int64),
            T_world_camera=poses,
            surface=SurfaceTruth(points_world, normals @ R_world_room.T, self._frames_seen),
        )


def _check_place(spec: SimulationSpec, out: Path) -> None:
    """Refuse a path that does not fit the format, or that holds anything but a simulated recording."""
    suffix = formats()[spec.format].suffix
    foreign = {".truth", *(one.suffix for one in formats().values())} - {"", suffix}
    if not out.name.strip("."):
        raise SettingsError(f"{out}: name a new folder or file, such as `{out / 'chair'}{suffix}`")
    if (suffix and out.suffix != suffix) or out.suffix.lower() in foreign:
        form = f"of this format is a file that ends in {suffix}" if suffix else "of this format is a folder"
        raise SettingsError(f"{out}: a recording {form}; no other name may end so, and none in .truth")
    truth = truth_folder(out)
    for path in (out, truth):
        empty = path.is_dir() and not any(path.iterdir())
        if (path.exists() or path.is_symlink()) and not (empty or is_truth(truth)):
            text = f"{path}: exists and is no simulated recording; choose another name or remove it"
            raise SettingsError(text, what="other-content")
    for name in added_files(truth, out):
        text = f"{out / name}: was added to the recording to replace; move it, or choose another name"
        raise SettingsError(text, what="other-content")
    other = out.with_suffix("") if suffix == ".bag" else out.with_name(f"{out.name}.bag")
    if other.exists():
        raise SettingsError(f"{other}: is there already, and would share {truth}; choose another name")
