"""benchmark.json, the description of a release, and publish.json, the record of the last publication."""

import contextlib
from typing import ClassVar, Literal, Self

from pydantic import Field

from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.reference import ReferenceInfo
from kinectbench.core.artefacts.stored import Stored, StoredPart
from kinectbench.core.errors import KinectBenchError, ReleaseError
from kinectbench.core.types import Framing, PartialRule, Split
from kinectbench.core.untrusted_text import strict_json

FORMAT_VERSION = 1
BENCHMARK_JSON = "benchmark.json"
SHA256 = "^[0-9a-f]{64}$"
UNSPECIFIED = "unspecified"
# Which `benchmark_sha256` a release has; without the key it is the first, of the list of files alone.
SHA256_VERSION_KEY = "benchmark_sha256_version"
SHA256_VERSION: Literal[2] = 2
# Excluded from the second hash: itself, and the two by which parts name each other.
HASH_KEYS = ("benchmark_sha256", "private_benchmark_sha256", "public_benchmark_sha256")
DOWNLOAD_AGAIN = "make or download it again"


class ReleaseFile(Stored):
    """A JSON file of a release."""

    ADVICE: ClassVar[str] = DOWNLOAD_AGAIN
    ERROR: ClassVar[type[KinectBenchError]] = ReleaseError


class Distribution(StoredPart):
    """Whether the release may be distributed."""

    allowed: bool = Field(description="licence and source of every recording are stated")
    reasons: tuple[str, ...] = Field(description="why it may not, one line each")


class PairsInfo(StoredPart):
    """The settings of the pairs."""

    framing: Framing | None = Field(None, description="of every pair")
    partial_rule: PartialRule | None = Field(None, description="of every pair")
    min_containment: float = Field(description="least share of a partial inside its shape")


class SettingsInfo(StoredPart):
    """The settings that the release was built with, as in benchmark.yaml."""

    source: str | None = Field(None, description="who recorded the data, or where it is from")
    recordings: tuple[dict[str, object], ...] | None = Field(
        None, description="without their paths; null or missing: not made from recordings"
    )
    tracking: dict[str, object] | None = Field(None, description="of the camera's path")
    fusion: dict[str, object] | None = Field(None, description="of the TSDF fusion")
    segmentation: dict[str, object] | None = Field(None, description="of floor and object")
    views: dict[str, object] | None = Field(None, description="of the sampling of the views")
    pairs: PairsInfo = Field(description="of the pairs")
    publish: dict[str, object] | None = Field(None, description="of the release")


class RecordingInfo(StoredPart):
    """One recording of a release."""

    object: str = Field(description="the thing recorded")
    category: str = Field(description="such as chair")
    split: Split = Field(description="train, validation or test")
    pairs: int = Field(description="number of pairs published")
    refused: int = Field(description="frames that were refused as views, and views whose pair was refused")
    quality: QualityFile = Field(
        description="quality.json of its object, without `method`; empty if held back"
    )
    license: str = Field(UNSPECIFIED, description="of the recording's data")
    source: str = Field(UNSPECIFIED, description="who recorded it, or where it is from")
    poor: tuple[str, ...] = Field(
        (), description="limits of `publish.gate` that it does not keep; no figures where they are held back"
    )
    accepted: str | None = Field(None, description="why it is published all the same")
    look: tuple[str, ...] = Field(
        (), description="what a person should look at, and nobody has; no figures where they are held back"
    )
    reference: ReferenceInfo | None = Field(
        None,
        description="its truth beside a mesh of `compare-truth`; null or missing: not compared, or held back",
    )
    visible_share: float | None = Field(
        None,
        description="of the true surface, that a view saw: mean over the pairs; null or missing: held back, "
        "or not measured",
    )
    rebuilt_iou: float | None = Field(
        None,
        description="held back: IoU with the truth, where that is known, of a solid carved from all public "
        "views of the recording at their true poses",
    )
    rebuilt_single_iou: float | None = Field(
        None, description="the same of one view alone, mean over some of the views"
    )


class Flow(StoredPart):
    """The number of recordings tried, and their outcomes."""

    tried: int = Field(description="recordings of the benchmark")
    not_built: int = Field(description="of these, not built, or not asked for")
    failed: int = Field(description="whose build failed")
    rejected: int = Field(description="that a person rejected")
    below_limits: int = Field(description="that do not keep `publish.gate`")
    without_pair: int = Field(description="without a view that has a pair")
    of_one_object: int = Field(description="by `--isolate`: of whose object another view is published")
    published: int = Field(description="in this release")
    poor: int = Field(description="of those published, that do not keep `publish.gate`, and were let pass")
    look: int = Field(description="of those published, that a person should look at, and nobody has")

    @property
    def left_out(self) -> int:
        """The number of recordings that are not published."""
        steps = (self.not_built, self.failed, self.rejected, self.below_limits)
        return sum(steps) + self.without_pair + self.of_one_object


