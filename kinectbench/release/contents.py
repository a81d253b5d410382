"""The files of a release: their names, and how they are read in a folder or an archive, in place."""

import tarfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from kinectbench.core import untrusted_text
from kinectbench.core.artefacts.targets import SHA256SUMS
from kinectbench.core.errors import ReleaseError
from kinectbench.core.untrusted import IMAGE_BYTES, decoded, listed_below, open_plain
from kinectbench.core.voxels.npz import UNREADABLE, open_npz
from kinectbench.core.voxels.pair_file import MAX_BYTES as PAIR_BYTES
from kinectbench.core.zip_files import DAMAGED_ZIP

CARD = "README.md"
READING = "READING.md"
CROISSANT = "croissant.json"
DATACITE = "datacite.json"
DATASHEET = "datasheet.md"
PREVIEW = "index.html"
CATEGORIES = "categories"
SCHEMAS = "schemas"
SPLIT_TARGETS = "targets"
# previews/<split>/: a table of pairs, and a picture of each.
PREVIEWS, ROWS = "previews", "metadata.jsonl"
# The bytes of each object, and of each view.
OBJECT_FILES = ("mesh.ply", "volume.npz")
# objects/<recording>.glb, and the most that it has: enough for 60,000 triangles with normals.
GLB, MOST_GLB_BYTES = ".glb", 2_000_000
VIEW_IMAGES = (".depth.png", ".mask.png")
# surfaces/<recording>.ply: an open mesh that is the truth, world frame, metres.
SURFACES = "surfaces"
LICENSE = "LICENSE"
CITATION = "CITATION.cff"
CHANGELOG = "CHANGELOG.md"
LINK = "a link; in an archive only plain files are read"
# A text of a release, or another file that is read whole.
MAX_READ_BYTES = 64 << 20
# Files and folders of a release: 70,000 pairs of 1,400 recordings; listing them takes 300 MB.
MOST_FILES = 300_000
# A larger file is no file of a release, and is not hashed: the largest, an object's volume, may unpack to
# 1.25 GiB, and shrinks to a tenth or less.
MOST_FILE_BYTES = 256 << 20
# What an object's volume may unpack to: 5 bytes a cell, of 3 m at 5 mm, or 1.9 m at 3 mm.
VOLUME_BYTES = 5 << 28
# By how a name ends, what is written, checked and made again. A mesh of 128 MB has 3 million vertices, 6
# million triangles, and takes 320 MB to be checked (measured).
MOST_BYTES = {
    "/mesh.ply": 128 << 20,
    "/volume.npz": MOST_FILE_BYTES,
    ".npz": PAIR_BYTES,
    ".png": IMAGE_BYTES,
    GLB: MOST_GLB_BYTES,
}
# What zipfile, tarfile and gzip raise of damaged files.
DAMAGED = (*DAMAGED_ZIP, tarfile.TarError)


def surface_name(recording: str) -> str:
    """The open mesh that is the truth of a recording."""
    return f"{SURFACES}/{recording}.ply"


def most_bytes(name: str) -> int:
    """The largest size of a release's file, by its name."""
    return next((most for end, most in MOST_BYTES.items() if name.endswith(end)), MAX_READ_BYTES)


def refuse_large(folder: Path) -> None:
    """Refuse a release with a file that its own check would find too large.

    Raises:
        ReleaseError: it names the file, and says what to do.
    """
    for path in release_files(folder):
        name = path.relative_to(folder).as_posix()
        advice = "build it with a larger fusion.voxel_size_m" if name.startswith("objects/") else "split it"
        size, most = path.stat().st_size, most_bytes(name)
        if size > most:
            raise ReleaseError(
                f"{name}: {size} bytes, of {most} that it may have in a release; {advice}", what="too-large"
            )
        if name.endswith("/volume.npz"):
            try:
                with open_plain(path) as file, open_npz(file, VOLUME_BYTES):
                    pass
            except UNREADABLE as error:
                raise ReleaseError(f"{name}: {error}; {advice}") from error


def release_files(folder: Path) -> Iterator[Path]:
    """Every file and link below a release but SHA256SUMS, sorted; links are not followed.

    Raises:
        ReleaseError: there are too many, or a folder cannot be read.
    """
    if not folder.is_dir():
        return
    try:
        # By their parts, as paths are compared, but one by one that takes longer than to list them.
        files = sorted(listed_below(folder, MOST_FILES), key=lambda path: path.parts)
    except OSError as error:
        raise ReleaseError(
            f"{error.filename or folder}: {error.strerror}; this is no release", what="not-one"
        ) from error
    sums = folder / SHA256SUMS
    yield from (path for path in files if path != sums)


@dataclass(frozen=True)
class Entry:
    """One file.

    Attributes:
        size: bytes, as the folder or archive says.
        opener: opens it, if it has no problem.
        problem: why it must not be opened, or None.
    """

    size: int
    opener: Callable[[], AbstractContextManager[IO[bytes]]]
    problem: str | None = None


@dataclass(frozen=True)
class Contents:
    """The files of a release's folder or archive.

    Attributes:
        entries: every file and link by its name, relative to the release, with "/".
        problems: one line each about what cannot be a file of a release, such as a way out of it.
    """

    entries: Mapping[str, Entry]
    problems: tuple[str, ...] = ()

    def read(self, name: str, limit: int | None = None) -> bytes:
        """The bytes of a file.

        Raises:
            ReleaseError: missing, not a plain file, larger than `limit` bytes (default: what its kind may
                have), or damaged.
        """
        entry = self.entries.get(name)
        if entry is None:
            raise ReleaseError(f"{name}: missing; make or download it again", what="missing-file")
        if entry.problem:
            raise ReleaseError(f"{name}: {entry.problem}; make or download it again")
        if entry.size > (most_bytes(name) if limit is None else limit):
            raise ReleaseError(
                f"{name}: {entry.size} bytes are more than such a file can have", what="too-large"
            )
        with self.stream(name) as file:
            # No more than is said: an entry of an archive may unpack to any size.
            return file.read(entry.size)

    @contextmanager
    def stream(self, name: str) -> Iterator[IO[bytes]]:
        """Open a file that has no problem.

        Raises:
            ReleaseError: it is larger than any file of a release, its bytes are damaged, or cannot be read.
        """
        size = self.entries[name].size
        if size > MOST_FILE_BYTES:
            raise ReleaseError(
                f"{name}: {size} bytes are more than a file of a release can have", what="too-large"
            )
        try:
            with self.entries[name].opener() as file:
                yield file
        except OSError as error:
            reason = error.strerror or error
            raise ReleaseError(f"{name}: cannot be read ({reason}); make or download it again") from error
        except DAMAGED as error:
            # In the archive, or the file in a folder: who reads it checks it here.
            raise ReleaseError(f"{name}: damaged ({error}); make or download it again") from error

    def text(self, name: str, limit: int = MAX_READ_BYTES) -> str:
        """A UTF-8 text file.

        Raises:
            ReleaseError: as `read`, or it is not UTF-8.
        """
        try:
            return decoded(self.read(name, limit), limit, name)
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or error
            raise ReleaseError(f"{name}: cannot be read ({reason}); make or download it again") from error


def release_json(text: str, where: str) -> Any:
    """Parse JSON without NaN and infinities.

    Raises:
        ReleaseError: it is malformed; the line begins with `where`.
    """
    try:
        return untrusted_text.strict_json(text)
    except (ValueError, RecursionError) as error:
        raise ReleaseError(f"{where}: not valid JSON ({error}); make or download it again") from error
