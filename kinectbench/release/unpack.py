"""Unpack an untrusted archive into a folder: only plain files, inside the folder, of bounded size."""

import gzip
import stat
import tarfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, BinaryIO, Self

from kinectbench.core import (
    COPIED_BYTES,
    MOST_LISTED,
    StorageError,
    below,
    open_plain,
    printable,
    replaced_folder,
    size_of,
    unpacked_bound,
)
from kinectbench.core.zip_files import DAMAGED_ZIP, open_zip

# Largest header before a member, such as a long name, bytes: tarfile reads it whole. Linux paths have 4 kB.
HEADER_BYTES = 1 << 20
# First bytes of a gzip file, RFC 1952, section 2.3.1.
GZIP = b"\x1f\x8b"
# First bytes of a .zip, with members and without: PKWARE's APPNOTE.TXT, sections 4.3.7 and 4.3.16.
ZIP = (b"PK\3\4", b"PK\5\6")
# The last three: two members have the same name, or one's name is a folder of the other's.
DAMAGED = (
    *(tarfile.TarError, EOFError, zlib.error, gzip.BadGzipFile, ValueError),
    *DAMAGED_ZIP,
    *(FileExistsError, NotADirectoryError, IsADirectoryError),
)


class TarMember(tarfile.TarInfo):
    """A tar member; reading it raises an error if a header is damaged, missing or too large.

    tarfile by itself would treat such a header as the end of the archive.
    """

    @classmethod
    def frombuf(cls, buf: bytes | bytearray, encoding: str | None, errors: str) -> Self:
        """Parse the header block of a member.

        Raises:
            tarfile.EOFHeaderError: the block is the end of the archive.
            tarfile.ReadError: the block is damaged or missing, or announces an extended header that is too
                large.
        """
        try:
            member = super().frombuf(buf, encoding or "utf-8", errors)
        except tarfile.EOFHeaderError:  # type: ignore[attr-defined] # the stubs lack it
            raise
        except tarfile.HeaderError as error:
            raise tarfile.ReadError("a header is damaged, or the end is missing") from error
        plain = member.type in tarfile.REGULAR_TYPES or member.type not in tarfile.SUPPORTED_TYPES
        if not plain and member.size > HEADER_BYTES:
            raise tarfile.ReadError(f"a header of {member.size} bytes")
        return member


def unpack_archive(archive: Path, folder: Path) -> None:
    """Unpack a .tar, .tgz or .zip, recognised by its content, into `folder`.

    If the archive holds only a single folder, the content of that folder is unpacked; this is repeated if the
    content is a single folder again. `folder` appears whole or not at all. Links, devices and hidden files
    are skipped.

    Raises:
        StorageError: the archive is damaged, holds no such file, leads out of the folder or unpacks to too
            much; or the disk is full.
    """
    try:
        with replaced_folder(folder) as temporary:
            with open_plain(archive) as file:
                # By its first bytes: a .tar may end in a .zip, whose end `zipfile` would find.
                is_zip = file.read(4) in ZIP
                file.seek(0)
                members = _of_zip(file) if is_zip else _of_tar(file)
                _unpack(members, temporary, unpacked_bound(size_of(file)))
            inside = list(temporary.iterdir())
            if not inside:
                raise ValueError("it holds no file")
            while len(inside) == 1 and inside[0].is_dir():
                alone = inside[0].rename(temporary / ".alone")
                for each in alone.iterdir():
                    each.rename(temporary / each.name)
                alone.rmdir()
                inside = list(temporary.iterdir())
    except DAMAGED as error:
        raise StorageError(f"{archive}: cannot be unpacked ({printable(str(error), 120)})") from error


@dataclass(frozen=True)
class _Part:
    """An archive's member: name, stated size, and a function that opens it (None if it is no plain file)."""

    name: str
    size: int
    content: Callable[[], IO[bytes] | None] | None


def _of_tar(file: BinaryIO) -> Iterator[_Part]:
    """Yield the members of a .tar or .tgz, in the archive's order."""
    packed = file.read(2) == GZIP
    file.seek(0)
    content = gzip.GzipFile(fileobj=file) if packed else file
    with tarfile.open(fileobj=content, mode="r|", tarinfo=TarMember) as members:
        for member in members:
            opened = partial(members.extractfile, member) if member.isreg() else None
            yield _Part(member.name, member.size, opened)
    most = unpacked_bound(size_of(file))
    try:
        while packed and content.read(COPIED_BYTES):  # gzip's checksum stands at the end
            if content.tell() > most:
                raise ValueError(f"it unpacks to more than {most} bytes")
    except gzip.BadGzipFile as error:
        if "Not a gzipped file" not in str(error):  # further bytes behind the archive are passed over
            raise


def _of_zip(file: BinaryIO) -> Iterator[_Part]:
    """Yield the members of a .zip, in the archive's order; links and folders get no content."""
    with open_zip(file, MOST_LISTED, unpacked_bound(size_of(file))) as archive:
        for member in archive.infolist():
            is_link = stat.S_ISLNK(member.external_attr >> 16)
            yield _Part(
                member.filename,
                member.file_size,
                None if is_link or member.is_dir() else partial(archive.open, member),
            )


def _unpack(members: Iterator[_Part], folder: Path, most_bytes: int) -> None:
    left = most_bytes
    for count, member in enumerate(members):
        if left < member.size or count == MOST_LISTED:
            raise ValueError(f"it unpacks to more than {most_bytes} bytes or too many files")
        name = member.name.removeprefix("./")
        if member.content is None or any(part.startswith(".") for part in name.split("/") if part != ".."):
            left -= member.size
            continue
        path = below(folder, name)
        path.parent.mkdir(parents=True, exist_ok=True)
        source = member.content()
        assert source is not None
        with path.open("xb") as out:
            while part := source.read(COPIED_BYTES):
                left -= len(part)
                if left < 0:  # a .zip may state any size
                    raise ValueError(f"it unpacks to more than {most_bytes} bytes")
                out.write(part)
