"""Make the gallery of predictions in the camera frame: the cells of their surfaces or solids, at 64^3."""

from pathlib import Path

import numpy as np

from kinectbench.core import PredictionError
from kinectbench.core.artefacts.gallery import CELLS_SHAPE
from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.types import Progress, no_progress
from kinectbench.core.voxels.pair_file import Packed
from kinectbench.release.release import Release
from kinectbench.report.gallery import chosen_pairs, reduced_packed, surface_cells
from kinectbench.scoring.camera.align import register_surface
from kinectbench.scoring.camera.solid import solid_in
from kinectbench.scoring.camera.surface import surface_of
from kinectbench.scoring.camera.truth import SpaceTruth, files_of, read_space_truth
from kinectbench.scoring.camera_predictions import CameraPredictionFile, find_files, load_camera_shape
from kinectbench.scoring.camera_shape import CameraShape
from kinectbench.scoring.closed_mesh import closed_mesh


def space_cells(
    release: Release,
    predictions: Path,
    method: MethodFile,
    table: ScoreTable,
    progress: Progress = no_progress,
) -> dict[str, Packed]:
    """Return {shown view: its prediction as cells, (64, 64, 8) uint8, packed}.

    If there are several hypotheses of a view, the first is taken. A missing prediction gives an empty grid.

    Args:
        release: the release that was predicted.
        predictions: the method's folder.
        method: content of method.json. Predictions of unknown scale are first registered by `R+t+s`.
        table: the method's scores.
        progress: called with (views done, views in all).
    """
    chosen = chosen_pairs(release, table)
    found = {
        target: file
        for target, _, file in reversed([*find_files(predictions, chosen, method)])
        if isinstance(file, CameraPredictionFile)
    }
    cells: dict[str, Packed] = {}
    for done, target in enumerate(chosen):
        progress(done, len(chosen))
        cells[target.name] = np.zeros(CELLS_SHAPE, np.uint8)
        if target in found:
            truth, shape = (
                read_space_truth(files_of(release, target)),
                load_camera_shape(found[target], method),
            )
            free = method.scale == "free"
            cells[target.name] = _prediction_cells(truth, shape, "R+t+s" if free else None)
    return cells


def _prediction_cells(truth: SpaceTruth, shape: CameraShape, kind: str | None) -> Packed:
    """Return the cells of a predicted solid, or of its surface if it is open: packed (64, 64, 8).

    `kind` names the registration to the truth that comes first, such as "R+t+s"; None: no registration.
    """
    surface, T = surface_of(shape), truth.T_grid_camera
    if kind is not None:
        T = register_surface(truth, surface.transformed(T), kind).T @ T
    try:
        solid = solid_in(truth, shape, closed_mesh(shape), T)
    except PredictionError:  # same outcome as in scoring
        solid = None
    return surface_cells(truth, surface.transformed(T)) if solid is None else reduced_packed(solid.cells)
