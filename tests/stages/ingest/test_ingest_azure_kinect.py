"""Matroska files of Azure Kinect, written here by PyAV as the sensor's SDK lays them out."""

import copy
import io
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from ingest_writers import every_frame, jpeg
from kinectbench_plugins.formats.matroska import _calibration as simulated_calibration
from raising import raises
from read_pictures import decoded_picture
from typed import noted, present

from kinectbench.core.errors import RecordingError
from kinectbench.core.geometry import Camera
from kinectbench.core.storage import pretty_json
from kinectbench.lab.simulate.writers.frame import Rig
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest import sources
from kinectbench.stages.ingest.images import DamagedImageError
from kinectbench.stages.ingest.readers import azure_kinect, open_recording
from kinectbench.stages.ingest.readers.azure_calibration import DEPTH_MODES, AzureCalibration
from kinectbench.stages.ingest.readers.azure_kinect import AzureKinectRecording
from kinectbench.stages.ingest.recording import Recording

av = pytest.importorskip("av", reason="needs kinectbench[azure]")

MODEL = "CALIBRATION_LensDistortionModelBrownConrady"
# One real sensor: shares of its 1024x1024 and 4:3 sensors, and what the SDK makes of them in pixels.
REAL_DEPTH = [0.5122697949409485, 0.49451231956481934, 0.4921168386936188, 0.4921667277812958]
REAL_DISTORTION = [3.1305770874, 2.324939012527, 0.130416, 3.458651542664, 3.350114583969, 0.6629416]
REAL_DEPTH_PX = (503.927643, 503.978729, 332.064270, 325.880615)
REAL_COLOR = [0.4967627227306366, 0.5108628273010254, 0.470907062292099, 0.6274453997612]
REAL_COLOR_PX = (904.141541, 903.521362, 953.284424, 555.142456)


def camera(location: str, shares: list[float], sensor: tuple[int, int], **change: Any) -> dict[str, Any]:
    parameters = [*shares, *REAL_DISTORTION, 0, 0, 1e-4, -5e-5]
    return {
        "Location": f"CALIBRATION_CameraLocation{location}",
        "SensorWidth": sensor[0],
        "SensorHeight": sensor[1],
        "MetricRadius": 1.74,
        "Intrinsics": {"ModelType": MODEL, "ModelParameterCount": 14, "ModelParameters": parameters},
        "Rt": {"Rotation": np.eye(3).ravel().tolist(), "Translation": [0, 0, 0]},
    } | change


def calibration(**of_color: Any) -> dict[str, Any]:
    place = {"Rotation": np.eye(3).ravel().tolist(), "Translation": [-0.032, -0.002, 0.004]}
    color = camera("PV0", REAL_COLOR, (4096, 3072), Rt=place) | of_color
    return {"CalibrationInformation": {"Cameras": [camera("D0", REAL_DEPTH, (1024, 1024)), color]}}


def write(
    path: Path,
    said: dict[str, Any] | bytes | None,
    depth_px: tuple[int, int] = (320, 288),
    mode: str = "MJPG",
    frames: int = 4,
    tracks: tuple[str, str] = ("DEPTH", "COLOR"),
    color_px: tuple[int, int] = (64, 48),
    step_ms: int = 33,
) -> Path:
    with av.open(str(path), "w", format="matroska", options={"allow_raw_vfw": "1"}) as out:
        depth = out.add_stream("rawvideo", rate=30)
        depth.width, depth.height, depth.pix_fmt = *depth_px, "gray16be"
        codec, pixels = {
            "MJPG": ("mjpeg", "yuvj420p"), "NV12": ("rawvideo", "nv12"), "YUY2": ("rawvideo", "yuyv422"),
            "BGRA": ("rawvideo", "bgra"),
        }[mode]  # fmt: skip
        color = out.add_stream(codec, rate=30)
        color.width, color.height, color.pix_fmt = *color_px, pixels
        for track, name in zip((depth, color), tracks, strict=True):
            track.metadata["title"], track.time_base = name, Fraction(1, 1000)
        color.metadata["K4A_COLOR_MODE"] = f"{mode}_48P"
        if said is not None:
            data = said if isinstance(said, bytes) else pretty_json(said).encode() + b"\0"
            out.add_attachment("calibration.json", "application/octet-stream", data)
        for i in range(frames):
            native = np.full((depth_px[1], depth_px[0]), 1000 + 7 * i, ">u2")
            for track, stamp_ms, data in (
                (depth, step_ms * i, native.tobytes()),
                (color, step_ms * i + 5, stored(i, mode)),
            ):
                packet = av.Packet(data)
                packet.stream, packet.time_base, packet.is_keyframe = track, Fraction(1, 1000), True
                packet.pts = packet.dts = stamp_ms
                out.mux(packet)
    return path


