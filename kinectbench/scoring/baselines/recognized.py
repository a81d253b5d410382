"""Recognize the tables of baselines by their scores, because anyone can name a method like a baseline."""

from collections.abc import Callable

from kinectbench.core.artefacts.scores import ScoreSettings, ScoreTable
from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.release.release import Release
from kinectbench.scoring.assemble import as_of_baseline
from kinectbench.scoring.base_rates import base_rates
from kinectbench.scoring.baselines.predict import possible_baselines
from kinectbench.scoring.pair_result import Counting
from kinectbench.scoring.thresholds import FROM_FILE


def made_table(
    release: Release,
    make: Callable[[ScoreSettings], ScoreTable],
    settings: ScoreSettings,
    counting: Counting,
    jobs: int = 1,
) -> ScoreTable:
    """Return a method's table; if its rows equal those of a baseline, it is marked as a baseline's.

    `make` makes the table from settings like `settings`, which `describe` returned.

    Raises:
        PairError, ReleaseError: a pair cannot be read.
    """
    table = make(settings)
    return make(as_of_baseline(settings)) if is_of_baseline(release, table, counting, jobs) else table


def is_of_baseline(release: Release, table: ScoreTable, how: Counting | tuple[str, ...], jobs: int) -> bool:
    """Return whether a complete table has the rows of the baseline that its method is named after.

    The baseline predicts all pairs again, so that a table with a few other predictions is not accepted.
    Thresholds must be from a file, or those that the baseline chooses on the validation split: with other
    thresholds it would score lower, and be easier to surpass. `how` tells how pairs were counted, or the
    protocols (camera, aligned) of a table in space.

    Raises:
        PairError, ReleaseError: a pair cannot be read.
    """
    if not table.complete or table.method not in possible_baselines(release):
        return False
    # Imported late: slow to load, and few methods have the name of a baseline.
    from kinectbench.scoring.baselines.in_grids import scoring_of
    from kinectbench.scoring.baselines.in_space import thresholds_of_baselines
    from kinectbench.scoring.baselines.reuse import tables_that_differ

    if not (table.threshold_source or "").startswith(FROM_FILE):
        upsampling, rates = getattr(how, "upsampling", HALF_PIXEL), base_rates(release, jobs)
        chosen = thresholds_of_baselines(release, [table.method], rates, jobs, upsampling)
        if chosen[table.method].of != table.thresholds:
            return False
    scoring = scoring_of(how, [table.method])
    return not tables_that_differ(release, {table.method: table}, scoring, jobs, every=True)
