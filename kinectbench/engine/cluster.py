"""A cluster as an executor: Dask's scheduler assigns tasks to local or remote workers.

The scheduler keeps only running tasks; results are on disk. If any part of the cluster dies, the same command
continues the work.
"""

import asyncio
import logging
import re
import ssl
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.request import ProxyHandler, build_opener

from kinectbench.core import ClusterError, SettingsError, printable, read_plain_text, strict_json
from kinectbench.engine.cluster_run import Run, dask_line
from kinectbench.engine.executor import Listener, Outcomes, Result, SendMessage, Task
from kinectbench.engine.interrupts import interrupts_held

if TYPE_CHECKING:
    from distributed import Client

WANTED = (
    "give tcp://HOST:PORT or tls://HOST:PORT of a scheduler, the file that `dask scheduler --scheduler-file` "
    "wrote, or local:N for N processes here"
)
TLS_HINT = "; Dask's settings distributed.comm.tls name the files: ca-file, client.cert, client.key"
MISSING = "--cluster needs Dask; install it by `pip install 'kinectbench[cluster]'`"
# Largest scheduler file: it has some hundred bytes, and some hundred more for each worker.
MOST_FILE_BYTES = 64 << 20
# Seconds: between two requests for the workers; until the scheduler must answer; without any worker until
# giving up; until Dask's page must answer.
LOOK_S, CONNECT_S, NO_WORKERS_S, DASHBOARD_S = 1.0, 20.0, 900.0, 2.0
# Seconds of silence after which a scheduler that had answered is given up: a busy one is silent for
# up to a minute.
SILENT_S = 300.0
# A nanny restarts a killed worker within seconds; after this time the worker is gone.
RESTART_S = 60.0
# Settings of a local scheduler; docs/cluster.md describes the settings of other schedulers. A task has three
# tries. A worker is dead after 20 minutes of silence: compiled code may hold the interpreter's lock for
# minutes. Tasks hold their arrays themselves, so Dask has nothing to spill.
OF_LOCAL = {
    "distributed.scheduler.allowed-failures": 2,
    "distributed.scheduler.worker-ttl": "20 minutes",
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
}


@contextmanager
def cluster(address: str) -> Iterator["Cluster"]:
    """Connect to a cluster, or start a local one; Dask's configuration sets up TLS.

    Args:
        address: `tcp://HOST:PORT`, `tls://HOST:PORT`, a scheduler's file, or `local:N`.

    Raises:
        SettingsError: the address has another form, or Dask is not installed.
        ClusterError: no scheduler answers there.
    """
    local = re.fullmatch(r"local:([1-9][0-9]{0,3})", address)
    end = time.monotonic() + CONNECT_S
    while address.endswith(".json") and not Path(address).is_file() and time.monotonic() < end:
        time.sleep(0.1)  # the scheduler may be starting
    if not local and not re.fullmatch(r"(tcp|tls)://.+:[0-9]{1,5}", address):
        _check_scheduler_file(address)
    try:
        import dask
    except ImportError as error:
        raise SettingsError(MISSING, what="no-package") from error
    with dask.config.set(OF_LOCAL if local else {}), ExitStack() as stack:
        try:
            with interrupts_held():
                client = _connected(address, int(local[1]) if local else 0, stack)
        except Exception as error:  # Dask has many kinds
            first: BaseException = error
            while first.__cause__ is not None:
                first = first.__cause__
            why, of_files = dask_line(first), isinstance(first, ssl.SSLError | FileNotFoundError)
            hint = TLS_HINT if of_files or re.search("TLS|encryption", why) else ""
            raise ClusterError(
                f"--cluster {address}: no scheduler answers there ({why}){hint}", what="no-answer"
            ) from error
        yield Cluster(client, address)


def _check_scheduler_file(address: str) -> None:
    option = f"--cluster {printable(address, 200)}"
    if not Path(address).is_file():
        missing = "no such file; " if address.endswith(".json") else ""
        raise SettingsError(f"{option}: {missing}{WANTED}")
    try:
        content = strict_json(read_plain_text(Path(address), MOST_FILE_BYTES))
    except (OSError, ValueError, RecursionError):
        content = None
    if not isinstance(content, dict) or not isinstance(content.get("address"), str):
        raise SettingsError(f"{option}: no file of a scheduler; {WANTED}")


