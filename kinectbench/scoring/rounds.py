"""Count a method's pairs (see `pair_result`): validation pairs first, to choose the thresholds on them."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from kinectbench.core import KinectBenchError, ReleaseError
from kinectbench.core.artefacts.counted import PairResult
from kinectbench.core.artefacts.provenance import nearest_step
from kinectbench.core.artefacts.targets import check_names
from kinectbench.core.store.address import shown
from kinectbench.core.types import Progress
from kinectbench.engine.executor import Executor, SendMessage, WorkerLost
from kinectbench.engine.shards import Shard
from kinectbench.release.release import Release, Target
from kinectbench.scoring.pair_result import Counting, Journal, PairJob, count_job
from kinectbench.scoring.predictions import FoundPredictions, find_predictions, missing_line
from kinectbench.scoring.thresholds import Thresholds, searched_thresholds, thresholds_for
from kinectbench.scoring.workers import run_tasks

Missing = Literal["error", "empty"]


@dataclass(frozen=True)
class Plan:
    """The pairs of a method to count.

    Attributes:
        found: the content of the method's folder.
        files: {pair to count: its prediction's file, or None for an empty grid}.
        failures: {pair that cannot be counted: the reason}.
        fixed: given thresholds; None if they are chosen on the validation split.
    """

    found: FoundPredictions
    files: dict[Target, Path | None]
    failures: dict[Target, str]
    fixed: Thresholds | None

    @property
    def own(self) -> float | None:
        """Return the method's own threshold from its method.json; None if it has none."""
        method = self.found.method
        return None if method is None or method.threshold is None else nearest_step(method.threshold)

    def part(self, shard: Shard, *, surface: bool) -> dict[Target, Path | None]:
        """Return {pair: its file, None for an empty grid} for one part of the run.

        These are the pairs of the part's recordings. If surface metrics are computed, the validation pairs on
        which their thresholds are chosen are included too.

        Args:
            shard: the part.
            surface: whether surface metrics are computed. The threshold of a category is chosen on all its
                validation pairs; if it has none, on those of all categories.
        """
        mine = {target for target in self.files if shard.holds(target.recording)}
        needed = {target.category for target in mine if target.split == "test" and surface}
        searched = {target.category for target in self.files if target.split == "validation"}
        if self.own is None and not needed <= searched:
            needed = searched
        return {
            target: file
            for target, file in self.files.items()
            if target in mine or (target.split == "validation" and target.category in needed)
        }


def plan(release: Release, predictions: Path, thresholds_file: Path | None, missing: Missing) -> Plan:
    """Find a method's files, and decide which pairs are counted.

    If a method has no validation prediction at all, it is scored without the validation split. If it has
    some, the other validation pairs count as missing.

    Raises:
        PredictionError, ReleaseError, SettingsError: see `score`.
    """
    check_names(release.targets, str(release.folder))
    test = pairs_to_score(release, validation=thresholds_file is None)
    fixed = None if thresholds_file is None else thresholds_for(thresholds_file, test)
    predicted = find_predictions(predictions, release.targets)
    answered = any(target.split == "validation" for target in (*predicted.files, *predicted.problems))
    splits = {"test", "validation"} if answered and fixed is None else {"test"}
    files: dict[Target, Path | None] = dict(predicted.files)
    failures = dict(predicted.problems)
    for target in predicted.missing:
        if missing == "empty":
            files[target] = None
        else:
            failures[target] = missing_line(target)
    return Plan(
        predicted,
        {target: file for target, file in files.items() if target.split in splits},
        {target: reason for target, reason in failures.items() if target.split in splits},
        fixed,
    )


def pairs_to_score(release: Release, *, validation: bool, solid: bool = True) -> tuple[Target, ...]:
    """Return the pairs of the test split, after checking that the needed splits have public truth.

    Args:
        release: the release that is scored.
        validation: whether the validation split is needed, too.
        solid: whether the truth must be solid, that is, no open mesh.

    Raises:
        ReleaseError: there is no test pair, or the truth is held back or not solid.
    """
    test = release.split("test")
    if not test:
        raise ReleaseError(
            f"{shown(release.folder)}: no pair in the test split; nothing to score", what="no-pairs"
        )
    release.require_truth(("test", "validation") if validation else ("test",), solid=solid)
    return test


@dataclass(frozen=True)
class Rounds:
    """Computes the voxel counts of predictions: first on the validation split, then on the test split.

    Attributes:
        release: the release that is scored.
        counting: the options of counting.
        journal: stores the counts on disk until all are complete.
        jobs: number of processes on this machine, or the executor that counts on other machines.
        progress: called with (pairs done, pairs in all).
    """

    release: Release
    counting: Counting
    journal: Journal
    jobs: int | Executor
    progress: Progress
    _counted: list[Target] = field(default_factory=list)

    def count(
        self, files: Mapping[Target, Path | None], fixed: Thresholds | None, own: float | None = None
    ) -> tuple[dict[Target, PairResult | str], Thresholds]:
        """Count pairs; return {pair: its result, or why it has none}, and the thresholds.

        Args:
            files: {pair: its prediction's file, None for an empty grid}.
            fixed: given thresholds; None if they are searched on the validation pairs.
            own: the method's own threshold, for categories without validation pairs.
        """
        total = len(files)
        validation = self._round(_of_split(files, "validation"), None, total)
        tallies = {t: result.tally for t, result in validation.items() if isinstance(result, PairResult)}
        thresholds = fixed or searched_thresholds(self.release.targets, tallies, own)
        return validation | self._round(_of_split(files, "test"), thresholds, total), thresholds

    def _round(
        self, files: Mapping[Target, Path | None], thresholds: Thresholds | None, total: int
    ) -> dict[Target, PairResult | str]:
        """Count the pairs of one split, with surface metrics if there are thresholds.

        `total` is the number of pairs of all splits, for the progress.
        """
        jobs = [
            PairJob(
                target,
                self.release.pair_path(target),
                file,
                None if thresholds is None else thresholds.of[target.category],
                self.counting,
                self.journal.earlier(target.name),
                self.journal.is_checked(target.name),
            )
            for target, file in sorted(files.items(), key=lambda item: item[0])
        ]

        results: dict[Target, PairResult | str] = {}

        def keep(job: PairJob, result: PairResult | str) -> None:
            """Record a result at once, so that it survives a kill."""
            if isinstance(result, PairResult):
                self.journal.add(job, result)
            results[job.target] = result
            self._counted.append(job.target)
            self.progress(len(self._counted), total)

        if isinstance(self.jobs, int):
            run_tasks(count_job, jobs, self.jobs, keep=keep)
        else:
            _by_recording(self.jobs, jobs, keep)
        return {job.target: results[job.target] for job in jobs}


class _Silent:
    """A console that prints nothing, because progress is reported in another way when a recording is done."""

    def heard(self, message: object) -> None: ...
    def warn(self, message: str, task: object = None) -> None: ...


def _by_recording(
    executor: Executor, jobs: Sequence[PairJob], keep: Callable[[PairJob, PairResult | str], None]
) -> None:
    """Count pairs by an executor, one recording per task, because a single pair takes too little time.

    `keep` is called with each job and its result.
    """
    by_id: dict[str, list[PairJob]] = {}
    for job in jobs:
        by_id.setdefault(job.target.recording, []).append(_elsewhere(job))
    with closing(executor.outcomes(_count_all, list(by_id.values()), _Silent(), slowest_twice=True)) as ended:
        for of_recording, results in ended:
            if isinstance(results, WorkerLost):
                raise KinectBenchError(
                    results.reason.format(id=of_recording[0].target.recording), what="process-killed"
                )
            for job, result in zip(of_recording, results, strict=True):
                keep(job, result)


def _elsewhere(job: PairJob) -> PairJob:
    """Return the job with absolute paths, for processes that have another working folder."""
    return replace(job, truth=job.truth.absolute(), file=None if job.file is None else job.file.absolute())


def _count_all(jobs: Sequence[PairJob], say: SendMessage) -> list[PairResult | str]:
    return [count_job(job) for job in jobs]


def _of_split(files: Mapping[Target, Path | None], split: str) -> dict[Target, Path | None]:
    return {target: file for target, file in files.items() if target.split == split}
