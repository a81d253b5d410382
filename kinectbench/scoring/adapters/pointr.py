"""AdaPoinTr and PoinTr (Yu et al., TPAMI 2023) read and predict points that are centred and scaled.

Source: its repository, commit 2e53e72. `tools/inference.py` reads N x 3 points, and writes fine.npy. Its
configurations for ShapeNet centre the points and divide them by their largest norm. The points written here
are already normalised in this way.
"""

from pathlib import Path

import numpy as np

from kinectbench.core import PredictionError, ReleaseError, open_plain, size_of
from kinectbench.core.geometry import invert_rigid, rigid
from kinectbench.core.mesh_files import MAX_POINTS
from kinectbench.core.types import Float64
from kinectbench.core.voxels.npy import NpyError, NpyHeader, read_npy
from kinectbench.release.exchange.rgbd import RgbdView
from kinectbench.release.release import Release
from kinectbench.scoring.adapters.adapter import Adapter, scaling
from kinectbench.scoring.camera_shape import CameraShape

# Number of points that PoinTr's loaders take; the seed draws them from the view's points.
POINTS = 2048
SEED = 0


def write_pointr(release: Release, view: RgbdView, folder: Path) -> tuple[RgbdView, dict[str, object]]:
    """Write points.npy: at most 2,048 measured points of the object, mean 0, largest norm 1, y up.

    Up is the floor's normal or, if the floor is not known, the up direction of the image.

    Raises:
        ReleaseError: no point of the object is measured.
    """
    points_m = view.object_points_m
    if not len(points_m):
        raise ReleaseError(
            f"{view.target.name}: no point of the object is measured; leave the view out",
            what="nothing-measured",
        )
    chosen = np.random.default_rng(SEED).permutation(len(points_m))[:POINTS]
    points_m = points_m[np.sort(chosen)]
    center_m = points_m.mean(axis=0)
    turned = (points_m - center_m) @ _upright(release, view)
    size = float(np.linalg.norm(turned, axis=1).max()) or 1.0
    np.save(folder / "points.npy", (turned / size).astype(np.float32))
    return view, {"T_camera_method": rigid(_upright(release, view), center_m) @ scaling(size)}


def _upright(release: Release, view: RgbdView) -> Float64:
    """Return the rotation (3, 3) to the camera from a frame with x right, y up and z towards the viewer."""
    floor = release.floor(view.target.recording)
    up = np.array([0.0, -1.0, 0.0])
    if floor is not None:
        up = invert_rigid(view.T_world_camera)[:3, :3] @ floor.T_floor_world[2, :3]
    towards = -np.array([0.0, 0.0, 1.0])
    right = np.cross(up, towards)
    # If the camera looks straight down, x is the camera's x.
    right = right if np.linalg.norm(right) > 1e-6 else np.array([1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    return np.stack([right, up, np.cross(right, up)], axis=1)


def read_pointr(path: Path) -> CameraShape:
    """Read the points of fine.npy, in the normalised frame of points.npy.

    Raises:
        PredictionError, NpyError, OSError: the file cannot be read, or is no array of points.
    """
    with open_plain(path) as file:
        points = read_npy(file, size_of(file), _refuse_no_points).astype(np.float64)
    if not np.isfinite(points).all():
        raise PredictionError(f"{path.name}: a number is not finite")
    return CameraShape("points", points, np.zeros((0, 3), np.int64))


def _refuse_no_points(header: NpyHeader) -> None:
    shape = header.shape
    if header.dtype.kind != "f" or len(shape) != 2 or shape[1] != 3 or not 1 <= shape[0] <= MAX_POINTS:
        raise NpyError(f"{shape} {header.dtype}; (n, 3) floats are wanted")


POINTR = Adapter(write_pointr, "fine.npy", read_pointr, "points", ("depth", "mask"))
