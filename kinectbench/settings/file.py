"""Read benchmark.yaml and `--set` overrides; each error gives one line, with the file and the line number."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from kinectbench.core import SettingsError, printable, pydantic_message
from kinectbench.core.store.address import shown
from kinectbench.settings import yaml_nodes
from kinectbench.settings.include import ACCEPTED, INCLUDE, RECORDINGS, with_included
from kinectbench.settings.models import BenchmarkSettings
from kinectbench.settings.reading import as_text, read_bytes
from kinectbench.settings.words import (
    WHAT_OF_TYPE,
    Location,
    choices_of,
    field_at,
    model_of,
    near_miss,
    suggestion,
    wanted,
    without_none,
)

# Recordings to validate at a time: each may have several errors of two kilobytes.
RECORDINGS_AT_ONCE = 5000
# Lines about errors to print: more errors usually have one cause.
SHOWN = 20
# Characters of a value that a line quotes, and that are examined for it; values may have megabytes.
QUOTED, LOOKED_AT = 60, 1000


def load_benchmark(path: Path, overrides: Sequence[str] = ()) -> BenchmarkSettings:
    """Read and check a benchmark.yaml.

    Args:
        path: the file, or its URL as a path.
        overrides: `section.key=value` or `recordings.<id>.key=value`, with the value in YAML. They replace
            values of the file; later overrides replace earlier overrides.

    Returns:
        The settings, with defaults for missing keys and empty sections.

    Raises:
        SettingsError: the message has one line for each of the first 20 errors, in the order of the file:
            file and line (or the override), dotted key, the value found, and the value expected.
        StorageError: a store cannot be read.
    """
    source = shown(path)
    return parse_benchmark(as_text(read_bytes(path), source), source, overrides, path)


@yaml_nodes.unsearched()
def parse_benchmark(
    text: str, source: str, overrides: Sequence[str] = (), config: Path | None = None
) -> BenchmarkSettings:
    """Parse the text of a benchmark.yaml as `load_benchmark` does; errors start with `source`.

    Args:
        text: text of the file.
        source: name of the file.
        overrides: `section.key=value` or `recordings.<id>.key=value`, with the value in YAML.
        config: path of the file, for relative includes; None: no file, so no includes.
    """
    root = nodes_of(text, source, config)
    for override in overrides:
        root = _overridden(root, override)
    return _validated(root)


def nodes_of(text: str, source: str, config: Path | None) -> yaml.Node:
    """Parse a benchmark.yaml and the files that it includes into nodes; if `config` is None, include nothing.

    Raises:
        SettingsError: the text is not YAML or holds no settings, a key repeats, or a file cannot be included.
    """
    allowance = yaml_nodes.Allowance()
    root = yaml_nodes.compose(text, source, allowance)
    if root.tag == yaml_nodes.NULL_TAG:
        raise SettingsError(
            f"{source}: holds no settings; `kinectbench init FOLDER` writes a file to start from",
            what="bad-yaml",
        )
    if not isinstance(root, yaml.MappingNode):
        raise SettingsError(
            f"{yaml_nodes.place(root)}: found {_found(root)}; wanted lines like 'name: furniture'"
        )
    yaml_nodes.plain(root)  # refuses repeated keys, before an override could hide one
    return with_included(root, config, allowance) if config else root


def _overridden(root: yaml.Node, override: str) -> yaml.Node:
    """Return a copy of the nodes in which one override `key=value` is applied."""
    source = f"{yaml_nodes.OVERRIDE}{_shortened(override)}"
    key, equals, text = override.partition("=")
    if not equals or not all(key.split(".")):
        raise SettingsError(f"{source}: write --set section.key=value")
    if key.strip().split(".")[0] == INCLUDE:
        raise SettingsError(f"{source}: what is included is read first; write it into the file")
    value = yaml_nodes.compose(text, source)
    return yaml_nodes.replaced(root, _override_path(root, key.strip(), source), value)


def _override_path(root: yaml.Node, key: str, source: str) -> Location:
    """Return the location of an override's dotted key; recordings are named by ids, which may have dots."""
    section, _, tail = key.partition(".")
    if section != "recordings" or not tail:
        return tuple(key.split("."))
    entries = yaml_nodes.items(root).get("recordings")
    children = entries.value if isinstance(entries, yaml.SequenceNode) else []
    ids = [str(child.value) if (child := yaml_nodes.items(entry).get("id")) else "" for entry in children]
    matching = [name for name in ids if name and tail.startswith(f"{name}.")]
    if not matching:
        name = tail if tail in ids else tail.split(".")[0]
        if name in ids:
            raise SettingsError(f"{source}: write --set recordings.{name}.key=value")
        raise SettingsError(f"{source}: no recording '{name}'; {suggestion(name, ids)}", what="no-recording")
    name = max(matching, key=len)
    return ("recordings", ids.index(name), *tail[len(name) + 1 :].split("."))


