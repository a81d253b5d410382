"""Recordings on a Dask cluster: the same bytes, and one line for whatever goes wrong with the cluster."""

import contextlib
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from command_lines import ONE, check_line
from distributed import Client, Future, LocalCluster
from raising import raises
from small_benchmark import Run, copied
from small_benchmark import run as separate

from kinectbench.core.errors import ClusterError, KinectBenchError, ReleaseError, SettingsError
from kinectbench.engine import cluster as module
from kinectbench.engine import cluster_run
from kinectbench.engine.cluster import Cluster, cluster
from kinectbench.engine.executor import (
    Listener,
    Outcomes,
    Result,
    SendMessage,
    SerialExecutor,
    Task,
    WorkerLost,
)
from kinectbench.engine.on_worker import package_versions
from kinectbench.engine.parallel import build
from kinectbench.engine.stages import Job
from kinectbench.release.release import Release, open_release
from kinectbench.scoring.baselines.predict import write_baselines
from kinectbench.scoring.score import score_methods
from kinectbench.settings.file import load_benchmark

Command = Callable[..., Run]
pytestmark = [
    pytest.mark.xdist_group("resume"),
    # Of Dask's own event loop, whose sockets and coroutines end when they do.
    *(
        pytest.mark.filterwarnings(line)
        for line in (
            "ignore::ResourceWarning",
            "ignore::pytest.PytestUnraisableExceptionWarning",
            "ignore:Creating scratch directories:UserWarning",
        )
    ),
]


class Heard:
    """An audience that remembers."""

    def __init__(self) -> None:
        self.messages: list[Any] = []
        self.warnings: list[str] = []

    def heard(self, message: Any) -> None:
        self.messages.append(message)

    def warn(self, message: str, task: Any = None) -> None:
        self.warnings.append(message.format(id=task))


@pytest.fixture
def threads() -> Iterator[tuple[LocalCluster, Cluster]]:
    """A scheduler and two workers in threads of this process, which begin at once."""
    where: dict[str, Any] = {
        "processes": False,
        "dashboard_address": "127.0.0.1:0",
        "resources": {"memory_gb": 6},
    }
    with LocalCluster(n_workers=2, threads_per_worker=1, silence_logs=50, **where) as here:
        module._be_quiet()
        with Client(here, set_as_default=False) as client:
            yield here, Cluster(client, "tcp://here")


def doubled(task: int, say: SendMessage) -> int:
    say((str(task), "doubling", 0, 1))
    return 2 * task


# --- carrying out tasks -------------------------------------------------------------------------------


def test_every_task_has_its_result_and_is_heard(threads: tuple[LocalCluster, Cluster]) -> None:
    _, where = threads
    audience, tasks = Heard(), list(range(30))
    found = dict(where.outcomes(doubled, tasks, audience))
    assert found == {task: 2 * task for task in tasks}
    assert where.slots() == 2 and audience.warnings == []
    # The last may still be on their way.
    assert len(audience.messages) >= 20 and ("3", "doubling", 0, 1) in audience.messages


def test_few_tasks_are_in_flight(
    threads: tuple[LocalCluster, Cluster], monkeypatch: pytest.MonkeyPatch
) -> None:
    """All that a worker holds is blamed for its death, and ten thousand futures are too many."""
    _, where = threads
    most = []
    plain = cluster_run.Run.submit

    def noted(run: Any, number: int, *, alone: bool = False) -> None:
        plain(run, number, alone=alone)
        most.append(len(run.running))

    monkeypatch.setattr(cluster_run.Run, "submit", noted)
    assert len(list(where.outcomes(doubled, list(range(20)), Heard()))) == 20
    assert max(most) == where.slots() + 1


def wrong(task: int, say: SendMessage) -> int:
    raise ReleaseError("pairs/a/000.npz: changed") if task else ZeroDivisionError("division by zero")


def test_what_a_task_raises_comes_here(threads: tuple[LocalCluster, Cluster]) -> None:
    _, where = threads
    with raises(ReleaseError, "release.damaged", match="changed"):
        list(where.outcomes(wrong, [1], Heard()))
    with raises(ClusterError, "cluster.task-failed"):
        list(where.outcomes(wrong, [0], Heard()))


def asked_gb(task: int, say: SendMessage) -> float:
    from distributed import get_worker

    worker: Any = get_worker()
    key = worker.get_current_task()
    return float(worker.state.tasks[key].resource_restrictions["memory_gb"])


def test_memory_is_asked_for_as_far_as_there_is_any(threads: tuple[LocalCluster, Cluster]) -> None:
    _, where = threads
    found = dict(where.outcomes(asked_gb, [1, 4, 9], Heard(), lambda task: float(task)))
    assert found == {1: 1.0, 4: 4.0, 9: 6.0}


