"""The predictions that a gallery shows, read once more after scoring and reduced to 64^3."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from kinectbench.release.release import Release
from kinectbench.report.gallery_file import CELLS_SHAPE, choose_pairs, reduced
from kinectbench.scoring.counts import PRIMARY
from kinectbench.scoring.mesh_prediction import MESHES
from kinectbench.scoring.occupancy import occupied
from kinectbench.scoring.prediction_file import load_prediction
from kinectbench.scoring.predictions import find_predictions
from kinectbench.scoring.table import ScoreTable
from kinectbench.scoring.truth import read_voxel_size
from kinectbench.voxels.pair_file import Packed
from kinectbench.voxels.resample import HALF_PIXEL

Progress = Callable[[int, int], None]


def gallery_cells(
    release: Release,
    predictions: Path,
    table: ScoreTable,
    upsampling: str = HALF_PIXEL,
    progress: Progress | None = None,
) -> dict[str, Packed]:
    """{pair: (64, 64, 8) uint8, packed} of the pairs worth showing, above the thresholds they were scored at.

    Args:
        release: what was predicted.
        predictions: the method's folder; a prediction that could not be scored is left out.
        table: its scores.
        upsampling: see `upsampled_planes`.
        progress: called with (pairs done, pairs in all).

    Raises:
        PredictionError: a file that was scored has gone or changed.
    """
    protocol = PRIMARY if PRIMARY in table.settings["protocols"] else table.settings["protocols"][0]
    rows = {f"{row.recording}/{row.view}": row for row in table.rows if row.protocol == protocol}
    rising = sorted(rows, key=lambda name: (rows[name].iou, name))
    targets = {target.name: target for target in release.split("test")}
    chosen = [name for name in choose_pairs(rising, list(targets)) if name in rows]
    files = find_predictions(predictions, [targets[name] for name in chosen]).files
    cells = {}
    for done, name in enumerate(chosen):
        if progress:
            progress(done, len(chosen))
        target, file = targets[name], files.get(targets[name])
        if file is None:  # missing, and scored as empty
            cells[name] = np.zeros(CELLS_SHAPE, np.uint8)
            continue
        mesh = file.suffix in MESHES
        size_m = read_voxel_size(release.pair_path(target), target.sha256) if mesh else None
        grid = load_prediction(file, name + file.suffix, size_m)
        cells[name] = reduced(occupied(grid, rows[name].threshold, upsampling))
    return cells
