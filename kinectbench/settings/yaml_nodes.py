"""Parse YAML into nodes that know their file and line, and into plain values; each error gives one line."""

import contextlib
import gc
import io
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import yaml
from yaml.composer import Composer
from yaml.resolver import Resolver

from kinectbench.core import SettingsError, printable

NULL_TAG = "tag:yaml.org,2002:null"
BOOL_TAG = "tag:yaml.org,2002:bool"
INT_TAG = "tag:yaml.org,2002:int"
FLOAT_TAG = "tag:yaml.org,2002:float"
STR_TAG = "tag:yaml.org,2002:str"
SEQ_TAG = "tag:yaml.org,2002:seq"
MAP_TAG = "tag:yaml.org,2002:map"
OVERRIDE = "in --set "
# Largest number of keys and values of a text: ten thousand recordings of fifteen lines, read in four seconds.
MOST_VALUES = 400_000
TOO_MANY = f"more than the {MOST_VALUES} keys and values that such a file may have"
# Characters of a line's start in which a tab is searched.
MOST_INDENT = 1000
# Largest number of bytes that PyYAML's own parser reads, in about two seconds.
SPELT_OUT = 1 << 20

# The core schema of YAML 1.2: `5e-3` is a number; `yes`, `010` and dates are text.
_PATTERNS = {
    NULL_TAG: r"~|null|Null|NULL|",
    BOOL_TAG: r"true|True|TRUE|false|False|FALSE",
    INT_TAG: r"[-+]?(?:0|[1-9][0-9]{0,17})",
    FLOAT_TAG: r"[-+]?(?:\.[0-9]+|[0-9]+\.[0-9]*|[0-9]+(?=[eE]))(?:[eE][-+]?[0-9]+)?"
    r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
}


# libyaml's parser if PyYAML has it: six times as fast. Its composer, written in C, is not used: it crashes on
# brackets nested a hundred thousand deep.
_Parser: Any = import_module("yaml._yaml").CParser if yaml.__with_libyaml__ else None


class _TooManyError(yaml.composer.ComposerError):
    """Error for a text with more values than allowed."""


@dataclass
class Allowance:
    """How many keys and values one or several files may still have; limited, as a node takes a kilobyte."""

    values: int = MOST_VALUES

    def take(self, count: int, source: str, line: int) -> None:
        """Subtract `count` values; the error names `source` and `line`.

        Raises:
            SettingsError: no values are left.
        """
        self.values -= count
        if self.values < 0:
            raise SettingsError(f"{source}:{line}: {TOO_MANY}", what="too-large")


class _Counting(Composer):
    """PyYAML's composer (it makes nodes from parser events), with a limit on the number of values."""

    allowance: Allowance

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose the next node; raise an error once the allowance of keys and values is used up."""
        self.allowance.values -= 1
        if self.allowance.values < 0:
            mark = self.peek_event().start_mark  # type: ignore[attr-defined] # the parser's
            raise _TooManyError(None, None, TOO_MANY, mark)
        return super().compose_node(parent, index)


class _FastLoader(_Counting, Resolver):
    """A loader that combines libyaml's parser, PyYAML's composer and the scalars of YAML 1.2."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012 - PyYAML's own

    def __init__(self, text: str, source: str, allowance: Allowance) -> None:
        self.allowance = allowance
        Composer.__init__(self)
        Resolver.__init__(self)
        stream = io.StringIO(text)
        stream.name = source
        parser = _Parser(stream)
        self.get_event, self.peek_event = parser.get_event, parser.peek_event
        self.check_event = parser.check_event


class _PlainLoader(_Counting, yaml.SafeLoader):
    """A loader with PyYAML's own parser and the scalars of YAML 1.2."""

    yaml_implicit_resolvers = _FastLoader.yaml_implicit_resolvers

    def __init__(self, text: str, source: str, allowance: Allowance) -> None:
        self.allowance = allowance
        super().__init__(text)
        self.name = source


for _tag, _pattern in _PATTERNS.items():
    _FastLoader.add_implicit_resolver(_tag, re.compile(rf"(?:{_pattern})\Z"), None)


