"""Find and decode messages of ROS 1 and ROS 2 bags: where each is stored, its stamp and its content.

The package rosbags generates Python code from a message definition, with nested messages and arrays of fixed
length unrolled. A definition of a few bytes could generate any amount of code, so definitions beyond the
limits below are refused.
"""

from collections.abc import Iterator, Mapping
from itertools import islice
from typing import TYPE_CHECKING, Any

from kinectbench.core import HEAD_BYTES

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

from kinectbench.core import UNPACKED_BYTES
from kinectbench.core.trajectory.stamps import LIMIT_NS
from kinectbench.stages.ingest.images import DamagedImageError

# A decoded message: an object of the class that rosbags generates, with the type's fields as attributes.
Message = Any
Encoding = Literal["ros1", "cdr"]
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
# Longest name of a topic or type, and longest description in a bag: mostly its definition.
LONGEST_NAME, DEFINITION_BYTES = 1000, 1 << 20
# Enough bytes of a message to contain the sequence number and stamp of its Header.
PEEK_BYTES = 16
# Bytes in which a compressed message starts: a block of zstd and its header. Bytes per step of unpacking.
PACKED_HEAD_BYTES, PART_BYTES = 256 << 10, 4 << 20
# If this many messages of a topic do not decode, it counts as no topic of images.
FIRST_TRIED = 1000
TF_MESSAGE, OLD_TF_MESSAGE = "tf2_msgs/TFMessage", "tf/tfMessage"
# rosbags' store of ROS 1 types lacks this type.
TF_DEFINITION = "geometry_msgs/TransformStamped[] transforms\n"
# Types that do not start with a std_msgs/Header.
HEADERLESS = frozenset(
    {TF_MESSAGE, OLD_TF_MESSAGE, "geometry_msgs/Transform", "std_msgs/Float32", "std_msgs/String"}
    | {"diagnostic_msgs/KeyValue"}
)
# Limits: numbers in an array of fixed length (a covariance has 36); fields of a type with its arrays
# unrolled, and depth of nested messages (librealsense's stream_info has 47 and 3).
MOST_IN_ARRAY, MOST_FIELDS, MOST_DEPTH = 64, 1000, 8


class DamagedRecordError(Exception):
    """A record of a bag is incomplete, invalid, or larger than the file."""


@dataclass(frozen=True, slots=True)
class MessagePlace:
    """Where a message is stored in a bag, and its stamp.

    Attributes:
        stamp_ns: stamp of its header, nanoseconds; without one, the time of recording.
        chunk: position of the chunk's record in the file; -1: the message is not in a compressed chunk.
        offset: byte position of the message in its unpacked chunk, or in the file if `chunk` is -1; in
            sqlite3 its row id.
        size: size of the message, bytes.
        file: index of the file, from 0, in a bag of several files.
    """

    stamp_ns: int
    chunk: int
    offset: int
    size: int
    file: int = 0


class BagTopic(NamedTuple):
    """A topic and where its messages are stored; or one connection of a topic, as a bag describes it.

    Attributes:
        name: such as "/camera/depth/image_raw".
        type: type in ROS 1's spelling, such as "sensor_msgs/Image", also for ROS 2.
        encoding: serialisation of the messages.
        definition: the bag's own definition of a non-standard type; "": the standard definition is used.
        messages: where the messages are stored, sorted by stamp; empty for a connection.
    """

    name: str
    type: str
    encoding: Encoding = "ros1"
    definition: str = ""
    messages: tuple[MessagePlace, ...] = ()


@dataclass(frozen=True)
class RosBag:
    """The messages found in a bag, which are decoded on request.

    Attributes:
        path: path of the bag, for error messages.
        topics: topics of the wanted types that have messages, sorted by name.
        read: returns the serialised bytes of the message at a `MessagePlace`.
        trouble: one line on the bag's faults and how much of it was readable, or "".
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
        """Decode the index-th message of a topic.

        Raises:
            DamagedImageError: the message does not decode as the topic's type.
            RecordingError: the same chunks would have to be unpacked again and again (`BagReader`).
        """
        from rosbags.serde import SerdeError

        data = self.read(topic.messages[index])
        try:
            return self._decoders[topic.encoding](data, long_type(topic.type))
        except (SerdeError, ValueError, struct.error, LookupError, OverflowError, RecursionError) as error:
            raise DamagedImageError(f"{topic.name}, message {index}: cannot be decoded ({error})") from error

    def whole(self, topic: BagTopic, most: int | None = None) -> Iterator[Message]:
        """Yield those of a topic's first `most` messages that decode (None: of all messages)."""
        for index in range(len(topic.messages[:most])):
            with suppress(DamagedImageError):
                yield self.decode(topic, index)

    def first(self, topic: BagTopic) -> Message | None:
        """Return the first message of a topic that decodes; None if none of its first thousand does."""
        return next(self.whole(topic, FIRST_TRIED), None)


@cache
def _ros1_decoder(own: tuple[tuple[str, str], ...]) -> Callable[[bytes, str], Message]:
    """Make a decoder for ROS 1's types and the bag's own types (`own`: pairs of type and definition)."""
    from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    for name in (TF_MESSAGE, OLD_TF_MESSAGE):
        store.register(get_types_from_msg(TF_DEFINITION, long_type(name)))
    for name, definition in own:
        # Messages of a type whose definition is damaged or exceeds the limits do not decode.
        with suppress(ValueError, TypesysError):
            store.register(known_types(long_type(name), definition, store))
    decode: Callable[[bytes, str], Message] = store.deserialize_ros1
    return decode


