"""Solid voxelisers at 256^3: speed and errors on closed meshes, and what becomes of open ones.

Every voxeliser gets the same vertices in cells, in turn, in one process; CPU time, the best of the rounds.
Needs the `bench` packages. Without DATA only the generated mesh is measured.
"""

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numba
import numpy as np
import trimesh
from figures import Figure, arguments, at_least, at_most, run, told
from numpy.typing import NDArray

from kinectbench.core.geometry import Grid, rigid, rotation_from_quaternion_xyzw, transform_points
from kinectbench.core.types import Bools
from kinectbench.core.voxels.open_mesh import voxelize_open
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.core.voxels.solid import voxelize_solid
from kinectbench.core.voxels.view_grids import object_cube

SIDE = 256
TRIMESH_RATIO = 100
VTK_RATIO = 5
MAX_WRONG = 10
# Cells whose centre is nearer to a face than this are decided by solid angles whatever the others say.
DOUBTFUL_CELLS = 1e-3
BENCHED = ("aws_ChairA_01", "aws_ChairD_01", "aws_KitchenTable_01")


def generated() -> trimesh.Trimesh:
    """A dented, stretched ball of 81,920 faces."""
    ball = trimesh.creation.icosphere(subdivisions=6)
    x, y, z = ball.vertices.T
    ball.vertices *= (1 + 0.2 * np.sin(5 * x) * np.cos(4 * y) + 0.1 * np.sin(7 * z))[:, None] * [
        0.3,
        0.4,
        0.5,
    ]
    return ball


def framed(mesh: trimesh.Trimesh) -> Grid:
    """The cube of a pair around a mesh, turned."""
    rotation = rotation_from_quaternion_xyzw([0.3, 0.1, -0.4, 0.8])
    return object_cube(np.asarray(mesh.vertices), rigid(rotation, np.zeros(3)))


def centred_cells(mesh: trimesh.Trimesh, grid: Grid) -> NDArray[np.float64]:
    """The vertices in cells, with the centre of cell (0, 0, 0) at the origin."""
    return transform_points(grid.T_grid_world, mesh.vertices) / grid.voxel_size_m - 0.5


def by_kinectbench(mesh: trimesh.Trimesh, grid: Grid) -> NDArray[np.uint8]:
    return voxelize_solid(mesh.vertices, mesh.faces.astype(np.int32), grid)


def by_vtk(cells: NDArray[np.float64], faces: NDArray[np.int64]) -> Bools:
    """vtkPolyDataToImageStencil, at its default tolerance."""
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy

    points, triangles, surface = vtk.vtkPoints(), vtk.vtkCellArray(), vtk.vtkPolyData()
    points.SetData(numpy_to_vtk(cells, deep=True))
    triangles.SetData(3, numpy_to_vtkIdTypeArray(faces.ravel(), deep=True))
    surface.SetPoints(points)
    surface.SetPolys(triangles)
    stencil, image = vtk.vtkPolyDataToImageStencil(), vtk.vtkImageStencilToImage()
    stencil.SetInputData(surface)
    stencil.SetOutputSpacing(1, 1, 1)
    stencil.SetOutputWholeExtent(0, SIDE - 1, 0, SIDE - 1, 0, SIDE - 1)
    image.SetInputConnection(stencil.GetOutputPort())
    image.SetInsideValue(1)
    image.SetOutsideValue(0)
    image.SetOutputScalarTypeToUnsignedChar()
    image.Update()
    flat = vtk_to_numpy(image.GetOutput().GetPointData().GetScalars())
    return np.asarray(flat.reshape((SIDE,) * 3).transpose(2, 1, 0) > 0)


def by_trimesh(cells: NDArray[np.float64], faces: NDArray[np.int64]) -> Bools:
    """`voxelized(pitch).fill()`: its voxels have their centres at whole multiples of the pitch."""
    filled = trimesh.Trimesh(cells, faces, process=False).voxelized(1.0).fill()
    solid = np.zeros((SIDE,) * 3, bool)
    low = np.rint(filled.translation).astype(int)
    solid[tuple(slice(a, a + n) for a, n in zip(low, filled.shape, strict=True))] = filled.matrix
    return solid


def exact(mesh: trimesh.Trimesh, cells: NDArray[np.float64], ours: Bools, other: Bools) -> Bools:
    """Cells whose winding number is not zero.

    By solid angles in float64 wherever two independent voxelisers differ or the centre is nearly on the
    surface; elsewhere they agree, and no rounding can matter.
    """
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    tensor = o3d.core.Tensor.from_numpy
    scene.add_triangles(tensor(cells.astype(np.float32)), tensor(mesh.faces.astype(np.uint32)))
    near = np.argwhere(border_cells(ours) | border_cells(other)).astype(np.float32)
    distance = scene.compute_distance(tensor(near), nthreads=1).numpy()
    doubtful = ours != other
    doubtful[tuple(near[distance < DOUBTFUL_CELLS].astype(int).T)] = True
    solid = ours.copy()
    numbers = winding_numbers(np.argwhere(doubtful).astype(np.float64), cells[mesh.faces])
    solid[doubtful] = np.abs(numbers) > 0.5
    return solid


def border_cells(solid: Bools) -> Bools:
    """Cells with a neighbour of the other kind."""
    border = np.zeros_like(solid)
    for axis in range(3):
        cells, marks = np.moveaxis(solid, axis, 0), np.moveaxis(border, axis, 0)
        differ = cells[1:] != cells[:-1]
        marks[1:] |= differ
        marks[:-1] |= differ
    return border


