"""Find the messages of a ROS 2 bag in an sqlite3 file (rosbag2_storage_sqlite3), even if damaged."""

import shutil
import sqlite3
import struct
import tempfile
import weakref
from contextlib import closing, suppress
from pathlib import Path
from urllib.parse import quote

from kinectbench.core import RecordingError, copy_bounded, open_plain, read_head, size_of
from kinectbench.stages.ingest.bags.message_decoding import (
    DEFINITION_BYTES,
    BagTopic,
    DamagedRecordError,
    FoundMessages,
    MessagePlace,
    RosBag,
    short_type,
)
from kinectbench.stages.ingest.bags.walk_limits import STEPS_AT_ONCE, WalkBudget

MAGIC = b"SQLite format 3\0"
TABLES = ("topics", "messages")
# A robot has some hundred topics, but a damaged file may state any number.
MOST_TOPICS = 10_000
# In the header: the counter of changes, and its value when the stated number of pages was valid.
CHANGE_COUNTER, VALID_FOR = slice(24, 28), 92
# Sizes in SQLite's file format.
HEAD_BYTES, LEAST_PAGE_BYTES = 100, 512
# A message longer than a page minus this does not fit into one page.
CELL_BYTES = 100
# Rows of a truncated file may state this multiple of its size, because some of their pages are lost.
LOST_TIMES = 4


def walk_sqlite(path: Path, types: frozenset[str], budget: WalkBudget) -> RosBag:
    """Find the messages of the wanted types (ROS 1's spelling) in an sqlite3 file, within `budget`.

    Raises:
        RecordingError: the file is not a bag's database.
    """
    messages = FoundMessages(types)
    cut_off, unread = _page_bytes_if_cut_off(path), _unread_log(path)
    trouble = f"{path}: is cut off" if cut_off else ""
    reader = _Reader(path, cut_off > 0)
    try:
        with closing(reader.connect()) as database:
            # Pages that form a cycle would give endless rows.
            database.set_progress_handler(lambda: not budget.take_step(), STEPS_AT_ONCE)
            _check_tables(database)
            rows = database.execute(
                "SELECT id, name, type, serialization_format FROM topics LIMIT ?", (MOST_TOPICS,)
            )
            for topic, name, type_, encoding in rows:
                if encoding == "cdr":
                    messages.connections[topic] = BagTopic(str(name), short_type(str(type_)), "cdr")
            try:
                _take_messages(database, messages, reader.file_bytes, all_of_them=cut_off > 0)
            except (sqlite3.DatabaseError, DamagedRecordError) as error:
                trouble = trouble or f"{path}: is damaged ({error})"
    except (sqlite3.DatabaseError, ValueError, TypeError) as error:
        what = "is cut off, and" if cut_off else "is damaged:"
        raise RecordingError(
            f"{path}: {what} cannot be read as a ROS 2 bag ({error}); {unread or 'copy it again'}"
        ) from error
    if cut_off and reader.file_bytes % cut_off:
        _leave_out_torn(messages, cut_off)
    if trouble:
        trouble += f": {sum(map(len, messages.places.values()))} whole messages were saved; copy it again"
    if unread:
        trouble = "; ".join(filter(None, (trouble, f"{path}: {unread}")))
    return RosBag(path, messages.topics(), reader, trouble)


def _unread_log(path: Path) -> str:
    """Return advice on the write-ahead log that a killed recorder leaves beside the file; "" without one."""
    log = path.with_name(f"{path.name}-wal")
    if not log.is_file() or not log.stat().st_size:
        return ""
    return (
        f"{log.name} beside it may hold further messages, which are not read: take them in by "
        f"`sqlite3 {path.name} 'PRAGMA wal_checkpoint(TRUNCATE)'`"
    )


