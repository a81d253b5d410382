"""Assemble the table of one method from its counts."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict

from kinectbench._version import __version__
from kinectbench.core.artefacts.counted import PairResult
from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.score_figures import ScoreRow, SurfaceMetrics, VoxelMetrics
from kinectbench.core.artefacts.score_marks import ValidationUse
from kinectbench.core.artefacts.scores import BaseRate, Failure, Hashes, ScoreSettings, ScoreTable
from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.engine.artefact import VERSIONS
from kinectbench.release.release import Release, Target
from kinectbench.scoring.caveats import marks_of
from kinectbench.scoring.counts import (
    CE_CLIP,
    THRESHOLDS,
    constant_cross_entropy,
    ious,
    is_all_unknown,
    metrics,
    protocol_counts,
    tally_unknown_share,
)
from kinectbench.scoring.derived_values import derived_values
from kinectbench.scoring.pair_result import Counting
from kinectbench.scoring.protocols import PRIMARY
from kinectbench.scoring.surface import F_SCORE_MM, SIGMAS
from kinectbench.scoring.suspicious import suspicious_lines
from kinectbench.scoring.thresholds import SEARCHED, Thresholds
from kinectbench.scoring.uncertainty import LEVEL, MIN_OBJECTS, RESAMPLES, SEED


def make_table(
    release: Release,
    method: str,
    results: Mapping[Target, PairResult],
    thresholds: Thresholds,
    rates: Mapping[str, BaseRate],
    failures: Mapping[Target, str],
    settings: ScoreSettings,
    empty: Collection[Target] = (),
) -> ScoreTable:
    """Make the table of a method that predicts in the pairs' grids.

    Args:
        release: the release that was predicted.
        method: the method's name.
        results: result of every counted pair, including those of the validation split.
        thresholds: threshold of every category of the test split.
        rates: base rate (share of occupied voxels in the truth) of every category.
        failures: {pair: why its prediction could not be scored}.
        settings: the settings that the scores depend on, as `describe` returns them.
        empty: pairs without a prediction that were counted as empty grids.
    """
    rows = rows_of(results, settings.protocols, thresholds, rates)
    digests = {target: result.digest for target, result in results.items()}
    used = {category: rates[category] for category in thresholds.of}
    warnings = [*suspicious_lines(results, thresholds, settings.of_baseline)]
    if empty:
        warnings.append(f"{len(empty)} predictions are missing and were counted as empty grids")
    if failures:
        what = f"{len(failures)} predictions could not be scored"
        warnings.append(f"incomplete: {what}, so there are no averages")
    table = table_of(
        release, method, rows, digests, thresholds, failures, settings, empty, warnings=warnings, rates=used
    )
    return table.model_copy(update={"verified": None})  # the key is written


def table_of(
    release: Release,
    method: str,
    rows: tuple[ScoreRow, ...],
    digests: Mapping[Target, str | None],
    thresholds: Thresholds,
    failures: Mapping[Target, str],
    settings: ScoreSettings,
    empty: Collection[Target],
    *,
    warnings: Sequence[str],
    rates: Mapping[str, BaseRate],
) -> ScoreTable:
    """Make a table of its rows; it has no averages if a pair failed: a mean over the rest could be too high.

    Args:
        release: the release that was predicted.
        method: the method's name.
        rows: every scored pair under every protocol.
        digests: {pair of the test or validation split: digest of its prediction, None without a file}.
        thresholds: threshold of every category of the test split.
        failures: {pair: why its prediction could not be scored}.
        settings: the settings that the scores depend on.
        empty: pairs without a prediction that were counted as empty.
        warnings: one line each; those of the thresholds come before them.
        rates: base rate of every category; empty if none was used.
    """
    quality = quality_of(release, rows)
    derived = derived_values(rows, settings.protocols, rates, quality, not failures)
    table = ScoreTable(
        method=method,
        benchmark_sha256=release.benchmark_sha256,
        package_version=__version__,
        settings=settings,
        complete=not failures,
        thresholds=dict(thresholds.of),
        threshold_source=thresholds.source,
        threshold_source_by_category=dict(thresholds.sources),
        threshold_objects=thresholds.objects,
        validation=_validation(release, digests, thresholds, empty),
        missing_as_empty=tuple(target.name for target in sorted(empty)),
        base_rate=dict(rates),
        rows=rows,
        truth_quality=quality,
        failures=tuple(
            Failure(recording=t.recording, view=t.view, reason=failures[t]) for t in sorted(failures)
        ),
        warnings=(*thresholds.warnings, *warnings),
        hashes={
            target.name: Hashes(truth=target.sha256, prediction=digests[target]) for target in sorted(digests)
        },
        **derived,
    )
    return table.model_copy(update={"marks": marks_of(table)})


def _validation(
    release: Release, predicted: Collection[Target], thresholds: Thresholds, empty: Collection[Target]
) -> ValidationUse | None:
    """Return the numbers of validation pairs and of predicted pairs; None if no threshold is from them."""
    if thresholds.source not in SEARCHED:
        return None
    without = frozenset(empty)  # a set, as there may be thousands of them
    count = sum(target.split == "validation" and target not in without for target in predicted)
    return ValidationUse(pairs=len(release.split("validation")), predicted=count)


def rows_of(
    results: Mapping[Target, PairResult],
    protocols: Sequence[str],
    thresholds: Thresholds,
    rates: Mapping[str, BaseRate],
) -> tuple[ScoreRow, ...]:
    """Return the rows of the table: every test pair under every protocol."""
    test = sorted(target for target in results if target.split == "test")
    return tuple(
        _row(t, results[t], protocol, thresholds.of[t.category], rates[t.category].value)
        for protocol in protocols
        for t in test
    )


def _row(target: Target, result: PairResult, protocol: str, threshold: float, rate: float) -> ScoreRow:
    """Return the row of a pair under one protocol; `threshold` and base rate `rate` are its category's."""
    tally = result.tally_under(protocol)
    counts, everything = (protocol_counts(tally, name) for name in (protocol, "paper"))
    figures, surface, base_rate_ce, curve = VoxelMetrics(), SurfaceMetrics(), None, None
    if not is_all_unknown(tally, protocol):
        figures = metrics(counts, THRESHOLDS.index(threshold))
        surface = result.surface.get(protocol, SurfaceMetrics())
        base_rate_ce = constant_cross_entropy(counts.occupied, counts.voxels, rate)
        curve = tuple(ious(counts).tolist())
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
        unknown_share=tally_unknown_share(result.tally),
        iou_by_threshold=curve,
    )


