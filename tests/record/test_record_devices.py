"""The files of the devices, each with a stand-in for its library; RealSense with librealsense itself."""

import importlib.util
import json
import os
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import camera_libraries
import numpy as np
import pytest
from camera_libraries import COUNT, depth_image, jpeg, rgb_image, write_by_librealsense
from small_benchmark import Run
from written_frames import color_rgb, read

from kinectbench.core.errors import CaptureError
from kinectbench.core.extras import EXTRA_OF
from kinectbench.record import interface
from kinectbench.record.devices import DEVICES, device_of
from kinectbench.record.recorder import Recorded, record
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import Recording

STAND_INS = {
    "kinect": camera_libraries.freenect,
    "openni": camera_libraries.openni,
    "azure": camera_libraries.pyk4a,
    "orbbec": camera_libraries.pyorbbecsdk,
    "iphone": camera_libraries.record3d,
}
MISSED = {"openni": 1, "orbbec": 1}


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A device that gives nothing is gone after a second; a busy machine may keep it waiting."""
    monkeypatch.setattr(interface, "SILENT_S", 1.0)


def recorded(monkeypatch: pytest.MonkeyPatch, name: str, out: Path) -> tuple[Recorded, Recording]:
    STAND_INS[name](monkeypatch)
    device = device_of(name)
    assert len(device.plugged_in()) == 1
    return record(device, out), open_recording(out)


@pytest.mark.parametrize("name", STAND_INS)
def test_a_device_is_recorded_until_it_gives_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str
) -> None:
    done, recording = recorded(monkeypatch, name, tmp_path / "out")
    assert (done.frames, done.missed, done.set_back) == (COUNT, MISSED.get(name, 0), 0)
    assert done.failure.startswith(f"{name}: ") and "frames before are whole" in done.failure
    assert len(read(recording)) == COUNT and not recording.warnings
    steps_ns = np.diff(recording.stamps_ns)
    # An iPhone's stamps are those of the machine, which may be busy.
    assert (steps_ns > 20e6).all() and (steps_ns < (5e9 if name == "iphone" else 200e6)).all()
    assert all(raw.color is not None for raw in read(recording))


def test_a_kinect_counts_on_where_its_clock_begins_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    _, recording = recorded(monkeypatch, "kinect", tmp_path / "out")
    assert recording.stamps_ns.tolist() == [k * 10**9 // 30 for k in range(COUNT)]
    assert recording.recorded_stamps_ns[1].tolist() == [k * 10**9 // 30 + 10**7 for k in range(COUNT)]
    check_pixels(recording, 480, 640)


@pytest.mark.parametrize("name", ["azure", "realsense"])
def test_a_device_whose_depth_stops_is_gone_while_its_colour_goes_on(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """As at a dip of USB's power; else it would wait for ever, and keep every image."""
    monkeypatch.setattr(interface, "SILENT_S", 0.2)
    stream = SimpleNamespace(depth=1, color=2, accel=3)
    camera_libraries.install(monkeypatch, "pyrealsense2", stream=stream)
    profile = SimpleNamespace(stream_type=lambda: stream.color)
    device, asked = device_of(name), iter(range(400))

    def color_alone() -> SimpleNamespace:
        assert next(asked, None) is not None, "waits for ever"
        time.sleep(0.002)
        return SimpleNamespace(depth=None, color=b"", get_profile=lambda: profile)

    monkeypatch.setattr(device, "_next", color_alone)
    with pytest.raises(CaptureError, match=rf"^{name}: no depth came for 0\.2 s"):
        next(device.frames())


@pytest.mark.parametrize(("registers", "focal_px"), [(True, 525), (False, 575)])
def test_openni_gives_the_focal_length_of_the_camera_on_whose_pixels_depth_lies(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, registers: bool, focal_px: float
) -> None:
    """The stand-in gives 525 px for colour and 575 px for depth."""
    camera_libraries.openni(monkeypatch, registers=registers)
    record(device_of("openni"), tmp_path / "out")
    recording = open_recording(tmp_path / "out")
    assert (recording.camera.fx, recording.camera.fy) == pytest.approx((focal_px, focal_px))
    assert recording.color_registered == registers and recording.depth_scale == 1000
    check_pixels(recording, 480, 640)


def check_pixels(recording: Recording, height: int, width: int) -> None:
    for index, raw in enumerate(read(recording)):
        assert np.array_equal(raw.depth, depth_image(index, height, width))
        assert np.array_equal(color_rgb(raw), rgb_image(index, height, width))


