"""benchmark.json, the description of a release, and publish.json, the record of the last publication."""

import contextlib
from typing import ClassVar, Literal, Self

from pydantic import Field

from kinectbench._version import __version__
from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.reference import ReferenceInfo
from kinectbench.core.artefacts.stored import JSON_BYTES, Count, Share, Stored, StoredPart, optional
from kinectbench.core.errors import KinectBenchError, ReleaseError
from kinectbench.core.types import Framing, PartialRule, Split
from kinectbench.core.untrusted_text import strict_json

FORMAT_VERSION = 1
# What `publish` writes, its texts and schemas included: raised by one when any of that changes.
PUBLISH_VERSION = 51
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

    allowed: bool = Field(description="whether licence and source of every recording are stated")
    reasons: tuple[str, ...] = Field(description="reasons against distribution, one line each")


class PairsInfo(StoredPart):
    """The settings of the pairs."""

    framing: Framing | None = optional("what pairs' cubes are fitted to")
    partial_rule: PartialRule | None = optional("rule for reducing partials to 64^3")
    min_containment: Share = Field(description="least share of a partial's cells inside its shape")


class SettingsInfo(StoredPart):
    """The settings that the release was built with, as in benchmark.yaml."""

    source: str | None = optional("who recorded the data, or where it is from")
    recordings: tuple[dict[str, object], ...] | None = optional(
        "recordings' entries, without their paths; null or missing: not made from recordings"
    )
    tracking: dict[str, object] | None = optional("camera tracking settings")
    fusion: dict[str, object] | None = optional("TSDF fusion settings")
    segmentation: dict[str, object] | None = optional("floor and object settings")
    views: dict[str, object] | None = optional("view sampling settings")
    pairs: PairsInfo = Field(description="pair settings")
    publish: dict[str, object] | None = optional("publication settings")


class RecordingInfo(StoredPart):
    """One recording of a release."""

    object: str = Field(description="the thing recorded")
    category: str = Field(description="such as chair")
    split: Split = Field(description="train, validation or test")
    pairs: Count = Field(description="number of pairs published")
    refused: Count = Field(description="frames that were refused as views, and views whose pair was refused")
    quality: QualityFile = Field(
        description="quality.json of its object, without `method`; empty if held back"
    )
    license: str = Field(UNSPECIFIED, description="its data's licence")
    source: str = Field(UNSPECIFIED, description="who recorded it, or where it is from")
    poor: tuple[str, ...] = Field(
        (), description="limits of `publish.gate` that it violates; without figures where these are held back"
    )
    accepted: str | None = optional("reason for publishing it nevertheless")
    look: tuple[str, ...] = Field(
        (), description="reasons for a review still missing; without figures where these are held back"
    )
    reference: ReferenceInfo | None = optional(
        "comparison of its truth with a mesh, by `compare-truth`; null or missing: not compared, or held back"
    )
    visible_share: Share | None = optional(
        "share of the true surface that a view saw, mean over the pairs; null or missing: held "
        "back, or not measured"
    )
    rebuilt_iou: Share | None = optional(
        "truth held back: IoU, where truth is known, of a solid carved from all the recording's "
        "public views at their true poses"
    )
    rebuilt_single_iou: Share | None = optional("the same IoU from one view alone, mean over some views")


class Flow(StoredPart):
    """The number of recordings tried, and their outcomes."""

    tried: Count = Field(description="recordings of the benchmark")
    not_built: Count = Field(description="recordings not built, or not requested")
    failed: Count = Field(description="recordings whose build failed")
    rejected: Count = Field(description="recordings that a person rejected")
    below_limits: Count = Field(description="recordings that violate `publish.gate`")
    without_pair: Count = Field(description="recordings without any pair")
    of_one_object: Count = Field(
        description="recordings left out by `--isolate`: another shows the same object"
    )
    published: Count = Field(description="recordings in this release")
    poor: Count = Field(description="recordings published though they violate `publish.gate`")
    look: Count = Field(description="recordings published that still need a person's review")

    @property
    def left_out(self) -> int:
        """The number of recordings that are not published."""
        steps = (self.not_built, self.failed, self.rejected, self.below_limits)
        return sum(steps) + self.without_pair + self.of_one_object


