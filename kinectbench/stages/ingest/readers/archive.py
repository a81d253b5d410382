"""Read a zip archive in place: nothing is unpacked to disk, and memory is limited."""

import re
import weakref
import zipfile
from dataclasses import dataclass, field
from pathlib import Path

from kinectbench.core import HEAD_BYTES, RecordingError, open_plain, printable, size_of, unpacked_bound
from kinectbench.core.zip_files import DAMAGED_ZIP, open_zip
from kinectbench.stages.ingest.images import DamagedImageError

# Signature of a zip archive's first local header (APPNOTE.TXT 4.3.7).
MAGIC = b"PK\x03\x04"
# Largest number of members: three for each frame of an hour at 30 frames a second; and bytes per row of the
# directory.
MOST_MEMBERS, ROW_BYTES = 350_000, 128
# Largest image or JSON of a recording: 16-bit depth of 4096x4096 pixels has 32 MB.
LARGEST_MEMBER_BYTES = 64 << 20
PACKED_BY = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
# OSError occurs if a member's offset is before the archive's start.
DAMAGE = (*DAMAGED_ZIP, OSError)


@dataclass
class Archive:
    """The members of a zip archive by name; the archive is opened at first use, once per process."""

    path: Path
    _zip: zipfile.ZipFile | None = field(default=None, repr=False)

    def __reduce__(self) -> tuple[type["Archive"], tuple[Path]]:
        """Pickle the path alone; another process opens the archive itself."""
        return Archive, (self.path,)

    def names(self) -> list[str]:
        """Return the names of all members.

        Raises:
            RecordingError: the archive is damaged or truncated, or its members' names lead out of it.
        """
        return self._opened().namelist()

    def read(self, name: str) -> bytes:
        """Read and unpack a member.

        Raises:
            DamagedImageError: the member is missing, damaged, encrypted, packed in another way than by
                deflate, or too large for an image.
        """
        where = f"{self.path}: {name}"
        try:
            info = self._opened().getinfo(name)
            if info.compress_type not in PACKED_BY:
                raise DamagedImageError(
                    f"{where}: is packed in a way that is not read; zip it again, deflated"
                )
            if info.file_size > LARGEST_MEMBER_BYTES:
                raise DamagedImageError(
                    f"{where}: says that it unpacks to {info.file_size} bytes; it is no image"
                )
            with self._opened().open(info) as member:
                return member.read(LARGEST_MEMBER_BYTES)
        except KeyError as error:
            raise DamagedImageError(f"{where}: the archive does not hold it") from error
        except DAMAGE as error:
            raise DamagedImageError(f"{where}: cannot be unpacked ({error})") from error

    def _opened(self) -> zipfile.ZipFile:
        if self._zip is None:
            file = open_plain(self.path)
            try:
                size = size_of(file)
                archive = open_zip(file, MOST_MEMBERS, unpacked_bound(size), ROW_BYTES)
                _check_members(archive, size)
            except DAMAGE as error:
                file.close()
                raise RecordingError(
                    f"{self.path}: the archive is cut off or damaged ({error}); copy it again"
                ) from error
            weakref.finalize(self, file.close)
            self._zip = archive
        return self._zip


def _check_members(archive: zipfile.ZipFile, size: int) -> None:
    """Refuse an archive if a member's name leads outside, or if its compressed data exceeds its `size`."""
    for name in archive.namelist():
        if name.startswith("/") or ".." in name.split("/") or "\\" in name:
            raise ValueError(f"'{printable(name)}' leads out of it")
    if sum(info.compress_size for info in archive.infolist()) > size:
        raise ValueError("its members are larger than itself")


def holds(path: Path, member: re.Pattern[bytes]) -> bool:
    """Whether a file is a zip archive, perhaps truncated, with a first or last member whose name matches."""
    if not path.is_file():
        return False
    with open_plain(path) as file:
        # The first bytes contain the names of the first members, and the last bytes those of the last.
        start = file.read(HEAD_BYTES)
        if not start.startswith(MAGIC):
            return False
        file.seek(max(0, size_of(file) - HEAD_BYTES))
        return any(member.search(part) for part in (start, file.read(HEAD_BYTES)))