def test_memory_is_asked_for_though_workers_come_late(
    threads: tuple[LocalCluster, Cluster], monkeypatch: pytest.MonkeyPatch
) -> None:
    here, where = threads
    here.scale(0)
    while where.slots():
        time.sleep(0.1)
    monkeypatch.setattr(where, "_largest_gb", 0.0)
    threading.Timer(2.0, here.scale, [1]).start()
    assert dict(where.outcomes(asked_gb, [4], Heard(), lambda task: float(task))) == {4: 4.0}


def test_who_asks_for_the_memory_of_a_worker_that_went_is_not_waiting_for_ever(
    threads: tuple[LocalCluster, Cluster], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, where = threads
    monkeypatch.setattr(module, "RESTART_S", 3.0)
    where.slots()
    where._largest_gb, where._seen_largest = 9.0, time.monotonic()  # as if one of 9 GB had just gone
    assert dict(where.outcomes(asked_gb, [9, 8], Heard(), lambda task: float(task))) == {9: 6.0, 8: 6.0}


def test_a_result_that_is_lost_with_its_worker_is_waited_for(
    threads: tuple[LocalCluster, Cluster], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A task that has ended is begun again if its worker dies before the result is here."""
    _, where = threads
    plain, lost = Future.result, list[str]()

    def slow(future: Any, timeout: Any = None) -> Any:
        if len(lost) < 3:
            lost.append(future.key)
            raise TimeoutError("timed out after 20 s.")
        return plain(future, timeout)

    monkeypatch.setattr(Future, "result", slow)
    assert dict(where.outcomes(doubled, [1, 2], Heard())) == {1: 2, 2: 4}
    assert len(lost) == 3


held: dict[str, int] = {}
released = threading.Event()


def slow_once(task: int, say: SendMessage) -> int:
    """The last task sleeps, but not where it is tried a second time; workers are threads of this process."""
    held[str(task)] = held.get(str(task), 0) + 1
    released.wait(200 if task == 9 and held["9"] == 1 else 0.05)
    return task


def test_the_slowest_is_tried_twice(threads: tuple[LocalCluster, Cluster]) -> None:
    _, where = threads
    held.clear()
    released.clear()
    started = time.monotonic()
    found = [task for task, _ in where.outcomes(slow_once, list(range(10)), Heard(), slowest_twice=True)]
    assert sorted(found) == list(range(10)) and held["9"] == 2
    assert time.monotonic() - started < 150
    released.set()


# --- what goes wrong ----------------------------------------------------------------------------------


def test_a_scheduler_that_dies_is_told(tmp_path: Path) -> None:
    file = tmp_path / "scheduler.json"
    run = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard"]
    where = ["--host", "127.0.0.1", "--scheduler-file", str(file)]
    with subprocess.Popen([*run, *where], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as scheduler:
        while not file.is_file() or not file.read_text():
            time.sleep(0.1)
        threading.Timer(2.0, scheduler.kill).start()
        with (
            raises(ClusterError, "cluster.lost", match=r"scheduler\.json") as told,
            cluster(str(file)) as found,
        ):
            list(found.outcomes(doubled, [1], Heard()))
    assert len(told.value.lines) == 1


def test_no_worker_is_waited_for_without_end(
    threads: tuple[LocalCluster, Cluster], monkeypatch: pytest.MonkeyPatch
) -> None:
    here, where = threads
    here.scale(0)
    monkeypatch.setattr(module, "NO_WORKERS_S", 2.0)
    with raises(ClusterError, "cluster.no-workers"):
        while True:
            list(where.outcomes(doubled, [1], Heard()))


def test_a_worker_of_another_version_is_refused(
    threads: tuple[LocalCluster, Cluster], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, where = threads
    wanted = dict(package_versions()) | {"kinectbench": "9.9.9"}
    monkeypatch.setattr(cluster_run, "package_versions", lambda: wanted)
    with raises(ClusterError, "cluster.other-versions", match=r"9\.9\.9") as told:
        list(where.outcomes(doubled, [1], Heard()))
    assert len(told.value.lines) == 1


@pytest.mark.parametrize(
    "address",
    ["", "x", "local:0", "local:", "tcp://", "tcp://a", "tcp://x:y", "http://a:1", "no-such-file.json"],
)
def test_what_is_no_address_is_refused(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CONNECT_S", 0.5)
    with raises(SettingsError, "settings.wrong-value", match="--cluster"), cluster(address):
        pass


@pytest.mark.parametrize("content", ["{}", '{"address": 3}', "[1]", "name: chairs", "\0", "[" * 9999])
def test_what_is_no_file_of_a_scheduler_is_refused(content: str, tmp_path: Path) -> None:
    (tmp_path / "s.json").write_text(content)
    file = str(tmp_path / "s.json")
    with raises(SettingsError, "settings.wrong-value", match=r"s\.json"), cluster(file):
        pass


def test_the_loggers_of_dask_are_silent(tmp_path: Path) -> None:
    """In a process of its own: Dask sets their levels when it is imported."""
    code = """if True:
        import logging
        from kinectbench.engine.cluster import cluster
        if __name__ == "__main__":
            with cluster("local:1"):
                for name in ("distributed", "distributed.client", "distributed.core", "tornado.application"):
                    assert not logging.getLogger(name).isEnabledFor(logging.CRITICAL), name
    """
    (tmp_path / "run.py").write_text(code)
    subprocess.run([sys.executable, str(tmp_path / "run.py")], check=True, timeout=120)


def test_where_no_scheduler_answers(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "benchmark.yaml").write_text(ONE)
    monkeypatch.setattr(module, "CONNECT_S", 1.0)
    (tmp_path / "s.json").write_text('{"address": "tcp://127.0.0.1:9"}')
    for address in ("tcp://127.0.0.1:9", str(tmp_path / "s.json")):
        run = command(tmp_path, "build", "--cluster", address)
        check_line(run, 1, f"--cluster {address}|no scheduler answers there")


def test_a_port_that_takes_calls_and_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CONNECT_S", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        with (
            raises(ClusterError, "cluster.no-answer", match="for 3 s"),
            cluster(address),
        ):
            pass


def test_a_scheduler_that_falls_silent_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is stopped, not dead: its sockets stay open."""
    monkeypatch.setattr(module, "SILENT_S", 2.0)
    file = tmp_path / "scheduler.json"
    run = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard"]
    where = ["--host", "127.0.0.1", "--scheduler-file", str(file)]
    with subprocess.Popen([*run, *where], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as scheduler:
        try:
            while not file.is_file() or not file.read_text():
                time.sleep(0.1)
            with raises(ClusterError, "cluster.lost", match="lost the scheduler"), cluster(str(file)) as dask:
                dask.slots()
                scheduler.send_signal(signal.SIGSTOP)
                list(dask.outcomes(doubled, [1], Heard()))
        finally:
            scheduler.kill()


def test_tls_that_is_not_set_is_told_at_once(tmp_path: Path) -> None:
    """In a process of its own: a traceback may come when its objects end, after a long wait."""
    (tmp_path / "benchmark.yaml").write_text(ONE)
    started = time.monotonic()
    for address, variables in (
        ("tls://127.0.0.1:9", {}),
        ("tcp://127.0.0.1:9", {"DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION": "true"}),
        ("tls://127.0.0.1:9", {"DASK_DISTRIBUTED__COMM__TLS__CA_FILE": "missing.pem"}),
        ("local:1", {"DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION": "true"}),
    ):
        run = separate(tmp_path, "build", "--cluster", address, variables=variables)
        check_line(run, 1, f"--cluster {address}|no scheduler answers there|distributed.comm.tls|ca-file")
    assert time.monotonic() - started < 4 * module.CONNECT_S


# --- scores -------------------------------------------------------------------------------------------


def test_scores_are_those_of_one_process(
    threads: tuple[LocalCluster, Cluster], release: Release, tmp_path: Path
) -> None:
    write_baselines(release, tmp_path / "predictions", ["partial", "mirror"])
    asked = release, tmp_path / "predictions"
    plain = score_methods(*asked, tmp_path / "plain", surface=False)
    found = score_methods(*asked, tmp_path / "found", surface=False, jobs=threads[1])
    assert [table.text() for table in found] == [table.text() for table in plain]


class Elsewhere(SerialExecutor):
    """An executor whose processes started in another folder, or are killed."""

    def __init__(self, killed: bool = False) -> None:
        self.killed = killed

    def outcomes(
        self,
        function: Callable[[Task, SendMessage], Result],
        tasks: Sequence[Task],
        listener: Listener,
        memory_gb: Callable[[Task], float] | None = None,
        *,
        slowest_twice: bool = False,
    ) -> Outcomes[Task, Result]:
        if self.killed:
            yield from ((task, WorkerLost("killed on {id}")) for task in tasks)
            return
        with contextlib.chdir("/"):
            found = list(super().outcomes(function, tasks, listener))
        yield from found


def test_relative_paths_are_those_of_whoever_asks(
    small: Path, release: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copied(small, tmp_path / "b")
    write_baselines(release, tmp_path / "predictions", ["partial"])
    shutil.copytree(release.folder, tmp_path / "benchmark")
    monkeypatch.chdir(tmp_path)
    settings = load_benchmark(Path("b/benchmark.yaml"), ())
    jobs = [Job(settings, recording, Path("b")) for recording in settings.recordings]
    outcomes = build(jobs, executor=Elsewhere())
    assert [(outcome.error, len(outcome.current)) for outcome in outcomes] == [(None, 6), (None, 6)]
    asked = open_release(Path("benchmark")), Path("predictions"), Path("out")
    (table,) = score_methods(*asked, surface=False, jobs=Elsewhere())
    assert table.complete


def test_a_score_whose_worker_is_killed_is_told(release: Release, tmp_path: Path) -> None:
    write_baselines(release, tmp_path / "predictions", ["partial"])
    with raises(KinectBenchError, "run.process-killed"):
        score_methods(release, tmp_path / "predictions", tmp_path, jobs=Elsewhere(killed=True))
