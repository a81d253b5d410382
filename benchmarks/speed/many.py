"""Ten thousand recordings: each command's time and memory, and whether it is linear in the recordings.

Twenty tiny simulated recordings (12 frames of 64 x 48, one view each) are built once. They and their
artefacts are then linked under as many ids as asked for: a fingerprint names no id, and a hard link has the
time of its file, so that `build` believes them. Every command runs as a process of its own; its CPU time and
its largest memory are those of it and its processes, as the system counts them.

    python benchmarks/run.py many 1000 10000 --build DIR
"""

import argparse
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from builds import build_root
from figures import Figure, arguments, at_most, run, stated

from kinectbench.cli.common import SOME_FAILED
from kinectbench.core.errors import KinectBenchError

FAMILIES = ("chair", "table")
# Of so many candidates the first that have a pair are taken: of some shapes no image is large enough.
CANDIDATES, ORIGINALS = 26, 20
FRAMES, WIDTH, HEIGHT = 12, 64, 48
# What lets so small images through the checks; it changes nothing that is measured.
SETTINGS = (
    "views.count=1",
    "views.min_pixels=16",
    "fusion.voxel_size_m=0.02",
    "fusion.scene_voxel_size_m=0.04",
    "tracking.check_stride_px=1",
    "tracking.max_disagreement_m=0.5",
    "pairs.min_containment=0.1",
    "pairs.max_residual_m=1",
    "pairs.min_visible_share=0",
)
CHEAP = ("--no-surface", "--no-baselines")
# Command → most milliseconds of CPU time for each recording, which has one pair; None: only stated.
STEPS: Mapping[str, tuple[tuple[str, ...], float | None]] = {
    "init": (("init", ".", "--force"), None),
    "build, nothing to do": (("build", "--jobs", "1"), 2),
    "publish": (("publish", "--jobs", "1"), 20),
    "verify": (("verify", "benchmark"), 100),
    "verify --checksums": (("verify", "benchmark", "--checksums"), 5),
    "score": (("score", "predictions/net", "--benchmark", "benchmark", "--jobs", "1", *CHEAP), None),
    "report": (("report",), None),
}
TAKES_SETTINGS = ("build", "publish", "report")
MOST_GROWTH = 1.1


@dataclass(frozen=True)
class Cost:
    """What a command took: CPU time and wall time in seconds, and its largest memory in MB."""

    cpu_s: float
    wall_s: float
    peak_mb: float


def originals(root: Path) -> list[Path]:
    """The recordings that all others are links to, simulated and built; they stay for the next time.

    Raises:
        KinectBenchError: one of them cannot be built.
    """
    from kinectbench.lab.simulate.simulate import simulate
    from kinectbench.lab.simulate.spec import SimulationSpec

    folders = [root / "recordings" / f"original_{n:02d}" for n in range(CANDIDATES)]
    for n, folder in enumerate(folders):
        if not folder.is_dir():
            spec = {
                "object": f"{FAMILIES[n % 2]}:seed={n}",
                "path": {"frames": FRAMES, "rate_hz": 3.0, "arc_rad": 3.0, "shake_m": 0.0, "shake_rad": 0.0},
                "sensor": {"width": WIDTH, "height": HEIGHT, "model": "ideal"},
                "scene": {"clutter": 0},
                "save_depth": False,
            }
            simulate(SimulationSpec.model_validate(spec), folder)
    if not (root / "benchmark.yaml").is_file():
        called(root, "init", ".")
        called(root, "build", "--jobs", "2", *set_options(), statuses=(0, SOME_FAILED))
    whole = [folder for folder in folders if (root / "build" / folder.name / "pairs" / "000.npz").is_file()]
    if len(whole) < ORIGINALS:
        raise KinectBenchError(f"{root}: {len(whole)} recordings have a pair, not {ORIGINALS}")
    return whole[:ORIGINALS]


def prepare(first: Path, root: Path, count: int) -> None:
    """Make the originals, and link them so many times."""
    linked(originals(first), first, root, count)


