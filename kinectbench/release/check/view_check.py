"""Check a pair's input against the published depth, mask and camera of its view.

The partial, `seen` and (with framing `view`) the pair's cube are made from depth, mask and camera alone.
Published depth is rounded to whole millimetres, so each pixel stands for an interval of depths. A pair passes
if some depths within these intervals give its input.

Its grids and matrices are checked, too: they must be as docs/format.md defines them.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core import ReleaseError, missing_module
from kinectbench.core.artefacts.views import ViewRow, ViewsFile
from kinectbench.core.geometry import MOST_MM, ORTHONORMAL_TOLERANCE, Camera, is_rigid
from kinectbench.core.types import MM_PER_M, Bools, Float32
from kinectbench.core.voxels.pair_file import (
    FULL_CELLS,
    OPTIONAL,
    Packed,
    Pair,
    PairInput,
    pack,
    packed_count,
    unpack,
)
from kinectbench.core.voxels.resample import reduce_blocks
from kinectbench.core.voxels.seen_cells import seen_cells
from kinectbench.core.voxels.solid import packed_shell
from kinectbench.core.voxels.view_grids import VIEW_SCALE, containment, corner_in_camera, view_cube
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

    Nothing is compared if the view has no images, or if they cannot be decoded here (`no_decoder`). The pair
    has rigid matrices and a positive, finite `voxel_size_m`. Only files in `whole`, whose bytes are the
    published ones, are compared.
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


LEAST_TRUSTED_SHARE = 0.5


def pair_problems(
    pair: Pair,
    *,
    min_containment: float,
    framing: str,
    partial_rule: str,
    unknown_shares: Mapping[str, float] = {},
    surface_sigma_m: float | None = None,
) -> Iterator[str]:
    """Yield a message for each fault of a pair; messages do not name the file.

    Args:
        pair: a pair whose keys, shapes and dtypes are checked already.
        min_containment: smallest share of the partial inside the full shape, from the benchmark's settings.
        framing: the framing in benchmark.json: cubes are fitted to the "object" or to the "view".
        partial_rule: the rule for partials in benchmark.json, "any" or "majority".
        unknown_shares: {file name: unknown share of the true shape that this file states}. Early releases
            state it in fewer files or in none.
        surface_sigma_m: the surface's standard deviation as benchmark.json states it; None if it does not.
    """
    yield from input_problems(pair, framing=framing, partial_rule=partial_rule)
    if not (np.isfinite(pair.surface_sigma_m) and pair.surface_sigma_m >= 0):
        yield f"surface_sigma_m is {pair.surface_sigma_m}, not a standard deviation"
    elif surface_sigma_m is not None and pair.surface_sigma_m != surface_sigma_m:
        yield f"surface_sigma_m is {pair.surface_sigma_m} where benchmark.json has {surface_sigma_m}"
    if not pair.full.any():
        yield "'full' is empty"
    wrong = packed_count(pair.shell ^ packed_shell(pair.full))
    if wrong:
        yield f"{wrong} cells of 'shell' are not as the surface of 'full'"
    yield from _trust_problems(pair, "known", pair.known)
    for name in OPTIONAL:
        grid: Packed | None = getattr(pair, name)
        if grid is not None and (beyond := packed_count(grid & ~pair.known)):
            yield f"{beyond} cells of '{name}' are not 'known'"
    found = pair.stated_unknown_share
    for file, said in unknown_shares.items():
        if said != found:
            yield f"{found} of the true shape is unknown where {file} has {said}"
    # These are the cells before the partial rule thinned them out; cells outside the cube are not in the
    # file.
    touched = pack(reduce_blocks(unpack(pair.partial_256), "any"))
    inside = containment(touched, pair.full)
    if inside < min_containment:
        yield f"containment is {inside:.3f}, below {min_containment}"


def input_problems(pair: Pair | PairInput, *, framing: str, partial_rule: str) -> Iterator[str]:
    """Yield a message for each fault of a pair's input (the part that is published even without truth).

    `framing` and `partial_rule` are those stated in benchmark.json, as in `pair_problems`.
    """
    for name in ("T_world_grid", "T_world_camera"):
        if not is_rigid(getattr(pair, name)):
            yield f"{name} is not a rotation and a shift"
    if not np.allclose(pair.T_world_grid[:3, :3], pair.T_world_camera[:3, :3], atol=ORTHONORMAL_TOLERANCE):
        yield "the grid's axes are not the view's"
    if not (pair.K[0, 0] > 0 and pair.K[1, 1] > 0):
        yield "the focal lengths in K are not positive"
    for name, expected in (("framing", framing), ("partial_rule", partial_rule)):
        if getattr(pair, name) != expected:
            yield f"{name} is '{getattr(pair, name)}' where the benchmark has '{expected}'"
    if not pair.partial.any():
        yield "'partial' is empty"
    if pair.partial_rule in ("any", "majority"):
        reduced = pack(reduce_blocks(unpack(pair.partial_256), pair.partial_rule))
        differ = packed_count(reduced ^ pair.partial)
        if differ:
            yield f"{differ} cells of 'partial' are not 'partial_256' reduced by '{pair.partial_rule}'"
    yield from _trust_problems(pair, "seen", pair.seen)
    yield from _behind_problems(pair)


def _trust_problems(pair: Pair | PairInput, name: str, grid: Packed) -> Iterator[str]:
    """Yield a message if less than half of `partial_256` lies in `grid`, which is `known` or `seen`.

    The surface that a view measures is both known and seen, so nearly all of `partial_256` should lie in both
    grids; every usable recording reaches one half. The release's files do not suffice to compute either grid.
    """
    cells, inside = packed_count(pair.partial_256), packed_count(pair.partial_256 & grid)
    if inside < LEAST_TRUSTED_SHARE * cells:
        yield f"only {inside} of the {cells} cells of 'partial_256' are '{name}'"


def _behind_problems(pair: Pair | PairInput) -> Iterator[str]:
    """Yield a message if `seen` contains cells behind the camera."""
    if pair.voxel_size_m > 0:
        corner_z_m = float(
            (pair.T_world_grid[:3, 3] - pair.T_world_camera[:3, 3]) @ pair.T_world_camera[:3, 2]
        )
        behind = int(np.clip(np.floor(0.5 - corner_z_m / pair.voxel_size_m), 0, FULL_CELLS))
        if unpack(pair.seen)[:, :, :behind].any():
            yield "'seen' holds cells behind the camera"
