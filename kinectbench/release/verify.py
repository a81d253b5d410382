"""Check a release, every byte and every pair of it."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from kinectbench.errors import KinectBenchError, PairError, ReleaseError
from kinectbench.release.layout import (
    BENCHMARK_JSON,
    SHA256SUMS,
    SPLITS_JSON,
    TARGETS_CSV,
    benchmark_sha256,
    read_sums,
    release_files,
)
from kinectbench.release.metadata import ReleaseInfo, read_metadata, read_text, strict_json
from kinectbench.release.pair_check import pair_problems
from kinectbench.release.release import Target, check_splits, parse_targets, recordings_by_split
from kinectbench.voxels.pair_file import read_pair
from kinectbench.workspace import sha256_file

Progress = Callable[[int, int], None]


def verify(path: Path, progress: Progress | None = None) -> list[str]:
    """Say everything that is wrong with a release.

    Args:
        path: the release's folder.
        progress: called with (files and pairs done, files and pairs in all).

    Returns:
        One line per problem, each naming a file relative to the release; empty if all is well. A file that
        is not the published one is named once and looked at no further.

    Raises:
        ReleaseError: there is no release at all.
    """
    if not path.is_dir() or not any((path / name).is_file() for name in (BENCHMARK_JSON, SHA256SUMS)):
        raise ReleaseError(f"{path}: no release there; run publish or download one")
    try:
        text = read_text(path / SHA256SUMS)
        sums = read_sums(text, SHA256SUMS)
    except ReleaseError as error:
        return [_relative(error, path)]
    pairs = [name for name in sums if name.startswith("pairs/")]
    total = len(sums) + len(pairs)
    damaged: dict[str, str] = {}
    for done, name in enumerate(sums, start=1):
        problem = _byte_problem(path / name, sums[name])
        if problem:
            damaged[name] = f"{name}: {problem}"
        if progress:
            progress(done, total)
    lines = [*damaged.values(), *_extra_files(path, sums)]
    metadata, targets = _small_files(path, text, damaged, lines)
    lines += _target_problems(targets, sums)
    for done, name in enumerate(pairs, start=len(sums) + 1):
        if metadata and name not in damaged:
            lines += _pair_lines(path, name, metadata)
        if progress:
            progress(done, total)
    return lines


def _byte_problem(file: Path, sha256: str) -> str | None:
    """What is wrong with the bytes of one file, or None."""
    if file.is_symlink():
        return "a link instead of the file that was published"
    if not file.is_file():
        return "missing"
    try:
        return None if sha256_file(file) == sha256 else "changed since it was published (SHA-256 differs)"
    except OSError as error:
        return f"cannot be read ({error.strerror})"


def _extra_files(path: Path, sums: Mapping[str, str]) -> Iterator[str]:
    """Files that were not published, and folders that lead elsewhere."""
    for file in release_files(path):
        name = file.relative_to(path).as_posix()
        if name not in sums:
            yield f"{name}: not part of the release"


def _small_files(
    path: Path, sums: str, damaged: Mapping[str, str], lines: list[str]
) -> tuple[ReleaseInfo | None, tuple[Target, ...]]:
    """benchmark.json and the targets; what is wrong with them and splits.json is added to `lines`.

    A damaged file is still read if it can be, but its faults are not named a second time.
    """
    metadata: ReleaseInfo | None = None
    targets: tuple[Target, ...] = ()
    found: list[tuple[str, str]] = []
    try:
        metadata = read_metadata(path)
        if metadata.benchmark_sha256 != benchmark_sha256(sums):
            found.append((SHA256SUMS, f"{SHA256SUMS}: not the list that {BENCHMARK_JSON} names"))
    except ReleaseError as error:
        found.append((BENCHMARK_JSON, _relative(error, path)))
    try:
        targets = parse_targets(read_text(path / TARGETS_CSV), TARGETS_CSV)
        check_splits(targets, TARGETS_CSV)
    except ReleaseError as error:
        found.append((TARGETS_CSV, _relative(error, path)))
    try:
        splits = strict_json(read_text(path / SPLITS_JSON), SPLITS_JSON)
        if splits != recordings_by_split(targets) and TARGETS_CSV not in damaged:
            found.append((SPLITS_JSON, f"{SPLITS_JSON}: does not agree with {TARGETS_CSV}"))
    except ReleaseError as error:
        found.append((SPLITS_JSON, _relative(error, path)))
    lines += [line for name, line in found if name not in damaged]
    return metadata, targets


def _target_problems(targets: tuple[Target, ...], sums: Mapping[str, str]) -> Iterator[str]:
    """Lines of targets.csv without a pair file, pair files without a line, and other hashes."""
    if not targets:
        return
    listed = {target.file: target.sha256 for target in targets}
    for name, sha256 in listed.items():
        if name not in sums:
            yield f"{TARGETS_CSV}: {name} is not part of the release"
        elif sums[name] != sha256:
            yield f"{TARGETS_CSV}: another SHA-256 for {name} than in {SHA256SUMS}"
    for name in sums:
        if name.startswith("pairs/") and name not in listed:
            yield f"{TARGETS_CSV}: no line for {name}"


def _pair_lines(path: Path, name: str, metadata: ReleaseInfo) -> list[str]:
    """What is wrong with one pair."""
    try:
        pair = read_pair(path / name)
    except PairError as error:
        return [_relative(error, path)]
    problems = pair_problems(
        pair,
        min_containment=metadata.settings.pairs.min_containment,
        framing=metadata.framing,
        partial_rule=metadata.partial_rule,
    )
    return [f"{name}: {problem}" for problem in problems]


def _relative(error: KinectBenchError, path: Path) -> str:
    """An error's line, its file named relative to the release."""
    return str(error).replace(f"{path}/", "")
