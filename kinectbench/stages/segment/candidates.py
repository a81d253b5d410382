"""Boxes that a person may choose the object from."""

from dataclasses import dataclass, replace

import numpy as np

from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import OrientedBox, TriangleMesh, transform_points
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float64
from kinectbench.core.voxels.morphology import cell_numbers
from kinectbench.settings.models import FloorCuts
from kinectbench.stages.segment.doubts import FINE_CELL_M
from kinectbench.stages.segment.find_object import Scene, find_object, find_scene
from kinectbench.stages.segment.floor import floor_cut_m
from kinectbench.stages.segment.select import CELL_M, fit_box, label_pieces, spacing_m, standing
from kinectbench.stages.segment.up import NOTHING_KNOWN, FloorHint

# Cells and whether they must share a face: what touches in the first may come apart in the next ones.
CUTS = ((0.03, False), (0.02, False), (0.015, True))
MIN_AREA_M2 = 0.05
MAX_CANDIDATES = 9
# Two pieces that end within this of each other on all sides show the same thing.
SAME_M = 0.06
# So that the noise of the surface is inside.
MARGIN_M = 0.02
# Rooms and rows of cupboards come last.
LARGE_M = 2.5


@dataclass(frozen=True)
class Candidate:
    """One thing that stands on the floor, or a part of one that touches others.

    Attributes:
        box: upright box around it, floor frame.
        points_floor: (n, 3) its points of the fused surface, floor frame, metres.
        automatic: it is what is chosen without a box.
        distance_m: from where the cameras look to its nearest point.
    """

    box: OrientedBox
    points_floor: Float64
    automatic: bool
    distance_m: float


@dataclass(frozen=True)
class Candidates:
    """The scene, and up to nine things in it: the automatic choice first, then by distance."""

    scene: Scene
    candidates: tuple[Candidate, ...]


def find_candidates(
    mesh: TriangleMesh,
    trajectory: Trajectory,
    settings: FloorCuts,
    hint: FloorHint = NOTHING_KNOWN,
) -> Candidates:
    """Find what stands on the floor: connected pieces, and their parts where there is a gap (own rule).

    The fused surface is cut into pieces thrice, each time where a smaller gap suffices: 60 mm, 40 mm and
    15 mm, or what the mesh resolves; less where cameras are nearer than 1 m. A piece that the finer cut
    leaves whole counts once.

    Args:
        mesh: the fused scene, world frame.
        trajectory: poses of the frames.
        settings: seed, floor cut and low cut.
        hint: what is known of the floor.

    Raises:
        SegmentationError: nothing that stands on the floor is large enough.
    """
    scene = find_scene(mesh, trajectory, settings, floor_may_lack=True, hint=hint)
    vertices_floor = transform_points(scene.floor.T_floor_world, mesh.vertices)
    points_floor = vertices_floor[vertices_floor[:, 2] > floor_cut_m(scene.floor, settings)]
    least_m = spacing_m(mesh)
    found = [] if len(points_floor) == 0 else _automatic(scene, vertices_floor, settings, least_m)
    for cell_m, through_faces in CUTS:
        larger = _pieces(points_floor / scene.scale, max(cell_m, least_m / scene.scale), through_faces)
        for points in (each * scene.scale for each in larger):
            candidate = _candidate(points, scene, automatic=False)
            if not any(_same(candidate, other, SAME_M * scene.scale) for other in found):
                found.append(candidate)
    if not found:
        least = f"{MIN_AREA_M2 * scene.scale**2:.2g} m²"
        raise SegmentationError(
            f"no candidates: nothing that stands on the floor has {least} of surface; is it in view? "
            "A black, glass or mirror-like one gives no depth: make it matt"
        )
    found.sort(key=lambda c: (not c.automatic, max(c.box.size_m) > LARGE_M, c.distance_m))
    return Candidates(scene, tuple(found[:MAX_CANDIDATES]))


def _automatic(scene: Scene, vertices_floor: Float64, settings: FloorCuts, least_m: float) -> list[Candidate]:
    """What `segment` would choose, or nothing if it would refuse."""
    if not scene.floor.found:
        return []
    try:
        found = find_object(scene, vertices_floor, settings, max(FINE_CELL_M * scene.scale, least_m))
    except SegmentationError:
        return []
    points_floor = np.concatenate([scene.points_floor[found.chosen], vertices_floor[found.feet]])
    return [_candidate(points_floor, scene, automatic=True)]


def _pieces(points_floor: Float64, cell_m: float, through_faces: bool) -> list[Float64]:
    """The points of each piece that stands on the floor and is large enough, as if seen from 1 m or more."""
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
    """By where their points lie: boxes around the same thing may be turned differently."""
    sides = [np.concatenate([c.points_floor.min(axis=0), c.points_floor.max(axis=0)]) for c in (one, other)]
    return bool(np.abs(sides[0] - sides[1]).max() < within_m)
