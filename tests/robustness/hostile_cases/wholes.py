"""Undamaged inputs: a release with predictions and scores, a built benchmark, recordings of all formats."""

import shutil
from importlib.util import find_spec
from pathlib import Path

RELEASE, BUILT = "release", "built"


def make_wholes(folder: Path) -> None:
    """`release/` (with predictions, scores and more), `built/`, `method/` and `<format>/`."""
    from fuzz.recordings import RECORDINGS
    from fuzz.tables import TABLES_FUZZER
    from small_runs import make_small, published

    TABLES_FUZZER.make(folder)
    (folder / "whole").rename(folder / RELEASE)
    RECORDINGS.make(folder)
    published(make_small(folder / BUILT, ("chair",)))
    if find_spec("torch"):
        from hostile_cases.methods import METHOD, make_method

        make_method(folder / METHOD)


def put_whole(folder: Path, name: str, work: Path) -> None:
    """A copy of an undamaged input, in a folder that does not exist."""
    if name:
        shutil.copytree(folder / name, work, symlinks=True)
    else:
        work.mkdir()
