"""Put the table of one method together from what was counted."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from statistics import fmean

from kinectbench._version import __version__
from kinectbench.core.artefacts.counted import PairResult
from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.score_figures import ScoreRow, SurfaceMetrics, VoxelMetrics
from kinectbench.core.artefacts.scores import BaseRate, Failure, Hashes, ScoreSettings, ScoreTable
from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.engine.artefact import VERSIONS
from kinectbench.release.release import Release, Target
from kinectbench.scoring.averages import (
    ObjectMeans,
    ObjectQuality,
    category_averages,
    extremes,
    iou_by_threshold,
    object_means,
    overall_averages,
)
from kinectbench.scoring.counts import (
    CE_CLIP,
    PRIMARY,
    THRESHOLDS,
    is_all_unknown,
    protocol_counts,
    unknown_share,
)
from kinectbench.scoring.metrics import constant_cross_entropy, metrics
from kinectbench.scoring.pair_result import Counting
from kinectbench.scoring.surface import F_SCORE_MM, SIGMAS
from kinectbench.scoring.thresholds import Thresholds
from kinectbench.scoring.uncertainty import LEVEL, MIN_OBJECTS, RESAMPLES, SEED


def make_table(
    release: Release,
    method: str,
    results: Mapping[Target, PairResult],
    thresholds: Thresholds,
    rates: Mapping[str, BaseRate],
    failures: Mapping[Target, str],
    settings: ScoreSettings,
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
    rows = _rows(results, settings.protocols, thresholds, rates)
    left_out = {name: _left_out(results, name) for name in settings.protocols}
    means = object_means(rows, left_out)
    quality = _quality(release, rows)
    objects = _by_object(rows, quality)
    by_category = None if failures else category_averages(means, rates, objects)
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
        thresholds=dict(thresholds.of),
        threshold_source=thresholds.source,
        base_rate={category: rates[category] for category in thresholds.of},
        rows=rows,
        by_category=by_category,
        overall=None if by_category is None else overall_averages(by_category, means),
        truth_quality=quality,
        truth_unknown_share={name: of.unknown_share for name, of in sorted(objects.items())},
        all_unknown_pairs=left_out,
        failures=tuple(
            Failure(recording=t.recording, view=t.view, reason=failures[t]) for t in sorted(failures)
        ),
        warnings=tuple(warnings),
        notes=tuple(_few_objects(rows, means)),
        extremes=extremes(rows),
        iou_by_threshold=None if failures else iou_by_threshold(results, settings.protocols),
        hashes={
            target.name: Hashes(truth=target.sha256, prediction=results[target].digest)
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


def _left_out(results: Mapping[Target, PairResult], protocol: str) -> tuple[str, ...]:
    """The test pairs of which a protocol says nothing, by name."""
    test = sorted(target for target in results if target.split == "test")
    return tuple(target.name for target in test if is_all_unknown(results[target].tally, protocol))


def _row(target: Target, result: PairResult, protocol: str, threshold: float, rate: float) -> ScoreRow:
    """One pair under one protocol."""
    counts, everything = (protocol_counts(result.tally, name) for name in (protocol, "paper"))
    figures, surface, base_rate_ce = VoxelMetrics(), SurfaceMetrics(), None
    if not is_all_unknown(result.tally, protocol):
        figures = metrics(counts, THRESHOLDS.index(threshold))
        surface = result.surface.get(protocol, SurfaceMetrics())
        base_rate_ce = constant_cross_entropy(counts.occupied, counts.voxels, rate)
    return ScoreRow(
        recording=target.recording,
        object=target.object,
        view=target.view,
        category=target.category,
        protocol=protocol,
        threshold=threshold,
        **asdict(figures),
        base_rate_ce=base_rate_ce,
        coverage_voxels=counts.voxels / everything.voxels,
        coverage_shape=counts.occupied / everything.occupied if everything.occupied else 1.0,
        cells=result.cells,
        ceiling_iou=result.ceilings[protocol],
        **asdict(surface),
        unknown_share=unknown_share(result.tally),
    )


def _quality(release: Release, rows: Sequence[ScoreRow]) -> dict[str, QualityFile]:
    """{recording: what the release says of its truth}."""
    recordings = release.metadata.recordings
    names = sorted({row.recording for row in rows})
    return {name: recordings[name].quality for name in names if name in recordings}


def _by_object(rows: Sequence[ScoreRow], quality: Mapping[str, QualityFile]) -> dict[str, ObjectQuality]:
    """{object: the figures of its truth that averages show}: means over recordings, and over pairs."""
    of_object: dict[str, list[ScoreRow]] = {}
    for row in rows:
        of_object.setdefault(row.object, []).append(row)
    found = {}
    for name, here in of_object.items():
        parts = [quality.get(recording, QualityFile()) for recording in sorted({r.recording for r in here})]
        shares = {row.pair: row.unknown_share or 0.0 for row in here}  # every protocol's row says the same
        found[name] = ObjectQuality(
            here[0].category,
            estimated_iou=_mean([part.estimated_iou for part in parts]),
            estimated_iou_low=_mean([part.estimated_iou_low for part in parts]),
            estimated_iou_high=_mean([part.estimated_iou_high for part in parts]),
            repeatability_iou=_mean([part.repeatability_iou for part in parts]),
            unknown_share=fmean(shares.values()),
        )
    return found


def _mean(values: Sequence[float | None]) -> float | None:
    """The mean of a figure; None if one of them is not known."""
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if len(known) == len(values) else None


def _few_objects(rows: Sequence[ScoreRow], means: Mapping[str, Mapping[str, ObjectMeans]]) -> list[str]:
    """A line that names the categories that are too few for an interval, under a protocol at least."""
    few = []
    for name in sorted({row.category for row in rows}):
        least = min(len(of[name].names) if name in of else 0 for of in means.values())
        few += [f"{name} ({least})"] if least < MIN_OBJECTS else []
    if not few:
        return []
    return [f"no intervals with fewer than {MIN_OBJECTS} objects in a category: {', '.join(few)}"]


def describe(counting: Counting, missing: str) -> ScoreSettings:
    """The choices that the numbers depend on, in words and numbers."""
    way = "cell centres to cell centres" if counting.upsampling == HALF_PIXEL else "outermost centres aligned"
    return ScoreSettings(
        score_version=VERSIONS["score"],
        protocols=counting.protocols,
        primary_protocol=PRIMARY,
        missing=missing,
        threshold_range=(THRESHOLDS[0], THRESHOLDS[-1]),
        threshold_step=0.05,
        threshold_rule="highest mean pair IoU of the category on validation, all voxels; ties: lowest",
        occupied="y > threshold, in float64",
        ce_clip=CE_CLIP,
        iou_of_empty_union=1,
        precision_and_recall_of_nothing="1 if prediction and truth are both empty, else 0",
        upsampling=f"trilinear, {counting.upsampling} ({way}), edges clamped",
        averages="pair, object, category, macro; protocol paper: plain mean of the pairs of a category",
        surface_metrics=counting.surface,
        f_score_mm=F_SCORE_MM,
        surface_dice_sigmas=SIGMAS,
        interval_level=LEVEL,
        interval_rule=f"category: Student t over objects; overall: bootstrap over objects, by category "
        f"({RESAMPLES} resamples, seed {SEED}); none with fewer than {MIN_OBJECTS} objects in a category",
    )
