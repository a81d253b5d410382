"""Writers of small recordings in every format that is read."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from kinectbench.stages.ingest.images import DamagedImageError
from kinectbench.stages.ingest.recording import RawFrame, Recording

WIDTH, HEIGHT = 64, 48
FX, FY, CX, CY = 60.0, 61.0, 31.5, 23.5
START_NS = 1_305_031_107_000_000_000
STEP_NS = 33_333_333
STORE = get_typestore(Stores.ROS1_NOETIC)
CAMERA: dict[str, Any] = {"width": WIDTH, "height": HEIGHT, "fx": FX, "fy": FY, "cx": CX, "cy": CY}


def every_frame(recording: Recording) -> Iterator[RawFrame | DamagedImageError]:
    """The frames in stamp order, one at a time; in place of one that is damaged, why."""
    for index in range(len(recording)):
        try:
            yield recording.frame(index)
        except DamagedImageError as error:
            yield error


def whole_frames(recording: Recording) -> Iterator[RawFrame]:
    """The frames in stamp order, one at a time; none may be damaged."""
    for frame in every_frame(recording):
        assert isinstance(frame, RawFrame), frame
        yield frame


def depth_image(index: int, scale: float = 5000.0) -> NDArray[np.uint16]:
    """A slanted wall 1 to 2 m away, with a hole; different for each frame."""
    u = np.arange(WIDTH)[None, :] + np.arange(HEIGHT)[:, None] * 0.1 + index
    depth = np.rint((1 + u / 200) * scale).astype(np.uint16)
    depth[:4, :6] = 0
    return depth


def color_image(index: int) -> NDArray[np.uint8]:
    """Colour (height, width, 3) BGR; different for each frame."""
    return np.random.default_rng(index).integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)


def png(image: NDArray[Any]) -> bytes:
    return bytes(cv2.imencode(".png", image)[1])


def jpeg(image: NDArray[Any]) -> bytes:
    return bytes(cv2.imencode(".jpg", image)[1])


def seconds(stamp_ns: int) -> str:
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}"


def quaternion(index: int) -> list[float]:
    """A quaternion that is not quite of unit length, x y z w."""
    return [0.1, 0.02 * index, -0.3, 0.9]


def translation(index: int) -> list[float]:
    return [0.1 * index, 1.25, -0.3]


def write_tum(folder: Path, frames: int = 5, color_shift_ns: int = 4_000_000) -> Path:
    """A TUM folder with colour a little later than depth, camera.json and groundtruth.txt."""
    lists: dict[str, list[str]] = {"depth": ["# depth"], "rgb": ["# colour"], "groundtruth": ["# truth"]}
    for name in ("depth", "rgb"):
        (folder / name).mkdir(parents=True)
    for i in range(frames):
        stamp_ns = START_NS + i * STEP_NS
        (folder / f"depth/{i}.png").write_bytes(png(depth_image(i)))
        (folder / f"rgb/{i}.jpg").write_bytes(jpeg(color_image(i)))
        lists["depth"].append(f"{seconds(stamp_ns)} depth/{i}.png")
        lists["rgb"].append(f"{seconds(stamp_ns + color_shift_ns)} rgb/{i}.jpg")
        pose = " ".join(repr(v) for v in [*translation(i), *quaternion(i)])
        lists["groundtruth"].append(f"{seconds(stamp_ns)} {pose}")
    for name, rows in lists.items():
        (folder / f"{name}.txt").write_text("\n".join(rows) + "\n")
    (folder / "camera.json").write_text(json.dumps({**CAMERA, "depth_factor": 5000}))
    return folder


def write_seven_scenes(folder: Path, numbers: Sequence[int] = (0, 1, 2, 3, 4)) -> Path:
    """A 7-Scenes folder with its intrinsics file and poses that are not quite orthonormal."""
    folder.mkdir(parents=True)
    for i in numbers:
        depth = depth_image(i, 1000.0)
        depth[10:12, 10:12] = 65535
        (folder / f"frame-{i:06d}.depth.png").write_bytes(png(depth))
        (folder / f"frame-{i:06d}.color.png").write_bytes(png(color_image(i)))
        pose = np.eye(4)
        pose[:3, 3] = translation(i)
        pose[0, 1] = 0.01
        np.savetxt(folder / f"frame-{i:06d}.pose.txt", pose)
    np.savetxt(folder / "camera-intrinsics.txt", np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1]]))
    return folder


def write_folder(folder: Path, stems: Sequence[str] = ("0", "1", "2", "3"), color: str = "color") -> Path:
    """A plain folder with Open3D's intrinsics file; no trajectory."""
    for name in ("depth", color):
        (folder / name).mkdir(parents=True)
    for i, stem in enumerate(stems):
        (folder / f"depth/{stem}.png").write_bytes(png(depth_image(i, 1000.0)))
        (folder / f"{color}/{stem}.jpg").write_bytes(jpeg(color_image(i)))
    matrix = [FX, 0, 0, 0, FY, 0, CX, CY, 1]
    intrinsics = {"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": matrix}
    (folder / "camera_intrinsic.json").write_text(json.dumps(intrinsics))
    return folder


