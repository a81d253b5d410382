"""ROS 1 bags: depth and colour images, CameraInfo, and one topic of poses."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Self

from kinectbench.config import CameraSettings
from kinectbench.errors import RecordingError
from kinectbench.geometry import Camera
from kinectbench.ingest.association import associate
from kinectbench.ingest.images import DamagedImageError, decode_color_bgr, encode_png, image_header
from kinectbench.ingest.recording import DamagedFrame, RawFrame, Recording
from kinectbench.ingest.ros_images import FLOAT_DEPTH, FLOAT_SCALE, INTEGER_SCALE, color_of, depth_of
from kinectbench.ingest.rosbag1_camera import choose_camera_info, intrinsics_of, undistortion_of
from kinectbench.ingest.rosbag1_chunks import MAGIC, BagContents, scan_bag
from kinectbench.ingest.rosbag1_topics import (
    ODOMETRY,
    POSE,
    WANTED,
    BagMessages,
    ImageTopic,
    choose_color,
    choose_depth,
    is_named_registered,
)
from kinectbench.ingest.stamps import first_by_stamp
from kinectbench.ingest.trajectory_file import TimedPose, trajectory_from_poses
from kinectbench.ingest.undistortion import Undistortion
from kinectbench.sequence import GivenTrajectory


@dataclass(frozen=True)
class Rosbag1Recording(Recording):
    """A ROS 1 bag; integer depth is taken as millimetres, float depth as metres.

    Attributes:
        depth: the depth topic.
        color: the colour topic, or None.
        pairs: for each frame the indices of its depth message and its colour message (or None).
        float_units_per_m: what 1 m is in a 32FC1 image.
        undistortion: how distorted images become pinhole images, or None.
    """

    format: ClassVar[str] = "rosbag1"
    looks_for: ClassVar[str] = "a file that begins with '#ROSBAG V2.0'"

    path: Path
    depth: ImageTopic
    color: ImageTopic | None
    pairs: tuple[tuple[int, int | None], ...]
    float_units_per_m: float
    undistortion: Undistortion | None
    camera: Camera
    depth_scale: float
    color_registered: bool
    given_trajectory: GivenTrajectory | None
    warnings: tuple[str, ...]

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the file begins like a bag."""
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC

    @classmethod
    def open(cls, path: Path, settings: CameraSettings | None) -> Self:
        """Walk through the bag, choose the topics, pair depth with colour, and read the poses."""
        contents = scan_bag(path, WANTED)
        warnings = _salvage_warnings(path, contents)
        messages = BagMessages(path)
        depth, depth_warnings = choose_depth(path, contents.topics, messages)
        color, color_warnings = choose_color(path, contents.topics, messages)
        is_float = depth.encoding == FLOAT_DEPTH
        size_px = _first_depth_size(path, depth, messages)
        info = choose_camera_info(depth, size_px, contents.topics, messages)
        intrinsics = intrinsics_of(info, depth).overridden_by(settings)
        camera = intrinsics.camera(size_px, path)
        trajectory, pose_warnings = _read_poses(path, contents, messages)
        pairs, pair_warnings = _pair(depth, color)
        registered, size_warnings = _is_registered(depth, color, size_px, messages)
        scale = intrinsics.depth_scale
        return cls(
            path=path,
            depth=depth,
            color=color,
            pairs=pairs,
            float_units_per_m=scale or 1.0,
            undistortion=undistortion_of(path, info, depth, camera),
            camera=camera,
            depth_scale=FLOAT_SCALE if is_float else scale or INTEGER_SCALE,
            color_registered=registered,
            given_trajectory=trajectory,
            warnings=(
                *warnings,
                *depth_warnings,
                *color_warnings,
                *pair_warnings,
                *size_warnings,
                *pose_warnings,
            ),
        )

    def __len__(self) -> int:
        return len(self.pairs)

    def frames(self) -> Iterator[RawFrame | DamagedFrame]:
        """Decode the messages frame by frame."""
        messages = BagMessages(self.path)
        for depth_index, color_index in self.pairs:
            try:
                yield self._frame(messages, depth_index, color_index)
            except DamagedImageError as error:
                yield DamagedFrame(str(error))

    def _frame(self, messages: BagMessages, depth_index: int, color_index: int | None) -> RawFrame:
        name = _message_name(self.path, self.depth, depth_index)
        message = messages.decode(self.depth.topic, depth_index)
        depth, png = depth_of(
            message, name, compressed=self.depth.compressed, float_units_per_m=self.float_units_per_m
        )
        color = self._color(messages, color_index)
        # Frames of another size are left as they are: the checks refuse them.
        if self.undistortion is not None and depth.shape == (self.camera.height, self.camera.width):
            depth, png = self.undistortion.depth(depth), None
        stamp_ns = self.depth.topic.messages[depth_index].stamp_ns
        return RawFrame(name, stamp_ns, depth, png, color)

    def _color(self, messages: BagMessages, index: int | None) -> tuple[str, bytes] | None:
        if self.color is None or index is None:
            return None
        name = _message_name(self.path, self.color, index)
        color = color_of(messages.decode(self.color.topic, index), name, compressed=self.color.compressed)
        # Colour that is not registered has a camera of its own, and is for display only.
        if self.undistortion is None or not self.color_registered:
            return color
        bgr = decode_color_bgr(color[1], name)
        return (".png", encode_png(self.undistortion.color(bgr))) if bgr.shape[:2] == self._shape else color

    @property
    def _shape(self) -> tuple[int, int]:
        return self.camera.height, self.camera.width


