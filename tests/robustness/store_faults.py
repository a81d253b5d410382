"""What a benchmark in a store costs in requests, and rows of `cluster_faults.py` in which the store fails.

A small benchmark lies in a bucket of moto's S3 server, behind a proxy that counts and fails. Each row of
faults starts with the stages up to the views, builds the pairs and publishes; it is held against an
undisturbed build on this machine.
"""

import os
import random
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from tempfile import TemporaryDirectory

from cluster_ways import held_against_there, store_variables
from fault_proxy import Choose, Fault, FaultProxy, for_a_while
from fault_rows import Became, Bench, Row, Run, check, ended, told_by, variables_set
from figures import Figure, at_most, stated
from full_disk import mounted
from s3_server import S3Server, start_s3
from small_runs import OBJECTS, start
from stored_benchmark import put_benchmark

from kinectbench.core.store.store import Store
from kinectbench.engine.orphans import find_orphans
from kinectbench.engine.pipeline import STAGE_NAMES

LATENCY_S = 0.02
RECORDINGS = tuple(OBJECTS)
BEFORE = STAGE_NAMES[:-1]
# Of answers that are lost one by one in a hundred there are to be some ten.
MANY_REQUESTS = 1000


@dataclass
class Lab:
    """The server, the proxy before it, and the benchmark as it is on this machine.

    Attributes:
        work: folder where commands run.
        scratch: for what they fetch.
    """

    server: S3Server
    proxy: FaultProxy
    bench: Bench
    work: Path
    scratch: Path

    def url(self, stages: Sequence[str], *, past: bool = True) -> str:
        """A bucket with the recordings and these stages, put past the proxy, or through it."""
        if past:
            os.environ["AWS_ENDPOINT_URL"] = self.server.variables()["AWS_ENDPOINT_URL"]
        url = f"s3://{self.server.bucket()}/lab"
        put_benchmark(self.bench.whole, url, stages)
        os.environ["AWS_ENDPOINT_URL"] = self.proxy.url
        return url

    def start(self, url: str, command: str = "build") -> "subprocess.Popen[str]":
        return start(self.work, command, "--jobs", "2", "-c", f"{url}/benchmark.yaml")

    def became(self, url: str, *runs: tuple[Run, Sequence[int]]) -> Became:
        """What became of it once the store is well again; what a killed run left is in the way of nobody."""
        faults = sum(fault != "" for fault in self.proxy.faults)
        became = Became(notes=[f"{faults} faults in {len(self.proxy.faults)} requests"] if faults else [])
        self.proxy.choose = lambda number, method, path: ""
        for each, statuses in runs:
            became.add(told_by(each, statuses))
        became.add(held_against_there(self.bench, self.work, url, self.scratch))
        became.wrong += [f"{each.name} is left over" for each in find_orphans(Store(url), young=True)]
        return became


@contextmanager
def laboratory(bench: Bench) -> Iterator[Lab]:
    server = start_s3()
    try:
        with (
            FaultProxy(server.port) as proxy,
            store_variables(bench.folder, server.variables()) as scratch,
            TemporaryDirectory() as work,
        ):
            yield Lab(server, proxy, bench, Path(work), scratch)
    finally:
        server.kill()


def in_lab(row: Callable[[Lab], Became]) -> Row:
    """The row in a laboratory of its own."""

    @wraps(row)
    def whole_row(bench: Bench) -> Became:
        with laboratory(bench) as lab:
            return row(lab)

    return whole_row


def failing(choose: Callable[[], Choose]) -> Row:
    """A build while the store fails in some way."""

    @in_lab
    def row(lab: Lab) -> Became:
        url = lab.url(BEFORE)
        lab.proxy.choose = choose()
        return lab.became(url, (ended(lab.start(url)), (0,)))

    return row


def some(fault: Fault, share: float) -> Choose:
    draw = random.Random(0)
    return lambda number, method, path: fault if draw.random() < share else ""


@in_lab
def one_in_a_hundred(lab: Lab) -> Became:
    """Recordings and stages are put, again and again, and some are built, until there are many requests."""
    lab.proxy.choose, runs = some("lose", 0.01), []
    while len(lab.proxy.requests) < MANY_REQUESTS:
        url = lab.url(BEFORE, past=False)
    runs.append((ended(lab.start(url)), (0,)))
    return lab.became(url, *runs)


