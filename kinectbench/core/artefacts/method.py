"""method.json beside a method's predictions, and training.json beside a network's weights."""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from kinectbench.core.artefacts.benchmark import SHA256
from kinectbench.core.artefacts.stored import Part, Stored
from kinectbench.core.errors import KinectBenchError, PredictionError
from kinectbench.core.storage import canonical_json, sha256_text

# What `predict` has written of a run that is not complete, a file a line.
PREDICTED = ".predicted.jsonl"
Blake3 = Annotated[str, Field(pattern="^blake3:[0-9a-f]{64}$")]


class MethodFile(Stored):
    """method.json: what made a folder of predictions; all but the name may be missing."""

    FILE: ClassVar[str] = "method.json"
    ADVICE: ClassVar[str] = "have the method write it again, or remove it"
    ERROR: ClassVar[type[KinectBenchError]] = PredictionError

    name: str = Field(description="of the method")
    version: str | None = Field(None, description="of the method or of what ran it")
    benchmark_sha256: str | None = Field(None, description="of the release that was predicted")
    frame: Literal["grid", "camera"] = Field(
        "grid", description="axes of the predictions; grid: those of `full`"
    )
    form: Literal["voxels", "mesh", "points", "sdf"] = Field("voxels", description="what a prediction is")
    scale: Literal["metric", "free"] = Field("metric", description="whether its size is known")
    hypotheses: int = Field(1, ge=1, description="predictions of each pair")
    inputs: tuple[str, ...] = Field((), description="what was looked at: depth, color, mask, …")
    parameter_count: int | None = Field(None, description="values that were learnt and run")
    settings: dict[str, Any] | None = Field(None, description="of the method")
    training: dict[str, Any] | None = Field(None, description="what it was trained on, and for how long")
    hardware: str | None = Field(None, description="that it ran on")
    seconds_per_view: float | None = Field(None, description="mean time of one prediction, without reading")
    peak_memory_mb: float | None = Field(
        None, description="most memory of the process, or of the GPU, 10^6 bytes"
    )
    run_sha256: str | None = Field(
        None,
        pattern=SHA256,
        description="of all that decides the bytes: the run of `predict` that wrote them",
    )
    files: dict[str, Blake3] | None = Field(
        None, description="every file that the run wrote -> blake3:<hex> of its bytes"
    )


class UnfinishedFile(Stored):
    """unfinished.json: which run of `predict` has left predictions that are not complete."""

    FILE: ClassVar[str] = "unfinished.json"
    ADVICE: ClassVar[str] = "remove it, and predict anew"
    ERROR: ClassVar[type[KinectBenchError]] = PredictionError

    version: str = Field(description="of kinectbench")
    benchmark_sha256: str = Field(pattern=SHA256, description="of the release")
    config_sha256: str = Field(pattern=SHA256, description="of the method's configuration")
    weights_sha256: str = Field(pattern=SHA256, description="of weights.npz")
    threshold: float | None = Field(description="above which bits are set; null: probabilities")
    torch: str | None = Field(None, description="version of torch")
    hardware: str | None = Field(None, description="that it runs on: sums are rounded in another order there")

    @property
    def sha256(self) -> str:
        """Of all that decides the bytes of the predictions."""
        return sha256_text(canonical_json(self.json_value()))


class PredictedFile(Part):
    """A line of .predicted.jsonl: a file that a run wrote whole."""

    run_sha256: str = Field(description="of the run")
    file: str = Field(description="relative to the method's folder")
    digest: Blake3 = Field(description="of its bytes")

    def line(self) -> str:
        """As the journal has it."""
        return canonical_json(self.json_value()) + "\n"


class TrainingRow(Part):
    """What was seen at a validation; losses are means since the row before."""

    step: int = Field(description="steps that were done")
    epoch: float = Field(description="how often every pair was seen")
    loss: float = Field(description="that the network minimises")
    reconstruction: float | None = Field(None, description="3d-recgan++: the part that the truth teaches")
    discriminator: float | None = Field(None, description="3d-recgan++: what the discriminator minimises")
    validation_iou: float | None = Field(None, description="mean over validation pairs, protocol known")
    threshold: float | None = Field(None, description="at which it is highest, of 0.1, 0.15, … 0.9")

    def told(self) -> str:
        """The row as a line for people."""
        more = "" if self.validation_iou is None else f", validation IoU {self.validation_iou:.3f}"
        return f"step {self.step}, epoch {self.epoch:.2f}: loss {self.loss:.4g}{more}"


class TrainingFile(Stored):
    """training.json: how the weights beside it came to be."""

    FILE: ClassVar[str] = "training.json"
    ADVICE: ClassVar[str] = "train the method again, or get its folder whole"

    format_version: Literal[1] = Field(1, description="of this file's format")
    name: str = Field(description="of the method")
    config_sha256: str = Field(
        pattern=SHA256, description="of those of config.yaml's values that are not the defaults"
    )
    parameter_count: int = Field(description="values that are learnt, those of a discriminator as well")
    benchmark_sha256: str | None = Field(None, description="of the release that was learnt from")
    further_benchmarks_sha256: tuple[str, ...] = Field((), description="of more releases beside it")
    framings: tuple[str, ...] = Field((), description="of the pairs that were learnt from")
    objects: tuple[str, ...] = Field((), description="that were learnt from")
    pairs: int | None = Field(None, description="that were learnt from")
    steps: int | None = Field(None, description="that were done")
    steps_in_all: int | None = Field(None, description="of the whole training")
    weights_step: int | None = Field(None, description="the weights are those after this step")
    seconds: float | None = Field(None, description="of training, without validation")
    hardware: str | None = Field(None, description="that it ran on last")
    source: str | None = Field(None, description="of converted weights: what they were made of")
    rows: tuple[TrainingRow, ...] = Field((), description="the course")
