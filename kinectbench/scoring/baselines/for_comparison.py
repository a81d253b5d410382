"""Score baselines for comparison with a method, and store their tables beside the method's scores.

Under the grid protocols, only voxel metrics are computed: they suffice to judge a method, and surface metrics
take most of the time. If the method predicts in the camera frame, baselines are scored only under `camera`.
"""

from collections.abc import Collection, Sequence
from pathlib import Path

from kinectbench.core.artefacts.score_figures import any_in_space
from kinectbench.core.artefacts.scores import BASELINES_FOLDER, ScoreTable
from kinectbench.core.types import Progress, no_progress
from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.release.release import Release
from kinectbench.scoring.baselines.in_grids import scoring_of
from kinectbench.scoring.baselines.predict import possible_baselines
from kinectbench.scoring.baselines.reuse import reusable_tables
from kinectbench.scoring.pair_result import Counting


def comparison_baselines(
    release: Release,
    out: Path,
    *,
    protocols: Sequence[str],
    upsampling: str = HALF_PIXEL,
    without: Collection[str] = (),
    jobs: int = 1,
    progress: Progress = no_progress,
) -> list[ScoreTable]:
    """Score every baseline that the release allows, for comparison with a method.

    Tables are stored in `out/baselines/<name>/scores.json`, or for the protocol `camera` in
    `out/baselines/<name>+camera/`. Valid tables of an earlier run are reused (`reusable_tables`). Thresholds
    are chosen per baseline on the validation split; without that split they are 0.5.

    Args:
        release: the release that is scored.
        out: folder of the scores.
        protocols: names of `PROTOCOLS` that the pairs allow; or `camera` and `aligned`, of which only
            `camera` is scored.
        upsampling: "half-pixel" or "corner-aligned".
        without: names of baselines that are left out.
        jobs: number of processes.
        progress: called with (pairs done, pairs in all); not called if all tables are reused.

    Returns:
        A table for each baseline.

    Raises:
        PairError, ReleaseError: a pair cannot be read.
        StorageError: the disk is full or read-only.
    """
    names = [name for name in possible_baselines(release) if name not in without]
    in_space = any_in_space(protocols)
    counting = Counting(tuple(protocols), upsampling, surface=False)
    scoring, sign = scoring_of(("camera",) if in_space else counting, names), "+camera" * in_space
    folders = {name: out / BASELINES_FOLDER / f"{name}{sign}" for name in scoring.names}
    tables = reusable_tables(folders, release, scoring, jobs, for_comparison=True)
    if wanted := [name for name in scoring.names if name not in tables]:
        for table in scoring.make(release, wanted, jobs=jobs, progress=progress):
            tables[table.method] = table.model_copy(update={"baseline": True})
            tables[table.method].write(folders[table.method])
    return [tables[name] for name in scoring.names]