@in_lab
def killed(lab: Lab) -> Became:
    """`build` and its processes are killed at five random moments."""
    url, moments, left = lab.url(BEFORE), random.Random(0), 0
    for _ in range(5):
        process = lab.start(url)
        time.sleep(moments.uniform(1, 8))
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        left = max(left, len(find_orphans(Store(url), young=True)))
    became = lab.became(url)
    became.notes.append(f"5 kills left {left} files at most that no manifest names")
    return became


@in_lab
def full_scratch(lab: Lab) -> Became:
    """The disk for what is fetched has room for a part of a recording."""
    url = lab.url(BEFORE)
    with mounted(lab.bench.folder / "disk", "size=200k") as disk:
        with variables_set({"KINECTBENCH_SCRATCH": str(disk)}):
            build = ended(lab.start(url))
        became = Became(wrong=[f"{path.name} is left over" for path in disk.iterdir()])
    became.add(lab.became(url, (build, (1, 3))))
    became.need(f"KINECTBENCH_SCRATCH={disk}" in build.err, "it is not told which disk is full")
    return became


@in_lab
def two_clients(lab: Lab) -> Became:
    url = lab.url(BEFORE)
    both = [lab.start(url) for _ in range(2)]
    return lab.became(url, *((ended(each), (0,)) for each in both))


@in_lab
def gone(lab: Lab) -> Became:
    """The store ends for good in the midst of a build; then the same is built in another one."""
    url = lab.url(BEFORE)
    os.environ["KINECTBENCH_STORE_PATIENCE_S"] = "10"
    build = lab.start(url)
    while len(lab.proxy.requests) < 20 and build.poll() is None:
        time.sleep(0.01)
    lab.server.kill()
    became = told_by(ended(build), (1, 3))
    lab.server = start_s3()
    os.environ["AWS_ENDPOINT_URL"] = lab.server.variables()["AWS_ENDPOINT_URL"]
    try:
        url = f"s3://{lab.server.bucket()}/lab"
        put_benchmark(lab.bench.whole, url, BEFORE)
        return became.add(lab.became(url))
    finally:
        lab.server.kill()


STORE_FAULTS: dict[str, Row] = {
    "store: 503 for a minute": failing(lambda: for_a_while(60)),
    "store: 10 % of requests cut": failing(lambda: some("cut", 0.1)),
    "store: 10 % of answers lost": failing(lambda: some("lose", 0.1)),
    "store: 1 % of answers lost": one_in_a_hundred,
    "store: build killed at 5 random moments": killed,
    "store: two clients at once": two_clients,
    "store: a full disk for what is fetched": full_scratch,
    "store: gone for good": gone,
}


def requests(bench: Bench) -> Iterator[Figure]:
    """Of each command: requests in all; those beyond files read and put, of each recording and of none."""
    with laboratory(bench) as lab:
        url = lab.url(())
        lab.proxy.latency_s = LATENCY_S
        files = len([each for each in Store(url).objects("recordings") if ".truth" not in each.name])
        config = ("--jobs", "2", "-c", f"{url}/benchmark.yaml")
        of_release = (f"{url}/benchmark",)
        publish = ("publish", *config, "--allow-poor")  # of so few and small pictures figures are poor
        for name, words in (
            ("build", ("build", *config)),
            ("build again", ("build", *config)),
            ("publish", publish),
            ("publish again", publish),
            ("fetch", ("fetch", *of_release, "--out", "got")),
            ("verify", ("verify", *of_release)),
        ):
            lab.proxy.requests.clear()
            check(ended(start(lab.work, *words)), words)
            asked = list(lab.proxy.requests)
            moved = sum(method == "PUT" for method, _ in asked) + (files if name == "build" else 0)
            if name in ("fetch", "verify"):
                moved += len(Store(f"{url}/benchmark").objects())
            of_none = sum(method != "PUT" and not any(map(path.count, RECORDINGS)) for method, path in asked)
            if name in ("fetch", "verify"):
                of_none = 0  # nearly all are files of the release
            beyond = (len(asked) - moved - of_none) / len(RECORDINGS)
            yield stated(f"{name}: requests", len(asked))
            yield stated(f"{name}: requests for no recording's sake", of_none)
            yield at_most(f"{name}: requests beyond one a file, a recording", beyond, 30)
