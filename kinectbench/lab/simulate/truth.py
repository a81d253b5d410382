"""The truth of a simulated recording: write it, read it, and sample its solid on a grid."""

import json
import re
from collections import Counter
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath

import cv2
import numpy as np
from numpy.typing import NDArray

from kinectbench._version import __version__
from kinectbench.core import RESULTS, KinectBenchError, RecordingError, SettingsError, pretty_json
from kinectbench.core.geometry import Camera, Grid, TriangleMesh, read_own_ply, write_ply
from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.trajectory_file import trajectory_text
from kinectbench.core.types import Bools
from kinectbench.core.voxels.npz import UNREADABLE, load_arrays, npz_bytes
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.core.voxels.seeable import SeeableSolid, seeable_solid
from kinectbench.core.voxels.solid import voxelize_solid

FORMAT_VERSION = 2
# Scale of noise-free depth as uint16: 0.2 mm a unit, up to 13.1 m.
DEPTH_SCALE = 5000.0


@dataclass(frozen=True)
class SurfaceTruth:
    """Samples spread evenly over the object's surface, each with the number of frames that see it.

    Attributes:
        points_world: (m, 3) float64, metres.
        normals_world: (m, 3) float64, unit, outward.
        frames_seen: (m,) uint16, number of frames in which the point was in view and not occluded.
    """

    points_world: NDArray[np.float64]
    normals_world: NDArray[np.float64]
    frames_seen: NDArray[np.uint16]


@dataclass(frozen=True)
class TrueCells:
    """True states of a grid's cells, sampled at their centres: bool arrays of the grid's shape.

    Attributes:
        exact: the cell is in the exact solid, inside the true mesh.
        solid: the cell is in the seeable solid: in the exact solid, or in space that no camera could see,
            except slits.
        judged: the cell is evaluated. Slits are not evaluated: gaps that only a finer sensor could see into,
            and walls thinner than a voxel.
    """

    exact: Bools
    solid: Bools
    judged: Bools


@dataclass(frozen=True)
class Truth:
    """The truth of a simulated recording. Frame indices are those of the written recording.

    Attributes:
        folder: the truth's folder, with the images of masks and depth.
        subject: name of the object, such as "chair:seed=3".
        origin: where the solid comes from and how it was closed.
        mesh_world: the solid's surface: watertight, outward; world frame, metres.
        T_world_object: (4, 4) float64; frame `object` has z up, the floor at z = 0.
        camera: the depth camera.
        stamps_ns: (n,) int64, the recorded depth stamps, in the order of the frames.
        T_world_camera: (n, 4, 4) float64; NaN where a frame shows another scene.
        surface: samples of the object's surface.
        limits: sensor limits that define which space is seeable; None: they follow from the object's size.
    """

    folder: Path
    subject: str
    origin: str
    mesh_world: TriangleMesh
    T_world_object: NDArray[np.float64]
    camera: Camera
    stamps_ns: NDArray[np.int64]
    T_world_camera: NDArray[np.float64]
    surface: SurfaceTruth
    limits: SensorLimits | None = None

    @cached_property
    def seeable(self) -> SeeableSolid:
        """The seeable solid: the true mesh's inside and space that no camera could see; takes seconds."""
        longest_m = float(np.ptp(self.mesh_world.vertices, axis=0).max())
        limits = self.limits or SensorLimits.of_size(longest_m)
        return seeable_solid(self.mesh_world, self.T_world_object, limits)

    def cells(self, grid: Grid) -> "TrueCells":
        """Return the true states of a grid's cells; the number of cells along z must be a multiple of 8."""
        exact, seeable = mesh_occupancy(self.mesh_world, grid), self.seeable
        closed = seeable.on(grid, seeable.closed & ~seeable.slit)
        return TrueCells(exact, exact | closed, exact | ~seeable.on(grid, seeable.slit))

    @property
    def floor_plane_world(self) -> NDArray[np.float64]:
        """The floor plane [a, b, c, d] in the world: `a x + b y + c z + d` is a point's height in metres."""
        return floor_plane(self.T_world_object)

    def mask(self, index: int) -> NDArray[np.bool_]:
        """Read the object's silhouette in a frame's depth image: (height, width) bool.

        Raises:
            RecordingError: the image is missing or damaged.
        """
        return np.asarray(_image(self.folder / "masks" / f"{index:06d}.png") > 0)

    def depth_m(self, index: int) -> NDArray[np.float32] | None:
        """Read a frame's noise-free depth: (height, width) float32, metres, 0 = none; None if not stored.

        Raises:
            RecordingError: the image is missing or damaged, although others are stored.
        """
        if not (self.folder / "depth").is_dir():
            return None
        return _image(self.folder / "depth" / f"{index:06d}.png").astype(np.float32) / np.float32(DEPTH_SCALE)


