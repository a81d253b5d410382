"""A zip archive that is read in place: nothing is unpacked to disk, and no more than a bound into memory."""

import re
import zipfile
import zlib
from dataclasses import dataclass, field
from pathlib import Path

from kinectbench.core.errors import RecordingError
from kinectbench.stages.ingest.images import DamagedImageError

# Of a zip archive's first local header (APPNOTE.TXT 4.3.7).
MAGIC = b"PK\x03\x04"
# Names of the first members lie in the first bytes, and those of the last in the last (own choice).
END_BYTES = 1 << 16
# An image or JSON of a recording is smaller: 16-bit depth of 4096x4096 pixels has 32 MB (own choice).
LARGEST_MEMBER_BYTES = 64 << 20
# What zipfile raises for an archive that is damaged, encrypted, or packed in a way it does not know.
DAMAGE = (zipfile.BadZipFile, zlib.error, EOFError, ValueError, RuntimeError, NotImplementedError)


@dataclass
class Archive:
    """Members of a zip archive by name; opened when first asked, once in each process."""

    path: Path
    _zip: zipfile.ZipFile | None = field(default=None, repr=False)

    def __reduce__(self) -> tuple[type["Archive"], tuple[Path]]:
        """Another process opens the archive itself."""
        return Archive, (self.path,)

    def names(self) -> list[str]:
        """The names of all members.

        Raises:
            RecordingError: the archive is damaged or cut off.
        """
        return self._opened().namelist()

    def read(self, name: str) -> bytes:
        """A member, unpacked.

        Raises:
            DamagedImageError: it is missing, damaged, encrypted, or larger than an image can be.
        """
        where = f"{self.path}: {name}"
        try:
            info = self._opened().getinfo(name)
            if info.file_size > LARGEST_MEMBER_BYTES:
                raise DamagedImageError(
                    f"{where}: says that it unpacks to {info.file_size} bytes; it is no image"
                )
            if info.compress_size > self.path.stat().st_size:
                raise DamagedImageError(f"{where}: says that it is larger than the archive; it is damaged")
            with self._opened().open(info) as member:
                return member.read(LARGEST_MEMBER_BYTES)
        except KeyError as error:
            raise DamagedImageError(f"{where}: the archive does not hold it") from error
        except DAMAGE as error:
            raise DamagedImageError(f"{where}: cannot be unpacked ({error})") from error

    def _opened(self) -> zipfile.ZipFile:
        if self._zip is None:
            try:
                self._zip = zipfile.ZipFile(self.path)
            except DAMAGE as error:
                raise RecordingError(
                    f"{self.path}: the archive is cut off or damaged ({error}); copy it again"
                ) from error
        return self._zip


def holds(path: Path, member: re.Pattern[bytes]) -> bool:
    """Whether a file is a zip archive whose first or last members include such a name; it may be cut off."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        start = file.read(END_BYTES)
        if not start.startswith(MAGIC):
            return False
        file.seek(max(0, path.stat().st_size - END_BYTES))
        return any(member.search(part) for part in (start, file.read(END_BYTES)))
