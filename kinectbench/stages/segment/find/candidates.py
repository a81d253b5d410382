"""Find boxes among which the user may choose the object."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinectbench.core import SegmentationError
from kinectbench.core.artefacts.object import AnchoredBoxPart, CandidateRow, CandidatesFile
from kinectbench.core.box_pictures import ShownBox, box_picture, plan_picture
from kinectbench.core.geometry import OrientedBox, TriangleMesh, transform_points
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float64
from kinectbench.core.voxels.point_cells import cell_numbers, spacing_m
from kinectbench.settings.models import FloorCuts
from kinectbench.stages.segment.find.floor import Floor
from kinectbench.stages.segment.find.given import BESIDE_CELLS, SAME_M, anchor_of
from kinectbench.stages.segment.find.hints import NOTHING_KNOWN, FloorHint
from kinectbench.stages.segment.find.object import Scene, find_object, find_scene
from kinectbench.stages.segment.find.pieces import (
    CELL_M,
    FINE_CELL_M,
    FINEST_CUT,
    FLAT,
    fit_box,
    label_pieces,
    standing,
)

# Edge of cells, and whether cells must share a face: pieces that touch in the first cut may come apart in the
# next cuts.
CUTS = ((CELL_M, False), (FINE_CELL_M, False), FINEST_CUT)
PLAN = "plan.png"
# Smaller surfaces (22 x 22 cm) are clutter, and nobody looks through more boxes.
MIN_AREA_M2, MAX_CANDIDATES = 0.05, 9
# The box has this margin, so that the noise of the surface is inside.
MARGIN_M = 0.02
# Rooms and rows of cupboards come last.
LARGE_M = 2.5


@dataclass(frozen=True)
class Candidate:
    """A possible object: a piece of surface on the floor, or a part of such a piece if several objects touch.

    Attributes:
        box: upright box around it, floor frame.
        points_floor: (n, 3) its points of the fused surface, floor frame, metres.
        automatic: whether it is the object that is chosen if no box is given.
        distance_m: distance of its nearest point from the point that the cameras look at, metres.
    """

    box: OrientedBox
    points_floor: Float64
    automatic: bool
    distance_m: float

    def shown(self, floor: Floor) -> ShownBox:
        """Return the candidate in the form in which it is drawn."""
        return ShownBox(self.box, self.points_floor, floor.T_world_floor)


@dataclass(frozen=True)
class Candidates:
    """The scene, and up to nine candidates.

    The automatic choice comes first. The others follow by distance; boxes with a side over 2.5 m come last.
    """

    scene: Scene
    candidates: tuple[Candidate, ...]


def find_candidates(
    mesh: TriangleMesh, trajectory: Trajectory, settings: FloorCuts, hint: FloorHint = NOTHING_KNOWN
) -> Candidates:
    """Find objects on the floor of a fused scene: connected pieces, and their parts if separated by a gap.

    The surface is split into pieces three times, at gaps of 60 mm, 40 mm and 15 mm, but no finer than the
    mesh resolves. The gaps shrink where cameras are nearer than 1 m. A piece that several splits find counts
    once.

    Raises:
        SegmentationError: the scene is empty, a given plane lies above the cameras, or nothing that stands on
            the floor is large enough.
    """
    scene = find_scene(mesh, trajectory, settings, floor_may_lack=True, hint=hint)
    vertices_floor = transform_points(scene.floor.T_floor_world, mesh.vertices)
    points_floor = vertices_floor[vertices_floor[:, 2] > scene.floor.cut_m(settings)]
    least_m = spacing_m(mesh)
    candidates = [] if len(points_floor) == 0 else _automatic(scene, vertices_floor, settings, least_m)
    for cell_m, through_faces in CUTS:
        larger = _pieces(points_floor / scene.scale, max(cell_m, least_m / scene.scale), through_faces)
        for points in (each * scene.scale for each in larger):
            candidate = _candidate(points, scene, automatic=False)
            if not any(_same(candidate, other, SAME_M * scene.scale) for other in candidates):
                candidates.append(candidate)
    if not candidates:
        least = f"{MIN_AREA_M2 * scene.scale**2:.2g} m²"
        raise SegmentationError(
            f"no candidates: nothing that stands on the floor has {least} of surface; is it in view? "
            f"A black, glass or mirror-like one gives no depth: make it matt; {FLAT}",
            what="no-candidates",
        )
    candidates.sort(key=lambda c: (not c.automatic, max(c.box.size_m) > LARGE_M, c.distance_m))
    return Candidates(scene, tuple(candidates[:MAX_CANDIDATES]))


def _automatic(scene: Scene, vertices_floor: Float64, settings: FloorCuts, least_m: float) -> list[Candidate]:
    """Return the object that is chosen without a box, as a list.

    The list is empty if no floor or no object is found, or if the object is not at the picked point.
    """
    if not scene.floor.found:
        return []
    try:
        result = find_object(scene, vertices_floor, settings, max(FINE_CELL_M * scene.scale, least_m))
    except SegmentationError:
        return []
    points_floor = np.concatenate([scene.points_floor[result.chosen], vertices_floor[result.feet]])
    found = _candidate(points_floor, scene, automatic=True)
    off = scene.picked and found.distance_m > BESIDE_CELLS * CELL_M * scene.scale
    return [] if off else [found]


def _pieces(points_floor: Float64, cell_m: float, through_faces: bool) -> list[Float64]:
    """Return the points (k, 3) of each large piece on the floor, as `label_pieces` finds them.

    The points (n, 3), above the floor, are in metres divided by the scale of the scene.
    """
    if len(points_floor) == 0:
        return []
    label = label_pieces(points_floor, cell_m, through_faces)
    # One point a cell, so that area counts.
    cells = np.floor(points_floor / CELL_M).astype(np.int64)
    _, first = np.unique(cell_numbers(cells), return_index=True)
    sizes = np.bincount(label[first], minlength=int(label.max()) + 1)
    large = standing(label, points_floor) & (sizes * CELL_M**2 >= MIN_AREA_M2)
    return [points_floor[label == piece] for piece in np.flatnonzero(large)]


def _candidate(points_floor: Float64, scene: Scene, automatic: bool) -> Candidate:
    fitted = fit_box(points_floor)
    margin_m = MARGIN_M * scene.scale
    grown = fitted.grown(margin_m)
    box = replace(grown, center_m=(*fitted.center_m[:2], grown.size_m[2] / 2 - margin_m))
    distance_m = float(np.linalg.norm(points_floor - scene.focus_floor, axis=1).min())
    return Candidate(box, points_floor, automatic, distance_m)


def _same(one: Candidate, other: Candidate, within_m: float) -> bool:
    """Whether the axis-aligned bounds of two candidates' points differ by less than `within_m`, metres."""
    sides = [np.concatenate([c.points_floor.min(axis=0), c.points_floor.max(axis=0)]) for c in (one, other)]
    return bool(np.abs(sides[0] - sides[1]).max() < within_m)


def write_candidates(result: Candidates, sequence: Sequence, trajectory: Trajectory, folder: Path) -> None:
    """Write candidates.json (numbers from 1, boxes as benchmark.yaml writes them) and the pictures."""
    scene, floor = result.scene, result.scene.floor
    rows, anchor = [], anchor_of(floor, trajectory, sequence)
    for number, candidate in enumerate(result.candidates, start=1):
        name = f"{number}.png"
        (folder / name).write_bytes(box_picture(number, candidate.shown(floor), sequence, trajectory))
        rows.append(
            CandidateRow(
                number=number,
                automatic=candidate.automatic,
                box=AnchoredBoxPart.of_anchored(candidate.box, anchor),
                distance_m=round(candidate.distance_m, 3),
                picture=name,
            )
        )
    boxes = [candidate.box for candidate in result.candidates]
    plan = plan_picture(
        boxes, scene.points_floor, scene.focus_floor, floor.T_floor_world, trajectory, scene.scale
    )
    (folder / PLAN).write_bytes(plan)
    CandidatesFile(
        floor_found=floor.found, T_floor_world=floor.T_floor_world, plan=PLAN, candidates=tuple(rows)
    ).write(folder)
