"""Many recordings, several runs: none stops the others, one waits for the other, and people are told."""

import contextlib
import dataclasses
import errno
import json
import os
import pickle
import signal
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path, PosixPath

import pytest
from slow import slow
from small_benchmark import Run, copied, finish, hashes, leftovers, start
from test_resume import group, wait_for, wait_until_all_ended

from kinectbench.core.storage import replaced_folder
from kinectbench.engine import executor, parallel
from kinectbench.engine.executor import Pool, SendMessage, WorkerLost
from kinectbench.engine.locks import locked, sweep
from kinectbench.engine.parallel import build
from kinectbench.engine.pipeline import Outcome
from kinectbench.engine.stages import Job
from kinectbench.settings.file import load_benchmark, parse_benchmark

STAGES = ("ingest", "track", "fuse", "segment", "sample-views", "pairs")
pytestmark = pytest.mark.xdist_group("resume")

Command = Callable[..., Run]


class Deadly(PosixPath):
    """Whoever unpickles this path is killed, as by a system that runs out of memory."""

    def __reduce__(self) -> tuple[Callable[[int], None], tuple[int]]:
        return signal.raise_signal, (signal.SIGKILL,)


class Listener:
    """A watcher that remembers."""

    def __init__(self) -> None:
        self.ends: list[str] = []
        self.warnings: list[str] = []

    def __call__(self, recording: str, stage: str, done: int, total: int) -> None: ...

    def heard(self, message: object) -> None: ...

    def ended(self, outcome: Outcome) -> None:
        self.ends.append(outcome.recording)

    def warn(self, message: str, task: object = None) -> None:
        self.warnings.append(message)


# --- one recording, several threads --------------------------------------------------------------------


def test_a_recording_that_is_alone_gives_the_same_bytes_with_any_number_of_threads(
    small: Path, tmp_path: Path
) -> None:
    """Of three what `build --jobs 1` made of it by one."""
    settings = load_benchmark(small / "benchmark.yaml", ())
    root = copied(small, tmp_path / "three", "recordings/chair")
    (outcome,) = build([Job(settings, settings.recordings[0], root)], workers=3)
    assert outcome.error is None and set(outcome.made) == set(STAGES)
    assert hashes(root / "build" / "chair") == hashes(small / "build" / "chair")


