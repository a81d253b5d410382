"""Write docs/keys.md, a table of keys for each file, from the models that read and write the files.

    .venv/bin/python scripts/docs_format.py

What a model cannot say is prose in docs/format.md, which names each table.
"""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from kinectbench.core.artefacts.benchmark import PublishStamp, ReleaseInfo
from kinectbench.core.artefacts.manifest import Failed, Manifest
from kinectbench.core.artefacts.method import MethodFile, TrainingFile
from kinectbench.core.artefacts.object import CandidatesFile, FloorFile, QualityFile
from kinectbench.core.artefacts.provenance import Lineage, Privacy, ThresholdsFile
from kinectbench.core.artefacts.reconstruction import ReconstructionFile
from kinectbench.core.artefacts.reference import ReferenceFile
from kinectbench.core.artefacts.scores import ScoreTable, scores_schema
from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.core.artefacts.stored import Stored
from kinectbench.core.artefacts.targets import ALL_COLUMNS, TARGETS_CSV, Splits
from kinectbench.core.artefacts.trajectory import StoredDepthCalibration, TrajectoryHealth
from kinectbench.core.artefacts.triage import TriageFile
from kinectbench.core.artefacts.views import PairsFile, ViewsFile

PAGE = Path(__file__).parents[1] / "docs" / "keys.md"
HEAD = """# Keys

Every key of every file, made of the models that read and write them (`scripts/docs_format.py`).
[Files](format.md) says what the files are for. `a.b` is the key `b` in the object `a`, `a[].b` that
of every object in the list `a`, `a.<name>.b` that of every object in `a`, whatever it is called. An
optional key is null or missing where its value is unknown or does not apply, and in files older
than the key.
"""
MODELS: tuple[type[Stored], ...] = (
    Manifest,
    CameraFile,
    TrajectoryHealth,
    StoredDepthCalibration,
    ReconstructionFile,
    FloorFile,
    QualityFile,
    ViewsFile,
    PairsFile,
    CandidatesFile,
    Failed,
    TriageFile,
    ReferenceFile,
    PublishStamp,
    ReleaseInfo,
    Splits,
    Lineage,
    Privacy,
    ThresholdsFile,
    MethodFile,
    TrainingFile,
    ScoreTable,
)
WORDS = {"string": "text", "boolean": "true or false", "": "any value"}
# Parts of which a table of their own says what they hold.
ELSEWHERE = {QualityFile.__name__: QualityFile.FILE}

Schema = Mapping[str, Any]


def tables() -> dict[str, str]:
    """The table of each file, by the file's name, as Markdown."""
    made = {model.FILE: _table(model) for model in MODELS}
    rows = [("column", "meaning"), ("---", "---")]
    rows += [(f"`{name}`", text) for name, text in ALL_COLUMNS.items()]
    return made | {TARGETS_CSV: _markdown(rows)}


def page() -> str:
    """The page: a section for each file."""
    return HEAD + "".join(f"\n## {name}\n\n{table}" for name, table in tables().items())


def _table(model: type[Stored]) -> str:
    """A row for each key: its name, what kind of value it has, and what it means."""
    # The models of scores have defaults for what older tables lack; their schema tells what is always there.
    schema = scores_schema() if model is ScoreTable else model.model_json_schema(by_alias=True)
    return _markdown([("key", "value", "meaning"), ("---", "---", "---"), *_rows(schema, schema, "", {})])


def _markdown(rows: list[tuple[str, ...]]) -> str:
    return "".join(f"| {' | '.join(map(_cell, row))} |\n" for row in rows)


def _cell(text: str) -> str:
    """A cell's text. Outside of code, Markdown would take a bracket for a link and `<` for a tag."""
    plain_and_code = re.split(r"(`[^`]*`)", text.replace("|", "&#124;"))
    plain_and_code[::2] = [plain.replace("[", r"\[").replace("<", "&lt;") for plain in plain_and_code[::2]]
    return "".join(plain_and_code)


def _rows(part: Schema, root: Schema, above: str, known: dict[str, str]) -> Iterator[tuple[str, str, str]]:
    """The rows of an object's keys, and of those of the objects in it.

    Args:
        part: the object's schema.
        root: that of the whole file.
        above: what the object's keys begin with.
        known: the objects that have their rows already, by name, with the key they stand below.
    """
    for name, schema in part["properties"].items():
        key, kind = f"{above}{name}", _kind(schema, root)
        found = list(_objects(schema, root))
        again = [known[title] for title, _, _ in found if title in known]
        if name not in part.get("required", ()):
            kind = f"{kind.removesuffix(' or null')}, optional"
        meaning = "; ".join([schema.get("description", ""), *(f"keys as in `{one}`" for one in again)])
        yield f"`{key}`", kind, meaning
        for title, inner, steps in found:
            if title not in known:
                known[title] = key
                yield from _rows(inner, root, f"{key}{steps}.", known)


def _objects(schema: Schema, root: Schema, steps: str = "") -> Iterator[tuple[str, Schema, str]]:
    """The objects with keys that a value holds: name, schema, and the way to them, such as "[]"."""
    if "$ref" in schema:
        name, target = _target(schema, root)
        if "properties" in target and name not in ELSEWHERE:
            yield name, target, steps
    for choice in schema.get("anyOf", ()):
        yield from _objects(choice, root, steps)
    if isinstance(schema.get("items"), Mapping):
        yield from _objects(schema["items"], root, f"{steps}[]")
    if isinstance(schema.get("additionalProperties"), Mapping):
        yield from _objects(schema["additionalProperties"], root, f"{steps}.<name>")


def _target(schema: Schema, root: Schema) -> tuple[str, Schema]:
    """The name of what a reference stands for, and its schema."""
    name = schema["$ref"].split("/")[-1]
    return name, root["$defs"][name]


def _kind(schema: Schema, root: Schema) -> str:
    """What kind of value a key has, in words."""
    if "$ref" in schema:
        name, target = _target(schema, root)
        return f"as `{ELSEWHERE[name]}`" if name in ELSEWHERE else _kind(target, root)
    if "anyOf" in schema:
        return " or ".join(dict.fromkeys(_kind(choice, root) for choice in schema["anyOf"]))
    if "const" in schema:
        return f"`{schema['const']}`"
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    if schema.get("type") == "array":
        return _list_kind(schema, root)
    if schema.get("type") == "object" and "properties" not in schema:
        values = schema.get("additionalProperties")
        return f"name → {_kind(values, root)}" if isinstance(values, Mapping) else "object"
    kind = str(schema.get("type", ""))
    return WORDS.get(kind, kind)


def _list_kind(schema: Schema, root: Schema) -> str:
    """A list in words: a matrix by its shape, a short list of fixed length by its length."""
    if "prefixItems" in schema:
        kinds = [_kind(item, root) for item in schema["prefixItems"]]
        return f"{len(kinds)} × {kinds[0]}" if len(set(kinds)) == 1 else f"[{', '.join(kinds)}]"
    items, length = schema.get("items", {}), schema.get("minItems")
    if items.get("type") == "array" and length is not None and length == schema.get("maxItems"):
        return f"{length} × {items['minItems']} matrix"
    count = f"{length} × " if length is not None and length == schema.get("maxItems") else "list of "
    return f"{count}{_kind(items, root)}"


def main() -> None:
    """Fill the tables of the page."""
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
