"""ROS 2 bags: a folder or a bare file, sqlite3 or mcap, compressed by message or as files, or not at all."""

import shutil
import tempfile
import weakref
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

from kinectbench.errors import RecordingError
from kinectbench.ingest import rosbag2_mcap, rosbag2_sqlite
from kinectbench.ingest.ros_messages import BagTopic, MessagePlace, RosBag
from kinectbench.ingest.ros_recording import RosRecording
from kinectbench.ingest.zstd_message import ZSTD_MAGIC, unpacked_message

MAGICS = (rosbag2_sqlite.MAGIC, rosbag2_mcap.MAGIC)
SUFFIXES = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")


class Rosbag2Recording(RosRecording):
    """A ROS 2 bag; the files of a bag that was split are read as one."""

    format: ClassVar[str] = "rosbag2"
    looks_for: ClassVar[str] = "a .mcap or .db3 file, or a folder with such files (and metadata.yaml)"
    verified: ClassVar[str] = "files written by rosbags and by mcap's own writer"

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the file, or a file in the folder, begins like mcap or sqlite3."""
        if path.is_dir():
            return any(_is_bag_file(file) for file in _bag_files(path))
        return path.is_file() and _is_bag_file(path)

    @classmethod
    def walk(cls, path: Path) -> RosBag:
        """Walk through the files of the bag."""
        files = [file for file in _bag_files(path) if _is_bag_file(file)] if path.is_dir() else [path]
        bags = [_walk_file(file, cls.wanted) for file in files]
        if not any(bag.topics for bag in bags) and any(bag.trouble for bag in bags):
            raise RecordingError(
                next(bag.trouble for bag in bags if bag.trouble) + ", and nothing in it can be saved"
            )
        return _joined(bags)


def _bag_files(folder: Path) -> list[Path]:
    """Files that may be a bag's, in the order of recording: NAME_2 before NAME_10."""
    found = (file for file in folder.iterdir() if file.name.endswith(SUFFIXES))
    return sorted(found, key=lambda file: (len(file.name), file.name))


def _is_bag_file(file: Path) -> bool:
    with file.open("rb") as stream:
        start = stream.read(16)
    return start.startswith(MAGICS) or (start.startswith(ZSTD_MAGIC) and file.name.endswith(SUFFIXES))


def _walk_file(file: Path, types: frozenset[str]) -> RosBag:
    with file.open("rb") as stream:
        start = stream.read(16)
    if start.startswith(ZSTD_MAGIC):
        return _walk_packed(file, types)
    walk: Callable[[Path, frozenset[str]], RosBag] = (
        rosbag2_mcap.walk if start.startswith(rosbag2_mcap.MAGIC) else rosbag2_sqlite.walk
    )
    bag = walk(file, types)
    return replace(bag, read=lambda place: unpacked_message(bag.read(place)))


class _Unpacked:
    """A file that is compressed as a whole, unpacked into a temporary folder that goes with this value."""

    def __init__(self, file: Path) -> None:
        import zstandard

        folder = tempfile.mkdtemp(prefix="kinectbench-")
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self.file = Path(folder) / file.name.removesuffix(".zstd")
        self.trouble = ""
        with file.open("rb") as packed, self.file.open("wb") as unpacked:
            try:
                zstandard.ZstdDecompressor().copy_stream(packed, unpacked)
            except zstandard.ZstdError as error:
                self.trouble = f"{file}: is damaged or cut off ({error})"


def _walk_packed(file: Path, types: frozenset[str]) -> RosBag:
    """Walk through a file that is compressed as a whole."""
    unpacked = _Unpacked(file)
    if not _is_bag_file(unpacked.file):
        return RosBag((), lambda place: b"", unpacked.trouble or f"{file}: is cut off or holds no ROS 2 bag")
    bag = _walk_file(unpacked.file, types)

    def read(place: MessagePlace, _kept: _Unpacked = unpacked) -> bytes:
        return bag.read(place)

    return replace(bag, read=read, trouble=bag.trouble.replace(str(unpacked.file), str(file)))


def _joined(bags: list[RosBag]) -> RosBag:
    """The bags of several files as one."""
    if len(bags) == 1:
        return bags[0]
    topics: dict[tuple[str, str], BagTopic] = {}
    for number, bag in enumerate(bags):
        for topic in bag.topics:
            moved = tuple(replace(place, file=number) for place in topic.messages)
            key = (topic.name, topic.type)
            before = topics[key].messages if key in topics else ()
            topics[key] = replace(
                topic, messages=tuple(sorted((*before, *moved), key=lambda place: place.stamp_ns))
            )
    return RosBag(
        tuple(topics[key] for key in sorted(topics)),
        lambda place: bags[place.file].read(place),
        "; ".join(bag.trouble for bag in bags if bag.trouble),
        sum(bag.backwards for bag in bags),
    )