@numba.njit(cache=True)
def winding_numbers(points, triangles):  # type: ignore[no-untyped-def]
    """By solid angles (van Oosterom & Strackee 1983): points (n, 3), triangles (m, 3, 3)."""
    numbers = np.zeros(len(points))
    for n in range(len(points)):
        for m in range(len(triangles)):
            a, b, c = triangles[m, 0] - points[n], triangles[m, 1] - points[n], triangles[m, 2] - points[n]
            la, lb, lc = np.sqrt((a * a).sum()), np.sqrt((b * b).sum()), np.sqrt((c * c).sum())
            top = a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            top += a[2] * (b[0] * c[1] - b[1] * c[0])
            dots = (a * b).sum() * lc + (b * c).sum() * la + (c * a).sum() * lb
            numbers[n] += np.arctan2(top, la * lb * lc + dots)
    return numbers / (2 * np.pi)


def timed(action: Callable[[], object]) -> tuple[float, object]:
    """CPU milliseconds of this process, and the result."""
    started = time.process_time()
    result = action()
    return 1000 * (time.process_time() - started), result


def closed_figures(name: str, mesh: trimesh.Trimesh, rounds: int, barred: bool) -> Iterator[Figure]:
    """Speeds and errors on one closed mesh."""
    grid = framed(mesh)
    cells, faces = centred_cells(mesh, grid), mesh.faces.astype(np.int64)
    ways: dict[str, Callable[[], object]] = {
        "kinectbench": lambda: by_kinectbench(mesh, grid),
        "VTK": lambda: by_vtk(cells, faces),
        "trimesh": lambda: by_trimesh(cells, faces),
    }
    by_kinectbench(mesh, grid)  # compiles
    times: dict[str, list[float]] = {way: [] for way in ways}
    found: dict[str, Bools] = {}
    for _ in range(rounds):
        for way, action in ways.items():
            spent_ms, result = timed(action)
            times[way].append(spent_ms)
            found[way] = unpack(result) if way == "kinectbench" else result  # type: ignore[assignment]
    truth = exact(mesh, cells, found["kinectbench"], found["VTK"])
    best = {way: min(spent) for way, spent in times.items()}
    yield told(f"{name}: faces", len(faces))
    yield told(f"{name}: voxels inside", int(truth.sum()))
    for way, spent in best.items():
        yield told(f"{name}: {way}, CPU ms", spent)
    wrong = {way: int((solid != truth).sum()) for way, solid in found.items()}
    yield at_most(f"{name}: kinectbench, voxels wrong", wrong["kinectbench"], MAX_WRONG)
    yield told(f"{name}: VTK, voxels wrong", wrong["VTK"])
    yield told(f"{name}: trimesh, voxels wrong", wrong["trimesh"])
    for way, bar in (("trimesh", TRIMESH_RATIO), ("VTK", VTK_RATIO)):
        ratio = best[way] / best["kinectbench"]
        text = f"{name}: times faster than {way}"
        yield at_least(text, ratio, bar) if barred else told(text, ratio)


def open_figures(name: str, mesh: trimesh.Trimesh) -> Iterator[Figure]:
    """What becomes of a mesh that is not watertight."""
    grid = framed(mesh)
    cells, faces = centred_cells(mesh, grid), mesh.faces.astype(np.int32)
    voxelize_open(mesh.vertices, faces, grid)
    spent_ms, packed = timed(lambda: voxelize_open(mesh.vertices, faces, grid))
    ours = unpack(packed)  # type: ignore[arg-type]
    winding = unpack(voxelize_solid(mesh.vertices, faces, grid))
    trimesh_ms, other = timed(lambda: by_trimesh(cells, faces.astype(np.int64)))
    yield told(f"{name}: faces, border edges", [len(faces), border_edges(mesh)])
    yield told(f"{name}: rule", "six-rays")
    yield told(f"{name}: CPU ms, trimesh's", [spent_ms, trimesh_ms])
    yield told(f"{name}: voxels", int(ours.sum()))
    yield told(f"{name}: voxels, winding scanlines", int(winding.sum()))
    yield told(f"{name}: IoU with trimesh's fill", iou(ours, other))  # type: ignore[arg-type]


def border_edges(mesh: trimesh.Trimesh) -> int:
    """Edges that belong to one face only."""
    return int((np.unique(mesh.edges_sorted, axis=0, return_counts=True)[1] == 1).sum())


def iou(a: Bools, b: Bools) -> float:
    return float((a & b).sum() / (a | b).sum())


def measure(data: Path | None, rounds: int) -> list[Figure]:
    figures = [*closed_figures("81,920 faces", generated(), rounds, barred=True)]
    folder = data / "furniture_meshes" if data else None
    for path in sorted(folder.glob("*.obj")) if folder else []:
        mesh = trimesh.load(path, force="mesh", process=False)
        if not mesh.is_watertight:
            figures += open_figures(path.stem, mesh)
        elif path.stem in BENCHED:
            figures += closed_figures(path.stem, mesh, 1, barred=False)
    return figures


def main() -> None:
    parser = arguments(__doc__)
    given = os.environ.get("KINECTBENCH_DATA")
    parser.add_argument("data", type=Path, nargs="?", default=Path(given) if given else None)
    parser.add_argument("--rounds", type=int, default=3, help="of which the best counts")
    options = parser.parse_args()
    run(options, lambda: measure(options.data, options.rounds))


if __name__ == "__main__":
    main()