def floor_plane(T_world_object: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the plane z = 0 of the object's frame as [a, b, c, d] in the world frame.

    Its normal is the object's z axis, a unit vector. `T_world_object` is (4, 4).
    """
    up = T_world_object[:3, 2]
    return np.append(up, -up @ T_world_object[:3, 3])


def truth_folder(recording: Path) -> Path:
    """Return the truth's folder beside a recording, which may be `.`: `<name without .bag>.truth`."""
    named = recording if recording.name.strip(".") else recording.resolve()
    if not named.name:
        raise SettingsError(f"{recording}: is no recording; name its folder or file")
    return named.with_name(f"{named.name.removesuffix('.bag')}.truth")


def is_truth(folder: Path) -> bool:
    """Return whether a folder holds the truth of a simulated recording, of any format version."""
    try:
        record = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        return {"format_version", "package_version", "T_world_object", "spec"} <= set(record)
    except (OSError, ValueError, TypeError, RecursionError):
        return False


def added_files(folder: Path, recording: Path) -> list[str]:
    """Return the files and folders in a simulated recording's folder that its simulation did not write.

    Hidden files and folders are ignored. An added folder is named without its content. Numbered files, such
    as images of frames, are only counted. If there are more than the simulation wrote, their common name,
    with # for the number, is returned once.

    Args:
        folder: the folder of the recording's truth; without a truth, the result is empty.
        recording: the recording; if it is a file, the result is empty.

    Returns:
        Sorted names relative to the recording.
    """
    if not recording.is_dir() or not is_truth(folder):
        return []
    record = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    if isinstance(written := record.get("files"), list | dict):
        named = {str(name) for name in written}
        # Earlier versions name only what lies at the top.
        folders = {"."} | (named if any("/" in name for name in named) else set())
        names = _names_below(recording)
        new = [name for name in names if _numberless(name) not in named]
        added = [name for name in new if _numberless(str(PurePosixPath(name).parent)) in folders]
        if isinstance(written, dict):  # earlier versions do not count
            count = Counter(map(_numberless, names))
            added += [name for name, most in written.items() if isinstance(most, int) and count[name] > most]
        return sorted(added)
    # Truths of earlier versions do not name the files: then what `init`, `record` and builds add.
    there = {path.name for path in recording.iterdir()}
    given = record["spec"].get("given", {}) if isinstance(record["spec"], dict) else {}
    return sorted(there & {"benchmark.yaml", *RESULTS, *({"masks"} if not given.get("masks") else ())})


def _names_below(folder: Path) -> list[str]:
    """Return the names of all files and folders below a folder, relative to it, without hidden ones."""
    names = [path.relative_to(folder) for path in folder.rglob("*")]
    return [name.as_posix() for name in names if not any(part.startswith(".") for part in name.parts)]


def _numberless(name: str) -> str:
    """Return a file's name with # in place of each number, such as a frame's index."""
    return re.sub(r"\d+", "#", name)


def write_truth(truth: Truth, spec: dict[str, object], recording: Path | None = None) -> None:
    """Write everything but the images into the existing folder of the truth.

    The files are truth.json, frames.npz (`stamps_ns`, `T_world_camera`), trajectory.txt (the same poses as
    TUM text, without frames of another scene), floor.json, object.ply (world frame) and surface.npz
    (`points_world`, `normals_world`, `frames_seen`). truth.json has the JSON values of `spec`. If `recording`
    is a folder, truth.json also has the names of all files and folders below it, with # for numbers, and the
    count of each name.
    """
    known = np.isfinite(truth.T_world_camera).all(axis=(1, 2))
    record = {
        "format_version": FORMAT_VERSION,
        "package_version": __version__,
        "subject": truth.subject,
        "origin": truth.origin,
        "camera": asdict(truth.camera),
        "depth_scale": DEPTH_SCALE,
        "T_world_object": truth.T_world_object.tolist(),
        "frames": len(truth.stamps_ns),
        "foreign_frames": np.flatnonzero(~known).tolist(),
        "spec": spec,
    }
    if recording is not None and recording.is_dir():
        record["files"] = dict(sorted(Counter(map(_numberless, _names_below(recording))).items()))
    folder = truth.folder
    (folder / "truth.json").write_text(pretty_json(record), encoding="utf-8")
    frames = {"stamps_ns": truth.stamps_ns, "T_world_camera": truth.T_world_camera}
    (folder / "frames.npz").write_bytes(npz_bytes(frames))
    posed = GivenTrajectory(truth.stamps_ns[known], truth.T_world_camera[known])
    (folder / "trajectory.txt").write_text(trajectory_text(posed), encoding="utf-8")
    (folder / "floor.json").write_text(
        pretty_json({"plane_world": truth.floor_plane_world.tolist()}), encoding="utf-8"
    )
    write_ply(truth.mesh_world, folder / "object.ply")
    surface: dict[str, NDArray[np.generic]] = {
        "points_world": truth.surface.points_world.astype(np.float32),
        "normals_world": truth.surface.normals_world.astype(np.float32),
        "frames_seen": truth.surface.frames_seen,
    }
    (folder / "surface.npz").write_bytes(npz_bytes(surface, level=6))


def read_truth(folder: Path) -> Truth:
    """Read the truth that was written beside a simulated recording.

    Raises:
        RecordingError: there is no truth, it is damaged, or it has another format version.
    """
    path = folder / "truth.json"
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        if record["format_version"] != FORMAT_VERSION:
            raise RecordingError(
                f"{path}: format version {record['format_version']}; this package reads {FORMAT_VERSION}; "
                "simulate the recording again",
                what="other-version",
            )
        frames, surface = load_arrays(folder / "frames.npz"), load_arrays(folder / "surface.npz")
        return Truth(
            folder=folder,
            subject=str(record["subject"]),
            origin=str(record["origin"]),
            mesh_world=read_own_ply(folder / "object.ply"),
            T_world_object=np.array(record["T_world_object"], dtype=np.float64).reshape(4, 4),
            camera=Camera(**record["camera"]),
            stamps_ns=frames["stamps_ns"].astype(np.int64),
            T_world_camera=frames["T_world_camera"].astype(np.float64).reshape(-1, 4, 4),
            surface=SurfaceTruth(
                surface["points_world"].astype(np.float64),
                surface["normals_world"].astype(np.float64),
                surface["frames_seen"],
            ),
        )
    except RecordingError:
        raise
    except (KinectBenchError, OSError, ValueError, KeyError, TypeError, IndexError, *UNREADABLE) as error:
        raise RecordingError(f"{path}: no readable truth ({error}); simulate the recording again") from error


def mesh_occupancy(mesh_world: TriangleMesh, grid: Grid) -> NDArray[np.bool_]:
    """Mark the cells of a grid whose centre is inside a closed mesh: bool array of the grid's shape.

    The mesh is in the world. The number of cells along the grid's last axis must be a multiple of 8.
    """
    return unpack(voxelize_solid(mesh_world.vertices, mesh_world.faces, grid))


def _image(path: Path) -> NDArray[np.uint16] | NDArray[np.uint8]:
    try:
        image = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_UNCHANGED)
    except (OSError, cv2.error) as error:
        raise RecordingError(f"{path}: missing or damaged; simulate the recording again") from error
    if image is None:
        raise RecordingError(f"{path}: damaged; simulate the recording again")
    return np.asarray(image)
