"""A method that predicts a mesh: here the convex hull of what was measured and of its mirror image.

    kinectbench export views --layout rgbd --benchmark benchmark/
    python examples/adapt_mesh.py views predictions/mesh
    kinectbench check predictions/mesh --benchmark benchmark/

Its frame is that of many generators: millimetres, y up, z backward; method.json says so.
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import trimesh


def complete(points: np.ndarray) -> trimesh.Trimesh:
    """Put your method here: from points (n, 3) to a mesh in the same frame."""
    mirrored = points * [1, 1, -1] + [0, 0, 2 * points[:, 2].min()]  # z backward: the least z is the farthest
    return trimesh.convex.convex_hull(np.concatenate([points, mirrored]))


def main(views: Path, out: Path) -> None:
    for view in sorted(views.glob("*/*/camera.json")):
        mask = cv2.imread(str(view.with_name("mask.png")), cv2.IMREAD_GRAYSCALE) > 0
        points_m = np.load(view.with_name("pointmap_cv.npy"))[mask]
        points_m = points_m[np.isfinite(points_m).all(axis=1)]
        mesh = complete(points_m * [1000, -1000, -1000])  # into the method's unit and axes
        path = out / view.parent.parent.name / f"{view.parent.name}.ply"
        path.parent.mkdir(parents=True, exist_ok=True)
        mesh.export(path)
    method = {"name": out.name, "frame": "camera", "form": "mesh", "unit": "mm", "axes": "opengl"}
    (out / "method.json").write_text(json.dumps(method))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
