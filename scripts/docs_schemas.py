"""Write the schemas that a release has, beside their module in the package, and docs/scores.schema.json.

.venv/bin/python scripts/docs_schemas.py
"""

from dataclasses import fields
from pathlib import Path
from typing import Any

from kinectbench.core.artefacts.score_figures import (
    SURFACE_METRICS,
    ByThreshold,
    InSpace,
    Resolution,
    Unknown,
    fields_of,
)
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.storage import pretty_json
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
from kinectbench.release.publish.schemas import JSON_FILES, PAIR_SCHEMA, TABLE_SCHEMA, targets_schema

ROOT = Path(__file__).parents[1]
PACKAGED = ROOT / "kinectbench" / "release" / "publish" / SCHEMAS
SCORES = ROOT / "docs" / "scores.schema.json"
DIALECT = "https://json-schema.org/draft/2020-12/schema"

# Keys that tables of the first versions lack.
LATER_KEYS = (
    *("threshold_source_by_category", "threshold_objects", "validation", "missing_as_empty", "marks"),
    *("verified", "run_sha256", "rows_file"),
    *("notes", "extremes", "iou_by_threshold", "hashes", "baseline", "intervals", "categories"),
    "all_unknown_pairs",
)
LATER_AVERAGES = (
    *("base_rate_source", "truth_estimated_iou", "truth_estimated_iou_low", "truth_estimated_iou_high"),
    *("truth_repeatability_iou", "truth_unknown_share"),
)
LATER_ROWS = (
    *SURFACE_METRICS,
    *fields_of(Resolution),
    *fields_of(Unknown),
    *fields_of(ByThreshold),
    *fields_of(InSpace),
)
LATER = {*LATER_KEYS, *LATER_AVERAGES, *LATER_ROWS}


def schema_texts() -> dict[str, str]:
    """{file name: text} of the schemas that a release has, made from the models."""
    schemas = {
        f"{name}.schema.json": {"$schema": DIALECT, "$comment": files}
        | model.model_json_schema(by_alias=True)
        for name, (files, model) in JSON_FILES.items()
    }
    schemas |= {TABLE_SCHEMA: targets_schema(), PAIR_SCHEMA: pair_schema()}
    return {name: pretty_json(schema) for name, schema in schemas.items()}


def pair_schema() -> dict[str, object]:
    """The schema of a pair file: name, dtype, shape and description of each array."""
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


def scores_schema() -> dict[str, Any]:
    """A JSON schema that the scores.json of every version satisfies."""
    schema = ScoreTable.model_json_schema(by_alias=True)
    for part in (
        schema,
        *(schema["$defs"][name] for name in ("ScoreRow", "CategoryAverages", "OverallAverages")),
    ):
        part["required"] = [key for key in part["properties"] if key not in LATER]
    return {"$schema": DIALECT, **schema}


def main() -> None:
    """Write all schemas."""
    for name, text in schema_texts().items():
        (PACKAGED / name).write_text(text, encoding="utf-8")
    SCORES.write_text(pretty_json(scores_schema()), encoding="utf-8")


if __name__ == "__main__":
    main()
