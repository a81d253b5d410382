"""benchmark.json: what a release says of itself, as a typed value."""

import json
from pathlib import Path
from typing import Any, NoReturn

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from kinectbench.config import Framing, PartialRule, Split
from kinectbench.errors import ReleaseError
from kinectbench.release.layout import BENCHMARK_JSON, FORMAT_VERSION

SHA256 = "^[0-9a-f]{64}$"


class _Open(BaseModel):
    """Typed where this package reads it; other keys are kept as they are."""

    model_config = ConfigDict(extra="allow", frozen=True)


class RecordingInfo(_Open):
    """One recording of a release."""

    object: str = Field(description="the thing recorded")
    category: str = Field(description="such as chair")
    split: Split = Field(description="train, validation or test")
    pairs: int = Field(description="pairs published")
    refused: int = Field(description="frames that were refused as views, and views whose pair was refused")
    quality: dict[str, Any] = Field(description="quality.json of the recording's object; empty if held back")
    license: str = Field("unspecified", description="of the recording's data")
    source: str = Field("unspecified", description="who recorded it, or where it is from")


class PairChecks(_Open):
    """The settings of the pairs."""

    min_containment: float = Field(description="least share of a partial inside its shape")


class SettingsInfo(_Open):
    """The settings the release was built with."""

    pairs: PairChecks


class Distribution(_Open):
    """Whether the release may be given away."""

    allowed: bool = Field(description="licence and source of every recording are stated")
    reasons: tuple[str, ...] = Field(description="why it may not, one line each")


class ReleaseInfo(_Open):
    """All of benchmark.json."""

    name: str = Field(description="of the benchmark")
    license: str = Field(description="of the data")
    format_version: int = Field(description="of the release's layout")
    package_version: str = Field(description="kinectbench that published it")
    benchmark_sha256: str = Field(pattern=SHA256, description="see layout.py")
    framing: Framing = Field(description="of every pair")
    partial_rule: PartialRule = Field(description="of every pair")
    settings: SettingsInfo
    packages: dict[str, str] = Field(description="versions of what the data was computed with")
    recordings: dict[str, RecordingInfo]
    version: str | None = Field(None, description="of the data")
    distribution: Distribution | None = Field(None, description="null: published before it was asked for")
    held_back: tuple[Split, ...] = Field((), description="splits of which only the inputs are here")
    private_benchmark_sha256: str | None = Field(None, pattern=SHA256, description="the part that scores")
    public_benchmark_sha256: str | None = Field(None, pattern=SHA256, description="the part for everybody")


def read_metadata(folder: Path) -> ReleaseInfo:
    """Read benchmark.json of a release.

    Raises:
        ReleaseError: it is missing, malformed, or of another format version.
    """
    path = folder / BENCHMARK_JSON
    return parse_metadata(read_text(path), str(path))


def parse_metadata(text: str, path: str) -> ReleaseInfo:
    """Parse benchmark.json.

    Raises:
        ReleaseError: malformed, or of another format version; the line begins with `path`.
    """
    content = strict_json(text, path)
    version = content.get("format_version") if isinstance(content, dict) else None
    if version != FORMAT_VERSION:
        raise ReleaseError(f"{path}: format version {version}; this package reads {FORMAT_VERSION}")
    try:
        return ReleaseInfo.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise ReleaseError(f"{path}: '{key}': {first['msg']}; download the release again") from error


def read_text(path: Path) -> str:
    """A UTF-8 text file of a release or a build.

    Raises:
        ReleaseError: it cannot be read.
    """
    try:
        return path.read_bytes().decode()
    except FileNotFoundError:
        raise ReleaseError(f"{path}: missing; make or download it again") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ReleaseError(f"{path}: cannot be read ({error}); make or download it again") from error


def strict_json(text: str, where: str) -> Any:
    """Parse JSON without NaN and infinities.

    Raises:
        ReleaseError: it is malformed; the line begins with `where`.
    """

    def refuse(constant: str) -> NoReturn:
        raise ValueError(f"{constant} is not JSON")

    try:
        return json.loads(text, parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise ReleaseError(f"{where}: not valid JSON ({error}); make or download it again") from error
