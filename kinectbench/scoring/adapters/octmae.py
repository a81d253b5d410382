"""OctMAE (Iwase et al., ECCV 2024) predicts points with normals, in millimetres, in a cube of side 1,280 mm.

Source: its repository, commit 08c1be6. Its `demo.py` reads the files written here, and writes output.pts.
"""

import json
from pathlib import Path

import numpy as np

from kinectbench.core import PredictionError, read_plain
from kinectbench.core.geometry import invert_rigid, transform_points
from kinectbench.core.mesh_files import MAX_FILE_BYTES, numbers_of
from kinectbench.core.types import Bools, Float64
from kinectbench.core.voxels.pair_file import FULL_CELLS, unpack
from kinectbench.release.exchange.rgbd import RgbdView, framed, parts_of, write_color, write_png
from kinectbench.release.release import Release
from kinectbench.scoring.adapters.adapter import Adapter, scaling
from kinectbench.scoring.camera_shape import CameraShape

# Image size that OctMAE's `demo.py` takes (config).
WIDTH, HEIGHT = 640, 480
M_PER_MM = 0.001
# OctMAE's grid: 2^5 cells of 40 mm. x and y lie around the optical axis; z begins five cells in front of the
# cell of the nearest measured point.
CELL_MM, CELLS, CELLS_BEFORE = 40.0, 32, 5
# Number of the truth's cells that are sampled: the share has a standard deviation of 0.002.
COUNTED, SEED = 100_000, 0
# Numbers in a line of output.pts: x, y, z, 0, r, g, b.
NUMBERS = 7


def write_octmae(release: Release, view: RgbdView, folder: Path) -> tuple[RgbdView, dict[str, object]]:
    """Write rgb.png, mask.png, depth.png (uint16, mm) and intrinsics.json.

    Returns:
        The view as written, and entries for camera.json, such as the share of the object outside the cube.
    """
    shown = framed(view, WIDTH, HEIGHT)
    write_color(shown, folder)
    write_png(folder / "mask.png", shown.mask.astype(np.uint8) * 255)
    write_png(folder / "depth.png", shown.depth_mm)
    K = json.dumps({"cam_K": shown.K.ravel().tolist()}, indent=1)
    (folder / "intrinsics.json").write_text(K, encoding="utf-8")
    stated = {"T_camera_method": scaling(M_PER_MM), **_cut_share(release, view)}
    if len(view.object_points_m):
        stated["volume_m"] = cube_mm(view.object_points_m / M_PER_MM) * M_PER_MM
    return shown, stated


def cube_mm(seen_mm: Float64) -> Float64:
    """Return the lowest and the highest corner of OctMAE's cube: (2, 3), millimetres, camera frame.

    The cube is centred on the optical axis; it begins five 40 mm cells in front of the cell of the nearest
    point.

    Args:
        seen_mm: (m, 3), measured points of the object, millimetres, camera frame.
    """
    side = CELLS * CELL_MM
    begin = (np.floor(seen_mm[:, 2].min() / CELL_MM) - CELLS_BEFORE) * CELL_MM
    low = np.array([-side / 2, -side / 2, begin])
    return np.stack([low, low + side])


def in_cube(points_mm: Float64, seen_mm: Float64) -> Bools:
    """Return which points (n, 3) lie in OctMAE's cube: bool (n,); units and `seen_mm` as in `cube_mm`."""
    low, high = cube_mm(seen_mm)
    return np.asarray(((points_mm >= low) & (points_mm < high)).all(axis=1))


def _cut_share(release: Release, view: RgbdView) -> dict[str, object]:
    """Return the share of the object outside OctMAE's cube, as entries for camera.json.

    The entries are {"cut_share": share, "cut_of": "truth" or "seen"}. "truth": the share is of the true
    solid's cells. "seen": the truth is held back, and the share is of the measured points. Return {} if there
    are none, or if no measured point places the cube.
    """
    seen_m, target = view.object_points_m, view.target
    if release.metadata.hides(target.recording):
        points_m, of = seen_m, "seen"
    else:
        full, T_world_grid, size = parts_of(release, target, ("full", "T_world_grid", "voxel_size_m"))
        T_camera_grid = invert_rigid(view.T_world_camera) @ T_world_grid
        cells = np.flatnonzero(unpack(full))
        if len(cells) > COUNTED:
            cells = cells[np.random.default_rng(SEED).integers(0, len(cells), COUNTED)]
        cells_m = (np.stack(np.unravel_index(cells, (FULL_CELLS,) * 3), axis=1) + 0.5) * float(size)
        points_m, of = transform_points(T_camera_grid, cells_m), "truth"
    if not len(seen_m) or not len(points_m):
        return {}
    share = float(1 - in_cube(points_m / M_PER_MM, seen_m / M_PER_MM).mean())
    return {"cut_share": share, "cut_of": of}


def read_octmae(path: Path) -> CameraShape:
    """Read points and normals, camera frame, millimetres, from output.pts.

    The file holds the number of points, then a line `x y z 0 r g b` per point. The colour encodes the normal:
    rgb / 255 = (normal + 1) / 2.

    Raises:
        PredictionError, ValueError, OSError: the file cannot be read, or does not have this format.
    """
    numbers = numbers_of(read_plain(path, MAX_FILE_BYTES))
    if not len(numbers) or len(numbers) != 1 + NUMBERS * numbers[0] or numbers[0] < 1:
        raise PredictionError(f"{path.name}: not a count of points and as many lines of {NUMBERS} numbers")
    rows = numbers[1:].reshape(-1, NUMBERS)
    if not np.isfinite(rows).all():
        raise PredictionError(f"{path.name}: a number is not finite")
    normals = rows[:, 4:] / 255 * 2 - 1
    return CameraShape("points", rows[:, :3], np.zeros((0, 3), np.int64), normals)


OCTMAE = Adapter(write_octmae, "output.pts", read_octmae, "points", ("color", "depth", "mask"))
