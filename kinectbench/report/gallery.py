"""Make a page's gallery: some pairs and their predictions at 64^3, as text that the browser unpacks."""

import base64
import contextlib
import json
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from markupsafe import Markup

from kinectbench.core import PredictionError, ReleaseError, images
from kinectbench.core.artefacts.gallery import CELLS_SHAPE, Gallery
from kinectbench.core.artefacts.score_figures import ScoreRow
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.even_choice import evenly
from kinectbench.core.listing import inert_json
from kinectbench.core.pictures import block_density
from kinectbench.core.types import Float64, Progress, no_progress
from kinectbench.core.voxels.pair_file import BLOCK, PARTIAL_CELLS, Packed, pack, unpack
from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.release.release import Release, Target
from kinectbench.release.view_images import color, depth_m, mask
from kinectbench.scoring.baselines.predict import BaselineTask, predicted
from kinectbench.scoring.camera.surface import Surface
from kinectbench.scoring.camera.truth import SpaceTruth, files_of, read_space_truth
from kinectbench.scoring.counts import Prediction, occupied
from kinectbench.scoring.mesh_prediction import MESHES
from kinectbench.scoring.prediction_file import load_hashed
from kinectbench.scoring.predictions import find_predictions
from kinectbench.scoring.protocols import PRIMARY
from kinectbench.scoring.truth import read_parts, read_voxel_size
from kinectbench.scoring.workers import run_tasks

# Largest text of a gallery; the rest of a page is its pictures. The second limit is for a page of many
# recordings, which has 5 MB in all.
MAX_BYTES, MAX_BYTES_OF_MANY = 4 << 20, 1 << 20
DEFLATE_LEVEL = 6
# Pairs shown of a method: this many of the best, and of the worst; and pairs shown of every method.
EXTREME, SHARED = 6, 12
# Width of the view beside a pair: 3 to 6 kB.
VIEW_PX = 200
# A cell of 64 is drawn if this share of its 4 x 4 x 4 voxels is set: parts thinner than a cell stay visible.
DRAWN_SHARE = 0.25


def shown_pairs(rising: Sequence[str], every: Sequence[str]) -> list[str]:
    """Return the sorted names of a method's shown pairs: its best, its worst, and some spread over all.

    Args:
        rising: the method's pairs, from the worst to the best.
        every: all pairs of the test split, in the same order for every method.
    """
    spread = {every[i] for i in evenly(len(every), SHARED)}
    return sorted({*rising[:EXTREME], *rising[::-1][:EXTREME], *spread})


def reduced_packed(packed: Packed) -> Packed:
    """Reduce packed (256, 256, 32) to (64, 64, 8): a cell is set if at least a quarter of its voxels is."""
    return pack(block_density(packed) >= np.float32(DRAWN_SHARE))


def gallery_cells(
    release: Release,
    predictions: Path,
    table: ScoreTable,
    upsampling: str = HALF_PIXEL,
    progress: Progress = no_progress,
) -> dict[str, Packed]:
    """Return {shown pair: packed cells (64, 64, 8) uint8 of its prediction, at the threshold of its score}.

    Args:
        release: the release that was predicted.
        predictions: the method's folder. A pair without a file gets an empty grid; one that could not be
            scored is left out.
        table: the method's scores.
        upsampling: convention for grids of fewer or more than 256 cells, "half-pixel" or "corner-aligned".
        progress: called with (pairs done, pairs in all).

    Raises:
        PredictionError: a file cannot be read as a prediction, or is not the scored one.
        ReleaseError: the pair of a predicted mesh, whose cell size is needed, is missing or not the published
            one.
    """
    files = find_predictions(predictions, release.split("test")).files

    def load(target: Target) -> Prediction | None:
        """Return the prediction of a pair, or None if it is missing."""
        file = files.get(target)
        if file is None:  # missing, scored as empty
            return None
        mesh = file.suffix in MESHES
        size_m = read_voxel_size(release.pair_path(target), target.sha256) if mesh else None
        found, scored = load_hashed(file, target.name + file.suffix, size_m), table.hashes.get(target.name)
        if scored is not None and scored.prediction != found.digest:
            raise PredictionError(f"{file}: changed after it was scored; score again", what="changed")
        return found.prediction

    return loaded_cells(release, load, table, upsampling, progress)


def loaded_cells(
    release: Release,
    load: Callable[[Target], Prediction | None],
    table: ScoreTable,
    upsampling: str = HALF_PIXEL,
    progress: Progress = no_progress,
) -> dict[str, Packed]:
    """Return the cells of `gallery_cells` for predictions that `load` returns; None gives an empty grid."""
    chosen = chosen_pairs(release, table)
    cells = {}
    for done, (target, threshold) in enumerate(chosen.items()):
        progress(done, len(chosen))
        cells[target.name] = _drawn(load(target), threshold, upsampling)
    return cells


