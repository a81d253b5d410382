"""scores.json and scores.csv: everything known of one method's scores."""

import csv
import hashlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, ClassVar, Self

from pydantic import BeforeValidator, Field
from pydantic.dataclasses import dataclass

from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.score_columns import (
    RowsFile,
    flat,
    read_rows,
    remove_rows,
    rows_as_json,
    write_rows,
)
from kinectbench.core.artefacts.score_figures import (
    FINITE,
    IN_UNIT_RANGE,
    Averages,
    ByThreshold,
    Closing,
    OptionalUnitRange,
    ScoreRow,
    UnitRange,
    fields_of,
)
from kinectbench.core.artefacts.score_marks import REPORTED, Mark, Sha256, ValidationUse, Verified
from kinectbench.core.artefacts.stored import Stored, StoredPart, optional
from kinectbench.core.errors import StorageError
from kinectbench.core.storage import canonical_json, replaced_file, sha256_text
from kinectbench.core.untrusted import cell

SCORES_JSON = "scores.json"
SCORES_CSV = "scores.csv"
OVERALL = "overall"
BASELINES_FOLDER = "baselines"  # in a folder of scores: what `score` adds to every table

Interval = Annotated[list[float], Field(min_length=2, max_length=2)]
Intervals = Annotated[dict[str, Interval | None], Field(description="metric -> ends of the 95 % interval")]
Count = Annotated[int | None, Field(json_schema_extra={"minimum": 1})]
ESTIMATED = "mean estimated IoU between the truth and the real object; null if not known"
LOW = "mean of the lower ends of the objects' intervals; null if not known"
HIGH = "mean of the upper ends of the objects' intervals; null if not known"
UNKNOWN = "mean over objects of the share of their true shape that is not known; all-unknown pairs count"
REPEATABILITY = "mean IoU between truths of odd and even frames; null if not known"


@dataclass(frozen=True, config=FINITE)
class CategoryAverages(Averages):
    """The averages of one category under one protocol, over objects; under `paper` over pairs."""

    pairs: Count = optional("number averaged over")
    objects: Count = optional("number averaged over")
    base_rate_source: str | None = optional("source of the base rate")
    intervals: Intervals = Field(default_factory=dict)
    truth_estimated_iou: OptionalUnitRange = optional(ESTIMATED)
    truth_estimated_iou_low: OptionalUnitRange = optional(LOW)
    truth_estimated_iou_high: OptionalUnitRange = optional(HIGH)
    truth_repeatability_iou: OptionalUnitRange = optional(REPEATABILITY)
    truth_unknown_share: OptionalUnitRange = optional(UNKNOWN)


@dataclass(frozen=True, config=FINITE)
class OverallAverages(Averages):
    """Means over the categories under one protocol."""

    truth_estimated_iou: OptionalUnitRange = optional(ESTIMATED)
    truth_estimated_iou_low: OptionalUnitRange = optional(LOW)
    truth_estimated_iou_high: OptionalUnitRange = optional(HIGH)
    truth_repeatability_iou: OptionalUnitRange = optional(REPEATABILITY)
    truth_unknown_share: OptionalUnitRange = optional(UNKNOWN)
    pairs: Count = optional("sum over the categories")
    objects: Count = optional("sum over the categories")
    categories: Count = optional("number of categories")
    intervals: Intervals = Field(default_factory=dict)


