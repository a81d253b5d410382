"""Write a simulated recording, with the exact truth beside it."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from kinectbench.errors import SettingsError
from kinectbench.locks import sweep
from kinectbench.simulate.simulation import Simulation, prepare, record
from kinectbench.simulate.spec import SimulationSpec
from kinectbench.simulate.truth import DEPTH_SCALE, SurfaceTruth, Truth, is_truth, truth_folder, write_truth
from kinectbench.simulate.visibility import Visibility, sample_surface
from kinectbench.simulate.writers import SUFFIXES, WRITERS, cut, stamp_as_read
from kinectbench.simulate.writers.frame import RecordedFrame, png_bytes
from kinectbench.workspace import replaced_file, replaced_folder, sha256_file

Progress = Callable[[int, int], None]

SURFACE_SAMPLES = 20_000


def simulate(spec: SimulationSpec, out: Path, progress: Progress = lambda done, total: None) -> Path:
    """Write a simulated recording to `out` and its truth beside it; returns the folder of the truth.

    The truth is what `truth.py` says, and `masks/<frame>.png` (255 = subject, from noise-free silhouettes, in
    depth pixels) and, with `save_depth`, `depth/<frame>.png` (noise-free, 5000 units a metre); `<frame>` is
    the recorded frame's index in six digits.

    Args:
        spec: what to simulate.
        out: a folder, or for the formats that are one file a path with their suffix, such as .bag.
        progress: told (frames done, frames in all).

    Raises:
        SettingsError: the path does not fit the format, or something else lies there; no such family.
        RecordingError: the mesh cannot be used.
        StorageError: it cannot be written.
    """
    _check_place(spec, out)
    simulation = prepare(spec)
    folder = truth_folder(out)
    sweep(out)
    sweep(folder)
    writer = WRITERS[spec.format]
    replaced = replaced_file if spec.format in SUFFIXES else replaced_folder
    with replaced_folder(folder) as temporary:
        recorder = _Recorder(simulation, temporary, progress)
        with replaced(out) as path:
            writer(path, simulation.rig, recorder.frames())
            if spec.faults.cut_share > 0:
                cut(path, spec.faults.cut_share)
        write_truth(recorder.truth(), _description(spec))
    return folder


class _Recorder:
    """Renders frame by frame; what belongs to the truth is kept or stored on the way."""

    def __init__(self, simulation: Simulation, folder: Path, progress: Progress) -> None:
        spec = simulation.spec
        self._simulation, self._folder, self._progress = simulation, folder, progress
        mesh = simulation.subject.mesh.transformed(simulation.T_room_object)
        self._mesh_room = mesh
        # The samples do not depend on the spec's seed, so that two recordings of one object share them.
        self._samples = sample_surface(mesh.vertices, mesh.faces, SURFACE_SAMPLES, np.random.default_rng(0))
        self._visibility = Visibility(simulation.scene)
        self._frames_seen = np.zeros(SURFACE_SAMPLES, dtype=np.uint16)
        (folder / "masks").mkdir()
        if spec.save_depth:
            (folder / "depth").mkdir()

    def frames(self) -> Iterator[RecordedFrame]:
        """Every frame of the recording."""
        simulation = self._simulation
        for index, plan in enumerate(simulation.frames):
            recorded = record(simulation, index)
            mask = np.where(recorded.mask, np.uint8(255), np.uint8(0))
            (self._folder / "masks" / f"{index:06d}.png").write_bytes(png_bytes(mask))
            if simulation.spec.save_depth:
                native = np.round(recorded.depth_m.astype(np.float64) * DEPTH_SCALE)
                depth = np.where(native > 65535, 0, native).astype(np.uint16)
                (self._folder / "depth" / f"{index:06d}.png").write_bytes(png_bytes(depth))
            if not plan.foreign:
                T_room_camera = simulation.path.poses(np.array([plan.time_s]))[0]
                seen = self._visibility.visible(*self._samples, simulation.spec.camera, T_room_camera)
                self._frames_seen += seen.astype(np.uint16)
            yield recorded.frame
            self._progress(index + 1, len(simulation.frames))

    def truth(self) -> Truth:
        """The truth of the frames rendered so far."""
        simulation = self._simulation
        spec, R_world_room = simulation.spec, simulation.T_world_room[:3, :3]
        points, normals = self._samples
        points_world = points @ R_world_room.T + simulation.T_world_room[:3, 3]
        poses = simulation.T_world_camera
        poses[[plan.foreign for plan in simulation.frames]] = np.nan
        stamps = [stamp_as_read(spec.format, i, plan.stamp_ns) for i, plan in enumerate(simulation.frames)]
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
    suffix = SUFFIXES.get(spec.format, "")
    foreign = {*SUFFIXES.values(), ".truth"} - {suffix}
    if not out.name or (suffix and out.suffix != suffix) or out.suffix.lower() in foreign:
        said = f"of this format is a file that ends in {suffix}" if suffix else "of this format is a folder"
        raise SettingsError(f"{out}: a recording {said}; no other name may end so, and none in .truth")
    truth = truth_folder(out)
    for path in (out, truth):
        if (path.exists() or path.is_symlink()) and not (_is_empty(path) or is_truth(truth)):
            raise SettingsError(
                f"{path}: exists and is no simulated recording; choose another name or remove it"
            )
    other = out.with_suffix("") if suffix == ".bag" else out.with_name(f"{out.name}.bag")
    if other.exists():
        raise SettingsError(f"{other}: is there already, and would share {truth}; choose another name")


def _is_empty(path: Path) -> bool:
    return path.is_dir() and not any(path.iterdir())


def _description(spec: SimulationSpec) -> dict[str, object]:
    """The spec as JSON values; a mesh file by its name and hash, not by its place on this machine."""
    values = spec.model_dump(mode="json")
    if spec.mesh is not None:
        values["mesh"] = {"name": Path(spec.mesh).name, "sha256": sha256_file(Path(spec.mesh))}
    return {"spec": values}
