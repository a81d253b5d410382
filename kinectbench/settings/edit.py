"""Change a benchmark.yaml as text, so that comments and layout stay as they are.

ruamel.yaml is not used: reading and writing a file with it drops the spaces that align values, needs the
indentation as a setting, and takes seven times as long (measured on 2000 recordings).
"""

import json
from collections.abc import Sequence
from pathlib import Path

import yaml

from kinectbench.core import SettingsError
from kinectbench.core.artefacts.object import BoxPart
from kinectbench.settings import yaml_nodes
from kinectbench.settings.file import nodes_of
from kinectbench.settings.reading import as_text, read_bytes
from kinectbench.settings.recording_table import ENDINGS


def file_of(config: Path, recording: str, box: BoxPart) -> Path:
    """Find the file that defines a recording: a valid benchmark.yaml, or a file that it includes.

    Args:
        config: the benchmark.yaml.
        recording: id of the recording.
        box: the new box, for the error message.

    Raises:
        SettingsError: the recording is defined in a table, which is never changed (the message names the
            cells to fill in); or a file cannot be read.
    """
    root = nodes_of(as_text(read_bytes(config), str(config)), str(config), config)
    entry = _entry(yaml_nodes.items(root)["recordings"], recording)
    path = Path(entry.start_mark.name)
    if path.suffix.lower() in ENDINGS:
        cells = ", ".join(f"box.{key} {json.dumps(value)}" for key, value in box.json_value().items())
        raise SettingsError(
            f"{yaml_nodes.place(entry)}: tables are not changed; fill in its cells: {cells}",
            what="not-editable",
        )
    return path


def _entry(recordings: yaml.Node, recording: str) -> yaml.MappingNode:
    entries: list[yaml.MappingNode] = recordings.value
    return next(e for e in entries if str(yaml_nodes.items(e)["id"].value) == recording)


def with_box(text: str, source: str, recording: str, box: BoxPart) -> str:
    """Set or replace the box of a recording in the text of a file; return the text, otherwise unchanged.

    The text is of a valid benchmark.yaml, or of a file that it includes; the box is in the floor frame.

    Raises:
        SettingsError: the file cannot be changed safely; the message contains the line to paste.
    """
    root = yaml_nodes.compose(text, source)
    entry = _entry(yaml_nodes.items(root)["recordings"], recording)
    changed = _changed(text, entry, box_line(box))
    wanted = yaml_nodes.plain(root)
    for row in wanted["recordings"]:
        if row["id"] == recording:
            row["box"] = json.loads(json.dumps(box.json_value()))
    try:
        done = yaml_nodes.plain(yaml_nodes.compose(changed, source)) == wanted
    except SettingsError:
        done = False
    if not done:
        raise SettingsError(
            f"{yaml_nodes.place(entry)}: cannot be changed safely; paste this line there: {box_line(box)}",
            what="not-editable",
        )
    return changed


def _changed(text: str, entry: yaml.MappingNode, line: str) -> str:
    """Replace the recording's box in the text, or insert it after the recording's id."""
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
    """Return the line `box: {…}` of benchmark.yaml."""
    inner = ", ".join(f"{key}: {json.dumps(value)}" for key, value in box.json_value().items())
    return f"box: {{{inner}}}"


def with_recordings(text: str, source: str, lines: Sequence[str]) -> str:
    """Append recordings to the text of a benchmark.yaml; return the text, otherwise unchanged.

    Each of the new entries in `lines` starts with `  - id:`.

    Raises:
        SettingsError: the file cannot be changed safely.
    """
    if not lines:
        return text
    root = yaml_nodes.compose(text, source)
    wanted = yaml_nodes.plain(root)
    added = yaml_nodes.plain(yaml_nodes.compose("\n".join(["recordings:", *lines]), source))["recordings"]
    own = yaml_nodes.items(root).get("recordings")
    filled = own is not None and wanted["recordings"]
    changed = _with_lines(text, own, lines) if own and filled else _with_first(text, own, lines)
    try:
        done = yaml_nodes.plain(yaml_nodes.compose(changed, source))
    except SettingsError:
        done = None
    if done != {**wanted, "recordings": [*(wanted.get("recordings") or []), *added]}:
        place = yaml_nodes.place(own or root)
        raise SettingsError(f"{place}: recordings cannot be added safely", what="not-editable")
    return changed


def _with_first(text: str, empty: yaml.Node | None, lines: Sequence[str]) -> str:
    """Put the lines below an empty `recordings:`; if this key is missing, add both at the end of the text."""
    if empty is None:
        return "\n".join([*text.removesuffix("\n").split("\n"), "", "recordings:", *lines, ""])
    start, end = empty.start_mark.index, empty.end_mark.index
    if "#" in text[start:end]:
        return text
    head, tail = text[:start].rstrip(), text[end:]
    rest, _, below = tail.partition("\n")
    return "\n".join([head + rest, *lines, below])


def _with_lines(text: str, recordings: yaml.Node, lines: Sequence[str]) -> str:
    """Insert the lines after the last recording and after comments that are indented more than its dash."""
    rows = text.removesuffix("\n").split("\n")
    margin, end = recordings.start_mark.column, len(rows)
    if recordings.end_mark.index < len(text):
        end = min(end, recordings.end_mark.line)
    while end and not _is_indented(rows[end - 1], margin):
        end -= 1
    moved = [" " * margin + line[2:] for line in lines]
    return "\n".join([*rows[:end], *moved, *rows[end:], ""])


def _is_indented(row: str, margin: int) -> bool:
    """Whether a row is neither blank nor a comment that begins at column `margin` or left of it."""
    inner = row.lstrip(" ")
    return bool(inner.strip()) and (not inner.startswith("#") or len(row) - len(inner) > margin)
