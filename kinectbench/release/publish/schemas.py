"""Schemas of a release's files, for readers without this package.

The published schemas are stored in `schemas/` beside this module, so that the bytes of a release do not
depend on the version of pydantic; a test compares them with the models. `schemas/` also has the schema of
scores.json, which is not published. After a change of the models, run `python -m
kinectbench.release.publish.schemas` in a checkout: it writes all schemas, and docs/scores.schema.json.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from fnmatch import fnmatchcase
from importlib import resources
from pathlib import Path

from pydantic import ValidationError

from kinectbench.core import pretty_json, printable, pydantic_message
from kinectbench.core.artefacts.benchmark import ReleaseInfo
from kinectbench.core.artefacts.object import FloorFile, QualityFile
from kinectbench.core.artefacts.provenance import Lineage, Privacy, ThresholdsFile
from kinectbench.core.artefacts.scores import scores_schema
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
from kinectbench.core.voxels.pair_file import (
    FORMAT_VERSION,
    INPUT_KEYS,
    MATRIX_SIDES,
    NUMBERS,
    PACKED_SHAPES,
    TEXTS,
    Pair,
)
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
SCORES_SCHEMA = "scores.schema.json"
# Most characters of an error message, and most errors that are reported for one file.
MOST_CHARACTERS, MOST_FAULTS = 200, 50
DIALECT = "https://json-schema.org/draft/2020-12/schema"
PATTERNS = {"view": "^[0-9]{3,6}$", "file": r"^pairs/[^/]+/[0-9]+\.npz$", "sha256": "^[0-9a-f]{64}$"}


def schema_texts() -> dict[str, str]:
    """Make every schema from the models: return {file name: text}."""
    schemas = {
        f"{name}.schema.json": {"$schema": DIALECT, "$comment": files}
        | model.model_json_schema(by_alias=True)
        for name, (files, model) in JSON_FILES.items()
    }
    schemas |= {TABLE_SCHEMA: _table(), PAIR_SCHEMA: _pair(), SCORES_SCHEMA: scores_schema()}
    return {name: pretty_json(schema) for name, schema in schemas.items()}


def write_schemas(folder: Path, columns: Sequence[str]) -> None:
    """Write the schemas of all files that the release folder has so far, and that of benchmark.json.

    Args:
        folder: the release's folder; benchmark.json is written later.
        columns: columns of the release's targets.csv.
    """
    (folder / SCHEMAS).mkdir()
    stored = resources.files("kinectbench.release.publish").joinpath(SCHEMAS)
    written = [
        name for name, (files, _) in JSON_FILES.items() if name == "benchmark" or any(folder.glob(files))
    ]
    for name in (*(f"{name}.schema.json" for name in written), TABLE_SCHEMA, PAIR_SCHEMA):
        (folder / SCHEMAS / name).write_bytes(stored.joinpath(name).read_bytes())
    if TRUTH_COLUMN in columns:
        (folder / SCHEMAS / TABLE_SCHEMA).write_text(pretty_json(_table(columns)), encoding="utf-8")


def schema_problems(name: str, text: str) -> Iterator[str]:
    """Yield a message for each schema violation of a release's JSON file; nothing if it has no schema.

    Args:
        name: the file's name, relative to the release.
        text: the file's content.
    """
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


def _table(columns: Iterable[str] = COLUMNS) -> dict[str, object]:
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


def _pair() -> dict[str, object]:
    """Return the schema of a pair file: name, dtype, shape and description of each array."""
    keys = []
    about = {field.name: field.metadata["description"] for field in fields(Pair)}
    about["format_version"] = str(FORMAT_VERSION)
    for name in about:
        row: dict[str, object] = {"name": name, "input": name in (*INPUT_KEYS, "format_version")}
        if name in PACKED_SHAPES:
            row |= {"dtype": "uint8", "shape": list(PACKED_SHAPES[name]), "packed": True}
        elif name in MATRIX_SIDES:
            row |= {"dtype": "float64", "shape": [MATRIX_SIDES[name]] * 2}
        else:
            dtype = "float64" if name in NUMBERS else "text" if name in TEXTS else "integer"
            row |= {"dtype": dtype, "shape": []}
        keys.append(row | {"description": about[name]})
    packed = "bits along the last axis, most significant first: numpy.unpackbits(array, axis=-1)"
    return {
        "$comment": "pairs/*/*.npz; of held-back splits the keys with input only",
        "packed": packed,
        "keys": keys,
    }


if __name__ == "__main__":
    for file_name, file_text in schema_texts().items():
        (Path(__file__).with_name(SCHEMAS) / file_name).write_text(file_text, encoding="utf-8")
    (Path(__file__).parents[3] / "docs" / SCORES_SCHEMA).write_text(
        schema_texts()[SCORES_SCHEMA], encoding="utf-8"
    )