def smooth(index: int) -> np.ndarray:
    """Colour that does not suffer when its chroma is halved."""
    return np.full((48, 64, 3), (40, 90 + index, 160), np.uint8)


def stored(index: int, mode: str) -> bytes:
    bgr = smooth(index)
    if mode == "MJPG":
        return jpeg(bgr)
    if mode == "BGRA":
        return bytes(cv2.cvtColor(bgr, cv2.COLOR_BGR2BGRA).tobytes())
    planes = cv2.cvtColor(bgr, cv2.COLOR_BGR2YUV_I420).reshape(-1)
    y, u, v = planes[: 64 * 48].reshape(48, 64), planes[64 * 48 : 64 * 60], planes[64 * 60 :]
    if mode == "NV12":
        return bytes(y.tobytes() + np.stack([u, v], axis=1).tobytes())
    u, v = (np.repeat(plane.reshape(24, 32), 2, axis=0) for plane in (u, v))
    packed = np.empty((48, 64, 2), np.uint8)
    packed[..., 0], packed[:, 0::2, 1], packed[:, 1::2, 1] = y, u, v
    return packed.tobytes()


def rational(location: str, p1: float, p2: float) -> dict[str, Any]:
    """A camera of the other model of lenses, at a place of the file."""
    said = camera(location, REAL_COLOR, (4096, 3072))
    said["Intrinsics"]["ModelType"] = "CALIBRATION_LensDistortionModelRational6KT"
    said["Intrinsics"]["ModelParameters"][12:] = [p2, p1]
    return said


def in_pixels(camera: Camera) -> tuple[float, ...]:
    return camera.fx, camera.fy, camera.cx, camera.cy


def test_a_real_sensors_intrinsics_are_those_of_its_sdk() -> None:
    found = AzureCalibration.of(calibration(), Path("r.mkv"))
    said, distortion = found.depth((640, 576), Path("r.mkv"))
    assert in_pixels(said.camera((640, 576), Path())) == pytest.approx(REAL_DEPTH_PX, abs=2e-5)
    assert distortion == pytest.approx((*REAL_DISTORTION[:2], -5e-5, 1e-4, *REAL_DISTORTION[2:]))
    color = found.color((1920, 1080), Path("r.mkv"))
    assert color is not None and in_pixels(color.camera) == pytest.approx(REAL_COLOR_PX, abs=2e-4)
    np.testing.assert_allclose(color.T_color_depth[:3, 3], [-0.032, -0.002, 0.004])


@pytest.mark.parametrize(
    ("size_px", "fx", "cx", "cy"),
    [  # by hand: binned side x share - crop - 1/2
        (
            (320, 288),
            512 * 0.4921168386936188,
            512 * 0.5122697949409485 - 96.5,
            512 * 0.49451231956481934 - 90.5,
        ),
        (
            (512, 512),
            512 * 0.4921168386936188,
            512 * 0.5122697949409485 - 0.5,
            512 * 0.49451231956481934 - 0.5,
        ),
        ((1024, 1024), 1024 * 0.4921168386936188, 1024 * 0.5122697949409485 - 0.5, 505.880615234375),
    ],
)
def test_every_depth_mode(size_px: tuple[int, int], fx: float, cx: float, cy: float) -> None:
    said, _ = AzureCalibration.of(calibration(), Path("r.mkv")).depth(size_px, Path("r.mkv"))
    assert (said.fx, said.cx, said.cy) == pytest.approx((fx, cx, cy))
    with raises(RecordingError, "recording.bad-intrinsics", match="the sensor"):
        AzureCalibration.of(calibration(), Path("r.mkv")).depth((640, 480), Path("r.mkv"))


@pytest.mark.parametrize("size_px", [*DEPTH_MODES, (640, 480)])
def test_simulated_intrinsics_are_read_as_they_are(size_px: tuple[int, int]) -> None:
    width, height = size_px
    depth = Camera(width, height, 504.0, 503.5, width / 2 - 0.5, height / 2 + 3)
    said = simulated_calibration(Rig(depth, Camera(1920, 1080, 900, 901, 955, 541), False, np.eye(4)))
    read, distortion = AzureCalibration.of(said, Path("r.mkv")).depth(size_px, Path("r.mkv"))
    assert (read.fx, read.fy, read.cx, read.cy) == pytest.approx((depth.fx, depth.fy, depth.cx, depth.cy))
    assert not any(distortion)


