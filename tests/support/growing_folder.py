"""A small recording that grows, and what a build takes of it while it is being written."""

from pathlib import Path

import pytest
from made_once import made_once
from small_runs import make_small

from kinectbench.record.build_process import GrowingBuild
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import write_sequence

FRAMES = 16


def recorded_once(factory: pytest.TempPathFactory) -> Path:
    """`out`, 16 frames of a chair, and `sequence`, what `ingest` makes of it."""

    def make(to: Path) -> None:
        (make_small(to, ("chair",)) / "recordings/chair").rename(to / "out")
        write_sequence(open_recording(to / "out"), to / "sequence")

    return made_once(factory, "partial", make)


def all_taken(folder: Path, stored: Path, *, whole: bool) -> GrowingBuild:
    """A folder of which all is taken that can be."""
    growing = GrowingBuild(folder, stored)
    growing.read_again()
    while growing.take(whole=whole):
        pass
    return growing


def contents(folder: Path) -> dict[str, bytes]:
    """The bytes of all files by their names, without the time that was taken."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file() and path.name != "timing.json")
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}
