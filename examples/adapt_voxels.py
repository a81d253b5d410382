"""A method that predicts cells of a grid of its own: here all cells behind what was measured.

    kinectbench export views --layout rgbd --benchmark benchmark/
    python examples/adapt_voxels.py views predictions/voxels
    kinectbench check predictions/voxels --benchmark benchmark/

Each file says where its grid lies: `T_camera_grid`, and `voxel_size_m`, the edge of a cell.
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np

CELLS = 64


def complete(points: np.ndarray) -> np.ndarray:
    """Put your method here: from points (n, 3) in cells to (64, 64, 64) bool; x right, y down, z forward."""
    grid = np.zeros((CELLS, CELLS, CELLS), bool)
    x, y, z = np.clip(points.astype(int), 0, CELLS - 1).T
    nearest = np.full((CELLS, CELLS), CELLS)
    np.minimum.at(nearest, (x, y), z)
    last = int(z.max())
    for column in np.argwhere(nearest < CELLS):
        grid[column[0], column[1], nearest[tuple(column)] : last + 1] = True
    return grid


def main(views: Path, out: Path) -> None:
    for view in sorted(views.glob("*/*/camera.json")):
        mask = cv2.imread(str(view.with_name("mask.png")), cv2.IMREAD_GRAYSCALE) > 0
        points_m = np.load(view.with_name("pointmap_cv.npy"))[mask]
        points_m = points_m[np.isfinite(points_m).all(axis=1)]
        low_m = points_m.min(axis=0)
        cell_m = float((points_m.max(axis=0) - low_m).max()) / CELLS
        T = np.eye(4)
        T[:3, 3] = low_m
        path = out / view.parent.parent.name / f"{view.parent.name}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        cells = complete((points_m - low_m) / cell_m)
        np.savez_compressed(path, occupancy=cells, T_camera_grid=T, voxel_size_m=cell_m)
    (out / "method.json").write_text(json.dumps({"name": out.name, "frame": "camera", "form": "voxels"}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
