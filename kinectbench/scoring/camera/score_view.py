"""Score the predictions of one view in the camera frame, as predicted and after registration to the truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from kinectbench.core import PredictionError, open_plain, printable
from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.artefacts.score_figures import (
    Alignment,
    Calibration,
    Hypotheses,
    ShapePart,
    SurfaceMetrics,
    VoxelMetrics,
)
from kinectbench.core.geometry import rotation_angle_rad, similarity_scale, transform_points
from kinectbench.core.types import Float64
from kinectbench.core.voxels.pair_file import FULL_CELLS
from kinectbench.release.release import Target
from kinectbench.scoring.camera.align import KINDS, SurfaceRegistration, register_kinds
from kinectbench.scoring.camera.calibration import Votes
from kinectbench.scoring.camera.metrics import PartFigures, figures_by_part
from kinectbench.scoring.camera.solid import Solid, solid_in, to_be_closed
from kinectbench.scoring.camera.surface import Surface, surface_of
from kinectbench.scoring.camera.truth import SpaceTruth, ViewFiles, read_space_truth
from kinectbench.scoring.camera_predictions import CameraPredictionFile, load_camera_shape
from kinectbench.scoring.camera_shape import CameraShape
from kinectbench.scoring.closed_mesh import closed_mesh, open_because
from kinectbench.scoring.prediction_file import blake3_of

# (protocol, kind of registration): see `register_surface` for the kinds; None under `camera`.
Asked = tuple[str, str | None]


@dataclass(frozen=True)
class Scored:
    """Scores of one part of a view under one protocol: the values of a row of the table.

    Other attributes are those of `InSpace`; each is None where there is no such value.

    Attributes:
        protocol: camera or aligned.
        figures: metrics of the part.
        open_because: why a mesh is not closed, in words; "" if it is closed, or no mesh.
    """

    protocol: str
    part: ShapePart
    figures: PartFigures
    alignment: Alignment | None = None
    solid: bool | None = None
    predicted_unknown_share: float | None = None
    cut: float | None = None
    silhouette: float | None = None
    hypotheses: Hypotheses | None = None
    closed: str | None = None
    calibration: Calibration | None = None
    open_because: str = ""


@dataclass(frozen=True)
class ViewJob:
    """A view to be scored.

    Attributes:
        target: the view.
        truth: the files that hold its truth.
        files: its prediction files, the main one first; () for an empty prediction.
        method: the method's method.json.
        protocols: camera, aligned or both.
        close: how open meshes and points are made solid; None if they are not.
    """

    target: Target
    truth: ViewFiles
    files: tuple[CameraPredictionFile, ...]
    method: MethodFile
    protocols: tuple[str, ...]
    close: str | None = None


@dataclass(frozen=True)
class ViewResult:
    """The result of scoring a view.

    Attributes:
        rows: scores, one for each protocol, kind of registration and part. Of several predictions, the
            first's rows come first, then the rows of the best one and of the mean.
        unknown_share: share of the true shape's cells that are not known.
        digest: BLAKE3 of the prediction's file or, for several files, of their joined digests; None without a
            prediction.
        cells: cells along a side of the prediction's grid; 256 in the camera frame; 0 without a prediction.
    """

    rows: tuple[Scored, ...]
    unknown_share: float
    digest: str | None
    cells: int = FULL_CELLS


def score_view(job: ViewJob) -> ViewResult | str:
    """Score a view; if one of its predictions cannot be scored, return the reason instead.

    Raises:
        ReleaseError: the truth is missing, or differs from the published one.
    """
    truth = read_space_truth(job.truth)
    asked = asked_rows(job.protocols, job.method.scale)
    if not job.files:
        return ViewResult(empty_rows(truth, asked), truth.unknown_share, None, 0)
    found, digests, votes = [], [], Votes()
    volume = (job.method.volume_m or {}).get(job.target.name)
    for file in job.files:
        try:
            with open_plain(file.path) as content:
                digests.append(blake3_of(content))
            shape = load_camera_shape(file, job.method)
            found.append(score_shape(truth, shape, asked, volume, job.close, votes))
        except PredictionError as error:
            line = str(error)
            return line if line.startswith(file.name) else f"{file.name}{file.path.suffix}: {line}"
        except OSError as error:
            return f"{file.name}{file.path.suffix}: cannot be read ({error.strerror or error})"
        except (ValueError, MemoryError) as error:  # one faulty file must not stop the other views
            return f"{file.name}{file.path.suffix}: cannot be scored ({printable(str(error), 120)})"
    digest = digests[0] if len(digests) == 1 else blake3_of("".join(digests).encode())
    return ViewResult((*found[0], *_over(truth, found, votes)), truth.unknown_share, digest)


def score_shape(
    truth: SpaceTruth,
    shape: CameraShape,
    asked: Sequence[Asked],
    volume_m: Float64 | None = None,
    close: str | None = None,
    votes: Votes | None = None,
) -> tuple[Scored, ...]:
    """Return the rows of one predicted shape: one per protocol, kind of registration and part.

    Args:
        truth: the truth of the view.
        shape: the predicted shape, camera frame.
        asked: the (protocol, kind of registration) pairs to score (`asked_rows`).
        volume_m: (2, 3), lowest and highest corner of the volume that the method covers, metres, camera
            frame; None if only the shape's own grid, if any, limits it.
        close: how an open mesh or points are made solid; None if they are not.
        votes: the shape's solids are added to it; None if they are not needed.

    Raises:
        PredictionError: the shape is empty or has too many cell faces, or its solid cannot be made in the
            truth's cells.
    """
    surface, mesh = surface_of(shape), closed_mesh(shape)
    if not len(surface):
        raise PredictionError("no cell is at a surface: an empty prediction", what="empty")
    as_predicted = surface.transformed(truth.T_grid_camera)
    is_solid = mesh is not None or shape.cells is not None
    because = "" if is_solid else open_because(shape)
    own, closed = shape, None
    may_close = close is not None and not is_solid and not truth.is_open
    if close is not None and may_close and (made := to_be_closed(shape, surface, close)) is not None:
        own, closed = made, close
        mesh = None if made is shape else closed_mesh(made)
    registered = register_kinds(truth, as_predicted, [kind for _, kind in asked if kind is not None])
    rows: list[Scored] = []
    for protocol, kind in asked:
        T, alignment, moved = truth.T_grid_camera, None, as_predicted
        if kind is not None:
            alignment = _alignment(as_predicted, kind, registered[kind])
            T = registered[kind].T @ T
            moved = surface.transformed(T)
        solid = None if truth.is_open else solid_in(truth, own, mesh, T, closed)
        if votes is not None and solid is not None:
            votes.solids.setdefault((protocol, kind), []).append(solid.cells)
        found, left_out = figures_by_part(truth, moved, solid, in_camera=kind is None)
        # Only for the unregistered shape: a registration moves it away from its view.
        cut = cut_share(truth, shape, volume_m) if kind is None else None
        silhouette = outside_mask_share(truth, surface) if kind is None else None
        rows += [
            Scored(
                *(protocol, part, figures, alignment, is_solid, left_out, cut, silhouette),
                closed=closed,
                open_because=because,
            )
            for part, figures in found.items()
        ]
    return tuple(rows)


def asked_rows(protocols: Sequence[str], scale: str) -> list[Asked]:
    """Return the (protocol, kind of registration) pairs to score; the kind is None under `camera`.

    Args:
        protocols: camera, aligned or both.
        scale: "metric" or "free", as method.json declares it; "free" allows only kinds that estimate a scale.
    """
    kinds = [kind for kind in KINDS if scale == "metric" or "s" in kind]
    found: list[Asked] = [("camera", None)] if "camera" in protocols else []
    return [*found, *(("aligned", kind) for kind in kinds if "aligned" in protocols)]


def _alignment(surface: Surface, kind: str, found: SurfaceRegistration) -> Alignment:
    """Return what a row states about a registration: kind, scale, angle, shift of the centroid, success."""
    middle, scale = surface.center_m, similarity_scale(found.T)
    shift_m = transform_points(found.T, middle) - middle
    return Alignment(
        kind=kind,
        scale=scale,
        rotation_deg=float(np.degrees(rotation_angle_rad(found.T[:3, :3] / scale))),
        translation_m=float(np.linalg.norm(shift_m)),
        ok=found.ok,
    )


def empty_rows(truth: SpaceTruth, asked: Sequence[Asked]) -> tuple[Scored, ...]:
    """Return the rows of a view with an empty prediction, in which each metric has its worst value."""
    nothing = None if truth.is_open else Solid(np.zeros_like(truth.full), 0.0)
    found = figures_by_part(truth, None, nothing)[0]
    return tuple(
        Scored(
            protocol,
            part,
            figures,
            None
            if kind is None
            else Alignment(kind=kind, scale=1.0, rotation_deg=0.0, translation_m=0.0, ok=False),
        )
        for protocol, kind in asked
        for part, figures in found.items()
    )


def _over(truth: SpaceTruth, found: Sequence[tuple[Scored, ...]], votes: Votes) -> list[Scored]:
    """Return the rows that combine several predictions of a view: the best prediction's, and their mean.

    Under each protocol and kind of registration, the best prediction is the one with the smallest Chamfer
    distance (L1) of the whole shape. `found` has the rows of each prediction.
    """
    k = len(found)
    if k == 1:
        return []
    best, mean = Hypotheses(k, "best"), Hypotheses(k, "mean")
    rows: list[Scored] = []
    leader = 0
    for of_one in zip(*found, strict=True):
        if of_one[0].part == "whole":
            far = [row.figures.surface.chamfer_l1_m for row in of_one]
            leader = int(np.argmin([np.inf if one is None else one for one in far]))
        rows.append(replace(of_one[leader], hypotheses=best))
        asked = of_one[0].protocol, of_one[0].alignment.kind if of_one[0].alignment else None
        calibration = votes.calibration(truth, asked, of_one[0].part, k)
        rows.append(replace(_mean(of_one), hypotheses=mean, calibration=calibration))
    return rows


def _mean(rows: Sequence[Scored]) -> Scored:
    """Return a row with the mean of each metric and share; a mean is None if a row has no value.

    `solid` is whether all rows are solid, and `as_papers` is None; everything else is from the first row.
    """
    figures = [row.figures for row in rows]
    surface = SurfaceMetrics(**_means([_vars_of(of.surface) for of in figures]))
    voxels = VoxelMetrics(**_means([_vars_of(of.voxels) for of in figures]))
    return replace(
        rows[0],
        figures=replace(figures[0], surface=surface, voxels=voxels, as_papers=None),
        solid=all(row.solid for row in rows),
        predicted_unknown_share=_mean_of([row.predicted_unknown_share for row in rows]),
        cut=_mean_of([row.cut for row in rows]),
        silhouette=_mean_of([row.silhouette for row in rows]),
    )


def _vars_of(metrics: SurfaceMetrics | VoxelMetrics) -> dict[str, float | None]:
    """Return a metrics object as {name of a metric: value}."""
    return {field.name: getattr(metrics, field.name) for field in fields(metrics)}


def _means(rows: Sequence[Mapping[str, float | None]]) -> dict[str, float | None]:
    return {name: _mean_of([row[name] for row in rows]) for name in rows[0]}


def _mean_of(values: Sequence[float | None]) -> float | None:
    """Return the mean of the values; None if a value is None."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if len(known) == len(values) else None


