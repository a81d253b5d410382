"""What all ROS bags have in common: topics are chosen, depth is paired with colour, frames are decoded."""

from abc import abstractmethod
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from kinectbench.config import CameraSettings
from kinectbench.errors import RecordingError
from kinectbench.ingest.association import associate
from kinectbench.ingest.images import DamagedImageError, decode_color_bgr, encode_png, image_header
from kinectbench.ingest.intrinsics import scale_warnings
from kinectbench.ingest.recording import ColorCalibration, RawFrame, Recording
from kinectbench.ingest.ros_camera import (
    CameraInfo,
    camera_info,
    choose_camera_info,
    distortion_of,
    intrinsics_of,
    undistortion_of,
)
from kinectbench.ingest.ros_images import FLOAT_DEPTH, FLOAT_SCALE, INTEGER_SCALE, color_of, depth_of
from kinectbench.ingest.ros_messages import BagMessages, MessagePlace, RosBag
from kinectbench.ingest.ros_poses import read_poses
from kinectbench.ingest.ros_topics import (
    CAMERA_INFO,
    WANTED,
    ImageTopic,
    choose_color,
    choose_depth,
    is_named_registered,
)
from kinectbench.ingest.ros_transforms import TransformTree, read_transforms
from kinectbench.ingest.stamps import NS_PER_S, first_by_stamp
from kinectbench.ingest.undistortion import Undistortion

COLOR_WORDS = ("rgb", "color", "colour")
NO_SETTINGS = CameraSettings()