def _validated(root: yaml.Node) -> BenchmarkSettings:
    fields = BenchmarkSettings.model_fields
    values = {
        key: value
        for key, value in yaml_nodes.plain(root).items()
        if value is not None or key not in fields or fields[key].is_required()
    }
    errors = _errors_of_first(values)
    if not errors:
        try:
            return BenchmarkSettings.model_validate(values)
        except ValidationError as error:
            errors = error.errors(include_url=False)
    raise SettingsError(*_error_lines(root, values, errors), what=WHAT_OF_TYPE.get(errors[0]["type"], ""))


def _errors_of_first(values: dict[str, Any]) -> list[ErrorDetails]:
    """Validate a long list of recordings in parts; return the errors of the first wrong part, else []."""
    recordings = values.get("recordings")
    if not isinstance(recordings, list) or len(recordings) <= RECORDINGS_AT_ONCE:
        return []
    for start in range(0, len(recordings), RECORDINGS_AT_ONCE):
        part = values | {"recordings": recordings[start : start + RECORDINGS_AT_ONCE]}
        try:
            BenchmarkSettings.model_validate(part)
        except ValidationError as error:
            errors = [one for one in error.errors(include_url=False) if one["loc"]]
            for one in errors:
                if one["loc"][0] == "recordings" and len(one["loc"]) > 1:
                    one["loc"] = ("recordings", start + int(one["loc"][1]), *one["loc"][2:])
            if errors:
                return errors
    return []


def _error_lines(root: yaml.Node, values: dict[str, Any], errors: Sequence[ErrorDetails]) -> list[str]:
    """Return one line for each of the first errors, in the order of the file, and one line for the rest."""
    known: yaml_nodes.Known = {}
    # Several wrong numbers of one vector are one error.
    of_place: dict[tuple[Location, str], ErrorDetails] = {}
    for error in errors:
        of_place.setdefault((_location(error), error["type"]), error)
    if any(error["loc"][:1] == (INCLUDE,) for error in errors):
        of_place.pop(((RECORDINGS,), "missing"), None)  # the included files should define them
    errors = list(of_place.values())
    anchors = [yaml_nodes.find(root, _location(error), known)[0] for error in errors]
    orders = [yaml_nodes.order(anchor, root.start_mark.name) for anchor in anchors]
    first = sorted(range(len(errors)), key=orders.__getitem__)[: 4 * SHOWN]
    messages = sorted((orders[n], _error_line(root, values, errors[n], known)) for n in first)
    lines = list(dict.fromkeys(line for _, line in messages))
    if hidden := len(lines[SHOWN:]) + len(errors) - len(first):
        lines[SHOWN:] = [f"{root.start_mark.name}: and {hidden} more errors"]
    return lines


def _location(error: ErrorDetails) -> Location:
    """Return the location of the YAML node that a pydantic error is about."""
    # For an invalid key of a mapping, pydantic appends an extra part.
    location, kind = tuple(part for part in error["loc"] if part != "[key]"), error["type"]
    if kind == "value_error":
        return location or tuple(error["ctx"]["at"])
    used = field_at(location)[2]
    whole = kind == "extra_forbidden" or (kind == "missing" and used == len(location))
    return location if whole else location[:used]


