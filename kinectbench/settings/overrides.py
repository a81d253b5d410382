"""Settings from command-line options; one clear line for every wrong one."""

from collections.abc import Sequence
from typing import Any, TypeVar

from pydantic import ValidationError

from kinectbench.core.errors import SettingsError
from kinectbench.settings import yaml_nodes
from kinectbench.settings.base import Settings
from kinectbench.settings.words import field_at, listed, model_of, suggestion, wanted

Model = TypeVar("Model", bound=Settings)


def settings_from_options(
    model: type[Model], values: dict[str, Any], overrides: Sequence[str], what: str
) -> Model:
    """Settings with some of their values changed.

    Args:
        model: of the settings.
        values: nested values.
        overrides: `section.key=value` or `key=value`, the value in YAML; they win, the last one most.
        what: begins each line about a wrong value, such as "simulation".

    Raises:
        SettingsError: one line for each wrong value.
    """
    for override in overrides:
        values = merged(values, _nested(override))
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise SettingsError(*(f"{what}: {_line(model, e)}" for e in error.errors())) from None


def merged(values: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Nested values with some of them replaced."""
    result = dict(values)
    for key, value in changes.items():
        old = result.get(key)
        result[key] = merged(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return result


def _nested(override: str) -> dict[str, Any]:
    """`a.b=value` as {a: {b: value}}."""
    source = f"{yaml_nodes.OVERRIDE}{override}"
    key, equals, text = override.partition("=")
    if not equals or not all(key.strip().split(".")):
        raise SettingsError(f"{source}: write --set key=value, or --set section.key=value")
    value = yaml_nodes.plain(yaml_nodes.compose(text, source))
    for part in reversed(key.strip().split(".")):
        value = {part: value}
    return dict(value)


def _line(model: type[Settings], error: Any) -> str:
    """A readable line for one of pydantic's errors."""
    location = tuple(error["loc"])
    annotation, constraints, used = field_at(location, model)
    key = ".".join(str(part) for part in location)
    if error["type"] == "extra_forbidden":
        inner = model_of(annotation)
        return f"{key}: unknown; {suggestion(str(location[-1]), list(inner.model_fields) if inner else [])}"
    if error["type"] == "value_error":
        return f"{key + ': ' if key else ''}{error['msg'].removeprefix('Value error, ')}"
    key = ".".join(str(part) for part in location[:used])
    inner = model_of(annotation)
    what = f"values of {listed(inner.model_fields)}" if inner else wanted(annotation, constraints)
    return f"{key}: found {error['input']!r}; wanted {what}"
