"""ElasticFusion logs and ScanNet files, written here from their layouts; cut at every tenth, and fuzzed."""

import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ingest_writers import (
    CAMERA,
    CX,
    CY,
    FX,
    FY,
    HEIGHT,
    WIDTH,
    color_image,
    depth_image,
    every_frame,
    jpeg,
    png,
)
from raising import raises
from read_pictures import decoded_picture

from kinectbench.core.errors import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import RawFrame

SETTINGS = CameraSettings(**CAMERA)
START_US = 1_305_031_107_000_000
T_DEPTH_COLOR = np.eye(4, dtype=np.float32)
T_DEPTH_COLOR[0, 3] = 0.025


def depth(index: int) -> np.ndarray:
    return depth_image(index, 1000.0)


def klg(frames: int = 10, declared: int | None = None, *, raw: bool = False, color: bool = True) -> bytes:
    found = [struct.pack("<i", frames if declared is None else declared)]
    for i in range(frames):
        pixels = depth(i).astype("<u2").tobytes()
        packed = pixels if raw else zlib.compress(pixels)
        picture = (color_image(i)[..., ::-1].tobytes() if raw else jpeg(color_image(i))) if color else b""
        found.append(struct.pack("<qii", START_US + 33_333 * i, len(packed), len(picture)) + packed + picture)
    return b"".join(found)


def sens(frames: int = 10, *, color: int = 2, packed: int = 1, lost: tuple[int, ...] = ()) -> bytes:
    K = np.eye(4, dtype=np.float32)
    K[0, 0], K[1, 1], K[0, 2], K[1, 2] = FX, FY, CX, CY
    found = [struct.pack("<IQ", 4, 14) + b"StructureSenso"]
    found += [m.tobytes() for m in (K, T_DEPTH_COLOR, K, np.eye(4, dtype=np.float32))]
    found.append(struct.pack("<iiIIIIfQ", color, packed, WIDTH, HEIGHT, WIDTH, HEIGHT, 1000.0, frames))
    for i in range(frames):
        T = np.full((4, 4), -np.inf, np.float32) if i in lost else np.eye(4, dtype=np.float32)
        if i not in lost:
            T[0, 3] = i
        pixels = depth(i).astype("<u2").tobytes()
        image = {0: color_image(i)[..., ::-1].tobytes(), 1: png(color_image(i)), 2: jpeg(color_image(i))}[
            color
        ]
        data = zlib.compress(pixels) if packed else pixels
        stamps = (START_US + 33_333 * i + 5, START_US + 33_333 * i)
        found.append(T.tobytes() + struct.pack("<4Q", *stamps, len(image), len(data)) + image + data)
    return b"".join(found)


def bgr(frame: RawFrame) -> np.ndarray:
    assert frame.color is not None
    return decoded_picture(frame.color[1])


@pytest.mark.parametrize("raw", [True, False])
@pytest.mark.parametrize("declared", [10, 0])
def test_klg(tmp_path: Path, raw: bool, declared: int) -> None:
    (tmp_path / "r.klg").write_bytes(klg(declared=declared, raw=raw))
    recording = open_recording(tmp_path / "r.klg", SETTINGS)
    assert (recording.format, len(recording), recording.warnings) == ("klg", 10, ())
    assert (recording.depth_scale, recording.color_registered) == (1000.0, True)
    for i in (9, 0, 4):
        frame = recording.frame(i)
        np.testing.assert_array_equal(frame.depth, depth(i))
        assert frame.stamp_ns == (START_US + 33_333 * i) * 1000
        if raw:
            np.testing.assert_array_equal(bgr(frame), color_image(i))
        else:
            assert frame.color == (".jpg", jpeg(color_image(i)))


