"""Ways of building, and what dies meanwhile: afterwards, is the benchmark the same to the byte?

Every row copies a small benchmark of two simulated recordings, builds it another way or disturbs it,
publishes it, and holds it against one that was built in one process: the same benchmark_sha256 (and
scores.json, of the ways), nothing left over, and no more than a line told. Some rows need root (a disk that
fills up), `faketime`, `openssl` or a Slurm that answers `sinfo`; where these are missing they say so.
`--only requests` counts what each command asks of a store.
"""

import random
import re
import signal
import subprocess
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from cluster_ways import WAYS
from dask_parts import Parts, Worker, dask, kill_all_of, killed_in, worker_below, writing
from fault_rows import (
    Became,
    Bench,
    NotHereError,
    Row,
    ended,
    figures_of,
    held_against,
    make_bench,
    variables_set,
)
from figures import Figure, arguments, run, stated
from full_disk import DISKS, PAGE, ROOMY, mounted, pages_of, remount
from small_runs import OBJECTS, copied, start
from store_faults import STORE_FAULTS, requests

from kinectbench.core.artefacts.manifest import Failed
from kinectbench.engine.stages import STAGES

FOLDERS = {stage.name: stage.folder for stage in STAGES}
RECORDINGS = tuple(OBJECTS)
MOMENTS = 20
Build = subprocess.Popen[str]


def begun(bench: Bench, stage: str) -> Path:
    """A copy that is built as far as the stage before this one."""
    before = [*FOLDERS.values()][: [*FOLDERS].index(stage)]
    return copied(
        bench.whole,
        bench.folder / "b",
        *(f"build/{recording}/{folder}" for recording in RECORDINGS for folder in before),
    )


def disturbed(fault: Callable[[Parts, Build], None], statuses: Sequence[int], stage: str = "fuse") -> Row:
    """Something happens to a part of the cluster, or to `build`, while a stage is written."""

    def row(bench: Bench) -> Became:
        root = begun(bench, stage)
        with dask(bench.folder) as parts:
            build = start(root, "build", "--cluster", str(parts.file))
            hit = writing(root, FOLDERS[stage], build) is not None
            fault(parts, build)
            run = ended(build)
        became = held_against(bench, root, (run, statuses))
        became.need(hit, f"{stage} was over before anything happened")
        return became

    return row


def killed_in_stage(stage: str, bench: Bench) -> Became:
    root = begun(bench, stage)
    with dask(bench.folder) as parts:
        build = start(root, "build", "--cluster", str(parts.file))
        recording = killed_in(root, FOLDERS[stage], parts, build)
        run = ended(build)
    became = held_against(bench, root, (run, (0,)))
    became.need(recording, f"no worker could be killed in {stage}")
    return became


def killed_at_random(bench: Bench) -> Became:
    """One cluster, whose nannies start workers again; two kills a build, drawn over as long as one lasts."""
    draw, became, hits, lasts_s = random.Random(0), Became(), 0, 0.0
    with dask(bench.folder) as parts:
        while hits < MOMENTS and not became.wrong:
            root = begun(bench, "ingest")
            build = start(root, "build", "--cluster", str(parts.file))
            writing(root, FOLDERS["ingest"], build)
            started = time.monotonic()
            for moment_s in sorted(draw.uniform(0, lasts_s) for _ in range(2 if lasts_s else 0)):
                time.sleep(max(started + moment_s - time.monotonic(), 0))
                worker = worker_below(draw.choice(parts.nannies).pid)
                if build.poll() is None:
                    worker.kill()
                    hits += 1
            run = ended(build)
            lasts_s = lasts_s or time.monotonic() - started
            became.add(held_against(bench, root, (run, (0,))))
    became.notes.append(f"{hits} kills, each within the {lasts_s:.0f} s that a build takes")
    return became


def full_disk(bench: Bench) -> Became:
    """There is room for half of what `fuse` writes."""
    with mounted(bench.folder / "disk", ROOMY) as place, dask(bench.folder) as parts:
        root = begun(Bench(bench.whole, bench.sha256, place), "fuse")
        needed = sum(pages_of(bench.whole / "build" / each / FOLDERS["fuse"]) for each in RECORDINGS)
        used = subprocess.check_output(["df", "--output=used", "-B", str(PAGE), str(place)], text=True)
        remount(place, f"size={(int(used.split()[-1]) + needed // 2) * PAGE}")
        run = ended(start(root, "build", "--cluster", str(parts.file)))
        remount(place, ROOMY)
        became = held_against(bench, root, (run, (1, 3)))
    became.wrong += [f"told: {line}" for line in became.told if "the disk is full: free some" not in line]
    return became


def two_clients(bench: Bench) -> Became:
    root = begun(bench, "ingest")
    with dask(bench.folder) as parts:
        both = [start(root, "build", "--cluster", str(parts.file)) for _ in range(2)]
        runs = [ended(build) for build in both]
    return held_against(bench, root, *((run, (0,)) for run in runs))


# A worker that eats memory in `segment` of one recording, as an image of a billion pixels would, up to a
# bound that spares the machine; it notes how much was handed out.
EATS = """
import time
from kinectbench.engine import steps
from kinectbench.engine.steps import _segment as plain
def segment(job, folder, progress):
    from distributed import get_worker
    if job.recording.id == "stool":
        worker = get_worker()
        asked = worker.state.tasks[worker.get_current_task()].resource_restrictions or {{}}
        with open({notes!r}, "a") as file:
            print(asked.get("memory_gb", 0), file=file)
        eaten = []
        while len(eaten) < 60:
            eaten.append(bytearray(b"x") * (32 << 20))
            time.sleep(0.05)
        time.sleep(600)
    plain(job, folder, progress)
steps.STEPS["segment"] = segment
"""


