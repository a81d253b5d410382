"""Which topics of a ROS bag hold depth, colour, intrinsics and poses: by type, content and name."""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinectbench.errors import RecordingError
from kinectbench.ingest.ros_images import FLOAT_DEPTH, color_encoding, depth_encoding
from kinectbench.ingest.ros_messages import OLD_TF_MESSAGE, TF_MESSAGE, BagMessages, BagTopic

IMAGE, COMPRESSED_IMAGE = "sensor_msgs/Image", "sensor_msgs/CompressedImage"
CAMERA_INFO = "sensor_msgs/CameraInfo"
POSE, ODOMETRY = "geometry_msgs/PoseStamped", "nav_msgs/Odometry"
TF = frozenset({TF_MESSAGE, OLD_TF_MESSAGE})
WANTED = TF | {IMAGE, COMPRESSED_IMAGE, CAMERA_INFO, POSE, ODOMETRY}
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
    path: Path, topics: tuple[BagTopic, ...], messages: BagMessages, named: str | None = None
) -> tuple[ImageTopic, list[str]]:
    """The depth topic: named so, registered, integer, raw, the most images; a warning if there was a choice.

    Args:
        path: the bag, for messages.
        topics: of the bag.
        messages: of the bag.
        named: the topic that the settings name.

    Raises:
        RecordingError: no topic holds depth, or the one that is named does not.
    """
    found = image_topics(topics, messages, depth_encoding)
    if named is not None:
        return _named(path, "depth_topic", named, found, topics), []
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
        found,
        key=lambda t: (
            "depth" in t.name.lower(),
            is_named_registered(t),
            t.encoding != FLOAT_DEPTH,
            not t.compressed,
            len(t.topic.messages),
        ),
    )
    return best, _choice(path, "depth", best, found)


def choose_color(
    path: Path,
    topics: tuple[BagTopic, ...],
    messages: BagMessages,
    depth: ImageTopic,
    named: str | None = None,
) -> tuple[ImageTopic | None, list[str]]:
    """The colour topic: not infrared, named so, of the depth's camera, with colours, raw, most images.

    Args:
        path: the bag, for messages.
        topics: of the bag.
        messages: of the bag.
        depth: the depth topic; where two cameras are in a bag, colour is of the same one.
        named: the topic that the settings name.

    Returns:
        The topic or None; and warnings.

    Raises:
        RecordingError: the topic that is named holds no colour.
    """
    found = image_topics(topics, messages, color_encoding)
    if named is not None:
        return _named(path, "color_topic", named, found, topics), []
    if not found:
        return None, [f"{path}: no topic holds colour images that can be read; there will be no colour"]
    best = max(
        found,
        key=lambda t: (
            not INFRARED.search(t.name.lower()) and "depth" not in t.name.lower(),
            any(word in t.name.lower() for word in ("rgb", "color", "colour")),
            _first_folder(t) == _first_folder(depth),
            t.encoding != "mono8",
            not t.compressed,
            len(t.topic.messages),
        ),
    )
    return best, _choice(path, "colour", best, found)


def is_named_registered(depth: ImageTopic) -> bool:
    """Whether a depth topic's name says that its pixels lie on those of colour."""
    return "registered" in depth.name.lower() or "aligned" in depth.name.lower()


def _named(
    path: Path, key: str, named: str, found: list[ImageTopic], topics: tuple[BagTopic, ...]
) -> ImageTopic:
    """The image topic of that name among those that fit."""
    for topic in found:
        if topic.name == named:
            return topic
    names = ", ".join(topic.name for topic in found) or "no topic"
    what = "holds no such images" if any(t.name == named for t in topics) else "is not in the bag"
    raise RecordingError(f"{path}: `{key}: {named}` {what}; those that fit are: {names}")


def _first_folder(image: ImageTopic) -> str:
    """The first part of a topic's name, by which drivers tell cameras apart."""
    return image.name.strip("/").split("/")[0]


def _any_encoding(message: Any, *, compressed: bool) -> str:
    encoding: str = message.format if compressed else message.encoding
    return encoding


def _choice(path: Path, what: str, best: ImageTopic, found: list[ImageTopic]) -> list[str]:
    if len(found) == 1:
        return []
    others = ", ".join(topic.name for topic in found if topic is not best)
    return [f"{path}: {what} is read from {best.name}, not from {others}"]