@dataclass(frozen=True, kw_only=True)
class RosRecording(Recording):
    """A ROS bag; integer depth is taken as millimetres, float depth as metres.

    Attributes:
        depth: the depth topic.
        color_topic: the colour topic, or None.
        pairs: for each frame the indices of its depth message and its colour message (or None).
        float_units_per_m: what 1 m is in a 32FC1 image.
        undistortion: how distorted images become pinhole images, or None.
        messages: of the bag.
    """

    wanted: ClassVar[frozenset[str]] = WANTED
    # Types whose definition is taken from the bag.
    own_types: ClassVar[frozenset[str]] = frozenset()
    # Images of one frame_id share their pixels.
    frame_ids_tell: ClassVar[bool] = True

    depth: ImageTopic
    color_topic: ImageTopic | None
    pairs: tuple[tuple[int, int | None], ...]
    float_units_per_m: float
    undistortion: Undistortion | None
    messages: BagMessages

    @classmethod
    @abstractmethod
    def walk(cls, path: Path) -> RosBag:
        """Find the messages of the wanted types.

        Raises:
            RecordingError: nothing in it can be read.
        """

    @classmethod
    def integer_scale(cls, bag: RosBag, messages: BagMessages, depth: ImageTopic) -> float | None:
        """Native units per metre of integer depth, or None if the bag does not say it."""
        return None

    @classmethod
    def color_place(
        cls, bag: RosBag, messages: BagMessages, tree: TransformTree, depth: ImageTopic, color: ImageTopic
    ) -> NDArray[np.float64] | None:
        """`T_color_depth`, where the bag says it."""
        return tree.fixed(color.frame_id.lstrip("/"), depth.frame_id.lstrip("/"))

    @classmethod
    def camera_infos(cls, bag: RosBag, messages: BagMessages) -> list[tuple[str, CameraInfo]]:
        """Every CameraInfo with its topic's name."""
        infos = ((t.name, messages.first(t)) for t in bag.topics if t.type == CAMERA_INFO)
        return [(name, camera_info(message)) for name, message in infos if message is not None]

    @classmethod
    def open(cls, path: Path, settings: CameraSettings | None) -> Self:
        """Walk through the bag, choose the topics, pair depth with colour, and read the poses."""
        named = settings or NO_SETTINGS
        bag = cls.walk(path)
        messages = BagMessages(bag)
        depth, depth_warnings = choose_depth(path, bag.topics, messages, named.depth_topic)
        color, color_warnings = choose_color(path, bag.topics, messages, depth, named.color_topic)
        if not cls.frame_ids_tell:
            depth, color = replace(depth, frame_id=""), color and replace(color, frame_id="")
        size_px = _first_depth_size(path, depth, messages)
        infos = cls.camera_infos(bag, messages)
        info = choose_camera_info(depth, ("depth",), size_px, infos)
        intrinsics = intrinsics_of(info, depth).overridden_by(settings)
        camera = intrinsics.camera(size_px, path)
        tree = read_transforms(bag.topics, messages)
        trajectory, pose_warnings, pose_error = read_poses(
            path, bag.topics, messages, tree, depth, named.pose_topic
        )
        pairs, pair_warnings = _pair(depth, color, named)
        registered, size_warnings = _is_registered(depth, color, size_px, messages)
        scale = intrinsics.depth_scale
        is_float = depth.encoding == FLOAT_DEPTH
        own_scale = None if is_float else cls.integer_scale(bag, messages, depth)
        calibration = None
        if color is not None and not registered:
            T_color_depth = cls.color_place(bag, messages, tree, depth, color)
            calibration = _calibration(path, color, T_color_depth, infos, messages)
        if calibration is not None:
            size_warnings = []
            registered = calibration.lies_on(camera)
        return cls(
            path=path,
            depth=depth,
            color_topic=color,
            pairs=pairs,
            float_units_per_m=scale or 1.0,
            undistortion=undistortion_of(camera, distortion_of(path, info, depth)),
            messages=messages,
            camera=camera,
            depth_scale=FLOAT_SCALE if is_float else scale or own_scale or INTEGER_SCALE,
            color_registered=registered,
            color_calibration=None if registered else calibration,
            given_trajectory=trajectory,
            trajectory_error=pose_error,
            warnings=(
                *([bag.trouble] if bag.trouble else []),
                *depth_warnings,
                *color_warnings,
                *pair_warnings,
                *size_warnings,
                *scale_warnings(path, own_scale, settings),
                *pose_warnings,
            ),
        )

    def __len__(self) -> int:
        return len(self.pairs)

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Stamp of each frame's depth message, nanoseconds."""
        return np.array([self.depth.topic.messages[i].stamp_ns for i, _ in self.pairs], np.int64)

    @property
    def recorded_stamps_ns(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Stamps of depth and of colour in the order of recording."""
        color = () if self.color_topic is None else self.color_topic.topic.messages
        return _in_file_order(self.depth.topic.messages), _in_file_order(color)

    def frame(self, index: int) -> RawFrame:
        """Decode the messages of a frame."""
        depth_index, color_index = self.pairs[index]
        name = _message_name(self.path, self.depth, depth_index)
        message = self.messages.decode(self.depth.topic, depth_index)
        depth, png = depth_of(
            message, name, compressed=self.depth.compressed, float_units_per_m=self.float_units_per_m
        )
        color = self._color(color_index)
        # Frames of another size are left as they are: the checks refuse them.
        if self.undistortion is not None and depth.shape == self._shape:
            depth, png = self.undistortion.depth(depth), None
        stamp_ns = self.depth.topic.messages[depth_index].stamp_ns
        return RawFrame(name, stamp_ns, depth, png, color)

    def _color(self, index: int | None) -> tuple[str, bytes] | None:
        if self.color_topic is None or index is None:
            return None
        name = _message_name(self.path, self.color_topic, index)
        message = self.messages.decode(self.color_topic.topic, index)
        color = color_of(message, name, compressed=self.color_topic.compressed)
        # Colour that is not registered has a camera of its own.
        if self.undistortion is None or not self.color_registered:
            return color
        bgr = decode_color_bgr(color[1], name)
        return (".png", encode_png(self.undistortion.color(bgr))) if bgr.shape[:2] == self._shape else color

    @property
    def _shape(self) -> tuple[int, int]:
        return self.camera.height, self.camera.width


def _message_name(path: Path, image: ImageTopic, index: int) -> str:
    return f"{path}: {image.name}, message {index}"


def _in_file_order(places: tuple[MessagePlace, ...]) -> NDArray[np.int64]:
    def position(place: MessagePlace) -> tuple[int, int, int]:
        return place.file, place.offset if place.chunk < 0 else place.chunk, place.offset

    return np.array([place.stamp_ns for place in sorted(places, key=position)], np.int64)


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
    depth: ImageTopic, color: ImageTopic | None, settings: CameraSettings
) -> tuple[tuple[tuple[int, int | None], ...], list[str]]:
    """Indices of the depth messages with distinct stamps, each with its colour message; and warnings."""
    depth_ns = [place.stamp_ns for place in depth.topic.messages]
    order, repeated = first_by_stamp(depth_ns)
    warnings = [f"{depth.name}: {repeated} messages repeat a stamp and were left out"] if repeated else []
    if color is None:
        return tuple((i, None) for i in order), warnings
    delay_ns = round(settings.color_delay_s * NS_PER_S)
    color_ns = [place.stamp_ns - delay_ns for place in color.topic.messages]
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


def _calibration(
    path: Path,
    color: ImageTopic,
    T_color_depth: NDArray[np.float64] | None,
    infos: list[tuple[str, CameraInfo]],
    messages: BagMessages,
) -> ColorCalibration | None:
    """Camera and place of colour; None if either is not known or does not fit the images."""
    size_px = _first_color_size(color, messages)
    info = choose_camera_info(color, COLOR_WORDS, size_px, infos)
    if T_color_depth is None or info is None:
        return None
    try:
        camera = intrinsics_of(info, color).camera(size_px, path)
        return ColorCalibration(camera, distortion_of(path, info, color), T_color_depth)
    except RecordingError:
        return None
