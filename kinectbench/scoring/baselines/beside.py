"""Score baselines for comparison with a method, and store their tables beside the method's scores.

Under the grid protocols, only voxel metrics are computed: they suffice to judge a method, and surface metrics
take most of the time. If the method predicts in the camera frame, baselines are scored only under `camera`.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path

from kinectbench.core.artefacts.score_figures import any_in_space
from kinectbench.core.artefacts.scores import BASELINES_FOLDER, ScoreTable
from kinectbench.core.types import Progress, no_progress
from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.release.release import Release
from kinectbench.scoring.assemble import as_of_baseline, describe
from kinectbench.scoring.baselines.counted import baselines_that_differ, counted_baselines
from kinectbench.scoring.baselines.in_space import space_baselines, space_baselines_that_differ
from kinectbench.scoring.baselines.kept import kept_tables
from kinectbench.scoring.baselines.predict import possible_baselines
from kinectbench.scoring.baselines.registry import WITHOUT_SURFACE
from kinectbench.scoring.camera.score import settings_in_space
from kinectbench.scoring.pair_result import Counting


def baselines_beside(
    release: Release,
    out: Path,
    *,
    protocols: Sequence[str],
    upsampling: str = HALF_PIXEL,
    without: Collection[str] = (),
    jobs: int = 1,
    progress: Progress = no_progress,
) -> list[ScoreTable]:
    """Score every baseline that the release allows; `score` gives the same for a baseline's prediction files.

    Tables are kept in `out/baselines/<name>/scores.json`, or under `camera` in
    `out/baselines/<name>+camera/`. A kept table is used again if the release, the settings and the versions
    of counting and of the baselines are the same. As a check, a few of its rows are computed again; they must
    agree. Thresholds are chosen per baseline on the validation split; without that split they are 0.5.

    Args:
        release: the release that is scored.
        out: folder of the scores.
        protocols: names of `PROTOCOLS` that the pairs allow; or `camera` and `aligned`, of which only
            `camera` is scored.
        upsampling: "half-pixel" or "corner-aligned".
        without: names of baselines that are left out.
        jobs: number of processes.
        progress: called with (pairs done, pairs in all); not called if all tables are kept tables.

    Returns:
        A table for each baseline.

    Raises:
        PairError, ReleaseError: a pair cannot be read.
        StorageError: the disk is full or read-only.
    """
    names = [name for name in possible_baselines(release) if name not in without]
    counting = Counting(tuple(protocols), upsampling, surface=False)
    settings, sign = as_of_baseline(describe(counting, "error")), ""
    make: Callable[..., list[ScoreTable]] = counted_baselines
    differ: Callable[..., Iterable[str]] = baselines_that_differ
    how: Counting | tuple[str, ...] = counting
    if any_in_space(protocols):
        names, how = [name for name in names if name not in WITHOUT_SURFACE], ("camera",)
        settings, sign = as_of_baseline(settings_in_space(how, "error")), "+camera"
        make, differ = space_baselines, space_baselines_that_differ
    folders = {name: out / BASELINES_FOLDER / f"{name}{sign}" for name in names}
    tables = kept_tables(folders, release, settings, differ, how, jobs, beside=True)
    wanted = tuple(name for name in names if name not in tables)
    if wanted:
        for table in make(release, wanted, how, jobs=jobs, progress=progress):
            tables[table.method] = table.model_copy(update={"baseline": True})
            tables[table.method].write(folders[table.method])
    return [tables[name] for name in names]
