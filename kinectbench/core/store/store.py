"""A store by its URL: read, list, create and replace files, each atomically."""

import asyncio
import itertools
import os
import threading
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from types import ModuleType
from typing import IO, TYPE_CHECKING, TypeVar
from urllib.parse import unquote

from kinectbench.core.errors import StorageError
from kinectbench.core.storage import replaced_file
from kinectbench.core.store.address import is_web, joined, require_usable, shown
from kinectbench.core.store.attempts import MissingObjectError, UnsettledError, patiently, wait_until
from kinectbench.core.untrusted import TEXT_BYTES, printable

if TYPE_CHECKING:
    from obstore import GetOptions, ObjectMeta
    from obstore.store import ClientConfig, ObjectStore

T = TypeVar("T")

# Limit of one request with its answer: a part of 8 MB at 140 kB/s. A longer answer is cut off and resumed.
REQUEST_TIMEOUT, CONNECT_TIMEOUT = "60s", "10s"
# Seconds to wait for the next entries of a listing; longer than one request, because a store may send empty
# pages for ever, each with a link to the next.
LISTED_S = 65.0
# Objects in one request: a page of S3.
LISTED_AT_ONCE = 1000
# S3 accepts parts from 5 MB on, at most 10,000: files up to 80 GB.
PART_BYTES, PARTS_AT_ONCE = 8 << 20, 4
# Files that are read or written at a time.
AT_ONCE = 8
# Calls that wait for a thread; each takes 1.7 kB of memory.
WAITING = 256
# Largest number of objects in a listing: twice those of a benchmark of ten thousand recordings; each takes
# 500 bytes.
MOST_OBJECTS = 1_000_000
# Largest file of a recording or a stage (chosen here: S3 allows 5 TB, and no recording comes near).
MOST_OBJECT_BYTES = 1 << 40


@dataclass(frozen=True)
class StoredObject:
    """An entry of a listing.

    Attributes:
        name: name relative to the store's URL, with "/" between folders; untrusted.
        size: bytes.
        e_tag: changes if the content does.
        modified_s: time of the last change, seconds since 1970.
    """

    name: str
    size: int
    e_tag: str
    modified_s: float


