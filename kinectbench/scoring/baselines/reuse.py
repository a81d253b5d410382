"""Reuse score tables of baselines from an earlier run, if they are still valid."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from kinectbench.core import StorageError
from kinectbench.core.artefacts.scores import ScoreSettings, ScoreTable
from kinectbench.release.release import Release
from kinectbench.scoring.read_table import read_table


@dataclass(frozen=True)
class Scoring:
    """How baselines are scored: in grids, or in space.

    Attributes:
        names: the baselines that can be scored in this way.
        settings: the settings that their tables state.
        make: makes tables, given (release, names) and the keywords thresholds_file, jobs and progress.
        differ: computes some rows of tables again, given (release, tables) and the keyword jobs; returns the
            baselines whose rows differ.
    """

    names: tuple[str, ...]
    settings: ScoreSettings
    make: Callable[..., list[ScoreTable]]
    differ: Callable[..., Iterable[str]]


def reusable_tables(
    folders: Mapping[str, Path],
    release: Release,
    scoring: Scoring,
    jobs: int,
    *,
    for_comparison: bool,
) -> dict[str, ScoreTable]:
    """Return the stored tables that are still valid, {baseline: its table}.

    A table is valid if release, settings, and the versions of `score` and of the baselines are unchanged, and
    its thresholds are from no file. A few of its rows are computed again as a check, and must be equal.

    Args:
        folders: {baseline: folder of its table}.
        release: the release that is scored.
        scoring: how baselines are scored now.
        jobs: number of processes.
        for_comparison: whether `comparison_baselines` stored the tables.

    Raises:
        PairError, ReleaseError: a pair cannot be read.
    """
    kept = {
        name: _kept(folder, name, release, scoring.settings, for_comparison)
        for name, folder in folders.items()
    }
    tables = {name: table for name, table in kept.items() if table is not None}
    wrong = set(scoring.differ(release, tables, jobs=jobs)) if tables else set()
    return {name: table for name, table in tables.items() if name not in wrong}


def _kept(
    folder: Path, name: str, release: Release, settings: ScoreSettings, for_comparison: bool
) -> ScoreTable | None:
    """Return a baseline's table if it is readable, and of this release and these settings; else None."""
    try:
        table = read_table(folder / ScoreTable.FILE)
    except StorageError:  # there is none, or it is damaged or contradicts itself
        return None
    made = (table.method, table.baseline, table.benchmark_sha256, table.settings)
    same = made == (name, for_comparison, release.benchmark_sha256, settings)
    by_file = (table.threshold_source or "").startswith("file:")
    return table if same and not by_file and (table.complete or table.failures) else None
