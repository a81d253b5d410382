"""Check a release, every byte and every pair of it, in a folder or in an archive."""

import hashlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, cast

from kinectbench.errors import PairError, ReleaseError
from kinectbench.release.contents import Contents, open_contents
from kinectbench.release.layout import SHA256SUMS, read_sums
from kinectbench.release.metadata import ReleaseInfo
from kinectbench.release.pair_check import input_problems, pair_problems
from kinectbench.release.small_check import check_small_files, held_back
from kinectbench.voxels.pair_file import checked_pair, pair_values
from kinectbench.voxels.pair_input import TRUTH_KEYS, checked_input

Progress = Callable[[int, int], None]


def verify(path: Path, progress: Progress | None = None) -> list[str]:
    """Say everything that is wrong with a release.

    One file at a time is in memory; an archive is not unpacked.

    Args:
        path: the release's folder, or a .zip, .tar or .tar.gz of it.
        progress: called with (files and pairs done, files and pairs in all).

    Returns:
        One line per problem, each naming a file relative to the release; empty if all is well. A file that
        is not the published one is named once and looked at no further, but the lines of targets.csv.

    Raises:
        ReleaseError: there is no release at all, or its archive is cut off or not to be trusted.
    """
    with open_contents(path) as contents:
        try:
            text = contents.text(SHA256SUMS)
            sums = read_sums(text, SHA256SUMS)
        except ReleaseError as error:
            return [*contents.problems, str(error)]
        pairs = [name for name in sums if name.startswith("pairs/")]
        total = len(sums) + len(pairs)
        damaged: dict[str, str] = {}
        for done, name in enumerate(sums, start=1):
            problem = _byte_problem(contents, name, sums[name])
            if problem:
                damaged[name] = problem
            if progress:
                progress(done, total)
        lines = [*contents.problems, *damaged.values(), *_extra_files(contents, sums)]
        metadata, found = check_small_files(contents, text, sums, damaged)
        lines += found
        for done, name in enumerate(pairs, start=len(sums) + 1):
            if metadata and name not in damaged:
                lines += _pair_lines(contents, name, metadata)
            if progress:
                progress(done, total)
    return lines


def _byte_problem(contents: Contents, name: str, sha256: str) -> str | None:
    """A line about the bytes of one file, or None."""
    entry = contents.entries.get(name)
    if entry is None:
        return f"{name}: missing"
    if entry.problem:
        return f"{name}: {entry.problem}"
    try:
        with contents.stream(name) as file:
            digest = hashlib.file_digest(cast(Any, file), "sha256").hexdigest()
    except ReleaseError as error:
        return str(error)
    return None if digest == sha256 else f"{name}: changed since it was published (SHA-256 differs)"


def _extra_files(contents: Contents, sums: Mapping[str, str]) -> Iterator[str]:
    """Files that were not published."""
    for name in contents.entries:
        if name not in sums and name != SHA256SUMS:
            yield f"{name}: not part of the release"


def _pair_lines(contents: Contents, name: str, metadata: ReleaseInfo) -> list[str]:
    """What is wrong with one pair."""
    rules = {"framing": metadata.framing, "partial_rule": metadata.partial_rule}
    try:
        values = pair_values(contents.read(name), name)
        if not held_back(name, metadata):
            least = metadata.settings.pairs.min_containment
            problems = pair_problems(checked_pair(values, name), min_containment=least, **rules)
            return [f"{name}: {problem}" for problem in problems]
        told = [key for key in values if key in TRUTH_KEYS]
        lines = [f"{name}: holds {', '.join(told)}, which is held back"] if told else []
        problems = input_problems(checked_input(values, name), **rules)
        return [*lines, *(f"{name}: {problem}" for problem in problems)]
    except (PairError, ReleaseError) as error:
        return [str(error)]
