"""What a Dask cluster on this machine costs beside the processes that `build` starts itself, on whole builds.

Twenty recordings of the samples' size are built as far as their pairs, by two processes and by
`--cluster local:2` in turn. Processor time is compared, which others at work here change little, and wall
time, which they do change.
"""

import json
import os
import resource
import shutil
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from figures import Figure, arguments, at_most, equals, run, told
from small_runs import start

from kinectbench.core.errors import KinectBenchError
from kinectbench.core.storage import sha256_file
from kinectbench.lab.simulate.presets import SAMPLES
from kinectbench.lab.simulate.simulate import simulate

WAYS = {"two processes": ("--jobs", "2"), "--cluster local:2": ("--cluster", "local:2")}


def options() -> ArgumentParser:
    parser = arguments(__doc__)
    parser.add_argument("--recordings", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=1, help="of each way, in turn; default: 1")
    return parser


def measure(chosen: Namespace) -> Iterator[Figure]:
    with TemporaryDirectory(prefix="kinectbench-overhead-") as folder:
        root = make(Path(folder), chosen.recordings)
        taken: dict[str, list[tuple[float, float, str]]] = {way: [] for way in WAYS}
        for _ in range(chosen.rounds):
            for way, words in WAYS.items():
                taken[way].append(built(root, words))
    for way, rounds in taken.items():
        yield told(f"{way}: wall, s", [round(wall_s, 1) for wall_s, _, _ in rounds])
        yield told(f"{way}: CPU, s", [round(cpu_s, 1) for _, cpu_s, _ in rounds])
    pool, cluster = taken.values()
    yield equals("the same bytes", len({sums for _, _, sums in pool + cluster}), 1)
    for number, what in enumerate(("wall", "CPU")):
        ratio = median(row[number] for row in cluster) / median(row[number] for row in pool)
        yield at_most(f"{what}, cluster over processes", round(ratio, 3), 1.05)


def make(root: Path, number: int) -> Path:
    """The sample chair under so many ids."""
    simulate(SAMPLES["chair_01"], root / "recordings" / "r00")
    for each in range(1, number):
        shutil.copytree(
            root / "recordings" / "r00", root / "recordings" / f"r{each:02}", copy_function=os.link
        )
    recordings = [
        {"id": f"r{each:02}", "path": f"recordings/r{each:02}", "category": "chair"} for each in range(number)
    ]
    text = json.dumps({"name": "overhead", "license": "CC0-1.0", "recordings": recordings})
    (root / "benchmark.yaml").write_text(text)
    return root


def built(root: Path, words: tuple[str, ...]) -> tuple[float, float, str]:
    """Build all anew: wall seconds, seconds of all processors, and the pairs' manifests in one text."""
    shutil.rmtree(root / "build", ignore_errors=True)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    started = time.monotonic()
    process = start(root, "build", *words)
    _, err = process.communicate()
    if process.returncode:
        raise KinectBenchError(f"build {' '.join(words)} ended with {process.returncode}: {err[-400:]}")
    wall_s = time.monotonic() - started
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    sums = [sha256_file(each) for each in sorted(root.glob("build/*/pairs/manifest.json"))]
    return wall_s, cpu_s, " ".join(sums)


if __name__ == "__main__":
    chosen = options().parse_args()
    run(chosen, lambda: list(measure(chosen)))
