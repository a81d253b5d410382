"""List the files of a recording: plain files only, a limited number, links only if allowed."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from kinectbench.core import RecordingError, below, printable, scanned

# Largest number of frames: two hours at 30 frames a second.
MOST_FRAMES = 250_000
# Largest number of files: depth, colour, a mask and a confidence image for each frame.
MOST_FILES = 4 * MOST_FRAMES
# Deepest nesting of folders; recordings have less.
MOST_DEPTH = 32
# Largest number of links to folders to follow: a few that link to each other form an endless tree.
MOST_LINKED = 1000
MISSING = "there is no such file or folder; correct the path"
# Characters of a path that a message quotes.
QUOTED = 300


def check_there(path: Path, missing: str = MISSING) -> None:
    """Refuse a missing recording, or a missing file of a recording, with the message `missing`.

    Raises:
        RecordingError: the path is missing or invalid.
    """
    shown = printable(str(path), QUOTED)
    try:
        exists = path.exists()
    except OSError as error:  # such as a name that is too long, or a link to itself
        raise RecordingError(
            f"{shown}: cannot be read ({error.strerror}); correct its path", what="unreadable"
        ) from error
    if not exists:
        raise RecordingError(f"{shown}: {missing}", what="not-found")


def check_count(path: Path, frames: int) -> None:
    """Refuse a recording with more than `MOST_FRAMES` frames.

    Raises:
        RecordingError: it has more frames.
    """
    if frames > MOST_FRAMES:
        raise RecordingError(
            f"{path}: holds more than the {MOST_FRAMES} frames that a recording may have; split it",
            what="too-large",
        )


def listed_name(folder: Path, name: str) -> str:
    """Return a name from a list of a recording's files, relative to the folder of the list.

    A name of Windows, with backslashes between folders, is returned with "/", if no file is so named.

    Raises:
        ValueError: the name leads out of the folder, or is no name; the message says which.
    """
    of_windows = name.replace("\\", "/")
    with suppress(ValueError):
        if of_windows != name and below(folder, name).exists():
            return name
    below(folder, of_windows)
    return of_windows


def files_below(folder: Path, *, follow_links: bool = False) -> list[Path]:
    """List every file in a folder and below it, except hidden ones, sorted.

    A link back to a folder that contains it is skipped.

    Args:
        folder: the folder; it may itself be a link.
        follow_links: whether files and folders in it may be links, too.

    Raises:
        RecordingError: an entry is a link that must not be followed, or no plain file; or there are too many.
        OSError: a folder cannot be read.
    """
    files: list[Path] = []
    for number, (path, plain) in enumerate(
        _entries(folder, frozenset(), follow_links, iter(range(MOST_LINKED)))
    ):
        if number >= MOST_FILES:
            raise RecordingError(
                f"{folder}: holds more than {MOST_FILES} files and folders; name the folder of one recording",
                what="too-large",
            )
        if plain:
            files.append(path)
    return files


def check_link(path: Path, *, follow_links: bool) -> None:
    """Refuse a link, unless links are followed.

    Raises:
        RecordingError: the path is a link.
    """
    if not follow_links and path.is_symlink():
        raise RecordingError(
            f"{path}: is a link, and links in a recording are not followed: copy what it leads to in its "
            "place, or, if you trust where the links lead, write `follow_links: true` beside the recording's "
            "`path:` in benchmark.yaml (`inspect --follow-links`)",
            what="link",
        )


def _entries(
    folder: Path, above: frozenset[tuple[int, int]], follow_links: bool, links: Iterator[int]
) -> Iterator[tuple[Path, bool]]:
    """Yield (path, whether it is a plain file) for everything in a folder and below it, sorted.

    `above` are the folders that contain it, by device and inode; `links` yields one item for each link to a
    folder that may still be followed.
    """
    status = folder.stat()
    identity = status.st_dev, status.st_ino
    if identity in above:
        return
    if len(above) > MOST_DEPTH:
        raise RecordingError(
            f"{printable(str(folder), QUOTED)}: lies too deep; no recording has such folders",
            what="too-large",
        )
    entries = [entry for entry in scanned(folder, MOST_FILES) if not entry.name.startswith(".")]
    # Sorted by name, because sorting paths takes ten times as long.
    for entry in sorted(entries, key=lambda entry: entry.name):
        path = folder / entry.name
        if entry.is_symlink():
            check_link(path, follow_links=follow_links)
        if entry.is_dir():
            if entry.is_symlink() and next(links, None) is None:
                raise RecordingError(
                    f"{path}: holds more than {MOST_LINKED} links to folders; copy what they lead to",
                    what="too-large",
                )
            yield path, False
            yield from _entries(path, above | {identity}, follow_links, links)
        elif entry.is_file():
            yield path, True
        else:
            what = "a link that leads nowhere" if entry.is_symlink() else "a pipe, a socket or a device"
            raise RecordingError(
                f"{path}: is no plain file but {what}; a recording cannot hold it: remove it", what="link"
            )
