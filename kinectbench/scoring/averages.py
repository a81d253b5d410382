"""From rows to averages: pair -> object -> category -> macro; `paper` takes the plain mean of the pairs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean

import numpy as np

from kinectbench.core.artefacts.counted import PairResult
from kinectbench.core.artefacts.score_figures import AVERAGED, METRICS, SHARES, ScoreRow
from kinectbench.core.artefacts.scores import (
    BaseRate,
    CategoryAverages,
    ExtremePair,
    Extremes,
    OverallAverages,
)
from kinectbench.core.types import Float64
from kinectbench.release.release import Target
from kinectbench.scoring.counts import THRESHOLDS, protocol_counts
from kinectbench.scoring.metrics import ious
from kinectbench.scoring.uncertainty import bootstrap_interval, student_interval

EXTREMES = 3


@dataclass(frozen=True)
class ObjectQuality:
    """How good an object's truth is: means over its recordings; None if one of these is not known."""

    estimated_iou: float | None = None
    repeatability_iou: float | None = None


@dataclass(frozen=True)
class ObjectMeans:
    """The objects of one category under one protocol.

    Attributes:
        names: of the objects, sorted.
        values: (k, m) mean over each object's pairs of every metric in `AVERAGED`; NaN where not computed.
        weights: (k,) what each counts for in the category's mean.
        pairs: how many pairs there are.
    """

    names: tuple[str, ...]
    values: Float64
    weights: Float64
    pairs: int


def object_means(rows: Sequence[ScoreRow]) -> dict[str, dict[str, ObjectMeans]]:
    """{protocol: {category: means of its objects}}, categories sorted.

    Views of one object are not independent: each object counts once, however many views it has. The
    protocol `paper` weighs every pair alike, as the paper does.
    """
    groups: dict[str, dict[str, dict[str, list[ScoreRow]]]] = {}
    for row in rows:
        objects = groups.setdefault(row.protocol, {}).setdefault(row.category, {})
        objects.setdefault(row.object, []).append(row)
    return {
        protocol: {
            category: _means(by_category[category], plain=protocol == "paper")
            for category in sorted(by_category)
        }
        for protocol, by_category in groups.items()
    }


def _means(by_object: Mapping[str, Sequence[ScoreRow]], plain: bool) -> ObjectMeans:
    """The means of one category's objects under one protocol."""
    names = tuple(sorted(by_object))
    values = [[_known_mean([getattr(row, m) for row in by_object[name]]) for m in AVERAGED] for name in names]
    counts = np.array([len(by_object[name]) for name in names], np.float64)
    return ObjectMeans(
        names, np.array(values, np.float64), counts if plain else np.ones_like(counts), int(counts.sum())
    )


def category_averages(
    means: Mapping[str, Mapping[str, ObjectMeans]],
    rates: Mapping[str, BaseRate],
    quality: Mapping[str, ObjectQuality],
) -> dict[str, dict[str, CategoryAverages]]:
    """{protocol: {category: averages, their intervals, and how many pairs and objects they stand on}}.

    Args:
        means: see `object_means`.
        rates: base rate by category.
        quality: of the truth of each object.
    """
    return {
        protocol: {
            category: CategoryAverages(
                **_known(here.weights @ here.values / here.weights.sum()),
                pairs=here.pairs,
                objects=len(here.names),
                base_rate_source=rates[category].source,
                intervals=_intervals(student_interval(here.values, here.weights)),
                truth_estimated_iou=_known_mean([quality[name].estimated_iou for name in here.names]),
                truth_repeatability_iou=_known_mean([quality[name].repeatability_iou for name in here.names]),
            )
            for category, here in categories.items()
        }
        for protocol, categories in means.items()
    }


def overall_averages(
    by_category: Mapping[str, Mapping[str, CategoryAverages]],
    means: Mapping[str, Mapping[str, ObjectMeans]],
) -> dict[str, OverallAverages]:
    """{protocol: macro mean over the categories, its intervals, and sums of pairs and objects}."""
    averaged = (*AVERAGED, "truth_estimated_iou", "truth_repeatability_iou")
    return {
        protocol: OverallAverages(
            **{name: _known_mean([getattr(of, name) for of in categories.values()]) for name in averaged},
            pairs=sum(here.pairs for here in means[protocol].values()),
            objects=sum(len(here.names) for here in means[protocol].values()),
            categories=len(categories),
            intervals=_intervals(
                bootstrap_interval([(here.values, here.weights) for here in means[protocol].values()])
            ),
        )
        for protocol, categories in by_category.items()
    }


def extremes(rows: Sequence[ScoreRow]) -> dict[str, Extremes]:
    """The pairs of the highest and of the lowest IoU by protocol, three each at most."""
    found = {}
    for protocol in dict.fromkeys(row.protocol for row in rows):
        rising = [
            ExtremePair(recording=recording, view=view, category=category, iou=iou)
            for iou, recording, view, category in sorted(
                (row.iou, row.recording, row.view, row.category)
                for row in rows
                if row.protocol == protocol and row.iou is not None
            )
        ]
        found[protocol] = Extremes(best=tuple(rising[::-1][:EXTREMES]), worst=tuple(rising[:EXTREMES]))
    return found


def _known_mean(values: Sequence[float | None]) -> float | None:
    """The mean, or None if a value is not known."""
    known = [value for value in values if value is not None]
    return fmean(known) if known and len(known) == len(values) else None


def _known(values: Float64) -> dict[str, float | None]:
    """Averages by name; None where not computed."""
    return {
        name: None if np.isnan(value) else float(value) for name, value in zip(AVERAGED, values, strict=True)
    }


def _intervals(ends: Float64 | None) -> dict[str, list[float] | None]:
    """Intervals by metric, within what the metric can be; None where there is none."""
    named: dict[str, list[float] | None] = dict.fromkeys(METRICS)
    if ends is not None:
        for name, (low, high) in zip(AVERAGED, ends.tolist(), strict=True):
            if name in named and not np.isnan(low):
                named[name] = [max(low, 0.0), min(high, 1.0) if name in SHARES else high]
    return named


def iou_by_threshold(
    results: Mapping[Target, PairResult], protocols: Sequence[str]
) -> dict[str, dict[str, list[float]]]:
    """{protocol: {category: mean IoU at each of the thresholds k / 20, k = 2 to 18}} of the test pairs.

    Averaged as the scores are (see `object_means`): pair, object, category; `paper` weighs every pair alike.

    Args:
        results: of every pair that was counted; those of other splits are left out.
        protocols: some of "paper", "known", "occluded".
    """
    test = sorted(target for target in results if target.split == "test")
    return {
        protocol: {
            category: _mean_curve([t for t in test if t.category == category], results, protocol)
            for category in sorted({target.category for target in test})
        }
        for protocol in protocols
    }


def _mean_curve(
    targets: Sequence[Target], results: Mapping[Target, PairResult], protocol: str
) -> list[float]:
    """The mean of one category."""
    by_object: dict[str, list[Target]] = {}
    for target in targets:
        by_object.setdefault("" if protocol == "paper" else target.object, []).append(target)
    objects = [
        np.mean([ious(protocol_counts(results[t].tally, protocol)) for t in group], axis=0)
        for group in by_object.values()
    ]
    curve: list[float] = np.mean(objects, axis=0).tolist()
    assert len(curve) == len(THRESHOLDS)
    return curve
