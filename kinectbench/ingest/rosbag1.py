"""ROS 1 bags: raw and compressed images, lz4 and bz2 chunks, whole, cut off or never closed."""

from pathlib import Path
from typing import ClassVar

from kinectbench.errors import RecordingError
from kinectbench.ingest.ros_messages import RosBag
from kinectbench.ingest.ros_recording import RosRecording
from kinectbench.ingest.rosbag1_chunks import MAGIC, BagContents, BagFile, scan_bag


class Rosbag1Recording(RosRecording):
    """A ROS 1 bag; integer depth is taken as millimetres, float depth as metres."""

    format: ClassVar[str] = "rosbag1"
    looks_for: ClassVar[str] = "a file that begins with '#ROSBAG V2.0'"
    verified: ClassVar[str] = "files written by rosbags; a bag with tf by ROS"

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the file begins like a bag, whatever its name ends in."""
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC

    @classmethod
    def walk(cls, path: Path) -> RosBag:
        """Walk through the bag's chunks."""
        read = BagFile(path)
        contents = scan_bag(path, cls.wanted, cls.own_types, read.keep)
        return RosBag(contents.topics, read, _trouble(path, contents), contents.backwards)


def _trouble(path: Path, contents: BagContents) -> str:
    found = sum(len(topic.messages) for topic in contents.topics)
    if contents.complete and not contents.damaged_chunks:
        return ""
    what = "is cut off or has no index" if not contents.complete else "is damaged"
    if not found:
        raise RecordingError(f"{path}: {what}, and nothing in it can be saved; copy it again")
    return (
        f"{path}: {what}: {found} messages of {contents.chunks - contents.damaged_chunks} whole chunks were "
        f"saved ({contents.damaged_chunks} chunks are damaged); copy it again, or run `rosbag reindex`"
    )
