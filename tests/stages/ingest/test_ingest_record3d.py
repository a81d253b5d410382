"""Record3D's .r3d files, written here as the app's author describes them; hostile ones."""

import builtins
import json
import pickle
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ingest_writers import CAMERA, depth_image, every_frame, jpeg
from raising import raises
from read_pictures import decoded_picture
from test_ingest_phones_bop import BIG, K_BIG, QUATERNION_XYZW, SMALL, big_color, confidence

from kinectbench.core.errors import RecordingError
from kinectbench.core.geometry import rotation_from_quaternion_xyzw
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import DamagedImageError
from kinectbench.stages.ingest.readers import format_of, open_recording

OPENGL = np.diag([1.0, -1.0, -1.0])
METADATA: dict[str, Any] = {
    "w": BIG[0],
    "h": BIG[1],
    "dw": 64,
    "dh": 48,
    # Column by column.
    "K": K_BIG.T.ravel().tolist(),
    "fps": 60,
    "poses": [[*QUATERNION_XYZW, 0.5 * i, 0.0, 0.0] for i in range(4)],
    "frameTimestamps": [100.25 + 0.5 * i for i in range(4)],
    "initPose": [0, 0, 0, 1, 0, 0, 0],
}


def lzfse(pixels: np.ndarray) -> bytes:
    return bytes(imagecodecs.lzfse_encode(pixels.tobytes()))


def metres(index: int) -> np.ndarray:
    """What `depth_image` is in 0.2 mm, with pixels that are no depth."""
    depth = (depth_image(index, 5000.0) / 5000).astype("<f4")
    depth[-1, :5] = [np.nan, np.inf, -np.inf, -1.0, 1e30]
    return depth


def r3d(
    path: Path, change: dict[str, Any] | None = None, members: dict[str, bytes | None] | None = None
) -> Path:
    """Four frames; `change` is of the metadata (None takes away), `members` of the archive."""
    said = {key: value for key, value in (METADATA | (change or {})).items() if value is not None}
    held: dict[str, bytes | None] = {"metadata": json.dumps(said).encode()}
    for i in range(4):
        held[f"rgbd/{i}.depth"] = lzfse(metres(i))
        held[f"rgbd/{i}.conf"] = lzfse(confidence())
        held[f"rgbd/{i}.jpg"] = jpeg(big_color(i))
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in (held | (members or {})).items():
            if data is not None:
                archive.writestr(name, data)
    return path


def expected(index: int, least: int = 2) -> np.ndarray:
    depth = depth_image(index, 5000.0)
    depth[-1, :5] = 0
    return np.where(confidence() >= least, depth, 0)


@pytest.mark.parametrize("least", [0, 1, 2])
def test_a_recording_of_record3d(tmp_path: Path, least: int) -> None:
    recording = open_recording(r3d(tmp_path / "r.r3d"), CameraSettings(min_confidence=least))
    camera = recording.camera
    assert (recording.format, len(recording), recording.warnings) == ("record3d", 4, ())
    assert recording.up_world == (0, 1, 0)
    assert (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy) == (64, 48, *SMALL)
    assert (recording.depth_scale, recording.color_registered) == (5000.0, True)
    assert recording.stamps_ns.tolist() == [100_250_000_000 + i * 500_000_000 for i in range(4)]
    for one in (recording, pickle.loads(pickle.dumps(recording))):
        for i in (3, 0, 2):
            frame = one.frame(i)
            np.testing.assert_array_equal(frame.depth, expected(i, least))
            assert frame.color is not None
            bgr = decoded_picture(frame.color[1], 1).astype(int)
            assert np.abs(bgr - big_color(i)[::4, ::4]).max() < 12
    trajectory = recording.given_trajectory
    assert trajectory is not None
    rotation = rotation_from_quaternion_xyzw(QUATERNION_XYZW) @ OPENGL
    np.testing.assert_allclose(trajectory.T_world_camera[3][:3, :3], rotation, atol=1e-12)
    np.testing.assert_allclose(trajectory.T_world_camera[3][:3, 3], [1.5, 0, 0], atol=1e-12)


def test_it_is_told_by_what_it_holds_too(tmp_path: Path) -> None:
    assert format_of(r3d(tmp_path / "renamed.zip")) == "record3d"


