"""ROS 2 bags: a folder or a single file, sqlite3 or mcap, compressed by message, by file or not at all."""

import errno
import shutil
import tempfile
import weakref
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

from kinectbench.core import RecordingError, copy_bounded, listed_paths, open_plain, read_head
from kinectbench.core.types import Float64
from kinectbench.stages.ingest.bags import rosbag2_mcap, rosbag2_sqlite
from kinectbench.stages.ingest.bags.message_decoding import (
    ZSTD_MAGIC,
    BagTopic,
    MessagePlace,
    RosBag,
    by_stamp,
    unpacked_message,
)
from kinectbench.stages.ingest.bags.realsense import (
    STREAM,
    STRING,
    TRANSFORM,
    between_streams,
    depth_units_scale,
)
from kinectbench.stages.ingest.bags.ros_poses import TransformTree
from kinectbench.stages.ingest.bags.ros_recording import RosRecording
from kinectbench.stages.ingest.bags.ros_topics import WANTED, ImageTopic
from kinectbench.stages.ingest.bags.walk_limits import WalkBudget

# Enough for one file per minute for sixteen hours.
MOST_FILES = 1000
MAGICS = (rosbag2_sqlite.MAGIC, rosbag2_mcap.MAGIC)


class Rosbag2Recording(RosRecording):
    """A ROS 2 bag; the files of a split bag are read as one."""

    format: ClassVar[str] = "rosbag2"
    looks_for: ClassVar[str] = "a .mcap or .db3 file, or a folder with such files (and metadata.yaml)"
    suffixes: ClassVar[tuple[str, ...]] = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
    verified: ClassVar[str] = "files written by rosbags, by mcap's own writer and by librealsense 2.59"
    wanted: ClassVar[frozenset[str]] = WANTED | {STRING, TRANSFORM}

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the file, or a file in the folder, starts like mcap or sqlite3."""
        if path.is_dir():
            return any(_is_bag_file(file) for file in _bag_files(path))
        return _is_bag_file(path)

    @classmethod
    def frame_ids_tell(cls, depth: ImageTopic) -> bool:
        """Return False for a librealsense bag that was converted from ROS 1: its streams share a frame_id."""
        return not STREAM.fullmatch(depth.name)

    @classmethod
    def integer_scale(cls, bag: RosBag, depth: ImageTopic) -> float | None:
        """Return native depth units per metre, which bags by librealsense state; None for other bags."""
        return depth_units_scale(bag, depth) if STREAM.fullmatch(depth.name) else None

    @classmethod
    def between(cls, bag: RosBag, tree: TransformTree, to: ImageTopic, of: ImageTopic) -> Float64 | None:
        """Return `T_to_of` (4, 4), by the extrinsics in a bag by librealsense, by tf in any other bag.

        The result is None if the bag lacks them.
        """
        if any(STREAM.fullmatch(topic.name) for topic in (to, of)):
            return between_streams(bag, to.name, of.name)
        return super().between(bag, tree, to, of)

    @classmethod
    def walk(cls, path: Path) -> RosBag:
        """Walk through the files of the bag."""
        files = [file for file in _bag_files(path) if _is_bag_file(file)] if path.is_dir() else [path]
        if len(files) > MOST_FILES:
            raise RecordingError(
                f"{path}: holds more than the {MOST_FILES} files that a bag may have; name the folder of one",
                what="too-large",
            )
        budget = WalkBudget(sum(file.stat().st_size for file in files))
        bags = [_walk_file(file, cls.wanted, budget) for file in files]
        if not any(bag.topics for bag in bags) and any(bag.trouble for bag in bags):
            raise RecordingError(
                next(bag.trouble for bag in bags if bag.trouble) + ", and nothing in it can be saved"
            )
        return _joined(path, bags)


def _bag_files(folder: Path) -> list[Path]:
    """Return the files that may belong to a bag, in the order of recording: NAME_2 before NAME_10."""

    def matches(name: str) -> bool:
        return name.lower().endswith(Rosbag2Recording.suffixes) and not name.startswith(".")

    files = listed_paths(folder, wanted=matches)
    return sorted(files, key=lambda file: (len(file.name), file.name))


def _start_of(file: Path) -> bytes:
    return read_head(file, 16)


def _is_bag_file(file: Path) -> bool:
    if not file.is_file():
        return False
    start = _start_of(file)
    return start.startswith(MAGICS) or (
        start.startswith(ZSTD_MAGIC) and file.name.lower().endswith(Rosbag2Recording.suffixes)
    )


def _walk_file(file: Path, types: frozenset[str], budget: WalkBudget) -> RosBag:
    start = _start_of(file)
    if start.startswith(ZSTD_MAGIC):
        return _walk_packed(file, types, budget)
    walk = rosbag2_mcap.walk_mcap if start.startswith(rosbag2_mcap.MAGIC) else rosbag2_sqlite.walk_sqlite
    bag = walk(file, types, budget)
    return replace(bag, read=lambda place: unpacked_message(bag.read(place)))


def _walk_packed(file: Path, types: frozenset[str], budget: WalkBudget) -> RosBag:
    """Find messages of `types` in a file compressed as a whole, unpacked into a temporary folder."""
    import zstandard

    def read(place: MessagePlace) -> bytes:
        return bag.read(place)

    # The file is unpacked into a temporary folder that exists as long as `read`.
    folder = tempfile.mkdtemp(prefix="kinectbench-")
    weakref.finalize(read, shutil.rmtree, folder, ignore_errors=True)
    unpacked, trouble = Path(folder) / file.stem, ""
    with open_plain(file) as source, unpacked.open("wb") as target:
        stream = zstandard.ZstdDecompressor().stream_reader(source, read_across_frames=True)
        try:
            copy_bounded(stream, target, budget.bytes_left)
        except zstandard.ZstdError as error:
            trouble = f"{file}: is damaged or cut off ({error})"
        except OSError as error:
            if error.errno != errno.EFBIG or error.filename is not None:
                raise
            raise RecordingError(f"{file}: {error.strerror}, which no bag of its size does") from error
        finally:
            budget.bytes_left -= target.tell()
    if not _start_of(unpacked).startswith(MAGICS):
        trouble = trouble or f"{file}: is cut off or holds no ROS 2 bag"
        return RosBag(file, (), lambda place: b"", trouble)
    bag = _walk_file(unpacked, types, budget)
    trouble = bag.trouble.replace(str(unpacked), str(file))
    if not bag.topics:  # nothing will be read, so the folder is removed at once
        return RosBag(file, (), lambda place: b"", trouble)
    return replace(bag, read=read, trouble=trouble)


def _joined(path: Path, bags: list[RosBag]) -> RosBag:
    """Combine the bags of several files into one."""
    if len(bags) == 1:
        return replace(bags[0], path=path)
    topics: dict[tuple[str, str], BagTopic] = {}
    for number, bag in enumerate(bags):
        for topic in bag.topics:
            moved = tuple(replace(place, file=number) for place in topic.messages)
            key = (topic.name, topic.type)
            before = topics[key].messages if key in topics else ()
            topics[key] = topic._replace(messages=by_stamp((*before, *moved)))
    return RosBag(
        path,
        tuple(topics[key] for key in sorted(topics)),
        lambda place: bags[place.file].read(place),
        "; ".join(bag.trouble for bag in bags if bag.trouble),
    )
