"""Find files and folders by the names that readers know, in any case, and names that nearly match."""

from collections.abc import Collection, Iterator
from difflib import get_close_matches
from functools import lru_cache
from itertools import islice
from pathlib import Path

from kinectbench.core import printable, scanned

# Names from this similarity on are taken for misspelled (difflib's ratio, chosen by hand: of depths.txt to
# depth.txt it is 0.95, of mask to masks 0.89), if their lengths differ by at most so many characters.
SIMILAR, LENGTHS_APART = 0.85, 2
# In folders with more entries, only names as given are found.
LOOKED_AT = 20_000


def in_any_case(folder: Path, name: str) -> Path:
    """Return the folder's entry of this name, or else the only one that differs from it in case alone.

    The path with the name as given is returned if there is no such entry, or several.
    """
    exact = folder / name
    if exact.exists():
        return exact
    same = [entry for entry in _entries(folder) if entry.lower() == name.lower()]
    return folder / same[0] if len(same) == 1 else exact


def in_order(folder: Path, names: Collection[str]) -> Iterator[Path]:
    """Yield the folder's path of each name as given, and then of each as `in_any_case` finds it."""
    yield from (folder / name for name in names)
    yield from (in_any_case(folder, name) for name in names)


def first_named(folder: Path, names: Collection[str]) -> Path | None:
    """Return the first file of `in_order`; None if there is none."""
    return next((file for file in in_order(folder, names) if file.is_file()), None)


def misnamed(folder: Path, known: Collection[str]) -> list[str]:
    """Return a line on each entry whose name is nearly one of `known`, in lower case, that the folder lacks.

    There is also a line on entries that are not read, because their names differ in case alone.

    Args:
        folder: a recording's folder; of anything else there is no line.
        known: names of files, with their suffix, and of folders, without.
    """
    entries = _entries(folder)
    there = {each: [name for name in entries if name.lower() == each] for each in known}
    lines = [
        f"{printable(' and '.join(names))} differ in case alone: rename the right one to {each}"
        for each, names in there.items()
        if len(names) > 1 and each not in names
    ]
    for name in entries:
        same = [
            each
            for each in known
            if not there[each]
            and abs(len(each) - len(name)) <= LENGTHS_APART
            and Path(each).suffix == Path(name).suffix.lower()
        ]
        (near, *_) = (same and get_close_matches(name.lower(), same, 1, SIMILAR)) or [""]
        sign = "" if Path(near).suffix else "/"
        if near and (folder / name).is_dir() == bool(sign):
            lines.append(f"{printable(name)}{sign} is not read: rename it to {near}{sign} if it is that")
    return lines


def _entries(folder: Path) -> tuple[str, ...]:
    """Return the names in a folder, sorted, without hidden ones; none if it is large, or no folder."""
    return _listed(folder, folder.stat().st_mtime_ns) if folder.is_dir() else ()


@lru_cache(maxsize=2)
def _listed(folder: Path, mtime_ns: int) -> tuple[str, ...]:
    """Do as `_entries`; a folder that has not changed since, by its `mtime_ns`, is listed once."""
    names = [entry.name for entry in islice(scanned(folder), LOOKED_AT + 1)]
    return tuple(sorted(name for name in names if name[0] != ".")) if len(names) <= LOOKED_AT else ()