def poisoned(bench: Bench) -> Became:
    """It must be tried alone, with twice the memory, and fail; the other one is done."""
    root, notes = begun(bench, "segment"), bench.folder / "asked.txt"
    notes.unlink(missing_ok=True)
    eater = Worker(
        ("--memory-limit", "1GB", "--resources", "memory_gb=16"), preload=EATS.format(notes=str(notes))
    )
    with dask(bench.folder, (eater, eater)) as parts:
        run = ended(start(root, "build", "--cluster", str(parts.file)))
    failed = Failed.read_if_there(root / "build" / "stool")
    told_why = failed is not None and "its worker was killed" in failed.error
    done = (root / "build" / "chair" / "pairs").is_dir()
    asked_gb = [float(line) for line in (notes.read_text().split() if notes.is_file() else ())]
    became = held_against(bench, root, (run, (3,)))
    became.need(told_why, "no failed.json of it")
    became.need(done, "the other recording is not done")
    became.need(asked_gb and asked_gb[-1] == 2 * asked_gb[0] > 0, f"memory handed out: {asked_gb} GB")
    became.notes.append(f"GB handed out, by try: {', '.join(f'{gb:.2g}' for gb in asked_gb)}")
    return became


OTHER_VERSION = 'import kinectbench._version as v; v.__version__ = "0.0.0"'


def other_version(bench: Bench) -> Became:
    root = begun(bench, "ingest")
    with dask(bench.folder, (Worker(preload=OTHER_VERSION), Worker(preload=OTHER_VERSION))) as parts:
        run = ended(start(root, "build", "--cluster", str(parts.file)))
    became = held_against(bench, root, (run, (1,)))
    became.need("has kinectbench 0.0.0 and not" in run.err, "its version was not told")
    return became


def clock_skew(bench: Bench) -> Became:
    """The clock of one worker is an hour ahead, that of the other an hour behind."""
    root = begun(bench, "ingest")
    with dask(
        bench.folder,
        [Worker(before=("faketime", "-f", hour)) for hour in ("+1h", "-1h")],
        {"FAKETIME_DONT_FAKE_MONOTONIC": "1"},
    ) as parts:
        run = ended(start(root, "build", "--cluster", str(parts.file)))
    return held_against(bench, root, (run, (0,)))


def tls(bench: Bench) -> Became:
    """All parts prove who they are by one certificate; who has none gets a line."""
    key, certificate = bench.folder / "key.pem", bench.folder / "certificate.pem"
    words = ["req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=kinectbench"]
    try:
        files = ["-keyout", str(key), "-out", str(certificate)]
        subprocess.run(["openssl", *words, *files], check=True, capture_output=True)
    except FileNotFoundError as error:
        raise NotHereError("no openssl") from error
    comm = "DASK_DISTRIBUTED__COMM"
    variables = {f"{comm}__REQUIRE_ENCRYPTION": "true", f"{comm}__TLS__CA_FILE": str(certificate)}
    for part in ("SCHEDULER", "WORKER", "CLIENT"):
        variables[f"{comm}__TLS__{part}__CERT"] = str(certificate)
        variables[f"{comm}__TLS__{part}__KEY"] = str(key)
    root = begun(bench, "ingest")
    with dask(bench.folder, variables=variables) as parts:
        address = re.search(r"tls://[0-9.:]+", parts.file.read_text())
        where = ("--cluster", address[0] if address else "no tls")
        without = ended(start(root, "build", *where))
        with variables_set(variables):
            run = ended(start(root, "build", *where))
    became = held_against(bench, root, (without, (1,)), (run, (0,)))
    became.need("distributed.comm.tls" in without.err, "who has no certificate is not told of it")
    return became


FAULTS: dict[str, Row] = {
    **{f"SIGKILL of a worker in {stage}": partial(killed_in_stage, stage) for stage in FOLDERS},
    f"SIGKILL of a worker at {MOMENTS} random moments": killed_at_random,
    "SIGKILL of a worker's nanny": disturbed(lambda parts, build: parts.nannies[0].kill(), (0,)),
    "SIGKILL of the scheduler": disturbed(lambda parts, build: parts.scheduler.kill(), (1,)),
    "SIGKILL of build": disturbed(
        lambda parts, build: kill_all_of(build, signal.SIGKILL), (-signal.SIGKILL,)
    ),
    "SIGINT of build": disturbed(lambda parts, build: kill_all_of(build, signal.SIGINT), (130,)),
    "SIGSTOP of a worker": disturbed(
        lambda parts, build: worker_below(parts.nannies[0].pid).send_signal(signal.SIGSTOP), (0,)
    ),
    "a full disk": full_disk,
    "two clients at once": two_clients,
    "a recording that eats memory": poisoned,
    "a worker of another version": other_version,
    "clocks that are an hour wrong": clock_skew,
    "TLS": tls,
}
ROWS = {**WAYS, **FAULTS, **DISKS, **STORE_FAULTS}
# Not a fault: how many requests each command makes to a store.
REQUESTS = "requests"


def options() -> ArgumentParser:
    parser = arguments(__doc__)
    names = [*ROWS, REQUESTS]
    parser.add_argument("--only", nargs="*", choices=names, default=names, help="default: all")
    return parser


def measure(chosen: Namespace) -> list[Figure]:
    with TemporaryDirectory(prefix="kinectbench-cluster-") as folder:
        bench = make_bench(Path(folder))
        return [
            stated("benchmark_sha256 of one process", bench.sha256),
            *figures_of(ROWS, [name for name in chosen.only if name != REQUESTS], bench),
            *(requests(bench) if REQUESTS in chosen.only else ()),
        ]


if __name__ == "__main__":
    chosen = options().parse_args()
    run(chosen, lambda: measure(chosen))
