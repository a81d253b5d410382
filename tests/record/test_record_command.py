"""The command `record`: its options, its lines, its exit statuses, and whatever kills it."""

import json
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from made_once import made_once
from small_benchmark import Run
from written_frames import frame, read, write

from kinectbench.cli.common import Common
from kinectbench.cli.record import _recorded, tell_recorded
from kinectbench.record import devices
from kinectbench.record.devices.replay import Replay
from kinectbench.record.interface import Device, Frame, Setup
from kinectbench.record.recorder import Recorded
from kinectbench.stages.ingest.readers import open_recording

FRAMES = 300
# Ten seconds of so many frames, so that whatever happens comes in the middle.
PACE = ("--speed", "1")
SMALL_DISK = ["unshare", "--map-root-user", "--mount", "bash", "-c"]
COMMAND = [sys.executable, "-m", "kinectbench", "record"]


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    def make(to: Path) -> None:
        write(to / "long", "tum", map(frame, range(FRAMES)))

    return made_once(tmp_path_factory, "replayed", make) / "long"


def started(out: Path, *arguments: str | Path) -> "subprocess.Popen[str]":
    """A recorder that has written its first frame."""
    process = subprocess.Popen(
        [*COMMAND, str(out), *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    end = time.monotonic() + 60
    while not (out / "depth.txt").is_file() and process.poll() is None and time.monotonic() < end:
        time.sleep(0.01)
    return process


def check_prefix(out: Path, source: Path) -> int:
    """All that is listed is equal to what was replayed; the number of frames."""
    stamps_ns, before = open_recording(source).stamps_ns.tolist(), open_recording(source)
    frames = read(open_recording(out))
    for raw in frames:
        assert np.array_equal(raw.depth, before.frame(stamps_ns.index(raw.stamp_ns)).depth)
        assert raw.color is not None
    return len(frames)


def test_a_recording_is_recorded(command: Callable[..., Run], tmp_path: Path, source: Path) -> None:
    run = command(
        tmp_path, "record", "out", "--from", str(source), "--speed", "3", "--seconds", "1", "--json"
    )
    said = json.loads(run.out)
    assert run.status == 0 and said["device"] == "replay" and said["failure"] is None
    assert 60 < said["frames"] == check_prefix(tmp_path / "out", source) < 110
    assert command(tmp_path, "inspect", "out").status == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["Ctrl-C", "SIGTERM"])
def test_a_signal_ends_it_well(tmp_path: Path, source: Path, number: int) -> None:
    process = started(tmp_path / "out", "--from", source, *PACE)
    time.sleep(0.5)
    process.send_signal(number)
    out, err = process.communicate(timeout=30)
    count = check_prefix(tmp_path / "out", source)
    assert process.returncode == 0 and f"wrote {tmp_path / 'out'}: {count} frames in" in out, err
    assert "error" not in err


SLOW_OBSERVER = """
import sys, threading
from pathlib import Path
from kinectbench.engine.interrupts import interrupts_remembered
from kinectbench.record.devices.replay import Replay
from kinectbench.record.recorder import record

class Slow:
    def see(self, number, frame, setup):
        threading.Event().wait()

with interrupts_remembered():
    done = record(Replay(Path(sys.argv[1]), 1.0, None), Path(sys.argv[2]), observers=[Slow()])
    print(done.frames)
"""


def test_a_second_ctrl_c_keeps_the_outcome(tmp_path: Path, source: Path) -> None:
    """It comes while an observer, which may be the guide, is still waited for."""
    out = tmp_path / "out"
    words = [sys.executable, "-c", SLOW_OBSERVER, str(source), str(out)]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 60
    rows = out / "depth.txt"
    while not (rows.is_file() and len(rows.read_text().splitlines()) > 5) and time.monotonic() < end:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    time.sleep(1)
    process.send_signal(signal.SIGINT)
    said, err = process.communicate(timeout=30)
    assert (process.returncode, said) == (0, f"{check_prefix(out, source)}\n"), err


def test_ctrl_c_while_the_guide_closes_keeps_the_line(
    command: Callable[..., Run], tmp_path: Path, source: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def interrupted(*_: object) -> Iterator[None]:
        yield None
        raise KeyboardInterrupt

    monkeypatch.setattr("kinectbench.cli.record._guide", interrupted)
    lost = command(tmp_path, "record", "none", "--from", "chair_01")
    assert lost.status == 1 and "give a recording's path" in lost.err
    run = command(tmp_path, "record", "out", "--from", str(source), "--speed", "100")
    assert run.status == 0 and f"wrote out: {check_prefix(tmp_path / 'out', source)} frames in" in run.out


def test_what_a_build_takes_counts_from_the_last_frame(
    tmp_path: Path, source: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def late(*_: object) -> Iterator[None]:
        yield None
        time.sleep(0.5)

    monkeypatch.setattr("kinectbench.cli.record._guide", late)
    _, last_s = _recorded(Replay(source, 100.0), tmp_path / "out", None, 0, None)
    assert time.monotonic() - last_s >= 0.5


@pytest.mark.parametrize(("speed", "advised"), [("100", True), ("1", False)])
def test_missed_frames_are_told(
    command: Callable[..., Run],
    tmp_path: Path,
    source: Path,
    monkeypatch: pytest.MonkeyPatch,
    speed: str,
    advised: bool,
) -> None:
    done = Recorded(tmp_path / "out", "replay", 9, 1, 0, 0, 1.0)
    monkeypatch.setattr("kinectbench.cli.record._recorded", lambda *_: (done, 0.0))
    run = command(tmp_path, "record", "out", "--from", str(source), "--speed", speed)
    assert "1 frame never arrived" in run.err and ("give a lower --speed" in run.err) == advised


@pytest.mark.parametrize(
    ("speed", "remedies"),
    [
        (None, ("another cable and port, and close other programs", "record to a faster one")),
        (1.0, ("if some are damaged, `kinectbench inspect` names them", "give a lower --speed")),
        (1000.0, ("give a lower --speed", "give a lower --speed")),
    ],
)
def test_lost_frames_are_told_with_their_share_and_the_remedy(
    capsys: pytest.CaptureFixture[str], speed: float | None, remedies: tuple[str, str]
) -> None:
    tell_recorded(Common(), Recorded(Path("out"), "it", 2, 5, 3, 0, 1.0), speed)
    never, dropped = capsys.readouterr().err.replace("\n", " ").split("warning: ")[1:]
    assert "5 frames never arrived (of 10;" in never and remedies[0] in never
    assert "3 frames could not be written (of 10)" in dropped and remedies[1] in dropped


def test_killed_at_random_moments_it_is_readable_to_the_last_second(tmp_path: Path, source: Path) -> None:
    """By SIGKILL; what was taken before the last half second is there."""
    moments_s, lost = random.Random(0), []
    for attempt in range(6):
        out = tmp_path / str(attempt)
        process = started(out, "--from", source, *PACE)
        begun = time.monotonic()
        time.sleep(moments_s.uniform(0.1, 1.5))
        passed_s = time.monotonic() - begun
        process.kill()
        process.communicate()
        lost.append(passed_s * 30 - check_prefix(out, source))
    assert max(lost) < 15, lost


def test_a_second_recorder_and_a_second_run_are_refused(
    command: Callable[..., Run], tmp_path: Path, source: Path
) -> None:
    first = started(tmp_path / "out", "--from", source, *PACE)
    second = command(tmp_path, "record", "out", "--from", str(source))
    first.terminate()
    first.communicate(timeout=30)
    again = command(tmp_path, "record", "out", "--from", str(source))
    line = "error: out: is there already; name a new folder for the recording\n"
    assert (second.status, second.err, again.status, again.err) == (2, line, 2, line)
    assert check_prefix(tmp_path / "out", source)


@pytest.mark.skipif(
    subprocess.run([*SMALL_DISK, "mount -t tmpfs none /mnt"], capture_output=True).returncode != 0,
    reason="this machine does not let a process mount a small disk for itself",
)
def test_a_full_disk_ends_it_in_one_line(tmp_path: Path, source: Path) -> None:
    """The disk is a tmpfs of 400 kB; what is on it is copied while it is there."""
    (tmp_path / "disk").mkdir()
    script = (
        'mount -t tmpfs -o size=400k none "$1" || exit 99\n'
        '"${@:3}" "$1/out"\nstatus=$?\ncp -r "$1/out" "$2"\nexit $status'
    )
    words = ["bash", tmp_path / "disk", tmp_path / "kept", *COMMAND, "--from", source, "--speed", "10"]
    done = subprocess.run([*SMALL_DISK, script, *map(str, words)], capture_output=True, text=True)
    count = check_prefix(tmp_path / "kept", source)
    assert done.returncode == 1 and 5 < count < FRAMES
    errors = [line for line in done.stderr.splitlines() if "error: " in line]
    assert errors[0].endswith(
        f"cannot be written any more (No space left on device); the {count} frames before are whole: "
        f"{tmp_path / 'disk/out'} can be built"
    )
    assert len(errors) == 1


class Pulled(Device):
    """Gives the frames of a recording until its cable is pulled."""

    name, cameras = "pulled", "a camera with a loose cable"
    there: tuple[str, ...] = ("Loose 1",)

    def plugged_in(self) -> tuple[str, ...]:
        return self.there

    def open(self) -> Setup:
        from drawn_camera import DrawnCamera

        return DrawnCamera().open()

    def frames(self) -> Iterator[Frame]:
        from drawn_camera import drawn

        yield from map(drawn, range(3))
        raise OSError("USB: no such device")

    def close(self) -> None:
        raise OSError("is gone")


@pytest.fixture
def pulled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(devices.DEVICES, "pulled", f"{__name__}:Pulled")


def test_a_pulled_cable_is_one_line(command: Callable[..., Run], tmp_path: Path, pulled: None) -> None:
    run = command(tmp_path, "record", "out", "--device", "pulled")
    line = "error: pulled: USB: no such device; the 3 frames before are whole: out can be built\n"
    assert run.status == 1 and run.err == line
    assert len(read(open_recording(tmp_path / "out"))) == 3


def test_devices_are_listed(command: Callable[..., Run], tmp_path: Path, pulled: None) -> None:
    rows = {row["name"]: row for row in json.loads(command(tmp_path, "record", "--list", "--json").out)}
    assert set(rows) == set(devices.DEVICES)
    assert rows["pulled"]["plugged_in"] == ["Loose 1"] and rows["pulled"]["absent"] == ""
    assert "pulled: a camera with a loose cable: Loose 1" in command(tmp_path, "record", "--list").out


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        ((), 2, "name a new folder for the recording, or give --list"),
        (("out",), 1, "no camera is found; `kinectbench record --list` says what each needs"),
        (("out", "--device", "eye"), 2, "--device eye: no such device; there are "),
        (("out", "--device", "eye", "--from", "x"), 2, "give --device or --from, not both"),
        (("out", "--speed", "2"), 2, "--speed and --set are of --from"),
        (("out", "--from", "nowhere"), 1, "nowhere: there is no such file or folder"),
        (("out", "--from", "."), 1, "the folder is empty"),
    ],
)
def test_wrong_usage_is_one_line(
    command: Callable[..., Run],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    status: int,
    words: str,
) -> None:
    monkeypatch.setattr(Pulled, "there", ())
    monkeypatch.setattr(devices, "DEVICES", {"pulled": f"{__name__}:Pulled"})
    run = command(tmp_path, "record", *arguments)
    assert run.status == status and run.err.count("\n") == 1 and words in run.err
    assert not (tmp_path / "out").exists()


def test_ctrl_c_ends_the_recording_and_then_it_is_built(source: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = started(out, "--from", source, "--speed", "1", "--build", "--no-guide")
    time.sleep(1)
    process.send_signal(signal.SIGINT)
    printed, err = process.communicate(timeout=300)
    assert f"wrote {out}:" in printed and "goes on from here" not in err, err
    # What is to fill in is said after the build, with the command for this folder.
    assert (
        f"run `kinectbench build --config {out}/benchmark.yaml`" in err
        and "`kinectbench build`" not in printed
    )
    # Whether these frames make an object matters to the last stages alone.
    assert process.returncode != 130 and (out / "build" / "out" / "sequence").is_dir(), err


def test_a_build_that_is_stopped_says_how_to_go_on(source: Path, tmp_path: Path) -> None:
    """The recording is whole then: `record` would ask for another folder."""
    out = tmp_path / "out"
    process = started(out, "--from", source, "--speed", "50", "--build")
    end = time.monotonic() + 120
    while not (out / "benchmark.yaml").is_file() and process.poll() is None and time.monotonic() < end:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    err = process.communicate(timeout=60)[1]
    assert process.returncode == 130
    assert f"`kinectbench build --config {out}/benchmark.yaml` goes on from here" in err
