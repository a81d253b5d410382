"""The input of a stage's step: only values in the stage's fingerprint."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from kinectbench.core.types import Progress
from kinectbench.engine.stage_settings import StageSettings

# The name of the source that a person's masks are.
MASKS = "masks"
# The name of the source that is a mesh in place of the fused truth.
REFERENCE = "reference"
Needed = TypeVar("Needed", bound=StageSettings)


@dataclass(frozen=True)
class Source:
    """An input of a stage from outside `build/`: the recording, a person's masks, or a reference mesh.

    Attributes:
        path: the file or folder.
        sha256: one hash over the names and contents of its files.
    """

    path: Path
    sha256: str


@dataclass(frozen=True)
class Work(Generic[Needed]):
    """The inputs of one stage.

    Attributes:
        settings: those that the stage depends on.
        stages: by their names the folders of the stages that it stands on, and of no others.
        sources: by their names those whose hashes are in the stage's fingerprint, and no others.
        folder: to be filled; it is empty.
        progress: called with (done, total).
    """

    settings: Needed
    stages: Mapping[str, Path]
    sources: Mapping[str, Source]
    folder: Path
    progress: Progress

    @property
    def masks(self) -> Path | None:
        """The folder of a person's masks, if the stage depends on one."""
        return self.sources[MASKS].path if MASKS in self.sources else None