def compose(text: str, source: str, allowance: Allowance | None = None) -> yaml.Node:
    """Parse YAML text into nodes; empty text is a null node.

    Args:
        text: the YAML.
        source: the file's name, or `in --set …` for an override; errors start with it.
        allowance: a limit that several texts share; None: the default limit, for this text alone.

    Raises:
        SettingsError: the text is not YAML, has several documents, contains a control character, is nested
            too deeply, or has more keys and values than allowed.
    """
    if source.startswith(OVERRIDE):
        # Arguments are decoded by the locale's encoding, perhaps ASCII, although people type UTF-8.
        with contextlib.suppress(UnicodeError):
            text = os.fsencode(text).decode()
    try:
        node = _nodes(text, source, allowance or Allowance())
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark or _null_mark(source)
        raise SettingsError(
            f"{_place(source, mark.line)}: {_problem(error, text, mark.index)}", what="bad-yaml"
        ) from None
    except yaml.reader.ReaderError as error:
        place = _place(source, text[: error.position].count("\n"))
        raise SettingsError(
            f"{place}: the control character U+{int(error.character):04X}; remove it", what="bad-yaml"
        ) from None
    except RecursionError:
        raise SettingsError(f"{source}: nested too deeply", what="bad-yaml") from None
    return node or yaml.ScalarNode(NULL_TAG, "", _null_mark(source), _null_mark(source))


@contextlib.contextmanager
def unsearched() -> Iterator[None]:
    """Disable garbage collection in the block: it took half of the time, although no node becomes garbage."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


@unsearched()
def _nodes(text: str, source: str, allowance: Allowance) -> yaml.Node | None:
    """Parse a text into nodes; if libyaml fails on a short text, use PyYAML's parser for a detailed error."""
    before = allowance.values
    if _Parser:
        try:
            return _FastLoader(text, source, allowance).get_single_node()
        except (yaml.YAMLError, UnicodeEncodeError) as error:
            if len(text) > SPELT_OUT or isinstance(error, _TooManyError):
                raise
        allowance.values = before
    return _PlainLoader(text, source, allowance).get_single_node()


def _null_mark(source: str) -> yaml.Mark:
    """Return a mark at the first character of a source, for errors and nodes without a position."""
    return yaml.Mark(source, 0, 0, 0, None, 0)


def _problem(error: yaml.MarkedYAMLError, text: str, index: int) -> str:
    line = max(text.rfind("\n", 0, index), text.rfind("\r", 0, index)) + 1
    if re.match(r"[^\S\r\n]*\t", text[line : line + MOST_INDENT]):
        return "indented with a tab; use spaces"
    problem = error.problem or error.context or "unreadable"
    if problem.startswith("but ") and error.context:
        problem = f"{error.context}, {problem}"
    if isinstance(error, _TooManyError):
        return problem
    return f"not valid YAML: {problem}; check indentation, colons and quotes"


def _place(source: str, line: int) -> str:
    return source if source.startswith(OVERRIDE) else f"{source}:{line + 1}"


def place(node: yaml.Node) -> str:
    """Return where a node is, for messages: `file:line`, or the override that contains it."""
    return _place(node.start_mark.name, node.start_mark.line)


def order(node: yaml.Node, first: str) -> tuple[bool, bool, str, int]:
    """Return a node's sort key by position: first the file `first`, then other files, then overrides."""
    name = node.start_mark.name
    return (
        name.startswith(OVERRIDE),
        name != first,
        "" if name.startswith(OVERRIDE) else name,
        node.start_mark.line,
    )


def plain(node: yaml.Node) -> Any:
    """Convert nodes to dict, list, str, int, float, bool and None.

    Raises:
        SettingsError: a repeated key, a key that is no text, an alias inside itself, a `!tag`, or too deep
            nesting.
    """
    try:
        return _plain(node, {}, set())
    except RecursionError:
        raise SettingsError(f"{place(node)}: nested too deeply", what="bad-yaml") from None


def _plain(node: yaml.Node, done: dict[int, object], open_nodes: set[int]) -> object:
    # An aliased node is converted once, so the cost of nested aliases is that of the file's length.
    if id(node) in done:
        return done[id(node)]
    if id(node) in open_nodes:
        raise SettingsError(
            f"{place(node)}: an alias that contains itself; write the value out", what="bad-yaml"
        )
    open_nodes.add(id(node))
    if isinstance(node, yaml.MappingNode):
        value: object = {key: _plain(child, done, open_nodes) for key, child in _checked_items(node)}
    elif isinstance(node, yaml.SequenceNode):
        value = [_plain(child, done, open_nodes) for child in node.value]
    else:
        value = _scalar(node)
    open_nodes.discard(id(node))
    done[id(node)] = value
    return value


