"""From rows to averages: pair -> object -> category -> macro; `paper` takes the plain mean of the pairs."""

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

from kinectbench.scoring.base_rate import BaseRate
from kinectbench.scoring.table import METRICS, ScoreRow

AVERAGED = (*METRICS, "base_rate_ce", "coverage_voxels", "coverage_shape")


def category_averages(
    rows: Sequence[ScoreRow], rates: Mapping[str, BaseRate]
) -> dict[str, dict[str, dict[str, Any]]]:
    """{protocol: {category: averages, and how many pairs and objects they stand on}}.

    Views of one object are not independent: each object counts once, however many views it has. The
    protocol `paper` weighs every pair alike, as the paper does.
    """
    groups: dict[str, dict[str, list[ScoreRow]]] = {}
    for row in rows:
        groups.setdefault(row.protocol, {}).setdefault(row.category, []).append(row)
    return {
        protocol: {
            category: _average(by_category[category], plain=protocol == "paper")
            | {"base_rate_source": rates[category].source}
            for category in sorted(by_category)
        }
        for protocol, by_category in groups.items()
    }


def _average(rows: Sequence[ScoreRow], plain: bool) -> dict[str, Any]:
    """Averages of one category under one protocol."""
    by_object: dict[str, list[ScoreRow]] = {}
    for row in rows:
        by_object.setdefault(row.object, []).append(row)
    groups = [list(rows)] if plain else [by_object[name] for name in sorted(by_object)]
    means = {name: fmean(fmean(getattr(row, name) for row in group) for group in groups) for name in AVERAGED}
    return means | {"pairs": len(rows), "objects": len(by_object)}


def overall_averages(by_category: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> dict[str, dict[str, Any]]:
    """{protocol: macro mean over the categories, and sums of pairs and objects}."""
    return {
        protocol: {name: fmean(averages[name] for averages in categories.values()) for name in AVERAGED}
        | {name: sum(averages[name] for averages in categories.values()) for name in ("pairs", "objects")}
        | {"categories": len(categories)}
        for protocol, categories in by_category.items()
    }