def test_a_recording_that_is_alone_takes_no_more_threads_than_memory_is_measured_for(
    small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = load_benchmark(small / "benchmark.yaml", ())
    asked: list[int] = []

    def counted(threads: int) -> contextlib.AbstractContextManager[None]:
        asked.append(threads)
        return contextlib.nullcontext()

    monkeypatch.setattr(parallel, "using_threads", counted)
    for workers in (1, 3, 64):
        parallel.build([Job(settings, settings.recordings[0], small)], workers=workers)
    assert asked == [1, 3, parallel.MOST_THREADS]


# --- thousands of recordings --------------------------------------------------------------------------


def sent_bytes(count: int, monkeypatch: pytest.MonkeyPatch) -> int:
    """What worker processes are sent to build so many recordings, bytes."""
    rows = "".join(f"  - {{id: r{n:05d}, path: r{n:05d}, category: chair}}\n" for n in range(count))
    settings = parse_benchmark(f"name: many\nrecordings:\n{rows}", "x.yaml")
    sent: list[Job] = []

    def done_at_once(processes: object, function: object, jobs: list[Job]) -> list[Future[Outcome]]:
        sent.extend(jobs)
        futures = [Future[Outcome]() for _ in jobs]
        for future, job in zip(futures, jobs, strict=True):
            future.set_result(Outcome(job.recording.id, (), (), "no such recording", 0.0))
        return futures

    monkeypatch.setattr(executor, "worker_pool", lambda *_: contextlib.nullcontext())
    monkeypatch.setattr(executor, "submit_all", done_at_once)
    jobs = [Job(settings, recording, Path("root")) for recording in settings.recordings]
    listener = Listener()
    outcomes = build(jobs, workers=2, watcher=listener)
    assert [outcome.recording for outcome in outcomes] == [job.recording.id for job in jobs]
    assert len(listener.ends) == count
    for job, alone in zip(jobs, sent, strict=True):
        assert alone.recording == job.recording and alone.root == job.root
        assert alone.settings.fusion == job.settings.fusion and alone.settings.recordings == [job.recording]
    return sum(len(pickle.dumps(job)) for job in sent)


def test_what_processes_are_sent_grows_with_the_recordings_and_no_faster(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    once, twice = sent_bytes(100, monkeypatch), sent_bytes(200, monkeypatch)
    assert twice == 2 * once  # four times, if all are sent with each


def test_an_interrupt_leaves_no_folders_of_recordings_that_had_not_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = parse_benchmark(
        "name: two\nrecordings:\n- {id: a, path: a, category: c}\n- {id: b, path: b, category: c}\n", "x.yaml"
    )

    def interrupted(*_: object) -> list[Job]:
        raise KeyboardInterrupt

    monkeypatch.setattr(executor, "_until_killed", interrupted)
    with pytest.raises(KeyboardInterrupt):
        build([Job(settings, recording, tmp_path) for recording in settings.recordings], workers=2)
    assert list(tmp_path.iterdir()) == []


# --- killed workers -----------------------------------------------------------------------------------


def test_a_recording_that_kills_its_process_fails_alone(small: Path, tmp_path: Path) -> None:
    settings = load_benchmark(small / "benchmark.yaml", ())
    chair, table = (Job(settings, recording, small) for recording in settings.recordings)
    deadly = dataclasses.replace(chair, root=Deadly(tmp_path))
    listener = Listener()
    outcomes = build([deadly, table], workers=2, watcher=listener)
    assert [outcome.recording for outcome in outcomes] == ["chair", "table"]
    assert (
        outcomes[0].error is not None and "its process was killed although no other ran" in outcomes[0].error
    )
    kept = json.loads((tmp_path / "build" / "chair" / "failed.json").read_text())
    assert kept == {
        "format_version": 1,
        "stage": None,
        "error": outcomes[0].error,
        "code": "run.process-killed",
    }
    assert outcomes[1].error is None and len(outcomes[1].current) == 6
    assert sorted(listener.ends) == ["chair", "table"]
    (warning,) = listener.warnings
    assert "a worker process was killed" in warning and "going on with 1 recording at a time" in warning


def once_killed(task: int, say: SendMessage) -> int:
    """The first task kills its process; the others tell it."""
    if task == 0:
        os._exit(1)
    time.sleep(0.3)  # so that none takes the next task, too
    return os.getpid()


def test_once_the_culprit_is_known_all_processes_are_at_work_again() -> None:
    # Enough of them that a process that is slow to start, on a busy machine, finds some left.
    found = dict(Pool(2).outcomes(once_killed, list(range(12)), Listener()))
    assert isinstance(found[0], WorkerLost)
    # The second task may have ended in the first pool, where the first task's process was slow to start.
    assert len({found[task] for task in range(2, 12)}) >= 2


TRACKED = ("sequence", "trajectory")


def test_a_killed_worker_costs_nothing(small: Path, tmp_path: Path) -> None:
    root = copied(small, tmp_path / "b", "benchmark.yaml", "recordings")
    process = start(root, "track", "--jobs", "2")
    wait_for(lambda: bool(list((root / "build").glob("*/.*.part"))), process)
    workers = [pid for pid in group(process) if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    os.kill(workers[-1], signal.SIGKILL)
    result = finish(process)
    assert result.status == 0, result
    assert "warning: a worker process was killed" in result.err and "Traceback" not in result.err
    wait_until_all_ended(process)
    whole = hashes(small / "build").items()
    assert hashes(root / "build") == {name: of for name, of in whole if name.split("/")[1] in TRACKED}
    assert leftovers(root) == []


# --- locks --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "held", "status"),
    [("build", "build/chair", 3), slow("track", "build/chair", 3), ("publish", "build", 1)],
)
def test_a_second_run_that_does_not_wait_says_who_is_there(
    command: Command, small: Path, tmp_path: Path, name: str, held: str, status: int
) -> None:
    root = copied(small, tmp_path / "b")
    before = hashes(root)
    with locked(root / held):
        result = command(root, name, "--no-wait", "--force", "--jobs", "1")
    errors = [line for line in result.err.splitlines() if "error: " in line]
    assert result.status == status and len(errors) == 1
    assert f"{held}: in use by process {os.getpid()} on " in errors[0] and "(`kinectbench" in errors[0]
    if name == "publish":
        assert hashes(root) == before
    assert command(root, name, "--no-wait", "--jobs", "1").status == 0


def test_a_run_that_waits_says_for_whom(small: Path, tmp_path: Path) -> None:
    root = copied(small, tmp_path / "b")
    with locked(root / "build" / "chair"):
        process = start(root, "build", "chair")
        assert process.stderr is not None
        line = process.stderr.readline()
        assert f"chair: waiting for process {os.getpid()} on " in line and "since 20" in line
        assert process.poll() is None
    assert finish(process).status == 0


def test_a_lock_names_nobody_once_it_is_free(tmp_path: Path) -> None:
    with locked(tmp_path):
        assert f"process {os.getpid()} on" in (tmp_path / ".lock").read_text()
    assert (tmp_path / ".lock").read_text() == ""


# --- what killed runs leave ---------------------------------------------------------------------------


def test_what_was_moved_aside_comes_back_if_nothing_took_its_place(tmp_path: Path) -> None:
    for name in (".views.01ab.old", ".views.01ab.part", ".pairs.02cd.old", "pairs"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_text(name)
    sweep(tmp_path / "*")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["pairs", "views"]
    assert (tmp_path / "views" / "file").read_text() == ".views.01ab.old"
    assert (tmp_path / "pairs" / "file").read_text() == "pairs"


def test_a_folder_that_cannot_be_renamed_into_place_leaves_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with replaced_folder(tmp_path / "views") as folder:
        (folder / "file").write_text("old")
    rename = Path.rename

    def full(path: Path, target: Path) -> Path:
        if path.suffix == ".part":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", full)
    with pytest.raises(Exception, match="the disk is full"), replaced_folder(tmp_path / "views") as folder:
        (folder / "file").write_text("new")
    assert (tmp_path / "views" / "file").read_text() == "old" and leftovers(tmp_path) == []


# --- what people see ----------------------------------------------------------------------------------


def test_a_log_has_a_line_for_each_stage_and_recording(command: Command, small: Path, tmp_path: Path) -> None:
    root = copied(small, tmp_path / "b")
    assert command(root, "build").progress == ()
    assert command(root, "pairs", "--force", "--jobs", "1").progress == (
        "chair: pairs",
        "chair: done, 1 of 2",
        "table: pairs",
        "table: done, 2 of 2",
    )


def test_the_last_line_says_what_failed_and_how_to_go_on(
    command: Command, small: Path, tmp_path: Path
) -> None:
    root = copied(small, tmp_path / "b")
    (root / "recordings" / "chair").rename(root / "recordings" / "elsewhere")
    result = command(root, "build", "--jobs", "1")
    assert result.status == 3
    assert result.progress[-1].startswith("chair: failed, 1 of 2: ")
    last = result.err.splitlines()[-1]
    assert last.startswith("failed: 1 of 2 recordings: chair; the rest is done. ")
