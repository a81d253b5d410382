"""Recordings that the key `include:` of benchmark.yaml reads from files below its folder, YAML or tables."""

from dataclasses import dataclass, field
from pathlib import Path

import yaml

from kinectbench.core import SettingsError, followed, printable
from kinectbench.core.store.address import shown, unusable, url_of
from kinectbench.settings import yaml_nodes
from kinectbench.settings.reading import MOST_BYTES, as_text, matching, read_bytes, refuse_outside
from kinectbench.settings.recording_table import ENDINGS, table_entries

INCLUDE, RECORDINGS = "include", "recordings"
# Largest number of included files: one for each recording of the largest benchmark; each takes a tenth of a
# millisecond.
MOST_FILES = 20_000
ACCEPTED = f"names of YAML files with `{RECORDINGS}:`, or of tables, {' or '.join(ENDINGS)}"
# JSON is valid YAML. Files with other suffixes are read as YAML, too.
OF_YAML = (".yaml", ".yml", ".json")
MISSING = "correct the name under `include:`, or make the file"


@dataclass
class _Left:
    """The limits that all included files share, as far as they remain, and the files read so far.

    Attributes:
        allowance: number of YAML keys and values that may still be read.
        bytes: number of bytes that may still be read.
        seen: resolved paths of benchmark.yaml and of the files read so far; none is read twice.
    """

    allowance: yaml_nodes.Allowance
    bytes: int = MOST_BYTES
    seen: set[Path] = field(default_factory=set)


def with_included(root: yaml.MappingNode, config: Path, allowance: yaml_nodes.Allowance) -> yaml.MappingNode:
    """Append the recordings of the included files to the nodes of a benchmark.yaml.

    Names are relative to the folder of `config`; `allowance` is the number of values that all files
    together may still have.

    Returns:
        Nodes without `include:`; each recording keeps its file and line number. If `include:` has the wrong
        form, it stays, so that validation refuses it.

    Raises:
        SettingsError: a file is missing, outside the folder, invalid, or holds more than recordings.
        StorageError: a store cannot be read.
    """
    nodes = yaml_nodes.items(root)
    patterns = nodes.get(INCLUDE)
    own = nodes.get(RECORDINGS)
    if patterns is None or not _are_texts(patterns):
        return root
    if not (own is None or isinstance(own, yaml.SequenceNode) or own.tag == yaml_nodes.NULL_TAG):
        return root
    entries = list(own.value) if isinstance(own, yaml.SequenceNode) else []
    left = _Left(allowance, seen={followed(config)})
    for pattern in patterns.value:
        for path in _files(pattern, config):
            entries += _entries(path, config, pattern, left)
    mark = own or patterns
    merged = yaml.SequenceNode(yaml_nodes.SEQ_TAG, entries, mark.start_mark, mark.end_mark)
    pairs = [(key, child) for key, child in root.value if key.value not in (INCLUDE, RECORDINGS)]
    key = yaml.ScalarNode(yaml_nodes.STR_TAG, RECORDINGS, mark.start_mark, mark.end_mark)
    return yaml.MappingNode(root.tag, [*pairs, (key, merged)], root.start_mark, root.end_mark)


def _are_texts(node: yaml.Node) -> bool:
    return (
        isinstance(node, yaml.SequenceNode)
        and node.value != []
        and all(isinstance(each, yaml.ScalarNode) and each.tag == yaml_nodes.STR_TAG for each in node.value)
    )


def _files(pattern: yaml.ScalarNode, config: Path) -> list[Path]:
    """List the files that match one entry of `include:`."""
    where = f"{yaml_nodes.place(pattern)}: {INCLUDE}"
    if url_of(pattern.value) or unusable(pattern.value):
        raise SettingsError(
            f"{where}: '{printable(shown(pattern.value))}' is a URL; files are named relative to the "
            f"folder of {config.name}, in a store, too"
        )
    try:
        files = matching(config.parent, pattern.value)
    except ValueError as error:
        raise SettingsError(f"{where}: {error}") from None
    except OSError as error:
        raise SettingsError(f"{where}: {error.filename}: {error.strerror}") from None
    if not files:
        place = shown(config.parent) if url_of(config) else followed(config.parent)
        raise SettingsError(f"{where}: no file is called '{printable(pattern.value)}' in {place}; correct it")
    if len(files) > MOST_FILES:
        raise SettingsError(f"{where}: {len(files)} files; at most {MOST_FILES} may be included")
    return files


def _entries(path: Path, config: Path, pattern: yaml.ScalarNode, left: _Left) -> list[yaml.Node]:
    """Read the recordings of one included file; return [] if an earlier pattern has matched it already."""
    where = f"{yaml_nodes.place(pattern)}: {INCLUDE}"
    refuse_outside(path, config.parent)
    if followed(path) in left.seen:
        if path.name == pattern.value and followed(path) == followed(config):
            raise SettingsError(f"{where}: '{printable(pattern.value)}' is this file itself; remove it")
        return []
    left.seen.add(followed(path))
    if url_of(path) is None and path.is_dir():
        name = printable(pattern.value.rstrip("/"))
        raise SettingsError(f"{where}: '{name}' is a folder; name its files, such as '{name}/*.yaml'")
    content = read_bytes(path, left.bytes, f"it is named at {where}; {MISSING}")
    left.bytes -= len(content)
    if path.suffix.lower() in ENDINGS:
        return table_entries(content, shown(path), left.allowance)
    try:
        return _of_yaml(as_text(content, shown(path)), shown(path), left.allowance)
    except SettingsError as error:
        if path.suffix.lower() in OF_YAML:
            raise
        raise SettingsError(f"{where}: {error}; accepted are {ACCEPTED}") from None


def _of_yaml(text: str, source: str, allowance: yaml_nodes.Allowance) -> list[yaml.Node]:
    """Read the recordings of an included YAML file, which may have no key besides `recordings:`."""
    root = yaml_nodes.compose(text, source, allowance)
    yaml_nodes.plain(root)  # refuses repeated keys
    only = f"an included file holds `{RECORDINGS}:` and nothing else"
    for key in yaml_nodes.items(root):
        if key != RECORDINGS:
            node = next(each for each, _ in root.value if each.value == key)
            raise SettingsError(
                f"{yaml_nodes.place(node)}: {printable(key)}: {only}; put it into benchmark.yaml"
            )
    recordings = yaml_nodes.items(root).get(RECORDINGS)
    if not isinstance(recordings, yaml.SequenceNode):
        raise SettingsError(f"{yaml_nodes.place(recordings or root)}: {only}, a list as in benchmark.yaml")
    return list(recordings.value)
