"""Find files and folders by the names that readers know, in any case, and names that nearly match."""

from collections.abc import Collection, Iterable
from difflib import get_close_matches
from functools import lru_cache
from itertools import islice
from pathlib import Path

from kinectbench.core import printable, scanned

# Names from this similarity on are taken for misspelled (difflib's ratio, chosen by hand: of depths.txt to
# depth.txt it is 0.95, of mask to masks 0.89), among the first so many entries of a folder.
SIMILAR, LOOKED_AT = 0.85, 20_000


def in_any_case(folder: Path, name: str) -> Path:
    """Return the folder's entry of this name, or else the only one that differs from it in case alone.

    The path with the name as given is returned if there is no such entry, or several.
    """
    exact = folder / name
    if exact.exists():
        return exact
    same = [entry for entry in _entries(folder) if entry.lower() == name.lower()]
    return folder / same[0] if len(same) == 1 else exact


def first_named(folder: Path, names: Iterable[str]) -> Path | None:
    """Return the folder's file of the first of these names that it has, in any case; None if of none."""
    return next((file for name in names if (file := in_any_case(folder, name)).is_file()), None)


def misnamed(folder: Path, known: Collection[str]) -> list[str]:
    """Return a line on each entry whose name is nearly one of `known`, in lower case, that the folder lacks.

    Args:
        folder: a recording's folder; of anything else there is no line.
        known: names of files, with their suffix, and of folders, without.
    """
    entries = _entries(folder)
    there = {name.lower() for name in entries}
    lines = []
    for name in entries:
        same = [
            each for each in known if Path(each).suffix == Path(name).suffix.lower() and each not in there
        ]
        (near, *_) = get_close_matches(name.lower(), same, 1, SIMILAR) or [""]
        sign = "" if Path(near).suffix else "/"
        if near and (folder / name).is_dir() == bool(sign):
            lines.append(f"{printable(name)}{sign} is not read: rename it to {near}{sign} if it is that")
    return lines


def _entries(folder: Path) -> tuple[str, ...]:
    """Return the names in a folder, sorted; none if it is no folder. Of large ones, not all are returned."""
    return _listed(folder, folder.stat().st_mtime_ns) if folder.is_dir() else ()


@lru_cache(maxsize=2)
def _listed(folder: Path, mtime_ns: int) -> tuple[str, ...]:
    """Do as `_entries`; a folder that has not changed since, by its `mtime_ns`, is listed once."""
    return tuple(sorted(entry.name for entry in islice(scanned(folder), LOOKED_AT)))
