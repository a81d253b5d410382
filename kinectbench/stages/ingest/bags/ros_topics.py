"""The depth and colour topics of a ROS bag, by type, content and name; intrinsics from CameraInfo."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

from kinectbench.core.errors import RecordingError
from kinectbench.stages.ingest.bags.ros_images import (
    FLOAT_DEPTH,
    color_encoding,
    depth_encoding,
    is_compressed,
)
from kinectbench.stages.ingest.bags.ros_messages import OLD_TF_MESSAGE, TF_MESSAGE, BagTopic, Message, RosBag
from kinectbench.stages.ingest.intrinsics import Intrinsics

IMAGE, COMPRESSED_IMAGE = "sensor_msgs/Image", "sensor_msgs/CompressedImage"
CAMERA_INFO = "sensor_msgs/CameraInfo"
POSE, ODOMETRY = "geometry_msgs/PoseStamped", "nav_msgs/Odometry"
TF = frozenset({TF_MESSAGE, OLD_TF_MESSAGE})
IMU = "sensor_msgs/Imu"
WANTED = TF | {IMAGE, COMPRESSED_IMAGE, CAMERA_INFO, POSE, ODOMETRY, IMU}
INFRARED = re.compile(r"infra|(^|[/_])ir([/_]|$)")
# realsense's names of Brown's model, and of none, stand beside those of ROS.
BROWN_MODELS = frozenset({"plumb_bob", "rational_polynomial", "Brown Conrady", "brown_conrady"})
NO_MODELS = frozenset({"", "None", "none"})
BROWN_LENGTHS = frozenset({4, 5, 8})
# A message of sensor_msgs/CameraInfo, and with its topic's name.
CameraInfo = Message
NamedInfo = tuple[str, CameraInfo]
# How well a CameraInfo fits images: of their size, beside them, of their frame, folders that both lie in.
Rank = tuple[bool, bool, bool, int]
# Intrinsics that differ by less than this share of the focal length are the same: .6 px of a Kinect's.
SAME_SHARE = 1e-3


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


@dataclass(frozen=True)
class ImageKind:
    """The names that identify the CameraInfo of one kind of images.

    Attributes:
        words: that the name of a folder holds in which such images and their CameraInfo lie.
        advice: what to do if another CameraInfo is right; {second} is its values.
    """

    words: tuple[str, ...]
    advice: str


DEPTH_KIND = ImageKind(("depth",), "put `camera: {{{second}}}` into benchmark.yaml")
COLOR_KIND = ImageKind(
    ("rgb", "color", "colour"), "colour lies beside its surface: leave the topic of the first out of the bag"
)


def image_topics(bag: RosBag, encoding_of: Callable[[Message], str | None]) -> list[ImageTopic]:
    """The image topics whose first readable message has an encoding by `encoding_of`."""
    topics = []
    for topic in bag.topics:
        message = bag.first(topic) if topic.type in (IMAGE, COMPRESSED_IMAGE) else None
        encoding = None if message is None else encoding_of(message)
        if message is not None and encoding is not None:
            topics.append(ImageTopic(topic, encoding, message.header.frame_id))
    return topics


def every_image(bag: RosBag) -> list[ImageTopic]:
    """The image topics that hold a readable message, of whatever kind."""
    return image_topics(bag, lambda m: m.format if is_compressed(m) else m.encoding)


def choose_depth(bag: RosBag, named: str | None = None) -> tuple[ImageTopic, list[str]]:
    """The depth topic: by name, registered, integer, raw, most images; warns if there was a choice.

    Args:
        bag: where it is looked for.
        named: the topic that the settings name.

    Raises:
        RecordingError: no topic holds depth, or the one that is named does not.
    """
    topics = image_topics(bag, depth_encoding)
    if named is not None:
        return _named(bag, "depth_topic", named, topics), []
    # Infrared images are 16-bit too.
    topics = [t for t in topics if "depth" in t.name.lower() or not INFRARED.search(t.name.lower())]
    if not topics:
        images = [f"{t.name} ({t.encoding})" for t in every_image(bag)]
        raise RecordingError(
            f"{bag.path}: no topic holds depth images (16UC1, mono16, 32FC1 or 16-bit PNG); its image topics "
            f"are: {', '.join(images) or 'none'}",
            what="no-depth",
        )
    best = max(
        topics,
        key=lambda t: (
            "depth" in t.name.lower(),
            is_named_registered(t),
            t.encoding != FLOAT_DEPTH,
            t.topic.type != COMPRESSED_IMAGE,
            len(t.topic.messages),
        ),
    )
    return best, _choice(bag, "depth", best, topics)


def choose_color(
    bag: RosBag, depth: ImageTopic, named: str | None = None
) -> tuple[ImageTopic | None, list[str]]:
    """The colour topic: not infrared, named so, of the depth's camera, with colours, raw, most images.

    Args:
        bag: where it is looked for.
        depth: the depth topic; where two cameras are in a bag, colour is of the same one.
        named: the topic that the settings name.

    Returns:
        The topic or None; and warnings.

    Raises:
        RecordingError: the topic that is named holds no colour.
    """
    topics = image_topics(bag, color_encoding)
    if named is not None:
        return _named(bag, "color_topic", named, topics), []
    if not topics:
        return None, [f"{bag.path}: no topic holds colour images that can be read; there will be no colour"]
    best = max(
        topics,
        key=lambda t: (
            not INFRARED.search(t.name.lower()) and "depth" not in t.name.lower(),
            any(word in t.name.lower() for word in COLOR_KIND.words),
            _first_folder(t) == _first_folder(depth),
            t.encoding != "mono8",
            t.topic.type != COMPRESSED_IMAGE,
            len(t.topic.messages),
        ),
    )
    return best, _choice(bag, "colour", best, topics)


def is_named_registered(depth: ImageTopic) -> bool:
    """Whether a depth topic's name declares depth registered to colour."""
    return "registered" in depth.name.lower() or "aligned" in depth.name.lower()


