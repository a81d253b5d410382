"""Which topics of a ROS 1 bag hold depth, colour, intrinsics and poses: by type, content and name."""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinectbench.errors import RecordingError
from kinectbench.ingest.images import DamagedImageError
from kinectbench.ingest.ros_images import FLOAT_DEPTH, color_encoding, depth_encoding
from kinectbench.ingest.rosbag1_chunks import BagTopic, ChunkReader

IMAGE, COMPRESSED_IMAGE = "sensor_msgs/Image", "sensor_msgs/CompressedImage"
CAMERA_INFO = "sensor_msgs/CameraInfo"
POSE, ODOMETRY = "geometry_msgs/PoseStamped", "nav_msgs/Odometry"
WANTED = frozenset({IMAGE, COMPRESSED_IMAGE, CAMERA_INFO, POSE, ODOMETRY})
INFRARED = re.compile(r"infra|(^|[/_])ir([/_]|$)")


@dataclass(frozen=True)
class ImageTopic:
    """A topic of images of one kind.

    Attributes:
        topic: its name and messages.
        encoding: of the first message that can be read.
        frame_id: of that message.
    """

    topic: BagTopic
    encoding: str
    frame_id: str

    @property
    def name(self) -> str:
        """The topic's name."""
        return self.topic.name

    @property
    def compressed(self) -> bool:
        """Whether its messages are CompressedImage."""
        return self.topic.type == COMPRESSED_IMAGE


class BagMessages:
    """Decodes the messages of a bag."""

    def __init__(self, path: Path) -> None:
        """Decode messages of this bag by the standard definitions, whatever the bag says of its types."""
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, get_typestore

        self._errors = (SerdeError, ValueError)
        self._decode: Callable[[bytes, str], Any] = get_typestore(Stores.ROS1_NOETIC).deserialize_ros1
        self._reader = ChunkReader(path)

    def decode(self, topic: BagTopic, index: int) -> Any:
        """The index-th message of a topic.

        Raises:
            DamagedImageError: it does not decode as the topic's type.
        """
        data = self._reader.message(topic.messages[index])
        try:
            return self._decode(data, topic.type.replace("/", "/msg/"))
        except self._errors as error:
            raise DamagedImageError(f"{topic.name}, message {index}: cannot be decoded ({error})") from error

    def first(self, topic: BagTopic) -> Any | None:
        """The first message that decodes, or None."""
        for index in range(len(topic.messages)):
            try:
                return self.decode(topic, index)
            except DamagedImageError:
                continue
        return None


def image_topics(
    topics: Iterable[BagTopic], messages: BagMessages, encoding_of: Callable[..., str | None]
) -> list[ImageTopic]:
    """The image topics whose first readable message has an encoding by `encoding_of`."""
    found = []
    for topic in topics:
        message = messages.first(topic) if topic.type in (IMAGE, COMPRESSED_IMAGE) else None
        if message is not None:
            encoding = encoding_of(message, compressed=topic.type == COMPRESSED_IMAGE)
            if encoding is not None:
                found.append(ImageTopic(topic, encoding, message.header.frame_id))
    return found


def choose_depth(
    path: Path, topics: tuple[BagTopic, ...], messages: BagMessages
) -> tuple[ImageTopic, list[str]]:
    """The depth topic: named so, registered, integer, raw, in this order; a warning if there was a choice.

    Raises:
        RecordingError: no topic holds depth.
    """
    found = image_topics(topics, messages, depth_encoding)
    # Infrared images are 16-bit too.
    found = [t for t in found if "depth" in t.name.lower() or not INFRARED.search(t.name.lower())]
    if not found:
        every = image_topics(topics, messages, _any_encoding)
        images = [f"{t.name} ({t.encoding})" for t in every]
        raise RecordingError(
            f"{path}: no topic holds depth images (16UC1, mono16, 32FC1 or 16-bit PNG); its image topics "
            f"are: {', '.join(images) or 'none'}"
        )
    best = max(
        reversed(found),
        key=lambda t: (
            "depth" in t.name.lower(),
            is_named_registered(t),
            t.encoding != FLOAT_DEPTH,
            not t.compressed,
        ),
    )
    return best, _choice(path, "depth", best, found)


def choose_color(
    path: Path, topics: tuple[BagTopic, ...], messages: BagMessages
) -> tuple[ImageTopic | None, list[str]]:
    """The colour topic: not infrared, named so, with colours, raw, in this order; or None; and warnings."""
    found = image_topics(topics, messages, color_encoding)
    if not found:
        return None, [f"{path}: no topic holds colour images that can be read; there will be no colour"]
    best = max(
        reversed(found),
        key=lambda t: (
            not INFRARED.search(t.name.lower()) and "depth" not in t.name.lower(),
            any(word in t.name.lower() for word in ("rgb", "color", "colour")),
            t.encoding != "mono8",
            not t.compressed,
        ),
    )
    return best, _choice(path, "colour", best, found)


def is_named_registered(depth: ImageTopic) -> bool:
    """Whether a depth topic's name says that its pixels lie on those of colour."""
    return "registered" in depth.name.lower() or "aligned" in depth.name.lower()


def _any_encoding(message: Any, *, compressed: bool) -> str:
    encoding: str = message.format if compressed else message.encoding
    return encoding


def _choice(path: Path, what: str, best: ImageTopic, found: list[ImageTopic]) -> list[str]:
    if len(found) == 1:
        return []
    others = ", ".join(topic.name for topic in found if topic is not best)
    return [f"{path}: {what} is read from {best.name}, not from {others}"]