def linked(folders: Sequence[Path], built: Path, root: Path, count: int) -> None:
    """Recordings, artefacts and predictions of so many ids, as links to those of the originals."""
    shutil.rmtree(root, ignore_errors=True)
    cells = np.zeros((256, 256, 256), bool)
    cells[96:160, 96:160, 96:160] = True
    prediction = root / "cube.npy"
    root.mkdir(parents=True)
    np.save(prediction, cells)
    for n in range(count):
        original, name = folders[n % len(folders)], f"thing_{n:05d}"
        _link(original, root / "recordings" / name)
        _link(built / "build" / original.name, root / "build" / name)
        (root / "predictions" / "net" / name).mkdir(parents=True)
        os.link(prediction, root / "predictions" / "net" / name / "000.npy")


def _link(source: Path, target: Path) -> None:
    shutil.copytree(source, target, copy_function=os.link, ignore=shutil.ignore_patterns(".lock"))


def set_options() -> Iterator[str]:
    """The settings as options."""
    for setting in SETTINGS:
        yield from ("--set", setting)


def called(root: Path, *arguments: str, statuses: Sequence[int] = (0,)) -> Cost:
    """Run a command in a folder, and say what it took.

    Raises:
        KinectBenchError: it failed.
    """
    log = root / f"{arguments[0]}.log"
    started = time.monotonic()
    with log.open("wb") as out:
        command = [sys.executable, "-m", "kinectbench", *arguments]
        process = subprocess.Popen(command, cwd=root, stdin=subprocess.DEVNULL, stdout=out, stderr=out)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in statuses:
        raise KinectBenchError(f"{arguments[0]}: ended with {process.returncode}; {log} says why")
    return Cost(used.ru_utime + used.ru_stime, time.monotonic() - started, used.ru_maxrss / 1024)


def measured(root: Path, count: int, only: Sequence[str]) -> dict[str, Cost]:
    """What each command takes of so many recordings."""
    there = root / str(count)
    # In a process of its own: Linux counts the memory of who starts a command as the command's.
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        pool.submit(prepare, root / "originals", there, count).result()
    costs = {}
    for name, (command, _) in STEPS.items():
        if only and command[0] not in only:
            continue
        more = set_options() if command[0] in TAKES_SETTINGS else ()
        costs[name] = called(there, *command, *more)
        print(count, name, costs[name], file=sys.stderr, flush=True)
    return costs


def figures(costs: Mapping[int, Mapping[str, Cost]]) -> list[Figure]:
    """Times a recording and memory of each command and count, and how the times grow with the count."""
    found = []
    for name, (_, most_ms) in STEPS.items():
        for count, cost in ((count, of[name]) for count, of in costs.items() if name in of):
            what = f"{name}, {count} recordings"
            each = round(1000 * cost.cpu_s / count, 2)
            cpu = f"{what}: CPU, ms each"
            found.append(stated(cpu, each) if most_ms is None else at_most(cpu, each, most_ms))
            found.append(stated(f"{what}: wall, s", round(cost.wall_s, 1)))
            found.append(stated(f"{what}: memory, MB", round(cost.peak_mb)))
        for few, many in pairwise(sorted(count for count in costs if name in costs[count])):
            growth = costs[many][name].cpu_s / costs[few][name].cpu_s / (many / few)
            what = f"{name}: time each of {many} recordings by that of {few}"
            found.append(at_most(what, round(growth, 3), MOST_GROWTH))
    return found


def main() -> None:
    """Measure the commands and print the table."""
    parser: argparse.ArgumentParser = arguments(__doc__)
    parser.add_argument("counts", type=int, nargs="+", help="recordings, such as 1000 10000")
    parser.add_argument("--only", nargs="+", default=(), metavar="COMMAND", help="of these commands alone")
    parser.add_argument("--build", type=Path, metavar="DIR", help="work there and keep it")
    options = parser.parse_args()
    with build_root(options.build) as root:
        root = root.resolve()
        run(options, lambda: figures({n: measured(root, n, options.only) for n in options.counts}))


if __name__ == "__main__":
    main()
