"""Schemas of a release's files, for readers without this package.

They are stored in `schemas/` beside this module, so that the bytes of a release do not depend on the version
of pydantic. `scripts/docs_schemas.py` generates them from the models, and a test compares them.
"""

from collections.abc import Iterable, Iterator, Sequence
from fnmatch import fnmatchcase
from importlib import resources
from pathlib import Path

from pydantic import ValidationError

from kinectbench.core import pretty_json, printable, pydantic_message, write_below
from kinectbench.core.artefacts.benchmark import ReleaseInfo
from kinectbench.core.artefacts.object import FloorFile, QualityFile
from kinectbench.core.artefacts.provenance import Lineage, Privacy, ThresholdsFile
from kinectbench.core.artefacts.stored import Stored
from kinectbench.core.artefacts.targets import (
    COLUMNS,
    NUMBER_COLUMNS,
    SPLITS,
    TARGETS_CSV,
    TRUTH_COLUMN,
    TRUTHS,
    Splits,
)
from kinectbench.core.artefacts.views import ViewsFile
from kinectbench.release.contents import SCHEMAS

# {schema's name: (files of the release, model)}.
JSON_FILES: dict[str, tuple[str, type[Stored]]] = {
    "benchmark": ("benchmark.json", ReleaseInfo),
    "splits": ("splits.json", Splits),
    "views": ("views/*/views.json", ViewsFile),
    "floor": ("objects/*/floor.json", FloorFile),
    "quality": ("objects/*/quality.json", QualityFile),
    "lineage": ("lineage.json", Lineage),
    "privacy": ("privacy.json", Privacy),
    "thresholds": ("thresholds.json", ThresholdsFile),
}
TABLE_SCHEMA = "targets.csv.json"
PAIR_SCHEMA = "pair.npz.json"
# Largest number of characters of an error message, and of errors that are reported for one file.
MOST_CHARACTERS, MOST_FAULTS = 200, 50
PATTERNS = {"view": "^[0-9]{3,6}$", "file": r"^pairs/[^/]+/[0-9]+\.npz$", "sha256": "^[0-9a-f]{64}$"}


def schema_texts(names: Iterable[str], columns: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield (file, text) of the schemas of a release with files `names` and these columns of targets.csv."""
    stored = resources.files("kinectbench.release.publish").joinpath(SCHEMAS)
    present = list(names)
    for schema, (files, _) in JSON_FILES.items():
        if schema == "benchmark" or any(fnmatchcase(name, files) for name in present):
            name = f"{schema}.schema.json"
            yield f"{SCHEMAS}/{name}", stored.joinpath(name).read_text(encoding="utf-8")
    for name in (TABLE_SCHEMA, PAIR_SCHEMA):
        text = stored.joinpath(name).read_text(encoding="utf-8")
        if name == TABLE_SCHEMA and TRUTH_COLUMN in columns:
            text = pretty_json(targets_schema(columns))
        yield f"{SCHEMAS}/{name}", text


def write_schemas(folder: Path, columns: Sequence[str]) -> None:
    """Write the schemas of all files in the release folder, and of benchmark.json, which is written later."""
    names = [path.relative_to(folder).as_posix() for path in folder.rglob("*.json")]
    for name, text in schema_texts(names, columns):
        write_below(folder / name, text.encode())


def schema_problems(name: str, text: str) -> Iterator[str]:
    """Yield a message for each schema violation of a release's JSON file; nothing if it has no schema."""
    for files, model in JSON_FILES.values():
        if fnmatchcase(name, files):
            try:
                model.validated(text)
            except ValidationError as error:
                if error.error_count() > MOST_FAULTS:
                    yield f"{error.error_count()} values are not as they should be"
                    return
                for fault in error.errors():
                    where = printable(".".join(str(part) for part in fault["loc"]))
                    problem = printable(pydantic_message(fault), MOST_CHARACTERS)
                    yield f"'{where}': {problem}" if where else problem


def targets_schema(columns: Iterable[str] = COLUMNS) -> dict[str, object]:
    """Return the table schema (https://datapackage.org/standard/table-schema/) of targets.csv."""
    rows: list[dict[str, object]] = []
    for column in columns:
        if column == TRUTH_COLUMN:  # the table of a split without such a truth lacks it
            rows.append({"name": column, "type": "string", "constraints": {"enum": [*filter(None, TRUTHS)]}})
            continue
        if column in NUMBER_COLUMNS:
            rows.append({"name": column, "type": "number", "constraints": {"minimum": 0, "maximum": 1}})
            continue
        constraints: dict[str, object] = {"required": True}
        if column in PATTERNS:
            constraints["pattern"] = PATTERNS[column]
        if column == "split":
            constraints["enum"] = list(SPLITS)
        rows.append({"name": column, "type": "string", "constraints": constraints})
    fewer = {"fieldsMatch": "superset"} if TRUTH_COLUMN in columns else {}
    comment = f"{TARGETS_CSV}, targets/*.csv"
    return {"$comment": comment, **fewer, "fields": rows, "primaryKey": ["recording", "view"]}
