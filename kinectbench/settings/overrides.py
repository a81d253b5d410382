"""Make settings from command-line options; each wrong option gives one error line."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TypeVar

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from kinectbench.core import SettingsError, listed, pydantic_message
from kinectbench.settings import yaml_nodes
from kinectbench.settings.base import Settings
from kinectbench.settings.words import field_at, model_of, suggestion, wanted

Model = TypeVar("Model", bound=Settings)


def settings_from_options(
    model: type[Model], values: Mapping[str, object], overrides: Sequence[str], what: str
) -> Model:
    """Make settings from the values of options, as changed by `--set` overrides.

    Args:
        model: model of the settings.
        values: values of the options, nested by section.
        overrides: `section.key=value` or `key=value`, with the value in YAML; they replace `values`, and
            later overrides replace earlier overrides.
        what: start of an error line about values that contradict each other, such as "simulation". A line
            about one value starts with its option instead.

    Raises:
        SettingsError: one line for each wrong value, or a line about an override that is not `key=value`.
    """
    for override in overrides:
        values = merged(values, _nested(override))
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise SettingsError(*(_line(model, e, overrides, what) for e in error.errors())) from None


def merged(values: Mapping[str, object], changes: Mapping[str, object]) -> dict[str, object]:
    """Merge `changes` into nested values; return new dicts."""
    result = dict(values)
    for key, value in changes.items():
        old = result.get(key)
        result[key] = merged(old, value) if isinstance(old, dict) and isinstance(value, dict) else value
    return result


def _nested(override: str) -> dict[str, object]:
    """Parse `a.b=value` into {a: {b: value}}."""
    source = f"{yaml_nodes.OVERRIDE}{override}"
    key, equals, text = override.partition("=")
    if not equals or not all(key.strip().split(".")):
        raise SettingsError(f"{source}: write --set key=value, or --set section.key=value")
    value = yaml_nodes.plain(yaml_nodes.compose(text, source))
    for part in reversed(key.strip().split(".")):
        value = {part: value}
    return dict(value)


def _line(model: type[Settings], error: ErrorDetails, overrides: Sequence[str], what: str) -> str:
    """Describe a pydantic error in a line, which starts with the wrong option, or else with `what`."""
    location = tuple(error["loc"])
    annotation, constraints, _ = field_at(location, model)
    where = _option([str(part) for part in location], overrides) if location else what
    if error["type"] == "extra_forbidden":
        inner, key = model_of(annotation), str(location[-1])
        if homes := list(_homes(model, key)):
            return f"{where}: unknown; did you mean {' or '.join(homes)}?"
        return f"{where}: unknown; {suggestion(key, list(inner.model_fields) if inner else [])}"
    if error["type"] == "value_error":
        return f"{where}: {pydantic_message(error)}"
    inner = model_of(annotation)
    found = f"values of {listed(inner.model_fields)}" if inner else wanted(annotation, constraints)
    return f"{where}: found {error['input']!r}; wanted {found}"


def _homes(model: type[Settings], key: str, where: str = "") -> Iterator[str]:
    """Yield `where` + each dotted name of a key in a model and its sections, such as `path.frames`."""
    for name, field in model.model_fields.items():
        if name == key:
            yield where + name
        elif (inner := model_of(field.annotation)) is not None:
            yield from _homes(inner, key, f"{where}{name}.")


def _option(location: Sequence[str], overrides: Sequence[str]) -> str:
    """Return the last `--set` that changes the value at a location, or else the option with its name."""
    for override in reversed(overrides):
        key = override.partition("=")[0].strip().split(".")
        if key == list(location[: len(key)]) or list(location) == key[: len(location)]:
            return f"{yaml_nodes.OVERRIDE}{override}"
    return f"--{location[0].replace('_', '-')}"
