"""The messages of a ROS 2 bag in a sqlite3 file (rosbag2_storage_sqlite3); a damaged one gives a part."""

import sqlite3
import struct
from contextlib import closing, suppress
from pathlib import Path
from urllib.parse import quote

from kinectbench.core.errors import RecordingError
from kinectbench.stages.ingest.bags.ros_messages import (
    BagTopic,
    FoundMessages,
    MessagePlace,
    RosBag,
    short_type,
)

MAGIC = b"SQLite format 3\0"
HEAD_BYTES, LEAST_PAGE_BYTES = 100, 512
# A message as long as a page less this does not fit into a page with others.
CELL_BYTES = 100


def walk(path: Path, types: frozenset[str]) -> RosBag:
    """Find the messages of the wanted types in the order in which they were written.

    Raises:
        RecordingError: not a bag's database.
    """
    found = FoundMessages(types)
    cut_off = _page_bytes_if_cut_off(path)
    trouble = f"{path}: is cut off" if cut_off else ""
    try:
        with closing(_connect(path)) as database:
            rows = database.execute("SELECT id, name, type, serialization_format FROM topics").fetchall()
            for topic, name, type_, encoding in rows:
                if encoding == "cdr":
                    found.connections[topic] = BagTopic(str(name), short_type(str(type_)), "cdr")
            try:
                _take_messages(database, found, all_of_them=cut_off > 0)
            except sqlite3.DatabaseError as error:
                trouble = trouble or f"{path}: is damaged ({error})"
    except (sqlite3.DatabaseError, ValueError, TypeError) as error:
        what = "is cut off, and" if cut_off else "is damaged:"
        raise RecordingError(
            f"{path}: {what} cannot be read as a ROS 2 bag ({error}); copy it again"
        ) from error
    if cut_off and path.stat().st_size % cut_off:
        _leave_out_torn(found, cut_off)
    if trouble:
        trouble += f": {sum(map(len, found.places.values()))} whole messages were saved; copy it again"
    return RosBag(path, found.topics(), _Reader(path), trouble)


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


def _leave_out_torn(found: FoundMessages, page_bytes: int) -> None:
    """Leave out the last message that has pages of its own: sqlite fills up a torn page with zeros."""
    every = found.places.values()
    long = (place for places in every for place in places if place.size > page_bytes - CELL_BYTES)
    last = max(long, key=lambda place: place.offset, default=None)
    for places in every:
        if last in places:
            places.remove(last)


def _take_messages(database: sqlite3.Connection, found: FoundMessages, all_of_them: bool) -> None:
    """Note where the messages lie; no more of them is read than their first bytes, or else `all_of_them`."""
    query = (
        "SELECT id, topic_id, timestamp, length(data) FROM messages WHERE typeof(data) = 'blob' ORDER BY id"
    )
    for row, topic, recorded_ns, size in database.execute(query):
        # One whose end is lost is passed over.
        if topic in found.connections:
            with (
                suppress(sqlite3.DatabaseError),
                database.blobopen("messages", "data", row, readonly=True) as blob,
            ):
                found.take(topic, blob, int(recorded_ns), (-1, row, size), whole=all_of_them)