def baseline_cells(
    release: Release,
    tables: Sequence[ScoreTable],
    upsampling: str = HALF_PIXEL,
    jobs: int = 1,
    progress: Progress = no_progress,
) -> list[dict[str, Packed]]:
    """Predict the shown pairs again: return for each baseline {pair: packed cells (64, 64, 8) uint8}.

    Args:
        release: the release that was predicted.
        tables: the baselines' scores.
        upsampling: convention for grids of fewer or more than 256 cells, "half-pixel" or "corner-aligned".
        jobs: number of processes.
        progress: called with (pairs done, pairs in all).

    Raises:
        PairError, ReleaseError: a pair cannot be read.
    """
    wanted: dict[Target, dict[str, float]] = {}
    for table in tables:
        for target, threshold in chosen_pairs(release, table).items():
            wanted.setdefault(target, {})[table.method] = threshold
    tasks = []
    for target, thresholds in sorted(wanted.items(), key=lambda item: item[0]):
        rate = tables[0].base_rate[target.category].value
        tasks.append((BaselineTask(release, target, rate, tuple(thresholds)), thresholds))
    results = run_tasks(partial(_baselines_of, upsampling), tasks, jobs, progress)
    return [
        {
            task.target.name: cells[table.method]
            for (task, _), cells in zip(tasks, results, strict=True)
            if table.method in cells
        }
        for table in tables
    ]


def _baselines_of(upsampling: str, task: tuple[BaselineTask, Mapping[str, float]]) -> dict[str, Packed]:
    """Predict one pair by some baselines: return {baseline: packed cells (64, 64, 8)}."""
    baselines, thresholds = task
    return {name: _drawn(grid, thresholds[name], upsampling) for name, grid in predicted(baselines)}


def chosen_pairs(release: Release, table: ScoreTable) -> dict[Target, float]:
    """Return {shown pair of a method: threshold at which its prediction was scored}."""
    protocols = table.settings.protocols
    first = next((row.heading for row in table.rows if row.protocol == protocols[0]), protocols[0])
    rows = {row.pair: row for row in table.pairs(PRIMARY if PRIMARY in protocols else first)}
    figures = {name: _figure(row) for name, row in rows.items()}
    rising = [name for _, name in sorted((of, name) for name, of in figures.items() if of is not None)]
    targets = {target.name: target for target in release.split("test")}
    shown = shown_pairs(rising, list(targets))
    return {targets[name]: rows[name].threshold for name in shown if name in rows}


def _figure(row: ScoreRow) -> float | None:
    """Return a row's sort key: IoU, or minus the Chamfer distance (higher is better); None if unknown."""
    if row.in_space:
        return None if row.chamfer_l1_m is None else -row.chamfer_l1_m
    return row.iou


def _drawn(grid: Prediction | None, threshold: float, upsampling: str) -> Packed:
    """Return the cells of a prediction above a threshold, packed (64, 64, 8); None: an empty grid."""
    if grid is None:
        return np.zeros(CELLS_SHAPE, np.uint8)
    return reduced_packed(occupied(grid, threshold, upsampling))


@dataclass(frozen=True)
class PairTruth:
    """The gallery's data of one pair, apart from predictions; grids have 64 cells a side.

    Attributes:
        category: such as "chair".
        object: the recorded object.
        up: (3,) unit vector that points up, in the grid's axes.
        partial: (64, 64, 8) uint8, packed.
        full: (64, 64, 8) uint8, packed, the true shape.
        known: (64, 64, 8) uint8, packed; a cell is set if the voxel just beyond its middle is known.
        unseen: (64, 64, 8) uint8, packed, the cells of `full` in which at least half of the shape's voxels
            are not known.
        picture: the view's depth, and its colour if published, as a `data:` URL; "" without images.
    """

    category: str
    object: str
    up: Float64
    partial: Packed
    full: Packed
    known: Packed
    unseen: Packed
    picture: str = ""


def read_pair_truth(release: Release, target: Target) -> PairTruth:
    """Read the parts of a release's pair that the page shows.

    If the truth is an open mesh, `full` has the cells with points of its surface, and all cells are known.

    Raises:
        ReleaseError: the pair file is missing, damaged or not the published one.
    """
    path = release.pair_path(target)
    if target.split in release.metadata.surface_truth:
        truth = read_space_truth(files_of(release, target))
        partial, T_world_grid = read_parts(path, target.sha256, ("partial", "T_world_grid"))
        drawn = surface_cells(truth, truth.surface)
        known, unseen = np.full_like(drawn, 255), np.zeros_like(drawn)
    else:
        names = ("partial", "full", "known", "T_world_grid")
        partial, full, known, T_world_grid = read_parts(path, target.sha256, names)
        drawn = reduced_packed(full)
        known, unseen = _sampled(known), _unseen(full, known) & drawn
    up = _up_grid(release, target.recording, T_world_grid)
    return PairTruth(
        target.category, target.object, up, partial, drawn, known, unseen, _picture(release, target)
    )


def surface_cells(truth: SpaceTruth, surface: Surface) -> Packed:
    """Return packed (64, 64, 8), the cells of the truth's cube with points of a surface (grid frame)."""
    at = np.floor(surface.points_m / (truth.voxel_size_m * BLOCK))
    inside = ((at >= 0) & (at < PARTIAL_CELLS)).all(axis=1)
    cells = np.zeros((PARTIAL_CELLS,) * 3, np.bool_)
    cells[tuple(at[inside].astype(np.int64).T)] = True
    return pack(cells)


