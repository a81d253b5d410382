"""Messages of ROS bags of any kind: where they lie, when they were made, and what they say."""

import struct
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any, Literal

from kinectbench.ingest.images import DamagedImageError

Encoding = Literal["ros1", "cdr"]
# Chunks that were read last are kept up to this many bytes, and always one.
CACHED_BYTES = 96 << 20
TF_MESSAGE, OLD_TF_MESSAGE = "tf2_msgs/TFMessage", "tf/tfMessage"
# rosbags' store of ROS 1 types lacks these.
TF_DEFINITION = "geometry_msgs/TransformStamped[] transforms\n"
# Types that do not begin with a std_msgs/Header.
HEADERLESS = frozenset(
    {TF_MESSAGE, OLD_TF_MESSAGE, "geometry_msgs/Transform", "std_msgs/Float32", "diagnostic_msgs/KeyValue"}
)


@dataclass(frozen=True, slots=True)
class MessagePlace:
    """Where a message lies.

    Attributes:
        stamp_ns: stamp of its header, or the time it was recorded where the header has none.
        chunk: position of the chunk's record in the file; -1: the message lies in the file as it is.
        offset: of the message in the unpacked chunk, or in the file.
        size: in bytes.
        file: which of a bag's files, counted from 0.
    """

    stamp_ns: int
    chunk: int
    offset: int
    size: int
    file: int = 0


@dataclass(frozen=True)
class BagTopic:
    """One topic: its type such as "sensor_msgs/Image", and its messages in the order of their stamps.

    Attributes:
        name: such as "/camera/depth/image_raw".
        type: in ROS 1's spelling, also for ROS 2.
        messages: where they lie, by stamp.
        encoding: how they are serialised.
        definition: the text that the bag gives of its type, where that is not a standard one.
    """

    name: str
    type: str
    messages: tuple[MessagePlace, ...]
    encoding: Encoding = "ros1"
    definition: str = ""


@dataclass(frozen=True)
class RosBag:
    """A bag that was walked through.

    Attributes:
        topics: those of the wanted types that have messages, sorted by name.
        read: gives the serialised message that lies at a place.
        trouble: what is wrong with it and what was saved, or "".
        backwards: how often a message was recorded earlier than the one before it on its topic.
    """

    topics: tuple[BagTopic, ...]
    read: Callable[[MessagePlace], bytes]
    trouble: str = ""
    backwards: int = 0


class BagMessages:
    """Decodes the messages of a bag by the standard definitions, whatever the bag says of its types."""

    def __init__(self, bag: RosBag) -> None:
        """Decode messages of this bag."""
        from rosbags.serde import SerdeError

        self._errors = (SerdeError, ValueError, struct.error, LookupError, OverflowError)
        self._read = bag.read
        own = tuple(sorted({(t.type, t.definition) for t in bag.topics if t.definition}))
        self._decode = {"ros1": _ros1_decoder(own), "cdr": _ros2_decoder()}

    def decode(self, topic: BagTopic, index: int) -> Any:
        """The index-th message of a topic.

        Raises:
            DamagedImageError: it does not decode as the topic's type.
        """
        data = self._read(topic.messages[index])
        try:
            return self._decode[topic.encoding](data, long_type(topic.type))
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


@cache
def _ros1_decoder(own: tuple[tuple[str, str], ...]) -> Callable[[bytes, str], Any]:
    """Decodes ROS 1's types, those of tf, and (type, definition) pairs of a bag's own."""
    from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    for name, definition in ((TF_MESSAGE, TF_DEFINITION), (OLD_TF_MESSAGE, TF_DEFINITION), *own):
        try:
            types = get_types_from_msg(definition, long_type(name))
            store.register({key: value for key, value in types.items() if key not in store.fielddefs})
        except TypesysError:  # messages of a type whose definition is damaged do not decode
            continue
    decode: Callable[[bytes, str], Any] = store.deserialize_ros1
    return decode


@cache
def _ros2_decoder() -> Callable[[bytes, str], Any]:
    """Decodes ROS 2's types."""
    from rosbags.typesys import Stores, get_typestore

    decode: Callable[[bytes, str], Any] = get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr
    return decode


def long_type(name: str) -> str:
    """A type in ROS 2's spelling: "sensor_msgs/msg/Image"."""
    return name if "/msg/" in name else name.replace("/", "/msg/")


def short_type(name: str) -> str:
    """A type in ROS 1's spelling: "sensor_msgs/Image"."""
    return name.replace("/msg/", "/")


def header_stamp_ns(start: bytes, type_: str, encoding: Encoding) -> int:
    """The stamp of the Header that a message begins with, nanoseconds; 0 if it has none or is too short.

    Args:
        start: the first 16 bytes at least.
        type_: in ROS 1's spelling.
        encoding: "ros1": sequence number, seconds, nanoseconds; "cdr": four bytes that tell the byte order,
            seconds, nanoseconds.
    """
    if type_ in HEADERLESS or len(start) < 12:
        return 0
    if encoding == "ros1":
        _, seconds, nanoseconds = struct.unpack_from("<III", start)
    else:
        seconds, nanoseconds = struct.unpack_from("<iI" if start[1] & 1 else ">iI", start, 4)
    return int(seconds) * 10**9 + int(nanoseconds)


def joined_topics(
    found: Iterable[tuple[str, str, Encoding, str, list[MessagePlace]]],
) -> tuple[tuple[BagTopic, ...], int]:
    """Topics from (name, type, encoding, definition, messages in the order of recording) of each connection.

    Returns:
        The topics, connections that share a name and a type joined; and how often the stamps of a
        connection go back.
    """
    joined: dict[tuple[str, str, Encoding, str], list[MessagePlace]] = {}
    backwards = 0
    for name, type_, encoding, definition, messages in found:
        stamps = [place.stamp_ns for place in messages]
        backwards += sum(after < before for before, after in pairwise(stamps))
        joined.setdefault((name, type_, encoding, definition), []).extend(messages)
    topics = (
        BagTopic(name, type_, tuple(sorted(messages, key=lambda m: m.stamp_ns)), encoding, definition)
        for (name, type_, encoding, definition), messages in sorted(joined.items())
    )
    return tuple(topics), backwards


class ChunkCache:
    """Keeps the chunks that were unpacked last."""

    def __init__(self, unpack: Callable[[int], bytes]) -> None:
        """Unpack with a function from a chunk's position to its bytes."""
        self._unpack = unpack
        self._chunks: dict[int, bytes] = {}

    def keep(self, position: int, data: bytes) -> None:
        """Keep a chunk that was unpacked already, as long as there is room: the first are read first."""
        if sum(map(len, self._chunks.values())) + len(data) <= CACHED_BYTES:
            self._chunks[position] = data

    def __call__(self, position: int) -> bytes:
        """The unpacked chunk at a position."""
        if position not in self._chunks:
            data = self._unpack(position)
            while self._chunks and sum(map(len, self._chunks.values())) + len(data) > CACHED_BYTES:
                del self._chunks[next(iter(self._chunks))]
            self._chunks[position] = data
        return self._chunks[position]