class ReleaseInfo(ReleaseFile):
    """The content of benchmark.json."""

    FILE: ClassVar[str] = BENCHMARK_JSON

    name: str = Field(description="the benchmark's name")
    license: str = Field(description="the data's licence")
    format_version: int = Field(description="version of the release's layout")
    package_version: str = Field(description="version of kinectbench that published it")
    publish_version: int | None = optional("version of what `publish` writes")
    benchmark_sha256: str = Field(
        pattern=SHA256,
        description="SHA-256 of SHA256SUMS without the line of benchmark.json, and of the rest of this file",
    )
    benchmark_sha256_version: Literal[2] | None = optional(
        "how `benchmark_sha256` is computed; missing: without the rest of this file"
    )
    framing: Framing = Field(description="what pairs' cubes are fitted to")
    partial_rule: PartialRule = Field(description="rule for reducing partials to 64^3")
    distribution: Distribution | None = optional(
        "whether the release may be distributed; missing: published before there was the key"
    )
    settings: SettingsInfo = Field(description="settings of the build")
    packages: dict[str, str] = Field(description="versions of the packages that computed the data")
    recordings: dict[str, RecordingInfo] = Field(description="recordings by id")
    left_out: dict[str, str] | None = optional(
        "recording built, or whose build failed, but not published → why"
    )
    flow: Flow | None = optional(
        "numbers of recordings tried, and their outcomes; missing: not made from recordings"
    )
    version: str | None = optional("the data's version")
    held_back: tuple[Split, ...] = Field((), description="splits of which only the inputs are here")
    isolated: tuple[str, ...] = Field(
        (), description="recordings of which one view is here, and nothing else that shows the object"
    )
    surface_truth: tuple[Split, ...] = Field(
        (),
        description="splits whose truth is an open mesh, surfaces/<recording>.ply; their pairs are inputs "
        "only",
    )
    private_benchmark_sha256: str | None = Field(
        None,
        pattern=SHA256,
        description="in the public part: `benchmark_sha256` of the private part, which scores",
    )
    public_benchmark_sha256: str | None = Field(
        None, pattern=SHA256, description="in the private part: `benchmark_sha256` of the public part"
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
        """Splits whose pair files lack the truth: it is held back, or is an open mesh in another file."""
        return (*self.held_back, *self.surface_truth)

    @property
    def of_this_version(self) -> bool:
        """Whether this version of the package published the release, of recordings: it can be made again."""
        versions = self.package_version, self.publish_version
        return versions == (__version__, PUBLISH_VERSION) and bool(self.settings.recordings)

    def hides(self, recording: str) -> bool:
        """Whether the release holds back a recording's ground truth; False for a recording not in it."""
        info = self.recordings.get(recording)
        return info is not None and info.split in self.held_back

    def has_solid(self, recording: str) -> bool:
        """Whether a recording's pair files hold its ground truth; True for a recording not in the release."""
        info = self.recordings.get(recording)
        return info is None or info.split not in self.inputs_only

    def isolates(self, recording: str) -> bool:
        """Whether the release has one view of a recording without its truth; False in the private part."""
        return self.hides(recording) and recording in self.isolated


class PublishOptions(StoredPart):
    """Command-line options of `publish` that are not in benchmark.yaml."""

    hold_back: tuple[Split, ...] = Field(description="splits whose truth is held back")
    thresholds: str | None = Field(description="content of the threshold file; null: none was given")
    allow_poor: bool | None = optional("whether recordings that violate `publish.gate` are published, too")
    isolate: bool | None = optional("whether of each object with held-back truth only one view is published")


class PublishStamp(Stored):
    """build/publish.json: a record of the last publication; it is not part of the release."""

    FILE: ClassVar[str] = "publish.json"
    MAX_TEXT: ClassVar[int] = JSON_BYTES  # a whole threshold file is one text in it
    ERROR: ClassVar[type[KinectBenchError]] = ReleaseError

    fingerprint: str = Field(description="fingerprint of the settings, the pairs' manifests and the options")
    options: PublishOptions = Field(description="options requested beyond the settings")
    benchmark_sha256: str = Field(description="`benchmark_sha256` of the release")
    pairs: Count = Field(description="number of pairs published")
    recordings: tuple[str, ...] = Field(description="ids of the published recordings")
    warnings: tuple[str, ...] = Field(description="warnings, one line each")
    private_sha256: str | None = Field(
        description="`benchmark_sha256` of the private part, which scores; null: nothing is held back"
    )
    removed: tuple[str, ...] = Field(description="what was removed for privacy, one line each")
    unanswered: tuple[str, ...] = Field(description="keys of the datasheet's questions without an answer")
    refused: tuple[str, ...] = Field((), description="ids of the recordings that violate `publish.gate`")
    shortened: bool = Field(False, description="whether further warnings of recordings are left out")
