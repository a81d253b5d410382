"""Common steps for all ROS bags: choose topics, pair depth with colour, decode frames."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import ClassVar, NamedTuple, Self

import numpy as np

from kinectbench.core import RecordingError
from kinectbench.core.sequence import UpSample
from kinectbench.core.trajectory.stamps import first_by_stamp
from kinectbench.core.types import Float64
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.bags.message_decoding import BagTopic, MessagePlace, RosBag
from kinectbench.stages.ingest.bags.ros_images import FLOAT_DEPTH, INTEGER_SCALE, color_of, depth_of
from kinectbench.stages.ingest.bags.ros_poses import TransformTree, read_ros_poses, read_transforms
from kinectbench.stages.ingest.bags.ros_topics import (
    CAMERA_INFO,
    COLOR_KIND,
    DEPTH_KIND,
    IMU,
    WANTED,
    CameraInfo,
    ImageTopic,
    NamedInfo,
    choose_camera_info,
    choose_color,
    choose_depth,
    distortion_of,
    every_image,
    intrinsics_of,
    is_named_registered,
)
from kinectbench.stages.ingest.gravity import up_at_rest
from kinectbench.stages.ingest.images import (
    FLOAT_SCALE,
    DamagedImageError,
    advised,
    decode_color_bgr,
    encode_png,
    image_header,
)
from kinectbench.stages.ingest.intrinsics import gives_intrinsics, scale_warnings
from kinectbench.stages.ingest.pairing import pair_by_time
from kinectbench.stages.ingest.recording import ColorCalibration, RawFrame, Recording, first_whole
from kinectbench.stages.ingest.undistortion import Undistortion

# Returns `T_depth_imu` (4, 4) for the topic of an accelerometer; None if the bag does not have it.
PlaceOfImu = Callable[[ImageTopic], Float64 | None]


class MessagePair(NamedTuple):
    """The stamp of a frame, nanoseconds, and the indices of its depth message and its colour message."""

    stamp_ns: int
    depth: int
    color: int | None


@dataclass(frozen=True, kw_only=True)
class RosRecording(Recording):
    """A ROS bag; integer depth is in millimetres, float depth in metres.

    Attributes:
        depth: the depth topic.
        color_topic: the colour topic; None if there is none.
        places: for each frame its stamp, and the indices of its depth and colour messages (colour or None).
        undistortion: makes pinhole images from distorted ones; None if not needed.
        bag: reads and decodes the messages.
    """

    wanted: ClassVar[frozenset[str]] = WANTED
    uses: ClassVar[frozenset[str]] = frozenset({"depth_topic", "color_topic", "pose_topic", "color_delay_s"})
    # Types for which the bag's definition is used.
    own_types: ClassVar[frozenset[str]] = frozenset()

    depth: ImageTopic
    color_topic: ImageTopic | None
    places: tuple[MessagePair, ...]
    undistortion: Undistortion | None
    bag: RosBag

    @classmethod
    @abstractmethod
    def walk(cls, path: Path) -> RosBag:
        """Find the messages of the wanted types in a bag.

        Raises:
            RecordingError: nothing in the bag is readable.
        """

    @classmethod
    def frame_ids_tell(cls, depth: ImageTopic) -> bool:
        """Whether equal frame_ids of depth and colour mean that they are registered, pixel by pixel."""
        return True

    @classmethod
    def integer_scale(cls, bag: RosBag, depth: ImageTopic) -> float | None:
        """Return native units per metre of integer depth; None if the bag does not state it."""
        return None

    @classmethod
    def color_place(
        cls, bag: RosBag, tree: TransformTree, depth: ImageTopic, color: ImageTopic
    ) -> Float64 | None:
        """Return `T_color_depth` (4, 4), depth camera to colour camera; None if the bag lacks it."""
        return cls.between(bag, tree, color, depth)

    @classmethod
    def between(cls, bag: RosBag, tree: TransformTree, to: ImageTopic, of: ImageTopic) -> Float64 | None:
        """Return `T_to_of` (4, 4) between the frames of two topics, one of depth; None if unknown."""
        return tree.fixed(to.frame_id, of.frame_id)

    @classmethod
    def camera_infos(cls, bag: RosBag) -> list[NamedInfo]:
        """Return pairs (topic's name, its first readable CameraInfo message)."""
        infos = ((t.name, bag.first(t)) for t in bag.topics if t.type == CAMERA_INFO)
        return [(name, message) for name, message in infos if message is not None]

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """Walk through the bag, choose the topics, pair depth with colour, and read the poses."""
        bag = cls.walk(path)
        depth, depth_warnings = choose_depth(bag, settings.depth_topic)
        color, color_warnings = choose_color(bag, depth, settings.color_topic)
        if not cls.frame_ids_tell(depth):
            depth, color = replace(depth, frame_id=""), color and replace(color, frame_id="")
        size_px = _first_depth_size(bag, depth)
        infos = cls.camera_infos(bag)
        info, info_warnings = _depth_info(bag, depth, color, size_px, infos, settings)
        intrinsics = intrinsics_of(info, depth).overridden_by(settings)
        camera = intrinsics.camera(size_px, path)
        tree = read_transforms(bag)
        trajectory, pose_warnings, pose_error = read_ros_poses(bag, tree, depth, settings.pose_topic)
        pairs, pair_warnings = _pair(depth, color, settings)
        registered, size_warnings = _is_registered(bag, depth, color, size_px)
        scale = intrinsics.depth_scale
        is_float = depth.encoding == FLOAT_DEPTH
        own_scale = None if is_float else cls.integer_scale(bag, depth)
        calibration = None
        if color is not None and not registered:
            T_color_depth = cls.color_place(bag, tree, depth, color)
            calibration, calibration_warnings = _calibration(bag, color, T_color_depth, infos)
            color_warnings = [*color_warnings, *calibration_warnings]
        if calibration is not None:
            size_warnings = []
            registered = calibration.lies_on(camera)
        distortion = distortion_of(path, info, depth)
        return cls(
            path=path,
            depth=depth,
            color_topic=color,
            places=pairs,
            float_scale=(scale or 1.0) if is_float else None,
            undistortion=Undistortion(camera, distortion) if distortion else None,
            bag=bag,
            recorded=(_in_file_order(depth), _in_file_order(color)),
            camera=camera,
            depth_scale=FLOAT_SCALE if is_float else scale or own_scale or INTEGER_SCALE,
            color_registered=registered,
            up_cameras=measured_up(
                bag, [pair.stamp_ns for pair in pairs], partial(cls.between, bag, tree, depth)
            ),
            color_calibration=None if registered else calibration,
            given_trajectory=trajectory,
            trajectory_error=pose_error,
            warnings=(
                *([bag.trouble] if bag.trouble else []),
                *depth_warnings,
                *color_warnings,
                *info_warnings,
                *pair_warnings,
                *size_warnings,
                *scale_warnings(path, own_scale, settings),
                *pose_warnings,
            ),
        )

    def frame(self, index: int) -> RawFrame:
        """Decode the depth and colour messages of a frame."""
        pair = self.places[index]
        name = _message_name(self.bag, self.depth, pair.depth)
        depth = depth_of(self.bag.decode(self.depth.topic, pair.depth), name, self.float_scale or 1.0)
        color = self._color(pair.color)
        if self.undistortion is not None:
            depth = self.undistortion.depth(depth)
        return RawFrame(name, pair.stamp_ns, depth, color)

    def _color(self, index: int | None) -> tuple[str, bytes] | None:
        if self.color_topic is None or index is None:
            return None
        name = _message_name(self.bag, self.color_topic, index)
        color = color_of(self.bag.decode(self.color_topic.topic, index), name)
        # Colour that is not registered has its own camera.
        if self.undistortion is None or not self.color_registered:
            return color
        return ".png", encode_png(self.undistortion.color(decode_color_bgr(color[1], name)))


def _message_name(bag: RosBag, image: ImageTopic, index: int) -> str:
    return f"{bag.path}: {image.name}, message {index}"


def _in_file_order(image: ImageTopic | None) -> tuple[int, ...]:
    """Return the stamps of a topic's messages, nanoseconds, in the order of recording."""

    def position(place: MessagePlace) -> tuple[int, int, int]:
        return place.file, place.offset if place.chunk < 0 else place.chunk, place.offset

    messages = () if image is None else image.topic.messages
    return tuple(place.stamp_ns for place in sorted(messages, key=position))


def _first_depth_size(bag: RosBag, depth: ImageTopic) -> tuple[int, int]:
    def size_px(index: int) -> tuple[int, int]:
        name = _message_name(bag, depth, index)
        height, width = depth_of(bag.decode(depth.topic, index), name).shape
        return width, height

    try:
        return first_whole(size_px, range(len(depth.topic.messages)))
    except DamagedImageError as error:
        line = advised(f"{error}; none of the depth images is usable", error.advice)
        raise RecordingError(line, what="no-frame") from error


def _pair(
    depth: ImageTopic, color: ImageTopic | None, settings: CameraSettings
) -> tuple[tuple[MessagePair, ...], list[str]]:
    """Pair depth messages, without repeated stamps, with colour messages; return the pairs and warnings."""
    depth_ns = [place.stamp_ns for place in depth.topic.messages]
    order, warnings = first_by_stamp(depth_ns, depth.name, "messages")
    if color is None:
        return tuple(MessagePair(depth_ns[i], i, None) for i in order), warnings
    color_ns = [place.stamp_ns for place in color.topic.messages]
    color_order, _ = first_by_stamp(color_ns, color.name, "messages")
    partners = pair_by_time(
        [depth_ns[i] for i in order],
        [color_ns[j] for j in color_order],
        delay_s=settings.color_delay_s,
        where=depth.name,
    )
    return tuple(
        MessagePair(depth_ns[i], i, None if partner is None else color_order[partner])
        for i, partner in zip(order, partners.of_depth, strict=True)
    ), [*warnings, *partners.warnings]


def _is_registered(
    bag: RosBag, depth: ImageTopic, color: ImageTopic | None, size_px: tuple[int, int]
) -> tuple[bool, list[str]]:
    """Return (whether depth and colour are registered to each other, warnings).

    They are if the depth topic's name says so or both topics have the same frame_id, and the colour images
    have the size `size_px` of the depth images. There is a warning if only the size differs.
    """
    if color is None:
        return False, []
    if not (_same_frame(depth, color) or is_named_registered(depth)):
        return False, []
    color_px = _first_color_size(bag, color)
    if color_px == size_px:
        return True, []
    return False, [
        f"{color.name} is {color_px[0]}x{color_px[1]} and depth {size_px[0]}x{size_px[1]}: "
        "colour is for display only"
    ]


def _depth_info(
    bag: RosBag,
    depth: ImageTopic,
    color: ImageTopic | None,
    size_px: tuple[int, int],
    infos: list[NamedInfo],
    settings: CameraSettings,
) -> tuple[CameraInfo | None, list[str]]:
    """Return depth's CameraInfo from `infos`, and a warning if another differs (none if settings decide)."""
    on_color = color is not None and (is_named_registered(depth) or _same_frame(depth, color))
    info, warnings = choose_camera_info(
        depth, DEPTH_KIND, size_px, infos, every_image(bag), color if on_color else None
    )
    return info, [warnings] if warnings and not gives_intrinsics(settings) else []


def _same_frame(depth: ImageTopic, color: ImageTopic) -> bool:
    return bool(depth.frame_id) and depth.frame_id == color.frame_id


def _first_color_size(bag: RosBag, color: ImageTopic) -> tuple[int, int]:
    for message in bag.whole(color.topic):
        with suppress(DamagedImageError):
            return image_header(color_of(message, color.name)[1], color.name)[1:]
    return 0, 0


def _calibration(
    bag: RosBag, color: ImageTopic, T_color_depth: Float64 | None, infos: list[NamedInfo]
) -> tuple[ColorCalibration | None, list[str]]:
    """Return colour's calibration by the best of `infos` (None if none of them fits), and warnings."""
    size_px = _first_color_size(bag, color)
    info, info_warnings = choose_camera_info(color, COLOR_KIND, size_px, infos, every_image(bag))
    if T_color_depth is None or info is None:
        return None, []
    try:
        camera = intrinsics_of(info, color).camera(size_px, bag.path)
        calibration = ColorCalibration(camera, distortion_of(bag.path, info, color), T_color_depth)
    except RecordingError:
        return None, []
    return calibration, [info_warnings] if info_warnings else []


def measured_up(bag: RosBag, stamps_ns: Sequence[int], place: PlaceOfImu) -> tuple[UpSample, ...]:
    """Find up in the depth camera's axes, at frames where an accelerometer measures gravity alone.

    The first IMU topic with known extrinsics and at least one such frame is used; () if there is none.

    Args:
        bag: the bag.
        stamps_ns: stamps of the depth frames, ascending, nanoseconds.
        place: returns `T_depth_imu` (4, 4) of an IMU topic; None if the bag does not have it.
    """
    for topic in bag.topics:
        first = bag.first(topic) if topic.type == IMU else None
        # -1 means "no measurement", by the definition of the message.
        if first is None or first.linear_acceleration_covariance[0] == -1:
            continue
        T_depth_imu = place(ImageTopic(topic, "", first.header.frame_id.lstrip("/")))
        if T_depth_imu is None:
            continue
        times_ns = np.array([message.stamp_ns for message in topic.messages], np.int64)
        samples = tuple(
            up_at_rest(times_ns, partial(_acceleration, bag, topic), stamps_ns, T_depth_imu[:3, :3])
        )
        if samples:
            return samples
    return ()


def _acceleration(bag: RosBag, topic: BagTopic, index: int) -> tuple[float, float, float]:
    said = bag.decode(topic, index).linear_acceleration
    return said.x, said.y, said.z
