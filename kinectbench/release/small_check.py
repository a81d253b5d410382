"""Check what a release is counted by: benchmark.json, targets.csv and splits.json, against each other."""

from collections.abc import Iterator, Mapping

from kinectbench.errors import ReleaseError
from kinectbench.release.agreement_check import Stated, agreement_problems
from kinectbench.release.contents import Contents
from kinectbench.release.layout import (
    BENCHMARK_JSON,
    SHA256SUMS,
    SPLITS_JSON,
    TARGETS_CSV,
    benchmark_sha256,
)
from kinectbench.release.metadata import ReleaseInfo, parse_metadata, strict_json
from kinectbench.release.release import Target, check_splits, parse_targets, recordings_by_split

VIEW_FILES = (".depth.png", ".mask.png")
FIRST_LINE = 2  # of targets.csv that holds a target


def check_small_files(
    contents: Contents, sums_text: str, sums: Mapping[str, str], damaged: Mapping[str, str]
) -> tuple[ReleaseInfo | None, list[str]]:
    """Check what the small files say, of themselves and of each other.

    Args:
        contents: the release.
        sums_text: SHA256SUMS.
        sums: the same, parsed.
        damaged: files that are not the published ones, by name. They are still read if they can be, but
            their faults are not named a second time, except for the lines of targets.csv.

    Returns:
        benchmark.json, None if it cannot be read; and one line per problem.
    """
    lines: list[str] = []
    metadata: ReleaseInfo | None = None
    targets: tuple[Target, ...] = ()
    try:
        metadata = parse_metadata(contents.text(BENCHMARK_JSON), BENCHMARK_JSON)
        if metadata.benchmark_sha256 != benchmark_sha256(sums_text) and BENCHMARK_JSON not in damaged:
            lines.append(f"{SHA256SUMS}: not the list that {BENCHMARK_JSON} names")
    except ReleaseError as error:
        lines += [] if BENCHMARK_JSON in damaged else [str(error)]
    try:
        targets = parse_targets(contents.text(TARGETS_CSV), TARGETS_CSV)
        check_splits(targets, TARGETS_CSV)
    except ReleaseError as error:
        known = TARGETS_CSV in damaged and TARGETS_CSV not in contents.entries
        lines += [] if known else [str(error)]
    if not targets:
        return metadata, lines
    lines += _file_problems(targets, sums)
    if metadata and BENCHMARK_JSON not in damaged:
        lines += _recording_problems(targets, metadata)
    if SPLITS_JSON not in damaged and TARGETS_CSV not in damaged:
        lines += _split_problems(contents, targets)
    if metadata and not {BENCHMARK_JSON, TARGETS_CSV} & set(damaged):
        lines += agreement_problems(contents, Stated(targets, metadata, sums), damaged)
    return metadata, lines


def held_back(pair_file: str, metadata: ReleaseInfo) -> bool:
    """Whether the truth of `pairs/<recording>/<view>.npz` is held back."""
    info = metadata.recordings.get(pair_file.split("/")[1])
    return info is not None and info.split in metadata.held_back


def _file_problems(targets: tuple[Target, ...], sums: Mapping[str, str]) -> Iterator[str]:
    """Lines of targets.csv without their files, pair files without a line, and other hashes."""
    # Synthesised views have no images.
    folders = {name.rpartition("/")[0] for name in sums if name.endswith(".png")}
    for line, target in enumerate(targets, start=FIRST_LINE):
        if target.file not in sums:
            yield f"{TARGETS_CSV}, line {line}: {target.file} is not part of the release"
        elif sums[target.file] != target.sha256:
            yield f"{TARGETS_CSV}, line {line}: another SHA-256 for {target.file} than in {SHA256SUMS}"
        if f"views/{target.recording}" in folders:
            for suffix in VIEW_FILES:
                image = f"views/{target.recording}/{target.view}{suffix}"
                if image not in sums:
                    yield f"{image}: missing, {TARGETS_CSV} has its pair in line {line}"
    listed = {target.file for target in targets}
    for name in sums:
        if name.startswith("pairs/") and name not in listed:
            yield f"{TARGETS_CSV}: no line for {name}"


def _recording_problems(targets: tuple[Target, ...], metadata: ReleaseInfo) -> Iterator[str]:
    """Where targets.csv and benchmark.json disagree."""
    for line, target in enumerate(targets, start=FIRST_LINE):
        info = metadata.recordings.get(target.recording)
        if info is None:
            yield f"{TARGETS_CSV}, line {line}: {BENCHMARK_JSON} has no recording {target.recording}"
            continue
        for key in ("object", "category", "split"):
            said, wanted = getattr(target, key), getattr(info, key)
            if said != wanted:
                yield f"{TARGETS_CSV}, line {line}: {key} '{said}' where {BENCHMARK_JSON} has '{wanted}'"
    for name, info in metadata.recordings.items():
        count = sum(target.recording == name for target in targets)
        if count != info.pairs:
            yield f"{TARGETS_CSV}: {count} pairs of {name} where {BENCHMARK_JSON} has {info.pairs}"


def _split_problems(contents: Contents, targets: tuple[Target, ...]) -> Iterator[str]:
    try:
        splits = strict_json(contents.text(SPLITS_JSON), SPLITS_JSON)
    except ReleaseError as error:
        yield str(error)
        return
    if splits != recordings_by_split(targets):
        yield f"{SPLITS_JSON}: does not agree with {TARGETS_CSV}"
