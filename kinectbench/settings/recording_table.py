"""Read a table of recordings, CSV or Parquet, as YAML nodes: a row is a recording, a column is a key."""

import io
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import accumulate
from types import ModuleType
from typing import TYPE_CHECKING, Any, get_origin

import yaml

from kinectbench.core import UNPACKED_BYTES, SettingsError, csv_rows, printable
from kinectbench.settings import yaml_nodes
from kinectbench.settings.base import Settings
from kinectbench.settings.models import RecordingSettings
from kinectbench.settings.reading import MOST_BYTES, as_text
from kinectbench.settings.words import model_of, suggestion, without_none

if TYPE_CHECKING:
    from pyarrow import Scalar
    from pyarrow.parquet import ParquetFile

CSV, PARQUET = ".csv", ".parquet"
ENDINGS = (CSV, PARQUET)
# Largest number of rows of a Parquet file, which may hold a million in a few bytes (ten times the largest
# benchmark).
MOST_ROWS = 100_000
INSTALL = "reading it needs the package pyarrow; run `pip install 'kinectbench[tables]'`, or save it as CSV"


def table_entries(content: bytes, source: str, allowance: yaml_nodes.Allowance) -> list[yaml.Node]:
    """Read the rows of a table as entries of `recordings:`; empty cells are skipped.

    A column has the name of its key in benchmark.yaml, with dots for nested keys, such as `camera.fx`. A cell
    holds the value as in benchmark.yaml: a text (without quotes), a number, true or false, or a list of
    numbers such as `[0, 0, 1, 0]`.

    Args:
        content: bytes of the file.
        source: name of the file, whose suffix gives the format. In messages, the header is line 1.
        allowance: limit on the values of all files together.

    Raises:
        SettingsError: the file is not a valid table, or a column is no key of a recording.
    """
    is_csv = source.lower().endswith(CSV)
    header, rows = _of_csv(content, source) if is_csv else _of_parquet(content, source)
    _check_header(header, source)
    fields = [tuple(name.split(".")) for name in header]
    entries = []
    for line, row in rows:
        if len(row) > len(header):
            raise SettingsError(
                f"{source}:{line}: {len(row)} cells under {len(header)} columns; put a cell with a comma "
                "into double quotes"
            )
        cells = {key: cell for key, cell in zip(fields, row, strict=False) if cell.strip()}
        if cells:
            allowance.take(1 + 2 * len(cells), source, line)
            entries.append(_entry(cells, yaml.Mark(source, 0, line - 1, 0, None, 0)))
    return entries


def columns() -> dict[str, object]:
    """Return {name of each column that a table may have: type of its values}, in the order of the models."""
    return {".".join(key): annotation for key, annotation in _leaves(RecordingSettings)}


def _leaves(model: type[Settings], above: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], object]]:
    for name, field in model.model_fields.items():
        inner = model_of(field.annotation)
        if inner is None:
            yield (*above, name), without_none(field.annotation)
        else:
            yield from _leaves(inner, (*above, name))


def _of_csv(content: bytes, source: str) -> tuple[list[str], Iterator[tuple[int, list[str]]]]:
    """Read the header of a CSV file, and each row with its line number."""
    try:
        rows = csv_rows(as_text(content, source))
    except ValueError as error:
        raise SettingsError(f"{source}: no CSV table: {error}") from None
    if not rows:
        raise SettingsError(f"{source}: an empty file; its first line names the columns: id,path,category")
    # A quoted cell may contain line breaks.
    lines = accumulate((1 + sum(cell.count("\n") for cell in row) for row in rows), initial=1)
    numbered = zip(lines, rows, strict=False)
    _, header = next(numbered)
    return [name.strip() for name in header], numbered


def _of_parquet(content: bytes, source: str) -> tuple[list[str], Iterator[tuple[int, list[str]]]]:
    """Read a Parquet file: the header, and each row with the line number that it would have in a CSV file."""
    try:
        import pyarrow as arrow
        from pyarrow import parquet
    except ImportError as error:
        raise SettingsError(f"{source}: {INSTALL}", what="no-package") from error
    try:
        file = parquet.ParquetFile(io.BytesIO(content))
        _check_parquet(file, source)
        names = [str(name) for name in file.schema_arrow.names]
        # Parquet stores repeated text once; its size in all rows is checked before the values are read.
        schema = file.schema_arrow
        is_text = (arrow.types.is_string, arrow.types.is_large_string)
        texts = [
            name
            for name, kind in zip(names, schema.types, strict=True)
            if any(is_it(kind) for is_it in is_text)
        ]
        file = parquet.ParquetFile(io.BytesIO(content), read_dictionary=texts)
        columns = [_cells(column, source) for column in file.read(use_threads=False).columns]
    except (arrow.ArrowException, OSError, ValueError) as error:
        raise SettingsError(f"{source}: no Parquet table: {printable(str(error))}") from None
    return names, enumerate((list(row) for row in zip(*columns, strict=True)), start=2)


