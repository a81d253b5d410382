"""A predicted shape in the camera frame (mesh, point cloud, occupied cells or distances), and its files.

The files are untrusted: sizes in their headers are checked before anything is allocated.
"""

import io
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import PredictionError, open_plain, size_of
from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.geometry import similarity_problem, similarity_scale, transform_points
from kinectbench.core.glb_file import read_glb
from kinectbench.core.mesh_files import MAX_FILE_BYTES, MAX_POINTS, read_obj, read_ply_surface
from kinectbench.core.types import Arrays, Bools, FileArray, Float32, Float64, Int64
from kinectbench.core.voxels.npz import UNREADABLE, arrays_of, npz_bytes
from kinectbench.core.voxels.resample import MAX_CELLS

SUFFIXES = (".ply", ".obj", ".glb", ".npz")
# 512^3 distances of float32 are 537 MB.
MAX_GRID_BYTES = 4 * MAX_CELLS**3 + (1 << 20)
# Units of `method.json` in metres. The scale of `free` is in `T_camera_prediction`, or is not known.
METRES = {"m": 1.0, "mm": 0.001, "free": 1.0}
# Factors from the axes named in `method.json` to the camera (x right, y down, z forward). PyTorch3D: x left,
# y up, z forward; OpenGL: x right, y up, z backward.
CAMERA_AXES = {"cv": (1.0, 1.0, 1.0), "pytorch3d": (-1.0, -1.0, 1.0), "opengl": (1.0, -1.0, -1.0)}
# No point of a room is farther away than this, in any supported unit.
FARTHEST_M = 1e6
# No cell is smaller than this.
NEAREST_M = 1e-6
# Maximum number of cells at a surface. A solid that fills a grid of 512 a side has 1.6 M, and its distances
# have twice as many; a grid of noise would exceed the memory.
MOST_SHOWN = 4 << 20


@dataclass(frozen=True)
class CameraShape:
    """A predicted shape in a view's camera frame (x right, y down, z forward), metres.

    Attributes:
        form: "mesh", "points", "voxels" or "sdf".
        points_m: (n, 3) float64: vertices of a mesh, points of a cloud, centres of occupied cells that have a
            free neighbour (voxels), or centres of cells less than a cell from the surface (sdf).
        faces: (m, 3) faces of a mesh, else (0, 3).
        normals: (n, 3) normals of a cloud's points; None if there are none.
        cells: (i, j, k) bool occupancy, or float32 signed distances in metres; None for meshes and points.
        T_camera_grid: (4, 4) similarity; the centre of cell (i, j, k) is at
            `T_camera_grid @ ((i + .5, j + .5, k + .5) * voxel_size_m)`.
        voxel_size_m: edge of a cell in the grid's own frame, which `T_camera_grid` may scale.
    """

    form: str
    points_m: Float64
    faces: Int64
    normals: Float64 | None = None
    cells: Bools | Float32 | None = None
    T_camera_grid: Float64 | None = None
    voxel_size_m: float | None = None

    def transformed(self, T: Float64) -> "CameraShape":
        """Return the shape mapped by a similarity (4, 4), which may also mirror."""
        scale = np.cbrt(abs(np.linalg.det(T[:3, :3])))
        normals = None if self.normals is None else self.normals @ (T[:3, :3] / scale).T
        grid = None if self.T_camera_grid is None else T @ self.T_camera_grid
        points = transform_points(T, self.points_m)
        return replace(self, points_m=points, normals=normals, T_camera_grid=grid)


def similarity_to_camera(method: MethodFile, name: str, view: str) -> Float64:
    """Return the (4, 4) similarity from a prediction file's coordinates to the camera frame, metres.

    Args:
        method: the content of method.json, which declares unit, axes and matrices.
        name: the file's name without its suffix, `<recording>/<view>.<k>` for example.
        view: `<recording>/<view>`.
    """
    T = np.diag([*(METRES[method.unit] * np.array(CAMERA_AXES[method.axes])), 1.0])
    declared = method.T_camera_prediction or {}
    return declared.get(name, declared.get(view, np.eye(4))) @ T


