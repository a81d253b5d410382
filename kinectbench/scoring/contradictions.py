"""Find contradictions in a score table, and values outside the bounds of its schema.

`read_table` refuses such a table, and reports the first contradiction. These checks need only the table.
Checks against the release are in `release_contradictions`, and checks against the predictions in `recheck`.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from functools import cache
from typing import Any

from pydantic.fields import FieldInfo

from kinectbench.core import Named, first_clash, listed, name_problem, printable, reserved_problem
from kinectbench.core.artefacts.score_figures import VOXEL_METRICS, ScoreRow, fields_of
from kinectbench.core.artefacts.score_marks import ACCOUNTED
from kinectbench.core.artefacts.scores import DERIVED, ScoreTable
from kinectbench.core.artefacts.stored import StoredPart
from kinectbench.engine.artefact import VERSIONS
from kinectbench.scoring.counts import CE_CLIP, THRESHOLDS
from kinectbench.scoring.protocols import EVERY_VOXEL, PRIMARY
from kinectbench.scoring.thresholds import (
    FIXED,
    FIXED_SOURCE,
    FROM_FILE,
    METHOD_SOURCE,
    POOLED_SOURCE,
    SEARCHED,
    SOURCES,
    VALIDATION_SOURCE,
)

# Keys that every table has since the version (ACCOUNTED) that states thresholds and missing predictions.
# Since that version, each row also has its IoU at every threshold.
ACCOUNTS = (
    *("complete", "benchmark_sha256", "thresholds", "threshold_source", "threshold_source_by_category"),
    *("threshold_objects", "validation", "missing_as_empty", "base_rate", "failures", "hashes"),
)
# Since this version of `score`, a category without validation pairs gets a pooled threshold or the method's
# own.
POOLED_FROM = 5
MOST_CE = -math.log(CE_CLIP)  # nats per voxel, of a prediction that is wrong everywhere


def contradictions(table: ScoreTable) -> Iterator[str]:
    """Yield the contradictions in a table, one sentence each, the most serious first."""
    yield from _out_of_bounds(table)
    yield from _of_version(table)
    yield from _of_names(table)
    yield from _of_rows(table)
    yield from _of_thresholds(table)
    if table.score_version >= ACCOUNTED:
        yield from _of_sources(table)
        yield from _of_missing(table)
    if table.complete and table.failures:
        yield f"it is called complete, but {len(table.failures)} predictions failed"
    if not table.rows and (table.overall or table.by_category):
        yield "it states averages, but holds no rows"


def _of_version(table: ScoreTable) -> Iterator[str]:
    """Report an unknown version, keys that this version must have or cannot have, and a bad method name."""
    version, known = table.score_version, VERSIONS["score"]
    if version > known:
        yield f"counted by score version {version}, and this kinectbench knows none after {known}"
    if version < ACCOUNTED:
        if any(row.iou_by_threshold is not None for row in table.rows):
            yield f"its rows have an IoU at every threshold, which score version {version} did not write"
        return
    yield from (
        f"lacks '{key}', which score version {version} states"
        for key in ACCOUNTS
        if key not in table.model_fields_set
    )
    if problem := name_problem(table.method, also="+"):
        yield f"'{printable(table.method)}': no name for a method: {problem}"
    if table.complete is False and not table.failures:
        yield "it is called incomplete, but no prediction failed"


def _of_names(table: ScoreTable) -> Iterator[str]:
    """Report conflicting names in the rows, and category names that are reserved, such as for a mean."""
    rows = [Named(*row) for row in dict.fromkeys((r.recording, r.object, r.category) for r in table.rows)]
    if clash := first_clash(rows):
        yield clash.problem
    yield from filter(None, map(reserved_problem, sorted({*table.thresholds, *(r.category for r in rows)})))


def _of_rows(table: ScoreTable) -> Iterator[str]:
    """Report rows that are impossible, or contradict another row of their pair, recording or protocol."""
    thing: dict[str, tuple[str, str]] = {}
    whole: dict[str, tuple[int, float | None]] = {}
    pairs: dict[str, set[str]] = {}
    most = {row.pair: row for row in table.rows if row.protocol == PRIMARY}
    for row in table.rows:
        of, seen = f"the row of {row.pair} under {row.heading}", pairs.setdefault(row.heading, set())
        if row.pair in seen:
            yield f"{of} stands there twice"
        seen.add(row.pair)
        if thing.setdefault(row.recording, (row.object, row.category)) != (row.object, row.category):
            yield f"{of} is of another object or category than another row of its recording"
        if whole.setdefault(row.pair, (row.cells, row.unknown_share)) != (row.cells, row.unknown_share):
            yield f"{of} has other cells, or another share of unknown, than under another protocol"
        yield from (f"{of} {words}" for words in _in_row(row, table.score_version))
        if (
            row.protocol not in EVERY_VOXEL
            and (known := most.get(row.pair)) is not None
            and _counts_more(row, known)
        ):
            yield f"{of} counts more than the protocol {PRIMARY} does"
    if any(of != pairs[table.rows[0].heading] for of in pairs.values()):
        yield "its protocols are of different pairs"
    protocols, present = table.settings.protocols, sorted({row.protocol for row in table.rows})
    if present and protocols and present != sorted(protocols):
        yield f"its rows are under {_named(present)}, its settings name {_named(protocols)}"


def _counts_more(row: ScoreRow, known: ScoreRow) -> bool:
    """Return whether a row counts more voxels, or more of the shape, than its pair's row under `known`."""
    return (row.coverage_voxels or 0.0) > (known.coverage_voxels or 0.0) + ROUNDING or (
        (row.coverage_shape or 0.0) > (known.coverage_shape or 0.0) + ROUNDING
    )