def cut_share(truth: SpaceTruth, shape: CameraShape, volume_m: Float64 | None) -> float | None:
    """Return the share of the known true solid outside the volume that a method covers.

    Args:
        truth: the truth of the view.
        shape: the predicted shape, camera frame; if it is a grid of cells or distances, that grid also bounds
            the volume.
        volume_m: (2, 3), lowest and highest corner of the volume in the camera frame, metres, as method.json
            declares it; None if it declares none.

    Returns:
        The share; None if nothing bounds the volume, or if no cell of the true solid is known.
    """
    if volume_m is None and shape.cells is None:
        return None
    points_m = truth.some_cells_m
    if not len(points_m):
        return None
    inside = np.ones(len(points_m), bool)
    if volume_m is not None:
        inside &= ((points_m >= volume_m[0]) & (points_m <= volume_m[1])).all(axis=1)
    if shape.cells is not None and shape.T_camera_grid is not None and shape.voxel_size_m is not None:
        T_grid_camera = np.linalg.inv(shape.T_camera_grid).astype(np.float64)
        at = transform_points(T_grid_camera, points_m) / shape.voxel_size_m
        inside &= ((at >= 0) & (at <= shape.cells.shape)).all(axis=1)
    return float(1 - inside.mean())


def outside_mask_share(truth: SpaceTruth, surface: Surface) -> float | None:
    """Return the area share of a predicted surface that projects outside the mask; None if there is no mask.

    The surface is in the camera frame; points behind the camera count as outside.
    """
    if truth.K is None or truth.mask is None:
        return None
    height, width = truth.mask.shape
    points_m = surface.points_m
    before = points_m[:, 2] > 0
    depth_m = np.where(before, points_m[:, 2], 1.0)
    # Pixel centres are integers. Clip, so that pixels far outside do not overflow.
    u = np.clip(np.rint(truth.K[0, 0] * points_m[:, 0] / depth_m + truth.K[0, 2]), -1, width).astype(np.int64)
    v = np.clip(np.rint(truth.K[1, 1] * points_m[:, 1] / depth_m + truth.K[1, 2]), -1, height).astype(
        np.int64
    )
    before &= (u >= 0) & (u < width) & (v >= 0) & (v < height)
    inside = np.zeros(len(points_m), bool)
    inside[before] = truth.mask[v[before], u[before]]
    return float(surface.areas[~inside].sum() / surface.areas.sum())