def _checked_items(node: yaml.MappingNode) -> Iterator[tuple[str, yaml.Node]]:
    first: dict[str, yaml.Node] = {}
    for key, child in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise SettingsError(
                f"{place(key)}: a key must be a name, not a list or a mapping", what="bad-yaml"
            )
        if key.value in first:
            raise SettingsError(
                f"{place(key)}: '{printable(key.value)}' stands twice, first at {place(first[key.value])}; "
                "keep one",
                what="bad-yaml",
            )
        first[key.value] = key
        yield key.value, child


def _scalar(node: yaml.Node) -> object:
    text = str(node.value)
    try:
        if node.tag == NULL_TAG:
            return None
        if node.tag == BOOL_TAG:
            return {"true": True, "false": False}[text.lower()]
        if node.tag == INT_TAG:
            return int(text)
        if node.tag == FLOAT_TAG:
            return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
    except (ValueError, KeyError):
        raise SettingsError(
            f"{place(node)}: '{printable(text)}' does not fit its tag; remove the tag", what="bad-yaml"
        ) from None
    if node.tag == STR_TAG:
        return text
    raise SettingsError(
        f"{place(node)}: the tag '{printable(node.tag)}' is not used here; remove it", what="bad-yaml"
    )


def scalar(text: str, mark: yaml.Mark) -> yaml.ScalarNode:
    """Make a YAML 1.2 scalar node (a text, a number, ...) from text on one line without quotes."""
    tag = next((tag for tag, pattern in _PATTERNS.items() if re.fullmatch(pattern, text)), STR_TAG)
    return yaml.ScalarNode(tag, text, mark, mark)


def items(node: yaml.Node | None) -> dict[str, yaml.Node]:
    """Return {scalar key: value node} of a mapping node, without other keys; empty for any other node."""
    pairs = node.value if isinstance(node, yaml.MappingNode) else []
    return {key.value: child for key, child in pairs if isinstance(key, yaml.ScalarNode)}


# For mappings searched so far, by identity: key -> the nodes of the key and of its value.
Known = dict[int, dict[str, tuple[yaml.Node, yaml.Node]]]


def find(
    node: yaml.Node, path: tuple[str | int, ...], known: Known | None = None
) -> tuple[yaml.Node, yaml.Node | None]:
    """Find the node at a path.

    A path has keys of mappings and indices of lists; `known` is a cache for look-ups in the same nodes.

    Returns:
        Two nodes. Errors show the line of the first: the key or list entry at the path, or the last one on
        the path that exists. The second is the value at the path; None if the path does not exist.
    """
    known = {} if known is None else known
    anchor, value = node, node
    for part in path:
        if isinstance(part, int) and isinstance(value, yaml.SequenceNode) and part < len(value.value):
            anchor = value = value.value[part]
            continue
        if id(value) not in known:
            pairs = value.value if isinstance(value, yaml.MappingNode) else []
            of_scalars = ((key, child) for key, child in pairs if isinstance(key, yaml.ScalarNode))
            known[id(value)] = {key.value: (key, child) for key, child in of_scalars}
        if part not in known[id(value)]:
            return anchor, None
        anchor, value = known[id(value)][str(part)]
    return anchor, value


def replaced(node: yaml.Node | None, path: tuple[str | int, ...], value: yaml.Node) -> yaml.Node:
    """Return a copy of a node in which `path` leads to `value`; old nodes, and so aliases, are unchanged."""
    if not path:
        return value
    head, tail = path[0], path[1:]
    if isinstance(head, int):
        assert isinstance(node, yaml.SequenceNode), "paths lead through entries that exist"
        entries = [replaced(child, tail, value) if i == head else child for i, child in enumerate(node.value)]
        return yaml.SequenceNode(node.tag, entries, node.start_mark, node.end_mark)
    pairs = list(node.value) if isinstance(node, yaml.MappingNode) else []
    old = {key.value: (key, child) for key, child in pairs if isinstance(key, yaml.ScalarNode)}
    new_key = yaml.ScalarNode(STR_TAG, head, value.start_mark, value.end_mark)
    key, child = old.get(head, (new_key, None))
    new_pair = (key if tail and head in old else new_key, replaced(child, tail, value))
    pairs = [new_pair if pair[0] is key else pair for pair in pairs] if head in old else [*pairs, new_pair]
    start, end = (node.start_mark, node.end_mark) if node else (value.start_mark, value.end_mark)
    return yaml.MappingNode(MAP_TAG, pairs, start, end)