def test_an_early_calibration_is_of_the_middle_of_the_sensor() -> None:
    # In pixels of 4096x3072 both say the same.
    early = [0.5, (0.5 * 3072 - 384) / 2304, 0.47, 0.6 * 3072 / 2304]
    shares = camera("PV0", early, (4096, 2304))
    whole = camera("PV0", [0.5, 0.5, 0.47, 0.6], (4096, 3072))
    found = [
        AzureCalibration.of(calibration(**c), Path()).color((1280, 720), Path()) for c in (shares, whole)
    ]
    assert found[0] is not None and found[1] is not None
    assert in_pixels(found[0].camera) == pytest.approx(in_pixels(found[1].camera))


def test_a_recording(tmp_path: Path) -> None:
    recording = open_recording(write(tmp_path / "r.mkv", calibration()))
    assert (recording.format, len(recording), recording.warnings) == ("azure_kinect", 4, ())
    assert recording.stamps_ns.tolist() == [0, 33_000_000, 66_000_000, 99_000_000]
    assert recording.color_calibration is not None and not recording.color_registered
    for i in range(4):
        frame = recording.frame(i)
        # The middle of the image, which distortion leaves where it is.
        assert frame.depth.shape == (288, 320) and frame.depth[144, 166] == 1000 + 7 * i
        assert frame.color == (".jpg", jpeg(smooth(i)))


def test_lens_distortion_is_taken_out_and_what_lies_beyond_has_no_depth(tmp_path: Path) -> None:
    near = calibration()
    near["CalibrationInformation"]["Cameras"][0]["MetricRadius"] = 0.3
    recording = open_recording(write(tmp_path / "r.mkv", near))
    rays = recording.camera.rays()
    beyond = np.hypot(rays[..., 0], rays[..., 1]) > 0.3
    assert 0.2 < beyond.mean() < 0.9
    assert (recording.frame(0).depth[beyond] == 0).all() and (recording.frame(0).depth[~beyond] > 0).all()


@pytest.mark.parametrize("mode", ["NV12", "YUY2", "BGRA"])
def test_colour_that_is_raw(tmp_path: Path, mode: str) -> None:
    frame = open_recording(write(tmp_path / "r.mkv", calibration(), mode=mode)).frame(2)
    assert frame.color is not None and frame.color[0] == ".png"
    bgr = decoded_picture(frame.color[1])
    assert np.abs(bgr.astype(int) - smooth(2)).max() <= 4


@pytest.mark.parametrize(("mode", "size_px"), [("YUY2", (5, 4)), ("NV12", (4, 5)), ("NV12", (4, 3))])
def test_raw_colour_of_an_odd_side_is_none(mode: str, size_px: tuple[int, int]) -> None:
    length = size_px[0] * size_px[1] * {"YUY2": 2, "NV12": 1.5}[mode]
    assert azure_kinect._raw_bgr(bytes(int(length)), mode, size_px) is None


def test_without_a_depth_track_it_is_colour_only(tmp_path: Path) -> None:
    path = write(tmp_path / "r.mkv", calibration(), tracks=("IR", "COLOR"))
    with raises(RecordingError, "recording.no-depth"):
        open_recording(path)


def changed(**depth_camera: Any) -> dict[str, Any]:
    said = copy.deepcopy(calibration())
    said["CalibrationInformation"]["Cameras"][0] |= depth_camera
    return said


@pytest.mark.parametrize(
    ("said", "why"),
    [
        (None, r"has no calibration\.json attached"),
        (b"{", "is not valid JSON"),
        ({}, "has no list of Cameras"),
        (changed(Location="CALIBRATION_CameraLocationPV0"), "has no camera at CALIBRATION_CameraLocationD0"),
        (changed(Intrinsics={"ModelType": "Theta"}), "the model 'Theta' of lenses is not read"),
        (changed(Intrinsics={"ModelType": MODEL, "ModelParameters": [1, 2]}), "must hold 14 numbers"),
        (changed(Intrinsics=None), "needs Intrinsics and Rt"),
        (changed(Rt={"Rotation": [0] * 9, "Translation": [0] * 3}), "Rt must hold"),
        (changed(**rational("D0", 1e-4, 0)), "the tangential terms of .*Rational6KT are not read; undistort"),
        (calibration(**rational("PV0", 0, -5e-5)), "camera PV0: the tangential terms of .* are not read"),
        (changed(SensorWidth="wide"), "SensorWidth must be a number"),
        (changed(SensorWidth=1e9), "pixels is none"),
    ],
)
def test_a_wrong_calibration(tmp_path: Path, said: dict[str, Any] | bytes | None, why: str) -> None:
    with pytest.raises(RecordingError, match=why) as error:
        open_recording(write(tmp_path / "r.mkv", said))
    assert "\n" not in str(error.value)


def test_a_rational_lens_without_tangential_terms_is_browns() -> None:
    found = AzureCalibration.of(changed(**rational("D0", 0, 0)), Path("r.mkv"))
    assert found.of_depth.distortion == (*REAL_DISTORTION[:2], 0, 0, *REAL_DISTORTION[2:])


