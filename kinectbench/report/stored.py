"""What the stages left on disk, read and checked: missing is None, damaged is an error."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.errors import StorageError
from kinectbench.geometry import rigid, rotation_from_quaternion_xyzw

Float64 = NDArray[np.float64]

VIEW_NAME = re.compile(r"[0-9]{1,6}")
UNITS = {"_mm": "mm", "_m": "m", "_s": "s", "_ns": "ns", "_px": "px", "_rad": "rad", "_deg": "deg"}
MAX_LISTED = 6
HIDDEN = ("verdict", "warnings", "format_version")
# First words of verdicts.
GOOD = {"good", "ok", "passed", "healthy", "usable"}
DOUBTFUL = {"coarse", "could", "doubtful", "drift", "fair"}
BAD = {"bad", "failed", "not", "poor", "unusable"}


@dataclass(frozen=True)
class Figures:
    """The figures of one stage, ready to be shown.

    Attributes:
        verdict: the stage's own word, or "".
        tone: "good", "warn", "bad" or "plain": how the verdict is coloured.
        warnings: the stage's warnings.
        rows: (name, value) of every other figure.
        values: the JSON object itself.
    """

    verdict: str
    tone: str
    warnings: tuple[str, ...]
    rows: tuple[tuple[str, str], ...]
    values: Mapping[str, Any]

    @property
    def brief(self) -> str:
        """The verdict up to its first colon."""
        return self.verdict.partition(":")[0]


def read_json(path: Path) -> dict[str, Any] | None:
    """Read a JSON object; None if there is no such file.

    Raises:
        StorageError: the file is not a JSON object.
    """
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise StorageError(f"{path}: not readable as JSON ({error}); build this recording again") from error
    if not isinstance(value, dict):
        raise StorageError(f"{path}: holds no JSON object; build this recording again")
    return value


def rows_of(path: Path, value: Mapping[str, Any], key: str) -> list[dict[str, Any]]:
    """The list of objects under a key, each with a `view`: an index in digits, zero-padded here.

    Raises:
        StorageError: it is something else.
    """
    rows = value.get(key, [])
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise StorageError(f"{path}: '{key}' is not a list of objects; build this recording again")
    for row in rows:
        # A view's name becomes part of a path: only digits may.
        if not VIEW_NAME.fullmatch(str(row.get("view"))):
            raise StorageError(f"{path}: '{key}' names a view {row.get('view')!r}, which is no index")
    return [{**row, "view": str(row["view"]).zfill(3)} for row in rows]


def read_trajectory(path: Path) -> Float64 | None:
    """Read a TUM trajectory: (n, 4, 4) T_world_camera, n > 0; None if there is no such file.

    Raises:
        StorageError: a line is not eight finite numbers, or there is none.
    """
    if not path.exists():
        return None
    transforms = []
    for number, line in enumerate(path.read_text(errors="replace").splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            values = np.array([float(word) for word in line.split()])
        except ValueError:
            values = np.array([np.nan])
        if len(values) != 8 or not np.isfinite(values).all() or not np.any(values[4:]):
            raise StorageError(
                f"{path}, line {number}: not 't tx ty tz qx qy qz qw'; track this recording again"
            )
        transforms.append(rigid(rotation_from_quaternion_xyzw(values[4:]), values[1:4]))
    if not transforms:
        raise StorageError(f"{path}: holds no camera; track it again")
    return np.stack(transforms)


def read_floor(path: Path) -> Float64 | None:
    """Read `T_floor_world` (4, 4) of floor.json; None if there is no such file.

    Raises:
        StorageError: it is not a finite 4x4 matrix.
    """
    value = read_json(path)
    if value is None:
        return None
    try:
        T_floor_world = np.array(value["T_floor_world"], dtype=np.float64)
    except (KeyError, TypeError, ValueError):
        T_floor_world = np.zeros(0)
    if T_floor_world.shape != (4, 4) or not np.isfinite(T_floor_world).all():
        raise StorageError(f"{path}: 'T_floor_world' is not a finite 4x4 matrix; build the object again")
    return T_floor_world


def read_figures(path: Path) -> Figures | None:
    """Read a stage's health or quality figures; None if there is no such file."""
    values = read_json(path)
    if values is None:
        return None
    warnings = as_lines(values.get("warnings"))
    verdict = "" if values.get("verdict") is None else str(values["verdict"])
    rest = {key: value for key, value in values.items() if key not in HIDDEN}
    return Figures(verdict, _tone(verdict, bool(warnings)), warnings, tuple(_rows(rest, "")), values)


def _tone(verdict: str, warned: bool) -> str:
    words = re.findall(r"[a-z]+", verdict.lower())
    first = words[0] if words else ""
    if first in BAD:
        return "bad"
    if warned or first in DOUBTFUL:
        return "warn"
    return "good" if first in GOOD else "plain"


def as_lines(value: Any) -> tuple[str, ...]:
    """Whatever a stage wrote as its list of messages, as lines of text."""
    if value is None or value == "":
        return ()
    if isinstance(value, Mapping):
        return tuple(f"{key}: {text_of(item)}" for key, item in value.items())
    items = value if isinstance(value, list | tuple) else [value]
    return tuple(
        ", ".join(f"{key} {text_of(part)}" for key, part in item.items())
        if isinstance(item, Mapping)
        else str(item)
        for item in items
    )


def text_of(value: Any) -> str:
    """A JSON value in a few characters."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        plain = not any(isinstance(item, list | tuple | Mapping) for item in value)
        if plain and len(value) <= MAX_LISTED:
            return ", ".join(text_of(item) for item in value) or "none"
        return f"{len(value)} entries"
    return str(value)


def _rows(values: Mapping[str, Any], prefix: str) -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            rows += _rows(value, f"{prefix}{key} · ")
        elif key == "rejected" and isinstance(value, list):
            rows.append((f"{prefix}rejected", str(len(value))))
        elif not (isinstance(value, list) and any(isinstance(item, Mapping) for item in value)):
            # Lists of objects, one for each frame say, are for machines.
            rows.append((prefix + _name(str(key)), text_of(value)))
    return rows


def _name(key: str) -> str:
    """A key for people: `median_residual_m` is `median residual (m)`."""
    for suffix, unit in UNITS.items():
        if key.endswith(suffix) and len(key) > len(suffix):
            return f"{key[: -len(suffix)].replace('_', ' ')} ({unit})"
    return key.replace("_", " ")
