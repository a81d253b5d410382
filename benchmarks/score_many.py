"""A thousand scorings: 50 pairs repeated 20 times, voxel metrics only, from float16 .npy files at 256^3.

A release of 50 pairs of simple shapes is written; 20 methods take turns with two sets of
predictions, so that the disk need not hold 33 GB. Prints the time, whether it is linear in the pairs, the
memory of a worker, and whether the result depends on the number of workers.

    python benchmarks/score_many.py --jobs 2
"""

import os
import resource
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from builds import build_root
from figures import Figure, arguments, at_most, equals, run, told

from kinectbench.release.release import Release, open_release
from kinectbench.scoring.score import score
from kinectbench.scoring.table import scores_json

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from synthetic_release import publish_synthetic

PAIRS, REPEATS, SETS = 50, 20, 2
RECORDINGS = tuple(
    (f"{category}_{n:02d}", category, f"{category}_{n:02d}", "test", 5)
    for category in ("chair", "table")
    for n in range(5)
)
MAX_S = 60
MAX_NONLINEAR = 1.2
MAX_WORKER_MB = 1000


def write_predictions(release: Release, folder: Path) -> None:
    """Two sets: the blurred truth with noise, float16, 33 MB a pair."""
    for number in range(SETS):
        noise = np.random.default_rng(number).random((256,) * 3, np.float32)
        for target in release.targets:
            with np.load(release.pair_path(target)) as pair:
                full = np.unpackbits(pair["full"], axis=-1)
            path = folder / str(number) / target.recording / f"{target.view}.npy"
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, (0.6 * full + 0.4 * np.roll(noise, int(target.view), axis=2)).astype(np.float16))


def timed(release: Release, folders: Sequence[Path], jobs: int) -> tuple[float, float, list[str]]:
    """Wall and CPU seconds (of this process and its workers), and the tables."""
    started, before = time.monotonic(), _cpu_s()
    tables = [score(release, f, method="m", surface=False, jobs=jobs) for f in folders]
    return time.monotonic() - started, _cpu_s() - before, [scores_json(table) for table in tables]


def _cpu_s() -> float:
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def _peak_mb(who: int) -> float:
    return resource.getrusage(who).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)


def measure(root: Path, jobs: int) -> list[Figure]:
    release = open_release(publish_synthetic(root, RECORDINGS).folder)
    assert len(release.split("test")) == PAIRS
    write_predictions(release, root / "predictions")
    folders = [root / "predictions" / str(n % SETS) for n in range(REPEATS)]
    timed(release, folders[:1], jobs)  # compiled, and the files are in memory
    _, few_cpu_s, _ = timed(release, folders[: REPEATS // 4], jobs)
    wall_s, cpu_s, several = timed(release, folders, jobs)
    worker_mb = _peak_mb(resource.RUSAGE_CHILDREN)
    _, _, alone = timed(release, folders[:SETS], 1)
    count = REPEATS * PAIRS
    return [
        told("scorings, processes", [count, jobs]),
        at_most("wall clock, s", wall_s, MAX_S),
        told("cpu of all processes, s; a scoring, ms", [round(cpu_s, 1), round(1000 * cpu_s / count, 1)]),
        at_most("cpu of a scoring among 1000 against one among 250", cpu_s / 4 / few_cpu_s, MAX_NONLINEAR),
        at_most("peak memory of a worker, MB", worker_mb, MAX_WORKER_MB),
        at_most("peak memory of one process alone, MB", _peak_mb(resource.RUSAGE_SELF), MAX_WORKER_MB),
        equals("tables of one process and of several are the same", alone == several[:SETS], True),
    ]


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: 2)")
    options = parser.parse_args()
    with build_root(None) as root:
        run(options, lambda: measure(root, options.jobs))


if __name__ == "__main__":
    main()
