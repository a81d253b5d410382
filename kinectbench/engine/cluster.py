"""A cluster as an executor: Dask's scheduler hands tasks to workers, here or on other machines.

The scheduler keeps nothing but what is in flight: what is done lies on disk. Whatever part of the cluster
dies, the same command goes on from there.
"""

import logging
import pickle
import re
import ssl
import time
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from statistics import median
from typing import TYPE_CHECKING, Any, Generic

from kinectbench.core.errors import ClusterError, KinectBenchError, SettingsError
from kinectbench.core.untrusted import printable, read_plain_text
from kinectbench.core.untrusted_text import strict_json
from kinectbench.engine.executor import Audience, Lost, Outcomes, Result, Say, Task
from kinectbench.engine.interrupts import interrupts_held
from kinectbench.engine.on_worker import call, package_versions

if TYPE_CHECKING:
    from distributed import Client, Future

WANTED = (
    "give tcp://HOST:PORT or tls://HOST:PORT of a scheduler, the file that `dask scheduler --scheduler-file` "
    "wrote, or local:N for N processes here"
)
TLS_HINT = "; Dask's settings distributed.comm.tls name the files: ca-file, client.cert, client.key"
MISSING = "--cluster needs Dask; install it by `pip install 'kinectbench[cluster]'`"
KILLED_ALONE = (
    "its worker was killed although no other recording ran, perhaps for lack of memory; start workers with "
    "more memory and run again, or look for the reason with `kinectbench build {id} --jobs 1`"
)
# A scheduler's file has some hundred bytes, and some hundred more for each worker (own choice).
MOST_FILE_BYTES = 64 << 20
# Seconds: between two looks at the workers; without a scheduler's answer; without any worker (own choices).
LOOK_S, CONNECT_S, NO_WORKERS_S = 1.0, 20.0, 900.0
# A worker that was killed is started again by its nanny within seconds; after this it is gone (own choice).
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
    """Connect to a cluster, or start one here; TLS is as Dask's own configuration says.

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
        raise SettingsError(MISSING) from error
    with dask.config.set(OF_LOCAL if local else {}), ExitStack() as stack:
        try:
            with interrupts_held():
                client = _connected(address, int(local[1]) if local else 0, stack)
        except Exception as error:  # of Dask's many kinds
            first: BaseException = error
            while first.__cause__ is not None:
                first = first.__cause__
            why, of_files = _line(first), isinstance(first, ssl.SSLError | FileNotFoundError)
            hint = TLS_HINT if of_files or re.search("TLS|encryption", why) else ""
            raise ClusterError(f"--cluster {address}: no scheduler answers there ({why}){hint}") from error
        yield Cluster(client, address)


def _check_scheduler_file(address: str) -> None:
    """Refuse what is no address and no file that a scheduler wrote."""
    said = f"--cluster {printable(address, 200)}"
    if not Path(address).is_file():
        missing = "no such file; " if address.endswith(".json") else ""
        raise SettingsError(f"{said}: {missing}{WANTED}")
    try:
        content = strict_json(read_plain_text(Path(address), MOST_FILE_BYTES))
    except (OSError, ValueError, RecursionError):
        content = None
    if not isinstance(content, dict) or not isinstance(content.get("address"), str):
        raise SettingsError(f"{said}: no file of a scheduler; {WANTED}")


def _connected(address: str, local: int, stack: ExitStack) -> "Client":
    """A client of the scheduler at an address, or of one with so many processes that is started here."""
    from distributed import Client, LocalCluster

    _be_quiet()  # not before: the levels of its loggers are set when it is imported

    class OwnClient(Client):  # type: ignore[misc]
        """Closed by us: at its own end one that never connected waits for 40 s and prints a traceback."""

        def __del__(self) -> None:
            pass

    where = {"scheduler_file": address} if Path(address).is_file() else {"address": address}
    if local:
        here = LocalCluster(
            n_workers=local,
            threads_per_worker=1,
            memory_limit=0,  # as much as there is, like the pool's processes
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        )
        stack.callback(here.close, timeout=CONNECT_S)
        where = {"address": here}
    client = OwnClient(**where, timeout=CONNECT_S, set_as_default=False)
    stack.callback(client.close, timeout=CONNECT_S)
    return client


def _be_quiet() -> None:
    """What goes wrong is told by us, in one line."""
    for name in ("distributed", *logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    warnings.filterwarnings("ignore", module=r"distributed\.")


def _line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


class Cluster:
    """The workers of a Dask scheduler; one task for each of their threads at a time."""

    def __init__(self, client: "Client", address: str) -> None:
        self._client, self._address = client, address
        self._slots, self._looked = 0, float("-inf")
        self._largest_gb, self._seen_largest = 0.0, float("-inf")
        self._last_worker = time.monotonic()

    @property
    def dashboard(self) -> str:
        """Address of Dask's page about the cluster; it needs `bokeh` where the scheduler runs."""
        return str(self._client.dashboard_link)

    def slots(self) -> int:
        """How many threads the workers have, as it was a second ago at most."""
        self._look()
        return self._slots

    def outcomes(
        self,
        function: Callable[[Task, Say], Result],
        tasks: Sequence[Task],
        audience: Audience,
        memory_gb: Callable[[Task], float] | None = None,
        *,
        slowest_twice: bool = False,
    ) -> Outcomes[Task, Result]:
        """See `Executor`. A task whose workers were killed is tried once more at the end, alone.

        Args:
            function: of the task.
            tasks: what is to be done.
            audience: who hears of it.
            memory_gb: what a task is expected to need, where workers have a resource `memory_gb`; alone it
                may have twice as much.
            slowest_twice: see `Executor`.
        """
        run = _Run(self, self._client, function, tasks, audience, memory_gb)
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
        """The largest resource `memory_gb` of a worker there was in the last minute; 0: none has it."""
        self._look()
        return self._largest_gb

    def gone(self) -> ClusterError:
        """What is told when the scheduler does not answer any more."""
        return ClusterError(
            f"--cluster {self._address}: lost the scheduler; start it again and run the same command again: "
            "what is done is kept"
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
                "`dask worker` with this address, and run the same command again"
            )


