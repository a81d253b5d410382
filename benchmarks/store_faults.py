"""What a benchmark in a store costs in requests, and what becomes of it when the store or a client fails.

    python benchmarks/store_faults.py [requests] [503] [cut] [lost] [killed] [clients] [gone]

Two small simulated recordings lie in a bucket of moto's S3 server, behind a proxy that counts and fails. Each
row of faults starts with the stages up to the views, builds the pairs and publishes; it is held against the
release of an undisturbed run on this machine: the same benchmark_sha256, and no file that no manifest names.
"""

import json
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from fault_proxy import Choose, FaultProxy, for_a_while
from s3_server import S3Server, start_s3
from small_benchmark import Run, finish, make_benchmark, run, start
from stored_benchmark import put_benchmark

from kinectbench.core.store.store import Store
from kinectbench.engine.pipeline import STAGE_NAMES
from kinectbench.engine.unnamed import unnamed

LATENCY_S = 0.02
RECORDINGS = 2
BEFORE = STAGE_NAMES[:-1]


@dataclass
class Lab:
    """The server, the proxy, and the benchmark as it is on this machine, built and published."""

    server: S3Server
    proxy: FaultProxy
    small: Path
    sha256: str
    work: Path

    def url(self, stages: tuple[str, ...]) -> str:
        """A bucket with the recordings and these stages, put past the proxy."""
        os.environ |= self.server.variables()
        url = f"s3://{self.server.bucket()}/lab"
        put_benchmark(self.small, url, stages)
        os.environ["AWS_ENDPOINT_URL"] = self.proxy.url
        self.proxy.requests.clear()
        self.proxy.faults.clear()
        self.proxy.choose = lambda number, method, path: ""
        return url

    def command(self, *words: str) -> Run:
        return run(self.work, *words)

    def same(self, url: str) -> str:
        """Publish there; whether that is what this machine published, and whether anything is left over."""
        self.proxy.choose = lambda number, method, path: ""
        told = self.command("publish", "--json", "--jobs", "2", "-c", f"{url}/benchmark.yaml")
        if told.status:
            return f"NOT PUBLISHED: {told.err.strip()[-200:]}"
        same = json.loads(told.out)["benchmark_sha256"] == self.sha256
        left = len(unnamed(Store(url), young=True))
        return f"{'same bytes' if same else 'OTHER BYTES'}, {left} files that no manifest names"


def counted(lab: Lab) -> None:
    """A row for each command: requests in all, files read and put, and requests beyond these a recording."""
    url = lab.url(())
    lab.proxy.latency_s = LATENCY_S
    config = ("-c", f"{url}/benchmark.yaml")
    files = len([each for each in Store(url).objects("recordings") if ".truth" not in each.name])
    print("command            requests   files   beyond, a recording   seconds")
    for name, words in (
        ("build", ("build", "--jobs", "2", *config)),
        ("build again", ("build", "--jobs", "2", *config)),
        ("publish", ("publish", "--jobs", "2", *config)),
        ("publish again", ("publish", "--jobs", "2", *config)),
        ("fetch", ("fetch", f"{url}/benchmark", "--out", "got")),
        ("verify", ("verify", f"{url}/benchmark")),
    ):
        lab.proxy.requests.clear()
        started = time.monotonic()
        result = lab.command(*words)
        assert result.status == 0, result
        requests = list(lab.proxy.requests)
        puts = sum(method == "PUT" for method, _ in requests)
        gets = files if name == "build" else 0
        if name in ("fetch", "verify"):
            gets = len(Store(f"{url}/benchmark").objects())
        beyond = (len(requests) - puts - gets) / RECORDINGS
        seconds = time.monotonic() - started
        print(f"{name:18} {len(requests):8} {puts + gets:7} {beyond:21.1f} {seconds:9.1f}", flush=True)
    lab.proxy.latency_s = 0


def with_fault(choose: Callable[[], Choose]) -> Callable[[Lab], str]:
    def row(lab: Lab) -> str:
        url = lab.url(BEFORE)
        lab.proxy.choose = choose()
        result = lab.command("build", "--jobs", "2", "-c", f"{url}/benchmark.yaml")
        faults = sum(fault != "" for fault in lab.proxy.faults)
        if result.status:
            print(result.err, flush=True)
        return f"status {result.status}, {faults} faults of {len(lab.proxy.faults)}; {lab.same(url)}"

    return row


def some(fault: str, share: float) -> Choose:
    draw = random.Random(0)
    return lambda number, method, path: fault if draw.random() < share else ""


def killed(lab: Lab) -> str:
    """The client and its workers are killed at five random moments."""
    url = lab.url(BEFORE)
    moments = random.Random(0)
    for _ in range(5):
        process = start(lab.work, "build", "--jobs", "2", "-c", f"{url}/benchmark.yaml")
        time.sleep(moments.uniform(3, 15))
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
    left = len(unnamed(Store(url), young=True))
    return f"5 kills, {left} files left by them; {lab.same(url)}"


def two_clients(lab: Lab) -> str:
    url = lab.url(BEFORE)
    both = [start(lab.work, "build", "--jobs", "2", "-c", f"{url}/benchmark.yaml") for _ in range(2)]
    statuses = [finish(each).status for each in both]
    return f"statuses {statuses}; {lab.same(url)}"


def gone(lab: Lab) -> str:
    """The server ends for good in the midst of it: the last row, as nothing comes after."""
    url = lab.url(BEFORE)
    os.environ["KINECTBENCH_STORE_PATIENCE_S"] = "10"
    process = start(lab.work, "build", "--jobs", "2", "-c", f"{url}/benchmark.yaml")
    time.sleep(5)
    lab.server.kill()
    result = finish(process)
    lines = [line for line in result.err.splitlines() if "error: " in line]
    first = lines[0][:160] if lines else result.err[-200:]
    return f"status {result.status}, {len(lines)} lines, the first: {first}"


ROWS: dict[str, Callable[[Lab], str]] = {
    "503": with_fault(lambda: for_a_while(60)),
    "cut": with_fault(lambda: some("cut", 0.1)),
    "lost": with_fault(lambda: some("lose", 0.1)),
    "killed": killed,
    "clients": two_clients,
    "gone": gone,
}


def main() -> None:
    wanted = sys.argv[1:] or ["requests", *ROWS]
    with tempfile.TemporaryDirectory() as folder:
        small = make_benchmark(Path(folder) / "small")
        published = run(small, "publish", "--json", "--jobs", "2")
        assert published.status == 0, published.err
        server = start_s3()
        (Path(folder) / "work").mkdir()
        with FaultProxy(server.port) as proxy:
            sha256 = json.loads(published.out)["benchmark_sha256"]
            lab = Lab(server, proxy, small, sha256, Path(folder) / "work")
            if "requests" in wanted:
                counted(lab)
            for name, row in ROWS.items():
                if name in wanted:
                    started = time.monotonic()
                    print(f"{name:8} {row(lab)} ({time.monotonic() - started:.0f} s)", flush=True)
        server.kill()


if __name__ == "__main__":
    main()