def test_intrinsics_of_every_frame(tmp_path: Path) -> None:
    rows = [[240.0 + i, 244.0, 127.5, 95.5] for i in range(4)]
    assert open_recording(r3d(tmp_path / "a.r3d", {"perFrameIntrinsicCoeffs": rows})).camera.fx == 241.5 / 4
    rows[0][0] = 400.0
    with raises(RecordingError, "recording.two-cameras"):
        open_recording(r3d(tmp_path / "b.r3d", {"perFrameIntrinsicCoeffs": rows}))


@pytest.mark.parametrize("portrait", [True, False])
def test_an_older_file_that_does_not_say_the_size_of_depth(tmp_path: Path, portrait: bool) -> None:
    shape, size = ((256, 192), {"w": 720, "h": 960}) if portrait else ((192, 256), {"w": 960, "h": 720})
    members: dict[str, bytes | None] = {
        f"rgbd/{i}.depth": lzfse(np.full(shape, 1.5, "<f4")) for i in range(4)
    }
    members |= {f"rgbd/{i}.conf": None for i in range(4)}
    color = jpeg(np.zeros((size["h"], size["w"], 3), np.uint8))
    members |= {f"rgbd/{i}.jpg": color for i in range(4)}
    K = [700.0, 0, 0, 0, 700, 0, size["w"] / 2, size["h"] / 2, 1]
    path = r3d(tmp_path / "r.r3d", {"dw": None, "dh": None, "K": K} | size, members)
    recording = open_recording(path)
    assert (recording.camera.height, recording.camera.width) == shape
    assert (recording.frame(0).depth == 7500).all()
    with raises(RecordingError, "recording.malformed", match="does not"):
        open_recording(r3d(tmp_path / "s.r3d", {"dw": None}))


def test_members_that_are_missing(tmp_path: Path) -> None:
    path = r3d(tmp_path / "a.r3d", members={"rgbd/1.jpg": None, "rgbd/2.conf": None, "rgbd/0.depth": None})
    recording = open_recording(path)
    # Poses and times are by the frame's number, not by its place.
    assert recording.stamps_ns.tolist()[0] == 100_750_000_000
    assert recording.given_trajectory is not None
    assert recording.given_trajectory.T_world_camera[0][0, 3] == 0.5
    assert recording.frame(0).color is None
    np.testing.assert_array_equal(recording.frame(1).depth, expected(2, 0))
    without: dict[str, bytes | None] = {f"rgbd/{i}.depth": None for i in range(4)}
    with raises(RecordingError, "recording.no-depth"):
        open_recording(r3d(tmp_path / "b.r3d", members=without))
    with raises(RecordingError, "recording.malformed", match="no metadata"):
        open_recording(r3d(tmp_path / "c.r3d", members={"metadata": None}))


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "cannot be unpacked"),
        (b"no LZFSE at all", "cannot be unpacked"),
        (lzfse(metres(0))[:200], r"cannot be unpacked|unpacks to"),
        (np.zeros((48, 63), "<f4"), "unpacks to 12096 bytes, not the 12288 bytes"),
        # Twice as much as may be taken. It is packed by the test alone, as that takes a second.
        (np.zeros((2048, 2048), "<f4"), "unpacks to more than the 12288 bytes"),
    ],
)
@pytest.mark.parametrize("kind", ["depth", "conf"])
def test_damaged_members_damage_their_frame_only(
    tmp_path: Path, kind: str, data: bytes | np.ndarray, why: str
) -> None:
    member = data if isinstance(data, bytes) else lzfse(data)
    recording = open_recording(r3d(tmp_path / "r.r3d", members={f"rgbd/1.{kind}": member}))
    tracemalloc.start()
    frames = list(every_frame(recording))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    damaged = [isinstance(frame, DamagedImageError) for frame in frames]
    assert damaged == [False, True, False, False] and peak < 8 << 20
    assert f"rgbd/1.{kind}" in str(frames[1])
    if kind == "depth":
        with raises(DamagedImageError, "recording.damaged-image", match=why):
            recording.frame(1)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"w": "wide"}, "'w' of its metadata must be a number"),
        ({"h": None}, "'h' of its metadata must be a number"),
        ({"K": [1, 2]}, "'K' of its metadata must hold nine numbers"),
        ({"K": None}, "'K' of its metadata must hold nine numbers"),
        ({"K": [float("nan")] * 9}, "'K' of its metadata must hold nine numbers"),
        ({"K": [0.0] * 9}, "a focal length is not positive"),
        ({"dw": 48, "dh": 64}, "which is another shape"),
        ({"dw": 0}, "is no size of depth images"),
        ({"dw": 10**9}, "is no size of depth images"),
        ({"dw": "wide"}, "'dw' must be a number"),
    ],
)
def test_a_wrong_metadata(tmp_path: Path, change: dict[str, Any], why: str) -> None:
    with pytest.raises(RecordingError, match=why) as error:
        open_recording(r3d(tmp_path / "r.r3d", change))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("data", [b"{", b"[1]", b"\xff\xfe", b"[" * 100_000])