class _Reader:
    """Reads single messages by row number.

    A truncated file lacks pages that its header counts, and sqlite refuses it. So it is copied into a
    temporary folder, which exists as long as the reader, with a header that marks the count as invalid.
    """

    def __init__(self, path: Path, cut_off: bool) -> None:
        with open_plain(path) as file:
            self.file_bytes = size_of(file)
        self._path = path
        self._database: sqlite3.Connection | None = None
        if cut_off:
            folder = tempfile.mkdtemp(prefix="kinectbench-")
            weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
            self._path = Path(folder) / "cut_off.db3"
            with open_plain(path) as source, self._path.open("wb") as target:
                copy_bounded(source, target, self.file_bytes)
                if self.file_bytes >= HEAD_BYTES:
                    target.seek(VALID_FOR)
                    changes = read_head(path, HEAD_BYTES)[CHANGE_COUNTER]
                    target.write(bytes(255 - byte for byte in changes))

    def connect(self) -> sqlite3.Connection:
        """Open the file read-only, as untrusted input."""
        open_plain(self._path).close()  # a regular file
        # immutable: nothing is written beside the file, and no journal or log is read.
        database = sqlite3.connect(
            f"file:{quote(str(self._path.resolve()))}?mode=ro&immutable=1", uri=True, check_same_thread=False
        )
        database.execute("PRAGMA trusted_schema = OFF")
        database.execute("PRAGMA query_only = ON")
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, DEFINITION_BYTES)
        return database

    def __call__(self, place: MessagePlace) -> bytes:
        """Read the serialised message in a row; if unreadable, return no bytes, which counts as damaged."""
        try:
            if self._database is None:
                self._database = self.connect()
                # Finding a row takes some ten steps.
                self._database.set_progress_handler(lambda: True, STEPS_AT_ONCE)
            with self._database.blobopen("messages", "data", place.offset, readonly=True) as blob:
                return blob.read(place.size)
        except sqlite3.DatabaseError:
            return b""

    def __del__(self) -> None:
        if self._database is not None:
            self._database.close()


def _check_tables(database: sqlite3.Connection) -> None:
    """Refuse views, virtual tables and generated columns, because reading them would run the file's SQL."""
    for name in TABLES:
        rows = database.execute(
            "SELECT type, rootpage FROM sqlite_master WHERE name = ? COLLATE NOCASE LIMIT 2", (name,)
        ).fetchall()
        if len(rows) != 1 or rows[0][0] != "table" or not rows[0][1]:
            raise ValueError(f"it has no table '{name}'")
        if any(column[6] for column in database.execute(f"PRAGMA table_xinfo({name})")):
            raise ValueError(f"its table '{name}' has columns that are computed")


def _page_bytes_if_cut_off(path: Path) -> int:
    """Return the page size, bytes, if the file is shorter than its header states, else 0 (format, 1.3)."""
    with open_plain(path) as file:
        head, file_bytes = file.read(HEAD_BYTES), size_of(file)
    if len(head) < HEAD_BYTES:
        return LEAST_PAGE_BYTES
    (page_code,), (pages,) = struct.unpack_from(">H", head, 16), struct.unpack_from(">I", head, 28)
    page_bytes = 65536 if page_code == 1 else max(int(page_code), LEAST_PAGE_BYTES)
    return page_bytes if file_bytes < pages * page_bytes else 0


def _leave_out_torn(messages: FoundMessages, page_bytes: int) -> None:
    """Drop the last message that is longer than a page: sqlite would fill its incomplete page with zeros."""
    every = messages.places.values()
    long = (place for places in every for place in places if place.size > page_bytes - CELL_BYTES)
    last = max(long, key=lambda place: place.offset, default=None)
    for places in every:
        if last in places:
            places.remove(last)


def _take_messages(
    database: sqlite3.Connection, messages: FoundMessages, file_bytes: int, all_of_them: bool
) -> None:
    """Note where the messages are stored; with `all_of_them`, read each completely to check it.

    Raises:
        DamagedRecordError: one message is larger than the file, or all messages together are (with
            `all_of_them`: than four times the file). Rows may share pages, so reading each could cost as much
            as the file times the number of rows.
    """
    query = (
        "SELECT rowid, topic_id, timestamp, length(data) FROM messages WHERE typeof(data) = 'blob' "
        "ORDER BY rowid"
    )
    left_bytes = file_bytes * (LOST_TIMES if all_of_them else 1)
    for row, topic, recorded_ns, size in database.execute(query):
        left_bytes -= size
        if size > file_bytes:  # its pages form a cycle
            raise DamagedRecordError("a message is larger than the file")
        if left_bytes < 0:
            raise DamagedRecordError("its messages are larger than the file, all of them together")
        # A message whose end is lost is skipped.
        if topic in messages.connections:
            with (
                suppress(sqlite3.DatabaseError),
                database.blobopen("messages", "data", row, readonly=True) as blob,
            ):
                messages.take(topic, blob, int(recorded_ns), (-1, row, size), whole=all_of_them)
