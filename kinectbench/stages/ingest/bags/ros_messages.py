"""Messages of ROS bags of any kind: position, time and content.

rosbags makes code of a message's definition, into which it unrolls arrays of a fixed length and the messages
in them: a few bytes of a definition may make any amount of it. So it is compiled only within bounds.
"""

from collections.abc import Iterator, Mapping
from itertools import islice
from typing import TYPE_CHECKING, Any

from kinectbench.core.untrusted import HEAD_BYTES

if TYPE_CHECKING:
    from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
    from rosbags.interfaces import Typestore
    from rosbags.interfaces.typing import Typesdict
import bz2
import struct
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, cached_property
from io import BytesIO
from pathlib import Path
from sqlite3 import Blob
from typing import BinaryIO, Literal, NamedTuple

from kinectbench.core.untrusted import UNPACKED_BYTES
from kinectbench.stages.ingest.images import DamagedImageError

# A decoded message: it has the attributes that its type defines, as rosbags makes its class.
Message = Any
Encoding = Literal["ros1", "cdr"]
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
# The longest name of a topic or type, and its description in a bag: mostly its definition.
LONGEST_NAME, DEFINITION_BYTES = 1000, 1 << 20
# Enough of a message to hold its Header's sequence number and stamp.
PEEK_BYTES = 16
# In as many bytes a message that is compressed begins: a block of zstd and its head. How chunks are unpacked.
PACKED_HEAD_BYTES, PART_BYTES = 256 << 10, 4 << 20
# Messages of a topic that are tried for one that decodes, before it is none of images.
FIRST_TRIED = 1000
TF_MESSAGE, OLD_TF_MESSAGE = "tf2_msgs/TFMessage", "tf/tfMessage"
# rosbags' store of ROS 1 types lacks these.
TF_DEFINITION = "geometry_msgs/TransformStamped[] transforms\n"
# Types that do not begin with a std_msgs/Header.
HEADERLESS = frozenset(
    {TF_MESSAGE, OLD_TF_MESSAGE, "geometry_msgs/Transform", "std_msgs/Float32", "diagnostic_msgs/KeyValue"}
)
# Numbers of a fixed array: a covariance has 36; fields in all once arrays are unrolled, and
# messages in each other: stream_info of librealsense has 47 and 3.
MOST_IN_ARRAY, MOST_FIELDS, MOST_DEPTH = 64, 1000, 8


class DamagedRecordError(Exception):
    """A record of a bag that is incomplete, invalid or larger than its file."""


@dataclass(frozen=True, slots=True)
class MessagePlace:
    """The position of a message.

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


class BagTopic(NamedTuple):
    """One topic, or a connection of it: the bag's description of a series of messages.

    Attributes:
        name: such as "/camera/depth/image_raw".
        type: such as "sensor_msgs/Image"; in ROS 1's spelling, also for ROS 2.
        encoding: how they are serialised.
        definition: the text that the bag gives of its type, where that is not a standard one.
        messages: where they lie, by stamp; of a connection they are not known yet.
    """

    name: str
    type: str
    encoding: Encoding = "ros1"
    definition: str = ""
    messages: tuple[MessagePlace, ...] = ()


@dataclass(frozen=True)
class RosBag:
    """A bag that was walked through; its messages are decoded by the standard definitions of their types.

    Attributes:
        path: the bag, for messages.
        topics: those of the wanted types that have messages, sorted by name.
        read: gives the serialised message that lies at a place.
        trouble: its faults and the part that was saved, or "".
    """

    path: Path
    topics: tuple[BagTopic, ...]
    read: Callable[[MessagePlace], bytes]
    trouble: str = ""

    @cached_property
    def _decoders(self) -> dict[Encoding, Callable[[bytes, str], Message]]:
        own = {t.type: t.definition for t in reversed(self.topics) if t.definition}
        return {"ros1": _ros1_decoder(tuple(sorted(own.items()))), "cdr": _ros2_decoder()}

    def decode(self, topic: BagTopic, index: int) -> Message:
        """The index-th message of a topic.

        Raises:
            DamagedImageError: it does not decode as the topic's type.
        """
        from rosbags.serde import SerdeError

        data = self.read(topic.messages[index])
        try:
            return self._decoders[topic.encoding](data, long_type(topic.type))
        except (SerdeError, ValueError, struct.error, LookupError, OverflowError, RecursionError) as error:
            raise DamagedImageError(f"{topic.name}, message {index}: cannot be decoded ({error})") from error

    def whole(self, topic: BagTopic, most: int | None = None) -> Iterator[Message]:
        """Every message of a topic that decodes; `most` messages are tried, or all."""
        for index in range(len(topic.messages[:most])):
            with suppress(DamagedImageError):
                yield self.decode(topic, index)

    def first(self, topic: BagTopic) -> Message | None:
        """The first message that decodes, or None if none of the first thousand does."""
        return next(self.whole(topic, FIRST_TRIED), None)


@cache
def _ros1_decoder(own: tuple[tuple[str, str], ...]) -> Callable[[bytes, str], Message]:
    """A decoder of ROS 1's types, those of tf, and a bag's own (type, definition) pairs."""
    from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    for name in (TF_MESSAGE, OLD_TF_MESSAGE):
        store.register(get_types_from_msg(TF_DEFINITION, long_type(name)))
    for name, definition in own:
        # Messages of a type whose definition is damaged, or more than is compiled, do not decode.
        with suppress(ValueError, TypesysError):
            store.register(known_types(long_type(name), definition, store))
    decode: Callable[[bytes, str], Message] = store.deserialize_ros1
    return decode


@cache
def _ros2_decoder() -> Callable[[bytes, str], Message]:
    """Decodes ROS 2's types."""
    from rosbags.typesys import Stores, get_typestore

    decode: Callable[[bytes, str], Message] = get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr
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


