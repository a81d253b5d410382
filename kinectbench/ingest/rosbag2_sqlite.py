"""The messages of a ROS 2 bag in a sqlite3 file (rosbag2_storage_sqlite3); a damaged one gives a part."""

import sqlite3
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

from kinectbench.errors import RecordingError
from kinectbench.ingest.ros_messages import (
    Encoding,
    MessagePlace,
    RosBag,
    header_stamp_ns,
    joined_topics,
    short_type,
)
from kinectbench.ingest.zstd_message import ZSTD_MAGIC, unpacked_message

MAGIC = b"SQLite format 3\0"
# Enough for a Header; of a message that is compressed all is needed.
PEEK = 16


def walk(path: Path, types: frozenset[str]) -> RosBag:
    """Find the messages of the wanted types in the order in which they were written.

    Raises:
        RecordingError: not a bag's database.
    """
    topics: list[tuple[str, str, Encoding, str, list[MessagePlace]]] = []
    trouble = ""
    try:
        with closing(_connect(path)) as database:
            rows = database.execute("SELECT id, name, type, serialization_format FROM topics").fetchall()
            wanted = {row[0]: row for row in rows if short_type(str(row[2])) in types and row[3] == "cdr"}
            places: dict[int, list[MessagePlace]] = {topic: [] for topic in wanted}
            try:
                _take_messages(database, wanted, places)
            except sqlite3.DatabaseError as error:
                trouble = f"{path}: is cut off or damaged ({error})"
    except (sqlite3.DatabaseError, ValueError, TypeError) as error:
        raise RecordingError(f"{path}: cannot be read as a ROS 2 bag ({error}); copy it again") from error
    for topic, found in places.items():
        if found:
            name, type_ = str(wanted[topic][1]), short_type(str(wanted[topic][2]))
            topics.append((name, type_, "cdr", "", found))
    made, backwards = joined_topics(topics)
    if trouble:
        trouble += f": {sum(map(len, places.values()))} messages before the damage were saved"
    return RosBag(made, _Reader(path), trouble, backwards)


class _Reader:
    """Reads single messages by their row."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._database: sqlite3.Connection | None = None

    def __call__(self, place: MessagePlace) -> bytes:
        try:
            if self._database is None:
                self._database = _connect(self._path)
            row = self._database.execute("SELECT data FROM messages WHERE id = ?", (place.offset,)).fetchone()
        except sqlite3.DatabaseError:
            return b""  # does not decode as a message, and counts as damaged
        return bytes(row[0]) if row else b""

    def __del__(self) -> None:
        if self._database is not None:
            self._database.close()


def _connect(path: Path) -> sqlite3.Connection:
    # immutable: nothing is written beside the file, and a journal that is missing does not matter.
    return sqlite3.connect(
        f"file:{quote(str(path.resolve()))}?immutable=1", uri=True, check_same_thread=False
    )


def _take_messages(
    database: sqlite3.Connection,
    wanted: dict[int, tuple[int, str, str, str]],
    places: dict[int, list[MessagePlace]],
) -> None:
    query = f"SELECT id, topic_id, timestamp, length(data), substr(data, 1, {PEEK}) FROM messages ORDER BY id"
    for row, topic, recorded_ns, size, start in database.execute(query):
        if topic not in wanted or not isinstance(start, bytes):
            continue
        if start.startswith(ZSTD_MAGIC):
            whole = database.execute("SELECT data FROM messages WHERE id = ?", (row,)).fetchone()
            start = unpacked_message(whole[0])[:PEEK]
        stamp_ns = header_stamp_ns(start, short_type(wanted[topic][2]), "cdr") or int(recorded_ns)
        places[topic].append(MessagePlace(stamp_ns, -1, row, size))
