"""Warn if the chosen object may not be a single free-standing object."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from kinectbench.core.geometry import OrientedBox
from kinectbench.core.types import Float64, Int32, Int64
from kinectbench.core.voxels.morphology import cell_numbers
from kinectbench.core.voxels.touching_cells import connected
from kinectbench.stages.segment.find.select import label_pieces, nearest_within, standing

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
