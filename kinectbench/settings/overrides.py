"""Make settings models of a YAML file or of command-line options; each error is reported in one line."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import yaml
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from kinectbench.core import SettingsError, listed, printable, pydantic_message, quoted, read_plain_text
from kinectbench.settings import yaml_nodes
from kinectbench.settings.base import Settings
from kinectbench.settings.words import WHAT_OF_TYPE, field_at, model_of, suggestion, wanted

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


# Largest file: it has some thirty keys, or a row of 200 bytes for each of 5,000 scans.
MOST_BYTES = 1 << 20
# Largest number of lines about errors; each takes as long as reading all keys.
SHOWN = 20


def read_model(path: Path, model: type[Model], example: str) -> Model:
    """Read a YAML file and validate its content by a model.

    `example` is a valid line, for an error message.

    Raises:
        SettingsError: the file is unreadable or not YAML, or has invalid values. In the latter case there is
            a line for each of the first 20 errors: file and line, key, expected value.
    """
    try:
        text = read_plain_text(path, MOST_BYTES)
    except UnicodeDecodeError:
        raise SettingsError(f"{path}: not UTF-8 text; save the file as UTF-8", what="bad-yaml") from None
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror or error}", what="unreadable") from None
    root = yaml_nodes.compose(text, str(path))
    if not isinstance(root, yaml.MappingNode):
        raise SettingsError(f"{path}: holds no settings; wanted lines like '{example}'", what="bad-yaml")
    values = yaml_nodes.plain(root)
    try:
        return model.model_validate(values)
    except ValidationError as error:
        errors = error.errors(include_url=False)
        lines = [_yaml_line(root, one, model) for one in errors[:SHOWN]]
        if len(errors) > SHOWN:
            lines.append(f"{path}: and {len(errors) - SHOWN} more errors")
        raise SettingsError(*dict.fromkeys(lines), what=WHAT_OF_TYPE.get(errors[0]["type"], "")) from None


def _yaml_line(root: yaml.Node, error: ErrorDetails, model: type[Settings]) -> str:
    """Describe a pydantic error in a line: file and line number, key, value expected."""
    # For an invalid key of a mapping, pydantic appends an extra part.
    location, kind = tuple(part for part in error["loc"] if part != "[key]"), error["type"]
    annotation, constraints, used = field_at(location, model)
    where = yaml_nodes.place(yaml_nodes.find(root, location)[0])
    key = printable(".".join(str(part) for part in location))
    begin = f"{where}: {key}: " if key else f"{where}: "
    if kind == "extra_forbidden":
        inner = model_of(annotation)
        return (
            begin + f"unknown key; {suggestion(str(location[-1]), list(inner.model_fields) if inner else [])}"
        )
    if kind == "value_error":
        return begin + pydantic_message(error)
    if kind == "missing" and used == len(location):
        return begin + f"missing; wanted {wanted(annotation, constraints)}"
    return begin + f"found {quoted(error['input'])}; wanted {wanted(annotation, constraints)}"
