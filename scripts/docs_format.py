"""Write docs/keys.md, a list of keys for each file, from the models that read and write the files.

    .venv/bin/python scripts/docs_format.py

What a model cannot say is prose in docs/format.md, which links to each list.
"""

import dataclasses
import re
import textwrap
from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

from docs_schemas import scores_schema

from kinectbench.core.artefacts.benchmark import ReleaseInfo
from kinectbench.core.artefacts.manifest import Failed, Manifest
from kinectbench.core.artefacts.method import MethodFile, TrainingFile
from kinectbench.core.artefacts.object import CandidatesFile, FloorFile, QualityFile
from kinectbench.core.artefacts.provenance import Lineage, Privacy, ThresholdsFile
from kinectbench.core.artefacts.reconstruction import ReconstructionFile
from kinectbench.core.artefacts.reference import ReferenceFile
from kinectbench.core.artefacts.score_figures import SurfaceMetrics, VoxelMetrics
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.core.artefacts.stored import Stored
from kinectbench.core.artefacts.targets import ALL_COLUMNS, SPLITS, TARGETS_CSV, Splits
from kinectbench.core.artefacts.trajectory import StoredDepthCalibration, TrajectoryHealth
from kinectbench.core.artefacts.triage import TriageFile
from kinectbench.core.artefacts.views import PairsFile, ViewsFile

PAGE = Path(__file__).parents[1] / "docs" / "keys.md"
HEAD = """# Keys

The keys of each JSON file, made by `scripts/docs_format.py` of the models that read and write them.
[Files](format.md) says what the files are for.

- An indented key belongs to the object above it, to each object of a list, or to each object `by name`.
- Units are those of the key's name. Grids and frames: [Conventions](conventions.md).
- A key without a kind is a number, or the object of the keys below it. A plural is a list: `texts`.
- N in a meaning is the number in the key's name.
- A key with `?` is null or missing where its value is unknown or does not apply, and in files older than
  the key.
- `split`, like every split, is `train`, `validation` or `test`.
- Everywhere the same: `format_version` of the file (listed where it says more), `package_version` of the
  kinectbench that wrote it, `recording` (its id), `object` (the thing recorded), `category` (such as chair),
  `view` (zero-padded index), `frame` (index in the recording, from 0), `stamp_ns` (of the frame's depth),
  `sha256` (of the file's bytes), `warnings` (what people should know, one line each), and the camera's
  `width`, `height`, `fx`, `fy`, `cx`, `cy` in pixels of the depth images.
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
    ReleaseInfo,
    Splits,
    Lineage,
    Privacy,
    ThresholdsFile,
    MethodFile,
    TrainingFile,
    ScoreTable,
)
WORDS = {"string": "text", "integer": "number", "": "any"}
# What a key's name, its kind or its `?` says already is left out of its meaning.
UNITS = {
    "_m": "metres|m",
    "_per_s": "m/s|rad/s",
    "_mm": "mm|millimetres",
    "_m2": "square metres",
    "_m3": "cubic metres",
}
UNITS |= {
    "_rad": "radians",
    "_deg": "degrees",
    "_ns": "nanoseconds",
    "_s": "seconds",
    "_ms": "ms",
    "_px": "pixels",
}
NOTHING = re.compile(
    r"; (?:null|absent|missing)(?: or missing)?(?:: [^;]*| if none| (?:if )?not known| without one)$"
)
EMPTY = set(
    re.findall(
        r"\w+", "a an the id of its it in by that this is name number each file whether keys and or how many"
    )
)
# The head of the page says what they mean, but for a meaning with a further clause.
COMMON = frozenset(
    [
        *("package_version", "recording", "object", "category", "split", "view", "frame", "stamp_ns"),
        *("sha256", "warnings", "width", "height", "fx", "fy", "cx", "cy"),
    ]
)
# Parts of which a list of their own says what they hold.
ELSEWHERE = {QualityFile.__name__: QualityFile.FILE}
# Objects whose keys are described where the link leads: constants of a method, and other papers' figures.
DESCRIBED = {
    "SolidMethod": "described in `schemas/quality.schema.json` of a release",
    "ScoreSettings": "described in [scores.schema.json](scores.schema.json)",
    "Alignment": "[its keys](scoring-in-space.md#registration)",
    "Calibration": "[its keys](scoring-in-space.md#several-hypotheses)",
    "Ceiling": "[its keys](scoring-in-space.md#ceiling)",
    "AsPapers": "[its keys](scoring-in-space.md#as-other-papers)",
}
# Keys of metrics, and where they are defined.
METRICS = tuple(field.name for of in (VoxelMetrics, SurfaceMetrics) for field in dataclasses.fields(of))
DEFINED = "scoring.md#metrics"
# So many keys at least that an object shares with an earlier one are named in one line.
# Of another file it is one more.
LEAST_SHARED = 2
LONGEST_LINE = 110
# A meaning of `format_version` of fewer words says nothing more than the name.
MORE_WORDS = 7

Schema = Mapping[str, Any]
Row = tuple[str, bool, str, str]  # a key's name, whether it always has a value, its kind, what it means


class _Listed:
    """What stands on the page already: objects by name, and rows, each with the file and key that have it."""

    def __init__(self) -> None:
        self.file = ""
        self.objects: dict[str, tuple[str, str]] = {}
        self.rows: dict[Row, tuple[str, str]] = {}
        self.metrics = ""  # the key whose objects list every metric

    def place(self, where: tuple[str, str]) -> str:
        """A place as a reader of the current file finds it."""
        file, key = where
        if file == DEFINED:
            return f"[Metrics]({DEFINED})"
        link = "" if file == self.file else f"[{file}](#{re.sub(r'[^a-z_]', '', file)})"
        return " of ".join(part for part in (f"`{key}`" if key else "", link) if part) or "above"


def tables() -> dict[str, str]:
    """The keys of each file, by the file's name, as a Markdown list."""
    listed, made = _Listed(), dict[str, str]()
    for model in MODELS:
        listed.file = model.FILE
        # The models of scores have defaults for what older files lack; their schema has what is always there.
        schema = scores_schema() if model is ScoreTable else model.model_json_schema(by_alias=True)
        if model is ScoreTable:
            row = schema["$defs"]["ScoreRow"]
            said = (_said(name, row["properties"][name], row, schema) for name in METRICS)
            listed.rows |= dict.fromkeys(said, (DEFINED, ""))
        made[model.FILE] = "".join(_rows(schema, schema, "", listed))
    return made | {
        TARGETS_CSV: _line(0, ", ".join(f"`{name}`" for name in ALL_COLUMNS if name in COMMON), "", "")
        + "".join(_line(0, f"`{name}`", "", text) for name, text in ALL_COLUMNS.items() if name not in COMMON)
    }