@dataclass
class _Run(Generic[Task, Result]):
    """The tasks of one call of `outcomes`, by their numbers."""

    cluster: Cluster
    client: "Client"
    function: Callable[[Task, Say], Result]
    tasks: Sequence[Task]
    audience: Audience
    memory_gb: Callable[[Task], float] | None
    events: "SimpleQueue[Any]" = field(default_factory=SimpleQueue)
    running: "dict[Future, int]" = field(default_factory=dict)
    asked_gb: dict[int, float] = field(default_factory=dict)
    begun: dict[int, float] = field(default_factory=dict)
    seconds: list[float] = field(default_factory=list)
    alone: set[int] = field(default_factory=set)
    killed: deque[int] = field(default_factory=deque)

    def __post_init__(self) -> None:
        self.waiting = deque(range(len(self.tasks)))
        self.topic = f"kinectbench-{self.client.id}"
        self.client.subscribe_topic(self.topic, lambda event: self.events.put(event[1]))
        self.versions = package_versions()

    def submit(self, number: int, *, alone: bool = False) -> None:
        """Give a task to the scheduler."""
        task, largest_gb = self.tasks[number], self.cluster.largest_gb()
        asked_gb = 0.0
        if self.memory_gb is not None and largest_gb:
            asked_gb = min(self.memory_gb(task) * (2 if alone else 1), largest_gb)
        self.asked_gb[number] = asked_gb
        packed = pickle.dumps((self.function, task))  # only a worker may unpack it: it may be what kills one
        how = {"pure": False, "resources": {"memory_gb": asked_gb} if asked_gb else None}
        key = f"{self.topic}-{number}-{time.monotonic_ns()}"
        try:
            future = self.client.submit(call, packed, self.topic, self.versions, key=key, **how)
        except Exception as error:  # the scheduler went since it was looked at
            raise self.cluster.gone() from error
        self.running[future] = number
        self.begun.setdefault(number, time.monotonic())
        if alone:
            self.alone.add(number)
        future.add_done_callback(self.events.put)

    def ask_for_less(self) -> None:
        """Submit again what asks for more memory than any worker has since one went: nobody would do it."""
        largest_gb = self.cluster.largest_gb()
        for future, number in list(self.running.items()):
            if self.asked_gb[number] > largest_gb:
                del self.running[future]
                future.cancel()
                self.submit(number, alone=number in self.alone)

    def submit_slowest(self) -> None:
        """Give the task that has been running longest to a second worker, if it is slower than most were."""
        copies = Counter(self.running.values())
        single = [number for number, count in copies.items() if count == 1 and number not in self.alone]
        slowest = min(single, key=self.begun.__getitem__, default=None)
        usual_s = median(self.seconds) if self.seconds else float("inf")
        if slowest is not None and time.monotonic() - self.begun[slowest] > 2 * usual_s:
            self.submit(slowest)

    def ended(self) -> Iterator[tuple[Task, Result | Lost]]:
        """Wait a moment for what happens, and yield the tasks that have ended."""
        try:
            event = self.events.get(timeout=LOOK_S)
        except Empty:
            return
        if isinstance(event, tuple | list):
            self.audience.heard(tuple(event))
            return
        number = self.running.pop(event, None)
        if number is None:
            return  # the copy of a task that was faster elsewhere
        try:
            outcome = self._outcome(event, number)
        except TimeoutError:  # its worker died with the result, which is made again, or is slow to answer
            self.running[event] = number
            event.add_done_callback(self.events.put)
            return
        if outcome is None:
            return
        for copy in [future for future, same in self.running.items() if same == number]:
            del self.running[copy]
            copy.cancel()
        self.seconds.append(time.monotonic() - self.begun.pop(number))
        yield self.tasks[number], outcome

    def _outcome(self, future: "Future", number: int) -> Result | Lost | None:
        """What has become of a task; None if it is to be tried once more, at the end, or runs elsewhere.

        Raises:
            TimeoutError: its result does not come; the future ends again.
        """
        from distributed.scheduler import KilledWorker, NoValidWorkerError

        try:
            result: Result = future.result(timeout=CONNECT_S)
            return result
        except (KilledWorker, NoValidWorkerError):
            if number in self.running.values():
                return None
            if number in self.alone:
                return Lost(KILLED_ALONE)
            self.audience.warn(
                "workers were killed, perhaps for lack of memory; the recording that was on them is tried "
                "once more at the end, alone"
            )
            self.killed.append(number)
            return None
        except KinectBenchError:
            raise
        except Exception as error:
            if future.status == "pending" or (
                future.status == "finished" and isinstance(error, TimeoutError)
            ):
                raise TimeoutError from error
            if future.status != "error":
                raise self.cluster.gone() from error
            raise ClusterError(
                f"a worker could not carry out its task ({type(error).__name__}: {_line(error)}); every "
                f"worker needs kinectbench {self.versions['kinectbench']} and the packages of this machine"
            ) from error

    def close(self) -> None:
        """Let go of what still runs: it is stopped with its worker, or ends by itself unheard."""
        for future in self.running:
            future.cancel()
        self.running.clear()