def quality_of(release: Release, rows: Sequence[ScoreRow]) -> dict[str, QualityFile]:
    """Return {recording: quality of its truth, as the release states it}."""
    recordings = release.metadata.recordings
    names = sorted({row.recording for row in rows})
    return {name: recordings[name].quality for name in names if name in recordings}


def as_of_baseline(settings: ScoreSettings) -> ScoreSettings:
    """Return the settings with the baselines' version, by which a table is recognised as a baseline's."""
    return settings.model_copy(update={"baseline_version": VERSIONS["baselines"]})


def describe(counting: Counting, missing: str) -> ScoreSettings:
    """Return the settings that the scores depend on; `missing` ("error" or "empty") as in `score`."""
    way = "cell centres to cell centres" if counting.upsampling == HALF_PIXEL else "outermost centres aligned"
    return ScoreSettings(
        score_version=VERSIONS["score"],
        protocols=counting.protocols,
        primary_protocol=PRIMARY,
        missing=missing,
        threshold_range=(THRESHOLDS[0], THRESHOLDS[-1]),
        threshold_step=0.05,
        threshold_rule="highest mean pair IoU of the category on validation, all voxels; ties: lowest; "
        "without validation pairs of it: the method's own, else that of all validation pairs, else 0.5",
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
        baseline_version=0,
    )
