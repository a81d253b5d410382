"""Stand-ins for libraries of cameras, by the calls that they document; and a file that librealsense makes.

Each gives `COUNT` frames, then nothing. They stand in `sys.modules` under the library's name.
"""

import sys
import time
from collections.abc import Callable
from math import atan
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

COUNT = 5
BENT = (0.1, -0.05, 0.001, 0.002, 0.01, 0.0, 0.0, 0.0)


def depth_image(index: int, height: int, width: int) -> NDArray[np.uint16]:
    """A slanted wall, another for each frame."""
    v, u = np.mgrid[:height, :width]
    image: NDArray[np.uint16] = (1000 + u + 2 * v + 7 * index).astype(np.uint16)
    return image


def rgb_image(index: int, height: int, width: int) -> NDArray[np.uint8]:
    v, u = np.mgrid[:height, :width]
    return np.dstack([u % 256, v % 256, np.full_like(u, index)]).astype(np.uint8)


def jpeg(index: int, height: int, width: int) -> bytes:
    return bytes(cv2.imencode(".jpg", rgb_image(index, height, width))[1])


def install(monkeypatch: pytest.MonkeyPatch, name: str, **members: Any) -> SimpleNamespace:
    """Put a module in place, with the modules above it."""
    made = ModuleType(name)
    for key, value in members.items():
        setattr(made, key, value)
    monkeypatch.setitem(sys.modules, name, made)
    return SimpleNamespace(**members)


def freenect(monkeypatch: pytest.MonkeyPatch, plugged: int = 1) -> None:
    """libfreenect's wrapper: images and stamps of 60 MHz in 32 bits, which begin again after frame 2."""
    ticks = [(2**32 - 5_000_000 + k * 2_000_000) % 2**32 for k in range(COUNT)]
    counts = {"depth": 0, "video": 0}

    def image(kind: str, draw: Callable[..., NDArray[Any]], late: int) -> Any:
        index = counts[kind]
        counts[kind] += 1
        if index == COUNT:
            return None
        return draw(index, 480, 640), (ticks[index] + late) % 2**32

    install(
        monkeypatch,
        "freenect",
        DEPTH_REGISTERED=4,
        VIDEO_RGB=0,
        init=object,
        shutdown=lambda context: 0,
        num_devices=lambda context: plugged,
        sync_get_depth=lambda index, form: image("depth", depth_image, 0),
        sync_get_video=lambda index, form: image("video", rgb_image, 600_000),
        sync_stop=lambda: None,
    )


def openni(monkeypatch: pytest.MonkeyPatch, plugged: int = 1, *, registers: bool = True) -> None:
    """OpenNI 2's wrapper: streams, frames with buffers of ctypes, stamps in microseconds; frame 3 is lost."""

    class Stream:
        def __init__(self, draw: Callable[..., NDArray[Any]], late_us: int, focal_px: float) -> None:
            self.draw, self.late_us, self.index = draw, late_us, 0
            self.focal_px = focal_px

        def configure_mode(self, width: int, height: int, fps: int, form: int) -> None:
            self.size = height, width

        def set_mirroring_enabled(self, mirrored: bool) -> None:
            assert not mirrored

        def start(self) -> None: ...

        def stop(self) -> None: ...

        def get_horizontal_fov(self) -> float:
            return 2 * atan(320 / self.focal_px)

        def get_vertical_fov(self) -> float:
            return 2 * atan(240 / self.focal_px)

        def read_frame(self) -> Any:
            index, self.index = self.index, self.index + 1
            image = self.draw(index, *self.size)
            number = index + (index >= 3)
            return SimpleNamespace(
                width=self.size[1],
                height=self.size[0],
                frameIndex=number,
                timestamp=number * 33_333 + self.late_us,
                get_buffer_as_uint16=lambda: np.ctypeslib.as_ctypes(image.ravel()),
                get_buffer_as_uint8=lambda: np.ctypeslib.as_ctypes(image.ravel()),
            )

    device = SimpleNamespace(
        create_depth_stream=lambda: Stream(depth_image, 0, 575.0),
        create_color_stream=lambda: Stream(rgb_image, 1_000, 525.0),
        is_image_registration_mode_supported=lambda mode: registers,
        set_image_registration_mode=lambda mode: None,
        set_depth_color_sync_enabled=lambda enabled: None,
    )
    openni2 = SimpleNamespace(
        PIXEL_FORMAT_DEPTH_1_MM=100,
        PIXEL_FORMAT_RGB888=200,
        IMAGE_REGISTRATION_DEPTH_TO_COLOR=1,
        is_initialized=lambda: True,
        wait_for_any_stream=lambda streams, timeout: streams[0] if streams[0].index < COUNT else None,
        Device=SimpleNamespace(open_any=lambda: device, enumerate_uris=lambda: [b"1d27/0601@1/2"] * plugged),
    )
    install(monkeypatch, "openni", openni2=openni2)


