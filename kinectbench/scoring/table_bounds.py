"""Check a score table's values against the bounds of its schema.

The reader of an untrusted table refuses a share above 1 or a cell count below 0.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass
from functools import cache
from typing import Any

from pydantic.fields import FieldInfo

from kinectbench.core import printable
from kinectbench.core.artefacts.score_figures import fields_of
from kinectbench.core.artefacts.scores import DERIVED, ScoreTable
from kinectbench.core.artefacts.stored import StoredPart

ROUNDING = 1e-9  # a sum of shares may be above 1 by 1e-15


def out_of_bounds(table: ScoreTable) -> Iterator[str]:
    """Yield a sentence for each value outside the schema's minimum, maximum, pattern or list of words.

    Values that follow from the rows are not checked: the reader computes them again.
    """
    for name in ScoreTable.model_fields:
        if name not in DERIVED:
            yield from _in_field(getattr(table, name), _extra(ScoreTable, name), name)


def _in_field(value: object, extra: Mapping[str, object], key: str) -> Iterator[str]:
    """Yield a sentence for each value out of bounds in a field and its parts; `extra`: the field's bounds."""
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
    """Return why a value breaks the bounds `extra`, such as {"minimum": 0}, in a few words; else ""."""
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
    """Return the bounds of a class's field, such as {"minimum": 0}, from its schema; {} if it has none."""
    info: FieldInfo = (kind.model_fields if issubclass(kind, StoredPart) else fields_of(kind))[name]
    return info.json_schema_extra if isinstance(info.json_schema_extra, dict) else {}
