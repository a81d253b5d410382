"""The messages of a ROS 2 bag in a sqlite3 file (rosbag2_storage_sqlite3); a damaged one gives a part."""

import sqlite3
import struct
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
HEAD_BYTES, LEAST_PAGE_BYTES = 100, 512
# A message as long as a page less this does not fit into a page with others.
CELL_BYTES = 100


def walk(path: Path, types: frozenset[str]) -> RosBag:
    """Find the messages of the wanted types in the order in which they were written.

    Raises:
        RecordingError: not a bag's database.
    """
    topics: list[tuple[str, str, Encoding, str, list[MessagePlace]]] = []
    cut_off = _page_bytes_if_cut_off(path)
    trouble = f"{path}: is cut off" if cut_off else ""
    try:
        with closing(_connect(path)) as database:
            rows = database.execute("SELECT id, name, type, serialization_format FROM topics").fetchall()
            wanted = {row[0]: row for row in rows if short_type(str(row[2])) in types and row[3] == "cdr"}
            places: dict[int, list[MessagePlace]] = {topic: [] for topic in wanted}
            try:
                _take_messages(database, wanted, places, all_of_them=cut_off > 0)
            except sqlite3.DatabaseError as error:
                trouble = trouble or f"{path}: is damaged ({error})"
    except (sqlite3.DatabaseError, ValueError, TypeError) as error:
        what = "is cut off, and" if cut_off else "is damaged:"
        raise RecordingError(
            f"{path}: {what} cannot be read as a ROS 2 bag ({error}); copy it again"
        ) from error
    if cut_off and path.stat().st_size % cut_off:
        _leave_out_torn(places, cut_off)
    for topic, found in places.items():
        if found:
            name, type_ = str(wanted[topic][1]), short_type(str(wanted[topic][2]))
            topics.append((name, type_, "cdr", "", found))
    made, backwards = joined_topics(topics)
    if trouble:
        trouble += f": {sum(map(len, places.values()))} whole messages were saved; copy it again"
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
    database = sqlite3.connect(
        f"file:{quote(str(path.resolve()))}?immutable=1", uri=True, check_same_thread=False
    )
    # Without it, sqlite opens no file that lacks pages that its head counts, as one does that was cut off.
    database.execute("PRAGMA writable_schema = ON")
    return database


def _page_bytes_if_cut_off(path: Path) -> int:
    """The size of a page if the file is shorter than its head says, else 0 (SQLite's file format, 1.3)."""
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    if len(head) < HEAD_BYTES:
        return LEAST_PAGE_BYTES
    (said,), (pages,) = struct.unpack_from(">H", head, 16), struct.unpack_from(">I", head, 28)
    page_bytes = 65536 if said == 1 else max(int(said), LEAST_PAGE_BYTES)
    return page_bytes if path.stat().st_size < pages * page_bytes else 0


def _leave_out_torn(places: dict[int, list[MessagePlace]], page_bytes: int) -> None:
    """Leave out the last message that has pages of its own: sqlite fills up a torn page with zeros."""
    long = (place for found in places.values() for place in found if place.size > page_bytes - CELL_BYTES)
    last = max(long, key=lambda place: place.offset, default=None)
    for found in places.values():
        if last in found:
            found.remove(last)


def _take_messages(
    database: sqlite3.Connection,
    wanted: dict[int, tuple[int, str, str, str]],
    places: dict[int, list[MessagePlace]],
    all_of_them: bool,
) -> None:
    """Note where the messages lie; no more of them is read than their first bytes, or else `all_of_them`."""
    query = (
        "SELECT id, topic_id, timestamp, length(data) FROM messages WHERE typeof(data) = 'blob' ORDER BY id"
    )
    for row, topic, recorded_ns, size in database.execute(query):
        if topic not in wanted:
            continue
        try:
            with database.blobopen("messages", "data", row, readonly=True) as blob:
                start = blob.read() if all_of_them else blob.read(PEEK)
                if start.startswith(ZSTD_MAGIC):
                    start = unpacked_message(start + blob.read())[:PEEK]
        except sqlite3.DatabaseError:
            continue  # its end is lost
        stamp_ns = header_stamp_ns(start, short_type(wanted[topic][2]), "cdr") or int(recorded_ns)
        places[topic].append(MessagePlace(stamp_ns, -1, row, size))
