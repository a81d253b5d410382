"""The truth of a simulated recording: written beside it, read back, and sampled on any grid."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench import __version__
from kinectbench.errors import RecordingError
from kinectbench.geometry import Grid, invert_rigid, transform_points
from kinectbench.simulate.solid import Mesh, Part, Solid
from kinectbench.workspace import pretty_json

FORMAT_VERSION = 1


@dataclass(frozen=True)
class ObjectTruth:
    """The exact subject and where it stands.

    Attributes:
        solid: union of convex parts, object frame.
        T_world_object: (4, 4) float64.
    """

    solid: Solid
    T_world_object: NDArray[np.float64]

    def mesh_world(self) -> Mesh:
        """The closed parts' meshes in the world frame, metres."""
        mesh = self.solid.mesh()
        return Mesh(transform_points(self.T_world_object, mesh.vertices), mesh.triangles)

    def floor_plane_world(self) -> NDArray[np.float64]:
        """The floor [a, b, c, d] with unit normal upwards: `a x + b y + c z + d` is the height in metres."""
        up = self.T_world_object[:3, 2]
        return np.append(up, -up @ self.T_world_object[:3, 3])


def truth_folder(recording: Path) -> Path:
    """Where the truth of a recording lies: beside it, `<name without .bag>.truth`."""
    return recording.with_name(f"{recording.name.removesuffix('.bag')}.truth")


def write_object_truth(folder: Path, truth: ObjectTruth, description: dict[str, Any]) -> None:
    """Write truth.json (with `description` in it), floor.json and object.ply into an existing folder."""
    record = {
        "format_version": FORMAT_VERSION,
        "package_version": __version__,
        **description,
        "T_world_object": truth.T_world_object.tolist(),
        "parts": [part.to_json() for part in truth.solid.parts],
    }
    (folder / "truth.json").write_text(pretty_json(record))
    plane = {"plane_world": truth.floor_plane_world().tolist()}
    (folder / "floor.json").write_text(pretty_json(plane))
    (folder / "object.ply").write_bytes(ply_bytes(truth.mesh_world()))


def read_object_truth(folder: Path) -> ObjectTruth:
    """Read the truth that was written beside a simulated recording.

    Raises:
        RecordingError: there is none, it is damaged, or it has another format version.
    """
    path = folder / "truth.json"
    try:
        record = json.loads(path.read_text())
        version = record["format_version"]
        if version != FORMAT_VERSION:
            raise RecordingError(f"{path}: format version {version}; this package reads {FORMAT_VERSION}")
        parts = tuple(Part.from_json(part) for part in record["parts"])
        T_world_object = np.array(record["T_world_object"], dtype=np.float64)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise RecordingError(f"{path}: no readable truth ({error}); simulate the recording again") from error
    if not parts or T_world_object.shape != (4, 4) or not np.isfinite(T_world_object).all():
        raise RecordingError(f"{path}: no parts or no 4x4 T_world_object; simulate the recording again")
    return ObjectTruth(Solid(parts), T_world_object)


def truth_occupancy(folder: Path, grid: Grid) -> NDArray[np.bool_]:
    """Which cell centres of a grid lie inside the true object: bool (grid.shape), exact.

    Raises:
        RecordingError: the folder holds no readable truth.
    """
    truth = read_object_truth(folder)
    return solid_occupancy(truth.solid, truth.T_world_object, grid)


def solid_occupancy(solid: Solid, T_world_object: NDArray[np.float64], grid: Grid) -> NDArray[np.bool_]:
    """Which cell centres of a grid lie inside or on a solid: bool (grid.shape).

    Along the grid's z axis a convex part is one interval, so a plane costs a column, not a cell (own rule).
    """
    occupied = np.zeros(grid.shape, dtype=np.bool_)
    T_object_grid = invert_rigid(T_world_object) @ grid.T_world_grid
    for part in solid.parts:
        corners = (
            transform_points(invert_rigid(T_object_grid), part.mesh().vertices) / grid.voxel_size_m - 0.5
        )
        low = np.maximum(np.floor(corners.min(axis=0)).astype(int), 0)
        high = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 1, grid.shape)
        if np.all(low < high):
            planes_grid = part.planes() @ T_object_grid
            box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
            occupied[box] |= _convex_occupancy(planes_grid, low, high, grid.voxel_size_m)
    return occupied


def _convex_occupancy(
    planes_grid: NDArray[np.float64], low: NDArray[np.int_], high: NDArray[np.int_], voxel_size_m: float
) -> NDArray[np.bool_]:
    """Which cells from `low` up to `high` have their centres within all planes (m, 4) of frame `grid`."""
    x, y, z = ((np.arange(a, b) + 0.5) * voxel_size_m for a, b in zip(low, high, strict=True))
    first = np.full((len(x), len(y)), -np.inf)
    last = np.full((len(x), len(y)), np.inf)
    for a, b, c, d in planes_grid:
        outside_m = a * x[:, None] + b * y[None, :] + d
        if abs(c) < 1e-12:
            last[outside_m > 0] = -np.inf
        elif c > 0:
            np.minimum(last, -outside_m / c, out=last)
        else:
            np.maximum(first, -outside_m / c, out=first)
    inside: NDArray[np.bool_] = (z >= first[..., None]) & (z <= last[..., None])
    return inside


def ply_bytes(mesh: Mesh) -> bytes:
    """A mesh as a binary little-endian PLY file (float32 vertices): same mesh, same bytes."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(mesh.vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(mesh.triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(mesh.triangles), dtype=[("count", "u1"), ("indices", "<i4", 3)])
    faces["count"], faces["indices"] = 3, mesh.triangles
    return header.encode() + mesh.vertices.astype("<f4").tobytes() + faces.tobytes()