@pytest.mark.parametrize("name", ["photo.jpg", "scan.bin", "video.mkv"])
def test_of_files_of_other_kinds_hardly_anything_is_read(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / name
    path.write_bytes(b"\xff\xd8\xff" + b"b16g" * (1 << 18))
    asked: list[int] = []

    class Counted(io.FileIO):
        def read(self, size: int | None = -1, /) -> bytes:
            asked.append(present(size))
            return super().read(size)

    monkeypatch.setattr(azure_kinect, "open_plain", lambda path: Counted(path, "r"))
    assert not AzureKinectRecording.recognises(path)
    assert 0 < sum(asked) <= 16 and min(asked) > 0


def test_a_file_that_becomes_shorter_while_it_is_read(tmp_path: Path) -> None:
    path = write(tmp_path / "r.mkv", calibration())
    recording = open_recording(path)
    assert isinstance(recording, AzureKinectRecording)
    with path.open("r+b") as file:
        file.truncate(recording.places[2].depth.start + 1000)
    assert recording.frame(1).depth.any()
    with raises(DamagedImageError, "recording.damaged-image", match="1000 bytes, not 2"):
        recording.frame(2)


def test_colour_without_its_camera_is_left_out_and_told(tmp_path: Path) -> None:
    said = calibration()
    del said["CalibrationInformation"]["Cameras"][1]
    recording = open_recording(write(tmp_path / "r.mkv", said))
    assert recording.frame(0).color is None and recording.frame(0).depth.any()
    (warning,) = recording.warnings
    assert "its colour is left out" in warning and "no camera at CALIBRATION_CameraLocationPV0" in warning


@pytest.mark.parametrize("size_px", [(20_000, 48), (64, 60_000)])
def test_a_track_of_impossible_size_is_refused(tmp_path: Path, size_px: tuple[int, int]) -> None:
    path = write(tmp_path / "r.mkv", calibration(), mode="BGRA", color_px=size_px)
    with raises(RecordingError, "recording.malformed", match=f"of {size_px[0]}x{size_px[1]} pixels"):
        open_recording(path)


def test_a_track_of_an_unknown_codec_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "r.mkv", calibration())
    path.write_bytes(path.read_bytes().replace(b"V_MJPEG", b"V_XJPEG"))
    with raises(RecordingError, "recording.malformed", match="0x0"):
        open_recording(path)


def test_no_more_images_are_looked_for_than_a_recording_may_have(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, looked = write(tmp_path / "r.mkv", calibration(), frames=60), list[object]()
    monkeypatch.setattr(azure_kinect, "_start", noted(azure_kinect._start, looked))
    monkeypatch.setattr(sources, "MOST_FRAMES", 20)
    with raises(RecordingError, "recording.too-large", match="the 20 frames"):
        open_recording(path)
    assert len(looked) <= 2 * 21  # of each of two tracks


def test_a_file_that_was_cut_off_is_read_to_its_end(tmp_path: Path) -> None:
    path = write(tmp_path / "r.mkv", calibration())
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size * 5 // 8)
    recording = open_recording(path)
    assert len(recording) == 2 and "is cut off: 2 frames are whole" in recording.warnings[0]
    with path.open("r+b") as file:
        file.truncate(700)
    with pytest.raises(RecordingError):
        open_recording(path)


def test_images_of_impossible_times_are_left_out(tmp_path: Path) -> None:
    recording = open_recording(write(tmp_path / "r.mkv", calibration(), step_ms=4 * 10**12))
    assert recording.stamps_ns.tolist() == [0, 4 * 10**18, 8 * 10**18]
    assert "images of impossible times, such as 12000000000005000000 ns, are left" in recording.warnings[0]


def fuzzed(data: bytes, seed: int) -> bytes:
    random = np.random.default_rng(seed)
    content = bytearray(data)
    for _ in range(4):
        at = int(random.integers(0, min(len(content), 6000)))
        content[at : at + 3] = random.integers(0, 256, 3, np.uint8).tobytes()
    return bytes(content)


@pytest.mark.parametrize("seed", range(40))
def test_damaged_bytes_neither_crash_nor_stay_unsaid(tmp_path: Path, seed: int) -> None:
    whole = write(tmp_path / "r.mkv", calibration(), depth_px=(320, 288), frames=2).read_bytes()
    path = tmp_path / "fuzzed.mkv"
    path.write_bytes(fuzzed(whole, seed))
    try:
        recording: Recording = open_recording(path, CameraSettings())
        for frame in every_frame(recording):
            assert isinstance(frame, DamagedImageError) or frame.depth.dtype == np.uint16
    except RecordingError as error:
        assert "\n" not in str(error)
