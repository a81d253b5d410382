"""Runs that are killed, interrupted or find the disk full: nothing is lost, and the next run goes on."""

import contextlib
import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from slow import slow
from small_benchmark import Run, copied, finish, hashes, leftovers, start

pytestmark = pytest.mark.xdist_group("resume")

Command = Callable[..., Run]
STOPPED = "error: stopped; run the same command again to go on from here\n"


@pytest.fixture
def fresh(small: Path, tmp_path: Path) -> Path:
    """The small benchmark before anything was built."""
    return copied(small, tmp_path / "b", "benchmark.yaml", "recordings")


def wait_for(condition: Callable[[], bool], process: "subprocess.Popen[str]", timeout_s: float = 60) -> None:
    """Wait until something holds, or the process has ended."""
    end = time.monotonic() + timeout_s
    while not condition() and process.poll() is None:
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.002)


def group(process: "subprocess.Popen[str]") -> list[int]:
    """The living processes of a started command's process group (not its zombies)."""
    members = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[2]) == process.pid and fields[0] != "Z":
            members.append(int(stat.parent.name))
    return members


def wait_until_all_ended(process: "subprocess.Popen[str]") -> None:
    end = time.monotonic() + 20
    while group(process):
        assert time.monotonic() < end, f"still there: {group(process)}"
        time.sleep(0.05)


# --- killed -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kills", [1, slow(5)])
def test_killed_at_random_moments(
    command: Command, small: Path, fresh: Path, tmp_path: Path, kills: int
) -> None:
    """Kills while it works; then one run must publish what an undisturbed one publishes."""
    moments = random.Random(0)
    for _ in range(kills):
        process = start(fresh, "publish", "--jobs", "2")
        wait_for(lambda: bool(list(fresh.glob("build/*/.*.part"))), process)
        time.sleep(moments.uniform(0, 1.5))
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        assert process.returncode == -signal.SIGKILL
    undisturbed = copied(small, tmp_path / "u")
    results = [command(root, "publish", "--jobs", "1", "--json") for root in (fresh, undisturbed)]
    assert [result.status for result in results] == [0, 0], results
    killed_sha256, sha256 = (json.loads(result.out)["benchmark_sha256"] for result in results)
    assert killed_sha256 == sha256
    assert hashes(fresh) == hashes(undisturbed)
    assert leftovers(fresh) == []


@pytest.mark.parametrize("stage", [slow("reconstruction"), "object", slow("pairs")])
def test_killed_while_a_stage_is_written(command: Command, small: Path, tmp_path: Path, stage: str) -> None:
    root = copied(small, tmp_path / "b")
    shutil.rmtree(root / "build" / "table" / stage)
    process = start(root, "build", "table")
    wait_for(lambda: bool(list((root / "build" / "table").glob(f".{stage}.*.part"))), process)
    process.kill()
    process.communicate()
    assert leftovers(root) != [] and not (root / "build" / "table" / stage).exists()
    assert command(root, "build", "--jobs", "1").status == 0
    assert hashes(root / "build") == hashes(small / "build")
    assert leftovers(root) == []


def test_workers_end_when_their_parent_is_killed(fresh: Path) -> None:
    process = start(fresh, "build", "--jobs", "2")
    wait_for(lambda: len(list((fresh / "build").glob("*/.sequence.*.part"))) == 2, process)
    process.kill()
    wait_until_all_ended(process)
    process.communicate()


@pytest.mark.parametrize("published_before", [slow(False), True])
def test_killed_while_publishing(
    command: Command, small: Path, tmp_path: Path, published_before: bool
) -> None:
    root = copied(small, tmp_path / "b")
    undisturbed = copied(small, tmp_path / "u")
    assert command(undisturbed, "publish", "--jobs", "1").status == 0
    if published_before:
        assert command(root, "publish", "--jobs", "1", "--set", "license=CC0-1.0").status == 0
    before = hashes(root / "benchmark") if published_before else {}
    process = start(root, "publish")
    wait_for(lambda: any((part / "pairs").exists() for part in root.glob(".benchmark.*.part")), process)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert (hashes(root / "benchmark") if published_before else {}) == before
    assert command(root, "publish", "--jobs", "1").status == 0
    assert hashes(root / "benchmark") == hashes(undisturbed / "benchmark")
    assert leftovers(root) == []


def test_killed_between_the_two_renames_of_publishing(command: Command, small: Path, tmp_path: Path) -> None:
    root = copied(small, tmp_path / "b")
    assert command(root, "publish").status == 0
    before = hashes(root / "benchmark")
    shutil.copytree(root / "benchmark", root / ".benchmark.abcdefgh.part")
    (root / "benchmark").rename(root / ".benchmark.abcdefgh.old")
    assert command(root, "publish").status == 0
    assert hashes(root / "benchmark") == before
    assert leftovers(root) == []


# --- interrupted --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("jobs", "whom", "number", "status"),
    [
        ("1", "parent", signal.SIGTERM, 143),
        ("2", "all", signal.SIGINT, 130),
        slow("1", "all", signal.SIGINT, 130),
        slow("1", "all", signal.SIGTERM, 143),
        slow("1", "parent", signal.SIGINT, 130),
        slow("2", "all", signal.SIGTERM, 143),
        slow("2", "parent", signal.SIGINT, 130),
        slow("2", "parent", signal.SIGTERM, 143),  # test_stopped_by_timeout sends it to both
    ],
)
def test_interrupted(
    command: Command, small: Path, fresh: Path, jobs: str, whom: str, number: int, status: int
) -> None:
    """Ctrl-C and `timeout` reach every process of the group; `kill` the parent alone."""
    process = start(fresh, "build", "--jobs", jobs)
    wait_for(lambda: bool(list((fresh / "build").glob("*/.*.part"))), process)
    time.sleep(0.3)
    asked = time.monotonic()
    if whom == "all":
        os.killpg(process.pid, number)
    else:
        process.send_signal(number)
    result = finish(process)
    assert time.monotonic() - asked < 15
    assert result.status == status, result
    assert result.err == STOPPED
    assert result.out == ""
    wait_until_all_ended(process)
    assert leftovers(fresh) == []
    if whom == "all":
        assert command(fresh, "build", "chair", "--jobs", "1").status == 0
        assert hashes(fresh / "build" / "chair") == hashes(small / "build" / "chair")


