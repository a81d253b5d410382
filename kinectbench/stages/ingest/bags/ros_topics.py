"""Choose the depth and colour topics of a ROS bag by type, content and name; intrinsics from CameraInfo."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

from kinectbench.core import RecordingError
from kinectbench.stages.ingest.bags.message_decoding import (
    OLD_TF_MESSAGE,
    TF_MESSAGE,
    BagTopic,
    Message,
    RosBag,
)
from kinectbench.stages.ingest.bags.ros_images import (
    FLOAT_DEPTH,
    color_encoding,
    depth_encoding,
    is_compressed,
)
from kinectbench.stages.ingest.intrinsics import Intrinsics

IMAGE, COMPRESSED_IMAGE = "sensor_msgs/Image", "sensor_msgs/CompressedImage"
CAMERA_INFO = "sensor_msgs/CameraInfo"
POSE, ODOMETRY = "geometry_msgs/PoseStamped", "nav_msgs/Odometry"
TF = frozenset({TF_MESSAGE, OLD_TF_MESSAGE})
IMU = "sensor_msgs/Imu"
WANTED = TF | {IMAGE, COMPRESSED_IMAGE, CAMERA_INFO, POSE, ODOMETRY, IMU}
INFRARED = re.compile(r"infra|(^|[/_])ir([/_]|$)")
# Names for Brown's model: those of ROS and of librealsense.
BROWN_MODELS = frozenset({"plumb_bob", "rational_polynomial", "Brown Conrady", "brown_conrady"})
NO_MODELS = frozenset({"", "None", "none"})
BROWN_LENGTHS = frozenset({4, 5, 8})
# A message of sensor_msgs/CameraInfo; and with the name of its topic.
CameraInfo = Message
NamedInfo = tuple[str, CameraInfo]
# How well a CameraInfo fits images: same size, beside them, same frame_id, and number of shared name parts.
Rank = tuple[bool, bool, bool, int]
# Intrinsics whose difference is below this share of the focal length are equal: 0.6 px for a Kinect.
SAME_SHARE = 1e-3


@dataclass(frozen=True)
class ImageTopic:
    """A topic of images of one encoding.

    Attributes:
        topic: its name and messages.
        encoding: encoding of the first readable message.
        frame_id: frame_id of that message, without the leading slash of tf 1.
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
    """Words that identify the CameraInfo of depth or of colour images.

    Attributes:
        words: words in the names of topics for these images and their CameraInfo.
        advice: what to do if another CameraInfo is the right one, for a warning; {second} is replaced by its
            values.
    """

    words: tuple[str, ...]
    advice: str


DEPTH_KIND = ImageKind(("depth",), "put `camera: {{{second}}}` into benchmark.yaml")
COLOR_KIND = ImageKind(
    ("rgb", "color", "colour"), "colour lies beside its surface: leave the topic of the first out of the bag"
)


def image_topics(bag: RosBag, encoding_of: Callable[[Message], str | None]) -> list[ImageTopic]:
    """Return image topics whose first readable message has an encoding by `encoding_of`, not None."""
    topics = []
    for topic in bag.topics:
        message = bag.first(topic) if topic.type in (IMAGE, COMPRESSED_IMAGE) else None
        encoding = None if message is None else encoding_of(message)
        if message is not None and encoding is not None:
            topics.append(ImageTopic(topic, encoding, message.header.frame_id.lstrip("/")))
    return topics


def every_image(bag: RosBag) -> list[ImageTopic]:
    """Return the image topics that contain a readable message, with any encoding."""
    return image_topics(bag, lambda m: m.format if is_compressed(m) else m.encoding)


def choose_depth(bag: RosBag, named: str | None = None) -> tuple[ImageTopic, list[str]]:
    """Choose the depth topic; return it, and a warning if there was a choice.

    These criteria decide, the most important first: "depth" in the name, a name that says registered, integer
    values, no compression, and the number of images. A topic whose name says infrared and not depth is left
    out.

    Args:
        bag: the bag to search.
        named: the topic that the settings name; None if they name none.

    Raises:
        RecordingError: no topic contains depth, or the named topic does not.
    """
    topics = image_topics(bag, depth_encoding)
    if named is not None:
        return _named(bag, "depth_topic", named, topics), []
    # Infrared images have 16 bits, too.
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
    """Choose the colour topic; return the topic (None if there is none), and warnings.

    These criteria decide, the most important first: a name that says neither infrared nor depth, a name that
    says colour, the same camera as the depth topic's, colours instead of grey, no compression, and the number
    of images.

    Args:
        bag: the bag to search.
        depth: the depth topic; in a bag with two cameras, colour is of the same camera.
        named: the topic that the settings name; None if they name none.

    Raises:
        RecordingError: the named topic contains no colour.
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
    """Whether a depth topic's name states that depth is registered to colour."""
    return "registered" in depth.name.lower() or "aligned" in depth.name.lower()


def _named(bag: RosBag, key: str, named: str, topics: list[ImageTopic]) -> ImageTopic:
    """Return the topic called `named` from `topics`; without it, raise an error about the setting `key`."""
    for topic in topics:
        if topic.name == named:
            return topic
    names = ", ".join(topic.name for topic in topics) or "no topic"
    what = "holds no such images" if any(t.name == named for t in bag.topics) else "is not in the bag"
    raise RecordingError(
        f"{bag.path}: `{key}: {named}` {what}; those that fit are: {names}", what="bad-topic"
    )


