"""A disk that fills up in the middle of each stage: rows of `cluster_faults.py`.

One line says that the disk is full, nothing is lost, and with more room the same bytes are made. For each
stage of `build`, and for `publish`, a small disk is mounted (tmpfs; needs root on Linux). It is as large as
everything that is there before the stage, and half of what the stage writes.
"""

import hashlib
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from fault_rows import Became, Bench, NotHereError, Row
from small_runs import copied, leftovers, make_small, published, start

from kinectbench.engine.stages import STAGES

PAGE = 4096
# Files that say when something was made, or by whom.
NOT_MADE = (".lock", "timing.json", "sources.json", "failed.json")
ROOMY = "size=200m"


def folders() -> dict[str, str]:
    """Stage -> its folder, in their order."""
    return {stage.name: f"build/chair/{stage.folder}" for stage in STAGES}


def filled_up(whole: Path, disk: Path, name: str) -> list[str]:
    """What was not as it should be when the disk filled up in this stage."""
    stages = folders()
    names = [*stages]
    before = [stages[n] for n in (names if name == "publish" else names[: names.index(name)])]
    after = "benchmark" if name == "publish" else stages[name]
    with mounted(disk, ROOMY) as place:
        root = copied(whole, place / "b", *before)
        disk_now = os.statvfs(place)
        pages = disk_now.f_blocks - disk_now.f_bfree + pages_of(whole / after) // 2
        remount(place, f"size={pages * PAGE}")
        kept = {path: hashes(root / path) for path in before}
        process = start(root, "publish" if name == "publish" else "build", "--jobs", "1")
        err = process.communicate()[1]
        problems = told_wrongly(process.returncode, err)
        problems += [f"{path} is not what it was" for path in before if hashes(root / path) != kept[path]]
        problems += [f"{path.name} is left over" for path in leftovers(root)]
        if (root / after).exists():
            problems.append(f"{after} is there")
        remount(place, ROOMY)
        published(root)
        for path in (*stages.values(), "benchmark"):
            if hashes(root / path) != hashes(whole / path):
                problems.append(f"{path}: other bytes after there was room")
    return problems


def told_wrongly(status: int, err: str) -> list[str]:
    """What is wrong with the exit status and the message."""
    lines = [line for line in err.splitlines() if "error: " in line]
    problems = [] if status == 1 else [f"exit status {status}"]
    if len(lines) != 1 or "the disk is full: free some space and run the command again" not in lines[0]:
        problems.append(f"said: {err.strip()!r}")
    return problems


def hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of every file that was made, by its path."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.name.endswith(NOT_MADE)
    }


def pages_of(folder: Path) -> int:
    """Pages that a tmpfs needs for the files of a folder."""
    return sum(-(-path.stat().st_size // PAGE) for path in folder.rglob("*") if path.is_file())


@contextmanager
def mounted(folder: Path, options: str) -> Iterator[Path]:
    """A small disk of our own.

    Raises:
        NotHereError: mounting is not permitted.
    """
    folder.mkdir(exist_ok=True)
    words = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    if sys.platform != "linux" or subprocess.run(words, capture_output=True, check=False).returncode:
        raise NotHereError(f"{folder}: a disk cannot be mounted here; run this as root on Linux")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def remount(folder: Path, options: str) -> None:
    subprocess.run(["mount", "-o", f"remount,{options}", str(folder)], check=True)


def filled_up_in(name: str, bench: Bench) -> Became:
    """What became of a benchmark of one recording when the disk filled up in this stage, or in `publish`."""
    whole = bench.folder / "one recording"
    if not whole.exists():
        published(make_small(whole, ("chair",)))
    return Became(same=["files of every stage"], wrong=filled_up(whole, bench.folder / "small disk", name))


DISKS: dict[str, Row] = {
    f"a full disk in {name}": partial(filled_up_in, name) for name in (*folders(), "publish")
}
