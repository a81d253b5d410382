"""The files of a release: their names, their size limits, and reading them in place."""

import tarfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from kinectbench.core import IMAGE_BYTES, ReleaseError, decoded, listed_below, open_plain, untrusted_text
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON
from kinectbench.core.artefacts.targets import SHA256SUMS
from kinectbench.core.store.address import shown, url_of
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
# previews/<split>/ has a table of the pairs, and a picture of each.
PREVIEWS, ROWS = "previews", "metadata.jsonl"
# Files of each object.
OBJECT_FILES = ("mesh.ply", "volume.npz")
# objects/<recording>.glb, and its largest size: enough for 60,000 triangles with normals.
GLB, MOST_GLB_BYTES = ".glb", 2_000_000
VIEW_IMAGES, COLOR = (".depth.png", ".mask.png"), ".color.jpg"
# surfaces/<recording>.ply: an open mesh that is the truth, world frame, metres.
SURFACES = "surfaces"
LICENSE = "LICENSE"
CITATION = "CITATION.cff"
CHANGELOG = "CHANGELOG.md"
# What to do about a file that is not the published one.
AGAIN = "make or download it again"
EMPTY_FOLDER = "an empty folder"
LINK = "a link; in an archive only plain files are read"
# Largest text or other file of a release that is read at once.
MAX_READ_BYTES = 64 << 20
# How many files and folders a release may have: 70,000 pairs of 1,400 recordings; listing them takes 300 MB.
MOST_FILES = 300_000
# Largest file of a release; larger files are not hashed. The largest kind, an object's volume, may unpack to
# 1.25 GiB, and compresses to a tenth or less.
MOST_FILE_BYTES = 256 << 20
# Limit in bytes to which an object's volume may unpack: 5 bytes a cell, of 3 m at 5 mm, or 1.9 m at 3 mm.
VOLUME_BYTES = 5 << 28
# Largest size by the end of a name, for files that are written, checked and rebuilt. A mesh of 128 MB has 3
# million vertices and 6 million triangles; checking it takes 320 MB (measured).
MOST_BYTES = {
    "/mesh.ply": 128 << 20,
    "/volume.npz": MOST_FILE_BYTES,
    ".npz": PAIR_BYTES,
    ".png": IMAGE_BYTES,
    GLB: MOST_GLB_BYTES,
}
# Exceptions of zipfile, tarfile and gzip for damaged files.
DAMAGED = (*DAMAGED_ZIP, tarfile.TarError)


def surface_name(recording: str) -> str:
    """Return `surfaces/<recording>.ply`, the file of the open mesh that is a recording's truth."""
    return f"{SURFACES}/{recording}.ply"


def most_bytes(name: str) -> int:
    """Return the largest size in bytes that a release's file of this name may have."""
    return next((most for end, most in MOST_BYTES.items() if name.endswith(end)), MAX_READ_BYTES)


def refuse_large(folder: Path) -> None:
    """Raise an error if a release has a file that `verify` would find too large.

    Raises:
        ReleaseError: a file is too large, or a volume.npz is damaged or unpacks to too much; the message
            names the file. Also the errors of `release_files`.
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


def no_release(path: Path) -> ReleaseError:
    """Return the error for a folder, a file, a URL or a missing path in place of a release."""
    if url_of(path) is None and not path.exists():
        return ReleaseError(f"{path}: there is no such file or folder; correct the path", what="not-one")
    advice = "give the folder that `publish` wrote, or that was downloaded"
    return ReleaseError(
        f"{shown(path)}: no release there ({BENCHMARK_JSON} is missing); {advice}", what="not-one"
    )


def release_files(folder: Path, *, with_empty: bool = False) -> Iterator[Path]:
    """Yield the path of every file and link below a release's folder except SHA256SUMS, sorted.

    With `with_empty`, empty folders are yielded, too. Links are not followed. If the folder is missing,
    nothing is yielded.

    Raises:
        ReleaseError: there are too many files, or a folder cannot be read.
    """
    if not folder.is_dir():
        return
    try:
        # Sorted by parts, as paths compare; comparing paths themselves would take longer than listing them.
        files = sorted(listed_below(folder, MOST_FILES, with_empty=with_empty), key=lambda path: path.parts)
    except OSError as error:
        raise ReleaseError(
            f"{error.filename or folder}: {error.strerror}; this is no release", what="not-one"
        ) from error
    sums = folder / SHA256SUMS
    yield from (path for path in files if path != sums)


@dataclass(frozen=True)
class Entry:
    """One file of a release.

    Attributes:
        size: size in bytes, as the folder or archive states it.
        opener: function that opens the file; to be called only if `problem` is None.
        problem: why the file must not be opened; None if it may be opened.
    """

    size: int
    opener: Callable[[], AbstractContextManager[IO[bytes]]]
    problem: str | None = None


@dataclass(frozen=True)
class Contents:
    """The files of a release's folder or archive.

    Attributes:
        entries: {path relative to the release: file}, with "/" between parts; an empty folder ends with "/".
        problems: a message for each invalid name in an archive, such as a path that leads out of the release,
            and for each file beside the release's folder.
    """

    entries: Mapping[str, Entry]
    problems: tuple[str, ...] = ()

    def read(self, name: str, limit: int | None = None) -> bytes:
        """Return the bytes of a file.

        Raises:
            ReleaseError: the file is missing, not plain, damaged, or larger than `limit` bytes; None: the
                limit for files of this name (`most_bytes`).
        """
        entry = self.entries.get(name)
        if entry is None:
            raise ReleaseError(f"{name}: missing; {AGAIN}", what="missing-file")
        if entry.problem:
            raise ReleaseError(f"{name}: {entry.problem}; {AGAIN}")
        if entry.size > (most_bytes(name) if limit is None else limit):
            raise ReleaseError(
                f"{name}: {entry.size} bytes are more than such a file can have", what="too-large"
            )
        with self.stream(name) as file:
            # Read no more than the stated size: an entry of an archive may unpack to any size.
            return file.read(entry.size)

    @contextmanager
    def stream(self, name: str) -> Iterator[IO[bytes]]:
        """Open a file for reading within a `with` block; the file's entry must have no `problem`.

        Raises:
            ReleaseError: the file is damaged, unreadable, or larger than any file of a release may be.
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
            raise ReleaseError(f"{name}: cannot be read ({reason}); {AGAIN}") from error
        except DAMAGED as error:
            # Errors while the caller reads the stream arrive here, too.
            raise ReleaseError(f"{name}: damaged ({error}); {AGAIN}") from error

    def text(self, name: str, limit: int = MAX_READ_BYTES) -> str:
        """Return the text of a UTF-8 file.

        Raises:
            ReleaseError: as in `read`, or the file is not UTF-8, or takes more than `limit` bytes of memory.
        """
        try:
            return decoded(self.read(name, limit), limit, name)
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, "strerror", None) or error
            raise ReleaseError(f"{name}: cannot be read ({reason}); {AGAIN}") from error


def release_json(text: str, where: str) -> Any:
    """Parse JSON without NaN and infinities.

    Raises:
        ReleaseError: the text is malformed; the message begins with `where`.
    """
    try:
        return untrusted_text.strict_json(text)
    except (ValueError, RecursionError) as error:
        raise ReleaseError(f"{where}: not valid JSON ({error}); {AGAIN}") from error
