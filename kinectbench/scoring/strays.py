"""Report files in a folder of predictions that match no target, and suggest their right names."""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import PurePosixPath

from kinectbench.core import printable
from kinectbench.scoring.method_json import NAMED

SUFFIXES = (".npy", ".npz", ".ply", ".obj")
# Mesh formats that are not supported; a file with such a suffix in a prediction's place is reported.
OTHER_MESHES = (".glb", ".gltf", ".stl", ".off")
NO_TARGET = "answers no target of the benchmark"
# A folder without a recording's name that has more files than this has one line (chosen by hand).
FEW = 3
# Maximum number of missing targets that a misspelt name is compared with (chosen by hand).
MOST_COMPARED = 200


def stray_lines(
    stray: Sequence[str],
    missing: Iterable[str],
    recordings: Collection[str] = (),
    answered: Collection[str] = (),
) -> list[str]:
    """Return a line for each of the first 20 files that match no target, and one with the number of others.

    A line suggests a new name if the file's name resembles that of a missing target: it differs only in
    letter case, or in the text around the view's number; or, outside the folders of recordings, it is the
    nearest name with the same numbers. No name is suggested twice. If a folder's name differs from that of a
    recording only in letter case, its files share one line.

    Args:
        stray: names of these files, relative to the method's folder.
        missing: `<recording>/<view>` of targets without a file.
        recordings: names of all recordings.
        answered: recordings that have a file of some target; no folder gets their names.
    """
    names = {_simple(name): name for name in missing}
    folders = {folder.lower(): folder for name in names.values() for folder in [name.partition("/")[0]]}
    of_folders, taken = _of_folders(stray, folders, recordings, answered)
    # {numbers in a name: missing names with these numbers that no stray file equals}
    clear = {_simple(_stem(name)) for name in stray}
    unclear = dict[tuple[int, ...], list[str]]()
    for simple, name in names.items():
        if simple in clear or name.partition("/")[0] in taken:
            continue
        if len(unclear.setdefault(_numbers(name), [])) < MOST_COMPARED:
            unclear[_numbers(name)].append(name)
    lines = dict[str, int]()
    for name in stray:
        top, suffix = name.partition("/")[0], PurePosixPath(name).suffix
        if folders.get(top.lower(), top) != top:
            wanted = folders[top.lower()]
            line = f"{printable(top)}/: its letter case is not that of the benchmark; rename it to {wanted}/"
        elif top in of_folders:
            line = of_folders[top]
        elif name in folders.values():
            line = f"{printable(name)}: no folder; put a folder of this name there, with its predictions"
        else:
            may_be_meant, stem, advice = (
                suffix.lower() in (*SUFFIXES, *OTHER_MESHES),
                _stem(name),
                "move it away",
            )
            if may_be_meant and (meant := names.pop(_simple(stem), None)):
                advice = f"rename it to {meant}{suffix.lower()}"
            elif may_be_meant and top not in recordings and len(lines) < NAMED:
                candidates = unclear.get(_numbers(stem), [])
                for near in get_close_matches(stem, candidates, 1):
                    candidates.remove(near)
                    advice = f"rename it to {near}{suffix.lower()}, the nearest that is missing, or {advice}"
            line = f"{printable(name)}: {NO_TARGET}; {advice}"
        if line in lines or len(lines) < NAMED:
            lines[line] = lines.get(line, 0) + 1
    more = len(stray) - sum(lines.values())
    return [*lines, *[f"and {more} more files that answer no target of the benchmark"] * (more > 0)]


def _of_folders(
    stray: Sequence[str], folders: Mapping[str, str], recordings: Collection[str], answered: Collection[str]
) -> tuple[dict[str, str], set[str]]:
    """Return {folder: its line} for folders that have no recording's name.

    A folder gets a line if it has more than `FEW` files, or if folders of recordings in it can be moved up.

    Args:
        stray: names of all files, as in `stray_lines`.
        folders: {name in lower case: name} of recordings that lack some file.
        recordings: names of all recordings.
        answered: names of recordings that have some file.

    Returns:
        The lines, and the names of recordings that they suggest.
    """
    tops = {name.partition("/")[0].lower() for name in stray}
    unused = {folder for lower, folder in folders.items() if lower not in tops}.difference(answered)
    free = set(unused)
    inside, nested = Counter[str](), dict[str, set[str]]()
    for name in stray:
        top, *parts = name.split("/")
        if parts and top not in recordings and top.lower() not in folders:
            inside[top] += 1
            nested.setdefault(top, set()).update({parts[0]}.intersection(recordings if parts[1:] else ()))
    lines = dict[str, str]()
    for top, within in nested.items():
        if within and within <= free:
            free -= within
            lines[top] = f"{printable(top)}/: has {min(within)}/ in it; move what is in it up"
    large = [top for top, files in inside.items() if files > FEW and recordings and top not in lines]
    for top in large[:NAMED]:
        by_lower = {name.lower(): name for name in sorted(free) if _numbers(name) == _numbers(top)}
        meant = ""
        for near in get_close_matches(top.lower(), list(by_lower)[:MOST_COMPARED], 1):
            free.remove(by_lower[near])
            meant = f"rename it to {by_lower[near]}/, the nearest that is missing, or "
        said = f"no recording of the benchmark has this name ({inside[top]} files); {meant}move it away"
        lines[top] = f"{printable(top)}/: {said}"
    return lines, unused - free


def _stem(name: str) -> str:
    return name.removesuffix(PurePosixPath(name).suffix)


def _numbers(name: str) -> tuple[int, ...]:
    return tuple(map(int, re.findall(r"[0-9]+", name)))


def _simple(name: str) -> str:
    """Return `<folder>/<file>` in lower case; of a file's name with a single number, only this number."""
    folder, _, file = name.lower().rpartition("/")
    numbers = re.findall(r"\d+", file)
    return f"{folder}/{numbers[0].lstrip('0') if len(numbers) == 1 else file}"
