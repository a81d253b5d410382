"""Check a pair's input against the published depth, mask and camera of its view.

The partial, `seen` and (with framing `view`) the pair's cube are made from depth, mask and camera alone.
Published depth is rounded to whole millimetres, so each pixel stands for an interval of depths. A pair passes
if some depths within these intervals give its input.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from importlib.util import find_spec

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core import ReleaseError, missing_module
from kinectbench.core.artefacts.views import ViewRow, ViewsFile
from kinectbench.core.geometry import MOST_MM, Camera
from kinectbench.core.types import MM_PER_M, Bools, Float32
from kinectbench.core.voxels.pair_file import FULL_CELLS, Packed, Pair, PairInput, packed_count
from kinectbench.core.voxels.seen_cells import seen_cells
from kinectbench.core.voxels.view_grids import VIEW_SCALE, corner_in_camera, view_cube
from kinectbench.release.contents import VIEW_IMAGES, Contents
from kinectbench.release.view_images import depth_mm, mask_levels

# A pixel of the object in a mask.
ON = 255
# Half a millimetre of rounding, and the 4 micrometres that float32 resolves at 65 m.
ROUNDED_M = 0.000505
# Cells that a corner may be off: matrices of held-back pairs are rounded to 1e-12.
SLACK_CELLS = 1e-6
# Share of the cells of `seen` that may differ: a cell whose centre falls between two pixels may be of either.
MOST_OTHER_SHARE = 0.001
# A cube farther from its camera, in cells, is compared with nothing.
MOST_FAR_CELLS = 1e9
# Largest number of cells that the pixels of one view may reach: 8,300,000 pixels of 4K, of 60 cells each. It
# takes 1 s.
MOST_REACHED = 500_000_000


def no_decoder() -> str | None:
    """Return a message if a package for decoding images is missing here, else None."""
    return None if find_spec("cv2") else missing_module(ModuleNotFoundError(name="cv2"))


def image_names(pair_name: str) -> tuple[str, str]:
    """Return the names of the depth image and the mask that belong to `pairs/<recording>/<view>.npz`."""
    depth, mask = (f"views{pair_name.removeprefix('pairs').removesuffix('.npz')}{end}" for end in VIEW_IMAGES)
    return depth, mask


@dataclass(frozen=True)
class StatedView:
    """The facts about a view in views.json.

    Attributes:
        row: the view's row in views.json; None if it has none.
        has_too_far: whether a depth of 0 may also mean a depth too large for 16 bits.
    """

    row: ViewRow | None = None
    has_too_far: bool = False


def view_lines(
    contents: Contents, name: str, pair: Pair | PairInput, stated: StatedView, whole: Collection[str]
) -> list[str]:
    """Return a message for each difference between a pair's input and the images of its view.

    Nothing is compared if the view has no images, or if they cannot be decoded here (`no_decoder`).

    Args:
        contents: the release.
        name: the pair's file.
        pair: a pair with rigid matrices and a positive, finite `voxel_size_m`.
        stated: what views.json states about the view.
        whole: names of the files whose bytes are the published ones; only these are compared.
    """
    of_depth, of_mask = image_names(name)
    if of_depth not in whole or of_mask not in whole or no_decoder():
        return []
    try:
        depth = depth_mm(contents.read(of_depth), of_depth)
        levels = mask_levels(contents.read(of_mask), of_mask)
    except ReleaseError as error:
        return [str(error)]
    row, lines = stated.row, list[str]()
    if row is not None and None not in (row.width, row.height) and (row.height, row.width) != depth.shape:
        lines.append(
            f"{of_depth}: {_size(depth)} pixels where {ViewsFile.FILE} has {row.width} x {row.height}"
        )
    mask = levels > 0
    if (levels[mask] != ON).any():
        lines.append(f"{of_mask}: holds other values than 0 and {ON}")
    problems = view_problems(pair, depth, mask, has_too_far=stated.has_too_far)
    return lines + [f"{name}: {problem}" for problem in problems]


def view_problems(
    pair: Pair | PairInput, depth: NDArray[np.uint16], mask: Bools, *, has_too_far: bool
) -> Iterator[str]:
    """Yield a message for each difference between a pair's input and its view.

    Args:
        pair: a pair whose matrices are rigid, and whose `voxel_size_m` is positive and finite.
        depth: (height, width) uint16, the view's published depth, millimetres, 0 = none.
        mask: (height, width) bool, the view's published mask.
        has_too_far: whether a depth of 0 may also mean a depth too large for 16 bits.
    """
    if depth.shape != mask.shape:
        yield f"its depth image has {_size(depth)} pixels, its mask {_size(mask)}"
        return
    fx, fy = float(pair.K[0, 0]), float(pair.K[1, 1])
    corner = corner_in_camera(pair.grid, pair.T_world_camera)
    if not (fx > 0 and fy > 0 and np.abs(corner).max() <= MOST_FAR_CELLS * pair.voxel_size_m):
        yield "its cube lies far from its camera: its partial cannot be compared with the view's depth"
        return
    height, width = depth.shape
    camera = Camera(width, height, fx, fy, float(pair.K[0, 2]), float(pair.K[1, 2]))
    yield from _partial_problems(pair, depth, mask, corner)
    yield from _seen_problems(pair, depth, camera, has_too_far=has_too_far)
    if pair.framing == "view":
        yield from _cube_problems(pair, np.where(mask, depth, 0), camera)


def _size(image: NDArray[np.generic]) -> str:
    return f"{image.shape[1]} x {image.shape[0]}"


def _partial_problems(
    pair: Pair | PairInput, depth: NDArray[np.uint16], mask: Bools, corner: NDArray[np.float64]
) -> Iterator[str]:
    """Yield a message if `partial_256` has cells without masked depth, or lacks cells that have masked depth.

    `corner` is the grid's corner, (3,) in the camera frame, metres.
    """
    reached = np.zeros_like(pair.partial_256)
    lost = int(_reach(depth, mask, pair.K, corner, pair.voxel_size_m, pair.partial_256, reached))
    if lost < 0:
        yield "'partial_256' cannot be compared: the pixels of its view reach too many cells"
        return
    # Depth that does not fit in 16 bits is not in the image.
    beyond = int(np.clip((MOST_MM / MM_PER_M - corner[2]) / pair.voxel_size_m - 1, 0, FULL_CELLS)) // 8
    reached[:, :, beyond:] = 255
    if other := packed_count(pair.partial_256 & ~reached):
        yield f"{other} cells of 'partial_256' hold no depth of its view's mask"
    if lost:
        yield f"{lost} pixels of depth in its view's mask lie in no cell of 'partial_256'"


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _reach(depth, mask, K, corner, voxel, partial, reached):  # type: ignore[no-untyped-def]
    """Set in `reached` all cells in which points of masked pixels may lie, given the rounding of depth.

    Return the number of pixels whose points lie inside the cube but in no cell of `partial`; -1 if the pixels
    reach more than `MOST_REACHED` cells. `depth` is in millimetres, and `K` (3, 3) is the camera matrix.
    `corner` is the grid's corner in the camera frame and `voxel` the edge of a cell, both in metres;
    `partial` and `reached` are packed.
    """
    lost, visited = 0, 0
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            if not mask[v, u] or depth[v, u] == 0:
                continue
            near = depth[v, u] / MM_PER_M - ROUNDED_M
            far = depth[v, u] / MM_PER_M + ROUNDED_M
            right, down = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
            first, last = _cells(near, far, corner[2], voxel)
            whole, found = first >= 0 and last < FULL_CELLS, False
            for k in range(max(first, 0), min(last, FULL_CELLS - 1) + 1):
                begin, end = max(near, corner[2] + k * voxel), min(far, corner[2] + (k + 1) * voxel)
                left, i_end = _cells(right * begin, right * end, corner[0], voxel)
                top, j_end = _cells(down * begin, down * end, corner[1], voxel)
                whole &= left >= 0 and top >= 0 and i_end < FULL_CELLS and j_end < FULL_CELLS
                bit = np.uint8(128 >> (k & 7))
                for i in range(max(left, 0), min(i_end, FULL_CELLS - 1) + 1):
                    for j in range(max(top, 0), min(j_end, FULL_CELLS - 1) + 1):
                        reached[i, j, k >> 3] |= bit
                        found |= (partial[i, j, k >> 3] & bit) != 0
                        visited += 1
            lost += whole and not found
            if visited > MOST_REACHED:
                return -1
    return lost


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _cells(one, other, corner, voxel):  # type: ignore[no-untyped-def]
    """Return the first and last cell between the coordinates `one` and `other` along an axis.

    A cell is -1 in front of the grid, which begins at `corner`, and FULL_CELLS behind it.
    """
    first = (min(one, other) - corner) / voxel - SLACK_CELLS
    last = (max(one, other) - corner) / voxel + SLACK_CELLS
    return _cell(first), _cell(last)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _cell(exact):  # type: ignore[no-untyped-def]
    if not exact >= 0:
        return -1
    return FULL_CELLS if exact >= FULL_CELLS else int(exact)


def _seen_problems(
    pair: Pair | PairInput, depth: NDArray[np.uint16], camera: Camera, *, has_too_far: bool
) -> Iterator[str]:
    """Yield a message if `seen` contradicts the published depth, given its rounding and a tolerance."""
    depth_m = depth.astype(np.float32) / np.float32(MM_PER_M)
    measured = depth_m > 0

    def seen(shift_m: float, unmeasured_m: float) -> Packed:
        shifted: Float32 = np.where(measured, depth_m + np.float32(shift_m), np.float32(unmeasured_m))
        return seen_cells(shifted, camera, pair.T_world_camera, pair.grid)

    least = seen(-ROUNDED_M, 0.0)
    most = seen(ROUNDED_M, MOST_MM / MM_PER_M if has_too_far else 0.0)
    other = packed_count(least & ~pair.seen) + packed_count(pair.seen & ~most)
    if other > MOST_OTHER_SHARE * packed_count(most):
        yield f"{other} cells of 'seen' are not as its view's depth has them"


def _cube_problems(pair: Pair | PairInput, object_mm: NDArray[np.uint16], camera: Camera) -> Iterator[str]:
    """Yield a message if the pair's cube differs from `view_cube` of the object's depth.

    `object_mm` is that depth, (height, width) uint16, millimetres, 0 outside the object.
    """
    v, u = np.nonzero(object_mm)
    if not len(v):
        return  # all cells of the partial are reported
    z = object_mm[v, u].astype(np.float32) / np.float32(MM_PER_M)
    points = np.empty((len(z), 3), np.float32)
    points[:, 0], points[:, 1], points[:, 2] = (
        (u - camera.cx) / camera.fx * z,
        (v - camera.cy) / camera.fy * z,
        z,
    )
    expected = view_cube(points, pair.T_world_camera)
    steepest = max(1.0, float(np.abs(points[:, :2] / z[:, None]).max()))
    # A quantile moves at most as far as the points; the side by the scale of twice that, the corner by the
    # middle and half the side.
    moved_m = ROUNDED_M * steepest + SLACK_CELLS * pair.voxel_size_m
    side_m = abs(expected.voxel_size_m - pair.voxel_size_m) * FULL_CELLS
    apart = corner_in_camera(pair.grid, pair.T_world_camera) - corner_in_camera(expected, pair.T_world_camera)
    if side_m > 2 * VIEW_SCALE * moved_m or np.abs(apart).max() > (1 + VIEW_SCALE) * moved_m:
        yield "its cube is not that of its view's depth in its mask"
