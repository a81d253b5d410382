"""A stranger's tar archive becomes a folder: plain files alone, below it, and no more than a bound."""

import gzip
import tarfile
import zlib
from pathlib import Path
from typing import Self

from kinectbench.core.errors import StorageError
from kinectbench.core.storage import replaced_folder
from kinectbench.core.untrusted import (
    COPIED_BYTES,
    MOST_LISTED,
    below,
    open_plain,
    printable,
    size_of,
    unpacked_bound,
)

# Of what stands before a member, such as a long name: tarfile reads it as a whole. Linux has paths of 4 kB.
HEADER_BYTES = 1 << 20
# The last three: of two members one name is the other's, or that of a folder of it.
DAMAGED = (
    *(tarfile.TarError, EOFError, zlib.error, gzip.BadGzipFile, ValueError),
    *(FileExistsError, NotADirectoryError, IsADirectoryError),
)


class _Member(tarfile.TarInfo):
    """A member whose extended headers are small."""

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str | None, errors: str) -> Self:
        """The member of a header block."""
        member = super().frombuf(buf, encoding or "utf-8", errors)
        plain = member.type in tarfile.REGULAR_TYPES or member.type not in tarfile.SUPPORTED_TYPES
        if not plain and member.size > HEADER_BYTES:
            raise tarfile.ReadError(f"a header of {member.size} bytes")
        return member


def unpack_tar(archive: Path, folder: Path) -> None:
    """Unpack a .tgz; a folder that holds all of it is left out. The target appears whole or not at all.

    Links, devices and hidden files are passed over.

    Raises:
        StorageError: it is damaged, leads out of the folder or unpacks to too much; or the disk is full.
    """
    try:
        with replaced_folder(folder) as temporary:
            _unpack(archive, temporary)
            inside = list(temporary.iterdir())
            while len(inside) == 1 and inside[0].is_dir():
                alone = inside[0].rename(temporary / ".alone")
                for each in alone.iterdir():
                    each.rename(temporary / each.name)
                alone.rmdir()
                inside = list(temporary.iterdir())
    except DAMAGED as error:
        raise StorageError(f"{archive}: cannot be unpacked ({printable(str(error), 120)})") from error


def _unpack(archive: Path, folder: Path) -> None:
    with open_plain(archive) as file, gzip.GzipFile(fileobj=file) as content:
        left = unpacked_bound(size_of(file))
        with tarfile.open(fileobj=content, mode="r|", tarinfo=_Member) as members:
            for count, member in enumerate(members):
                left -= member.size
                if left < 0 or count == MOST_LISTED:
                    raise ValueError(
                        f"it unpacks to more than {unpacked_bound(size_of(file))} bytes or too many files"
                    )
                name = member.name.removeprefix("./")
                if not member.isreg() or any(
                    part.startswith(".") for part in name.split("/") if part != ".."
                ):
                    continue
                path = below(folder, name)
                path.parent.mkdir(parents=True, exist_ok=True)
                source = members.extractfile(member)
                assert source is not None
                with path.open("xb") as out:
                    while part := source.read(COPIED_BYTES):
                        out.write(part)
