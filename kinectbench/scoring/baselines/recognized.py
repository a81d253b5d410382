"""Recognize the tables of baselines by their scores, because anyone can name a method like a baseline."""

from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.release.release import Release
from kinectbench.scoring.baselines.counted import baselines_that_differ
from kinectbench.scoring.baselines.in_space import space_baselines_that_differ
from kinectbench.scoring.baselines.predict import possible_baselines
from kinectbench.scoring.pair_result import Counting


def is_of_baseline(release: Release, table: ScoreTable, how: Counting | tuple[str, ...], jobs: int) -> bool:
    """Return whether a complete table has the rows of the baseline that its method is named after.

    A few randomly drawn pairs are predicted by the baseline and counted again.

    Args:
        release: the release that was predicted.
        table: the table; its method may have any name.
        how: how pairs were counted; or the protocols (camera, aligned) of a table in space.
        jobs: number of processes.

    Raises:
        PairError, ReleaseError: a pair cannot be read.
    """
    if not table.complete or table.method not in possible_baselines(release):
        return False
    if isinstance(how, Counting):
        return not baselines_that_differ(release, {table.method: table}, how, jobs)
    return not space_baselines_that_differ(release, {table.method: table}, how, jobs)