def read_shape(path: Path, name: str) -> CameraShape:
    """Read a predicted .ply (mesh or cloud), .obj, .glb or .npz in its own coordinates; `name` is for errors.

    Raises:
        PredictionError: the file is invalid; the message is one line.
    """
    try:
        with open_plain(path) as file:
            return _shape(file, path.suffix)
    except PredictionError as error:
        raise PredictionError(f"{name}: {error}", what=error.what) from None
    except OSError as error:
        raise PredictionError(
            f"{name}: cannot be read ({error.strerror or error})", what="unreadable"
        ) from error
    except (ValueError, *UNREADABLE) as error:
        raise PredictionError(
            f"{name}: not a readable {path.suffix[1:]} file: {error}", what="unreadable"
        ) from error


def _shape(file: IO[bytes], suffix: str) -> CameraShape:
    most = MAX_GRID_BYTES if suffix == ".npz" else MAX_FILE_BYTES
    if not 0 < size_of(file) <= most:
        raise PredictionError(
            f"{size_of(file)} bytes; a file of 1 to {most} bytes is accepted", what="too-large"
        )
    if suffix == ".npz":
        return _of_arrays(arrays_of(file, MAX_GRID_BYTES))
    content, normals = file.read(most), None
    if suffix == ".ply":
        points, faces, normals = read_ply_surface(content)
    elif suffix in (".obj", ".glb"):
        points, faces = (read_obj if suffix == ".obj" else read_glb)(content)
    else:
        raise PredictionError(f"save it as {', '.join(SUFFIXES)}")
    return CameraShape("mesh" if len(faces) else "points", _checked_points(points), faces, normals)


def _of_arrays(arrays: Arrays) -> CameraShape:
    """Return the shape that the arrays of an .npz file hold; its form follows from their keys."""
    no_faces = np.zeros((0, 3), np.int64)
    several = [key for key in ("points_m", "occupancy", "sdf_m") if key in arrays]
    if len(several) > 1:
        raise PredictionError(f"holds {' and '.join(several)}; save one of them")
    if "points_m" in arrays:
        points, normals = _checked_points(arrays["points_m"]), arrays.get("normals")
        if normals is None:
            return CameraShape("points", points, no_faces)
        if normals.shape != points.shape:
            raise PredictionError(f"normals {normals.shape} are not as many as the points {points.shape}")
        if normals.dtype.kind not in "fiu":
            raise PredictionError(f"normals {normals.dtype}: rows of x, y, z are needed")
        return CameraShape("points", points, no_faces, normals.astype(np.float64))
    key = next((key for key in ("occupancy", "sdf_m") if key in arrays), None)
    if key is None:
        raise PredictionError("holds none of points_m, occupancy, sdf_m; save one of them")
    if missing := {"T_camera_grid", "voxel_size_m"} - arrays.keys():
        raise PredictionError(f"holds no {' and no '.join(sorted(missing))}; add it beside {key}")
    T, cells = arrays["T_camera_grid"], arrays[key]
    size = arrays["voxel_size_m"]
    if cells.ndim != 3 or not 1 <= min(cells.shape) <= max(cells.shape) <= MAX_CELLS:
        raise PredictionError(f"{key} must be (i, j, k) with sides of 1 to {MAX_CELLS}")
    if T.shape != (4, 4) or T.dtype.kind not in "fiu" or not np.isfinite(T).all():
        raise PredictionError("T_camera_grid must be 4 x 4 finite numbers")
    if problem := similarity_problem(T.astype(np.float64)):
        raise PredictionError(f"T_camera_grid: {problem}")
    one = size.size == 1 and size.dtype.kind in "fiu"
    if not (one and NEAREST_M <= float(size.reshape(())) < FARTHEST_M):
        raise PredictionError(f"voxel_size_m must be one positive number, {NEAREST_M:g} m at least")
    made = occupancy_shape if key == "occupancy" else distance_shape
    return made(_checked_cells(cells, key), T.astype(np.float64), float(size.reshape(())))


def _checked_points(points: NDArray[np.generic]) -> Float64:
    if points.ndim != 2 or points.shape[1] != 3 or not len(points) or points.dtype.kind not in "fiu":
        raise PredictionError(f"points {points.shape} {points.dtype}: rows of x, y, z are needed")
    if len(points) > MAX_POINTS:
        raise PredictionError(f"{len(points)} points; at most {MAX_POINTS} are accepted", what="too-large")
    found = points.astype(np.float64)
    # `<=` is false for NaN, too.
    if not (np.abs(found) <= FARTHEST_M).all():
        raise PredictionError(
            f"a point is not finite, or beyond {FARTHEST_M:g}; write the points again", what="bad-values"
        )
    return found