def by_stamp(places: Iterable[MessagePlace]) -> tuple[MessagePlace, ...]:
    """Messages sorted by stamp; equal stamps keep their order."""
    return tuple(sorted(places, key=lambda place: place.stamp_ns))


@dataclass
class FoundMessages:
    """The messages of the wanted types that a walk through a bag's file meets, by number of a connection."""

    types: frozenset[str]
    connections: dict[int, BagTopic] = field(default_factory=dict)
    places: dict[int, list[MessagePlace]] = field(default_factory=dict)

    def take(
        self,
        connection: int,
        file: BinaryIO | Blob,
        recorded_ns: int,
        place: tuple[int, int, int],
        *,
        whole: bool = False,
    ) -> None:
        """Note a message, unless its connection is of another type.

        Args:
            connection: the number of its connection.
            file: is at the beginning of the message.
            recorded_ns: when it was recorded, nanoseconds.
            place: chunk, offset and size, as in `MessagePlace`.
            whole: read all of it, to see whether all is there, and not only its Header.

        Raises:
            DamagedRecordError: it says that it is larger than a message can be.
        """
        known = self.connections.get(connection)
        # The connection of a message can be in a chunk that is lost, and again at the end.
        if known is not None and known.type not in self.types:
            return
        size = place[2]
        if size > UNPACKED_BYTES:
            raise DamagedRecordError(f"a message of {size} bytes")
        start = file.read(size if whole else min(PEEK_BYTES, size))
        if start.startswith(ZSTD_MAGIC):
            start = _start_of_packed(start + file.read(max(0, min(PACKED_HEAD_BYTES, size) - len(start))))
        sort = known or BagTopic("", "")
        stamp_ns = header_stamp_ns(start, sort.type, sort.encoding) or recorded_ns
        self.places.setdefault(connection, []).append(MessagePlace(stamp_ns, *place))

    def topics(self) -> tuple[BagTopic, ...]:
        """The topics that have messages, sorted; connections that share a name and a type are joined."""
        joined: dict[BagTopic, list[MessagePlace]] = {}
        for number, places in self.places.items():
            connection = self.connections.get(number)
            if connection is not None and connection.type in self.types:
                joined.setdefault(connection, []).extend(places)
        return tuple(key._replace(messages=by_stamp(joined[key])) for key in sorted(joined))