def _message_name(path: Path, image: ImageTopic, index: int) -> str:
    return f"{path}: {image.name}, message {index}"


def _salvage_warnings(path: Path, contents: BagContents) -> list[str]:
    found = sum(len(topic.messages) for topic in contents.topics)
    if contents.complete and not contents.damaged_chunks:
        return []
    what = "is cut off or has no index" if not contents.complete else "is damaged"
    if not found:
        raise RecordingError(f"{path}: {what}, and nothing in it can be saved; copy it again")
    return [
        f"{path}: {what}: {found} messages of {contents.chunks - contents.damaged_chunks} whole chunks were "
        f"saved ({contents.damaged_chunks} chunks are damaged); copy it again, or run `rosbag reindex`"
    ]


def _first_depth_size(path: Path, depth: ImageTopic, messages: BagMessages) -> tuple[int, int]:
    complaint: DamagedImageError | None = None
    for index in range(len(depth.topic.messages)):
        name = _message_name(path, depth, index)
        try:
            image, _ = depth_of(messages.decode(depth.topic, index), name, compressed=depth.compressed)
            return image.shape[1], image.shape[0]
        except DamagedImageError as error:
            complaint = complaint or error
    raise RecordingError(f"{complaint}; none of the depth images is usable") from complaint


def _pair(
    depth: ImageTopic, color: ImageTopic | None
) -> tuple[tuple[tuple[int, int | None], ...], list[str]]:
    """Indices of the depth messages with distinct stamps, each with its colour message; and warnings."""
    depth_ns = [place.stamp_ns for place in depth.topic.messages]
    order, repeated = first_by_stamp(depth_ns)
    warnings = [f"{depth.name}: {repeated} messages repeat a stamp and were left out"] if repeated else []
    if color is None:
        return tuple((i, None) for i in order), warnings
    color_ns = [place.stamp_ns for place in color.topic.messages]
    color_order, _ = first_by_stamp(color_ns)
    partners = associate([depth_ns[i] for i in order], [color_ns[i] for i in color_order])
    alone = sum(partner is None for partner in partners)
    if alone:
        warnings.append(
            f"{depth.name}: {alone} of {len(order)} depth frames have no colour frame within 20 ms"
        )
    return tuple(
        (i, None if partner is None else color_order[partner])
        for i, partner in zip(order, partners, strict=True)
    ), warnings


def _is_registered(
    depth: ImageTopic, color: ImageTopic | None, size_px: tuple[int, int], messages: BagMessages
) -> tuple[bool, list[str]]:
    """Whether colour pixels lie on depth pixels: by name or frame, and only where the sizes agree."""
    if color is None:
        return False, []
    same_frame = bool(depth.frame_id) and depth.frame_id == color.frame_id
    if not (same_frame or is_named_registered(depth)):
        return False, []
    color_px = _first_color_size(color, messages)
    if color_px == size_px:
        return True, []
    return False, [
        f"{color.name} is {color_px[0]}x{color_px[1]} and depth {size_px[0]}x{size_px[1]}: "
        "colour is for display only"
    ]


def _first_color_size(color: ImageTopic, messages: BagMessages) -> tuple[int, int]:
    for index in range(len(color.topic.messages)):
        try:
            message = messages.decode(color.topic, index)
            return image_header(color_of(message, color.name, compressed=color.compressed)[1], color.name)[1:]
        except DamagedImageError:
            continue
    return 0, 0


def _read_poses(
    path: Path, contents: BagContents, messages: BagMessages
) -> tuple[GivenTrajectory | None, list[str]]:
    """The trajectory of the one topic of poses, camera to world; none if there are several."""
    topics = [topic for topic in contents.topics if topic.type in (POSE, ODOMETRY)]
    if len(topics) != 1:
        names = ", ".join(topic.name for topic in topics)
        return None, [f"{path}: {names} all hold poses; none of them is used"] if topics else []
    topic, rows = topics[0], []
    for index, place in enumerate(topic.messages):
        message = messages.decode(topic, index)
        pose = message.pose.pose if topic.type == ODOMETRY else message.pose
        p, q = pose.position, pose.orientation
        where = f"{path}: {topic.name}, message {index}"
        rows.append(TimedPose(place.stamp_ns, (p.x, p.y, p.z), (q.x, q.y, q.z, q.w), where))
    return trajectory_from_poses(rows, f"{path}: {topic.name}")
