"""method.json beside a method's predictions, and training.json beside a network's weights."""

import math
import re
from typing import Annotated, Any, ClassVar, Literal, Self, get_args

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from kinectbench.core.artefacts.benchmark import SHA256
from kinectbench.core.artefacts.stored import Matrix4, Stored, StoredPart, array_in_file, optional
from kinectbench.core.errors import KinectBenchError, PredictionError
from kinectbench.core.geometry import similarity_problem
from kinectbench.core.storage import canonical_json, sha256_text
from kinectbench.core.types import Float64
from kinectbench.core.untrusted import printable

# What `predict` has written of a run that is not complete, a file a line.
PREDICTED = ".predicted.jsonl"
# Unknown keys of a method.json.
MOST_UNKNOWN = 200
# Characters of a key that are compared with the known ones, which have up to 19.
LONGEST_NAME = 40
# Keys that decide the score. A key that is nearly one of them is refused where it has this many letters. Of
# fewer, honest keys are near (`from`, `init`, `scales`): unless the value is a word of it.
DECIDING = ("frame", "form", "unit", "axes", "scale", "hypotheses", "threshold", "T_camera_prediction")
LEAST_LETTERS = 6
# Samples of a view that are read: chosen here.
MOST_HYPOTHESES = 100
Blake3 = Annotated[str, Field(pattern="^blake3:[0-9a-f]{64}$")]


def _checked_similarity(T: Float64) -> Float64:
    if problem := similarity_problem(T):
        raise ValueError(problem)
    return T


Box = Annotated[Float64, *array_in_file((2, 3))]
Similarity = Annotated[Matrix4, AfterValidator(_checked_similarity)]


def _letters(name: str) -> str:
    """Lower-case a key and remove its separators."""
    return re.sub(r"[\W_]", "", name[:LONGEST_NAME]).casefold()


def is_misspelt(name: str, known: str) -> bool:
    """Whether a name is a known key with at most one typo, or two if the key has eight letters or more.

    A typo is an extra, missing or wrong letter, or two swapped ones. Case and separators are ignored.
    """
    one, other = _letters(name), _letters(known)
    allowed = 1 if len(other) < 8 else 2
    if abs(len(one) - len(other)) > allowed:
        return False
    # Optimal string alignment: the last two rows of the table of distances between beginnings.
    before, row = [0] * (len(other) + 1), list(range(len(other) + 1))
    for i, letter in enumerate(one, start=1):
        earlier, before, row = before, row, [i]
        for j, wanted in enumerate(other, start=1):
            cost = min(before[j] + 1, row[j - 1] + 1, before[j - 1] + (letter != wanted))
            if i > 1 and j > 1 and one[i - 2] == wanted and letter == other[j - 2]:
                cost = min(cost, earlier[j - 2] + 1)
            row.append(cost)
    return row[-1] <= allowed


class MethodFile(Stored):
    """method.json: how a method made a folder of predictions; all keys but the name are optional."""

    FILE: ClassVar[str] = "method.json"
    ADVICE: ClassVar[str] = "have the method write it again"
    ERROR: ClassVar[type[KinectBenchError]] = PredictionError
    # The digests of 100,000 files take 11 MB.
    MAX_BYTES: ClassVar[int] = 32 << 20

    name: str = Field(description="the method's name")
    version: str | None = optional("version of the method, or of what ran it")
    benchmark_sha256: str | None = optional("the release's `benchmark_sha256`")
    frame: Literal["grid", "camera"] = Field(
        "grid", description="axes of predictions; grid: those of the pair's `full`"
    )
    form: Literal["voxels", "mesh", "points", "sdf"] = Field("voxels", description="what a prediction is")
    unit: Literal["m", "mm", "free"] = Field("m", description="unit of a prediction's lengths")
    axes: Literal["cv", "pytorch3d", "opengl"] = Field(
        "cv", description="camera axes; cv: x right, y down, z forward, as those of `full`"
    )
    T_camera_prediction: dict[str, Similarity] | None = optional(
        "`<recording>/<view>` -> 4 x 4 similarity from the prediction to the camera, metres, for "
        "column vectors; it is applied after `unit` and `axes`"
    )
    volume_m: dict[str, Box] | None = optional(
        "`<recording>/<view>` -> lowest and highest x, y, z of the method's own volume: camera "
        "frame, metres; scores state the share of the truth outside"
    )
    scale: Literal["metric", "free"] = Field("metric", description="whether predictions have metric size")
    hypotheses: int = Field(1, ge=1, le=MOST_HYPOTHESES, description="predictions per pair")
    threshold: float | None = Field(
        None, ge=0, le=1, description="threshold of categories without validation pairs: 0.1, 0.15, … or 0.9"
    )
    inputs: tuple[str, ...] = Field((), description="what the method used: depth, color, mask, …")
    parameter_count: int | None = Field(None, ge=0, description="learnt values used in inference")
    settings: dict[str, Any] | None = optional("the method's settings")
    training: dict[str, Any] | None = optional("training data and time")
    hardware: str | None = optional("hardware that it ran on")
    seconds_per_view: float | None = Field(None, ge=0, description="mean time, without reading files")
    peak_memory_mb: float | None = Field(None, ge=0, description="most memory of process or GPU, 10^6 bytes")
    run_sha256: str | None = Field(
        None, pattern=SHA256, description="id of the `predict` run: SHA-256 of all that decides the bytes"
    )
    files: dict[str, Blake3] | None = optional("file that the run wrote -> blake3:<hex>")

    @field_validator("frame", "form", "unit", "axes", "scale", mode="before")
    @classmethod
    def _a_known_word(cls, value: object, info: ValidationInfo) -> object:
        words = get_args(cls.model_fields[str(info.field_name)].annotation)
        if value not in words:
            raise ValueError(f"{printable(repr(value), 60)} is none of {', '.join(words)}")
        return value

    @model_validator(mode="after")
    def _size_is_known_or_said_to_be_free(self) -> Self:
        if self.unit == "free" and self.scale == "metric" and not self.T_camera_prediction:
            raise ValueError(
                "'unit': 'free' leaves the size unknown: add 'scale': 'free', or 'T_camera_prediction'"
            )
        return self

    @model_validator(mode="after")
    def _no_misspelt_key(self) -> Self:
        """Refuse a misspelt key that would otherwise be ignored although it decides the score."""
        unknown = self.model_extra or {}
        if len(unknown) > MOST_UNKNOWN:
            raise ValueError(f"{len(unknown)} keys that are not known: at most {MOST_UNKNOWN} are read")
        for key, value in unknown.items():
            for known in DECIDING:
                words = get_args(type(self).model_fields[known].annotation)
                is_meant = len(known) >= LEAST_LETTERS or _letters(key) == _letters(known) or value in words
                if is_meant and is_misspelt(key, known):
                    raise ValueError(f"'{key}': no such key; did you mean '{known}'?")
        return self

    def meant(self, key: str) -> str | None:
        """Return the known key that an unknown key misspells; None if it resembles none."""
        return next((known for known in type(self).model_fields if is_misspelt(key, known)), None)