def _named(bag: RosBag, key: str, named: str, topics: list[ImageTopic]) -> ImageTopic:
    """The image topic of that name among those that fit."""
    for topic in topics:
        if topic.name == named:
            return topic
    names = ", ".join(topic.name for topic in topics) or "no topic"
    what = "holds no such images" if any(t.name == named for t in bag.topics) else "is not in the bag"
    raise RecordingError(
        f"{bag.path}: `{key}: {named}` {what}; those that fit are: {names}", what="bad-topic"
    )


def _first_folder(image: ImageTopic) -> str:
    """The first part of a topic's name, which identifies the camera in drivers."""
    return image.name.strip("/").split("/")[0]


def _choice(bag: RosBag, what: str, best: ImageTopic, topics: list[ImageTopic]) -> list[str]:
    if len(topics) == 1:
        return []
    others = ", ".join(topic.name for topic in topics if topic is not best)
    return [f"{bag.path}: {what} is read from {best.name}, not from {others}"]


def values_of(info: CameraInfo, name: str) -> tuple[float, ...]:
    """The numbers that a CameraInfo holds as K, D or P, which ROS 2 spells k, d and p."""
    values = getattr(info, name, None)
    return tuple(float(v) for v in (getattr(info, name.lower()) if values is None else values))


def choose_camera_info(
    image: ImageTopic,
    kind: ImageKind,
    size_px: tuple[int, int],
    infos: Sequence[NamedInfo],
    images: Sequence[ImageTopic],
    pixels_of: ImageTopic | None = None,
) -> tuple[CameraInfo | None, str]:
    """The CameraInfo of images: of their frame, beside them, or in a folder named for their kind.

    Of several, one of their size comes first, then the one beside them (as image_transport's cameras have
    it), then one of their frame, then the nearest by name. Images that by their name lie on the pixels of
    others are seen by the camera of those: where its CameraInfo says otherwise, it takes precedence.

    Args:
        image: the topic of the images.
        kind: of the images.
        size_px: width and height of the images.
        infos: every CameraInfo of the bag with its topic's name.
        images: every topic of images: a CameraInfo beside another one is that one's, and contradicts nothing.
        pixels_of: the topic of the images on whose pixels `image` lies, by name or by frame; or None.

    Returns:
        The message, or None; and "", or a warning that another one contradicts it.
    """
    usable = [(name, info) for name, info in infos if values_of(info, "K")[0] > 0]  # 0: no calibration
    ranked = []
    for name, info in usable:
        shared = _shared_folders(name, image.name)
        same_frame = bool(image.frame_id) and info.header.frame_id == image.frame_id
        beside = _is_beside(name, image)
        if same_frame or beside or any(word in folder.lower() for folder in shared for word in kind.words):
            rank = ((info.width, info.height) == size_px, beside, same_frame, len(shared))
            ranked.append((rank, (name, info)))
    ranked.sort(key=lambda entry: entry[0], reverse=True)
    # As good as the first except for its name, or of its size and frame; the camera on whose pixels they lie.
    rivals = [
        named
        for rank, named in ranked[1:]
        if rank[:3] == ranked[0][0][:3]
        or (_is_of_one_camera(rank, ranked[0][0]) and not any(_is_beside(named[0], each) for each in images))
    ]
    for name, info in usable:
        if pixels_of and _is_beside(name, pixels_of) and (info.width, info.height) == size_px:
            rivals.insert(0, (name, info))
    if not ranked:
        return (rivals[0][1] if rivals else None), ""
    own = ranked[0][1]
    rival = next((rival for rival in rivals if _differ(own, rival, image)), None)
    if rival is None:
        return own[1], ""
    if pixels_of and is_named_registered(image) and _is_beside(rival[0], pixels_of):
        own, rival = rival, own
    return own[1], _contradicted(own, rival, image, kind.advice)