def _in_row(row: ScoreRow, version: int) -> Iterator[str]:
    """Report impossible or contradictory values of one row: threshold, coverage, CE, IoU."""
    figures = [getattr(row, name) for name in VOXEL_METRICS]
    if row.threshold not in THRESHOLDS:
        yield f"has a threshold of {row.threshold:g}, which is not one of the {len(THRESHOLDS)}"
    if row.protocol in EVERY_VOXEL and (row.coverage_voxels or 1.0, row.coverage_shape or 1.0) != (1.0, 1.0):
        yield "does not count every voxel"
    if row.ce is not None and row.ce > MOST_CE + ROUNDING:
        yield f"states a CE of {row.ce:g}; none is above {MOST_CE:.1f}, since predictions are clipped"
    if row.in_space and row.counts:
        # Means of several predictions need not satisfy equations between ratios.
        is_mean = row.hypotheses is not None and row.hypotheses.of == "mean"
        yield from _ratios(row) if row.iou is not None and not is_mean else ()
        return
    if row.iou is None:
        if any(value is not None for value in (*figures, row.iou_by_threshold)):
            yield "has figures, but no IoU"
        elif version >= ACCOUNTED and row.coverage_voxels and row.coverage_shape:
            yield "has no figures, though it counts a part of the shape"
        return
    yield from _ratios(row)
    if row.iou_by_threshold is not None or version >= ACCOUNTED:
        yield from _off_its_curve(row, row.iou_by_threshold or ())


def _ratios(row: ScoreRow) -> Iterator[str]:
    """Report precision, recall and F1 that contradict the IoU: the same three counts determine all four."""
    iou, precision, recall = row.iou or 0.0, row.precision, row.recall
    if row.f1 is not None and not _near(row.f1, 2 * iou / (1 + iou)):
        yield f"states an F1 of {row.f1:g}, which no IoU of {iou:g} has"
    if precision is None or recall is None:
        return
    # This is 1 / IoU = 1 / precision + 1 / recall - 1, without a division
    if not _near(precision * recall, iou * (precision + recall - precision * recall)):
        yield f"states precision {precision:g} and recall {recall:g}, which no IoU of {iou:g} has"