class UnfinishedFile(Stored):
    """unfinished.json: the settings of a run of `predict` that has not completed its predictions."""

    FILE: ClassVar[str] = "unfinished.json"
    ADVICE: ClassVar[str] = "remove it, and predict again"
    ERROR: ClassVar[type[KinectBenchError]] = PredictionError

    version: str = Field(description="version of kinectbench")
    benchmark_sha256: str = Field(pattern=SHA256, description="`benchmark_sha256` of the release")
    config_sha256: str = Field(pattern=SHA256, description="SHA-256 of the method's configuration")
    weights_sha256: str = Field(pattern=SHA256, description="SHA-256 of weights.npz")
    threshold: float | None = Field(
        description="threshold above which bits are set; null: probabilities are written"
    )
    precision: Literal["packed"] | None = optional(
        "packed: probabilities at 256^3 are stored in 8 bits; missing: none are"
    )
    torch: str | None = optional("version of torch")
    hardware: str | None = optional("hardware that it runs on: elsewhere sums are rounded in another order")
    code_sha256: str | None = Field(
        None,
        pattern=SHA256,
        description="SHA-256 of a user's network code: its file, and what it imports from there; missing: a "
        "network of kinectbench",
    )

    @property
    def sha256(self) -> str:
        """SHA-256 of this file's values, which determine the bytes of the predictions."""
        return sha256_text(canonical_json(self.json_value()))


class PredictedFile(StoredPart):
    """One line of .predicted.jsonl: a prediction file that a run completed."""

    run_sha256: str = Field(description="id of the run")
    file: str = Field(description="path relative to the method's folder")
    digest: Blake3 = Field(description="BLAKE3 hash of its bytes")

    def line(self) -> str:
        """Return the line of .predicted.jsonl: JSON with a line break."""
        return canonical_json(self.json_value()) + "\n"


class TrainingRow(StoredPart):
    """Results of one validation during training; losses are means since the previous row."""

    step: int = Field(description="steps done")
    epoch: float = Field(description="passes over all pairs")
    loss: float = Field(description="loss that the network minimises")
    reconstruction: float | None = optional("3d-recgan++: part of the loss against the truth")
    discriminator: float | None = optional("3d-recgan++: what the discriminator minimises")
    validation_iou: float | None = optional("mean IoU over validation pairs, protocol known")
    threshold: float | None = optional("threshold of the highest `validation_iou`, of 0.1, 0.15, … 0.9")

    def line(self) -> str:
        """Return the row as a line to print."""
        more = "" if self.validation_iou is None else f", validation IoU {self.validation_iou:.3f}"
        return f"step {self.step}, epoch {self.epoch:.2f}: loss {self.loss:.4g}{more}"


class TrainingFile(Stored):
    """training.json: how the network weights beside it were trained or converted."""

    FILE: ClassVar[str] = "training.json"
    ADVICE: ClassVar[str] = "train the method again, or get its folder whole"

    format_version: Literal[1] = Field(1, description="version of this file's format")
    name: str = Field(description="the method's name")
    config_sha256: str = Field(
        pattern=SHA256, description="SHA-256 of config.yaml's values other than defaults"
    )
    parameter_count: int = Field(description="learnt values, including a discriminator's")
    benchmark_sha256: str | None = optional("the release's `benchmark_sha256`")
    further_benchmarks_sha256: tuple[str, ...] = Field(
        (), description="`benchmark_sha256` of further releases"
    )
    framings: tuple[str, ...] = Field((), description="framings of the training pairs")
    objects: tuple[str, ...] = Field((), description="training objects")
    pairs: int | None = optional("number of training pairs")
    steps: int | None = optional("steps done")
    steps_in_all: int | None = optional("steps of the whole training")
    weights_step: int | None = optional("step that the weights are from")
    seconds: float | None = optional("training time without validation, seconds")
    hardware: str | None = optional("hardware that it ran on last")
    source: str | None = optional("what converted weights were made of")
    rows: tuple[TrainingRow, ...] = Field((), description="training progress")

    @property
    def threshold(self) -> float | None:
        """The best threshold in the last validation up to the step of the weights; None if there is none."""
        step = math.inf if self.weights_step is None else self.weights_step
        thresholds = [row.threshold for row in self.rows if row.step <= step and row.threshold is not None]
        return thresholds[-1] if thresholds else None
