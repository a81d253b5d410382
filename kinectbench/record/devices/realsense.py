"""RealSense cameras by librealsense, read by sensor, because its pipeline would drop frames at the start."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from kinectbench.core import CaptureError
from kinectbench.core.geometry import Camera, rigid
from kinectbench.record.interface import POLL_MS, Acceleration, Device, Frame, Setup, polled
from kinectbench.stages.ingest.recording import ColorCalibration

if TYPE_CHECKING:
    import pyrealsense2 as rs

# Width, height and rate that all D400 and L500 offer for depth and colour; else the first profile is used.
USUAL = (640, 480, 30)
# Frames that librealsense's queue holds: one second.
QUEUE = 90


class RealSense(Device):
    """The first RealSense that is plugged in; or a recording by librealsense, which it plays back."""

    name = "realsense"
    cameras = "RealSense D400 and L500"
    extra = "record-realsense"

    def __init__(self, file: Path | None = None) -> None:
        """Prepare the device without opening it.

        Args:
            file: a recording of librealsense that is played back instead of a camera.
        """
        self._file = file
        self._started: list[rs.sensor] = []
        self._playback: rs.playback | None = None
        self._last: int | None = None

    def plugged_in(self) -> tuple[str, ...]:
        """Return names and serial numbers of the cameras."""
        import pyrealsense2 as rs

        words = (rs.camera_info.name, rs.camera_info.serial_number)
        return tuple(" ".join(map(each.get_info, words)) for each in rs.context().query_devices())

    def open(self) -> Setup:
        """Start depth, colour and accelerometer."""
        import pyrealsense2 as rs

        context = rs.context()
        if self._file is not None:
            device = context.load_device(str(self._file))
            self._playback = device.as_playback()
        else:
            found = list(context.query_devices())
            if not found:
                raise CaptureError(f"{self.name}: no camera is plugged in")
            device = found[0]
        wanted = {rs.stream.depth: rs.format.z16, rs.stream.color: rs.format.rgb8}
        wanted[rs.stream.accel] = rs.format.motion_xyz32f
        profiles: dict[rs.stream, rs.stream_profile] = {}
        chosen = []
        for sensor in device.query_sensors():
            offered = sensor.get_stream_profiles()
            new = {s: _usual(offered, s, form) for s, form in wanted.items() if s not in profiles}
            new = {stream: profile for stream, profile in new.items() if profile is not None}
            profiles |= new
            if new:
                chosen.append((sensor, list(new.values())))
            if rs.stream.depth in new:
                units_m = sensor.as_depth_sensor().get_depth_scale()
        if rs.stream.depth not in profiles:
            raise CaptureError(f"{self.name}: this camera has no depth")
        depth = profiles[rs.stream.depth]
        if rs.stream.accel in profiles:
            to_depth = profiles[rs.stream.accel].get_extrinsics_to(depth)
            self._R_depth_accel = np.reshape(to_depth.rotation, (3, 3)).T
        self._queue = rs.frame_queue(QUEUE, keep_frames=True)
        for sensor, selected in chosen:
            sensor.open(selected)
            self._started.append(sensor)
            sensor.start(self._queue)
        camera = _camera(depth.as_video_stream_profile().get_intrinsics())
        # The unit is stored as float32: 0.001 is read as 0.0010000000474.
        scale = float(np.round(1 / units_m, 3))
        return Setup(camera, scale, False, _calibration(depth, profiles.get(rs.stream.color)))

    def frames(self) -> Iterator[Frame]:
        """Yield each depth image with the colour nearest in time, once the next depth image has arrived."""
        import pyrealsense2 as rs

        held: rs.frame | None = None
        colors: list[rs.frame] = []
        felt: list[Acceleration] = []

        def stream_of(each: "rs.frame | Literal[False]") -> "rs.stream":
            return each.get_profile().stream_type() if each else rs.stream.depth

        for each in polled(self._next, self.name, lambda each: stream_of(each) == rs.stream.depth):
            stream = stream_of(each)
            if stream == rs.stream.color:
                colors.append(each)
            elif stream == rs.stream.accel:
                felt.append(self._felt(each))
            else:
                if held is not None:
                    yield self._frame(held, colors, tuple(felt))
                    felt = []
                if not each:
                    return
                held = each

    def close(self) -> None:
        """Stop and close the sensors."""
        while self._started:
            sensor = self._started.pop()
            sensor.stop()
            sensor.close()

    def _next(self) -> "rs.frame | Literal[False] | None":
        """Return the next frame; None if none arrived; False at the end of the file."""
        import pyrealsense2 as rs

        there, frame = self._queue.try_wait_for_frame(POLL_MS)
        if there:
            return frame
        if self._playback is not None and self._playback.current_status() == rs.playback_status.stopped:
            return False
        return None

    def _frame(self, depth: "rs.frame", colors: list["rs.frame"], felt: tuple[Acceleration, ...]) -> Frame:
        """Return depth with the colour nearest in time, and `felt`; drop that colour and older `colors`."""
        number, stamp_ns = depth.get_frame_number(), _stamp_ns(depth)
        if self._last is not None:
            self.missed += max(number - self._last - 1, 0)
        self._last = number
        image = np.array(np.asanyarray(depth.get_data()), np.uint16)
        if not colors:
            return Frame(stamp_ns, image, None, None, felt)
        nearest = min(range(len(colors)), key=lambda k: abs(_stamp_ns(colors[k]) - stamp_ns))
        color = colors[nearest]
        del colors[: nearest + 1]
        rgb = np.array(np.asanyarray(color.get_data()), np.uint8)
        return Frame(stamp_ns, image, rgb, _stamp_ns(color), felt)

    def _felt(self, frame: "rs.frame") -> Acceleration:
        """Return a measurement of the accelerometer, m/s^2, in the depth camera's axes."""
        said = frame.as_motion_frame().get_motion_data()
        x, y, z = (self._R_depth_accel @ [said.x, said.y, said.z]).tolist()
        return Acceleration(_stamp_ns(frame), (x, y, z))


def _stamp_ns(frame: "rs.frame") -> int:
    """Return a frame's stamp in nanoseconds; librealsense gives ms."""
    milliseconds: float = frame.get_timestamp()
    return round(milliseconds * 1e6)


def _usual(
    profiles: Sequence["rs.stream_profile"], stream: "rs.stream", form: "rs.format"
) -> "rs.stream_profile | None":
    """Return a stream's profile in a format: one of USUAL size and rate, else the first; None if absent."""
    found = [each for each in profiles if each.stream_type() == stream and each.format() == form]
    for each in found:
        if each.is_video_stream_profile():
            video = each.as_video_stream_profile()
            if (video.width(), video.height(), video.fps()) == USUAL:
                return each
    return found[0] if found else None


def _camera(said: "rs.intrinsics") -> Camera:
    return Camera(said.width, said.height, said.fx, said.fy, said.ppx, said.ppy)


def _calibration(depth: "rs.stream_profile", color: "rs.stream_profile | None") -> ColorCalibration | None:
    if color is None:
        return None
    said, place = color.as_video_stream_profile().get_intrinsics(), depth.get_extrinsics_to(color)
    # librealsense stores rotations column by column.
    T_color_depth = rigid(np.reshape(place.rotation, (3, 3)).T, place.translation)
    distortion = tuple(map(float, said.coeffs)) if any(said.coeffs) else ()
    return ColorCalibration(_camera(said), distortion, T_color_depth)