class ScoreSettings(StoredPart):
    """Every setting that the scores depend on, in words and numbers."""

    score_version: int | None = Field(
        None,
        description="version of what `score` computes; 1 where it is not stated",
        json_schema_extra={"minimum": 1},
    )
    protocols: tuple[str, ...] = Field((), description="protocols that were scored")
    primary_protocol: str | None = optional("protocol that methods are ranked by")
    missing: str | None = Field(
        None,
        description='what a missing prediction is: "error", or "empty" for an empty grid',
        json_schema_extra={"enum": ["error", "empty"]},
    )
    threshold_range: tuple[float, float] | None = optional("lowest and highest threshold")
    threshold_step: float | None = optional("step between neighbouring thresholds")
    threshold_rule: str | None = optional("how thresholds are chosen")
    occupied: str | None = optional("rule by which a voxel is predicted occupied")
    ce_clip: float | None = optional("predictions are clipped to [ce_clip, 1 - ce_clip]")
    iou_of_empty_union: int | None = optional("IoU where nothing is occupied or predicted")
    precision_and_recall_of_nothing: str | None = optional(
        "precision without predicted voxels, recall without occupied ones"
    )
    upsampling: str | None = optional("how a grid of less than 256 a side is brought to 256")
    averages: str | None = optional("the order of the means")
    surface_metrics: bool | None = optional("whether surface metrics were computed")
    close: Closing = optional("how open meshes and points are made solid; null: they are not")
    f_score_mm: tuple[float, ...] = Field((), description="tolerances of the F-scores in millimetres")
    surface_dice_sigmas: float | None = optional("surface Dice's tolerance, standard deviations")
    interval_level: float | None = optional("level of the confidence intervals")
    interval_rule: str | None = optional("how intervals are computed")
    baseline_version: int | None = optional(
        "version of what baselines predict, in their tables; 0 in those of other methods; null: "
        "not stated, as in older tables"
    )

    @property
    def of_baseline(self) -> bool:
        """Whether kinectbench found the predictions to be a baseline's; False also if it did not look."""
        return bool(self.baseline_version)


class BaseRate(StoredPart):
    """The base rate of one category."""

    value: UnitRange = Field(description="share of occupied voxels")
    source: str = Field(
        description="the split whose truth it was taken from",
        json_schema_extra={"enum": ["validation", "train", "test (oracle)"]},
    )


class Failure(StoredPart):
    """A prediction that could not be scored."""

    recording: str = Field("", description="id of the recording")
    view: str = Field("", description="zero-padded index")
    reason: str = Field("", description="reason in one line")


class ExtremePair(StoredPart):
    """One of the best or worst pairs."""

    recording: str = Field(description="id of the recording")
    view: str = Field(description="zero-padded index")
    category: str = Field(description='such as "chair"')
    iou: UnitRange = Field(description="this pair's IoU")


class Extremes(StoredPart):
    """The pairs of the highest and of the lowest IoU, at most three each, the most extreme first."""

    best: tuple[ExtremePair, ...] = Field(description="pairs with highest IoU")
    worst: tuple[ExtremePair, ...] = Field(description="pairs with lowest IoU")


class Hashes(StoredPart):
    """Hashes of the files that a pair was scored from."""

    truth: Sha256 = Field(description="SHA-256 of the pair file")
    prediction: str | None = Field(
        description="blake3:<hex> (in older tables SHA-256)",
        json_schema_extra={"pattern": "^(blake3:)?[0-9a-f]{64}$"},
    )


def _without_nulls(content: object) -> object:
    """Drop the keys of an untrusted JSON object whose value is null; null itself becomes {}."""
    if not isinstance(content, Mapping):
        return {} if content is None else content
    return {key: value for key, value in content.items() if value is not None}


def _lines(content: object) -> object:
    """Convert a JSON list to a tuple; null becomes ()."""
    return tuple(content) if isinstance(content, list) else () if content is None else content


Lines = Annotated[tuple[str, ...], BeforeValidator(_lines)]
ByCategory = Annotated[dict[str, CategoryAverages], BeforeValidator(_without_nulls)]
Curve = Annotated[
    list[float],
    Field(json_schema_extra={"minItems": 17, "maxItems": 17, "items": {"type": "number", **IN_UNIT_RANGE}}),
]