def _checked_cells(cells: FileArray, key: str) -> FileArray:
    """Check cells by their key; return occupancy as bool, or distances as float32."""
    if key == "occupancy":
        if cells.dtype == np.bool_ or (cells.dtype == np.uint8 and cells.max() <= 1):
            return cells.astype(bool)
        raise PredictionError(
            "occupancy must be bool, or uint8 of 0 and 1; apply your threshold first", what="bad-values"
        )
    with np.errstate(over="ignore"):
        distances = cells.astype(np.float32) if cells.dtype.kind == "f" else None
    if distances is None or not np.isfinite(distances).all():
        raise PredictionError("sdf_m must be finite floats, metres, negative inside", what="bad-values")
    return distances


def occupancy_shape(cells: Bools, T_camera_grid: Float64, voxel_size_m: float) -> CameraShape:
    """Return occupied cells as a shape; its points are the centres of those with a free 6-neighbour.

    Raises:
        PredictionError: no cell is occupied, or too many occupied cells have a free neighbour.
    """
    padded = np.pad(cells, 1)
    inner = cells.copy()
    for axis in range(3):
        for by in (-1, 1):
            inner &= np.roll(padded, by, axis)[1:-1, 1:-1, 1:-1]
    return _of_cells("voxels", cells, cells & ~inner, T_camera_grid, voxel_size_m)


def distance_shape(cells: Float32, T_camera_grid: Float64, voxel_size_m: float) -> CameraShape:
    """Return signed distances (metres, negative inside) as a shape.

    Its points are the centres of cells that are less than one cell from the surface.

    Raises:
        PredictionError: no cell, or too many cells, are this near to the surface.
    """
    near = np.abs(cells) < voxel_size_m * similarity_scale(T_camera_grid)
    return _of_cells("sdf", cells, near, T_camera_grid, voxel_size_m)


def _of_cells(
    form: str, cells: Bools | Float32, shown: Bools, T_camera_grid: Float64, voxel_size_m: float
) -> CameraShape:
    if int(shown.sum()) > MOST_SHOWN:
        raise PredictionError(
            f"more than {MOST_SHOWN} cells at a surface: noise? reduce the grid", what="too-large"
        )
    if not shown.any():
        raise PredictionError("no cell is at a surface: an empty prediction", what="empty")
    points = transform_points(T_camera_grid, (np.argwhere(shown) + 0.5) * voxel_size_m)
    none = np.zeros((0, 3), np.int64)
    return CameraShape(form, points, none, None, cells, T_camera_grid, voxel_size_m)


def write_shape(shape: CameraShape, stem: Path) -> Path:
    """Write a shape as a prediction; return the file, `<stem>.ply` (mesh, points) or `<stem>.npz` (grids).

    Coordinates are in the camera frame, metres; in a .ply file they are float32.
    """
    stem.parent.mkdir(parents=True, exist_ok=True)
    if shape.cells is not None:
        path = stem.with_name(stem.name + ".npz")
        key = "occupancy" if shape.form == "voxels" else "sdf_m"
        size = np.array(shape.voxel_size_m)
        arrays = {key: shape.cells, "T_camera_grid": np.array(shape.T_camera_grid), "voxel_size_m": size}
        path.write_bytes(npz_bytes(arrays))
        return path
    path = stem.with_name(stem.name + ".ply")
    path.write_bytes(_ply(shape))
    return path


def _ply(shape: CameraShape) -> bytes:
    names = ["x", "y", "z", *(["nx", "ny", "nz"] if shape.normals is not None else [])]
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(shape.points_m)}"]
    head += [f"property float {name}" for name in names]
    parts = [shape.points_m] if shape.normals is None else [shape.points_m, shape.normals]
    body = io.BytesIO(np.hstack(parts).astype("<f4").tobytes())
    body.seek(0, io.SEEK_END)
    if len(shape.faces):
        head += [f"element face {len(shape.faces)}", "property list uchar int vertex_indices"]
        rows = np.zeros(len(shape.faces), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
        rows["count"], rows["corners"] = 3, shape.faces
        body.write(rows.tobytes())
    return "\n".join([*head, "end_header\n"]).encode() + body.getvalue()
