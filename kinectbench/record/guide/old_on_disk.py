"""A mapping whose oldest values lie on the disk, so that a long recording takes bounded memory."""

import pickle
import tempfile
import threading
from collections.abc import Iterator, MutableMapping
from pathlib import Path
from typing import BinaryIO, Generic, TypeVar

Value = TypeVar("Value")
# Number of values in memory. Reduced images and averaged depth of so many keyframes take 0.4 GB.
MOST_IN_MEMORY = 1000


class _File:
    """A file without a name, which goes with the process; made when it is needed first."""

    def __init__(self, folder: Path | None) -> None:
        self._folder, self._lock = folder, threading.Lock()
        self._file: BinaryIO | None = None

    def __del__(self) -> None:
        if self._file is not None:
            self._file.close()

    def add(self, data: bytes) -> tuple[int, int]:
        """Append data; return its offset and length."""
        with self._lock:
            if self._file is None:
                self._file = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115 - it stays open
            start = self._file.seek(0, 2)
            self._file.write(data)
            return start, len(data)

    def read(self, start: int, length: int) -> bytes:
        """Read what `add` wrote at an offset."""
        with self._lock:
            assert self._file is not None
            self._file.seek(start)
            return self._file.read(length)


class OldOnDisk(MutableMapping[int, Value], Generic[Value]):
    """Values by number; those that were set first are on the disk, the others in memory."""

    def __init__(self, folder: Path | None = None, most: int = MOST_IN_MEMORY) -> None:
        """Start empty.

        Args:
            folder: a folder on the disk to use; None: that of temporary files, which may be in memory.
            most: number of values in memory.
        """
        self._memory, self._places = dict[int, Value](), dict[int, tuple[int, int]]()
        self._file, self._most = _File(folder), most

    def __getitem__(self, key: int) -> Value:
        if key in self._memory:
            return self._memory[key]
        value: Value = pickle.loads(self._file.read(*self._places[key]))  # written by this process
        return value

    def __setitem__(self, key: int, value: Value) -> None:
        self._places.pop(key, None)
        self._memory[key] = value
        if len(self._memory) > self._most:
            oldest = next(iter(self._memory))
            self._places[oldest] = self._file.add(pickle.dumps(self._memory[oldest], pickle.HIGHEST_PROTOCOL))
            del self._memory[oldest]

    def __delitem__(self, key: int) -> None:
        del (self._memory if key in self._memory else self._places)[key]

    def __iter__(self) -> Iterator[int]:
        return iter([*self._places, *self._memory])

    def __len__(self) -> int:
        return len(self._places) + len(self._memory)

    def __copy__(self) -> "OldOnDisk[Value]":
        """Return a copy that does not see later changes; both use one file."""
        copied = OldOnDisk[Value](most=self._most)
        copied._memory, copied._places, copied._file = {**self._memory}, {**self._places}, self._file
        return copied
