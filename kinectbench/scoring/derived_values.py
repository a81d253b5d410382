"""Compute the values that follow from the rows of a table: averages, curves, extremes and notes.

`score` writes these values into a table. Readers compute them again from the rows, and refuse a file with
other values.
"""

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.score_figures import ScoreRow
from kinectbench.core.artefacts.scores import BaseRate
from kinectbench.scoring.averages import (
    OF_RECORDING,
    ObjectMeans,
    ObjectQuality,
    category_averages,
    curves,
    extremes,
    object_means,
    overall_averages,
)
from kinectbench.scoring.uncertainty import MIN_OBJECTS


def derived_values(
    rows: Sequence[ScoreRow],
    protocols: Sequence[str],
    rates: Mapping[str, BaseRate],
    quality: Mapping[str, QualityFile],
    complete: bool,
) -> dict[str, Any]:
    """Return {field of `ScoreTable`: value} of the fields that follow from the rows.

    There are no averages if a pair was not scored, because a mean over the others could be too high.

    Args:
        rows: the rows of a table.
        protocols: the scored protocols.
        rates: {category: base rate}.
        quality: {recording: quality of its truth}.
        complete: whether every pair was scored.
    """
    left_out: dict[str, list[str]] = {name: [] for name in protocols}
    for row in rows:
        left_out.setdefault(row.heading, [])
        if not row.counts:
            left_out[row.heading].append(row.pair)
    means = object_means(rows)
    objects = _by_object(rows, quality)
    by_category = category_averages(means, rates, objects) if complete else None
    return {
        "by_category": by_category,
        "overall": None if by_category is None else overall_averages(by_category, means),
        "truth_unknown_share": {
            name: of.unknown_share for name, of in sorted(objects.items()) if of.unknown_share is not None
        },
        "all_unknown_pairs": {name: tuple(pairs) for name, pairs in left_out.items()},
        "notes": tuple(_few_objects(rows, means)),
        "extremes": extremes(rows),
        "iou_by_threshold": curves(rows, protocols) if complete else None,
    }


def _by_object(rows: Sequence[ScoreRow], quality: Mapping[str, QualityFile]) -> dict[str, ObjectQuality]:
    """Return {object: quality of its truth}: means over recordings; for the unknown share, over pairs."""
    of_object: dict[str, list[ScoreRow]] = {}
    for row in rows:
        of_object.setdefault(row.object, []).append(row)
    by_object = {}
    for name, own in of_object.items():
        parts = [quality.get(recording, QualityFile()) for recording in sorted({r.recording for r in own})]
        shares = {row.pair: row.unknown_share for row in own}  # the same under every protocol
        known = [share for share in shares.values() if share is not None]
        by_object[name] = ObjectQuality(
            own[0].category,
            **{key: _mean([getattr(part, key) for part in parts]) for key in OF_RECORDING},
            unknown_share=fmean(known) if len(known) == len(shares) else None,
        )
    return by_object


def _mean(values: Sequence[float | None]) -> float | None:
    """Return the mean of some values; None if one of them is None."""
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if len(known) == len(values) else None


def _few_objects(rows: Sequence[ScoreRow], means: Mapping[str, Mapping[str, ObjectMeans]]) -> list[str]:
    """Return a line with the categories that have too few objects for an interval under a protocol, or []."""
    few = []
    for name in sorted({row.category for row in rows}):
        least = min(len(of[name].names) if name in of else 0 for of in means.values())
        few += [f"{name} ({least})"] if least < MIN_OBJECTS else []
    if not few:
        return []
    return [f"no intervals with fewer than {MIN_OBJECTS} objects in a category: {', '.join(few)}"]
