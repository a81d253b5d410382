"""Put the table of one method together from what was counted."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from kinectbench import __version__
from kinectbench.release.release import Release, Target
from kinectbench.scoring.averages import (
    QUALITY,
    category_averages,
    extremes,
    object_means,
    overall_averages,
)
from kinectbench.scoring.base_rate import BaseRate
from kinectbench.scoring.counts import CE_CLIP, PRIMARY, THRESHOLDS, protocol_counts
from kinectbench.scoring.curves import iou_by_threshold
from kinectbench.scoring.intervals import LEVEL, MIN_OBJECTS, RESAMPLES, SEED
from kinectbench.scoring.metrics import constant_cross_entropy, metrics
from kinectbench.scoring.pair_result import Counting, PairResult
from kinectbench.scoring.surface import F_SCORE_MM, SIGMAS
from kinectbench.scoring.table import ScoreRow, ScoreTable
from kinectbench.scoring.thresholds import Thresholds
from kinectbench.voxels.resample import HALF_PIXEL


def make_table(
    release: Release,
    method: str,
    results: Mapping[Target, PairResult],
    thresholds: Thresholds,
    rates: Mapping[str, BaseRate],
    failures: Mapping[Target, str],
    settings: Mapping[str, Any],
) -> ScoreTable:
    """The table of a method. An average over a part of the pairs would flatter, so there is none.

    Args:
        release: what was predicted.
        method: its name.
        results: of every pair that was counted, also of the validation split.
        thresholds: of every category of the test split.
        rates: base rates.
        failures: why a prediction could not be scored.
        settings: see `describe`.
    """
    rows = _rows(results, settings["protocols"], thresholds, rates)
    means = object_means(rows)
    quality = _quality(release, rows)
    by_category = None if failures else category_averages(means, rates, _by_object(rows, quality))
    warnings = list(thresholds.warnings)
    if failures:
        warnings.append(
            f"incomplete: {len(failures)} predictions could not be scored, so there are no averages"
        )
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
        overall=None if by_category is None else overall_averages(by_category, means),
        truth_quality=quality,
        failures=tuple(
            {"recording": t.recording, "view": t.view, "reason": failures[t]} for t in sorted(failures)
        ),
        warnings=tuple(warnings),
        notes=tuple(_few_objects(rows)),
        extremes=extremes(rows),
        iou_by_threshold=None if failures else iou_by_threshold(results, settings["protocols"]),
        hashes={
            target.name: {"truth": target.sha256, "prediction": results[target].digest}
            for target in sorted(results)
        },
    )


def _rows(
    results: Mapping[Target, PairResult],
    protocols: Sequence[str],
    thresholds: Thresholds,
    rates: Mapping[str, BaseRate],
) -> tuple[ScoreRow, ...]:
    """The rows of the table: every protocol of every test pair."""
    test = sorted(target for target in results if target.split == "test")
    return tuple(
        _row(t, results[t], protocol, thresholds.of[t.category], rates[t.category].value)
        for protocol in protocols
        for t in test
    )


def _row(target: Target, result: PairResult, protocol: str, threshold: float, rate: float) -> ScoreRow:
    """One pair under one protocol."""
    counts, everything = (protocol_counts(result.tally, name) for name in (protocol, "paper"))
    values = metrics(counts, THRESHOLDS.index(threshold))
    surface = result.surface.get(protocol)
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
        cells=result.cells,
        ceiling_iou=result.ceilings[protocol],
        **({} if surface is None else asdict(surface)),
    )


def _quality(release: Release, rows: Sequence[ScoreRow]) -> dict[str, dict[str, Any]]:
    """{recording: what the release says of its truth}."""
    recordings = release.metadata.recordings
    names = sorted({row.recording for row in rows})
    return {name: recordings[name].quality for name in names if name in recordings}


def _by_object(
    rows: Sequence[ScoreRow], quality: Mapping[str, Mapping[str, Any]]
) -> dict[str, dict[str, Any]]:
    """{object: the figures of its recordings' truth that averages show}; the mean where it has several."""
    recordings: dict[str, set[str]] = {}
    for row in rows:
        recordings.setdefault(row.object, set()).add(row.recording)
    found: dict[str, dict[str, Any]] = {}
    for name, of_object in recordings.items():
        found[name] = {}
        for key in QUALITY.values():
            values = [quality.get(recording, {}).get(key) for recording in sorted(of_object)]
            known = [float(value) for value in values if isinstance(value, int | float)]
            if len(known) == len(values):
                found[name][key] = sum(known) / len(known)
    return found


def _few_objects(rows: Sequence[ScoreRow]) -> list[str]:
    """A line that names the categories that are too few for an interval."""
    objects: dict[str, set[str]] = {}
    for row in rows:
        objects.setdefault(row.category, set()).add(row.object)
    few = [f"{name} ({len(objects[name])})" for name in sorted(objects) if len(objects[name]) < MIN_OBJECTS]
    if not few:
        return []
    return [f"no intervals with fewer than {MIN_OBJECTS} objects in a category: {', '.join(few)}"]


def describe(counting: Counting, missing: str) -> dict[str, Any]:
    """The choices that the numbers depend on, in words and numbers."""
    way = "cell centres to cell centres" if counting.upsampling == HALF_PIXEL else "outermost centres aligned"
    return {
        "protocols": list(counting.protocols),
        "primary_protocol": PRIMARY,
        "missing": missing,
        "threshold_range": [THRESHOLDS[0], THRESHOLDS[-1]],
        "threshold_step": 0.05,
        "threshold_rule": "highest mean pair IoU of the category on validation, all voxels; ties: lowest",
        "occupied": "y > threshold, in float64",
        "ce_clip": CE_CLIP,
        "iou_of_empty_union": 1,
        "precision_and_recall_of_nothing": "1 if prediction and truth are both empty, else 0",
        "upsampling": f"trilinear, {counting.upsampling} ({way}), edges clamped",
        "averages": "pair, object, category, macro; protocol paper: plain mean of the pairs of a category",
        "surface_metrics": counting.surface,
        "f_score_mm": list(F_SCORE_MM),
        "surface_dice_sigmas": SIGMAS,
        "interval_level": LEVEL,
        "interval_rule": f"category: Student t over objects; overall: bootstrap over objects, by category "
        f"({RESAMPLES} resamples, seed {SEED}); none with fewer than {MIN_OBJECTS} objects in a category",
    }