def test_klg_without_colour_and_with_red_and_blue_exchanged(tmp_path: Path) -> None:
    (tmp_path / "n.klg").write_bytes(klg(color=False))
    assert open_recording(tmp_path / "n.klg", SETTINGS).frame(0).color is None
    (tmp_path / "r.klg").write_bytes(klg(raw=True))
    swapped = open_recording(tmp_path / "r.klg", CameraSettings(**CAMERA, swap_red_blue=True))
    np.testing.assert_array_equal(bgr(swapped.frame(1)), color_image(1)[..., ::-1])
    (tmp_path / "j.klg").write_bytes(klg())
    swapped = open_recording(tmp_path / "j.klg", CameraSettings(**CAMERA, swap_red_blue=True))
    plain = decoded_picture(jpeg(color_image(1)))
    np.testing.assert_array_equal(bgr(swapped.frame(1)), plain[..., ::-1])


def test_klg_of_another_size_is_refused(tmp_path: Path) -> None:
    (tmp_path / "r.klg").write_bytes(klg())
    with raises(RecordingError, "recording.malformed", match=r"640x480; .*`camera: \{width"):
        open_recording(tmp_path / "r.klg")
    (tmp_path / "raw.klg").write_bytes(klg(raw=True))
    with raises(RecordingError, "recording.malformed", match="640x480"):
        open_recording(tmp_path / "raw.klg")


@pytest.mark.parametrize("packed", [0, 1])
@pytest.mark.parametrize("color", [0, 1, 2])
def test_sens(tmp_path: Path, color: int, packed: int) -> None:
    (tmp_path / "r.sens").write_bytes(sens(color=color, packed=packed, lost=(3,)))
    recording = open_recording(tmp_path / "r.sens")
    assert (recording.format, len(recording), recording.depth_scale) == ("sens", 10, 1000.0)
    assert (recording.camera.fx, recording.camera.cy) == (FX, CY)
    assert "1 of 10 frames have no pose" in recording.warnings[0]
    assert recording.given_trajectory is not None
    assert recording.given_trajectory.T_world_camera[:, 0, 3].tolist() == [0, 1, 2, 4, 5, 6, 7, 8, 9]
    assert recording.color_calibration is not None
    np.testing.assert_allclose(recording.color_calibration.T_color_depth[:3, 3], [-0.025, 0, 0], atol=1e-8)
    frame = recording.frame(7)
    np.testing.assert_array_equal(frame.depth, depth(7))
    assert frame.stamp_ns == (START_US + 33_333 * 7) * 1000
    expected = decoded_picture(jpeg(color_image(7)), 1) if color == 2 else color_image(7)
    np.testing.assert_array_equal(bgr(frame), expected)


@pytest.mark.parametrize("make", [klg, sens])
@pytest.mark.parametrize("tenth", range(10))
def test_cut_off_at_every_tenth(tmp_path: Path, make: Callable[[], bytes], tenth: int) -> None:
    data = make()
    path = tmp_path / f"r.{make.__name__}"
    path.write_bytes(data[: len(data) * tenth // 10])
    try:
        recording = open_recording(path, SETTINGS)
    except RecordingError as error:
        assert tenth < 2
        assert "\n" not in str(error)
        return
    # Frames are about as long as each other.
    assert len(recording) in (tenth - 1, tenth)
    assert f"is cut off: {len(recording)} of 10 frames are whole" in recording.warnings[0]
    for i in range(len(recording)):
        np.testing.assert_array_equal(recording.frame(i).depth, depth(i))


@pytest.mark.parametrize("make", [klg, sens])
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_fuzzed_headers_neither_crash_nor_allocate(
    tmp_path: Path, make: Callable[..., bytes], data: st.DataObject
) -> None:
    content = bytearray(make(3))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, 420 if make is sens else 40))
        patch = data.draw(st.binary(min_size=1, max_size=8))
        content[at : at + len(patch)] = patch
    path = tmp_path / f"r.{make.__name__}"
    path.write_bytes(content)
    tracemalloc.start()
    try:
        list(every_frame(open_recording(path, SETTINGS)))
    except RecordingError as error:
        assert "\n" not in str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    # The file is 15 KB or so, and Python's own modules may be loaded.
    assert peak < 8 << 20