def test_azure_and_orbbec_keep_the_cameras_own_jpeg(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name, scale in (("azure", 1000), ("orbbec", 2000)):
        _, recording = recorded(monkeypatch, name, tmp_path / name)
        calibration = recording.color_calibration
        assert recording.depth_scale == scale and calibration is not None
        assert calibration.T_color_depth[:3, 3] == pytest.approx([-0.032, 0.002, 0.004])
        assert [raw.color for raw in read(recording)] == [(".jpg", jpeg(k, 720, 1280)) for k in range(COUNT)]
    assert np.array_equal(read(recording)[1].depth, depth_image(1, 576, 640))
    bent = read(open_recording(tmp_path / "azure"))[1].depth
    assert bent[330, 320] == depth_image(1, 576, 640)[330, 320]  # in the middle the lens bends nothing
    assert not np.array_equal(bent, depth_image(1, 576, 640))


def test_orbbecs_library_writes_no_log_where_one_works(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    recorded(monkeypatch, "orbbec", tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_an_iphone_gives_metres_and_leaves_out_what_is_not_sure(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    _, recording = recorded(monkeypatch, "iphone", tmp_path / "out")
    depth = read(recording)[0].depth
    assert depth.shape == (256, 192) and not depth[5].any() and not depth[0, :2].any()
    assert depth[100, 100] == 5 * depth_image(0, 256, 192)[100, 100]
    assert (recording.camera.fx, recording.camera.cx) == (200, 95.5)
    assert recording.color_calibration is not None
    assert np.array_equal(recording.color_calibration.T_color_depth, np.eye(4))


def test_every_device_has_an_extra_and_a_row_in_the_documentation() -> None:
    root = Path(__file__).parents[2]
    extras = tomllib.loads((root / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    page = (root / "docs/capture.md").read_text(encoding="utf-8")
    for name in DEVICES:
        extra = device_of(name).extra
        assert len(extras[extra]) == 1 and extra in EXTRA_OF.values()
        assert f"| `{name}` |" in page


@pytest.mark.parametrize("name", STAND_INS)
def test_nothing_plugged_in_is_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str) -> None:
    STAND_INS[name](monkeypatch, plugged=0)
    with pytest.raises(CaptureError, match=f"^{name}: no (camera|phone) is plugged in"):
        record(device_of(name), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_what_is_not_installed_is_listed_with_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch, command: Callable[..., Run], tmp_path: Path
) -> None:
    plain = importlib.util.find_spec
    absent = {module for module, extra in EXTRA_OF.items() if extra.startswith("record-")}
    monkeypatch.setattr(
        "kinectbench.core.extras.find_spec", lambda name: None if name in absent else plain(name)
    )
    rows = json.loads(command(tmp_path, "record", "--list", "--json").out)
    assert [row["name"] for row in rows] == list(DEVICES)
    for row in rows:
        advice = f"not installed; run `pip install 'kinectbench[record-{row['name']}]'`"
        assert advice in row["absent"] and row["plugged_in"] == []
        run = command(tmp_path, "record", "out", "--device", row["name"])
        assert run.status == 2 and run.err.count("\n") == 1 and advice in run.err


def test_a_library_that_lacks_its_own_or_prints_is_one_line(
    monkeypatch: pytest.MonkeyPatch, command: Callable[..., Run], tmp_path: Path
) -> None:
    """As pyk4a does where it was compiled for another NumPy."""
    (tmp_path / "pyk4a.py").write_text(
        "import os, sys\nos.write(1, b'noise')\nprint('noise', file=sys.stderr)\n"
        "raise ImportError('Cannot import k4a_module. Make sure that\\nit is there.')\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "pyk4a", raising=False)
    run = command(tmp_path, "record", "--list", "--json")
    rows = {row["name"]: row for row in json.loads(run.out)}
    assert rows["azure"]["absent"].startswith("Cannot import k4a_module; it needs ") and not run.err


def test_librealsense_itself_is_recorded_with_equal_depth(tmp_path: Path) -> None:
    """Its software device, its recorder and its playback; since 2.58 that writes .db3."""
    pytest.importorskip("pyrealsense2")
    from kinectbench.record.devices.realsense import RealSense

    write_by_librealsense(tmp_path / "made.db3", 12)
    done = record(RealSense(tmp_path / "made.db3"), tmp_path / "out")
    recording = open_recording(tmp_path / "out")
    frames, made = read(recording), open_recording(tmp_path / "made.db3")
    assert (made.format, made.depth_scale, made.camera) == ("rosbag2", 10_000, recording.camera)
    assert all(np.array_equal(one.depth, raw.depth) for one, raw in zip(read(made), frames, strict=True))
    assert (done.frames, done.missed, done.failure) == (12, 0, "")
    assert recording.depth_scale == 10_000 and recording.camera.fy == 61
    assert recording.stamps_ns.tolist() == [10**9 + k * 33_250_000 for k in range(12)]
    assert all(np.array_equal(raw.depth, depth_image(k, 48, 64)) for k, raw in enumerate(frames))
    colored = [k for k, raw in enumerate(frames) if raw.color is not None]
    assert len(colored) >= 10  # its colour may begin a frame later
    assert all(np.array_equal(color_rgb(frames[k]), rgb_image(k, 48, 64)) for k in colored)
    assert recording.color_calibration is not None
    assert recording.color_calibration.T_color_depth[0, 3] == pytest.approx(-0.015)


PRINTS = """
import ctypes, sys
from kinectbench.record.interface import quiet
libc = ctypes.CDLL(None)
libc.printf(b"before\\n")
with quiet():
    libc.printf(b"a line of a camera's library\\n")
sys.stdout.write("{}\\n")
"""


def test_what_a_library_of_c_prints_is_silenced() -> None:
    """Its buffer is written when it is full, or at the end of the process."""
    command = [sys.executable, "-c", PRINTS]
    buffered = os.environ | {"PYTHONUNBUFFERED": ""}
    done = subprocess.run(command, env=buffered, check=True, capture_output=True, text=True)
    assert done.stdout == "before\n{}\n"
