"""Records beside the results of a build: inputs, files and duration of each stage, and why a run failed."""

from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from pydantic import Field, JsonValue

from kinectbench.core.artefacts.stored import Stored, optional
from kinectbench.core.storage import canonical_json
from kinectbench.core.untrusted import read_plain_text
from kinectbench.core.untrusted_text import strict_json


class Manifest(Stored):
    """manifest.json of an artefact: the inputs that it was made from, and the files that it must hold."""

    FILE: ClassVar[str] = "manifest.json"

    format_version: int = Field(description="version of this file's format")
    package_version: str = Field(description="version of KinectBench that made the artefact")
    stage: str = Field(description="name of the stage")
    stage_version: int | None = optional("version of the stage's algorithm")
    fingerprint: str = Field(description="SHA-256 of the format version, stage, version, settings and inputs")
    settings: dict[str, JsonValue] = Field(description="the settings that the stage depends on")
    inputs: dict[str, str] = Field(description="fingerprint of each input, by name")
    files: dict[str, int] = Field(description="file sizes, bytes, by path below the folder")
    removed: int | None = optional(
        "number of files that `fetch --stream` deleted after the build; absent if none"
    )
    content: str | None = Field(
        None,
        pattern="^[0-9a-f]{64}$",
        description="in a store: SHA-256 over the files' SHA-256, and the name of the folder that holds them",
    )


class Timing(Stored):
    """timing.json of an artefact: how long its stage took; it is part of no fingerprint."""

    FILE: ClassVar[str] = "timing.json"

    seconds: float = Field(description="how long the stage took, seconds")


class Failed(Stored):
    """failed.json of `build/<recording>/`: why its last run failed; deleted once that stage succeeds."""

    FILE: ClassVar[str] = "failed.json"

    format_version: int = Field(1, description="version of this file's format")
    stage: str | None = Field(description="stage that failed; null: its process was killed")
    error: str = Field(description="error message, one line")
    code: str | None = optional("error code in docs/errors.md")
    fingerprint: str | None = optional(
        "fingerprint of what would fail again: not retried until it or `package_version` "
        "changes; null where a retry may succeed (full disk, killed process)"
    )
    package_version: str | None = optional("version of kinectbench that failed")
    scan_sha256: str | None = optional("SHA-256 over the scan's files, if `fetch --stream` deleted them")


class SourceFile(NamedTuple):
    """Size, times and hash of a recording's file when it was hashed.

    Attributes:
        size: bytes.
        mtime_ns: time of the last change of its content, nanoseconds; a copy may keep it.
        sha256: SHA-256 of the content, hex.
        ctime_ns: time of the last change of the file on this disk, nanoseconds; 0 if unknown.
    """

    size: int
    mtime_ns: int
    sha256: str
    ctime_ns: int = 0


class Sources(Stored):
    """sources.json of `build/<recording>/`: size, times and hash of each file, by its name.

    A recording that is a single file has the name "". masks.sources.json and reference.sources.json beside it
    have the same form. They list the masks that the user supplies, and the reference mesh.
    """

    FILE: ClassVar[str] = "sources.json"
    __pydantic_extra__: dict[str, SourceFile]

    @classmethod
    def unchecked(cls, path: Path) -> Any:
        """Read the JSON of a sources.json without validation, because that is slow for thousands of rows.

        Raises:
            OSError, ValueError, RecursionError: the file cannot be read, or is no JSON of bounded size.
        """
        return strict_json(read_plain_text(path, cls.MAX_BYTES), cls.MAX_VALUES)

    @property
    def files(self) -> dict[str, SourceFile]:
        """Size, times and hash of each file, by its name relative to the recording."""
        return self.__pydantic_extra__

    @property
    def sha256(self) -> dict[str, str]:
        """SHA-256 of each file, by its name relative to the recording."""
        return {name: file.sha256 for name, file in self.files.items()}

    def text(self) -> str:
        """Return the JSON text of the file, compact and on one line: there may be thousands of entries."""
        return canonical_json(self.json_value())
