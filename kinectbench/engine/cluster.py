"""A cluster as an executor: Dask's scheduler assigns tasks to workers, local or remote.

The scheduler keeps only running tasks: results are on disk. If any part of the cluster
dies, the same command resumes.
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

from kinectbench.core.errors import ClusterError, SettingsError
from kinectbench.core.untrusted import printable, read_plain_text
from kinectbench.core.untrusted_text import strict_json
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
# A scheduler's file has some hundred bytes, and some hundred more for each worker.
MOST_FILE_BYTES = 64 << 20
# Seconds: between two looks at the workers; without a scheduler's answer; without any worker; until Dask's
# page answers.
LOOK_S, CONNECT_S, NO_WORKERS_S, DASHBOARD_S = 1.0, 20.0, 900.0, 2.0
# Seconds without an answer of a scheduler that has answered before: a busy one may be silent for a minute.
SILENT_S = 300.0
# A worker that was killed is started again by its nanny within seconds; after this it is gone.
RESTART_S = 60.0
# Of a scheduler that is started here; docs/cluster.md says how others are given them. Three tries; a worker
# that is silent for 20 minutes is dead: compiled code may hold the interpreter's lock for minutes. Tasks hold
# their arrays themselves, so that Dask has nothing to spill.
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
        SettingsError: it is something else, or Dask is not installed.
        ClusterError: no scheduler answers there.
    """
    local = re.fullmatch(r"local:([1-9][0-9]{0,3})", address)
    end = time.monotonic() + CONNECT_S
    while address.endswith(".json") and not Path(address).is_file() and time.monotonic() < end:
        time.sleep(0.1)  # a scheduler that is just being started
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
        except Exception as error:  # of Dask's many kinds
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
    """Refuse a value that is neither an address nor a scheduler file."""
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
    """A client of the scheduler at an address, or of a new local one with this many processes."""
    from distributed import Client, LocalCluster

    _be_quiet()  # not before: the levels of its loggers are set when it is imported

    class OwnClient(Client):  # type: ignore[misc]
        """Waits for a scheduler for a limited time; we close it.

        At its own end one that never connected waits for 40 s and prints a traceback.
        """

        async def _start(self, **how: object) -> None:
            # To connect, to be greeted and to be known; of these Dask limits only the first.
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
            memory_limit=0,  # as much as there is, like the pool's processes
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
    """Silence Dask's logs: we report errors ourselves, in one line."""
    for name in ("distributed", *logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    warnings.filterwarnings("ignore", module=r"distributed\.")


class Cluster:
    """The workers of a Dask scheduler; one task for each of their threads at a time."""

    def __init__(self, client: "Client", address: str) -> None:
        self._client, self._address = client, address
        self._slots, self._looked = 0, float("-inf")
        self._largest_gb, self._seen_largest = 0.0, float("-inf")
        self._last_worker = time.monotonic()

    @property
    def dashboard(self) -> str:
        """Address of Dask's dashboard; "" if it does not answer.

        The scheduler names an address also where it was started with `--no-dashboard` (404), and answers
        without `bokeh` that it needs it.
        """
        try:
            link = str(self._client.dashboard_link)
            with build_opener(ProxyHandler({})).open(link, timeout=DASHBOARD_S) as answer:
                return "" if b"needs bokeh" in answer.read(500) else link
        except Exception:  # of Dask's many kinds, and of HTTP's
            return ""

    def slots(self) -> int:
        """The number of worker threads, at most a second old."""
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
        """See `Executor`. A task whose workers were killed is tried once more at the end, alone.

        Args:
            function: of the task.
            tasks: to run.
            listener: receives the messages.
            memory_gb: expected memory of a task, where workers have a resource `memory_gb`; alone it
                may have twice as much.
            slowest_twice: see `Executor`.
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
        """The largest resource `memory_gb` of a worker in the last minute; 0: no worker has it."""
        self._look()
        return self._largest_gb

    def gone(self) -> ClusterError:
        """The message for a scheduler that has stopped answering."""
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
        except Exception as error:  # of Dask's many kinds
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
