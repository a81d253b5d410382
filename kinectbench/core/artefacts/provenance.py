"""The provenance of a release: lineage.json, privacy.json and thresholds.json."""

from collections.abc import Mapping
from typing import ClassVar, Literal

from pydantic import Field, field_validator

from kinectbench.core.artefacts.benchmark import ReleaseFile
from kinectbench.core.artefacts.stored import Count, StoredPart, optional
from kinectbench.core.names import StoredCategory, unlike
from kinectbench.core.storage import canonical_json, sha256_text

LINEAGE_JSON = "lineage.json"
PRIVACY_JSON = "privacy.json"
THRESHOLDS_JSON = "thresholds.json"

# What became of the colour images of the views; none: there were none.
ColorPublished = Literal["left out", "published", "none"]


class LineageStage(StoredPart):
    """How one artefact of a recording was made."""

    package_version: str = Field(description="version of kinectbench; a record only")
    stage_version: int | None = optional(
        "version of the stage's output; null or missing: the artefact is older than the key"
    )
    settings: dict[str, object] = Field(description="settings that it depends on")
    fingerprint: str = Field(description="SHA-256 of stage, version, settings and inputs")


class LineageView(StoredPart):
    """The frame of a view."""

    view: str = Field(description="zero-padded index")
    frame: Count = Field(description="index among the recording's depth images, in their order")
    stamp_ns: int = Field(description="depth stamp, nanoseconds")


class LineageRecording(StoredPart):
    """The origin of the pairs of one recording."""

    source: str = Field(description="who recorded it, or where it is from")
    license: str = Field(description="the data's licence")
    files: dict[str, str] = Field(
        description="file of the recording, relative to it → SHA-256; empty where `files_sha256` is"
    )
    files_sha256: str | None = optional("in place of very many `files`: SHA-256 over their JSON")
    stages: dict[str, LineageStage] = Field(description="stages by name, in pipeline order")
    views: tuple[LineageView, ...] | None = optional("views with a pair; missing: held back")


def files_hash(files: Mapping[str, str]) -> str:
    """Return `files_sha256`: SHA-256 of the JSON {file name: SHA-256 of the file}, keys sorted."""
    return sha256_text(canonical_json(dict(files)))


class Lineage(ReleaseFile):
    """The content of lineage.json; the versions of other packages are in benchmark.json."""

    FILE: ClassVar[str] = LINEAGE_JSON

    format_version: Literal[1] = Field(description="version of this file's format")
    package_version: str = Field(description="version of kinectbench that published it")
    packages: str = Field(description="where the versions of other packages are")
    recordings: dict[str, LineageRecording] = Field(description="recordings by id")


class Removed(StoredPart):
    """Something that was removed."""

    file: str = Field(description="the release's file")
    what: str = Field(description="what was removed, in words")


class Privacy(ReleaseFile):
    """The content of privacy.json: what was searched for, and removed or kept."""

    FILE: ClassVar[str] = PRIVACY_JSON

    format_version: Literal[1] = Field(description="version of this file's format")
    color: ColorPublished = Field(description="whether the views' colour images are published")
    looked_in: tuple[str, ...] = Field(description="kinds of files searched")
    looked_for: tuple[str, ...] = Field(description="kinds of facts searched for")
    removed: tuple[Removed, ...] = Field(description="facts found and removed")
    kept: tuple[str, ...] = Field(description="what is published knowingly")


# A threshold is k / 20, with k from 2 to 18.
STEPS, THRESHOLD_STEPS = 20, tuple(range(2, 19))


def nearest_step(value: float) -> float | None:
    """Return the threshold k / 20, k = 2 to 18, that equals a number up to rounding; None if none does."""
    return next((k / STEPS for k in THRESHOLD_STEPS if abs(value - k / STEPS) <= 1e-9), None)


class ThresholdsFile(ReleaseFile):
    """The content of thresholds.json: the frozen thresholds of a method."""

    FILE: ClassVar[str] = THRESHOLDS_JSON
    ADVICE: ClassVar[str] = "`kinectbench score --save-thresholds` writes one"

    thresholds: dict[StoredCategory, float] = Field(
        description="category → threshold, one of 0.1, 0.15, … 0.9"
    )
    objects: tuple[str, ...] = Field((), description="objects they were chosen on")
    method: str | None = optional("method they were chosen for")
    benchmark_sha256: str | None = optional("`benchmark_sha256` of the release they were chosen on")

    @field_validator("thresholds")
    @classmethod
    def _one_spelling(cls, thresholds: dict[str, float]) -> dict[str, float]:
        spelled: dict[str, str] = {}
        for category in thresholds:
            if (other := spelled.setdefault(category.lower(), category)) != category:
                raise ValueError(unlike("categories", category, other))
        return thresholds
