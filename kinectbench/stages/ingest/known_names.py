"""Find files and folders by the names that readers know, in any case, and names that nearly match."""

import re
from collections.abc import Collection, Iterable, Iterator
from difflib import get_close_matches
from fnmatch import fnmatchcase
from functools import lru_cache
from itertools import chain, islice
from pathlib import Path

from kinectbench.core import listed_paths, printable, scanned

# Names from this similarity on are taken for misspelled (difflib's ratio, chosen by hand: of depths.txt to
# depth.txt it is 0.95, of mask to masks 0.89), if their lengths differ by at most so many characters.
SIMILAR, LENGTHS_APART = 0.85, 2
# In folders with more entries, only names as given are found.
LOOKED_AT = 20_000
# The folder of depth and colour of Replica, as NICE-SLAM renders it.
REPLICA_FOLDER = "results"
# Names of files that may contain poses in an unsupported layout.
LIKE_POSES = re.compile(
    r"(?=.*(?:pose|traj|extrin|transform|odom|ground[-_. ]?truth|(?<![a-z])gt(?![a-z])|(?:to_?|2)world|c2w))"
    r".+\.(?:json|txt|np[yz]|log|csv|ya?ml|pkl|mat)|.+\.(?:freiburg|traj|pose)",
    re.IGNORECASE,
)
# A file with the pose of one frame, as pose/000000.npy; or COLMAP's images, which have poses.
IN_POSE_FOLDER = re.compile(
    r"\w*poses?/[^/]+\.(?:json|txt|np[yz])|(?:.*/)?(?:sparse|colmap)(?:/\d+)?/images\.(?:txt|bin)",
    re.IGNORECASE,
)


def in_any_case(folder: Path, name: str) -> Path:
    """Return the folder's entry of this name, or else the only one that differs from it in case alone.

    The path with the name as given is returned if there is no such entry, or several.
    """
    exact = folder / name
    if exact.exists():
        return exact
    same = _by_lower(folder).get(name.lower(), ())
    return folder / same[0] if len(same) == 1 else exact


def in_order(folder: Path, names: Collection[str]) -> Iterator[Path]:
    """Yield the folder's path of each name as given, and then of each as `in_any_case` finds it."""
    yield from (folder / name for name in names)
    yield from (in_any_case(folder, name) for name in names)


def first_named(folder: Path, names: Collection[str]) -> Path | None:
    """Return the first file of `in_order`; None if there is none."""
    return first_file(folder / name for name in names)


def first_file(candidates: Iterable[Path]) -> Path | None:
    """Return the first file of several paths, or of these as `in_any_case` finds each; None without one."""
    files = list(candidates)
    found = chain(files, (in_any_case(file.parent, file.name) for file in files))
    return next((file for file in found if file.is_file()), None)


def is_like_poses(name: str) -> bool:
    """Whether a name, with or without its folder, is one of files that may contain poses."""
    return bool(LIKE_POSES.fullmatch(Path(name).name) or IN_POSE_FOLDER.fullmatch(name))


def visible(folder: Path, *patterns: str) -> list[Path]:
    """List files in a folder that match a pattern, in any case, without hidden files.

    They are in the order of the patterns, and of each pattern those in its own case come last. Patterns are
    those of `fnmatch`; of anything but a folder the list is empty.
    """

    def matches(name: str) -> list[bool]:
        found = [fnmatchcase(name.lower(), each.lower()) for each in patterns]
        return found if any(found) and not name.startswith(".") else []

    def rank(file: Path) -> tuple[int, bool, str]:
        kind = matches(file.name).index(True)
        return kind, fnmatchcase(file.name, patterns[kind]), file.name

    return sorted(listed_paths(folder, wanted=matches), key=rank) if folder.is_dir() else []


def clashing(folder: Path, known: Iterable[str]) -> list[str]:
    """Return a line on each of `known` of which the folder has several entries that differ in case alone."""
    lines, entries = list[str](), _by_lower(folder)
    for each in known:
        names = entries.get(each.lower(), [])
        others = printable(" and ".join(name for name in names if name != each))
        if len(names) > 1 and each in names:
            lines.append(f"{others} is not read beside {each}: rename it, or move it away")
        elif len(names) > 1:
            lines.append(f"{others} differ in case alone: rename the right one to {each}")
    return lines


def misnamed(folder: Path, known: Collection[str]) -> list[str]:
    """Return a line on each entry whose name is nearly one of `known`, in lower case, that the folder lacks.

    There is also a line on entries that are not read, because their names differ in case alone.

    Args:
        folder: a recording's folder; of anything else there is no line.
        known: names of files, with their suffix, and of folders, without.
    """
    entries = _by_lower(folder)
    there = {each: entries.get(each, []) for each in known}
    lines = clashing(folder, known)
    for name in chain(*entries.values()):
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


def _by_lower(folder: Path) -> dict[str, list[str]]:
    """Return the names in a folder, sorted, by each in lower case; without hidden ones.

    There are none if it is large, or no folder.
    """
    return _listed(folder, folder.stat().st_mtime_ns) if folder.is_dir() else {}


@lru_cache(maxsize=16)
def _listed(folder: Path, mtime_ns: int) -> dict[str, list[str]]:
    """Do as `_by_lower`; a folder that has not changed since, by its `mtime_ns`, is listed once."""
    names = [entry.name for entry in islice(scanned(folder), LOOKED_AT + 1)]
    by_lower: dict[str, list[str]] = {}
    for name in sorted(names if len(names) <= LOOKED_AT else ()):
        if name[0] != ".":
            by_lower.setdefault(name.lower(), []).append(name)
    return by_lower
