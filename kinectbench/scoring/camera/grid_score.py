"""Score a method under the protocols camera and aligned, if it predicts in the grids of the pairs."""

from collections.abc import Sequence

from kinectbench.core import SettingsError
from kinectbench.core.artefacts.counted import PairResult
from kinectbench.core.artefacts.score_figures import IN_SPACE
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.types import Progress, no_progress
from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.release.release import Release
from kinectbench.scoring.camera.grid import GridJob, score_grid
from kinectbench.scoring.camera.score import refuse_many_rows, settings_in_space, table_in_space
from kinectbench.scoring.camera.truth import files_of
from kinectbench.scoring.camera.view import ViewResult, asked_rows
from kinectbench.scoring.pair_result import Counting, Journal
from kinectbench.scoring.rounds import Missing, Plan, Rounds
from kinectbench.scoring.workers import run_tasks

# Thresholds are searched by the IoU over all cells, so surface metrics are not needed.
SEARCHING = Counting(("paper",), surface=False)


def space_alone(
    protocols: Sequence[str] | None, upsampling: str, close: str | None = None
) -> tuple[str, ...]:
    """Return those of the requested protocols that are `camera` or `aligned`; () if neither is requested.

    Raises:
        SettingsError: `camera` or `aligned` is combined with other protocols, or with another upsampling than
            half-pixel; or `close` is given, which does not apply to predictions in grids.
    """
    if close is not None:
        raise SettingsError(
            f"--close {close}: only of meshes and points whose method.json has 'frame': 'camera'"
        )
    asked = tuple(name for name in IN_SPACE if name in (protocols or ()))
    if others := [name for name in protocols or () if asked and name not in asked]:
        raise SettingsError(
            f"--protocol {', '.join(asked)} and {', '.join(others)}: surfaces in space and cells have tables "
            "of their own; score twice, each with a folder --out"
        )
    if asked and upsampling != HALF_PIXEL:
        raise SettingsError(f"--upsampling {upsampling}: under {', '.join(asked)} it is {HALF_PIXEL}")
    return asked


def score_grid_in_space(
    release: Release,
    asked: Plan,
    method: str,
    protocols: tuple[str, ...],
    missing: Missing,
    jobs: int,
    progress: Progress,
) -> ScoreTable:
    """Score in space, on the test split, a method that predicts voxels in each pair's grid; return the table.

    Args:
        release: the release that was predicted.
        asked: the method's prediction files, and its thresholds or how to choose them.
        method: the method's name.
        protocols: camera, aligned or both.
        missing: "error" or "empty", how missing predictions were treated when `asked` was made; here it is
            only noted in the table.
        jobs: number of processes.
        progress: called with (test views done, test views in all).

    Raises:
        ReleaseError: a pair file is missing or changed.
        SettingsError: the table would have too many rows.
    """
    rows = tuple(asked_rows(protocols, "metric"))
    refuse_many_rows(len(release.split("test")), rows)
    rounds = Rounds(release, SEARCHING, Journal(None), jobs, no_progress)
    searched = {target: file for target, file in asked.files.items() if target.split == "validation"}
    outcomes, thresholds = rounds.count(searched, asked.fixed, asked.own)
    validation = {t: found.digest for t, found in outcomes.items() if isinstance(found, PairResult)}
    tasks = [
        GridJob(t, files_of(release, t), asked.files[t], thresholds.of[t.category], rows)
        for t in sorted(asked.files)
        if t.split == "test"
    ]
    found = {
        task.target: of for task, of in zip(tasks, run_tasks(score_grid, tasks, jobs, progress), strict=True)
    }
    reasons = {t: of for t, of in (outcomes | found).items() if isinstance(of, str)}
    return table_in_space(
        release,
        method,
        {t: of for t, of in found.items() if isinstance(of, ViewResult)},
        asked.failures | reasons,
        settings_in_space(protocols, missing),
        sorted(t.name for t, file in asked.files.items() if file is None),
        thresholds,
        validation,
    )
