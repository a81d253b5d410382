"""Score one method's predictions against a release."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from kinectbench.errors import ReleaseError, SettingsError
from kinectbench.release.release import Release, Target, check_splits
from kinectbench.scoring.assemble import describe, make_table
from kinectbench.scoring.base_rate import base_rates
from kinectbench.scoring.counts import PROTOCOLS
from kinectbench.scoring.journal import Journal
from kinectbench.scoring.pair_result import Counting, Job, PairResult, count_job
from kinectbench.scoring.predictions import FoundPredictions, find_predictions, missing_line
from kinectbench.scoring.table import ScoreTable
from kinectbench.scoring.thresholds import Thresholds, read_thresholds, searched_thresholds
from kinectbench.scoring.workers import Progress, run_tasks
from kinectbench.voxels.resample import CONVENTIONS, HALF_PIXEL

Missing = Literal["error", "empty"]


def score(
    release: Release,
    predictions: Path,
    *,
    method: str,
    protocols: Sequence[str] = tuple(PROTOCOLS),
    thresholds_file: Path | None = None,
    missing: Missing = "error",
    upsampling: str = HALF_PIXEL,
    surface: bool = True,
    jobs: int = 1,
    progress: Progress | None = None,
    resume_in: Path | None = None,
) -> ScoreTable:
    """Score the test split; predictions of the validation split only choose the thresholds.

    Args:
        release: what the predictions are for.
        predictions: one method's folder, `<recording>/<view>.npy` or `.npz`; untrusted.
        method: its name.
        protocols: some of "paper", "known", "occluded".
        thresholds_file: see `read_thresholds`; it wins over the validation split.
        missing: "error" lists a missing prediction as a failure; "empty" scores an empty grid for it.
        upsampling: "half-pixel" or "corner-aligned" (see `upsample`).
        surface: whether surface metrics are computed; they take most of the time.
        jobs: number of processes; the result does not depend on it.
        progress: called with (pairs done, pairs in all).
        resume_in: a folder that keeps what is counted until all is; None keeps nothing.

    Returns:
        The table. A prediction that cannot be scored is in its `failures`; the rest has been scored.

    Raises:
        PredictionError: the folder is missing.
        ReleaseError: no test pair, an object in two splits, a pair file is missing or changed, or the truth
            is held back.
        SettingsError: an unknown protocol or an unusable threshold file.
    """
    check_words(protocols, upsampling)
    check_splits(release.targets, str(release.folder))
    test = release.split("test")
    if not test:
        raise ReleaseError(f"{release.folder}: no pair in the test split; nothing to score")
    release.require_truth(("test", "validation") if thresholds_file is None else ("test",))
    categories = sorted({target.category for target in test})
    fixed = None
    if thresholds_file is not None:
        fixed = read_thresholds(thresholds_file, categories, frozenset(target.object for target in test))
    found = find_predictions(predictions, (*test, *release.split("validation")))
    files, failures = _plan(found, missing, with_validation=fixed is None)
    counting, journal = Counting(tuple(protocols), upsampling, surface), Journal(resume_in)
    run = _Run(release, counting, journal, jobs, progress, len(files))

    validation = run.count({t: file for t, file in files.items() if t.split == "validation"}, None)
    thresholds = fixed or searched_thresholds(
        categories,
        {target: result.tally for target, result in validation.items() if isinstance(result, PairResult)},
        has_validation=bool(release.split("validation")),
    )
    outcomes = validation | run.count({t: file for t, file in files.items() if t.split == "test"}, thresholds)
    failures |= {target: result for target, result in outcomes.items() if isinstance(result, str)}
    results = {target: result for target, result in outcomes.items() if isinstance(result, PairResult)}
    rates = base_rates(release, jobs, {target: result.tally for target, result in results.items()})
    settings = describe(counting, missing)
    table = make_table(release, method, results, thresholds, rates, failures, settings)
    if table.complete:
        journal.remove()
    return table


@dataclass
class _Run:
    """Counts pairs in two rounds, validation and test, with one progress and one journal."""

    release: Release
    counting: Counting
    journal: Journal
    jobs: int
    progress: Progress | None
    pairs: int
    done: int = 0

    def count(
        self, files: Mapping[Target, Path | None], thresholds: Thresholds | None
    ) -> dict[Target, PairResult | str]:
        """Count some pairs; surface metrics only where there are thresholds."""
        jobs = [
            Job(
                target,
                self.release.pair_path(target),
                file,
                None if thresholds is None else thresholds.of[target.category],
                self.counting,
                self.journal.earlier(target.name),
            )
            for target, file in sorted(files.items(), key=lambda item: item[0])
        ]
        results = run_tasks(count_job, jobs, self.jobs, keep=self._keep)
        return {job.target: result for job, result in zip(jobs, results, strict=True)}

    def _keep(self, job: Job, result: PairResult | str) -> None:
        if isinstance(result, PairResult):
            self.journal.add(job, result)
        self.done += 1
        if self.progress:
            self.progress(self.done, self.pairs)


def check_words(protocols: Sequence[str], upsampling: str) -> None:
    """Refuse names of protocols and of upsampling that are not known.

    Raises:
        SettingsError: one that is not.
    """
    unknown = [name for name in protocols if name not in PROTOCOLS]
    if unknown or not protocols:
        raise SettingsError(f"no protocol '{', '.join(unknown)}': choose among {', '.join(PROTOCOLS)}")
    if upsampling not in CONVENTIONS:
        raise SettingsError(f"no upsampling '{upsampling}': choose {' or '.join(CONVENTIONS)}")


def _plan(
    found: FoundPredictions, missing: Missing, with_validation: bool
) -> tuple[dict[Target, Path | None], dict[Target, str]]:
    """The file of every pair that is to be counted (None: an empty grid), and what has failed already.

    A method that predicts nothing of the validation split has chosen to do without it; one that predicts a
    part of it has left out the rest.
    """
    answered = any(target.split == "validation" for target in (*found.files, *found.problems))
    splits = {"test", "validation"} if answered and with_validation else {"test"}
    files: dict[Target, Path | None] = dict(found.files)
    failures = dict(found.problems)
    for target in found.missing:
        if missing == "empty":
            files[target] = None
        else:
            failures[target] = missing_line(target)
    return (
        {target: file for target, file in files.items() if target.split in splits},
        {target: reason for target, reason in failures.items() if target.split in splits},
    )
