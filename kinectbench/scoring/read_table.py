"""Read score tables. All values that follow from the rows are computed again and compared with the file.

The rows themselves could be invented; only `recheck` can tell whether they are of real predictions.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import TypeGuard

from kinectbench.core import StorageError, printable
from kinectbench.core.artefacts.score_figures import Averages
from kinectbench.core.artefacts.scores import DERIVED, ScoreTable
from kinectbench.core.artefacts.stored import StoredPart
from kinectbench.scoring.caveats import marks_of
from kinectbench.scoring.contradictions import contradictions
from kinectbench.scoring.counts import THRESHOLDS
from kinectbench.scoring.derived_values import derived_values

# Relative tolerance. Sums in another order differ by 1e-15; the smallest change that is displayed is 1e-3.
TOLERANCE = 1e-9
# Share of an interval's width by which a bootstrapped end may differ, because another version of numpy may
# draw other samples. With 10 000 resamples, an end is accurate to 2.6 % (measured with 100 000 draws of
# another seed).
OF_BOOTSTRAP = 0.05
NOTHING: tuple[object, ...] = (None, [], (), {})
# Keys that are compared. Notes and marks, which other versions may word differently, are only computed again.
FIGURES = [name for name in DERIVED if name not in ("notes", "marks")]


def read_table(path: Path) -> ScoreTable:
    """Read a score table, recompute the values that follow from its rows, and remove `verified` if invalid.

    Raises:
        StorageError: the file is missing or damaged, its rows contradict each other, or its other values
            (averages, intervals, curves, extremes) do not follow from its rows. The message is one line.
    """
    return recomputed(ScoreTable.read_file(path), str(path))


def recomputed(table: ScoreTable, where: str) -> ScoreTable:
    """Check a table as `read_table` does; return it with the values that follow from its rows recomputed.

    Raises:
        StorageError: as in `read_table`; the message begins with `where`.
    """
    problem = next(contradictions(table), None)
    if problem is None:
        complete = not table.failures and bool(table.complete or table.overall or table.by_category)
        values = derived_values(
            table.rows, table.settings.protocols, table.base_rate, table.truth_quality, complete
        ) | {"marks": marks_of(table)}
        if values["iou_by_threshold"] is None:  # rows of older tables have no curves
            values["iou_by_threshold"] = table.iou_by_threshold
            problem = next(_off_the_curve(table, values["by_category"] or {}), None)
        problem = problem or next(_differences(table, values), None)
    if problem is not None:
        raise StorageError(f"{where}: {printable(problem, 300)}; {ScoreTable.ADVICE}")
    holds = table.verified is not None and (
        table.verified.table_sha256 == table.facts_sha256()
        and table.verified.predictions_sha256 == table.predictions_sha256()
    )
    return table.model_copy(update=values | ({} if holds else {"verified": None}))


def _off_the_curve(table: ScoreTable, by_category: Mapping[str, Mapping[str, Averages]]) -> Iterator[str]:
    """Report IoU curves of an older table that differ from its mean IoU at the category's threshold."""
    for protocol, curves in (table.iou_by_threshold or {}).items():
        for category, curve in curves.items():
            used = table.thresholds.get(category)
            mean = by_category.get(protocol, {}).get(category)
            if mean is None or mean.iou is None or used not in THRESHOLDS or len(curve) != len(THRESHOLDS):
                yield f"'iou_by_threshold.{protocol}.{category}' belongs to no rows"
            elif not _close(curve[THRESHOLDS.index(used)], mean.iou):
                yield f"'iou_by_threshold.{protocol}.{category}' does not go through the mean of the rows"


def _differences(table: ScoreTable, computed: Mapping[str, object]) -> Iterator[str]:
    """Report values of a table that do not follow from its rows; values that are missing are not reported."""
    for name in FIGURES:
        if name in table.model_fields_set:
            yield from differing(getattr(table, name), computed[name], name)


def differing(stated: object, computed: object, key: str, whole: bool = False) -> Iterator[str]:
    """Yield a sentence for each key whose stated value differs from the computed one beyond rounding.

    Args:
        stated: numbers, text, lists, mappings, models or dataclasses of these.
        computed: the same kinds of values.
        key: the key of both values in the file, "" at the top.
        whole: whether a value that is not stated (None) also counts as a difference.
    """
    stated, computed = _plain(stated), _plain(computed)
    if stated is None and not whole:
        return
    if isinstance(stated, Mapping) and isinstance(computed, Mapping | None):
        computed = computed or {}
        for name in dict.fromkeys((*stated, *(computed if whole else ()))):
            one, other, at = stated.get(name), computed.get(name), _below(key, name)
            if name == "intervals" and key.startswith("overall."):
                yield from _bootstrapped(one or {}, other or {}, at)
            else:
                yield from differing(one, other, at, whole)
    elif _is_list(stated) and _is_list(computed) and len(stated) == len(computed):
        for index, (one, other) in enumerate(zip(stated, computed, strict=True)):
            yield from differing(one, other, _below(key, index), whole)
    elif not _close(stated, computed) and not (stated in NOTHING and computed in NOTHING):
        yield f"'{printable(key)}' states {_short(stated)}, but it is {_short(computed)}"


def _bootstrapped(
    stated: Mapping[str, Sequence[float] | None], computed: Mapping[str, Sequence[float] | None], key: str
) -> Iterator[str]:
    """Report intervals that differ by more than 5 % of their width, as the bootstrap is random."""
    for name, ends in stated.items():
        of = computed.get(name)
        near = of is not None and ends is not None and OF_BOOTSTRAP * (of[1] - of[0]) + TOLERANCE
        if ends is not None and not (of and all(abs(a - b) <= near for a, b in zip(ends, of, strict=True))):
            yield f"'{printable(f'{key}.{name}')}' states {_short(ends)}, but it is {_short(of)}"


def _below(key: str, name: object) -> str:
    return f"{key}.{name}" if key else str(name)


def _plain(value: object) -> object:
    """Return a model or dataclass as a mapping, and any other value unchanged."""
    if isinstance(value, StoredPart):
        return value.json_value()
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value


def _is_list(value: object) -> TypeGuard[Sequence[object]]:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _close(one: object, other: object) -> bool:
    if isinstance(one, int | float) and isinstance(other, int | float):
        return math.isclose(one, other, rel_tol=TOLERANCE, abs_tol=TOLERANCE)
    return bool(one == other)


def _short(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return "nothing" if value is None else printable(repr(value), 60)
