"""Ways of building and scoring that must give the same bytes as one process: rows of `cluster_faults.py`."""

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from dask_parts import OF_WORKER, dask, running
from fault_rows import (
    SCORE,
    Became,
    Bench,
    NotHereError,
    Row,
    ended,
    held_against,
    same_release,
    same_scores,
    told_by,
    variables_set,
)
from s3_server import start_s3
from small_runs import copied, start
from stored_benchmark import put_benchmark

from kinectbench.core.store.store import Store
from kinectbench.engine.orphans import find_orphans

SHARDS = 40


def by(*words: str) -> Row:
    """`build` and `score` with these options."""
    return lambda bench: built_and_scored(bench, *words)


def built_and_scored(bench: Bench, *words: str) -> Became:
    root = copied(bench.whole, bench.folder / "b", "predictions")
    became = held_against(bench, root, (ended(start(root, "build", *words)), (0,)))
    return became.add(scored(bench, root, *words))


def scored(bench: Bench, root: Path, *words: str) -> Became:
    """Score with these options, and hold the table against the bench's."""
    return told_by(ended(start(root, *SCORE, *words)), (0,)).add(same_scores(bench, root))


def by_scheduler(bench: Bench) -> Became:
    with dask(bench.folder) as parts:
        return built_and_scored(bench, "--cluster", str(parts.file))


def by_parts(bench: Bench) -> Became:
    """One part after another, then the table of scores."""
    root = copied(bench.whole, bench.folder / "b", "predictions")
    parts = [("--shard", f"{number}/{SHARDS}") for number in range(1, SHARDS + 1)]
    builds = [ended(start(root, "build", "--jobs", "1", *part)) for part in parts]
    became = held_against(bench, root, *((build, (0,)) for build in builds))
    for part in parts:
        became.add(told_by(ended(start(root, *SCORE, *part)), (0,)))
    return became.add(scored(bench, root))


# --- a store ------------------------------------------------------------------------------------------


@contextmanager
def store_variables(folder: Path, variables: Mapping[str, str]) -> Iterator[Path]:
    """The environment of whoever uses a store; yields where what is fetched lies, for a while."""
    scratch = folder / "scratch"
    scratch.mkdir(exist_ok=True)
    cache = str(folder / "cache")
    more = {"KINECTBENCH_SCRATCH": str(scratch), "KINECTBENCH_CACHE": cache}
    with variables_set({**variables, **more}):
        try:
            yield scratch
        finally:
            shutil.rmtree(scratch)
            shutil.rmtree(cache, ignore_errors=True)


def held_against_there(bench: Bench, work: Path, url: str, scratch: Path) -> Became:
    """Publish what is in a store, one process building what is missing, and hold it against the bench."""
    run = ended(start(work, "publish", "--json", "--jobs", "1", "-c", f"{url}/benchmark.yaml"))
    if run.status:
        return Became(wrong=[f"not published: {run.err.strip()[-200:]}"])
    became = same_release(bench, json.loads(run.out)["benchmark_sha256"])
    became.wrong += [f"{path.name} is left over" for path in scratch.iterdir()]
    return became


def in_store(*words: str) -> Row:
    """`build` and `score` of a benchmark in moto's S3 server, with these options."""

    def row(bench: Bench) -> Became:
        server = start_s3()
        try:
            with store_variables(bench.folder, server.variables()) as scratch, TemporaryDirectory() as work:
                url = f"s3://{server.bucket()}/lab"
                put_benchmark(bench.whole, url, ())
                config = f"{url}/benchmark.yaml"
                became = told_by(ended(start(Path(work), "build", *words, "-c", config)), (0,))
                became.add(held_against_there(bench, Path(work), url, scratch))
                became.wrong += [f"{each.name} is left over" for each in find_orphans(Store(url), young=True)]
                shutil.copytree(bench.whole / "predictions", Path(work) / "predictions")
                of_url = ("--benchmark", f"{url}/benchmark", "--out", "scores")
                return became.add(scored(bench, Path(work), *of_url, *words))
        finally:
            server.kill()

    return row


# --- Slurm --------------------------------------------------------------------------------------------


def need_slurm() -> None:
    """Raise NotHereError where no Slurm answers."""
    if not shutil.which("sbatch"):
        raise NotHereError("no Slurm")
    if subprocess.run(["sinfo"], capture_output=True, check=False).returncode:
        raise NotHereError("no Slurm controller answers `sinfo`")


def by_slurm_array(bench: Bench) -> Became:
    """Three tasks of `build`, then of `score`."""
    need_slurm()
    root = copied(bench.whole, bench.folder / "b", "predictions")
    arrays = []
    for words in (("build", "--jobs", "1"), SCORE):
        line = f"{sys.executable} -m kinectbench {' '.join(words)} --shard $SLURM_ARRAY_TASK_ID/3"
        array = ["sbatch", "--wait", "--array=1-3", f"--output={bench.folder}/slurm-%A-%a.log"]
        run = subprocess.run([*array, "--wrap", line], cwd=root, capture_output=True, text=True, check=False)
        arrays.append(run.returncode)
        if words is not SCORE:
            became = held_against(bench, root)
    became.notes.append(f"statuses of the arrays: {arrays}")
    became.wrong += ["an array failed"] if any(arrays) else []
    return became.add(scored(bench, root))


def by_slurm_workers(bench: Bench) -> Became:
    """A scheduler, and two workers by `srun`."""
    need_slurm()
    file = bench.folder / "s.json"
    with dask(bench.folder, workers=()):
        words = [*OF_WORKER, "--scheduler-file", str(file)]
        before = ("srun", "--ntasks", "2")
        with running("worker", *words, file=file, variables={}, before=before):
            return built_and_scored(bench, "--cluster", str(file))


WAYS: dict[str, Row] = {
    "one process": by("--jobs", "1"),
    "two processes": by("--jobs", "2"),
    "--cluster local:2": by("--cluster", "local:2"),
    "a scheduler and two workers by file": by_scheduler,
    f"{SHARDS} shards": by_parts,
    "a store": in_store("--jobs", "2"),
    "a store and --cluster local:2": in_store("--cluster", "local:2"),
    "a Slurm array": by_slurm_array,
    "workers by srun": by_slurm_workers,
}