def page() -> str:
    """The page: a section for each file."""
    return HEAD + "".join(f"\n## {name}\n\n{keys}" for name, keys in tables().items())


def _line(depth: int, names: str, kind: str, meaning: str) -> str:
    """An item of the list, wrapped."""
    head = " ".join(
        filter(None, [f"- {names}", "" if kind == "number" or names == f"`{kind}`" else _plain(kind)])
    )
    indent = "    " * depth
    lines = textwrap.wrap(
        f"{head}: {_plain(meaning)}" if meaning else head,
        LONGEST_LINE,
        initial_indent=indent,
        subsequent_indent=f"{indent}  ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    return "\n".join(lines) + "\n"


def _plain(text: str) -> str:
    """A text of the list. Outside of code, Markdown would take a bracket for a link and `<` for a tag."""
    plain_and_code = re.split(r"(`[^`]*`|\[[^\]]*\]\([^)\s]+\))", text)
    plain_and_code[::2] = [plain.replace("[", r"\[").replace("<", "&lt;") for plain in plain_and_code[::2]]
    return "".join(plain_and_code)


def _rows(part: Schema, root: Schema, above: str, listed: _Listed) -> Iterator[str]:
    """The lines of an object's keys, and of those of the objects in it.

    Args:
        part: the object's schema.
        root: that of the whole file.
        above: the keys that lead to the object, with dots.
        listed: what the page has already.
    """
    depth = above.count(".") + bool(above)
    rows = [_said(name, schema, part, root) for name, schema in part["properties"].items()]
    inside = {name: list(_objects(schema, root)) for name, schema in part["properties"].items()}
    shared: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row in listed.rows and not inside[row[0]]:
            shared.setdefault(listed.rows[row], []).append(row)
    shared = {
        where: same for where, same in shared.items() if len(same) >= LEAST_SHARED + (where[0] != listed.file)
    }
    known = {row for same in shared.values() for row in same}
    own = [row for row in rows if row not in known and not _said_by_head(row)]
    for _, group in groupby(own, lambda row: row[0] if inside[row[0]] else _without_numbers(row)):
        (name, _, kind, meaning), *others = together = list(group)
        key, found = f"{above}.{name}".lstrip("."), inside[name]
        if any(other[3] != meaning for other in others):
            meaning = _without_numbers(together[0])[1]
        again = [DESCRIBED[one] for one, _ in found if one in DESCRIBED]
        again += [
            f"keys as in {listed.place(listed.objects[one])}" for one, _ in found if one in listed.objects
        ]
        shown = "" if kind == "object" and found else kind.replace("object by name", "by name")
        yield _line(
            depth, ", ".join(map(_named, together)), shown, "; ".join(filter(None, [meaning, *again]))
        )
        for row in together:
            listed.rows.setdefault(row, (listed.file, above))
        for title, inner in found:
            if title not in {*listed.objects, *DESCRIBED}:
                listed.objects[title] = (listed.file, key)
                yield from _rows(inner, root, key, listed)
    for where, same in shared.items():
        names = ", ".join(map(_named, same))
        if where[0] == DEFINED and listed.metrics:
            yield _line(depth, "all metrics?", "", f"as in `{listed.metrics}`")
            continue
        yield _line(depth, names, "", f"as {'in ' * (where != (listed.file, ''))}{listed.place(where)}")
        listed.metrics = listed.metrics or (above if where[0] == DEFINED else "")


def _said_by_head(row: Row) -> bool:
    """Whether a row says no more than the head of the page."""
    return row[0] == "format_version" and len(row[3].split()) < MORE_WORDS


def _without_numbers(row: Row) -> tuple[str, str]:
    """A row's kind and meaning with N for each number: neighbours that agree in them stand in one line."""
    return row[2], re.sub(r"\d+", "N", row[3])


def _named(row: Row) -> str:
    """A key's name in the list."""
    return f"`{row[0]}`" if row[1] else f"`{row[0]}`?"


def _said(name: str, schema: Schema, part: Schema, root: Schema) -> Row:
    """A key's row, without what its name and its kind say already."""
    kind = _kind(schema, root).removesuffix(" or null")
    always = name in part.get("required", ()) and schema.get("anyOf", [{}])[-1].get("type") != "null"
    meaning = NOTHING.sub("", re.sub(r"^\(\d, \d\),? ", "", schema.get("description", "")).removesuffix("."))
    for suffix, unit in UNITS.items():
        if name.endswith(suffix):
            meaning = re.sub(rf"[,;] (?:{unit})(?=$|[,;])", "", meaning)
    words = set(re.findall(r"[a-z]\w*", meaning.lower())) - EMPTY
    said = words <= {*name.lower().split("_"), *re.findall(r"\w+", kind)}
    said |= name in COMMON and ";" not in meaning
    return name, always, kind, "" if said else meaning


def _objects(schema: Schema, root: Schema) -> Iterator[tuple[str, Schema]]:
    """The objects with keys that a value holds, each with its name."""
    if "$ref" in schema:
        name, target = _target(schema, root)
        if "properties" in target and name not in ELSEWHERE:
            yield name, target
    for choice in schema.get("anyOf", ()):
        yield from _objects(choice, root)
    for inner in (schema.get("items"), schema.get("additionalProperties")):
        if isinstance(inner, Mapping):
            yield from _objects(inner, root)


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
    if schema.get("enum") == list(SPLITS):
        return "split"
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    if schema.get("type") == "array":
        return _list_kind(schema, root)
    if schema.get("type") == "object" and "properties" not in schema:
        values = schema.get("additionalProperties")
        return f"{_kind(values, root)} by name" if isinstance(values, Mapping) else "object"
    kind = str(schema.get("type", ""))
    return WORDS.get(kind, kind)


def _list_kind(schema: Schema, root: Schema) -> str:
    """A list in words: a matrix by its shape, a short list of fixed length by its length."""
    if "prefixItems" in schema:
        kinds = [_kind(item, root) for item in schema["prefixItems"]]
        return f"{len(kinds)} {_several(kinds[0])}" if len(set(kinds)) == 1 else f"[{', '.join(kinds)}]"
    items, length = schema.get("items", {}), schema.get("minItems")
    if items.get("type") == "array" and length is not None and length == schema.get("maxItems"):
        return f"{length}×{items['minItems']} matrix"
    kind = _kind(items, root)
    if length is not None and length == schema.get("maxItems"):
        return f"{length} {_several(kind)}"
    if kind == "object":
        return "list"
    return _several(kind) if _several(kind) != kind else f"list of {kind}"


def _several(kind: str) -> str:
    """The plural of a kind, where it is a word."""
    return f"{kind}s" if kind in ("number", "text", "split") else kind


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
