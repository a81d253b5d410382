"""Read scores.json: a stranger's file as far as this goes, and older ones without the newer keys."""

from collections.abc import Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

from kinectbench.errors import ReleaseError, SettingsError
from kinectbench.release.metadata import strict_json
from kinectbench.scoring.table import ScoreRow, ScoreTable

SCORES_JSON = "scores.json"
BASELINES_FOLDER = "baselines"  # in a folder of scores: what `score` adds to every table
MAX_BYTES = 1 << 30
NUMBERS = (int, float)


def read_scores(path: Path) -> ScoreTable:
    """Read one scores.json.

    Raises:
        SettingsError: it is missing, too large, or not a table of scores.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise SettingsError(f"{path}: larger than any table of scores; give a scores.json")
        content = strict_json(path.read_text(encoding="utf-8"), str(path))
    except (OSError, UnicodeDecodeError, ReleaseError) as error:
        raise SettingsError(f"{path}: cannot be read as scores ({error}); score again") from error
    try:
        rows = tuple(_row(row) for row in content["rows"])
        known = {name: content[name] for name in _names(ScoreTable, content)}
        table = ScoreTable(**{**known, "rows": rows, **_tuples(content)})
        if not isinstance(table.method, str) or not isinstance(table.benchmark_sha256, str):
            raise TypeError("method and benchmark_sha256 must be texts")
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise SettingsError(f"{path}: not a table of scores ({error}); score again") from error
    return table


def find_scores(paths: Sequence[Path]) -> list[Path]:
    """The scores.json of each path: a file, one method's folder, or a folder of methods.

    Raises:
        SettingsError: there is none.
    """
    found = []
    for path in paths:
        if path.is_dir():
            here = [path / SCORES_JSON] if (path / SCORES_JSON).is_file() else []
            below = here or sorted(path.glob(f"*/{SCORES_JSON}"))
            if not below:
                raise SettingsError(f"{path}: no scores.json there; run `kinectbench score` first")
            found += below
        else:
            found.append(path)
    return found


def _names(kind: type[ScoreTable] | type[ScoreRow], content: dict[str, Any]) -> list[str]:
    """The fields that are there; one that must be and is not is a KeyError."""
    names = []
    for field in fields(kind):
        if field.name in content:
            names.append(field.name)
        elif field.default is MISSING and field.default_factory is MISSING:
            raise KeyError(field.name)
    return names


def _row(content: dict[str, Any]) -> ScoreRow:
    row = ScoreRow(**{name: content[name] for name in _names(ScoreRow, content)})
    for field in fields(ScoreRow):
        value, text = getattr(row, field.name), field.type is str
        if not isinstance(value, str if text else NUMBERS) and not (value is None and field.default is None):
            raise TypeError(f"'{field.name}' is {value!r}")
    return row


def _tuples(content: dict[str, Any]) -> dict[str, Any]:
    """Lists of JSON as the tuples that they were."""
    return {name: tuple(content.get(name, ())) for name in ("failures", "warnings", "notes")}