def _is_of_one_camera(rank: Rank, best: Rank) -> bool:
    """Whether two CameraInfo have the images' size and frame, under any name."""
    return rank[0] and best[0] and rank[2] and best[2]


def _is_beside(info: str, image: ImageTopic) -> bool:
    """Whether a CameraInfo's topic lies beside one of images, whose name may end in how they are packed."""
    folder, _, last = image.name.rpartition("/")
    if image.topic.type == COMPRESSED_IMAGE and last.startswith("compressed"):
        folder = folder.rpartition("/")[0]
    return info.rpartition("/")[0] == folder


def _differ(first: NamedInfo, second: NamedInfo, image: ImageTopic) -> bool:
    """Whether two CameraInfo have different intrinsics for images of one size, beyond rounding."""
    a, b = (intrinsics_of(info, image) for _, info in (first, second))
    pairs = ((a.fx, b.fx), (a.fy, b.fy), (a.cx, b.cx), (a.cy, b.cy))
    return any(abs((x or 0.0) - (y or 0.0)) > SAME_SHARE * (a.fx or 1.0) for x, y in pairs)


def _contradicted(taken: NamedInfo, other: NamedInfo, image: ImageTopic, advice: str) -> str:
    """The warning that two CameraInfo differ, with both values, and what to do about it."""
    first, second = (_in_words(info, image) for _, info in (taken, other))
    return (
        f"{image.name}: {taken[0]} ({first}) and {other[0]} ({second}) contradict each other; the first is "
        f"taken; if the second is right, {advice.format(second=second)}"
    )


def _in_words(info: CameraInfo, image: ImageTopic) -> str:
    intrinsics = intrinsics_of(info, image)
    return ", ".join(f"{name}: {getattr(intrinsics, name):g}" for name in ("fx", "fy", "cx", "cy"))


def intrinsics_of(info: CameraInfo | None, image: ImageTopic) -> Intrinsics:
    """K of the images; of rectified images the left 3x3 of P, as sensor_msgs/CameraInfo defines them."""
    if info is None:
        return Intrinsics()
    k, p = values_of(info, "K"), values_of(info, "P")
    if _is_rectified(image) and p[0] > 0:
        k = (*p[0:3], *p[4:7], *p[8:11])
    return Intrinsics(width=info.width, height=info.height, fx=k[0], fy=k[4], cx=k[2], cy=k[5])


def distortion_of(path: Path, info: CameraInfo | None, image: ImageTopic) -> tuple[float, ...]:
    """Brown's coefficients of images, as OpenCV orders them; empty if they have no distortion.

    Raises:
        RecordingError: they are distorted by a model that is not Brown's.
    """
    if info is None or _is_rectified(image) or info.distortion_model in NO_MODELS:
        return ()
    coefficients = values_of(info, "D")
    if not any(coefficients):
        return ()
    if info.distortion_model not in BROWN_MODELS or len(coefficients) not in BROWN_LENGTHS:
        raise RecordingError(
            f"{path}: {image.name} has the distortion model '{info.distortion_model}' with "
            f"{len(coefficients)} values; only plumb_bob and rational_polynomial can be removed: record "
            "rectified images",
            what="lens",
        )
    return coefficients


def _is_rectified(image: ImageTopic) -> bool:
    """Whether a topic's name declares rectified images, as image_proc names them."""
    return any("rect" in re.split(r"[_/]", part) for part in image.name.lower().split("/"))


def _shared_folders(first: str, second: str) -> list[str]:
    both = zip(first.split("/")[:-1], second.split("/"), strict=False)
    return [a for a, _ in takewhile(lambda pair: pair[0] == pair[1], both)]