def pyk4a(monkeypatch: pytest.MonkeyPatch, plugged: int = 1) -> None:
    """pyk4a: captures with images and stamps in microseconds; a calibration in pixels and metres."""

    late = type("K4ATimeoutException", (Exception,), {})

    class PyK4A:
        def __init__(self, config: Any) -> None:
            assert config.color_format == "MJPG"
            self.index = 0
            self.calibration = SimpleNamespace(
                get_camera_matrix=lambda of: np.array([[504.0 + of, 0, 320], [0, 505.0, 330], [0, 0, 1]]),
                get_distortion_coefficients=lambda of: np.array(BENT),
                get_extrinsic_parameters=lambda of, to: (np.eye(3), np.array([[-0.032, 0.002, 0.004]])),
            )

        def start(self) -> None: ...

        def stop(self) -> None: ...

        def get_capture(self, timeout: int) -> Any:
            if self.index == COUNT:
                raise late
            index, self.index = self.index, self.index + 1
            return SimpleNamespace(
                depth=depth_image(index, 576, 640),
                depth_timestamp_usec=index * 33_333,
                color=np.frombuffer(jpeg(index, 720, 1280), np.uint8),
                color_timestamp_usec=index * 33_333 + 160,
            )

    install(
        monkeypatch,
        "pyk4a",
        K4ATimeoutException=late,
        PyK4A=PyK4A,
        Config=lambda **values: SimpleNamespace(**values),
        ColorResolution=SimpleNamespace(RES_720P=1),
        ImageFormat=SimpleNamespace(COLOR_MJPG="MJPG"),
        DepthMode=SimpleNamespace(NFOV_UNBINNED=2),
        FPS=SimpleNamespace(FPS_30=2),
        CalibrationType=int,
        connected_device_count=lambda: plugged,
    )


def pyorbbecsdk(monkeypatch: pytest.MonkeyPatch, plugged: int = 1) -> None:
    """Orbbec's SDK: pairs of frames with raw bytes, a unit of depth in mm, translations in mm.

    It writes Log/ where one works, unless its logger is turned off.
    """
    straight = SimpleNamespace(k1=0, k2=0, p1=0, p2=0, k3=0, k4=0, k5=0, k6=0)

    def profile(width: int, height: int) -> Any:
        said = SimpleNamespace(width=width, height=height, fx=400.0, fy=401.0, cx=width / 2, cy=height / 2)
        place = SimpleNamespace(rot=np.eye(3, dtype=np.float32).ravel(), transform=[-32.0, 2.0, 4.0])
        return SimpleNamespace(
            get_intrinsic=lambda: said,
            get_distortion=lambda: straight,
            get_extrinsic_to=lambda other: place,
        )

    def one(index: int, data: bytes, late_us: int) -> Any:
        return SimpleNamespace(
            get_data=lambda: np.frombuffer(data, np.uint8),
            get_height=lambda: 576,
            get_width=lambda: 640,
            get_index=lambda: index + (index >= 3),
            get_depth_scale=lambda: 0.5,
            get_timestamp_us=lambda: index * 33_333 + late_us,
        )

    class Pipeline:
        index = 0

        def get_stream_profile_list(self, sensor: str) -> Any:
            return SimpleNamespace(
                get_default_video_stream_profile=lambda: profile(640, 576),
                get_video_stream_profile=lambda width, height, form, fps: profile(1280, 720),
            )

        def wait_for_frames(self, timeout: int) -> Any:
            if self.index == COUNT:
                return None
            index, self.index = self.index, self.index + 1
            depth = one(index, depth_image(index, 576, 640).tobytes(), 0)
            color = one(index, jpeg(index, 720, 1280), 120)
            return SimpleNamespace(get_depth_frame=lambda: depth, get_color_frame=lambda: color)

        def enable_frame_sync(self) -> None: ...

        def start(self, config: Any) -> None: ...

        def stop(self) -> None: ...

    found = SimpleNamespace(
        get_count=lambda: plugged,
        get_device_name_by_index=lambda k: "Femto Bolt",
        get_device_serial_number_by_index=lambda k: "CL8",
    )

    class Context:
        logs = True

        @classmethod
        def set_logger_to_file(cls, level: str, folder: str) -> None:
            cls.logs = level != "none"

        def __init__(self) -> None:
            if self.logs:
                Path("Log").mkdir(exist_ok=True)

        def query_devices(self) -> SimpleNamespace:
            return found

    install(
        monkeypatch,
        "pyorbbecsdk",
        Pipeline=Pipeline,
        Config=lambda: SimpleNamespace(
            enable_stream=lambda profile: None, set_frame_aggregate_output_mode=lambda mode: None
        ),
        Context=Context,
        OBLogLevel=SimpleNamespace(NONE="none"),
        OBSensorType=SimpleNamespace(DEPTH_SENSOR="depth", COLOR_SENSOR="color"),
        OBFormat=SimpleNamespace(MJPG="MJPG"),
        OBFrameAggregateOutputMode=SimpleNamespace(FULL_FRAME_REQUIRE=3),
    )