def _connected(address: str, local: int, stack: ExitStack) -> "Client":
    """Connect to a scheduler, or start one with `local` processes if not 0; `stack` closes both."""
    from distributed import Client, LocalCluster

    _be_quiet()  # after the import, which sets the levels of loggers

    class OwnClient(Client):  # type: ignore[misc]
        """A client that waits a limited time for a scheduler; it is closed explicitly.

        When Dask's own client ends without a connection, it waits for 40 s and prints a traceback.
        """

        async def _start(self, **how: object) -> None:
            # Connecting, greeting and registering together; Dask limits only the first.
            try:
                await asyncio.wait_for(super()._start(**how), 3 * CONNECT_S)
            except TimeoutError:
                raise OSError(f"it takes calls, but said nothing for {3 * CONNECT_S:.0f} s") from None

        def sync(self, *call: object, callback_timeout: float | None = None, **how: object) -> object:
            return super().sync(*call, callback_timeout=callback_timeout or SILENT_S, **how)

        def __del__(self) -> None:
            pass

    where = {"scheduler_file": address} if Path(address).is_file() else {"address": address}
    if local:
        local_cluster = LocalCluster(
            n_workers=local,
            threads_per_worker=1,
            memory_limit=0,  # no limit, like the pool's processes
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        )
        stack.callback(local_cluster.close, timeout=CONNECT_S)
        where = {"address": local_cluster}
    client = OwnClient(**where, timeout=CONNECT_S, set_as_default=False)
    stack.callback(client.close, timeout=CONNECT_S)
    return client


def _be_quiet() -> None:
    """Silence Dask's logs: this package reports errors itself, in one line."""
    for name in ("distributed", *logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    warnings.filterwarnings("ignore", module=r"distributed\.")


class Cluster:
    """The workers of a Dask scheduler; each of their threads runs one task at a time."""

    def __init__(self, client: "Client", address: str) -> None:
        self._client, self._address = client, address
        self._slots, self._looked = 0, float("-inf")
        self._largest_gb, self._seen_largest = 0.0, float("-inf")
        self._last_worker = time.monotonic()

    @property
    def dashboard(self) -> str:
        """Address of Dask's dashboard; "" if the dashboard does not answer.

        The scheduler gives an address even if it was started with `--no-dashboard` (the page is then 404), or
        lacks `bokeh` (the page then asks for it).
        """
        try:
            link = str(self._client.dashboard_link)
            with build_opener(ProxyHandler({})).open(link, timeout=DASHBOARD_S) as answer:
                return "" if b"needs bokeh" in answer.read(500) else link
        except Exception:  # Dask and HTTP have many kinds
            return ""

    def slots(self) -> int:
        """Return the number of worker threads; it may be a second old."""
        self._look()
        return self._slots

    def outcomes(
        self,
        function: Callable[[Task, SendMessage], Result],
        tasks: Sequence[Task],
        listener: Listener,
        memory_gb: Callable[[Task], float] | None = None,
        *,
        slowest_twice: bool = False,
    ) -> Outcomes[Task, Result]:
        """Run tasks; see `Executor`. A task whose workers were killed is tried again at the end, alone.

        Args:
            function: computes a task's result.
            tasks: the tasks to run.
            listener: receives the messages.
            memory_gb: expected memory of a task, GB; used if workers have a resource `memory_gb`. A task that
                runs alone may use twice as much.
            slowest_twice: whether idle workers may run the last tasks a second time; see `Executor`.
        """
        run = Run(self._client, self.largest_gb, self.gone, function, tasks, listener, memory_gb)
        try:
            while run.waiting or run.running or run.killed:
                slots = self.slots()
                while slots and run.waiting and len(run.running) <= slots:
                    run.submit(run.waiting.popleft())
                if slots and not run.waiting and not run.running:
                    run.submit(run.killed.popleft(), alone=True)
                if slots:
                    run.ask_for_less()
                if slowest_twice and not run.waiting and len(run.running) < slots:
                    run.submit_slowest()
                yield from run.ended()
        finally:
            run.close()

    def largest_gb(self) -> float:
        """Return the largest `memory_gb` resource of any worker in the last minute; 0 if none has one."""
        self._look()
        return self._largest_gb

    def gone(self) -> ClusterError:
        """Return the error for a scheduler that has stopped answering."""
        return ClusterError(
            f"--cluster {self._address}: lost the scheduler; start it again and run the same command again: "
            "what is done is kept",
            what="lost",
        )

    def _look(self) -> None:
        now = time.monotonic()
        if now - self._looked < LOOK_S:
            return
        try:
            workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
        except Exception as error:  # Dask has many kinds
            raise self.gone() from error
        if self._client.status != "running":
            raise self.gone()
        self._looked = now
        self._slots = sum(worker["nthreads"] for worker in workers)
        largest_gb = max((worker["resources"].get("memory_gb", 0) for worker in workers), default=0)
        if largest_gb >= self._largest_gb or now - self._seen_largest > RESTART_S:
            self._largest_gb, self._seen_largest = largest_gb, now
        if self._slots:
            self._last_worker = now
        elif now - self._last_worker > NO_WORKERS_S:
            raise ClusterError(
                f"--cluster {self._address}: no worker for {NO_WORKERS_S / 60:.0f} minutes; start some, by "
                "`dask worker` with this address, and run the same command again",
                what="no-workers",
            )
