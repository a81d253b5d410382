"""Score one method's predictions against a release."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from kinectbench import __version__
from kinectbench.errors import PredictionError, ReleaseError, SettingsError
from kinectbench.release.release import Release, Target, check_splits
from kinectbench.scoring.averages import category_averages, overall_averages
from kinectbench.scoring.base_rate import BaseRate, base_rates
from kinectbench.scoring.counts import (
    CE_CLIP,
    PRIMARY,
    PROTOCOLS,
    THRESHOLDS,
    Prediction,
    Tally,
    protocol_counts,
    tally,
)
from kinectbench.scoring.metrics import constant_cross_entropy, metrics
from kinectbench.scoring.prediction_file import load_prediction
from kinectbench.scoring.predictions import FoundPredictions, find_predictions, missing_line
from kinectbench.scoring.table import ScoreRow, ScoreTable
from kinectbench.scoring.thresholds import Thresholds, read_thresholds, searched_thresholds
from kinectbench.scoring.truth import read_truth
from kinectbench.scoring.workers import Progress, run_tasks

Missing = Literal["error", "empty"]
EMPTY_CELLS = 16


@dataclass(frozen=True)
class Job:
    """One pair to be counted.

    Attributes:
        target: the pair.
        truth: its pair file.
        file: the prediction's file, None for an empty grid.
    """

    target: Target
    truth: Path
    file: Path | None


def score(
    release: Release,
    predictions: Path,
    *,
    method: str,
    protocols: Sequence[str] = tuple(PROTOCOLS),
    thresholds_file: Path | None = None,
    missing: Missing = "error",
    jobs: int = 1,
    progress: Progress | None = None,
) -> ScoreTable:
    """Score the test split; predictions of the validation split only choose the thresholds.

    Args:
        release: what the predictions are for.
        predictions: one method's folder, `<recording>/<view>.npy` or `.npz`; untrusted.
        method: its name.
        protocols: some of "paper", "known", "occluded".
        thresholds_file: see `read_thresholds`; it wins over the validation split.
        missing: "error" lists a missing prediction as a failure; "empty" scores an empty grid for it.
        jobs: number of processes; the result does not depend on it.
        progress: called with (pairs done, pairs in all).

    Returns:
        The table. A prediction that cannot be scored is in its `failures`; the rest has been scored.

    Raises:
        PredictionError: the folder is missing.
        ReleaseError: no test pair, an object in two splits, or a pair file is missing or changed.
        SettingsError: an unknown protocol or an unusable threshold file.
    """
    unknown = [name for name in protocols if name not in PROTOCOLS]
    if unknown or not protocols:
        raise SettingsError(f"no protocol '{', '.join(unknown)}': choose among {', '.join(PROTOCOLS)}")
    check_splits(release.targets, str(release.folder))
    test = release.split("test")
    if not test:
        raise ReleaseError(f"{release.folder}: no pair in the test split; nothing to score")
    categories = sorted({target.category for target in test})
    fixed = None
    if thresholds_file is not None:
        fixed = read_thresholds(thresholds_file, categories, frozenset(target.object for target in test))
    found = find_predictions(predictions, (*test, *release.split("validation")))
    work, failures = _plan(release, found, missing, with_validation=fixed is None)
    outcomes = run_tasks(_count, work, jobs, progress)
    tallies = {
        job.target: outcome for job, outcome in zip(work, outcomes, strict=True) if isinstance(outcome, Tally)
    }
    failures |= {job.target: o for job, o in zip(work, outcomes, strict=True) if isinstance(o, str)}
    thresholds = fixed or searched_thresholds(
        categories,
        {target: counts for target, counts in tallies.items() if target.split == "validation"},
        has_validation=bool(release.split("validation")),
    )
    rates = base_rates(release, jobs)
    rows = _rows([t for t in test if t in tallies], tallies, protocols, thresholds, rates)
    return _table(release, method, rows, thresholds, rates, failures, _settings(protocols, missing))


def _plan(
    release: Release, found: FoundPredictions, missing: Missing, with_validation: bool
) -> tuple[list[Job], dict[Target, str]]:
    """What is to be counted, in the order of the targets, and what has failed already.

    A method that predicts nothing of the validation split has chosen to do without it; one that predicts a
    part of it has left out the rest.
    """
    answered = any(target.split == "validation" for target in (*found.files, *found.problems))
    splits = {"test", "validation"} if answered and with_validation else {"test"}
    work = [Job(target, release.pair_path(target), path) for target, path in found.files.items()]
    failures = dict(found.problems)
    for target in found.missing:
        if missing == "empty":
            work.append(Job(target, release.pair_path(target), None))
        else:
            failures[target] = missing_line(target)
    work = [job for job in work if job.target.split in splits]
    return sorted(work, key=lambda job: job.target), {t: r for t, r in failures.items() if t.split in splits}


def _count(job: Job) -> Tally | str:
    """Count one prediction against its truth; the reason where that cannot be done."""
    try:
        if job.file is None:
            prediction: Prediction = np.zeros((EMPTY_CELLS,) * 3, np.bool_)
        else:
            prediction = load_prediction(job.file, job.target.name + job.file.suffix)
    except PredictionError as error:
        return str(error)
    return tally(prediction, read_truth(job.truth, job.target.sha256))


def _rows(
    targets: Sequence[Target],
    tallies: Mapping[Target, Tally],
    protocols: Sequence[str],
    thresholds: Thresholds,
    rates: Mapping[str, BaseRate],
) -> tuple[ScoreRow, ...]:
    """The rows of the table: every protocol of every target."""
    return tuple(
        _row(target, tallies[target], protocol, thresholds.of[target.category], rates[target.category].value)
        for protocol in protocols
        for target in targets
    )


def _row(target: Target, counted: Tally, protocol: str, threshold: float, rate: float) -> ScoreRow:
    """One pair under one protocol."""
    counts, everything = protocol_counts(counted, protocol), protocol_counts(counted, "paper")
    values = metrics(counts, THRESHOLDS.index(threshold))
    return ScoreRow(
        recording=target.recording,
        object=target.object,
        view=target.view,
        category=target.category,
        protocol=protocol,
        threshold=threshold,
        **asdict(values),
        base_rate_ce=constant_cross_entropy(counts.occupied, counts.voxels, rate),
        coverage_voxels=counts.voxels / everything.voxels,
        coverage_shape=counts.occupied / everything.occupied if everything.occupied else 1.0,
    )


def _settings(protocols: Sequence[str], missing: Missing) -> dict[str, Any]:
    """The choices that the numbers depend on, in words and numbers."""
    return {
        "protocols": list(protocols),
        "primary_protocol": PRIMARY,
        "missing": missing,
        "threshold_range": [THRESHOLDS[0], THRESHOLDS[-1]],
        "threshold_step": 0.05,
        "threshold_rule": "highest mean pair IoU of the category on validation, all voxels; ties: lowest",
        "occupied": "y > threshold, in float64",
        "ce_clip": CE_CLIP,
        "iou_of_empty_union": 1,
        "precision_and_recall_of_nothing": "1 if prediction and truth are both empty, else 0",
        "upsampling": "trilinear, half-pixel (cell centres to cell centres), edges clamped",
        "averages": "pair, object, category, macro; protocol paper: plain mean of the pairs of a category",
    }


def _table(
    release: Release,
    method: str,
    rows: tuple[ScoreRow, ...],
    thresholds: Thresholds,
    rates: Mapping[str, BaseRate],
    failures: Mapping[Target, str],
    settings: Mapping[str, Any],
) -> ScoreTable:
    """Put the table together. An average over a part of the pairs would flatter, so there is none."""
    by_category = None if failures else category_averages(rows, rates)
    warnings = list(thresholds.warnings)
    if failures:
        warnings.append(
            f"incomplete: {len(failures)} predictions could not be scored, so there are no averages"
        )
    recordings = release.metadata.recordings
    return ScoreTable(
        method=method,
        benchmark_sha256=release.benchmark_sha256,
        package_version=__version__,
        settings=settings,
        complete=not failures,
        thresholds=thresholds.of,
        threshold_source=thresholds.source,
        base_rate={category: asdict(rates[category]) for category in thresholds.of},
        rows=rows,
        by_category=by_category,
        overall=None if by_category is None else overall_averages(by_category),
        truth_quality={
            name: recordings[name].quality
            for name in sorted({row.recording for row in rows})
            if name in recordings
        },
        failures=tuple(
            {"recording": t.recording, "view": t.view, "reason": failures[t]} for t in sorted(failures)
        ),
        warnings=tuple(warnings),
    )
