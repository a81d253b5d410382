"""A disk that fills up in the middle of each stage: one line, nothing lost, and later the same bytes.

For each stage of `build`, and for `publish`, a small disk of its own is mounted (tmpfs; needs root on Linux),
as large as all that is there before the stage and half of what the stage writes.
"""

import hashlib
import os
import subprocess
import sys
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from figures import Figure, arguments, equals, run, told
from small_runs import copied, leftovers, make_small, published, start

from kinectbench.core.errors import StorageError
from kinectbench.engine.stages import STAGES

PAGE = 4096
# Files that say when something was made, or by whom.
NOT_MADE = (".lock", "timing.json", "sources.json", "failed.json")
ROOMY = "size=200m"


def measure(_: Namespace) -> Iterator[Figure]:
    with TemporaryDirectory(prefix="kinectbench-disk-") as folder:
        whole = make_small(Path(folder) / "whole", ("chair",))
        published(whole)
        results = {name: filled_up(whole, Path(folder) / "disk", name) for name in (*folders(), "publish")}
    for name, problems in results.items():
        yield equals(f"disk full in {name}: what went wrong", "; ".join(problems) or "nothing", "nothing")
    yield told("disks filled", len(results))


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
        if path.is_file() and path.name not in NOT_MADE
    }


def pages_of(folder: Path) -> int:
    """Pages that a tmpfs needs for the files of a folder."""
    return sum(-(-path.stat().st_size // PAGE) for path in folder.rglob("*") if path.is_file())


@contextmanager
def mounted(folder: Path, options: str) -> Iterator[Path]:
    """A small disk of our own.

    Raises:
        StorageError: mounting is not permitted.
    """
    folder.mkdir(exist_ok=True)
    words = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    if sys.platform != "linux" or subprocess.run(words, capture_output=True, check=False).returncode:
        raise StorageError(f"{folder}: a disk cannot be mounted here; run this as root on Linux")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def remount(folder: Path, options: str) -> None:
    subprocess.run(["mount", "-o", f"remount,{options}", str(folder)], check=True)


if __name__ == "__main__":
    chosen = arguments(__doc__).parse_args()
    run(chosen, lambda: list(measure(chosen)))
