"""Average the rows of a table: pairs -> object -> category -> mean over the categories (macro).

Under the protocols `paper` and `shell`, a category's mean is the plain mean over its pairs.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

import numpy as np

from kinectbench.core.artefacts.score_figures import AVERAGED, METRICS, SHARES, ScoreRow
from kinectbench.core.artefacts.scores import (
    BaseRate,
    CategoryAverages,
    ExtremePair,
    Extremes,
    OverallAverages,
)
from kinectbench.core.types import Float64
from kinectbench.scoring.protocols import EVERY_VOXEL
from kinectbench.scoring.uncertainty import bootstrap_interval, student_interval

EXTREMES = 3
# Figures of quality.json that are averaged over an object's recordings; then the one that is averaged over
# its pairs.
OF_RECORDING = ("estimated_iou", "estimated_iou_low", "estimated_iou_high", "repeatability_iou")
OF_TRUTH = (*OF_RECORDING, "unknown_share")


@dataclass(frozen=True)
class ObjectQuality:
    """The quality of the truth of an object: means of figures of quality.json over its recordings.

    A mean is None if a recording lacks the figure.

    Attributes:
        category: the object's category.
        unknown_share: share of the true shape that is not known, averaged over all pairs of the object; None
            if the rows are from an older version that lacks this share.
    """

    category: str
    estimated_iou: float | None
    estimated_iou_low: float | None
    estimated_iou_high: float | None
    repeatability_iou: float | None
    unknown_share: float | None


@dataclass(frozen=True)
class ObjectMeans:
    """Mean metrics of each object of one category, under one protocol.

    Attributes:
        names: names of the objects, sorted.
        values: (k, m), mean of each metric in `AVERAGED` over each object's pairs; NaN where not computed.
        weights: (k,) weight of each object in the category's mean.
        pairs: number of pairs of all these objects.
    """

    names: tuple[str, ...]
    values: Float64
    weights: Float64
    pairs: int


def object_means(rows: Sequence[ScoreRow]) -> dict[str, dict[str, ObjectMeans]]:
    """Return {heading: {category: means of its objects}}.

    A heading is a protocol, with kind of registration and part if any: `known`, `aligned-t-visible`.

    Categories are sorted; a category without a counted pair is left out. Each object has weight 1, however
    many views it has, because views of one object are not independent. Under the protocols `paper` and
    `shell`, every pair has the same weight, as in the paper.

    Args:
        rows: the rows of a table. Rows without metrics are skipped: the truth of their pair is all unknown.
    """
    groups: dict[str, dict[str, dict[str, list[ScoreRow]]]] = {}
    for row in rows:
        categories = groups.setdefault(row.heading, {})
        if row.counts:
            categories.setdefault(row.category, {}).setdefault(row.object, []).append(row)
    return {
        protocol: {
            category: _means(by_category[category], plain=protocol in EVERY_VOXEL)
            for category in sorted(by_category)
        }
        for protocol, by_category in groups.items()
    }


def plain_mean(rows: Sequence[ScoreRow], value: Callable[[ScoreRow], float | None]) -> float | None:
    """Return the mean of a value that is no metric: over each object's pairs, then objects, then categories.

    Args:
        rows: rows under one heading; rows without metrics are skipped.
        value: function that returns the value of a row.

    Returns:
        The mean; None if a counted row has no value, or if no row counts.
    """
    groups: dict[str, dict[str, list[float | None]]] = {}
    for row in rows:
        if row.counts:
            groups.setdefault(row.category, {}).setdefault(row.object, []).append(value(row))
    return _known_mean(
        [_known_mean([_known_mean(values) for values in of.values()]) for of in groups.values()]
    )


def _means(by_object: Mapping[str, Sequence[ScoreRow]], plain: bool) -> ObjectMeans:
    """Return the means of a category's objects; an object weighs 1 or, if `plain`, its number of pairs."""
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
    """Return {heading: {category: averages, their intervals, and the numbers of pairs and objects}}.

    Args:
        means: see `object_means`.
        rates: base rate by category; a category may be missing.
        quality: {object: quality of its truth}, including objects that are left out of the means.
    """
    names: dict[str, list[str]] = {}
    for name, of in quality.items():
        names.setdefault(of.category, []).append(name)
    return {
        protocol: {
            category: _category(
                categories.get(category), rates.get(category), [quality[n] for n in names[category]]
            )
            for category in sorted(names)
        }
        for protocol, categories in means.items()
    }