def _first_folder(image: ImageTopic) -> str:
    """Return the first part of a topic's name, by which drivers name the camera."""
    return image.name.strip("/").split("/")[0]


def _choice(bag: RosBag, what: str, best: ImageTopic, topics: list[ImageTopic]) -> list[str]:
    if len(topics) == 1:
        return []
    others = ", ".join(topic.name for topic in topics if topic is not best)
    return [f"{bag.path}: {what} is read from {best.name}, not from {others}"]


def values_of(info: CameraInfo, name: str) -> tuple[float, ...]:
    """Return the numbers of a CameraInfo field K, D or P, which ROS 2 spells k, d and p."""
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
    """Choose the CameraInfo message that describes the images of a topic.

    A message is a candidate if it has the images' frame_id, if its topic is in their namespace (where
    image_transport puts it), or if both topics' names start with the same parts, one of which contains a word
    of `kind`. Of the candidates, these criteria decide, the most important first: the images' size, their
    namespace, their frame_id, and the number of common parts. The CameraInfo of `pixels_of`, if it has the
    images' size, is taken instead in two cases: if there is no candidate; or if the best candidate has other
    values and the images' name says that they are registered.

    Args:
        image: the topic of the images.
        kind: the kind of the images.
        size_px: width and height of the images, pixels.
        infos: every CameraInfo of the bag with the name of its topic.
        images: every topic of images; a CameraInfo in the namespace of another topic belongs to that topic,
            so it contradicts nothing.
        pixels_of: the topic to which `image` is registered, by name or frame_id; None if there is none.

    Returns:
        The message (None if there is none), and a warning if another CameraInfo contradicts it, else "".
    """
    usable = [(name, info) for name, info in infos if values_of(info, "K")[0] > 0]  # 0 means no calibration
    ranked = []
    for name, info in usable:
        shared = _shared_folders(name, image.name)
        same_frame = bool(image.frame_id) and info.header.frame_id.lstrip("/") == image.frame_id
        beside = _is_beside(name, image)
        if same_frame or beside or any(word in folder.lower() for folder in shared for word in kind.words):
            rank = ((info.width, info.height) == size_px, beside, same_frame, len(shared))
            ranked.append((rank, (name, info)))
    ranked.sort(key=lambda entry: entry[0], reverse=True)
    # CameraInfo that rank as high except by name, or have the size and frame_id; and that of `pixels_of`.
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
    """Whether two CameraInfo, by their ranks as candidates, both have the images' size and frame_id."""
    return rank[0] and best[0] and rank[2] and best[2]


def _is_beside(info: str, image: ImageTopic) -> bool:
    """Whether a CameraInfo is in the namespace of an image topic, whose name may end in "/compressed"."""
    folder, _, last = image.name.rpartition("/")
    if image.topic.type == COMPRESSED_IMAGE and last.startswith("compressed"):
        folder = folder.rpartition("/")[0]
    return info.rpartition("/")[0] == folder


def _differ(first: NamedInfo, second: NamedInfo, image: ImageTopic) -> bool:
    """Whether two CameraInfo give the images of a topic different intrinsics, beyond rounding."""
    a, b = (intrinsics_of(info, image) for _, info in (first, second))
    pairs = ((a.fx, b.fx), (a.fy, b.fy), (a.cx, b.cx), (a.cy, b.cy))
    return any(abs((x or 0.0) - (y or 0.0)) > SAME_SHARE * (a.fx or 1.0) for x, y in pairs)


def _contradicted(taken: NamedInfo, other: NamedInfo, image: ImageTopic, advice: str) -> str:
    """Return a warning that two CameraInfo differ, with their values, and what to do if `other` is right."""
    first, second = (_in_words(info, image) for _, info in (taken, other))
    return (
        f"{image.name}: {taken[0]} ({first}) and {other[0]} ({second}) contradict each other; the first is "
        f"taken; if the second is right, {advice.format(second=second)}"
    )


def _in_words(info: CameraInfo, image: ImageTopic) -> str:
    intrinsics = intrinsics_of(info, image)
    return ", ".join(f"{name}: {getattr(intrinsics, name):g}" for name in ("fx", "fy", "cx", "cy"))


def intrinsics_of(info: CameraInfo | None, image: ImageTopic) -> Intrinsics:
    """Make intrinsics from K, or for rectified images from the left 3x3 of P (see sensor_msgs/CameraInfo)."""
    if info is None:
        return Intrinsics()
    k, p = values_of(info, "K"), values_of(info, "P")
    if _is_rectified(image) and p[0] > 0:
        k = (*p[0:3], *p[4:7], *p[8:11])
    return Intrinsics(width=info.width, height=info.height, fx=k[0], fy=k[4], cx=k[2], cy=k[5])


def distortion_of(path: Path, info: CameraInfo | None, image: ImageTopic) -> tuple[float, ...]:
    """Return the coefficients of Brown's distortion model in OpenCV's order; empty if undistorted.

    Raises:
        RecordingError: the distortion model is not Brown's, or has not 4, 5 or 8 coefficients.
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
    """Whether a topic's name states that images are rectified, as image_proc names them."""
    return any("rect" in re.split(r"[_/]", part) for part in image.name.lower().split("/"))


def _shared_folders(first: str, second: str) -> list[str]:
    both = zip(first.split("/")[:-1], second.split("/"), strict=False)
    return [a for a, _ in takewhile(lambda pair: pair[0] == pair[1], both)]
