"""Triage of a benchmark: decide on each recording, and find two recordings of one object under two names.

The same object is found by registering shapes with each other on the floor. docs/releases.md explains the
rule. docs/evidence/releases.md has the results of `python benchmarks/truth/same_object.py`.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Self

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from kinectbench.core.artefacts.object import FloorFile, QualityFile
from kinectbench.core.artefacts.object_grids import Label, ObjectVolume
from kinectbench.core.artefacts.triage import DECISIONS, SameObject, TriageFile, TriageRow
from kinectbench.core.geometry import transform_points, yaw_rotation
from kinectbench.core.types import Float64
from kinectbench.release.triage.rules import Judged, judged
from kinectbench.settings.models import BenchmarkSettings, RecordingSettings

# Number of points kept of a surface, and number of these that are laid onto another surface: a tenth of the 2
# m^2 of a chair is a point on each square centimetre. Chosen by hand.
KEPT, LAID = 20_000, 1_500
# Number of turns tried, 10 degrees apart, with every fifth point; number of the best that are refined, and
# steps of refinement. Chosen by hand.
TURNS, THIN, REFINED, STEPS = 36, 5, 4, 12
# A point agrees if it is nearer than this share of the larger diagonal; for small objects, nearer than two
# voxels of 3 mm: the surfaces of one chair, built twice, lie 4 mm apart.
NEAR_SHARE, NEAR_M = 0.012, 0.006
# Farther points have no influence: one recording may not have seen them. Chosen by hand.
REACH, LEAST_REACH, LEAST_POINTS = 8.0, 2.0, 10
# Heights, lengths and widths of one object differ by less between recordings (4 % at most, measured).
SIZES_APART = 0.12
# Two shapes are one object if their agreement is at least this: docs/releases.md has its derivation.
LEAST_AGREEMENT = 0.9


@dataclass(frozen=True)
class Shape:
    """Points on an object's surface, metres, in the floor frame (z up), with x and y relative to their mean.

    Attributes:
        measured: (n, 3) points of the surface that cameras measured.
        surface: (m, 3) points of the whole surface, including inferred parts.
    """

    measured: Float64
    surface: Float64

    @classmethod
    def of(cls, measured_floor: Float64, surface_floor: Float64) -> Self:
        """Make a shape from points (n, 3) in the floor frame; keep about `KEPT` points of larger sets."""
        middle = np.array([*surface_floor[:, :2].mean(axis=0), 0.0])
        few = (points[:: max(1, len(points) // KEPT)] - middle for points in (measured_floor, surface_floor))
        return cls(*few)

    @classmethod
    def read(cls, folder: Path) -> Self | None:
        """Read the shape in `build/<recording>/object/`; None if nothing was measured.

        Raises:
            StorageError: a file is missing or damaged.
        """
        volume, floor = ObjectVolume.read(folder), FloorFile.read(folder)
        outside = volume.solid & ~ndimage.binary_erosion(volume.solid)
        cells, measured = np.argwhere(outside), volume.labels[outside] == Label.SURFACE
        if measured.sum() < LEAST_POINTS:
            return None
        centres_grid = (cells + 0.5) * volume.grid.voxel_size_m
        points = transform_points(np.array(floor.T_floor_world) @ volume.grid.T_world_grid, centres_grid)
        return cls.of(points[measured], points)


def shape_agreement(a: Shape, b: Shape) -> float:
    """Register two shapes by a rotation about the vertical and a translation; return their agreement, 0 to 1.

    Returns:
        The share of one shape's measured points that lie near the other's surface. It is computed both ways,
        and the smaller share is returned.
    """
    diagonals_m = [float(np.linalg.norm(np.ptp(shape.surface, axis=0))) for shape in (a, b)]
    near_m = max(NEAR_SHARE * max(diagonals_m), NEAR_M)
    tree_a, tree_b = cKDTree(a.surface), cKDTree(b.surface)
    laid, other = (shape.measured[:: max(1, len(shape.measured) // LAID)] for shape in (a, b))
    turns = [yaw_rotation(turn * 2 * np.pi / TURNS) for turn in range(TURNS)]
    apart = [np.minimum(tree_b.query(laid[::THIN] @ R.T)[0], REACH * near_m).mean() for R in turns]
    best = 0.0
    for first in np.argsort(apart, kind="stable")[:REFINED]:
        R, t = _refined(laid, turns[first], tree_b, near_m)
        of_a = np.mean(tree_b.query(laid @ R.T + t)[0] < near_m)
        of_b = np.mean(tree_a.query((other - t) @ R)[0] < near_m)
        best = max(best, float(min(of_a, of_b)))
    return best


def _refined(points: Float64, R: Float64, tree: "cKDTree", near_m: float) -> tuple[Float64, Float64]:
    """Register points (n, 3) to the points of a k-d tree by ICP, starting from R without translation.

    `near_m` is the distance, metres, at which points count as near each other. Return R (3, 3), a rotation
    about z, and t (3,), metres: R p + t maps a point p onto the tree's points.
    """
    t = np.zeros(3)
    for step in range(STEPS):
        placed = points @ R.T + t
        distance_m, nearest = tree.query(placed)
        used = distance_m < near_m * max(REACH / (1 + step), LEAST_REACH)
        if used.sum() < LEAST_POINTS:
            break
        used_points, targets = placed[used], tree.data[nearest[used]]
        middle, target = used_points.mean(axis=0), targets.mean(axis=0)
        p, q = (used_points - middle)[:, :2], (targets - target)[:, :2]
        sine, cosine = (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum(), (p * q).sum()
        turn = yaw_rotation(float(np.arctan2(sine, cosine)))
        R, t = turn @ R, turn @ (t - middle) + target
    return R, t


def same_objects(
    folders: Mapping[str, Path], sizes_m: Mapping[str, Float64], objects: Mapping[str, str]
) -> Iterator[tuple[str, str, float]]:
    """Yield (recording, other recording, agreement) for shapes that agree although their object names differ.

    Only shapes of similar height, length and width are compared. If one of two recordings did not see a side
    of the object, the sizes may differ more, and the match is missed.

    Args:
        folders: {recording: path of its `object/`}.
        sizes_m: {recording: (3,) longer side, shorter side and height of its object, metres}.
        objects: {recording: name of its object}.

    Raises:
        StorageError: a file is missing or damaged.
    """
    shapes = dict[str, Shape | None]()
    for a, b in combinations(sizes_m, 2):
        larger_m = np.maximum(sizes_m[a], sizes_m[b])
        if objects[a] == objects[b] or (np.abs(sizes_m[a] - sizes_m[b]) > SIZES_APART * larger_m).any():
            continue
        for name in (a, b):
            if name not in shapes:
                shapes[name] = Shape.read(folders[name])
        one, other = shapes[a], shapes[b]
        if (
            one is not None
            and other is not None
            and (value := shape_agreement(one, other)) >= LEAST_AGREEMENT
        ):
            yield a, b, value


def triage(settings: BenchmarkSettings, build: Path, built: Collection[str]) -> TriageFile:
    """Sort the recordings of a benchmark into accept, look and reject, by the rules that `publish` applies.

    `built` are ids of recordings whose pairs are built.

    Raises:
        StorageError: a built file is damaged.
    """
    qualities = {name: QualityFile.read(build / name / "object") for name in sorted(built)}
    rows = [_row(each, settings, qualities.get(each.recording.id)) for each in judged(settings, build, built)]
    rows.sort(key=_severity)
    wanted = {row.recording for row in rows if row.decision != "reject"}
    sizes_m = {
        name: size for name, of in qualities.items() if name in wanted and (size := _size_m(of)) is not None
    }
    return TriageFile(
        format_version=1, rows=tuple(rows), same_object=tuple(_same(settings.recordings, build, sizes_m))
    )


def _row(each: Judged, settings: BenchmarkSettings, quality: QualityFile | None) -> TriageRow:
    recording = each.recording
    category = settings.categories.get(recording.category)
    of_category = category is not None and "underside" in category.model_fields_set
    failure = () if each.failure is None else (each.failure,)
    return TriageRow(
        recording=recording.id,
        object=recording.object_name,
        split=recording.split,
        decision=each.decision,
        reasons=(*failure, *each.limits, *each.look),
        review=recording.review.reason if recording.review else None,
        estimated_iou=quality.estimated_iou if quality else None,
        estimated_iou_low=quality.estimated_iou_low if quality else None,
        estimated_known_iou=quality.estimated_known_iou if quality else None,
        underside=settings.underside_of(recording),
        underside_by="recording" if recording.underside else "category" if of_category else None,
        incomplete=each.incomplete,
        built=quality is not None,
    )


def _severity(row: TriageRow) -> tuple[int, float, int, str]:
    """Return the key that sorts rows by worst decision, lowest `estimated_iou_low`, most reasons, then id.

    Among rows with the same decision, those without an estimate come first.
    """
    low = row.estimated_iou_low
    return DECISIONS.index(row.decision), -1.0 if low is None else low, -len(row.reasons), row.recording


def _size_m(quality: QualityFile) -> Float64 | None:
    """Return (3,) longer side, shorter side and height of the object, metres; None if not known."""
    if quality.box is None:
        return None
    x, y, z = quality.box.size_m
    return np.array([max(x, y), min(x, y), z])


def _same(
    recordings: Sequence[RecordingSettings], build: Path, sizes_m: dict[str, Float64]
) -> Iterator[SameObject]:
    """Yield pairs of recordings with one shape but two object names, those in different splits first."""
    by_id = {each.id: each for each in recordings}
    pairs = []
    names = {name: by_id[name].object_name for name in sizes_m}
    for a, b, value in same_objects({name: build / name / "object" for name in sizes_m}, sizes_m, names):
        first, second = by_id[a], by_id[b]
        write = f"object: {first.object_name}"
        if first.split != second.split:
            write += f", split: {first.split}"
        pairs.append(
            SameObject(
                recordings=(a, b), agreement=round(value, 3), splits=(first.split, second.split), write=write
            )
        )
    yield from sorted(pairs, key=lambda pair: (pair.splits[0] == pair.splits[1], -pair.agreement))