def _off_its_curve(row: ScoreRow, curve: Sequence[float]) -> Iterator[str]:
    """Report a row whose IoU differs from the value of its IoU curve at the row's threshold."""
    if len(curve) != len(THRESHOLDS) or row.threshold not in THRESHOLDS:
        yield f"has no IoU at each of the {len(THRESHOLDS)} thresholds"
    elif not _near(of := curve[THRESHOLDS.index(row.threshold)], row.iou or 0.0):
        yield f"states an IoU of {row.iou:g}, and {of:g} at its threshold"


def _of_thresholds(table: ScoreTable) -> Iterator[str]:
    """Report rows whose threshold is not that of their category, and thresholds chosen on scored objects."""
    used: dict[str, float] = dict(table.thresholds)
    for row in table.rows:
        if used.setdefault(row.category, row.threshold) != row.threshold:
            yield (
                f"the row of {row.pair} under {row.protocol} has the threshold {row.threshold:g}, "
                f"its category {used[row.category]:g}"
            )
    shared = sorted({row.object for row in table.rows} & set(table.threshold_objects or ()))
    if shared:
        yield f"its thresholds were found on objects that it scores ({_named(shared)})"


def _of_sources(table: ScoreTable) -> Iterator[str]:
    """Report contradictions in what a table states as sources of its thresholds.

    The source of the whole table must fit the sources of its categories, the values of the thresholds, and
    the number of validation pairs that were counted, if any.
    """
    source, sources, use = table.threshold_source, table.threshold_source_by_category, table.validation
    categories = {row.category for row in table.rows} | table.thresholds.keys()
    if not categories == table.thresholds.keys() == sources.keys():
        yield "'thresholds', 'threshold_source_by_category' and the rows are of different categories"
        return
    if not _fit(source, set(sources.values()), table.score_version):
        names = _named(sorted({printable(of, 17) for of in sources.values()}))
        yield f"its thresholds are from {printable(source, 17)}, those of its categories from {names}"
    for name, of in sources.items():
        if of == FIXED_SOURCE and table.thresholds[name] != FIXED:
            yield f"the threshold of {name} is called fixed, but is {table.thresholds[name]:g}, not {FIXED}"
    for of_many in (POOLED_SOURCE, METHOD_SOURCE):
        if len({table.thresholds[name] for name, of in sources.items() if of == of_many}) > 1:
            yield f"its thresholds from {of_many} differ, and there is only one"
    if (use is not None) != (source in SEARCHED):
        yield f"its thresholds are from {printable(source, 17)}, but 'validation' says otherwise"
    if use is not None and not 0 <= use.predicted <= use.pairs:
        yield f"{use.predicted} of {use.pairs} validation pairs cannot have been predicted"
    if (
        table.threshold_objects is None
        and not source.startswith(FROM_FILE)
        and METHOD_SOURCE not in sources.values()
    ):
        yield "'threshold_objects' is null, though its thresholds are from no file and not the method's own"


def _fit(source: str, by_category: set[str], version: int) -> bool:
    """Return whether a table's source of thresholds fits the sources of its categories."""
    if source.startswith(FROM_FILE):
        return by_category == {source}
    others = by_category - {VALIDATION_SOURCE}
    if source != next((word for word in SOURCES if word in by_category), None) or len(others) > 1:
        return False
    if version < POOLED_FROM:
        return others <= {FIXED_SOURCE}
    # If any category has validation pairs, a category without them can use the pooled ones.
    return others <= set(SOURCES) and (source == FIXED_SOURCE or FIXED_SOURCE not in others)


