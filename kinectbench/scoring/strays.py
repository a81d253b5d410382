"""Lines on files in a folder of predictions that match no target: how to rename them."""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import PurePosixPath

from kinectbench.core import printable
from kinectbench.scoring.declared import NAMED

SUFFIXES = (".npy", ".npz", ".ply", ".obj")
# Mesh formats that are not supported; a file with such a suffix in a prediction's place is reported.
OTHER_MESHES = (".glb", ".gltf", ".stl", ".off")
NO_TARGET = "answers no target of the benchmark"
# Maximum number of views of a recording that a misspelt name is compared with.
MOST_COMPARED = 200


def stray_lines(stray: Sequence[str], missing: Iterable[str], recordings: Collection[str] = ()) -> list[str]:
    """Return a line for each of the first 20 files that match no target, and one with the number of others.

    Files in a folder whose name differs from a recording's only in letter case have one line together.

    Args:
        stray: names of these files, relative to the method's folder.
        missing: `<recording>/<view>` of targets without a file. If a stray file's name differs from one of
            these only in letter case, or in what is around the number of the view, the line says how to
            rename the file; else it has the nearest of these names, if any is near.
        recordings: names of all recordings; a file in the folder of one is meant for it.
    """
    names = {_simple(name): name for name in missing}
    by_folder = dict[str, list[str]]()
    for name in names.values():
        by_folder.setdefault(name.partition("/")[0], []).append(name)
    folders = {name.lower(): name for name in by_folder}
    lines = dict[str, int]()
    for name in stray:
        top, suffix = name.partition("/")[0], PurePosixPath(name).suffix
        meant = names.get(_simple(name.removesuffix(suffix)))
        if folders.get(top.lower(), top) != top:
            wanted = folders[top.lower()]
            line = f"{printable(top)}/: its letter case is not that of the benchmark; rename it to {wanted}/"
        elif name in folders.values():
            line = f"{printable(name)}: no folder; put a folder of this name there, with its predictions"
        else:
            may_be_meant = suffix.lower() in (*SUFFIXES, *OTHER_MESHES)
            advice = f"rename it to {meant}{suffix.lower()}" if meant and may_be_meant else "move it away"
            looked_for = may_be_meant and not meant and len(lines) < NAMED
            if looked_for and (near := _nearest(name.removesuffix(suffix), by_folder, recordings)):
                advice = f"rename it to {near}{suffix.lower()}, the nearest that is missing, or {advice}"
            line = f"{printable(name)}: {NO_TARGET}; {advice}"
        if line in lines or len(lines) < NAMED:
            lines[line] = lines.get(line, 0) + 1
    more = len(stray) - sum(lines.values())
    return [*lines, *[f"and {more} more files that answer no target of the benchmark"] * (more > 0)]


def _nearest(name: str, by_folder: Mapping[str, Sequence[str]], recordings: Collection[str]) -> str | None:
    """Return the missing target (of {recording: names}) that is nearest to a file's name, if any is near."""
    top = name.partition("/")[0]
    near = [top] if top in recordings else get_close_matches(top, by_folder, 1)
    names = by_folder.get(near[0], ())[:MOST_COMPARED] if near else ()
    return next(iter(get_close_matches(name, names, 1)), None)


def _simple(name: str) -> str:
    """Return `<folder>/<file>` in lower case, with the file's number alone if it has just one."""
    folder, _, file = name.lower().rpartition("/")
    numbers = re.findall(r"\d+", file)
    return f"{folder}/{numbers[0].lstrip('0') if len(numbers) == 1 else file}"
