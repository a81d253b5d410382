"""Read a YAML file that holds one settings model; each error is reported in one line."""

from pathlib import Path
from typing import TypeVar

import yaml
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from kinectbench.core import SettingsError, printable, pydantic_message, quoted, read_plain_text
from kinectbench.settings import yaml_nodes
from kinectbench.settings.base import Settings
from kinectbench.settings.words import WHAT_OF_TYPE, field_at, model_of, suggestion, wanted

Model = TypeVar("Model", bound=Settings)
# Largest file: it has some thirty keys, or a row of 200 bytes for each of 5,000 scans.
MOST_BYTES = 1 << 20
# Largest number of lines about errors; each takes as long as reading all keys.
SHOWN = 20


def read_model(path: Path, model: type[Model], example: str) -> Model:
    """Read a YAML file and validate its content by a model.

    Args:
        path: the file.
        model: model of the content.
        example: a valid line, for an error message.

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
        lines = [_line(root, one, model) for one in errors[:SHOWN]]
        if len(errors) > SHOWN:
            lines.append(f"{path}: and {len(errors) - SHOWN} more errors")
        raise SettingsError(*dict.fromkeys(lines), what=WHAT_OF_TYPE.get(errors[0]["type"], "")) from None


def _line(root: yaml.Node, error: ErrorDetails, model: type[Settings]) -> str:
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
