"""Making the pairs of one recording: CPU time, and the cells of each against their plain definitions.

BUILD is a folder `build/<recording>` with views; 50 pairs are made of them, over again if there are fewer.
Everything from reading a frame to the file's bytes counts; compiling does not. The best of three rounds.
"""

import time
from pathlib import Path

import numpy as np
from figures import Figure, arguments, at_most, equals, run, stated
from numpy.typing import NDArray
from references import shell_of

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.errors import StorageError
from kinectbench.core.geometry import Grid, transform_points
from kinectbench.core.geometry.depth import depth_sigma_m
from kinectbench.core.sequence import Sequence
from kinectbench.core.voxels.pair_file import Pair, pair_bytes, unpack
from kinectbench.engine.steps import read_tracked
from kinectbench.settings.models import PairSettings
from kinectbench.stages.pairs import FullShape, full_shape, make_pair
from kinectbench.stages.sample_views.views import View, read_views
from kinectbench.stages.segment.object_model import ObjectModel, read_object

PAIRS, ROUNDS, CPU_S = 50, 3, 3.0
CHECKED, CELLS = 3, 300_000


def made(view: View, sequence: Sequence, shape: FullShape) -> Pair:
    """The pair of a view that passes."""
    result = make_pair(view, sequence, shape, PairSettings())
    if result.pair is None:
        raise StorageError(f"view {view.name} gives no pair: {result.reason}")
    return result.pair


def wrong_cells(pair: Pair, view: View, sequence: Sequence, model: ObjectModel) -> dict[str, int]:
    """Cells, of many drawn at random, that differ from the definition; not those that rounding decides.

    The definitions are those of the format page, a cell at a time, in plain numpy.
    """
    cells = np.random.default_rng(0).integers(0, 256, (CELLS, 3))
    points_world = transform_points(pair.T_world_grid, (cells + 0.5) * pair.voxel_size_m)
    depth_m = sequence.depth_m(view.frame)
    seen, tie = plain_seen(pair, points_world, depth_m)
    found = {name: unpack(getattr(pair, name))[tuple(cells.T)] for name in ("seen", "known")}
    return {
        "seen": int(((found["seen"] != seen) & ~tie).sum()),
        "known": int((found["known"] != plain_known(model, points_world)).sum()),
        "shell": int(np.unpackbits(pair.shell ^ shell_of(unpack(pair.full))).sum()),
        "partial": int((unpack(pair.partial_256) != plain_partial(pair, view, depth_m)).sum()),
    }


def plain_seen(
    pair: Pair, points_world: NDArray[np.float64], depth_m: NDArray[np.float32]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """What the view has seen, and where rounding decides."""
    x, y, z = transform_points(np.linalg.inv(pair.T_world_camera), points_world).T
    u, v = pair.K[0, 0] * x / z + pair.K[0, 2], pair.K[1, 1] * y / z + pair.K[1, 2]
    column, row = np.rint(u).astype(int), np.rint(v).astype(int)
    height, width = depth_m.shape
    inside = (z > 0) & (column >= 0) & (row >= 0) & (column < width) & (row < height)
    d = np.where(inside, depth_m[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)], 0)
    limit_m = d + 2 * depth_sigma_m(d) + pair.voxel_size_m
    tie = (np.minimum(abs(u % 1 - 0.5), abs(v % 1 - 0.5)) < 1e-6) | (abs(z - limit_m) < 1e-6)
    return (d > 0) & (z <= limit_m), tie


def plain_known(model: ObjectModel, points_world: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Where the label is not unknown: of the fine grid, else of the coarse one."""
    labels = np.full(len(points_world), int(Label.UNKNOWN))
    levels: list[tuple[Grid, NDArray[np.uint8]]] = [
        (model.surround, model.surround_labels),
        (model.shape.grid, model.shape.labels),
    ]
    for grid, values in levels:
        index = np.floor(transform_points(grid.T_grid_world, points_world) / grid.voxel_size_m).astype(int)
        inside = np.all((index >= 0) & (index < grid.shape), axis=1)
        labels[inside] = values[tuple(index[inside].T)]
    return np.asarray(labels != Label.UNKNOWN)


def plain_partial(pair: Pair, view: View, depth_m: NDArray[np.float32]) -> NDArray[np.bool_]:
    """The cells of each masked pixel's point."""
    v, u = np.nonzero(view.mask & (depth_m > 0))
    d = depth_m[v, u].astype(np.float64)
    points = np.stack([(u - pair.K[0, 2]) / pair.K[0, 0] * d, (v - pair.K[1, 2]) / pair.K[1, 1] * d, d], -1)
    in_grid = transform_points(np.linalg.inv(pair.T_world_grid) @ pair.T_world_camera, points)
    index = np.floor(in_grid / pair.voxel_size_m).astype(int)
    cells = np.zeros((256,) * 3, bool)
    cells[tuple(index[np.all((index >= 0) & (index < 256), axis=1)].T)] = True
    return cells


def measure(build: Path) -> list[Figure]:
    """Time 50 pairs, and check some of them."""
    sequence, model, views = (
        read_tracked(build)[0],
        read_object(build / "object"),
        read_views(build / "views"),
    )
    pair_bytes(made(views[0], sequence, full_shape(model)))  # compiles
    cpu_s = float("inf")
    for _ in range(ROUNDS):
        started = time.process_time()
        shape = full_shape(model)
        for number in range(PAIRS):
            pair_bytes(made(views[number % len(views)], sequence, shape))
        cpu_s = min(cpu_s, time.process_time() - started)
    wrong: dict[str, int] = {}
    for view in views[:CHECKED]:
        here = wrong_cells(made(view, sequence, shape), view, sequence, model)
        wrong = {name: wrong.get(name, 0) + count for name, count in here.items()}
    camera = sequence.camera
    return [
        stated("image, px", f"{camera.width} x {camera.height}"),
        stated("faces of the shape", len(model.shape.mesh.faces)),
        at_most(f"{PAIRS} pairs, CPU s", cpu_s, CPU_S),
        *(equals(f"wrong cells of `{name}`", count, 0) for name, count in wrong.items()),
    ]


if __name__ == "__main__":
    parser = arguments(__doc__)
    parser.add_argument("build", type=Path, metavar="BUILD")
    options = parser.parse_args()
    run(options, lambda: measure(options.build))