def unpacked_chunk(compression: str, data: bytes, size: int) -> bytes:
    """The bytes of a chunk, limited to the size in its header.

    Args:
        compression: "bz2", "lz4" or "zstd".
        data: the compressed bytes.
        size: of the chunk when it is unpacked, as its header says.

    Raises:
        DamagedRecordError: it is damaged, larger than a chunk can be, or compressed in another way.
    """
    import zstandard

    if size > UNPACKED_BYTES:
        raise DamagedRecordError
    try:
        if compression == "bz2":
            return _unpacked(bz2.BZ2Decompressor(), data, size)
        if compression == "lz4":
            from lz4.frame import LZ4FrameDecompressor

            return _unpacked(LZ4FrameDecompressor(), data, size)
        if compression == "zstd":
            # A stream also reads frames that do not say their size.
            return zstandard.ZstdDecompressor().stream_reader(data).read(size)
    except (zstandard.ZstdError, OSError, RuntimeError, ValueError, EOFError, MemoryError) as error:
        raise DamagedRecordError from error
    raise DamagedRecordError


def _unpacked(unpacker: "bz2.BZ2Decompressor | LZ4FrameDecompressor", data: bytes, size: int) -> bytes:
    """Decompress at most `size` bytes by bz2 or lz4, with one copy in memory."""
    target = BytesIO()
    part = unpacker.decompress(data, max_length=min(max(size, 1), PART_BYTES))
    while part:
        target.write(part)
        left = size - target.tell()
        if left <= 0 or unpacker.eof:
            break
        part = unpacker.decompress(b"", max_length=min(left, PART_BYTES))
    return target.getvalue()


def _start_of_packed(head: bytes) -> bytes:
    """The first bytes of a message, of the first that it is compressed to; empty if it is damaged."""
    import zstandard

    with suppress(zstandard.ZstdError):
        return zstandard.ZstdDecompressor().stream_reader(head).read(PEEK_BYTES)
    return b""


def unpacked_message(data: bytes) -> bytes:
    """A message as it was serialised; empty, which no message is, if it is damaged.

    `ros2 bag record --compression-mode message` compresses messages one by one with zstd.
    """
    if not data.startswith(ZSTD_MAGIC):
        return data
    import zstandard

    try:
        size = zstandard.frame_content_size(data)
        if not 0 <= size <= UNPACKED_BYTES:
            return b""
        return bytes(zstandard.ZstdDecompressor().decompress(data, max_output_size=size))
    except zstandard.ZstdError:
        return b""


def known_types(name: str, definition: str, store: "Typestore") -> "Typesdict":
    """The types of a definition that a store lacks, for it to register.

    Args:
        name: of the type, in ROS 2's spelling.
        definition: its text, with those of the types in it.
        store: of the types that are known.

    Raises:
        ValueError: it is damaged, or more than is compiled; the message says what.
    """
    from rosbags.interfaces import Nodetype
    from rosbags.typesys import TypesysError, get_types_from_msg

    if len(definition) > HEAD_BYTES:
        raise ValueError(f"a definition of {len(definition)} characters")
    try:
        types = get_types_from_msg(definition, name)
    except (TypesysError, RecursionError) as error:
        raise ValueError(f"is no definition ({type(error).__name__})") from error
    lacking = {key: value for key, value in types.items() if key not in store.fielddefs}
    fields = {key: value[1] for key, value in (store.fielddefs | lacking).items()}
    met: set[str] = set()
    if sum(1 for _ in islice(_unrolled(name, fields, met, 0), MOST_FIELDS + 1)) > MOST_FIELDS:
        raise ValueError(f"more than {MOST_FIELDS} fields")
    for own in lacking.keys() & met:
        # Each message of such a list may have no bytes, so that a list without end takes none.
        if any(kind == Nodetype.SEQUENCE and node[0][0] == Nodetype.NAME for _, (kind, node) in fields[own]):
            raise ValueError(f"{own} holds a list of messages")
    return {key: value for key, value in lacking.items() if key in met}


def _unrolled(name: str, fields: Mapping[str, Any], met: set[str], depth: int) -> Iterator[None]:
    """Once for each field of a type, and of those in it, with arrays unrolled; notes the types it meets."""
    from rosbags.interfaces import Nodetype

    if depth > MOST_DEPTH or name not in fields:
        raise ValueError(f"{name} is nested too deep, or not defined")
    met.add(name)
    for _, (kind, node) in fields[name]:
        inner, count = node if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else ((kind, node), 1)
        if kind == Nodetype.ARRAY and count > MOST_IN_ARRAY:
            raise ValueError(f"an array of {count}")
        for _ in range(count if kind == Nodetype.ARRAY else 1):
            yield
            if inner[0] == Nodetype.NAME:
                yield from _unrolled(inner[1], fields, met, depth + 1)