@dataclass(frozen=True)
class Store:
    """A folder in an object store, on a web server (read-only) or on a disk; can be pickled.

    Every file appears whole or not at all. A failed call is retried for some minutes, unless a retry
    cannot help. After that a `StorageError` is raised.

    Attributes:
        url: URL without trailing slash.
    """

    url: str

    @property
    def can_list(self) -> bool:
        """Whether the store can list its files."""
        return not is_web(self.url)

    def place(self, name: str = "") -> str:
        """Return the URL of a file, or of the store if no name is given, short and without secrets."""
        return printable(shown(joined(self.url, name) if name else self.url), 200)

    def read(self, name: str, most_bytes: int = TEXT_BYTES) -> bytes:
        """Read the bytes of a file.

        Raises:
            MissingObjectError: the file does not exist.
            StorageError: the file is larger than `most_bytes`, or cannot be read.
        """
        return self._try_read(name, lambda: self._content(name, most_bytes))

    def read_if_there(self, name: str, most_bytes: int = TEXT_BYTES) -> bytes | None:
        """Read a file; None if it does not exist."""
        try:
            return self.read(name, most_bytes)
        except MissingObjectError:
            return None

    def fetch(self, name: str, path: Path, most_bytes: int = MOST_OBJECT_BYTES) -> None:
        """Download a file; it appears at `path` when it is complete.

        Raises:
            MissingObjectError: the file does not exist.
            StorageError: the file is larger than `most_bytes`, cannot be read, or the disk cannot be written.
        """
        with replaced_file(path) as temporary, temporary.open("wb") as out:
            first: list[ObjectMeta] = []
            self._try_read(name, lambda: self._append(name, out, first, most_bytes), out.tell)

    def put(self, name: str, content: bytes | Path) -> None:
        """Write a file; replace an existing one.

        Raises:
            StorageError: the file cannot be written.
        """
        options = {"chunk_size": PART_BYTES, "max_concurrency": PARTS_AT_ONCE}

        def put() -> object:
            if isinstance(content, Path):
                self._check_readable(content)
            return _obstore().put(self._opened(make=True), name, content, **options)

        self._try(name, put)

    def put_new(self, name: str, content: bytes, same: Callable[[bytes, bytes], bool] = bytes.__eq__) -> bool:
        """Create a file, but never replace one; of several concurrent writers only one succeeds.

        An existing file with equal content is no error: the store's answer to an earlier attempt may be lost.
        `same` compares the existing content (first argument) with the new one; true if they are equivalent.

        Returns:
            Whether this call wrote the file; False if it existed with equal content.

        Raises:
            StorageError: the file has other content, or cannot be written.
        """
        return self._try(name, lambda: self._put_new(name, content, same))

    def objects(self, below: str = "", most: int = MOST_OBJECTS) -> list[StoredObject]:
        """List every file below a folder ("": all of the store), by name; [] if the folder is missing.

        Raises:
            StorageError: there are more than `most` files, or they cannot be listed.
        """
        listed: list[StoredObject] = []
        furthest = 0

        def progress() -> int:
            nonlocal furthest
            furthest = max(furthest, len(listed))
            return furthest

        self._try_read(below, lambda: self._list_on(below, most, listed), progress)
        return sorted(listed, key=lambda each: each.name)

    def head(self, name: str) -> StoredObject | None:
        """Size and metadata of a file, without reading it; None if it does not exist."""
        try:
            return self._try_read(name, lambda: _object(_obstore().head(self._opened(), name)))
        except MissingObjectError:
            return None

    def delete(self, names: Iterable[str]) -> None:
        """Delete files, in any order; missing files are passed over.

        Raises:
            StorageError: a file cannot be deleted.
        """
        if found := list(names):
            self._try("", lambda: self._delete(found))

    def _delete(self, names: list[str]) -> None:
        try:
            _obstore().delete(self._opened(), names)
        except FileNotFoundError:  # a file:// store stops at the first one that is missing
            for name in names:
                with suppress(FileNotFoundError):
                    _obstore().delete(self._opened(), name)

    def _try(self, name: str, call: Callable[[], T]) -> T:
        """Run a call that writes, with retries; if it fails for too long, the store counts as gone."""
        require_usable(self.url, self.place(name))
        return patiently(self.place(name), call)

    def _try_read(self, name: str, call: Callable[[], T], progress: Callable[[], object] = lambda: None) -> T:
        require_usable(self.url, self.place(name))
        return patiently(self.place(name), call, progress, self._first_listed if self.can_list else None)

    def _first_listed(self) -> object:
        """Send a small request, to test whether the store answers."""
        return next(self._chunks(None, None, 1), None)

    def _chunks(self, below: str | None, after: str | None, at_once: int) -> Iterator[Sequence["ObjectMeta"]]:
        """Yield the entries below a folder whose names follow `after`, in batches of `at_once`.

        Raises:
            StorageError: the next batch does not arrive in time.
        """
        pages = _obstore().list(self._opened(), prefix=below, offset=after, chunk_size=at_once).__aiter__()
        # In an extra thread, because the caller's thread may run an event loop, as in a notebook.
        with ThreadPoolExecutor(1, "listing") as pool:
            while True:
                try:
                    chunk = pool.submit(asyncio.run, _next(pages)).result()
                except TimeoutError:
                    raise StorageError(
                        f"{self.place(below or '')}: the store lists nothing for {LISTED_S:.0f} s and says "
                        "that there is more; name another store, or ask whoever runs it",
                        what="refused",
                    ) from None
                if chunk is None:
                    return
                yield chunk

    def _opened(self, *, make: bool = False) -> "ObjectStore":
        if _first_process.setdefault("id", os.getpid()) != os.getpid():
            raise StorageError(
                f"{self.place()}: cannot be used in a process that was forked after a store was opened; "
                "start processes by spawn, a DataLoader's by multiprocessing_context='spawn'",
                what="forked",
            )
        return _opened(self.url, make, os.getpid())

    def _content(self, name: str, most_bytes: int) -> bytes:
        result = _obstore().get(self._opened(), name)
        self._check_size(name, result.meta["size"], most_bytes)
        return bytes(result.bytes())

    def _put_new(self, name: str, content: bytes, same: Callable[[bytes, bytes], bool]) -> bool:
        from obstore.exceptions import AlreadyExistsError

        try:
            _obstore().put(self._opened(make=True), name, content, mode="create")
        except AlreadyExistsError:
            try:
                stored = self._content(name, max(TEXT_BYTES, len(content)))
            except FileNotFoundError:  # of two concurrent writers both may have failed
                raise UnsettledError from None
            if same(stored, content):
                return False
            raise StorageError(
                f"{self.place(name)}: holds something else than what was to be written there, and stays so",
                what="other-content",
            ) from None
        return True

    def _append(self, name: str, out: IO[bytes], first: list["ObjectMeta"], most_bytes: int) -> None:
        """Download the rest of a file into `out`, from its position on.

        `first` keeps the metadata of the first response, which later responses must match.
        """
        at = out.tell()
        if first and at == first[0]["size"]:
            return
        options: GetOptions = {"range": {"offset": at}} if at else {}
        if at and first[0]["e_tag"]:
            options["if_match"] = first[0]["e_tag"]
        result = _obstore().get(self._opened(), name, options=options or None)
        self._check_size(name, result.meta["size"], most_bytes)
        first[:] = first or [result.meta]
        is_same = all(result.meta[key] == first[0][key] for key in ("size", "last_modified"))
        if not first[0]["e_tag"] and not is_same:
            raise StorageError(
                f"{self.place(name)}: was replaced during the download; run the command again", what="refused"
            )
        for part in result.stream():
            out.write(bytes(part))
            if out.tell() > most_bytes:
                self._check_size(name, out.tell(), most_bytes)
        if out.tell() != first[0]["size"]:
            raise UnsettledError(f"{out.tell()} of {first[0]['size']} bytes")

    def _check_size(self, name: str, size: int, most_bytes: int) -> None:
        if size > most_bytes:
            raise StorageError(
                f"{self.place(name)}: {size} bytes are more than the {most_bytes} it may have",
                what="too-large",
            )

    def _list_on(self, below: str, most: int, listed: list[StoredObject]) -> None:
        """Continue the interrupted listing `listed`; begin again if the store does not list in order."""
        try:
            self._opened()
        except FileNotFoundError:  # a missing local folder holds nothing
            return
        in_order = all(one.name < other.name for one, other in itertools.pairwise(listed))
        if not in_order or self.url.startswith(("file:", "memory:")):
            listed.clear()
        for chunk in self._chunks(below or None, listed[-1].name if listed else None, LISTED_AT_ONCE):
            listed += [_object(each) for each in chunk]
            if len(listed) > most:
                raise StorageError(f"{self.place(below)}: holds more than {most} files", what="too-large")

    def _check_readable(self, path: Path) -> None:
        try:
            path.open("rb").close()
        except OSError as error:
            raise StorageError(
                f"{path}: cannot be read ({error.strerror}), and so not put to {self.place()}; "
                "run the command again",
                what="unreadable",
            ) from error


