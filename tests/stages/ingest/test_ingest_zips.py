"""Redwood's scans in their zip archives, written here from the data set's own page; hostile archives."""

import pickle
import tracemalloc
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ingest_writers import CAMERA, color_image, depth_image, every_frame, jpeg, png
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest import recording as recordings
from kinectbench.stages.ingest.images import DamagedImageError
from kinectbench.stages.ingest.readers import format_of, name_suffixes, open_recording
from kinectbench.stages.ingest.recording import RawFrame

SMALL = CameraSettings(**CAMERA)
STEP_US = 33_366


def redwood(
    path: Path, frames: int = 4, *, folder: str = "", without: str = "", packed: int = zipfile.ZIP_DEFLATED
) -> Path:
    with zipfile.ZipFile(path, "w", packed) as archive:
        for i in range(frames):
            # Colour is some ms late.
            members = {
                f"depth/{i + 1:07d}-{i * STEP_US:012d}.png": png(depth_image(i, 1000.0)),
                f"rgb/{i + 1:07d}-{i * STEP_US + 4000:012d}.jpg": jpeg(color_image(i)),
            }
            for name, data in members.items():
                if not (without and name.startswith(without)):
                    archive.writestr(folder + name, data)
    return path


@pytest.mark.parametrize("folder", ["", "00001/"])
@pytest.mark.parametrize("packed", [zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED])
def test_a_scan_in_its_archive(tmp_path: Path, folder: str, packed: int) -> None:
    recording = open_recording(redwood(tmp_path / "r.zip", folder=folder, packed=packed), SMALL)
    assert (recording.format, len(recording), recording.warnings) == ("redwood_zip", 4, ())
    assert (recording.depth_scale, recording.color_registered) == (1000.0, True)
    assert recording.stamps_ns.tolist() == [i * STEP_US * 1000 for i in range(4)]
    assert recording.given_trajectory is None
    # At random, and in another process.
    for one in (recording, pickle.loads(pickle.dumps(recording))):
        for i in (3, 0, 2, 1):
            frame = one.frame(i)
            np.testing.assert_array_equal(frame.depth, depth_image(i, 1000.0))
            assert frame.color == (".jpg", jpeg(color_image(i)))
    assert ".zip" in name_suffixes()


def test_the_size_of_a_primesense_tells_its_intrinsics(tmp_path: Path) -> None:
    depth = np.full((480, 640), 1500, np.uint16)
    with zipfile.ZipFile(tmp_path / "r.zip", "w") as archive:
        archive.writestr("depth/0000001-000000000000.png", cv2.imencode(".png", depth)[1].tobytes())
        archive.writestr("rgb/0000001-000000000000.jpg", jpeg(np.zeros((480, 640, 3), np.uint8)))
    camera = open_recording(tmp_path / "r.zip").camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (525.0, 525.0, 319.5, 239.5)
    with raises(RecordingError, "recording.no-intrinsics"):
        open_recording(redwood(tmp_path / "s.zip"))


def test_of_very_many_damaged_images_the_first_are_tried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recordings, "MOST_TRIED", 3)
    with zipfile.ZipFile(tmp_path / "r.zip", "w") as archive:
        for i in range(5):
            archive.writestr(f"depth/{i + 1:07d}-{i * STEP_US:012d}.png", b"")
    with raises(RecordingError, "recording.no-frame", match="first 3 depth"):
        open_recording(tmp_path / "r.zip", SMALL)


def test_members_that_are_missing_or_wrong(tmp_path: Path) -> None:
    plain = open_recording(redwood(tmp_path / "a.zip", without="rgb/0000002"), SMALL)
    assert (plain.frame(1).color, plain.warnings) == (
        None,
        (f"{tmp_path / 'a.zip'}: 1 of 4 depth frames have no colour frame within 20 ms",),
    )
    with raises(RecordingError, "recording.no-depth"):
        open_recording(redwood(tmp_path / "b.zip", without="depth/"))
    with zipfile.ZipFile(redwood(tmp_path / "c.zip", without="depth/0000001"), "a") as archive:
        archive.writestr("depth/0000001-000000000000.png", b"no image")
        archive.writestr("depth/notes.txt", b"x")
    recording = open_recording(tmp_path / "c.zip", SMALL)
    assert len(recording) == 4
    with raises(DamagedImageError, "recording.damaged-image", match="PNG image"):
        recording.frame(0)
    with zipfile.ZipFile(tmp_path / "d.zip", "w") as archive:
        archive.writestr("readme.txt", b"x")
    assert format_of(tmp_path / "d.zip") is None


@pytest.mark.parametrize("tenth", range(1, 10))
def test_an_archive_cut_off_at_every_tenth_is_refused_in_one_line(tmp_path: Path, tenth: int) -> None:
    path = redwood(tmp_path / "r.zip", 10)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * tenth // 10])
    assert format_of(path) == "redwood_zip"
    with raises(RecordingError, "recording.malformed", match="archive") as error:
        open_recording(path, SMALL)
    assert "\n" not in str(error.value)


def test_a_member_that_says_it_is_huge_is_not_unpacked(tmp_path: Path) -> None:
    path = redwood(tmp_path / "r.zip", without="depth/0000002")
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(f"depth/0000002-{STEP_US:012d}.png", bytes(65 << 20))
    assert path.stat().st_size < 1 << 20
    tracemalloc.start()
    frames = list(every_frame(open_recording(path, SMALL)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert [isinstance(frame, RawFrame) for frame in frames] == [True, False, True, True]
    assert "says that it unpacks to 68157440 bytes" in str(frames[1]) and peak < 8 << 20


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_fuzzed_archives_neither_crash_nor_allocate(tmp_path: Path, data: st.DataObject) -> None:
    content = bytearray(redwood(tmp_path / "whole.zip").read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        # The index is at the end.
        at = data.draw(
            st.one_of(st.integers(4, len(content) - 1), st.integers(len(content) - 700, len(content)))
        )
        patch = data.draw(
            st.one_of(st.binary(min_size=1, max_size=4), st.just(b"\xff" * 4), st.just(bytes(4)))
        )
        content[at : at + len(patch)] = patch
    path = tmp_path / "fuzzed.zip"
    path.write_bytes(content)
    if format_of(path) is None:
        return
    tracemalloc.start()
    try:
        for frame in every_frame(open_recording(path, SMALL)):
            assert isinstance(frame, DamagedImageError) or frame.depth.dtype == np.uint16
    except RecordingError as error:
        assert "\n" not in str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 8 << 20


def test_bytes_lost_before_the_index_are_damage(tmp_path: Path) -> None:
    """Members then begin before the archive does, where nothing can be read."""
    content = redwood(tmp_path / "whole.zip").read_bytes()
    path = tmp_path / "short.zip"
    path.write_bytes(content[:100] + content[104:])
    frames = list(every_frame(open_recording(path, SMALL)))
    assert any(isinstance(frame, DamagedImageError) for frame in frames)