def _picture(release: Release, target: Target) -> str:
    """Return a picture of the view as a `data:` URL: depth with the mask's outline, and colour to its right.

    The result is "" if the release has no valid depth or mask of the view, or if this machine has no decoder.
    """
    if find_spec("cv2") is None:  # without a decoder the page has no pictures
        return ""
    try:
        depth = images.depth_picture((depth_m(release, target) * 1000).astype(np.uint16))
        seen = mask(release, target)
        if seen.shape != depth.shape[:2]:
            return ""
        shown = [images.overlay_mask(depth, seen)]
    except ReleaseError:  # synthesised views have none
        return ""
    with contextlib.suppress(ReleaseError):
        shown.append(images.shrunk(color(release, target), max(depth.shape)))
    height = min(len(picture) for picture in shown)
    return images.data_uri(
        images.shrunk(np.concatenate([p[:height] for p in shown], axis=1), VIEW_PX * len(shown))
    )


def _unseen(full: Packed, known: Packed) -> Packed:
    """Return packed (64, 64, 8), the cells in which at least half of the voxels of `full` are not known.

    Cells without a voxel of `full` are among them.
    """
    share_unknown = block_density(full & ~known)
    return pack(share_unknown >= block_density(full) / np.float32(2))


def _up_grid(release: Release, recording: str, T_world_grid: Float64) -> Float64:
    """Return the up direction (3,) in grid axes: the floor's normal, or up in the image without a floor."""
    up = np.zeros(3)
    with contextlib.suppress(ReleaseError):  # only affects how a picture is turned
        floor = release.floor(recording)
        up = up if floor is None else floor.T_floor_world[2, :3] @ T_world_grid[:3, :3]
    length = float(np.linalg.norm(up))
    return up / length if length > 0 and np.isfinite(length) else np.array([0.0, -1, 0])


def _sampled(packed: Packed) -> Packed:
    """Sample packed (256, 256, 32) to packed (64, 64, 8): take the voxel just beyond each cell's middle."""
    middle = BLOCK // 2
    return pack(unpack(packed[middle::BLOCK, middle::BLOCK])[..., middle::BLOCK])


def gallery_json(
    tables: Sequence[ScoreTable],
    galleries: Sequence[Gallery | None],
    truths: Mapping[str, PairTruth],
    protocol: str,
    *,
    many: bool = False,
) -> tuple[Markup | None, int]:
    """Return the gallery's data as JSON of limited size for a page.

    Args:
        tables: the methods' scores.
        galleries: each method's gallery; None if there is none.
        truths: {pair: its truth}; pairs without truth are not shown.
        protocol: the protocol whose scores are shown. If a method was not scored under it, the scores of its
            first row's protocol are shown, with the name of that protocol.
        many: whether the page shows many recordings; then the gallery is smaller.

    Returns:
        The JSON text (None if there is nothing to show), and the number of pairs left out to limit its size.
    """
    shown_by = [
        {name: _text(cells) for name, cells in (gallery or {}).items() if name in truths}
        for gallery in galleries
    ]
    holders = Counter(name for of in shown_by for name in of)
    room, kept = MAX_BYTES_OF_MANY if many else MAX_BYTES, {}
    for name in sorted(holders, key=lambda name: (-holders[name], name)):
        truth = _truth(truths[name])
        size = len(json.dumps({"truth": truth, "by": [of.get(name) for of in shown_by]}))
        if size <= room:
            room -= size
            kept[name] = truth
    if not kept:
        return None, len(holders)
    methods = []
    for table, cells in zip(tables, shown_by, strict=True):
        headings = [row.heading for row in table.rows] or [""]
        under = protocol if protocol in headings else headings[0]
        rows = {row.pair: row for row in table.pairs(under)}
        pairs = {
            name: {
                **({} if under == protocol else {"under": under}),
                "iou": rows[name].iou,
                "chamfer_m": rows[name].chamfer_l1_m,
                "threshold": rows[name].threshold,
                "cells": cells[name],
            }
            for name in sorted(kept)
            if name in cells and name in rows
        }
        if pairs:
            methods.append({"name": table.method, "pairs": pairs})
    content = {"protocol": protocol, "pairs": {name: kept[name] for name in sorted(kept)}, "methods": methods}
    return inert_json(content), len(holders) - len(kept)


def _truth(truth: PairTruth) -> dict[str, object]:
    grids = {name: _text(getattr(truth, name)) for name in ("partial", "full", "known", "unseen")}
    up = [round(float(value), 5) for value in truth.up]
    picture = {"picture": truth.picture} if truth.picture else {}
    return {"category": truth.category, "object": truth.object, "up": up, **picture, **grids}


def _text(packed: Packed) -> str:
    return base64.b64encode(zlib.compress(packed.tobytes(), DEFLATE_LEVEL)).decode()
