"""From which size on a sensor tells nothing: cubes and balls of falling size on a table, from .5, 1 and 2 m.

A Kinect v1 at its full resolution, exact poses. What it tells is measured with the table's plane and a box
around the thing by hand; whether it would be chosen without is asked apart. What lies in --build is brought
up to date and measured.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
from builds import CORES, build_root
from figures import Figure, arguments, run, told
from tabletop import PATH, Recording, Row, measured

from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import transform_points
from kinectbench.core.geometry.mesh import read_own_ply, write_ply
from kinectbench.engine.steps import read_tracked
from kinectbench.lab.simulate.objects.shapes import surface
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.lab.simulate.truth import read_truth, truth_folder
from kinectbench.settings.models import SegmentationSettings
from kinectbench.stages.segment.find.gravity import floor_hint
from kinectbench.stages.segment.find.object import find_floor_and_object

SIZES_MM = (160, 80, 40, 20)
DISTANCES_M = (0.5, 1.0, 2.0)
SHAPES = ("cube", "ball")
FRAMES = 40
# So much of a thing's volume is right where the sensor tells its shape (own choice).
TELLS_IOU = 0.8


def shape_of(shape: str, size_mm: int) -> manifold3d.Manifold:
    """A cube or a ball that stands on z = 0, metres."""
    size_m = size_mm / 1000
    if shape == "cube":
        return manifold3d.Manifold.cube((size_m, size_m, size_m), True).translate((0, 0, size_m / 2))
    return manifold3d.Manifold.sphere(size_m / 2, 96).translate((0, 0, size_m / 2))


def recordings(root: Path) -> list[Recording]:
    """Each shape of each size from each distance; their meshes are written into `root`."""
    (root / "meshes").mkdir(exist_ok=True)
    found = []
    for shape in SHAPES:
        for size_mm in SIZES_MM:
            mesh, size_m = root / "meshes" / f"{shape}{size_mm}.ply", size_mm / 1000
            write_ply(surface(shape_of(shape, size_mm)), mesh)
            # A cube may be turned: its diagonal is less than one and a half edges.
            size = [1.5 * size_m + 0.02] * 2 + [size_m + 0.02]
            around = {"center_m": [0, 0, size_m / 2 + 0.01], "size_m": size}
            said = {"floor": {"plane_world": [0, 0, 1, 0]}, "box": around}
            found += [
                Recording(_name(shape, size_mm, far_m), shape, _spec(mesh, far_m), said)
                for far_m in DISTANCES_M
            ]
    return found


def is_chosen(build: Path, truth: Path) -> bool:
    """Whether the thing is what is chosen without a box and without a plane by hand."""
    sequence, trajectory = read_tracked(build)[:2]
    scene = read_own_ply(build / "reconstruction" / "mesh.ply")
    try:
        chosen = find_floor_and_object(
            scene, trajectory, None, SegmentationSettings(), floor_hint(sequence, trajectory)
        )
    except SegmentationError:
        return False
    true = read_truth(truth).mesh_world.vertices
    corners = transform_points(chosen.floor.T_world_floor, chosen.box.corners_floor())
    apart_m = np.abs((corners.min(0) + corners.max(0) - true.min(0) - true.max(0))[:2]).max() / 2
    size_m = float(np.ptp(true, axis=0).max())
    return bool(apart_m < size_m / 2 and max(chosen.box.size_m) < 2 * size_m)


def _name(shape: str, size_mm: int, distance_m: float) -> str:
    return f"{shape}{size_mm}-{100 * distance_m:.0f}cm"


def _spec(mesh: Path, distance_m: float) -> SimulationSpec:
    path = PATH | {"frames": FRAMES, "rate_hz": 4.0, "distance_m": distance_m, "reach_share": 0.04}
    return SimulationSpec.model_validate(
        {
            "mesh": str(mesh),
            "seed": 1,
            "path": path,
            "scene": {"stands_on": "table", "clutter": 2},
            "save_depth": False,
        }
    )


def figures(rows: list[Row], root: Path) -> Iterator[Figure]:
    """For each distance and shape: IoU by size, which are chosen, and the least size that is told."""
    by_name = {row.name: row for row in rows}
    for shape in SHAPES:
        for far_m in DISTANCES_M:
            of = {size: by_name[_name(shape, size, far_m)] for size in SIZES_MM}
            texts = [f"{size} mm {row.known_iou:.2f}" for size, row in of.items()]
            chosen = [
                f"{size}"
                for size, row in of.items()
                if is_chosen(root / "build" / row.name, truth_folder(root / "recordings" / row.name))
            ]
            least = min((size for size, row in of.items() if row.known_iou >= TELLS_IOU), default=None)
            yield told(f"{shape} from {far_m:g} m: IoU on what is known, with a box", ", ".join(texts))
            yield told(f"{shape} from {far_m:g} m: least size that is told, mm", least)
            yield told(f"{shape} from {far_m:g} m: chosen without a box, mm", ", ".join(chosen))


def main() -> None:
    """Run from the command line."""
    parser = arguments(__doc__)
    parser.add_argument("--workers", type=int, default=CORES)
    parser.add_argument("--build", type=Path, metavar="DIR", help="build there and keep it")
    options = parser.parse_args()
    details: dict[str, Any] = {}

    def measure() -> list[Figure]:
        with build_root(options.build) as root:
            rows = measured(root, recordings(root), "trust", options.workers)
            found = [*figures(rows, root)]
        details["objects"] = json.loads(json.dumps([asdict(row) for row in rows]))
        return found

    run(options, measure, details)


if __name__ == "__main__":
    main()
