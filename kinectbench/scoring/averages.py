"""From rows to averages: pair -> object -> category -> macro; `paper` takes the plain mean of the pairs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.scoring.base_rate import BaseRate
from kinectbench.scoring.intervals import bootstrap_interval, student_interval
from kinectbench.scoring.table import METRICS, SHARES, SURFACES, ScoreRow

Float64 = NDArray[np.float64]

AVERAGED = (*METRICS, *SURFACES, "base_rate_ce", "coverage_voxels", "coverage_shape", "ceiling_iou")
# What quality.json says of an object's truth, and what the averages call it.
QUALITY = {"truth_estimated_iou": "estimated_iou", "truth_repeatability_iou": "repeatability_iou"}
EXTREMES = 3

ByCategory = Mapping[str, Mapping[str, Mapping[str, Any]]]


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
    values = [[_mean([getattr(row, m) for row in by_object[name]]) for m in AVERAGED] for name in names]
    counts = np.array([len(by_object[name]) for name in names], np.float64)
    return ObjectMeans(names, np.array(values), counts if plain else np.ones_like(counts), int(counts.sum()))


def _mean(values: Sequence[float | None]) -> float:
    known = [value for value in values if value is not None]
    return fmean(known) if len(known) == len(values) else np.nan


def category_averages(
    means: Mapping[str, Mapping[str, ObjectMeans]],
    rates: Mapping[str, BaseRate],
    quality: Mapping[str, Mapping[str, Any]],
) -> dict[str, dict[str, dict[str, Any]]]:
    """{protocol: {category: averages, their intervals, and how many pairs and objects they stand on}}.

    Args:
        means: see `object_means`.
        rates: base rate by category.
        quality: {object: quality.json of its recordings' truth, averaged}.
    """
    return {
        protocol: {
            category: _named(here.weights @ here.values / here.weights.sum())
            | {"pairs": here.pairs, "objects": len(here.names)}
            | {"base_rate_source": rates[category].source}
            | {"intervals": _intervals(student_interval(here.values, here.weights))}
            | {
                name: _known_mean([quality.get(thing, {}).get(key) for thing in here.names])
                for name, key in QUALITY.items()
            }
            for category, here in categories.items()
        }
        for protocol, categories in means.items()
    }


def overall_averages(
    by_category: ByCategory, means: Mapping[str, Mapping[str, ObjectMeans]]
) -> dict[str, dict[str, Any]]:
    """{protocol: macro mean over the categories, its intervals, and sums of pairs and objects}."""
    return {
        protocol: {
            name: _known_mean([averages[name] for averages in categories.values()])
            for name in (*AVERAGED, *QUALITY)
        }
        | {name: sum(averages[name] for averages in categories.values()) for name in ("pairs", "objects")}
        | {"categories": len(categories)}
        | {
            "intervals": _intervals(
                bootstrap_interval([(m.values, m.weights) for m in means[protocol].values()])
            )
        }
        for protocol, categories in by_category.items()
    }


def extremes(rows: Sequence[ScoreRow]) -> dict[str, dict[str, list[dict[str, Any]]]]:
    """{protocol: {"best": pairs, "worst": pairs}}, three each at most by IoU, the first the most extreme."""
    found = {}
    for protocol in dict.fromkeys(row.protocol for row in rows):
        ordered = sorted(
            (row for row in rows if row.protocol == protocol),
            key=lambda row: (row.iou, row.recording, row.view),
        )
        named = [
            {"recording": row.recording, "view": row.view, "category": row.category, "iou": row.iou}
            for row in ordered
        ]
        found[protocol] = {"best": named[::-1][:EXTREMES], "worst": named[:EXTREMES]}
    return found


def _known_mean(values: Sequence[Any]) -> float | None:
    """The mean, or None if a value is not known."""
    known = [float(value) for value in values if isinstance(value, int | float)]
    return fmean(known) if known and len(known) == len(values) else None


def _named(values: Float64) -> dict[str, float | None]:
    """Averages by name; None where not computed."""
    return {
        name: None if np.isnan(value) else float(value) for name, value in zip(AVERAGED, values, strict=True)
    }


def _intervals(ends: Float64 | None) -> dict[str, list[float] | None]:
    """Intervals by metric, within what the metric can be; None where there is none."""
    named: dict[str, list[float] | None] = dict.fromkeys((*METRICS, *SURFACES))
    if ends is not None:
        for name, (low, high) in zip(AVERAGED, ends.tolist(), strict=True):
            if name in named and not np.isnan(low):
                named[name] = [max(low, 0.0), min(high, 1.0) if name in SHARES else high]
    return named
