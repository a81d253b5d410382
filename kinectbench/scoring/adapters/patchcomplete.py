"""PatchComplete (Rao et al., NeurIPS 2022) predicts signed distances in 32^3 voxels of a cube.

Source: its repository, commit 938303c. It reads `tsdf`, in units of the cube's edge, and writes
`predicted_voxels`, in voxels. Values up to 1e-10 are solid. The cube is that of the pair's grid; its axes are
parallel to the camera's.
"""

from pathlib import Path

import numpy as np

from kinectbench.core import PredictionError, open_plain
from kinectbench.core.geometry import invert_rigid, similarity_scale, transform_points
from kinectbench.core.types import Float32, Float64
from kinectbench.core.voxels.npz import arrays_of, npz_bytes
from kinectbench.core.voxels.pair_file import FULL_CELLS
from kinectbench.release.exchange.rgbd import RgbdView, parts_of
from kinectbench.release.release import Release
from kinectbench.scoring.adapters.adapter import Adapter, scaling
from kinectbench.scoring.camera_shape import CameraShape, occupancy_shape

# PatchComplete's loader uses this number of voxels, and clips distances at CLIP_VOXELS; its own metric counts
# cells with values up to SOLID_BELOW as solid.
VOXELS = 32
CLIP_VOXELS = 2.5
SOLID_BELOW = 1e-10
KEY = "predicted_voxels"
# Size of 32^3 numbers of eight bytes, plus the overhead of an npz.
MOST_BYTES = VOXELS**3 * 8 + (1 << 16)


def write_patchcomplete(release: Release, view: RgbdView, folder: Path) -> tuple[RgbdView, dict[str, object]]:
    """Write input.npz: `tsdf` (32, 32, 32) float32 in units of the cube's edge, clipped at 2.5 voxels."""
    T_world_grid, size = parts_of(release, view.target, ("T_world_grid", "voxel_size_m"))
    edge_m = float(size) * FULL_CELLS
    T_camera_cube = invert_rigid(view.T_world_camera) @ T_world_grid @ scaling(edge_m)
    tsdf = (distances_m(view, T_camera_cube) / edge_m).astype(np.float32)
    (folder / "input.npz").write_bytes(npz_bytes({"tsdf": tsdf}))
    return view, {"T_camera_method": T_camera_cube}


def distances_m(view: RgbdView, T_camera_cube: Float64) -> Float32:
    """Return each voxel centre's distance along z to the measured surface: (32, 32, 32) float32, metres.

    The distance is positive in front of the surface, and is clipped to +-2.5 voxels. It is +2.5 voxels where
    the voxel centre projects to no measured pixel of the object.

    Args:
        view: depth and mask of the object.
        T_camera_cube: (4, 4) similarity from the cube [0, 1]^3 to the camera.
    """
    clip_m = CLIP_VOXELS / VOXELS * similarity_scale(T_camera_cube)
    centers = (np.indices((VOXELS,) * 3).reshape(3, -1).T + 0.5) / VOXELS
    points = transform_points(T_camera_cube, centers)
    front = points[:, 2] > 0
    values_m = np.full(len(points), clip_m)
    pixels = np.rint(view.camera.project(points[front])).astype(np.int64)
    u, v = pixels.T
    height, width = view.depth_mm.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    depth_m = np.zeros(len(u))
    at = v[inside], u[inside]
    depth_m[inside] = np.where(view.mask[at], view.depth_mm[at], 0) / 1000.0
    behind = np.where(depth_m > 0, depth_m - points[front, 2], clip_m)
    values_m[front] = np.clip(behind, -clip_m, clip_m)
    return values_m.reshape((VOXELS,) * 3).astype(np.float32)


def read_patchcomplete(path: Path) -> CameraShape:
    """Read `predicted_voxels` as occupied cells of the cube [0, 1]^3.

    Raises:
        PredictionError, UNREADABLE: the file is damaged, or does not hold (32, 32, 32) finite floats.
    """
    with open_plain(path) as file:
        values = arrays_of(file, MOST_BYTES, (KEY,))[KEY].squeeze()
    if values.shape != (VOXELS,) * 3 or values.dtype.kind != "f" or not np.isfinite(values).all():
        raise PredictionError(f"{path.name}: {KEY} must be 32 x 32 x 32 finite floats, voxels")
    return occupancy_shape(values <= SOLID_BELOW, np.eye(4), 1 / VOXELS)


PATCHCOMPLETE = Adapter(write_patchcomplete, "*_pred.npz", read_patchcomplete, "voxels", ("depth", "mask"))
