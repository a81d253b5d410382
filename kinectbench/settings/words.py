"""Describe settings in words for error messages: expected values, and valid names."""

import difflib
import types
from collections.abc import Sequence
from typing import Annotated, Literal, Union, get_args, get_origin

import annotated_types
from pydantic.fields import FieldInfo

from kinectbench.core import listed
from kinectbench.settings.base import Settings
from kinectbench.settings.models import BenchmarkSettings

Location = tuple[str | int, ...]
# Error code for the type of pydantic's first error; other types have the code of the error's class.
WHAT_OF_TYPE = {"extra_forbidden": "unknown-key", "missing": "missing-key"}


def without_none(annotation: object) -> object:
    """Return a type annotation without `| None` and without validators."""
    if get_origin(annotation) is Annotated:
        return without_none(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        return without_none(next(one for one in get_args(annotation) if one is not type(None)))
    return annotation


def model_of(annotation: object) -> type[Settings] | None:
    """Return the settings model that a type annotation names; None if it names none."""
    inner = without_none(annotation)
    return inner if isinstance(inner, type) and issubclass(inner, Settings) else None


def choices_of(annotation: object) -> tuple[str, ...]:
    """Return the values that a Literal annotation allows; empty for other annotations."""
    inner = without_none(annotation)
    return tuple(map(str, get_args(inner))) if get_origin(inner) is Literal else ()


def field_at(
    location: Location, root: type[Settings] = BenchmarkSettings
) -> tuple[object, Sequence[object], int]:
    """Follow a location (keys, and indices of lists) from the model `root` to a field, as far as possible.

    Returns:
        The field's type annotation, its constraints, and the number of followed parts of the location. A
        vector is one field, so an index into it is not followed.
    """
    annotation: object = root
    constraints: Sequence[object] = ()
    for used, part in enumerate(location):
        annotation = without_none(annotation)
        model = model_of(annotation)
        if isinstance(part, str) and model is not None and part in model.model_fields:
            field = model.model_fields[part]
            annotation, constraints = field.annotation, field.metadata
        elif isinstance(part, str) and get_origin(annotation) is dict:
            annotation, constraints = get_args(annotation)[1], ()
        elif isinstance(part, int) and get_origin(annotation) is list:
            annotation, constraints = get_args(annotation)[0], ()
        else:
            return annotation, constraints, used
    return annotation, constraints, len(location)


def wanted(annotation: object, constraints: Sequence[object]) -> str:
    """Describe the values that a field accepts, such as `a number from 0.001 to 0.05`."""
    inner = without_none(annotation)
    model = model_of(inner)
    if model is not None:
        return f"a mapping with {listed(model.model_fields)}"
    if choices := choices_of(inner):
        return choices[0] if len(choices) == 1 else f"one of {listed(choices)}"
    if get_origin(inner) is tuple:
        entries = get_args(inner)
        if entries[-1] is Ellipsis:
            return f"a list, each entry {wanted(entries[0], ())}"
        return f"a list of {len(entries)} numbers"
    if get_origin(inner) is dict:
        return f"a mapping from names to {wanted(get_args(inner)[1], ())}"
    if get_origin(inner) is list:
        (entry,) = get_args(inner)
        return f"a list with at least one entry, each {'a mapping' if model_of(entry) else 'a text'}"
    names: dict[object, str] = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}
    limits = range_in_words(constraints)
    return f"{names[inner]} {limits}" if limits else names[inner]


def range_in_words(constraints: Sequence[object]) -> str:
    """Return the range that constraints allow, such as `from 1 to 64` or `above 0`; "" if there is none."""
    words = []
    for constraint in constraints:
        if isinstance(constraint, annotated_types.Ge):
            words.append(f"from {constraint.ge}")
        elif isinstance(constraint, annotated_types.Gt):
            words.append(f"above {constraint.gt}")
        elif isinstance(constraint, annotated_types.Le):
            words.append(f"to {constraint.le}" if words and "from" in words[0] else f"up to {constraint.le}")
        elif isinstance(constraint, annotated_types.Lt):
            words.append(f"below {constraint.lt}")
    text = " ".join(words).replace(" up to", " and up to").replace(" below", " and below")
    return f"{text} up" if len(words) == 1 and text.startswith("from") else text


def field_range(field: FieldInfo) -> str:
    """Return a field's choices or range in a few words; empty if any value of its type is valid."""
    choices = choices_of(field.annotation)
    return listed(choices) if len(choices) > 1 else range_in_words(field.metadata)


def suggestion(name: str, valid: Sequence[str]) -> str:
    """Return a hint with the most similar valid name; if none is similar, with all valid names."""
    return near_miss(name, valid) or f"valid here: {listed(valid)}"


def near_miss(name: str, valid: Sequence[str]) -> str:
    """Return a hint with the most similar valid name; empty if none is similar."""
    near = difflib.get_close_matches(name.lower().replace("-", "_"), valid, n=1)
    return f"did you mean '{near[0]}'?" if near else ""