def _check_parquet(file: "ParquetFile", source: str) -> None:
    """Check a Parquet file's metadata before its values are read."""
    from pyarrow import types

    metadata, schema = file.metadata, file.schema_arrow
    _check_header([str(name) for name in schema.names], source)
    if metadata.num_rows > MOST_ROWS:
        raise SettingsError(
            f"{source}: {metadata.num_rows} rows; at most {MOST_ROWS} may be there", what="too-large"
        )
    for name, kind in zip(schema.names, schema.types, strict=True):
        is_list = types.is_list(kind) or types.is_large_list(kind)
        inner = kind.value_type if is_list or types.is_dictionary(kind) else kind
        texts = () if is_list else (types.is_string, types.is_large_string)
        if not any(is_it(inner) for is_it in (*texts, *_numbers(types))):
            raise SettingsError(
                f"{source}: the column '{name}' holds {printable(str(kind))}; wanted text, numbers, truth "
                "values or lists of numbers"
            )
    chunks = (
        metadata.row_group(group).column(column)
        for group in range(metadata.num_row_groups)
        for column in range(metadata.num_columns)
    )
    unpacked = sum(chunk.total_uncompressed_size + 8 * chunk.num_values for chunk in chunks)
    if unpacked > UNPACKED_BYTES:
        raise SettingsError(
            f"{source}: unpacks to {unpacked} bytes; at most {UNPACKED_BYTES} may be there", what="too-large"
        )


def _numbers(types: ModuleType) -> tuple[Callable[[object], bool], ...]:
    return types.is_integer, types.is_floating, types.is_boolean, types.is_null


def _cells(column: "Iterable[Scalar]", source: str) -> list[str]:
    """Convert a Parquet column to the texts of CSV cells; refuse more than `MOST_BYTES` characters."""
    cells, left = [], MOST_BYTES
    for value in column:
        cells.append(_cell(value.as_py()))
        left -= len(cells[-1])
        if left < 0:
            raise SettingsError(f"{source}: a column of more than {MOST_BYTES} characters", what="too-large")
    return cells


def _cell(value: object) -> str:
    """Convert a value to the text of a CSV cell."""
    if value is None or value != value:  # pandas writes NaN for an empty cell
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"[{', '.join(_cell(each) for each in value)}]"
    return repr(value) if isinstance(value, float) else str(value)


def _check_header(header: Sequence[str], source: str) -> None:
    known = columns()
    for name, times in Counter(header).items():
        if times > 1:
            raise SettingsError(f"{source}:1: the column '{printable(name)}' stands {times} times; keep one")
        if name in known:
            continue
        if inner := [key for key in known if key.startswith(f"{name}.")]:
            hint = f"write a column for each of {', '.join(inner)}"
        elif ";" in name or "\t" in name:
            hint = "columns are separated by commas"
        else:
            hint = suggestion(name, list(known))
        raise SettingsError(f"{source}:1: '{printable(name)}' is no column of recordings; {hint}")


def _entry(cells: Mapping[tuple[str, ...], str], mark: yaml.Mark) -> yaml.Node:
    """Make a mapping node from the cells of a row."""
    known = _KINDS
    entry: dict[str, Any] = {}
    for key, cell in cells.items():
        inner = entry
        for part in key[:-1]:
            inner = inner.setdefault(part, {})
        inner[key[-1]] = _value(cell.strip(), known[key], mark)
    return _mapping(entry, mark)


def _mapping(entry: Mapping[str, object], mark: yaml.Mark) -> yaml.Node:
    pairs = [
        (
            yaml.ScalarNode(yaml_nodes.STR_TAG, key, mark, mark),
            _mapping(value, mark) if isinstance(value, dict) else value,
        )
        for key, value in entry.items()
    ]
    return yaml.MappingNode(yaml_nodes.MAP_TAG, pairs, mark, mark)


def _value(cell: str, is_text: bool, mark: yaml.Mark) -> yaml.Node:
    """Make a node at `mark` from a cell: a text if `is_text`, else the value that YAML would read from it."""
    if is_text:
        return yaml.ScalarNode(yaml_nodes.STR_TAG, cell, mark, mark)
    if cell.startswith("[") and cell.endswith("]"):
        parts = [yaml_nodes.scalar(part.strip(), mark) for part in cell[1:-1].split(",")]
        return yaml.SequenceNode(yaml_nodes.SEQ_TAG, parts, mark, mark)
    return yaml_nodes.scalar(cell, mark)


def _is_text(annotation: object) -> bool:
    """Whether cells of this type are always text, even if they look like a number, as ids may do."""
    return annotation not in (int, float, bool) and get_origin(annotation) is not tuple


_KINDS = {key: _is_text(annotation) for key, annotation in _leaves(RecordingSettings)}
