"""Say everything that is wrong with a submission at once, without scoring it."""

from collections.abc import Callable
from pathlib import Path

from kinectbench.errors import PredictionError
from kinectbench.release.release import Release, Target
from kinectbench.scoring.mesh_prediction import MESHES
from kinectbench.scoring.prediction_file import load_prediction
from kinectbench.scoring.predictions import find_predictions, missing_line, stray_line
from kinectbench.scoring.truth import read_voxel_size


def check(release: Release, folder: Path, progress: Callable[[int, int], None] | None = None) -> list[str]:
    """Check one method's predictions for the test split, and for validation if it answers any of it.

    Args:
        release: what the predictions are for.
        folder: one method's predictions.
        progress: called with (files done, files in all).

    Returns:
        One line per problem, in the order of the targets, stray files last; empty if all is well.

    Raises:
        PredictionError: the folder is missing.
    """
    found = find_predictions(folder, release.targets)
    answered = {target.split for target in (*found.files, *found.problems)}
    required = {"test", "validation"} & answered | {"test"}
    missing = {target: missing_line(target) for target in found.missing if target.split in required}
    problems = []
    for done, target in enumerate(release.targets, start=1):
        line = found.problems.get(target) or missing.get(target)
        if target in found.files:
            line = _file_problem(release, target, found.files[target])
        if line:
            problems.append(line)
        if progress:
            progress(done, len(release.targets))
    return problems + [stray_line(name, found.missing) for name in found.stray]


def _file_problem(release: Release, target: Target, path: Path) -> str | None:
    """What is wrong with one file, or None."""
    size_m = read_voxel_size(release.pair_path(target), target.sha256) if path.suffix in MESHES else None
    try:
        load_prediction(path, target.name + path.suffix, size_m)
    except PredictionError as error:
        return str(error)
    return None
