"""Read settings files: limit their size, keep them inside their folder, and find them by patterns."""

import codecs
import fnmatch
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path

from kinectbench.core import (
    MOST_LISTED,
    SettingsError,
    below,
    decoded,
    lies_below,
    printable,
    read_plain,
    scanned,
)
from kinectbench.core.store.address import is_web, other_scheme, parent_of, shown, url_of
from kinectbench.core.store.attempts import MissingObjectError
from kinectbench.core.store.store import Store

# Enough for ten thousand recordings with a page of text each; the number of values has its own limit.
MOST_BYTES = 16 << 20
# Wildcards; a name without them names one file.
SIGNS = "*?["
INIT = "`kinectbench init FOLDER` writes one for the recordings in FOLDER"


def read_bytes(path: Path, most_bytes: int = MOST_BYTES, missing: str = INIT) -> bytes:
    """Read the bytes of a settings file, on disk, in a store or on a web server.

    A file larger than `most_bytes` is refused; `missing` is the advice if there is none.

    Raises:
        SettingsError: the file is missing, unreadable or too large.
        StorageError: a store cannot be read.
    """
    if (url := url_of(path)) is not None:
        try:
            return Store(parent_of(url)).read(url.rpartition("/")[2], most_bytes)
        except MissingObjectError:
            advice = "copy a benchmark.yaml there" if missing == INIT else missing
            raise SettingsError(f"{shown(url)}: no such file; {advice}", what="no-file") from None
    if path.is_dir():
        raise SettingsError(f"{path}: a folder; name the benchmark.yaml in it", what="no-file")
    try:
        return read_plain(path, most_bytes)
    except FileNotFoundError:
        raise SettingsError(
            other_scheme(path) or f"{path}: no such file; {missing}", what="no-file"
        ) from None
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror or error}", what="unreadable") from None


def as_text(content: bytes, source: str) -> str:
    """Decode the bytes of a file as UTF-8, with or without a byte order mark.

    Raises:
        SettingsError: the bytes are not UTF-8, or the text takes too much memory.
    """
    try:
        return decoded(content.removeprefix(codecs.BOM_UTF8), MOST_BYTES, source)
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise SettingsError(
            f"{source}:{line}: not UTF-8 text; save the file as UTF-8", what="bad-yaml"
        ) from None
    except OSError as error:
        raise SettingsError(
            f"{source}: cannot be read: {error.strerror or error}", what="unreadable"
        ) from None


def matching(folder: Path, pattern: str) -> list[Path]:
    """List the files below a folder that a name or a pattern with "/" between folders matches, sorted.

    A pattern may contain `*`, `?` and `[…]` as in a shell. `**` is refused: it would search all frames of the
    recordings below a benchmark.

    Returns:
        The files that match; there may be none. A name without wildcards is returned even if the file is
        missing.

    Raises:
        ValueError: the pattern leads out of the folder, is hidden, or is invalid; the message says which.
        OSError, StorageError: the files cannot be listed.
    """
    path = below(folder, pattern)
    parts = path.relative_to(folder).parts
    if any("**" in part for part in parts):
        raise ValueError(f"'{printable(pattern)}' looks through folders of any depth; write '*' for each")
    if (url := url_of(folder)) is not None:
        return _matching_there(url, folder, parts)
    paths = [folder]
    for part in parts:
        paths = [way for above in paths for way in _inside(above, part)]
    paths.sort(key=lambda way: way.parts)  # the same order as in a store
    return [way for way in paths if way == path or way.is_file()]


def _matching_there(url: str, folder: Path, parts: tuple[str, ...]) -> list[Path]:
    """List the files in the store at `url` that match a pattern's `parts`, as paths below `folder`."""
    known = list(takewhile(lambda part: not any(sign in part for sign in SIGNS), parts))
    if len(known) == len(parts):
        return [folder.joinpath(*parts)]
    if is_web(url):
        raise ValueError("a web server does not list its files; name each of them")
    names = (each.name.split("/") for each in Store(url).objects("/".join(known)))
    matches = sorted(n for n in names if len(n) == len(parts) and all(map(_matches, n, parts)))
    return [folder.joinpath(*name) for name in matches]


def _matches(name: str, part: str) -> bool:
    """Whether a name matches one part of a pattern; `*` does not match hidden files."""
    return fnmatch.fnmatchcase(name, part) and not name.startswith(".")


def _inside(above: Path, part: str) -> Iterator[Path]:
    """Yield the entries of a folder that match one part of a pattern.

    A part without wildcards yields one path, which is not checked to exist.
    """
    if not any(sign in part for sign in SIGNS):
        yield above / part
    elif above.is_dir():
        names = (entry.name for entry in scanned(above, MOST_LISTED))
        yield from (above / name for name in names if _matches(name, part))


def refuse_outside(path: Path, folder: Path) -> None:
    """Refuse a file whose links lead out of its folder; files in a store are always accepted.

    Raises:
        SettingsError: the links lead out of the folder.
    """
    if url_of(path) is None and path.exists() and not lies_below(path, folder.resolve()):
        raise SettingsError(
            f"{path}: a link that leads out of {folder.resolve()}; copy the file there", what="outside-folder"
        )