class ReleaseInfo(ReleaseFile):
    """The content of benchmark.json."""

    FILE: ClassVar[str] = BENCHMARK_JSON

    name: str = Field(description="of the benchmark")
    license: str = Field(description="of the data")
    format_version: int = Field(description="of the release's layout")
    package_version: str = Field(description="version of kinectbench that published it")
    benchmark_sha256: str = Field(
        pattern=SHA256,
        description="SHA-256 of SHA256SUMS without the line of benchmark.json, and of the rest of this file",
    )
    benchmark_sha256_version: Literal[2] | None = Field(
        None, description="how it is computed; missing: without the rest of this file"
    )
    framing: Framing = Field(description="of every pair")
    partial_rule: PartialRule = Field(description="of every pair")
    distribution: Distribution | None = Field(
        None, description="whether it may be given away; missing: published before there was the key"
    )
    settings: SettingsInfo = Field(description="those it was built with")
    packages: dict[str, str] = Field(description="versions of what the data was computed with")
    recordings: dict[str, RecordingInfo] = Field(description="by id")
    left_out: dict[str, str] | None = Field(
        None, description="recording that was built, or whose build failed, and is not published → why"
    )
    flow: Flow | None = Field(
        None, description="how many were tried, and what became of them; missing: not made from recordings"
    )
    version: str | None = Field(None, description="of the data")
    held_back: tuple[Split, ...] = Field((), description="splits of which only the inputs are here")
    isolated: tuple[str, ...] = Field(
        (), description="recordings of which one view is here, and nothing else that tells of the object"
    )
    surface_truth: tuple[Split, ...] = Field(
        (), description="splits whose truth is an open mesh, surfaces/<recording>.ply; their pairs are inputs"
    )
    private_benchmark_sha256: str | None = Field(
        None, pattern=SHA256, description="of the part that scores, in the part for everybody"
    )
    public_benchmark_sha256: str | None = Field(
        None, pattern=SHA256, description="of the part for everybody, in the part that scores"
    )

    @classmethod
    def parse(cls, text: str, where: str) -> Self:
        """Parse benchmark.json as `Stored.parse` does, but first refuse a file of another format version."""
        with contextlib.suppress(ValueError, AttributeError, RecursionError):
            version = strict_json(text).get("format_version")
            if version != FORMAT_VERSION:
                stated = version if version is None or type(version) is int else "unknown"
                raise ReleaseError(
                    f"{where}: format version {stated}; this package reads {FORMAT_VERSION}",
                    what="other-version",
                )
        return super().parse(text, where)

    @property
    def inputs_only(self) -> tuple[Split, ...]:
        """Splits whose pair files hold no ground truth: it is held back, or an open mesh in another file."""
        return (*self.held_back, *self.surface_truth)

    def hides(self, recording: str) -> bool:
        """Whether the release holds back a recording's ground truth; False for a recording not in it."""
        info = self.recordings.get(recording)
        return info is not None and info.split in self.held_back

    def has_solid(self, recording: str) -> bool:
        """Whether a recording's pair files hold its ground truth; True for a recording not in the release."""
        info = self.recordings.get(recording)
        return info is None or info.split not in self.inputs_only

    def isolates(self, recording: str) -> bool:
        """Whether the release holds one view of a recording and no truth; False in the private part."""
        return self.hides(recording) and recording in self.isolated


class PublishOptions(StoredPart):
    """Command-line options of `publish` that are not in benchmark.yaml."""

    hold_back: tuple[Split, ...] = Field(description="splits whose truth is held back")
    thresholds: str | None = Field(description="content of the threshold file; null: none was given")
    allow_poor: bool | None = Field(
        None, description="whether recordings that do not keep `publish.gate` are published, too"
    )
    isolate: bool | None = Field(
        None, description="whether one view of each object is published whose truth is held back"
    )


class PublishStamp(Stored):
    """build/publish.json: a record of the last publication; it is not part of the release."""

    FILE: ClassVar[str] = "publish.json"
    ERROR: ClassVar[type[KinectBenchError]] = ReleaseError

    fingerprint: str = Field(description="of the settings, the pairs' manifests and the options")
    options: PublishOptions = Field(description="what was asked for beyond the settings")
    benchmark_sha256: str = Field(description="of the release")
    pairs: int = Field(description="number of pairs published")
    recordings: tuple[str, ...] = Field(description="ids of those published")
    warnings: tuple[str, ...] = Field(description="one line each")
    private_sha256: str | None = Field(description="of the part that scores; null: nothing is held back")
    removed: tuple[str, ...] = Field(description="what was removed for privacy, one line each")
    unanswered: tuple[str, ...] = Field(description="questions of the datasheet, by key")
    refused: tuple[str, ...] = Field((), description="ids of those that did not keep `publish.gate`")