@cache
def _ros2_decoder() -> Callable[[bytes, str], Message]:
    """Make a decoder for ROS 2's types."""
    from rosbags.typesys import Stores, get_typestore

    decode: Callable[[bytes, str], Message] = get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr
    return decode


def long_type(name: str) -> str:
    """Return the name of a type in ROS 2's spelling: "sensor_msgs/msg/Image"."""
    return name if "/msg/" in name else name.replace("/", "/msg/")


def short_type(name: str) -> str:
    """Return the name of a type in ROS 1's spelling: "sensor_msgs/Image"."""
    return name.replace("/msg/", "/")


def header_stamp_ns(start: bytes, type_: str, encoding: Encoding) -> int:
    """Return the stamp of a message's Header, ns; 0 without a Header, or if the message is too short.

    Args:
        start: at least the first 16 bytes of the message.
        type_: type in ROS 1's spelling.
        encoding: layout of the Header; "ros1": sequence number, seconds, nanoseconds; "cdr": four bytes for
            the byte order, then seconds, nanoseconds.
    """
    if type_ in HEADERLESS or len(start) < 12:
        return 0
    if encoding == "ros1":
        _, seconds, nanoseconds = struct.unpack_from("<III", start)
    else:
        seconds, nanoseconds = struct.unpack_from("<iI" if start[1] & 1 else ">iI", start, 4)
    return int(seconds) * 10**9 + int(nanoseconds)


def by_stamp(places: Iterable[MessagePlace]) -> tuple[MessagePlace, ...]:
    """Sort the places of messages by stamp; equal stamps keep their order."""
    return tuple(sorted(places, key=lambda place: place.stamp_ns))


@dataclass
class FoundMessages:
    """Collects where a bag's file stores messages of the wanted `types`: {connection number: places}."""

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
        """Record where a message is stored, and its stamp, unless its type is known to be unwanted.

        Args:
            connection: number of the message's connection.
            file: file positioned at the start of the message.
            recorded_ns: time of recording, nanoseconds.
            place: (chunk, offset, size), as in `MessagePlace`.
            whole: whether to read the whole message, to check that it is complete; else only its Header.

        Raises:
            DamagedRecordError: the message is larger than `UNPACKED_BYTES`, or its stamp exceeds 64 bits.
        """
        known = self.connections.get(connection)
        # The message's connection may be known only later: its chunk is lost, but the end of the file repeats
        # it.
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
        if abs(stamp_ns) >= LIMIT_NS:
            raise DamagedRecordError(f"a message of the time {stamp_ns} ns")
        self.places.setdefault(connection, []).append(MessagePlace(stamp_ns, *place))

    def topics(self) -> tuple[BagTopic, ...]:
        """Return the topics with messages, sorted by name; connections of one name and type are joined."""
        joined: dict[BagTopic, list[MessagePlace]] = {}
        for number, places in self.places.items():
            connection = self.connections.get(number)
            if connection is not None and connection.type in self.types:
                joined.setdefault(connection, []).extend(places)
        return tuple(key._replace(messages=by_stamp(joined[key])) for key in sorted(joined))


def unpacked_chunk(compression: str, data: bytes, size: int) -> bytes:
    """Unpack a "bz2", "lz4" or "zstd" chunk to the `size` in its header; return less if the data ends early.

    Raises:
        DamagedRecordError: the chunk is damaged, too large, or compressed in an unknown way.
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
            # A stream reader also accepts frames that do not state their size.
            return zstandard.ZstdDecompressor().stream_reader(data).read(size)
    except (zstandard.ZstdError, OSError, RuntimeError, ValueError, EOFError, MemoryError) as error:
        raise DamagedRecordError from error
    raise DamagedRecordError


def _unpacked(unpacker: "bz2.BZ2Decompressor | LZ4FrameDecompressor", data: bytes, size: int) -> bytes:
    """Decompress at most `size` bytes by bz2 or lz4, with a single copy in memory."""
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
    """Decompress the first bytes of a message from the start of its zstd data; empty if damaged."""
    import zstandard

    with suppress(zstandard.ZstdError):
        return zstandard.ZstdDecompressor().stream_reader(head).read(PEEK_BYTES)
    return b""


def unpacked_message(data: bytes) -> bytes:
    """Decompress a message if it is compressed by zstd; return empty bytes if it is damaged or too large.

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
    """Parse the definition of a ROS 2 type; return the types that it uses and the store lacks.

    Raises:
        ValueError: the definition is damaged or exceeds the limits; the message says which.
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
        # A list of messages that have no bytes takes no bytes itself, and could be endless.
        if any(kind == Nodetype.SEQUENCE and node[0][0] == Nodetype.NAME for _, (kind, node) in fields[own]):
            raise ValueError(f"{own} holds a list of messages")
    return {key: value for key, value in lacking.items() if key in met}


def _unrolled(name: str, fields: Mapping[str, Any], met: set[str], depth: int) -> Iterator[None]:
    """Yield once per field of type `name`, nested fields and array elements included; add types to `met`."""
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
