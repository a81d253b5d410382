"""Workers of a cluster that die, and the page that tells of them."""

import dataclasses
import signal
import threading
import time
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from slow import slow
from small_benchmark import copied, hashes
from test_cluster import Heard
from test_many_recordings import Deadly, Listener

from kinectbench.engine import cluster as module
from kinectbench.engine.cluster import Cluster, cluster
from kinectbench.engine.executor import SendMessage
from kinectbench.engine.parallel import build
from kinectbench.engine.stages import Job
from kinectbench.settings.file import load_benchmark

pytestmark = [
    pytest.mark.xdist_group("resume"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


def dies_once(task: tuple[int, str], say: SendMessage) -> int:
    """The first try of the task that names a file kills its worker."""
    number, marker = task
    if marker and not Path(marker).exists():
        Path(marker).touch()
        time.sleep(1)
        signal.raise_signal(signal.SIGKILL)
    return number


@pytest.mark.parametrize("allowed", [slow(0), 2])
def test_a_worker_that_dies_is_told_once_and_its_recording_named(
    allowed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether Dask gives the recording to another worker, or we do."""
    monkeypatch.setitem(module.OF_LOCAL, "distributed.scheduler.allowed-failures", allowed)
    audience, tasks = Heard(), [(0, str(tmp_path / "tried")), (1, "")]
    with cluster("local:1") as where:
        found = {task[0]: result for task, result in where.outcomes(dies_once, tasks, audience)}
    assert found == {0: 0, 1: 1}
    told = [line for line in audience.warnings if line.startswith("(0, ")]
    words = (
        "died, perhaps for lack of memory; the recording is tried again"
        if allowed
        else "tried once more at the end, alone"
    )
    assert len(told) == 1 and words in told[0], audience.warnings


def test_recordings_on_processes_give_the_same_bytes_and_a_deadly_one_fails_alone(
    small: Path, tmp_path: Path
) -> None:
    root = copied(small, tmp_path / "b")
    settings = load_benchmark(root / "benchmark.yaml", ())
    chair, table = (Job(settings, recording, root) for recording in settings.recordings)
    deadly = dataclasses.replace(chair, root=Deadly(tmp_path / "elsewhere"))
    listener = Listener()
    with cluster("local:2") as where:
        assert where.slots() == 2
        outcomes = build([deadly, table], force=("ingest", "pairs"), watcher=listener, executor=where)
    assert outcomes[0].error is not None and "its worker was killed although no other" in outcomes[0].error
    assert (tmp_path / "elsewhere" / "build" / "chair" / "failed.json").is_file()
    assert outcomes[1].error is None and outcomes[1].made == ("ingest", "pairs")
    assert hashes(root / "build" / "table") == hashes(small / "build" / "table")
    # The table's result may have been on the worker that the chair killed: it is made again, and told.
    assert all(": its worker" in line for line in listener.warnings), listener.warnings
    alone = [line for line in listener.warnings if "tried once more at the end, alone" in line]
    assert len(alone) == 1 and alone[0].startswith("chair: "), listener.warnings


def test_a_dashboard_is_told_where_it_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    class Page(BaseHTTPRequestHandler):
        status, text = 200, b"<title>Dask: Status</title>"

        def do_GET(self) -> None:
            self.send_response(self.status)
            self.end_headers()
            self.wfile.write(self.text)

        def log_message(self, *_: Any) -> None: ...

    with HTTPServer(("127.0.0.1", 0), Page) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        link = f"http://127.0.0.1:{server.server_port}/status"
        where = Cluster(SimpleNamespace(dashboard_link=link), "tcp://here")
        assert where.dashboard == link
        monkeypatch.setattr(Page, "text", b"<p>Dask needs bokeh>=3.1.0 for the dashboard.</p>")
        assert where.dashboard == ""
        monkeypatch.setattr(Page, "status", 404)  # of a scheduler started with --no-dashboard
        assert where.dashboard == ""
        server.shutdown()
    assert where.dashboard == ""
