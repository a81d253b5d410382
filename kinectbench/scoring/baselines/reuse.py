"""Reuse score tables of baselines from an earlier run, if they are still valid."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from kinectbench.core import StorageError
from kinectbench.core.artefacts.score_figures import ScoreRow
from kinectbench.core.artefacts.scores import ScoreSettings, ScoreTable
from kinectbench.release.release import Release
from kinectbench.scoring.base_rates import base_rates
from kinectbench.scoring.baselines.predict import baseline_tasks
from kinectbench.scoring.pair_result import drawn
from kinectbench.scoring.read_table import differing, read_table
from kinectbench.scoring.thresholds import Thresholds


@dataclass(frozen=True)
class Scoring:
    """How baselines are scored: in grids, or in space.

    Attributes:
        names: the baselines that can be scored in this way.
        settings: the settings that their tables state.
        make: makes tables, given (release, names) and the keyword `request`, a `Request`.
        again: yields (baseline, its rows) for tasks of the test split, given (tasks, {baseline: thresholds},
            {category: base rate}, number of processes).
    """

    names: tuple[str, ...]
    settings: ScoreSettings
    make: Callable[..., list[ScoreTable]]
    again: Callable[..., Iterable[tuple[str, Sequence[ScoreRow]]]]


def reusable_tables(
    folders: Mapping[str, Path], release: Release, scoring: Scoring, jobs: int, *, for_comparison: bool
) -> dict[str, ScoreTable]:
    """Return the stored tables that are still valid, {baseline: its table}.

    A table is valid if release, settings, and the versions of `score` and of the baselines are unchanged, and
    its thresholds are from no file. A few of its rows are computed again as a check, and must be equal.
    `for_comparison` tells whether `comparison_baselines` stored them.

    Raises:
        PairError, ReleaseError: a pair cannot be read.
    """
    kept = {
        name: _kept(folder, name, release, scoring.settings, for_comparison)
        for name, folder in folders.items()
    }
    tables = {name: table for name, table in kept.items() if table is not None}
    wrong = tables_that_differ(release, tables, scoring, jobs) if tables else set()
    return {name: table for name, table in tables.items() if name not in wrong}


def tables_that_differ(
    release: Release, tables: Mapping[str, ScoreTable], scoring: Scoring, jobs: int, *, every: bool = False
) -> set[str]:
    """Score some test pairs again; return the baselines whose tables have other rows for these pairs.

    Args:
        release: the release that was predicted.
        tables: {baseline: its table}, made in the way of `scoring`.
        scoring: how baselines are scored.
        jobs: number of processes.
        every: whether all pairs are scored again; else a few that are randomly drawn.

    Raises:
        PairError, ReleaseError: a pair cannot be read.
    """
    rates, categories = base_rates(release, jobs), {target.category for target in release.split("test")}
    thresholds = {
        name: Thresholds(table.thresholds, "")
        for name, table in tables.items()
        if categories <= table.thresholds.keys()
    }
    tasks = baseline_tasks(release, tuple(thresholds), rates, ("test",))
    names = [task.target.name for task in tasks]
    pairs = {*names} if every else drawn(names, "".join(table.facts_sha256() for table in tables.values()))
    chosen = [task for task in tasks if task.target.name in pairs]
    wrong = set(tables.keys() - thresholds.keys())
    for name, rows in scoring.again(chosen, thresholds, rates, jobs):
        kept = {(row.pair, row.heading): row for row in tables[name].rows if row.pair in pairs}
        again = {(row.pair, row.heading): row for row in rows}
        both = kept.keys() | again.keys()
        if any(any(differing(kept.get(key), again.get(key), "", whole=True)) for key in both):
            wrong.add(name)
    return wrong


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
