"""sources.lock beside a recipe's sources.yaml, and index.json, the list of scans that a source offers."""

from typing import ClassVar

from pydantic import Field

from kinectbench.core.artefacts.stored import Bare, Stored, StoredPart
from kinectbench.core.errors import KinectBenchError, SettingsError
from kinectbench.core.names import Name


class LockedFile(StoredPart):
    """Size and hash of a file at its first download."""

    bytes: int = Field(ge=0, description="size of the file, bytes")
    sha256: str = Field(pattern="^[0-9a-f]{64}$", description="SHA-256 of its content")


class SourcesLock(Stored):
    """sources.lock of a recipe: size and hash of each file; later downloads must equal the first."""

    FILE: ClassVar[str] = "sources.lock"
    ADVICE: ClassVar[str] = "take it from where the recipe is from, or remove it to lock what comes next"
    ERROR: ClassVar[type[KinectBenchError]] = SettingsError

    format_version: int = Field(1, description="version of this file's format")
    files: dict[str, LockedFile] = Field({}, description="files by their names below the recipe's addresses")


class ScanIndex(Bare):
    """index.json: the ids of a source's scans by the source's own categories."""

    FILE: ClassVar[str] = "index.json"
    ADVICE: ClassVar[str] = 'wanted {"category": ["id", …]}; correct `index` in sources.yaml'
    ERROR: ClassVar[type[KinectBenchError]] = SettingsError

    scans: dict[str, list[Name]] = Field(description="ids of scans, by the source's word for a category")
