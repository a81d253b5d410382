"""Change a benchmark.yaml as text: comments and layout stay as they are."""

import json

import yaml

from kinectbench.core.artefacts.object import BoxPart
from kinectbench.core.errors import SettingsError
from kinectbench.settings import yaml_nodes
from kinectbench.settings.file import parse_benchmark
from kinectbench.settings.models import BoxSettings


def with_box(text: str, source: str, recording: str, box: BoxPart) -> str:
    """The text of a benchmark.yaml in which a recording has this box, and nothing else is changed.

    Args:
        text: of the file, without errors.
        source: its name.
        recording: an id in it.
        box: in the floor frame.

    Raises:
        SettingsError: the file is written in a way that cannot be changed safely; the line to paste is told.
    """
    entries = yaml_nodes.items(yaml_nodes.compose(text, source))["recordings"].value
    entry = next(e for e in entries if str(yaml_nodes.items(e)["id"].value) == recording)
    changed = _changed(text, entry, box_line(box))
    wanted = parse_benchmark(text, source).model_dump()
    for row in wanted["recordings"]:
        if row["id"] == recording:
            row["box"] = BoxSettings.model_validate(box.json_value()).model_dump()
    try:
        done = parse_benchmark(changed, source).model_dump() == wanted
    except SettingsError:
        done = False
    if not done:
        raise SettingsError(
            f"{yaml_nodes.place(entry)}: cannot be changed safely; paste this line there: {box_line(box)}"
        )
    return changed


def _changed(text: str, entry: yaml.MappingNode, line: str) -> str:
    """The text with the recording's box replaced, or put in after its id."""
    nodes = yaml_nodes.items(entry)
    if "box" in nodes:
        start, end = nodes["box"].start_mark.index, nodes["box"].end_mark.index
        trailing = text[start:end][len(text[start:end].rstrip()) :]
        return text[:start] + line.removeprefix("box: ") + trailing + text[end:]
    after_id = nodes["id"].end_mark.index
    if entry.flow_style:
        return f"{text[:after_id]}, {line}{text[after_id:]}"
    end_of_line = text.find("\n", after_id)
    end_of_line = len(text) if end_of_line < 0 else end_of_line
    return f"{text[:end_of_line]}\n{' ' * entry.start_mark.column}{line}{text[end_of_line:]}"


def box_line(box: BoxPart) -> str:
    """The line `box: {…}` of benchmark.yaml."""
    inner = ", ".join(f"{key}: {json.dumps(value)}" for key, value in box.json_value().items())
    return f"box: {{{inner}}}"