def in_parallel(
    calls: Iterable[Callable[[], T]], done: Callable[[int], None] = lambda count: None, at_once: int = AT_ONCE
) -> list[T]:
    """Run calls in threads, and return their results in order.

    The first error, in the order of the calls, is raised and cancels the waiting calls.

    Args:
        calls: functions without arguments, such as methods of `Store` by `functools.partial`.
        done: called in this thread with the number of calls, from the first on, that have all finished.
        at_once: number of calls that run at a time.
    """
    stop = threading.Event()
    with ThreadPoolExecutor(at_once, "store", initializer=wait_until, initargs=(stop,)) as pool:
        left, waiting = iter(calls), deque[Future[T]]()
        results: list[T] = []
        try:
            waiting.extend(pool.submit(call) for call in itertools.islice(left, WAITING))
            while waiting:
                results.append(waiting.popleft().result())
                done(len(results))
                waiting.extend(pool.submit(call) for call in itertools.islice(left, 1))
        except BaseException:
            stop.set()
            pool.shutdown(cancel_futures=True)
            raise
        return results


async def _next(pages: AsyncIterator[Sequence["ObjectMeta"]]) -> Sequence["ObjectMeta"] | None:
    """The next batch of a listing; None at the end.

    Raises:
        TimeoutError: the batch does not arrive in time.
    """
    return await asyncio.wait_for(anext(pages, None), LISTED_S)


def _obstore() -> ModuleType:
    import obstore

    return obstore


def _object(meta: "ObjectMeta") -> StoredObject:
    return StoredObject(meta["path"], meta["size"], meta["e_tag"] or "", meta["last_modified"].timestamp())


# The process that opened the first store. A forked process would wait for ever for obstore's threads, which a
# fork does not copy.
_first_process: dict[str, int] = {}


@cache
def _opened(url: str, make: bool, process: int) -> "ObjectStore":
    """Open a store once per `process` (its id); `make` creates the folder of a file:// URL."""
    from obstore.store import LocalStore, MemoryStore, from_url

    if url.startswith("memory:"):
        return MemoryStore() if process == 0 else _opened(url, False, 0)
    if url.startswith("file:"):
        folder = Path(unquote(url.removeprefix("file://")))
        if not make and not folder.is_dir():
            raise FileNotFoundError(str(folder))
        return LocalStore(folder, mkdir=make)
    plain = url.startswith("http:") or os.environ.get("AWS_ENDPOINT_URL", "").startswith("http:")
    client: ClientConfig = {
        "timeout": REQUEST_TIMEOUT,
        "connect_timeout": CONNECT_TIMEOUT,
        "allow_http": plain,
    }
    # Retries are counted in one place, `attempts.patiently`.
    return from_url(url, client_options=client, retry_config={"max_retries": 0})


def fetch_all(
    store: Store, files: Iterable[tuple[str, Path, int]], done: Callable[[int], None] = lambda count: None
) -> None:
    """Download files in parallel; each is given as (name in the store, local path, limit in bytes)."""
    in_parallel((partial(store.fetch, name, path, most) for name, path, most in files), done)
