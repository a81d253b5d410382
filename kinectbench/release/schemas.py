"""The schemas of a release: what every file holds, for people and programs that do not have this package.

They lie in `schemas/` beside this file as they are published, so that they do not depend on the version of
pydantic; a test makes them anew from the models and compares. `python -m kinectbench.release.schemas` writes
them after a change of the models.
"""

from collections.abc import Iterator
from dataclasses import fields
from fnmatch import fnmatchcase
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from kinectbench.release.layout import SCHEMAS, TARGETS_CSV
from kinectbench.release.release import COLUMNS, SPLITS
from kinectbench.release.schema_models import JSON_FILES
from kinectbench.voxels.pair_file import NUMBERS, PACKED_SHAPES, TEXTS, Pair
from kinectbench.voxels.pair_input import INPUT_KEYS
from kinectbench.workspace import pretty_json

DIALECT = "https://json-schema.org/draft/2020-12/schema"
MATRICES = {"T_world_grid": 4, "T_world_camera": 4, "K": 3}
PATTERNS = {"view": "^[0-9]{3,6}$", "file": r"^pairs/[^/]+/[0-9]+\.npz$", "sha256": "^[0-9a-f]{64}$"}
ABOUT = {
    "partial": "the view's depth on the object, the input: partial_256 reduced by partial_rule",
    "partial_256": "the same before reduction",
    "full": "the solid shape, the truth",
    "shell": "its surface only",
    "known": "the truth is trusted there",
    "seen": "in the view's frustum and not behind its depth",
    "T_world_grid": "cell (i, j, k) has its centre at T_world_grid @ ((i+.5, j+.5, k+.5) * voxel_size_m)",
    "T_world_camera": "camera to world, metres",
    "K": "intrinsics, pixels; pixel centres are integers",
    "voxel_size_m": "edge of a cell of the 256^3 grid, metres",
    "surface_sigma_m": "standard deviation of the truth's surface, metres",
    "framing": "object or view",
    "partial_rule": "any or majority",
    "occupancy_rule": "winding or six-rays; files without it: winding",
    "format_version": "1",
}


def schema_texts() -> dict[str, str]:
    """Every schema as a text by its file's name, made from the models."""
    texts = {
        f"{name}.schema.json": pretty_json(
            {"$schema": DIALECT, "$comment": files} | model.model_json_schema()
        )
        for name, (files, model) in JSON_FILES.items()
    }
    texts["targets.csv.json"] = pretty_json(_table())
    texts["pair.npz.json"] = pretty_json(_pair())
    return texts


def write_schemas(folder: Path) -> None:
    """Write the schemas of the files that a release holds so far; benchmark.json comes last."""
    (folder / SCHEMAS).mkdir()
    for entry in sorted(resources.files("kinectbench.release").joinpath(SCHEMAS).iterdir(), key=str):
        model = JSON_FILES.get(entry.name.removesuffix(".schema.json"))
        if model is None or entry.name == "benchmark.schema.json" or any(folder.glob(model[0])):
            (folder / SCHEMAS / entry.name).write_bytes(entry.read_bytes())


def schema_problems(name: str, text: str) -> Iterator[str]:
    """What is wrong with a JSON file of a release by its schema, a clause each; nothing if it has none.

    Args:
        name: of the file, relative to the release.
        text: its content.
    """
    for files, model in JSON_FILES.values():
        if fnmatchcase(name, files):
            try:
                model.model_validate_json(text)
            except ValidationError as error:
                for fault in error.errors():
                    where = ".".join(str(part) for part in fault["loc"])
                    yield f"'{where}': {fault['msg']}" if where else fault["msg"]


def _table() -> dict[str, Any]:
    """A table schema (https://specs.frictionlessdata.io/table-schema/) of targets.csv."""
    rows = []
    for column in COLUMNS:
        constraints: dict[str, Any] = {"required": True}
        if column in PATTERNS:
            constraints["pattern"] = PATTERNS[column]
        if column == "split":
            constraints["enum"] = list(SPLITS)
        rows.append({"name": column, "type": "string", "constraints": constraints})
    return {"$comment": f"{TARGETS_CSV}, targets/*.csv", "fields": rows, "primaryKey": ["recording", "view"]}


def _pair() -> dict[str, Any]:
    """The keys of a pair file."""
    keys = []
    for name in (*(field.name for field in fields(Pair)), "format_version"):
        row: dict[str, Any] = {"name": name, "input": name in (*INPUT_KEYS, "format_version")}
        if name in PACKED_SHAPES:
            row |= {"dtype": "uint8", "shape": list(PACKED_SHAPES[name]), "packed": True}
        elif name in MATRICES:
            row |= {"dtype": "float64", "shape": [MATRICES[name]] * 2}
        else:
            dtype = "float64" if name in NUMBERS else "text" if name in TEXTS else "integer"
            row |= {"dtype": dtype, "shape": []}
        keys.append(row | {"description": ABOUT[name]})
    about = "bits along the last axis, most significant first: numpy.unpackbits(array, axis=-1)"
    return {
        "$comment": "pairs/*/*.npz; of held-back splits the keys with input only",
        "packed": about,
        "keys": keys,
    }


if __name__ == "__main__":
    for file_name, file_text in schema_texts().items():
        (Path(__file__).with_name(SCHEMAS) / file_name).write_text(file_text)
