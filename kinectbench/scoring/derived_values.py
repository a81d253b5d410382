"""Compute the values that follow from the rows of a table: averages, curves, extremes and notes.

`score` writes these values into a table. Readers compute them again from the rows, and refuse a file with
other values.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean

from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.score_figures import ScoreRow
from kinectbench.core.artefacts.scores import (
    BaseRate,
    CategoryAverages,
    Extremes,
    OverallAverages,
)
from kinectbench.scoring.averages import (
    ObjectMeans,
    ObjectQuality,
    category_averages,
    curves,
    extremes,
    object_means,
    overall_averages,
)
from kinectbench.scoring.uncertainty import MIN_OBJECTS


@dataclass(frozen=True)
class DerivedValues:
    """The fields of a `ScoreTable` that follow from its rows.

    A heading is a protocol, with kind of registration and part if any: `known`, `aligned-t-visible`.

    Attributes:
        by_category: {heading: {category: averages}}; None if a pair was not scored.
        overall: {heading: mean over the categories}; None if a pair was not scored.
        truth_unknown_share: {object: share of its true shape that is not known}.
        all_unknown_pairs: {heading: pairs without metrics, because all truth that would be compared is
            unknown}.
        notes: one line each.
        extremes: {heading: pairs with the highest and with the lowest IoU}.
        iou_by_threshold: {protocol: {category: mean IoU at each threshold}}; None if a pair was not scored,
            or if rows have no curves (older tables).
    """

    by_category: dict[str, dict[str, CategoryAverages]] | None
    overall: dict[str, OverallAverages] | None
    truth_unknown_share: dict[str, float]
    all_unknown_pairs: dict[str, tuple[str, ...]]
    notes: tuple[str, ...]
    extremes: dict[str, Extremes]
    iou_by_threshold: dict[str, dict[str, list[float]]] | None


def derived_values(
    rows: Sequence[ScoreRow],
    protocols: Sequence[str],
    rates: Mapping[str, BaseRate],
    quality: Mapping[str, QualityFile],
    complete: bool,
) -> DerivedValues:
    """Compute the values that follow from the rows.

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
    return DerivedValues(
        by_category=by_category,
        overall=None if by_category is None else overall_averages(by_category, means),
        truth_unknown_share={
            name: of.unknown_share for name, of in sorted(objects.items()) if of.unknown_share is not None
        },
        all_unknown_pairs={name: tuple(pairs) for name, pairs in left_out.items()},
        notes=tuple(_few_objects(rows, means)),
        extremes=extremes(rows),
        iou_by_threshold=curves(rows, protocols) if complete else None,
    )


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
            estimated_iou=_mean([part.estimated_iou for part in parts]),
            estimated_iou_low=_mean([part.estimated_iou_low for part in parts]),
            estimated_iou_high=_mean([part.estimated_iou_high for part in parts]),
            repeatability_iou=_mean([part.repeatability_iou for part in parts]),
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