def record3d(monkeypatch: pytest.MonkeyPatch, plugged: int = 1) -> None:
    """Record3D's library: floats in metres, confidence, colour four times as large; a thread calls back."""
    import threading

    class Record3DStream:
        index = 0
        on_new_frame: Callable[[], None]
        on_stream_stopped: Callable[[], None]

        @staticmethod
        def get_connected_devices() -> list[Any]:
            return [SimpleNamespace(udid="0008-001", product_id=1)] * plugged

        def connect(self, device: Any) -> bool:
            threading.Thread(target=self._stream, daemon=True).start()
            return True

        def _stream(self) -> None:
            # A frame that a busy machine does not take in time is lost, as on a phone; not so in a test.
            self.taken = threading.Event()
            for self.index in range(COUNT):
                self.taken.clear()
                self.on_new_frame()
                self.taken.wait(10)
                time.sleep(0.05)
            self.on_stream_stopped()

        def get_depth_frame(self) -> NDArray[np.float32]:
            self.taken.set()
            metres = depth_image(self.index, 256, 192).astype(np.float32) / np.float32(1000)
            metres[0, :2] = np.nan, 60
            return metres

        def get_confidence_frame(self) -> NDArray[np.uint8]:
            confidence = np.full((256, 192), 2, np.uint8)
            confidence[5, :] = 1
            return confidence

        def get_rgb_frame(self) -> NDArray[np.uint8]:
            return rgb_image(self.index, 1024, 768)

        def get_intrinsic_mat(self) -> Any:
            return SimpleNamespace(fx=800.0, fy=800.0, tx=383.5, ty=511.5)

        def disconnect(self) -> None: ...

    install(monkeypatch, "record3d", Record3DStream=Record3DStream)


def write_by_librealsense(file: Path, count: int) -> None:
    """A recording by librealsense's own recorder of its own software device: 64x48, depth in 0.1 mm."""
    import pyrealsense2 as rs

    camera = rs.intrinsics()
    camera.width, camera.height, camera.model = 64, 48, rs.distortion.brown_conrady
    camera.fx, camera.fy, camera.ppx, camera.ppy, camera.coeffs = 60, 61, 31.5, 22, [0.0] * 5
    device, streams = rs.software_device(), []
    for uid, (name, stream, form, size) in enumerate(
        [("Depth", rs.stream.depth, rs.format.z16, 2), ("Color", rs.stream.color, rs.format.rgb8, 3)]
    ):
        sensor, video = device.add_sensor(name), rs.video_stream()
        video.type, video.fmt, video.uid, video.index, video.bpp = stream, form, uid, 0, size
        video.width, video.height, video.fps, video.intrinsics = 64, 48, 30, camera
        streams.append((sensor, sensor.add_video_stream(video), size))
    streams[0][0].add_read_only_option(rs.option.depth_units, 0.0001)
    place = rs.extrinsics()
    place.rotation, place.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [-0.015, 0.0, 0.0]
    streams[0][1].register_extrinsics_to(streams[1][1], place)
    recorder, queue, kept = rs.recorder(str(file), device), rs.frame_queue(9), []
    for sensor in recorder.query_sensors():
        sensor.open(sensor.get_stream_profiles())
        sensor.start(queue)
    for index in range(count):
        for sensor, profile, size in streams:
            image = rgb_image(index, 48, 64) if size == 3 else depth_image(index, 48, 64)
            kept.append(image)
            made = rs.software_video_frame()
            made.pixels, made.stride, made.bpp = image, 64 * size, size
            made.timestamp, made.frame_number = 1000 + 33.25 * index, index
            made.domain = rs.timestamp_domain.hardware_clock
            made.profile = profile.as_video_stream_profile()
            sensor.on_video_frame(made)
        time.sleep(0.03)
    for sensor in recorder.query_sensors():
        sensor.stop()
        sensor.close()