def _of_missing(table: ScoreTable) -> Iterator[str]:
    """Report that `missing_as_empty`, settings, `hashes` and rows disagree about pairs scored as empty."""
    test = {row.pair: row.cells for row in table.rows}
    empty = set(table.missing_as_empty)
    if {name for name, cells in test.items() if not cells} != empty & test.keys():
        yield "'missing_as_empty' names other pairs than the rows without a prediction"
    if empty and table.settings.missing != "empty":
        yield "'missing_as_empty' names pairs, though its settings call a missing prediction an error"
    if not test.keys() <= table.hashes.keys():
        yield "'hashes' lacks pairs of its rows"
    elif table.threshold_source not in (FIXED_SOURCE, METHOD_SOURCE):
        validation = len(table.hashes) - len(test)
        predicted = 0 if table.validation is None else table.validation.predicted
        if validation != predicted + len(empty - test.keys()):
            yield f"'hashes' has {validation} pairs beside its rows, where validation has {predicted}"


def _near(one: float, other: float) -> bool:
    return math.isclose(one, other, rel_tol=ROUNDING, abs_tol=ROUNDING)


def _named(names: Sequence[str]) -> str:
    return listed((printable(name, 60) for name in names), 3)


ROUNDING = 1e-9  # a sum of shares may be above 1 by 1e-15


def _out_of_bounds(table: ScoreTable) -> Iterator[str]:
    """Yield a sentence for each value outside its schema's minimum, maximum, pattern or list of words.

    Values that follow from the rows are not checked, because the reader computes them again.
    """
    for name in ScoreTable.model_fields:
        if name not in DERIVED:
            yield from _in_field(getattr(table, name), _extra(ScoreTable, name), name)


def _in_field(value: object, extra: Mapping[str, object], key: str) -> Iterator[str]:
    """Yield a sentence for each value out of bounds in a field and its parts.

    `extra` has the field's bounds. `key` is the field's name in the sentence, as a path such as `a.b.0`.
    """
    if extra and value not in (None, "") and (why := _outside(value, extra)):
        yield f"'{key}' is {printable(repr(value), 60)}, but {why}"
    elif isinstance(value, StoredPart) or (is_dataclass(value) and not isinstance(value, type)):
        for name, of in _bounded(type(value)):
            yield from _in_field(getattr(value, name), of, f"{key}.{name}")
    elif isinstance(value, Mapping):
        for name, of_name in value.items():
            yield from _in_field(of_name, {}, f"{key}.{printable(str(name), 60)}")
    elif isinstance(value, tuple):
        for index, one in enumerate(value):
            yield from _in_field(one, {}, f"{key}.{index}")


def _outside(value: object, extra: Mapping[str, Any]) -> str:
    """Return, in a few words, why a value breaks the bounds `extra`, such as {"minimum": 0}; else ""."""
    if isinstance(value, list | tuple):
        if "minItems" in extra and not extra["minItems"] <= len(value) <= extra["maxItems"]:
            return f"must have {extra['minItems']} values"
        items = extra.get("items")
        if not items or not value:
            return ""
        return next((why for one in (min(value), max(value)) if (why := _outside(one, items))), "")
    if isinstance(value, str):
        if "enum" in extra and value not in extra["enum"]:
            return f"must be one of {', '.join(filter(None, extra['enum']))}"
        if not re.fullmatch(extra.get("pattern", ".*"), value, re.DOTALL):
            return f"must match {extra['pattern']}"
        return ""
    if isinstance(value, int | float):
        if value < extra.get("minimum", value) - ROUNDING:
            return f"must be at least {extra['minimum']}"
        if value > extra.get("maximum", value) + ROUNDING:
            return f"must be at most {extra['maximum']}"
    return ""


@cache
def _bounded(kind: type) -> tuple[tuple[str, Mapping[str, object]], ...]:
    """Return (name, bounds) of each field of a class; bounds are such as {"minimum": 0}."""
    names = kind.model_fields if issubclass(kind, StoredPart) else fields_of(kind)
    return tuple((name, _extra(kind, name)) for name in names)


def _extra(kind: type, name: str) -> Mapping[str, object]:
    """Return the bounds that the schema of a class gives a field, such as {"minimum": 0}; {} if none."""
    info: FieldInfo = (kind.model_fields if issubclass(kind, StoredPart) else fields_of(kind))[name]
    return info.json_schema_extra if isinstance(info.json_schema_extra, dict) else {}