def _error_line(root: yaml.Node, values: dict[str, Any], error: ErrorDetails, known: yaml_nodes.Known) -> str:
    """Describe a pydantic error in a line: place, key, value found, value expected; `known` is a cache."""
    location, kind = _location(error), error["type"]
    annotation, constraints, used = field_at(error["loc"])
    anchor, value = yaml_nodes.find(root, location, known)
    if kind == "extra_forbidden":
        what = f"unknown key; {_key_hint(str(location[-1]), annotation)}"
    elif kind == "missing" and used == len(error["loc"]):
        what = f"missing; wanted {wanted(annotation, constraints)}"
    elif kind == "value_error":
        what = pydantic_message(error)
        if "earlier" in error.get("ctx", {}):
            earlier = yaml_nodes.find(root, ("recordings", error["ctx"]["earlier"]), known)[0]
            what += f" (the other is at {yaml_nodes.place(earlier)})"
        if "valid" in error.get("ctx", {}):
            what += f"; {suggestion(str(location[-1]), error['ctx']['valid'])}"
        what = f"found {_found(value)}; {what}" if isinstance(value, yaml.ScalarNode) else what
    else:
        what = f"found {_found(value)}; wanted {wanted(annotation, constraints)}"
        what += "; it must be finite" if kind == "finite_number" else _value_hint(value, annotation)
    if location == (INCLUDE,):
        what += f": {ACCEPTED}"
    where, key = yaml_nodes.place(anchor), _dotted(values, location)
    named = where.startswith(f"{yaml_nodes.OVERRIDE}{key}=")
    return f"{where}: {what}" if named else f"{where}: {printable(key)}: {what}"


def _key_hint(name: str, annotation: object) -> str:
    """Return advice on an unknown key of a model: the section that it belongs under, or a similar key."""
    model = model_of(annotation)
    homes = [
        section
        for section, field in BenchmarkSettings.model_fields.items()
        if (home := model_of(field.annotation)) and home is not model and name in home.model_fields
    ]
    if homes:
        return f"it belongs under '{homes[0]}:'"
    return suggestion(name, list(model.model_fields) if model else [])


def _value_hint(value: yaml.Node | None, annotation: object) -> str:
    """Return advice on a value of the wrong type; "" if there is none."""
    if not isinstance(value, yaml.ScalarNode) or value.tag == yaml_nodes.NULL_TAG:
        return ""
    if choices := choices_of(annotation):
        hint = near_miss(value.value, choices) if len(choices) > 1 else ""
        return f"; {hint}" if hint else ""
    if without_none(annotation) is str:
        return f": write '{printable(value.value)}' in quotes"
    return ""


def _dotted(values: dict[str, Any], location: Location) -> str:
    """Write a location as `--set` does: a recording by its id, or by its index if it has no id."""
    text = ""
    for depth, part in enumerate(location):
        if isinstance(part, str):
            text += f".{part}" if text else part
            continue
        entry = values["recordings"][part] if location[:depth] == ("recordings",) else None
        name = entry.get("id") if isinstance(entry, dict) else None
        text += f".{name}" if isinstance(name, str) else f"[{part}]"
    return text


def _found(node: yaml.Node | None) -> str:
    """Describe a value as written in the file, shortened."""
    if isinstance(node, yaml.SequenceNode):
        if not node.value or not all(isinstance(child, yaml.ScalarNode) for child in node.value):
            return f"a list of {len(node.value)}"
        # As many elements as a line may quote characters.
        return _shortened(f"[{', '.join(_scalar(child) for child in node.value[:QUOTED])}]")
    if isinstance(node, yaml.MappingNode):
        return "a mapping"
    if node is None:
        return "nothing"
    return f"the text {_scalar(node)}" if node.tag == yaml_nodes.STR_TAG else _scalar(node)


def _scalar(node: yaml.Node) -> str:
    """Return a scalar as written in the file; a text is put in quotation marks."""
    if node.tag == yaml_nodes.NULL_TAG:
        return "nothing"
    text = _shortened(str(node.value))
    return f"'{text}'" if node.tag == yaml_nodes.STR_TAG else text


def _shortened(text: str) -> str:
    """Put a text on one line, and cut out its middle if it is long."""
    return printable(" ".join(text[:LOOKED_AT].split()), QUOTED)
