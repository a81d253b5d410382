"""From rows to averages: pair -> object -> category -> macro; `paper` takes the plain mean of the pairs."""

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


@dataclass(frozen=True)
class ObjectQuality:
    """The quality of an object's truth, as averages over its recordings.

    Attributes:
        category: the object's category.
        estimated_iou: mean estimate of the IoU of truth and real shape; None if unknown for one recording.
        estimated_iou_low: mean lower end of the estimate's interval; None like `estimated_iou`.
        estimated_iou_high: mean upper end of that interval.
        repeatability_iou: mean IoU of solids of odd and of even frames; None if unknown for one recording.
        unknown_share: share of the object's true shape that is not known: mean over all its pairs; None if
            the rows are of an older version without this share.
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
        values: (k, m) mean over each object's pairs of every metric in `AVERAGED`; NaN where not computed.
        weights: (k,) weight of each object in the category's mean.
        pairs: number of pairs of these objects.
    """

    names: tuple[str, ...]
    values: Float64
    weights: Float64
    pairs: int


def object_means(rows: Sequence[ScoreRow]) -> dict[str, dict[str, ObjectMeans]]:
    """Return {heading: {category: means of its objects}}; a heading is such as `known`, `aligned-t-visible`.

    Categories are sorted; one without a counted pair is left out. Views of one object are not independent:
    each object counts once, however many views it has. The protocols `paper` and `shell` weigh every pair
    equally, as the paper does.

    Args:
        rows: the rows of a table; a row without metrics is of an all-unknown pair, and is skipped.
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
    """Return the mean of a figure that is no metric: over pairs, then objects, then categories.

    Args:
        rows: rows under one heading; rows without metrics are skipped.
        value: returns the figure of a row.

    Returns:
        The mean; None if a counted row lacks the figure, or no row counts.
    """
    groups: dict[str, dict[str, list[float | None]]] = {}
    for row in rows:
        if row.counts:
            groups.setdefault(row.category, {}).setdefault(row.object, []).append(value(row))
    return _known_mean(
        [_known_mean([_known_mean(values) for values in of.values()]) for of in groups.values()]
    )


def _means(by_object: Mapping[str, Sequence[ScoreRow]], plain: bool) -> ObjectMeans:
    """Return the means of a category's objects; an object weighs 1 or, with `plain`, its number of pairs."""
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
        quality: quality of each object's truth, also of objects that are left out of the means.
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
    """Return a category's averages; without counted pairs, only the quality figures of its truth."""
    of_truth: dict[str, Any] = {
        "truth_estimated_iou": _known_mean([of.estimated_iou for of in quality]),
        "truth_estimated_iou_low": _known_mean([of.estimated_iou_low for of in quality]),
        "truth_estimated_iou_high": _known_mean([of.estimated_iou_high for of in quality]),
        "truth_repeatability_iou": _known_mean([of.repeatability_iou for of in quality]),
        "truth_unknown_share": _known_mean([of.unknown_share for of in quality]),
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
    by_category: Mapping[str, Mapping[str, CategoryAverages]],
    means: Mapping[str, Mapping[str, ObjectMeans]],
) -> dict[str, OverallAverages]:
    """Return {heading: macro mean over the counted categories, its intervals, sums of pairs and objects}.

    Means of the truth's quality also include categories without a counted pair.
    """
    estimated = ("truth_estimated_iou", "truth_estimated_iou_low", "truth_estimated_iou_high")
    of_truth = (*estimated, "truth_repeatability_iou", "truth_unknown_share")
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
    """Return {heading: pairs of the highest and of the lowest IoU}, at most three each, the extreme first."""
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

    The IoU is averaged like scores (`object_means`): over the pairs of each object, then over objects;
    `paper` and `shell` weigh every pair equally. All-unknown pairs are left out.

    Args:
        rows: the rows of a table.
        protocols: the scored protocols.

    Returns:
        The curves; None if a counted row has no curve (older tables).
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
