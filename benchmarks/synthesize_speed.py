"""Synthetic pairs: CPU time of each step, and 100 pairs a category in the authors' files, read back.

The bar is for a parametric chair subdivided to at least 80,000 faces, over the views of same viewing.
"""

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import numpy as np
import trimesh
from figures import Figure, arguments, at_most, equals, run, told

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "support"))
from recgan_reader import block_maximum, centring_shift, load

from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.voxels.morphology import containment, packed_shell
from kinectbench.core.voxels.pair_file import Pair, pair_bytes, unpack
from kinectbench.core.voxels.resample import reduce_blocks
from kinectbench.core.voxels.seen_cells import seen_cells
from kinectbench.core.voxels.view_grids import object_cube, partial_grids
from kinectbench.lab.simulate.objects import PAPER_FURNITURE, make_object
from kinectbench.lab.synthesize.mesh_check import CheckedMesh, check_mesh
from kinectbench.lab.synthesize.models import SynthesisSettings
from kinectbench.lab.synthesize.pair import VOXELIZERS, make_pair, recgan_bytes
from kinectbench.lab.synthesize.views import DepthCamera, ViewAngles, all_views, camera_pose, virtual_camera
from kinectbench.release.exchange.layouts import recgan_path

Result = TypeVar("Result")

FACES = 80_000
PAIR_MS = 80
SETTINGS = SynthesisSettings(up="z")


def fine_chair() -> TriangleMesh:
    """The chair of the first hundred seeds that has the fewest faces above 80,000 when subdivided."""
    found = [make_object("chair", seed).mesh for seed in range(100)]
    times = [int(np.ceil(np.log(FACES / len(mesh.faces)) / np.log(4))) for mesh in found]
    best = min(range(100), key=lambda n: len(found[n].faces) * 4 ** times[n])
    shape = trimesh.Trimesh(found[best].vertices, found[best].faces, process=False)
    for _ in range(times[best]):
        shape = shape.subdivide()
    return TriangleMesh(np.asarray(shape.vertices), np.asarray(shape.faces, dtype=np.int32))


class Clock:
    """CPU milliseconds per step, added up; each step is run twice, and the better time counts."""

    def __init__(self) -> None:
        self.spent_ms: dict[str, float] = {}

    def time(self, step: str, action: Callable[[], Result]) -> Result:
        spent = []
        for _ in range(2):
            started = time.process_time()
            result = action()
            spent.append(1000 * (time.process_time() - started))
        self.spent_ms[step] = self.spent_ms.get(step, 0.0) + min(spent)
        return result


def one_pair(checked: CheckedMesh, eye: DepthCamera, view: ViewAngles, clock: Clock) -> int:
    """Every step of a pair by itself, and then the whole of it; returns the file's size in bytes."""
    mesh, camera = checked.mesh, eye.camera
    pose = clock.time("camera pose", lambda: camera_pose(eye.corners_world, view, camera, "z"))
    depth_m = clock.time("depth", lambda: eye.depth_m(pose))
    grid = object_cube(eye.corners_world, pose)
    full = clock.time("full", lambda: VOXELIZERS[checked.rule](mesh.vertices, mesh.faces, grid))
    grids = clock.time("partial", lambda: partial_grids(depth_m, camera, pose, grid))
    clock.time("shell", lambda: packed_shell(full))
    clock.time("seen", lambda: seen_cells(depth_m, camera, pose, grid, noisy=False))
    clock.time("containment", lambda: containment(grids[1], full))
    pair, _ = make_pair(checked, eye, view, SETTINGS)
    clock.time("encode", lambda: pair_bytes(pair))
    return len(clock.time("whole pair", lambda: pair_bytes(make_pair(checked, eye, view, SETTINGS)[0])))


def speed(name: str, checked: CheckedMesh, views: int, bar: float | None) -> Iterator[Figure]:
    """CPU time of a mesh's pairs by step."""
    clock = Clock()
    eye = clock.time(
        "camera made ready, once a model",
        lambda: DepthCamera(checked.mesh, virtual_camera(SETTINGS.image_px)),
    )
    one_pair(checked, eye, all_views(5)[0], Clock())  # compiles
    chosen = all_views(5)[:: 125 // views][:views]
    sizes = [one_pair(checked, eye, view, clock) for view in chosen]
    yield told(f"{name}: faces, rule", [len(checked.mesh.faces), checked.rule])
    ready_ms = clock.spent_ms.pop("camera made ready, once a model")
    whole_ms = clock.spent_ms.pop("whole pair") / len(sizes)
    for step, spent in clock.spent_ms.items():
        yield told(f"{name}: {step}, CPU ms", spent / len(sizes))
    yield told(f"{name}: kB a pair", float(np.mean(sizes)) / 1000)
    yield told(f"{name}: camera made ready, once a model, CPU ms", ready_ms)
    text = f"{name}: whole pair, CPU ms"
    yield told(text, whole_ms) if bar is None else at_most(text, whole_ms, bar)


def readback(category: str, pairs: int, folder: Path) -> Iterator[Figure]:
    """Pairs of one category in the authors' files, read back by the loading rule."""
    checked = check_mesh(make_object(category, 0).mesh, SETTINGS.max_faces)
    eye = DepthCamera(checked.mesh, virtual_camera(SETTINGS.image_px))
    wrong = mirrored = 0
    for view in all_views(5)[:pairs]:
        pair, _ = make_pair(checked, eye, view, SETTINGS)
        paths = [
            folder / recgan_path(kind, category, "train", view.n**3, f"{category}-0_{view.name}")
            for kind in ("25d", "3d")
        ]
        for path, content in zip(paths, recgan_bytes(pair), strict=True):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        same, flipped = compare(pair, paths[0].read_bytes(), paths[1].read_bytes())
        wrong += not same
        mirrored += flipped
    yield equals(f"{category}: pairs of {pairs} that are not read back as they were", wrong, 0)
    yield told(f"{category}: pairs that would pass with an axis mirrored", mirrored)


def compare(pair: Pair, seen_file: bytes, full_file: bytes) -> tuple[bool, bool]:
    """Whether partial and full come back cell by cell; whether the full would also with x or y mirrored."""
    full, seen = unpack(pair.full), unpack(pair.partial_256)
    shift = centring_shift(full | seen)
    back = load(full_file) > 0
    back_64 = block_maximum(load(seen_file)) > 0
    moved = np.roll(full, shift, axis=(0, 1, 2))
    expected_64 = reduce_blocks(np.roll(seen, shift, axis=(0, 1, 2)), "any")
    same = np.array_equal(back[::-1, ::-1], moved) and np.array_equal(back_64[::-1, ::-1], expected_64)
    mirrors = (back[:, ::-1], back[::-1, :], back[::-1, ::-1, ::-1])
    return same, any(np.array_equal(mirror, moved) for mirror in mirrors)


def measure(views: int, pairs: int) -> Iterator[Figure]:
    chair = check_mesh(fine_chair(), SETTINGS.max_faces)
    yield from speed("chair", chair, views, PAIR_MS)
    yield from speed("chair, authors' rule", CheckedMesh(chair.mesh, "six-rays"), views, None)
    with TemporaryDirectory() as folder:
        for category in sorted(PAPER_FURNITURE) if pairs else ():
            yield from readback(category, pairs, Path(folder))


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--views", type=int, default=25, help="timed, of 125")
    parser.add_argument("--pairs", type=int, default=100, help="read back in each category, up to 125")
    options = parser.parse_args()
    run(options, lambda: [*measure(options.views, options.pairs)])


if __name__ == "__main__":
    main()