class BagWriter:
    """Writes a ROS 1 bag message by message."""

    def __init__(self, path: Path, compression: str | None = None, chunk_bytes: int = 1 << 15) -> None:
        self._writer = Writer(path)
        self._writer.chunk_threshold = chunk_bytes
        if compression:
            self._writer.set_compression(Writer.CompressionFormat[compression])
        self._connections: dict[tuple[str, str], Any] = {}

    def __enter__(self) -> Self:
        self._writer.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.close()

    def image(
        self,
        topic: str,
        stamp_ns: int,
        pixels: NDArray[Any],
        encoding: str,
        frame_id: str = "camera",
        *,
        padding: int = 0,
        big_endian: bool = False,
    ) -> None:
        """A raw image; `padding` bytes of 0xAB end each row."""
        stored = pixels.astype(pixels.dtype.newbyteorder(">" if big_endian else "<"))
        rows = np.ascontiguousarray(stored).reshape(len(pixels), -1).view(np.uint8)
        rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=0xAB)
        fields = (*pixels.shape[:2], encoding, int(big_endian), rows.shape[1], rows.reshape(-1))
        self.write(topic, "sensor_msgs/msg/Image", stamp_ns, frame_id, fields)

    def compressed(self, topic: str, stamp_ns: int, data: bytes, text: str, frame_id: str = "camera") -> None:
        fields = (text, np.frombuffer(data, np.uint8))
        self.write(topic, "sensor_msgs/msg/CompressedImage", stamp_ns, frame_id, fields)

    def info(
        self,
        topic: str,
        stamp_ns: int,
        camera: dict[str, Any],
        distortion: Sequence[float] = (0, 0, 0, 0, 0),
        frame_id: str = "camera",
        model: str = "plumb_bob",
    ) -> None:
        fx, fy, cx, cy = (camera[key] for key in ("fx", "fy", "cx", "cy"))
        K = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1.0])
        P = np.array([fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0.0])
        region = STORE.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        size = (camera["height"], camera["width"])
        fields = (*size, model, np.array(distortion, float), K, np.eye(3).reshape(-1), P, 0, 0, region)
        self.write(topic, "sensor_msgs/msg/CameraInfo", stamp_ns, frame_id, fields)

    def pose(self, topic: str, stamp_ns: int, position: Sequence[float], xyzw: Sequence[float]) -> None:
        types = STORE.types
        point = types["geometry_msgs/msg/Point"](*position)
        turn = types["geometry_msgs/msg/Quaternion"](*xyzw)
        pose = types["geometry_msgs/msg/Pose"](point, turn)
        self.write(topic, "geometry_msgs/msg/PoseStamped", stamp_ns, "world", (pose,))

    def write(self, topic: str, kind: str, stamp_ns: int, frame_id: str, fields: tuple[Any, ...]) -> None:
        stamp = STORE.types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
        header = STORE.types["std_msgs/msg/Header"](0, stamp, frame_id)
        data = bytes(STORE.serialize_ros1(STORE.types[kind](header, *fields), kind))
        self.raw(topic, kind, stamp_ns, data)

    def raw(self, topic: str, kind: str, stamp_ns: int, data: bytes) -> None:
        key = (topic, kind)
        if key not in self._connections:
            self._connections[key] = self._writer.add_connection(topic, kind, typestore=STORE)
        self._writer.write(self._connections[key], stamp_ns, data)


def write_bag(path: Path, frames: int = 5, scale: float = 5000.0, compression: str | None = None) -> Path:
    """The frames of `write_tum` as a bag: raw depth, JPEG colour, CameraInfo and poses."""
    with BagWriter(path, compression) as bag:
        for i in range(frames):
            stamp_ns = START_NS + i * STEP_NS
            bag.info("/camera/depth/camera_info", stamp_ns, CAMERA)
            bag.image("/camera/depth/image_raw", stamp_ns, depth_image(i, scale), "16UC1")
            bag.compressed("/camera/rgb/image/compressed", stamp_ns + 4_000_000, jpeg(color_image(i)), "jpeg")
            bag.pose("/pose", stamp_ns, translation(i), quaternion(i))
    return path