@pytest.mark.parametrize("wait_s", [0.0, slow(0.3), 0.6, slow(0.9)])
def test_interrupted_at_any_moment(fresh: Path, wait_s: float) -> None:
    """Also while libraries are imported, some of which swallow an interrupt."""
    process = start(fresh, "build", "chair")
    wait_for(lambda: bool(list((fresh / "build").glob("*/.*.part"))), process)
    time.sleep(wait_s)
    process.send_signal(signal.SIGINT)
    result = finish(process)
    assert (result.status, result.err) == (130, STOPPED)
    assert leftovers(fresh) == []


@pytest.mark.parametrize("wait_s", [0.0, slow(0.003), slow(0.01), slow(0.1)])
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_interrupted_while_workers_start(fresh: Path, wait_s: float, number: int, status: int) -> None:
    process = start(fresh, "build", "--jobs", "2")
    wait_for(lambda: len(group(process)) >= 3, process)
    time.sleep(wait_s)
    os.killpg(process.pid, number)
    result = finish(process)
    assert result.status == status
    assert result.err == STOPPED
    wait_until_all_ended(process)


def test_stopped_by_timeout(fresh: Path) -> None:
    """It sends SIGTERM to the command, then to its group; batch systems, again until it has ended."""
    process = start(fresh, "build", "--jobs", "2")
    wait_for(lambda: bool(list((fresh / "build").glob("*/.*.part"))), process)
    while process.poll() is None:
        process.send_signal(signal.SIGTERM)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGTERM)
        time.sleep(0.002)
    result = finish(process)
    assert (result.status, result.err) == (143, STOPPED)
    wait_until_all_ended(process)
    assert leftovers(fresh) == []


# --- disks --------------------------------------------------------------------------------------------


@pytest.fixture
def mounted(tmp_path: Path) -> Iterator[Callable[..., Path]]:
    """mounted(options): a small disk of our own, or a skip where that is not permitted."""
    folder = tmp_path / "disk"
    folder.mkdir()
    done = []

    def mount(options: str) -> Path:
        words = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
        if sys.platform != "linux" or os.geteuid() or subprocess.run(words, capture_output=True).returncode:
            pytest.skip("mounting a file system is not permitted here")
        done.append(folder)
        return folder

    yield mount
    for place in done:
        subprocess.run(["umount", "-l", str(place)], check=True)


def test_a_full_disk(command: Command, small: Path, tmp_path: Path, mounted: Callable[..., Path]) -> None:
    disk = mounted("size=3m")
    root = copied(small, disk / "b", "benchmark.yaml", "recordings")
    result = command(root, "build", "--jobs", "1")
    assert result.status == 1
    lines = [line for line in result.err.splitlines() if "error: " in line]
    assert len(lines) == 2 and "Traceback" not in result.err
    assert all("the disk is full: free some space" in line for line in lines), lines
    assert leftovers(root) == []
    subprocess.run(["mount", "-o", "remount,size=40m", str(disk)], check=True)
    assert command(root, "build", "chair", "--jobs", "1").status == 0
    assert hashes(root / "build" / "chair") == hashes(small / "build" / "chair")


def test_a_read_only_disk(command: Command, small: Path, mounted: Callable[..., Path]) -> None:
    disk = mounted("size=60m")
    root = copied(small, disk / "b")
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    for arguments in (["build"], ["report"], ["init", ".", "--force"], ["simulate", "new"]):
        result = command(root, *arguments)
        assert result.status == 1, (arguments, result)
        lines = [line for line in result.err.splitlines() if "error: " in line]
        assert lines and all("the disk is read-only: choose a folder" in line for line in lines), lines
        assert "Traceback" not in result.err and "internal error" not in result.err


WRITES = {
    "ingest": "kinectbench.engine.steps.write_sequence",
    "fuse": "kinectbench.engine.steps.write_reconstruction",
    "segment": "kinectbench.engine.steps.write_object",
    "sample-views": "kinectbench.engine.steps.write_views",
    "pairs": "kinectbench.core.artefacts.views.PairsFile.write",
    "publish": "kinectbench.release.publish.publish.write_small_files",
}


@pytest.mark.parametrize(
    ("name", "number"),
    [(name, errno.ENOSPC) for name in WRITES]
    + [("pairs", n) for n in (errno.EROFS, errno.EACCES, errno.EIO)],
)
def test_no_disk_while_a_stage_is_written(
    command: Command, small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, number: int
) -> None:
    """What was there before is untouched, whatever the operating system says."""
    root = copied(small, tmp_path / "b")
    if name == "publish":
        assert command(root, "publish").status == 0
    before = hashes(root)

    def fail(*_: object, **__: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(WRITES[name], fail)
    result = command(root, name, *([] if name == "publish" else ["chair"]), "--force")
    assert result.status == 1
    lines = [line for line in result.err.splitlines() if "error: " in line]
    assert len(lines) == 1 and "Traceback" not in result.err
    assert "untouched" in lines[0] or number == errno.EIO
    assert hashes(root) == before
    assert leftovers(root) == []