def _category(
    here: ObjectMeans | None, rate: BaseRate | None, quality: Sequence[ObjectQuality]
) -> CategoryAverages:
    """Return a category's averages; without a counted pair, only the averages of its truth's quality."""
    of_truth: dict[str, Any] = {
        f"truth_{key}": _known_mean([getattr(of, key) for of in quality]) for key in OF_TRUTH
    }
    source = None if rate is None else rate.source
    if here is None:
        return CategoryAverages(base_rate_source=source, intervals=_intervals(None), **of_truth)
    return CategoryAverages(
        **_known(here.weights @ here.values / here.weights.sum()),
        pairs=here.pairs,
        objects=len(here.names),
        base_rate_source=source,
        intervals=_intervals(student_interval(here.values, here.weights)),
        **of_truth,
    )


def overall_averages(
    by_category: Mapping[str, Mapping[str, CategoryAverages]], means: Mapping[str, Mapping[str, ObjectMeans]]
) -> dict[str, OverallAverages]:
    """Return {heading: mean over the counted categories, its intervals, numbers of pairs and objects}.

    The means of the truth's quality also include the categories without a counted pair.
    """
    of_truth = [f"truth_{key}" for key in OF_TRUTH]
    averages = {}
    for protocol, categories in by_category.items():
        of_protocol = means[protocol]
        counted = [of for name, of in categories.items() if name in of_protocol]
        groups = [(of.values, of.weights) for of in of_protocol.values()]
        averages[protocol] = OverallAverages(
            **{name: _known_mean([getattr(of, name) for of in counted]) for name in AVERAGED},
            **{name: _known_mean([getattr(of, name) for of in categories.values()]) for name in of_truth},
            pairs=sum(of.pairs for of in of_protocol.values()) or None,
            objects=sum(len(of.names) for of in of_protocol.values()) or None,
            categories=len(of_protocol) or None,
            intervals=_intervals(bootstrap_interval(groups) if groups else None),
        )
    return averages


def extremes(rows: Sequence[ScoreRow]) -> dict[str, Extremes]:
    """Return {heading: up to three pairs of the highest IoU, and of the lowest; the most extreme first}."""
    by_protocol = {}
    for protocol in dict.fromkeys(row.heading for row in rows):
        rising = [
            ExtremePair(recording=recording, view=view, category=category, iou=iou)
            for iou, recording, view, category in sorted(
                (row.iou, row.recording, row.view, row.category)
                for row in rows
                if row.heading == protocol and row.iou is not None
            )
        ]
        by_protocol[protocol] = Extremes(best=tuple(rising[::-1][:EXTREMES]), worst=tuple(rising[:EXTREMES]))
    return by_protocol


def _known_mean(values: Sequence[float | None]) -> float | None:
    """Return the mean of the values; None if the list is empty or a value is None."""
    known = [value for value in values if value is not None]
    return fmean(known) if known and len(known) == len(values) else None


def _known(values: Float64) -> dict[str, float | None]:
    """Return {metric: average}; None instead of NaN."""
    return {
        name: None if np.isnan(value) else float(value) for name, value in zip(AVERAGED, values, strict=True)
    }


def _intervals(ends: Float64 | None) -> dict[str, list[float] | None]:
    """Return {metric: interval}, clipped to the metric's range; `ends` (m, 2) has a row per metric."""
    named: dict[str, list[float] | None] = dict.fromkeys(METRICS)
    if ends is not None:
        for name, (low, high) in zip(AVERAGED, ends.tolist(), strict=True):
            if name in named and not np.isnan(low):
                named[name] = [max(low, 0.0), min(high, 1.0) if name in SHARES else high]
    return named


def curves(rows: Sequence[ScoreRow], protocols: Sequence[str]) -> dict[str, dict[str, list[float]]] | None:
    """Return {protocol: {category: mean IoU at each of the thresholds k / 20, k = 2 to 18}}.

    The IoU is averaged as in `object_means`: over the pairs of each object, then over objects. Under `paper`
    and `shell`, every pair has the same weight. Pairs whose truth is all unknown are left out.

    Returns:
        The curves; None if a counted row has no curve, as in older tables.
    """
    by_protocol: dict[str, dict[str, list[float]]] = {name: {} for name in protocols}
    groups: dict[tuple[str, str], dict[str, list[tuple[float, ...]]]] = {}
    for row in rows:
        if row.iou is None:
            continue
        if row.iou_by_threshold is None:
            return None
        by_object = groups.setdefault((row.protocol, row.category), {})
        by_object.setdefault("" if row.protocol in EVERY_VOXEL else row.object, []).append(
            row.iou_by_threshold
        )
    for (protocol, category), by_object in sorted(groups.items()):
        means = [np.mean(pairs, axis=0) for pairs in by_object.values()]
        by_protocol.setdefault(protocol, {})[category] = np.mean(means, axis=0).tolist()
    return by_protocol
