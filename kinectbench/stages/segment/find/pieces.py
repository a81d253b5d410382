"""The connected pieces of the surface above the floor: which is the object, and why that may be wrong."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial import cKDTree

from kinectbench.core import SegmentationError
from kinectbench.core.geometry import OrientedBox, yaw_rotation
from kinectbench.core.types import Bools, Float64, Int32, Int64
from kinectbench.core.voxels.point_cells import cell_numbers, connected, pieces_of_cells, touching_cells

# A piece whose lowest point is higher is in the air, and something not too far away holds it.
GROUNDED_M = 0.12
# It holds on to the nearest standing piece within this, unless it is a speck of fewer cells.
MAX_HANGING_GAP_M, MIN_HANGING_CELLS = 0.3, 10
# Points are queried in batches of 60 ms, between which an interrupt is answered (with a bound, 6,000 points
# of a desk took 90 ms; without, 9.6 s).
QUERY_BATCH = 4096
# Cells of this edge that touch are one piece, so that a gap of two of them parts two.
CELL_M = 0.03
# A piece of fewer cells, 270 cm² of surface, is a speck.
MIN_CELLS = 30
# A smaller piece is a speck, unless it has this many cells, stands on the floor, and the cameras look at it:
# their focus is this near to its surface, and this many times nearer than to any larger piece (chosen by
# hand; on furniture the focus is higher above the floor than such a piece reaches).
SMALL_CELLS, SMALL_FOCUS_M, SMALL_NEARER = 6, 0.06, 2.0
# Share of the points that lie beyond each face of a box that is fitted to them: streaks at edges.
BEYOND_FACE = 0.0005
# A piece that ends inside a box is meant if it has this share of the largest one's cells.
ENDING_SHARE = 0.3
LOOK = "`kinectbench segment --suggest` lists boxes to choose from"
# Longer than most beds and couches.
MAX_EXTENT_M = 2.5
# Parts with at least this share of the largest one's surface are things of their own.
PART_SHARE = 0.2
# Things that touch at 30 mm cells come apart at these, where there is a gap of a finger's breadth.
FINE_CELL_M = 0.02
# The finest cells, and whether they must share a face: things that come apart at these are boxes of their own
# in `segment --suggest`.
FINEST_CUT = (0.015, True)
# Fewer of these cells are a speck.
MIN_PART_CELLS = 60
# A thing that is nearer may be a part of the object.
BESIDE_M = 0.1
# A box cuts its object if this share of the object's cells continues right beyond it.
CUT_SHARE, CUT_CELLS = 0.02, 1.5
# A board continues beyond what it carries. This much of it is seen this far around (chosen by hand: a thing
# hides some of it, and stands near its edge).
BOARD_M, BOARD_SHARE = 0.06, 0.4
# By this value boards of 15 to 20 mm are built (docs/evidence/ground-truth.md).
FLAT = "a flat one counts as floor: try `segmentation.floor_cut_m: 0.01` (for all recordings)"
NOTHING_STANDS = (
    "no object found: nothing stands on the floor; is the object in view? A black, glass or mirror-like one "
    f"gives no depth: make it matt; {FLAT}"
)


def label_pieces(points_floor: Float64, cell_m: float, through_faces: bool = False) -> Int32:
    """Label points (n, 3), n > 0, floor frame, with the connected piece that each belongs to, from 1: (n,).

    They are connected as by `connected`. A piece in the air, such as a table top whose underside is unseen,
    is merged into the nearest piece that stands on the floor, so that some numbers may not occur. It stays
    separate if that is over 0.3 m away, or if it has fewer than ten points itself.
    """
    label = connected(points_floor, cell_m, through_faces)
    stands, sizes = standing(label, points_floor), np.bincount(label)
    on_floor = np.flatnonzero(stands[label])
    if not len(on_floor):
        return label
    tree = cKDTree(points_floor[on_floor])
    holder = np.arange(len(sizes), dtype=label.dtype)
    for piece in np.flatnonzero(~stands & (sizes >= MIN_HANGING_CELLS)):
        _, nearest = nearest_within(tree, points_floor[label == piece], MAX_HANGING_GAP_M)
        if nearest is not None:
            holder[piece] = label[on_floor[nearest]]
    return holder[label]


def standing(label: Int32, points_floor: Float64) -> Bools:
    """Whether the points of each label reach down to 0.12 m above the floor: (largest label + 1,) bool."""
    lowest_m = np.full(int(label.max()) + 1, np.inf)
    np.minimum.at(lowest_m, label, points_floor[:, 2])
    return np.asarray(lowest_m <= GROUNDED_M)


def nearest_within(tree: cKDTree, points: Float64, most_m: float) -> tuple[float, int | None]:
    """Return the smallest distance from points (n, k) to a tree's points, and the index of that tree point.

    They are inf and None if no point is within `most_m`. A search without a bound would visit most of the
    tree.
    """
    least_m, nearest = np.inf, None
    for start in range(0, len(points), QUERY_BATCH):
        bound_m = min(least_m, np.nextafter(most_m, np.inf))
        nearby_m, index = tree.query(points[start : start + QUERY_BATCH], distance_upper_bound=bound_m)
        closest = int(np.argmin(nearby_m))
        if np.isfinite(nearby_m[closest]):
            least_m, nearest = float(nearby_m[closest]), int(index[closest])
    return least_m, nearest


def select_object(points_floor: Float64, floor_cut_m: float, target_floor: Float64) -> Bools:
    """Choose the piece above the floor cut, metres, that lies nearest to where the cameras look: (n,) bool.

    The points (n, 3), spread evenly over the surface, and the target (3,) are in the floor frame, metres.
    Specks are ignored. A small piece is chosen only if it lies right where the cameras look.

    Raises:
        SegmentationError: nothing stands on the floor.
    """
    above = np.flatnonzero(points_floor[:, 2] > floor_cut_m)
    if len(above) < SMALL_CELLS:
        raise SegmentationError(NOTHING_STANDS)
    label = label_pieces(points_floor[above], CELL_M)
    sizes = np.bincount(label)
    distance_m = np.full(len(sizes), np.inf)
    np.minimum.at(distance_m, label, np.linalg.norm(points_floor[above] - target_floor, axis=1))
    piece = _small_one(label, points_floor[above], sizes, distance_m)
    if piece is None:
        distance_m[sizes < MIN_CELLS] = np.inf
        if not np.isfinite(distance_m).any():
            raise SegmentationError(
                "no object found: only specks stand on the floor; a black, glass or mirror-like thing gives "
                f"no depth: make it matt, or record closer; {FLAT}"
            )
        piece = int(np.argmin(distance_m))
    chosen = np.zeros(len(points_floor), dtype=bool)
    chosen[above[label == piece]] = True
    return chosen


def _small_one(label: Int32, points_floor: Float64, sizes: Int64, distance_m: Float64) -> int | None:
    """Return the label of a small piece, larger than a speck, right where the cameras look; None if none is.

    For each label, `sizes` has its number of cells and `distance_m` its distance from where the cameras look.
    """
    is_small = (sizes >= SMALL_CELLS) & (sizes < MIN_CELLS) & (distance_m <= SMALL_FOCUS_M)
    is_small &= standing(label, points_floor)
    if not is_small.any():
        return None
    nearest = int(np.argmin(np.where(is_small, distance_m, np.inf)))
    larger_m = float(np.min(distance_m[sizes >= MIN_CELLS], initial=np.inf))
    return nearest if larger_m >= SMALL_NEARER * distance_m[nearest] else None


def select_in_box(points_floor: Float64, in_box: Bools) -> Bools:
    """Choose the object among the pieces of the scene that a given box holds: (n,) bool.

    The object consists of all pieces that end inside the box. A piece that continues beyond the box, such as
    the corner of a table top over a chair, is something else. If all pieces that end inside are much smaller
    than the largest piece, the box cuts the object, and the largest piece belongs to it, too. The points (n,
    3) are spread evenly above the floor, floor frame, metres; `in_box` (n,) holds at least one.
    """
    which, pairs = touching_cells(points_floor, CELL_M)
    inside, outside = np.zeros((2, int(which.max()) + 1), dtype=bool)
    inside[which[in_box]] = True
    outside[which[~in_box]] = True
    label = pieces_of_cells(pairs[inside[pairs].all(axis=1)], len(inside))
    meets = outside.copy()
    for one, other in (pairs.T, pairs.T[::-1]):
        meets[one[outside[other]]] = True
    runs_on = np.zeros(len(inside), dtype=bool)
    runs_on[label[inside & meets]] = True
    sizes = np.bincount(label, weights=inside, minlength=len(inside))
    kept = ~runs_on
    if sizes[kept].max(initial=0) < ENDING_SHARE * sizes.max():
        kept[np.argmax(sizes)] = True
    return np.asarray(in_box & kept[label[which]])


def fit_box(
    points_floor: Float64, yaw_rad: float | None = None, left_out: float = BEYOND_FACE
) -> OrientedBox:
    """Return the upright box around points (n, 3), from the floor to their top.

    If `yaw_rad` is None, it is that of the smallest rectangle on the ground around all points, in [-pi/4,
    pi/4), which makes it unique. On each side and at the top, the share `left_out` of the points is left
    outside, so that specks do not enlarge the box; they may still turn it.
    """
    if yaw_rad is None:
        (_, _, angle_deg) = cv2.minAreaRect(points_floor[:, :2].astype(np.float32))
        yaw_rad = float(np.radians((angle_deg + 45.0) % 90.0 - 45.0))
    turned = points_floor @ yaw_rotation(yaw_rad)
    low, high = np.quantile(turned, [left_out, 1 - left_out], axis=0)
    low[2] = 0.0
    center = yaw_rotation(yaw_rad) @ ((low + high) / 2)
    size = np.maximum(high - low, 1e-3)
    return OrientedBox(triple(center), triple(size), yaw_rad)


def triple(values: Float64) -> tuple[float, float, float]:
    """Return a vector (3,) as a tuple."""
    x, y, z = (float(value) for value in values)
    return x, y, z


@dataclass(frozen=True)
class Selection:
    """The surface points of the chosen object, and all others above the floor; floor frame, metres.

    Attributes:
        object_points: (n, 3) points of the object's surface, at least one per cell of `cell_m`.
        other_points: (m, 3) the same for everything else above the floor.
        box: upright box around the object.
        given: whether the user gave the box.
        focus: (3,) where the cameras look.
        cell_m: edge of the cells by which parts are separated: 20 mm, or more if the surface is coarser.
        spacing_m: of the surface's points: no finer cells connect them.
        scale: of the scene; all lengths above are metres divided by it.
    """

    object_points: Float64
    other_points: Float64
    box: OrientedBox
    given: bool
    focus: Float64
    cell_m: float = FINE_CELL_M
    spacing_m: float = 0.0
    scale: float = 1.0


def choice_warnings(selection: Selection) -> tuple[str, ...]:
    """Return the reasons why the choice may be wrong, one line each.

    For a given box there are only two: it holds several objects, or it cuts through one.
    """
    parts = separate_parts(selection.object_points, selection.cell_m)
    if selection.given:
        parts = max(parts, 1 + things_beside(selection.object_points, selection.cell_m))
        held = (
            f"the box holds {parts} things that stand apart, or one whose joints no frame shows; if they are "
            f"several, give a box around one of them: {LOOK}"
        )
        cut = f"the box cuts through what it holds, which goes on beyond it: make it larger; {LOOK}"
        return (held,) * (parts > 1) + (cut,) * (box_cut_share(selection) >= CUT_SHARE)
    lines = []
    extent_m = max(selection.box.size_m) * selection.scale
    if extent_m > MAX_EXTENT_M:
        lines.append(f"the object is {extent_m:.1f} m long: hardly one piece of furniture; {LOOK}")
    if parts > 1:
        lines.append(f"the object falls into {parts} things that stand side by side and hardly touch; {LOOK}")
    neighbours = large_neighbours(selection)
    gap_m = _gap_within_m(neighbours, selection.object_points, BESIDE_M)
    if gap_m < BESIDE_M:
        lines.append(
            f"another large thing stands {100 * selection.scale * gap_m:.0f} cm beside the object; {LOOK}"
        )
    elif (
        _distance_m(neighbours, selection.focus)
        < _distance_m(selection.object_points, selection.focus) + BESIDE_M
    ):
        lines.append(f"another large thing stands as near to where the cameras look as the object; {LOOK}")
    return tuple(lines)


def separate_parts(points_floor: Float64, cell_m: float = FINE_CELL_M) -> int:
    """Count the large parts on the floor that the points (n, 3) form, in cells of edge `cell_m`."""
    if not len(points_floor):
        return 0
    label = label_pieces(points_floor, cell_m)
    sizes = _cells(points_floor, label)
    sizes[~standing(label, points_floor)] = 0
    return int((sizes >= max(MIN_PART_CELLS, PART_SHARE * sizes.max())).sum())


def things_beside(points_floor: Float64, cell_m: float = FINE_CELL_M) -> int:
    """Count the parts on the floor, even small parts, at least 0.1 m from the largest as seen from above."""
    if not len(points_floor):
        return 0
    label = label_pieces(points_floor, cell_m)
    sizes = _cells(points_floor, label)
    largest = points_floor[label == np.argmax(sizes), :2]
    stands = standing(label, points_floor)
    # The largest part is none: it lies at a distance of 0 from itself.
    parts = np.flatnonzero((sizes >= MIN_PART_CELLS) & stands)
    return sum(
        _gap_within_m(largest, points_floor[label == part, :2], BESIDE_M) >= BESIDE_M for part in parts
    )


def box_cut_share(selection: Selection) -> float:
    """Return the share of the object's cells that continue right beside them, outside the box.

    Neither the board that the object stands on counts, nor a thing that comes apart from all large pieces in
    the box at the finest cut, such as one beside them that the box just touches.
    """
    inside, outside = selection.object_points, selection.other_points
    outside = outside[~selection.box.contains(outside)]
    if stands_on_a_board(selection):
        bottom_m = selection.box.center_m[2] - selection.box.size_m[2] / 2
        outside = outside[outside[:, 2] > bottom_m + CUT_CELLS * selection.cell_m]
    if not len(inside) or not len(outside):
        return 0.0
    reach_m = CUT_CELLS * selection.cell_m
    outside = outside[selection.box.grown(reach_m).contains(outside)]
    finest_m, through_faces = FINEST_CUT
    label = connected(np.concatenate([inside, outside]), max(finest_m, selection.spacing_m), through_faces)
    within, beyond = label[: len(inside)], label[len(inside) :]
    sizes = _cells(inside, within)
    outside = outside[np.isin(beyond, np.flatnonzero(sizes >= PART_SHARE * sizes.max()))]
    beside = np.isfinite(cKDTree(outside).query(inside, distance_upper_bound=reach_m)[0])
    return float(_cells(inside[beside], None).max(initial=0) / _cells(inside, None).max())


def stands_on_a_board(selection: Selection) -> bool:
    """Whether surface at the height of the box's lower end surrounds the box, as a shelf's board does."""
    box, cell_m = selection.box, selection.cell_m
    bottom_m = box.center_m[2] - box.size_m[2] / 2
    around = replace(box, size_m=(box.size_m[0] + 2 * BOARD_M, box.size_m[1] + 2 * BOARD_M, box.size_m[2]))
    points = np.concatenate([selection.object_points, selection.other_points])
    points = points[np.abs(points[:, 2] - bottom_m) < CUT_CELLS * cell_m]
    at_middle = np.column_stack([points[:, :2], np.full(len(points), box.center_m[2])])
    ring = points[around.contains(at_middle) & ~box.contains(at_middle)]
    covered_m2 = len(np.unique(cell_numbers(np.floor(ring[:, :2] / cell_m).astype(np.int64)))) * cell_m**2
    whole_m2 = around.size_m[0] * around.size_m[1] - box.size_m[0] * box.size_m[1]
    return covered_m2 >= BOARD_SHARE * whole_m2


def large_neighbours(selection: Selection) -> Float64:
    """Return the points (k, 3) of other standing objects with a fifth of the object's surface or more."""
    others = selection.other_points
    if not len(others):
        return others
    label = label_pieces(others, selection.cell_m)
    sizes = _cells(others, label)
    least = max(MIN_PART_CELLS, PART_SHARE * _cells(selection.object_points, None).max())
    return np.asarray(others[((sizes >= least) & standing(label, others))[label]])


def _gap_within_m(points: Float64, others: Float64, most_m: float) -> float:
    """Return the smallest distance between points (n, k) and (m, k); inf if it exceeds `most_m`."""
    return nearest_within(cKDTree(points), others, most_m)[0] if len(points) else np.inf


def _distance_m(points: Float64, point: Float64) -> float:
    """Return the smallest distance between points (n, 3) and one (3,); inf if n is 0."""
    return float(np.linalg.norm(points - point, axis=1).min(initial=np.inf))


def _cells(points_floor: Float64, label: Int32 | None) -> Int64:
    """Count the 20 mm cells that the points of each label occupy; without `label`, those of all points."""
    cells = np.floor(points_floor / FINE_CELL_M).astype(np.int64)
    _, first = np.unique(cell_numbers(cells), return_index=True)
    return np.asarray(np.bincount(np.zeros(len(first), int) if label is None else label[first]))