class ScoreTable(Stored):
    """Everything known of one method's scores; a key that an older file lacks has its default."""

    FILE: ClassVar[str] = SCORES_JSON
    ADVICE: ClassVar[str] = "score the predictions again"
    # Of 10,000 pairs under three protocols, each of its own recording, with its quality: 6.9 kB
    # and 288 values each; read in 7 s and 0.63 GB.
    MAX_BYTES: ClassVar[int] = 80 << 20
    MAX_VALUES: ClassVar[int] = 3_000_000

    method: str = Field(description="name of the method")
    benchmark_sha256: Sha256 = Field("", description="the release's `benchmark_sha256`")
    package_version: str = Field("", description="version of kinectbench")
    run_sha256: Sha256 | None = optional("as in method.json; null: not known")
    settings: ScoreSettings = Field(ScoreSettings(), description="every choice that the numbers depend on")
    complete: bool = Field(False, description="whether every test pair was scored; if not, no averages")
    thresholds: Annotated[dict[str, float], BeforeValidator(_without_nulls)] = Field(
        {}, description="category -> threshold, k / 20 with k from 2 to 18"
    )
    threshold_source: str = Field(
        "",
        description="how they were chosen: validation, pooled (of other categories), method (its own), fixed "
        "or file:<sha256>",
        json_schema_extra={"pattern": "^(validation|pooled|method|fixed|file:[0-9a-f]{64})$"},
    )
    threshold_source_by_category: dict[str, str] = Field({}, description="category -> source, likewise")
    threshold_objects: Lines | None = optional(
        "objects that the thresholds were chosen on; null where unknown: their file does not "
        "name them, or some are the method's own"
    )
    validation: ValidationUse | None = optional(
        "validation pairs that chose the thresholds; null: they chose none"
    )
    missing_as_empty: Lines = Field((), description="pairs scored as empty grids")
    marks: tuple[Mark, ...] = Field((), description="what to know before trusting the numbers")
    base_rate: dict[str, BaseRate] = Field(
        {}, description="category -> the constant that CE is compared with"
    )
    rows: tuple[ScoreRow, ...] = Field((), description="one row for each protocol and test pair")
    rows_file: RowsFile | None = optional(
        "description of rows.npz, which holds the rows if more than 30,000; `rows` is empty"
    )
    by_category: Annotated[dict[str, ByCategory], BeforeValidator(_without_nulls)] | None = optional(
        "protocol -> category -> averages; null if not complete"
    )
    overall: Annotated[dict[str, OverallAverages], BeforeValidator(_without_nulls)] | None = optional(
        "protocol -> mean over the categories"
    )
    truth_quality: dict[str, QualityFile] = Field(
        {}, description="recording -> what the release says of its truth"
    )
    truth_unknown_share: dict[str, UnitRange] = Field({}, description="object -> its mean `unknown_share`")
    all_unknown_pairs: dict[str, Lines] = Field(
        {}, description="protocol -> pairs left out: nothing of their true shape is known"
    )
    failures: tuple[Failure, ...] = Field((), description="predictions that were not scored")
    warnings: Lines = Field((), description="warnings, one line each")
    notes: Lines = Field((), description="notes, one line each")
    extremes: dict[str, Extremes] = Field({}, description="protocol -> the best and the worst pairs by IoU")
    iou_by_threshold: dict[str, dict[str, Curve]] | None = optional(
        "protocol -> category -> mean IoU at k / 20, k = 2 to 18; null if not complete"
    )
    hashes: dict[str, Hashes] = Field({}, description="pair -> hashes of its truth and prediction")
    baseline: bool = Field(False, description="whether kinectbench made it, for comparison with methods")
    verified: Verified | None = optional("recheck that found the same rows; null: reported only")

    @property
    def standing(self) -> str:
        """Whether the scores were verified: `verified DATE, kinectbench VERSION`, or `reported`."""
        return REPORTED if self.verified is None else self.verified.words

    def facts_sha256(self) -> str:
        """SHA-256 of the values that a recheck must reproduce: all but derived ones and `verified`."""
        content = self.model_copy(update={"rows": ()}).json_value()
        digest, sign = hashlib.sha256(), "{"
        for key in sorted(set(content) - NO_FACTS):
            digest.update(f"{sign}{canonical_json(key)}:".encode())
            sign = ","
            # Row by row: all of half a million as one text take gigabytes.
            for part in rows_as_json(self.rows) if key == "rows" else [canonical_json(content[key])]:
                digest.update(part.encode())
        digest.update(b"}")
        return digest.hexdigest()

    def predictions_sha256(self) -> str:
        """SHA-256 of the names of the pairs and the hashes of their predictions."""
        return sha256_text(canonical_json({name: of.prediction for name, of in self.hashes.items()}))

    @property
    def counted_by(self) -> str:
        """How predictions were counted: version of `score`, and how grids were upsampled, as text.

        Tables that differ here are not compared. The setting `missing` does not change the numbers of a pair.
        """
        return f"score version {self.score_version}, upsampling {self.settings.upsampling or 'unknown'}"

    @property
    def score_version(self) -> int:
        """The version of `score` that computed the table; 1 if it is not stated, as in early tables."""
        return self.settings.score_version or 1

    def averages(self, protocol: str) -> dict[str, CategoryAverages | OverallAverages]:
        """The averages under a protocol by category; those over all categories have the key `OVERALL`."""
        values: dict[str, CategoryAverages | OverallAverages] = {**(self.by_category or {}).get(protocol, {})}
        over_all = (self.overall or {}).get(protocol)
        return values if over_all is None else {**values, OVERALL: over_all}

    def pairs(self, protocol: str) -> list[ScoreRow]:
        """The rows of a group (`ScoreRow.heading`); for most protocols the group has the protocol's name."""
        return [row for row in self.rows if row.heading == protocol]

    def left_out_line(self, protocol: str) -> str:
        """Return a sentence on the number of pairs that a protocol leaves out; "" if it leaves out none."""
        count, pairs = len(self.all_unknown_pairs.get(protocol, ())), len(self.pairs(protocol))
        if not count:
            return ""
        verb = "is" if count == 1 else "are"
        return (
            f"{protocol}: {count} of {pairs} pairs {verb} left out: nothing of the true shape is known there"
        )

    def csv(self) -> str:
        """Return the text of scores.csv: a line for each row, with the method's name in the first column."""
        columns = tuple(name for name in fields_of(ScoreRow) if name not in fields_of(ByThreshold))
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(["method", *columns])
        rows = ([self.method, *(flat(getattr(row, name)) for name in columns)] for row in self.rows)
        writer.writerows(map(cell, row) for row in rows)
        return buffer.getvalue()

    def write(self, folder: Path, name: str = SCORES_JSON) -> None:
        """Write scores.json and scores.csv into a folder, each atomically; many rows go to rows.npz.

        Args:
            folder: created if missing.
            name: name of the JSON file. If it is not scores.json, no scores.csv is written, and the rows.npz
                of a scores.json in the folder stays.

        Raises:
            StorageError: the table has many rows, but the folder has a scores.json with other ones, so that
                nothing is replaced; or the disk is full or read-only.
        """
        is_own = name == SCORES_JSON
        over = is_own or not (folder / SCORES_JSON).exists()
        table, beside = self, write_rows(self.rows, folder, over=over)
        if beside is not None:
            table = self.model_copy(update={"rows": (), "rows_file": beside})
        files = {SCORES_CSV: self.csv()} if is_own else {}
        for file, text in (files | {name: table.text()}).items():
            with replaced_file(folder / file) as temporary:
                temporary.write_text(text, encoding="utf-8")
        if is_own and beside is None:  # last: until it is replaced, a table that lies there needs them
            remove_rows(folder)

    @classmethod
    def read_file(cls, path: Path) -> Self:
        """Read a table, with the rows of a rows.npz beside it; raises what `Stored.read_file` raises."""
        table = super().read_file(path)
        if table.rows_file is None:
            return table
        if table.rows:
            raise StorageError(
                f"{path}: it has 'rows' and 'rows_file', of which one must hold all; {cls.ADVICE}"
            )
        rows = read_rows(path.parent, table.rows_file)
        return table.model_copy(update={"rows": rows, "rows_file": None})


# What follows from rows and settings, or has no effect on the numbers.
DERIVED = (
    *("by_category", "overall", "truth_unknown_share", "all_unknown_pairs", "notes", "extremes"),
    *("iou_by_threshold", "marks"),
)
NO_FACTS = {*DERIVED, "verified", "rows_file"}