def test_metadata_that_is_none(tmp_path: Path, data: bytes) -> None:
    with raises(RecordingError, "recording.malformed", match="valid JSON|must"):
        open_recording(r3d(tmp_path / "r.r3d", members={"metadata": data}))


@pytest.mark.parametrize(
    ("poses", "why"),
    [
        (METADATA["poses"][:3], "has 3 poses for 4 frames"),
        ({}, "has 0 poses for 4 frames"),
        ([[1, 2]] * 4, "must hold seven numbers"),
        ([["x"] * 7] * 4, "must hold seven numbers"),
        ([[float("nan")] * 7, *METADATA["poses"][1:]], "1 of 4 frames have no pose"),
        ([[0.0] * 7, *METADATA["poses"][1:]], "1 of 4 frames have no pose"),
        ([[0, 0, 0, 1, 0, 0, 0]] * 4, "its poses are all the same, as those of the face camera"),
    ],
)
def test_poses_that_are_none(tmp_path: Path, poses: Any, why: str) -> None:
    recording = open_recording(r3d(tmp_path / "r.r3d", {"poses": poses}))
    # Frames can be used without poses.
    assert len(recording) == 4
    assert why in (recording.trajectory_error or " ".join(recording.warnings))


@pytest.mark.parametrize(
    "times",
    [
        None,
        [1.0, 2.0],
        [1.0, 1.0, 2.0, 3.0],
        [3.0, 2.0, 1.0, 0.0],
        ["x"] * 4,
        [1e300] * 4,
        [float("nan")] * 4,
    ],
)
def test_times_that_are_none_are_counted(tmp_path: Path, times: Any) -> None:
    recording = open_recording(r3d(tmp_path / "r.r3d", {"frameTimestamps": times}))
    assert recording.stamps_ns.tolist() == [0, 16_666_667, 33_333_334, 50_000_001]
    assert "frames are counted instead" in recording.warnings[0]


@pytest.mark.parametrize("tenth", range(10))
def test_a_file_cut_off_at_every_tenth_is_refused_in_one_line(tmp_path: Path, tenth: int) -> None:
    path = r3d(tmp_path / "r.r3d")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * tenth // 10])
    with raises(RecordingError, "recording.malformed", match="archive") as error:
        open_recording(path)
    assert "\n" not in str(error.value)


def test_without_the_library_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording, usual = open_recording(r3d(tmp_path / "r.r3d")), builtins.__import__

    def without(name: str, *rest: Any, **more: Any) -> Any:
        if name == "imagecodecs":
            raise ImportError(name)
        return usual(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with raises(RecordingError, "recording.no-package", match=r"'kinectbench\[record3d\]'"):
        recording.frame(0)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_fuzzed_files_neither_crash_nor_allocate(tmp_path: Path, data: st.DataObject) -> None:
    member = data.draw(st.sampled_from(["metadata", "rgbd/1.depth", "rgbd/1.conf", "rgbd/1.jpg"]))
    path = tmp_path / "fuzzed.r3d"
    with zipfile.ZipFile(r3d(path)) as archive:
        content = bytearray(archive.read(member))
    words = (b"-inf", b"nan", b"1e999", b"9" * 40, b"null", b"[" * 50, b"{}", b",", b'"', b"-1", b"\xff" * 4)
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(content)))
        patch = data.draw(st.one_of(st.sampled_from(words), st.binary(min_size=1, max_size=4)))
        content[at : at + len(patch) * data.draw(st.integers(0, 1))] = patch
    r3d(path, members={member: bytes(content)})
    tracemalloc.start()
    try:
        for frame in every_frame(open_recording(path, CameraSettings(**CAMERA))):
            assert isinstance(frame, DamagedImageError) or frame.depth.dtype == np.uint16
    except RecordingError as error:
        assert "\n" not in str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 16 << 20
