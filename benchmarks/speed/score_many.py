"""A thousand scorings: 50 pairs repeated 20 times, voxel metrics only, from float16 .npy files at 256^3.

A release of 50 pairs of simple shapes is written with a prediction of each; a repeated pair is a target of
its own, its prediction a hard link, so that the disk need not hold 33 GB. All are scored as one run. Prints
the time, whether it is linear in the pairs, the memory of a worker, and whether the result depends on the
number of workers. Then the table of 100,000 pairs is made of what was counted of those 50, written and read.

    python benchmarks/run.py score_many --jobs 2
"""

import copy
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from builds import build_root
from figures import Figure, arguments, at_most, equals, run, stated
from memory import peak_mb, watched_workers
from synthetic_release import publish_synthetic

from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.engine.processes import submit_all, worker_pool
from kinectbench.release.release import Release, Target, open_release
from kinectbench.scoring.assemble import describe, make_table
from kinectbench.scoring.base_rates import base_rates
from kinectbench.scoring.pair_result import PairJob, count_job
from kinectbench.scoring.read_table import read_table
from kinectbench.scoring.score import counting_of, score
from kinectbench.scoring.thresholds import Thresholds

PAIRS, REPEATS = 50, 20
VIEWS = 5
MAX_S = 60
MAX_NONLINEAR = 1.2
MAX_WORKER_MB = 1000
TABLE_PAIRS = 100_000
MAX_TABLE_MB = 2000


def prepare(root: Path) -> None:
    """Publish the pairs and predict each: the truth with noise, float16, 33 MB."""
    count = PAIRS // VIEWS
    recordings = [
        (f"thing_{n:02d}", ("chair", "table")[n % 2], f"thing_{n:02d}", "test") for n in range(count)
    ]
    release = open_release(publish_synthetic(root, tuple((*r, VIEWS) for r in recordings)).folder)
    noise = np.random.default_rng(0).random((256,) * 3, np.float32)
    for number, target in enumerate(release.targets):
        with np.load(release.pair_path(target)) as pair:
            full = np.unpackbits(pair["full"], axis=-1)
        path = prediction_file(root, target)
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, (0.6 * full + 0.4 * np.roll(noise, number, axis=2)).astype(np.float16))


def prediction_file(root: Path, target: Target) -> Path:
    """Where a prediction lies."""
    return root / "predictions" / target.recording / f"{target.view}.npy"


def repeated(root: Path, release: Release, times: int) -> Release:
    """The release with every pair repeated, each time under another name."""
    targets = []
    for n in range(times):
        for target in release.targets:
            name = f"{target.recording}_{n:02d}"
            targets.append(replace(target, recording=name, object=name))
            path = prediction_file(root, targets[-1])
            path.parent.mkdir(parents=True, exist_ok=True)
            if not path.exists():
                os.link(prediction_file(root, target), path)
    return replace(release, targets=tuple(targets))


@dataclass(frozen=True)
class Timed:
    """One run: seconds, of the clock and of all processes' cpu, the largest worker, and scores.json."""

    wall_s: float
    cpu_s: float
    worker_mb: float
    table: str


def timed(release: Release, root: Path, jobs: int) -> Timed:
    """Score all."""
    started, before = time.monotonic(), _cpu_s()
    with watched_workers() as peaks:
        table = score(release, root / "predictions", method="m", surface=False, jobs=jobs)
    seconds = time.monotonic() - started, _cpu_s() - before
    assert table.complete
    return Timed(*seconds, max(peaks.values(), default=0.0), table.text())


def large_table(root: Path) -> tuple[int, float, float, float]:
    """Make the table of 100,000 pairs, write it and read it, in a process of its own.

    Returns:
        Its rows, the seconds of writing and of reading, and the most memory meanwhile, MB.
    """
    release = open_release(root / "benchmark")
    counting = counting_of(release, None, HALF_PIXEL, surface=False)
    counted = [
        count_job(PairJob(target, release.pair_path(target), prediction_file(root, target), 0.5, counting))
        for target in release.targets
    ]
    results, rng = {}, np.random.default_rng(0)
    for n in range(TABLE_PAIRS // PAIRS):
        for target, one in zip(release.targets, counted, strict=True):
            name = f"{target.recording}_{n:04d}"
            result = copy.deepcopy(one)
            result.tally.above[:] -= rng.integers(0, 2, result.tally.above.shape) * (result.tally.above > 0)
            results[replace(target, recording=name, object=name)] = result
    of = {target.category: 0.5 for target in release.targets}
    thresholds = Thresholds(of, "fixed", (), dict.fromkeys(of, "fixed"))
    rates = base_rates(release, 1, dict(zip(release.targets, (one.tally for one in counted), strict=True)))
    table = make_table(release, "m", results, thresholds, rates, {}, describe(counting, "error"))
    started, rows = time.monotonic(), len(table.rows)
    table.write(root / "large")
    written, facts = time.monotonic(), table.facts_sha256()
    del results, table
    assert read_table(root / "large" / "scores.json").facts_sha256() == facts
    return rows, written - started, time.monotonic() - written, peak_mb()


def _cpu_s() -> float:
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def measure(root: Path, jobs: int, repeats: int) -> list[Figure]:
    with worker_pool(1) as pool:  # a process of its own, whose memory is not counted
        submit_all(pool, prepare, [root])[0].result()
    release = open_release(root / "benchmark")
    timed(release_of := repeated(root, release, 1), root, jobs)  # compiled, and the files are in memory
    alone = timed(release_of, root, 1).table == timed(release_of, root, jobs).table
    alone_mb = peak_mb()
    few = timed(repeated(root, release, max(repeats // 4, 1)), root, jobs)
    many = timed(repeated(root, release, repeats), root, jobs)
    with worker_pool(1) as pool:
        rows, written_s, read_s, table_mb = submit_all(pool, large_table, [root])[0].result()
    count, ratio = repeats * PAIRS, repeats / max(repeats // 4, 1)
    return [
        stated("scorings, processes", [count, jobs]),
        at_most("wall clock, s", many.wall_s, MAX_S * repeats / REPEATS),
        stated("wall clock of a quarter, s", round(few.wall_s, 1)),
        stated("cpu of all processes, s; a scoring, ms", [many.cpu_s, 1000 * many.cpu_s / count]),
        at_most("cpu of a scoring, against one of a quarter", many.cpu_s / ratio / few.cpu_s, MAX_NONLINEAR),
        at_most("peak memory of a worker, MB", many.worker_mb, MAX_WORKER_MB),
        at_most("the same, of a quarter, MB", few.worker_mb, MAX_WORKER_MB),
        at_most("peak memory of one process alone, MB", alone_mb, MAX_WORKER_MB),
        stated("rows of a large table; seconds to write it, and to read it", [rows, written_s, read_s]),
        at_most("peak memory of making, writing and reading it, MB", table_mb, MAX_TABLE_MB),
        equals("tables of one process and of several are the same", alone, True),
    ]


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: 2)")
    parser.add_argument("--repeats", type=int, default=REPEATS, help="of 50 pairs (default: 20)")
    options = parser.parse_args()
    with build_root(None) as root:
        run(options, lambda: measure(root, options.jobs, options.repeats))


if __name__ == "__main__":
    main()
