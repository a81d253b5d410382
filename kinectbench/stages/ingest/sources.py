"""The files of a recording: plain ones, a bounded number, links only if allowed."""

from collections.abc import Iterator
from pathlib import Path

from kinectbench.core.errors import RecordingError
from kinectbench.core.untrusted import printable, scanned

# Two hours at 30 frames a second.
MOST_FRAMES = 250_000
# Depth, colour, a mask and a confidence of each frame.
MOST_FILES = 4 * MOST_FRAMES
# No recording's folders lie deeper in each other.
MOST_DEPTH = 32
# Links to folders that are followed: a few that link to each other are a tree without end.
MOST_LINKED = 1000
MISSING = "there is no such file or folder; correct the recording's `path:`"
# Characters of a path that a message quotes.
QUOTED = 300


def check_there(path: Path, missing: str = MISSING) -> None:
    """Refuse a missing recording, or a missing file of it.

    Args:
        path: the file or folder.
        missing: the message if there is none.

    Raises:
        RecordingError: there is none, or no such name can be.
    """
    shown = printable(str(path), QUOTED)
    try:
        exists = path.exists()
    except OSError as error:  # a name that is too long, a link to itself
        raise RecordingError(
            f"{shown}: cannot be read ({error.strerror}); correct its path", what="unreadable"
        ) from error
    if not exists:
        raise RecordingError(f"{shown}: {missing}", what="not-found")


def check_count(path: Path, frames: int) -> None:
    """Refuse a recording that has more frames than one may have.

    Raises:
        RecordingError: it has.
    """
    if frames > MOST_FRAMES:
        raise RecordingError(
            f"{path}: holds more than the {MOST_FRAMES} frames that a recording may have; split it",
            what="too-large",
        )


def files_below(folder: Path, *, follow_links: bool = False) -> list[Path]:
    """Every file in a folder and below that is not hidden, sorted.

    A folder that a link leads back to, from inside of it, is passed over.

    Args:
        folder: may be a link itself.
        follow_links: files and folders may be links, too.

    Raises:
        RecordingError: one is a link that is not to be followed, or no plain file; or there are too many.
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
    """Refuse a link that is not to be followed.

    Raises:
        RecordingError: it is one.
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
    """Everything in a folder and below, sorted, and whether it is a plain file.

    Args:
        folder: listed with all below.
        above: the folders on the way to it.
        follow_links: links are resolved.
        links: one for each link to a folder that may still be followed.
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
    # By their names: to sort paths takes ten times as long.
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
