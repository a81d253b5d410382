"""Check every byte and every pair of a release, in a folder or in an archive."""

import hashlib
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import cast

import numpy as np

from kinectbench.core import PairError, ReleaseError, StorageError, printable
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, ReleaseInfo
from kinectbench.core.artefacts.targets import (
    SHA256SUMS,
    SPLITS_JSON,
    TARGETS_CSV,
    Splits,
    Target,
    benchmark_sha256,
    check_names,
    parse_sums,
    parse_targets,
)
from kinectbench.core.artefacts.views import ViewRow, ViewsFile
from kinectbench.core.geometry import TOO_FAR, is_rigid
from kinectbench.core.types import Progress, no_progress
from kinectbench.core.voxels.pair_file import TRUTH_KEYS, Pair, PairInput, checked_pair, pair_values
from kinectbench.release.check.agreement_check import Stated, agreement_problems
from kinectbench.release.check.object_check import object_problems, recording_of, surface_lines
from kinectbench.release.check.promises import missing_files, promise_problems
from kinectbench.release.check.text_check import text_problems
from kinectbench.release.check.truth_check import TruthCheck
from kinectbench.release.check.view_check import StatedView, input_problems, pair_problems, view_lines
from kinectbench.release.contents import AGAIN, GLB, OBJECT_FILES, SURFACES, VIEW_IMAGES, Contents
from kinectbench.release.fetch import stored_hashes
from kinectbench.release.opening import open_contents
from kinectbench.release.release import FIRST_LINE, copy_problems, recording_problems, sum_problems

MISSING = f"{{}}: missing; {AGAIN}"
CHANGED = f"{{}}: changed since it was published (SHA-256 differs); {AGAIN}"
EXTRA = "{}: not part of the release; move it away"


def verify(path: Path, progress: Progress = no_progress, *, checksums_only: bool = False) -> list[str]:
    """Return all faults of a release, one line each.

    One file at a time is in memory; an archive is not unpacked.

    Args:
        path: the release's folder, or a .zip, .tar or .tar.gz of it.
        progress: called with (files and pairs done, files and pairs in all).
        checksums_only: whether to check only the SHA-256 of each file, not its content.

    Returns:
        One line per problem, each naming a file relative to the release; empty if all is well. A file with a
        wrong SHA-256 is named once and not checked further, except that the lines of targets.csv are still
        checked.

    Raises:
        ReleaseError: there is no release at all, or its archive is cut off or cannot be trusted.
        SettingsError, StorageError: as in `open_contents`.
    """
    with open_contents(path) as contents:
        try:
            text = contents.text(SHA256SUMS)
            sums = parse_sums(text, SHA256SUMS)
        except ReleaseError as error:
            return [*contents.problems, str(error)]
        pairs = [] if checksums_only else [name for name in sums if name.startswith("pairs/")]
        done, total = 0, len(sums) + len(pairs)
        damaged: dict[str, str] = {}
        for done, name in enumerate(sums, start=1):
            problem = _byte_problem(contents, name, sums[name])
            if problem:
                damaged[name] = problem
            progress(done, total)
        lines = [*contents.problems, *damaged.values(), *_extra_files(contents, sums)]
        if checksums_only:
            return lines + _identity(contents, text, damaged)[1]
        metadata, targets, problems = _small_file_problems(contents, text, sums, damaged)
        lines += problems
        whole = sums.keys() - damaged.keys()
        of_objects = _object_lines(contents, whole, metadata)
        lines += [line for problems in of_objects.values() for line in problems]
        stated = _stated(contents, metadata, targets)
        objects = TruthCheck(contents, whole - of_objects.keys(), metadata)
        for done, name in enumerate(sorted(pairs), start=len(sums) + 1):
            if metadata and name not in damaged:
                lines += _pair_lines(contents, name, metadata, stated.get(name, _StatedPair()), objects)
            progress(done, total)
        lines += [*objects.share_lines(), *objects.key_lines()]
        lines += copy_problems(targets, sums, objects.inputs)
        if metadata is not None:
            for recording in sorted({name.split("/")[1] for name in pairs if name not in damaged}):
                if not metadata.hides(recording) and not metadata.has_solid(recording):
                    lines += surface_lines(contents, recording)
            if not lines and metadata.of_this_version:
                lines += text_problems(contents, metadata, targets)
                lines += promise_problems(contents, metadata, targets, objects.keys)
    return lines


def verify_checksums(url: str, folder: Path, progress: Progress = no_progress) -> list[str]:
    """Check the SHA-256 of every file of a release at a URL; return a message for each fault.

    Files are downloaded, hashed and deleted, so that only a few are on the local disk at a time.

    Args:
        url: URL of the release.
        folder: an empty folder for the downloads.
        progress: called with (files done, files in all).

    Raises:
        ReleaseError: there is no release at all, or its SHA256SUMS is damaged.
        StorageError: the store fails.
    """
    hashes, others = stored_hashes(url, folder, progress)
    with open_contents(folder) as contents:
        text = contents.text(SHA256SUMS)
        damaged = {
            name: MISSING.format(name) if hashes[name] is None else CHANGED.format(name)
            for name, sha256 in parse_sums(text, SHA256SUMS).items()
            if hashes[name] != sha256
        }
        lines = [*map(_extra, others), *damaged.values()]
        return lines + _identity(contents, text, damaged)[1]


def _byte_problem(contents: Contents, name: str, sha256: str) -> str | None:
    """Return a message if a file is missing, unreadable or does not have this SHA-256, else None."""
    entry = contents.entries.get(name)
    if entry is None:
        return MISSING.format(name)
    if entry.problem:
        return f"{name}: {entry.problem}; {AGAIN}"
    try:
        with contents.stream(name) as file:
            digest = hashlib.file_digest(cast(io.BufferedIOBase, file), "sha256").hexdigest()
    except ReleaseError as error:
        return str(error)
    return None if digest == sha256 else CHANGED.format(name)


def _extra_files(contents: Contents, sums: Mapping[str, str]) -> Iterator[str]:
    """Yield a message for each file or empty folder that SHA256SUMS does not list."""
    # An empty folder of missing files is not reported: the files are.
    folders = {f"{above}/" for name in sums for above in PurePosixPath(name).parents}
    for name in contents.entries:
        if name not in sums and name != SHA256SUMS and name not in folders:
            yield _extra(name)


def _extra(name: str) -> str:
    return EXTRA.format(printable(name, 200))


def _object_lines(
    contents: Contents, whole: Iterable[str], metadata: ReleaseInfo | None
) -> dict[str, list[str]]:
    """Return {file name: its faults} for each faulty mesh, volume or GLB of an object with public truth."""
    lines: dict[str, list[str]] = {}
    for name in sorted(whole):
        parts = name.split("/")
        is_object = parts[0] == "objects" and (parts[-1] in OBJECT_FILES or name.endswith(GLB))
        is_open = is_object and metadata is not None and not metadata.hides(recording_of(name))
        if is_open and (problems := list(object_problems(contents, name))):
            lines[name] = problems
    return lines


@dataclass
class _StatedPair:
    """The facts about a pair that targets.csv and views.json state.

    Attributes:
        unknown_shares: {file name: unknown share of the true shape that this file states}.
        shown: what views.json states about the pair's view.
    """

    unknown_shares: dict[str, float] = field(default_factory=dict)
    shown: StatedView = field(default_factory=StatedView)


def _stated(
    contents: Contents, metadata: ReleaseInfo | None, targets: Sequence[Target]
) -> dict[str, _StatedPair]:
    """Return {pair file: the facts about the pair that targets.csv and views.json state}."""
    stated = {target.file: _StatedPair() for target in targets}
    for target in targets:
        if target.unknown_share is not None:
            stated[target.file].unknown_shares[TARGETS_CSV] = target.unknown_share
    if metadata is None:
        return stated
    for recording in metadata.recordings:
        try:
            views = ViewsFile.parse(contents.text(f"views/{recording}/views.json"), ViewsFile.FILE)
        except (ReleaseError, StorageError):  # reported elsewhere
            continue
        # A held-back recording has no warnings.
        has_too_far = metadata.hides(recording) or any(TOO_FAR in line for line in views.warnings)
        for row in views.views:
            of_pair = stated.setdefault(f"pairs/{recording}/{row.view}.npz", _StatedPair())
            of_pair.shown = StatedView(row, has_too_far)
            if row.unknown_share is not None:
                of_pair.unknown_shares[ViewsFile.FILE] = row.unknown_share
    return stated


def _view_problems(pair: Pair | PairInput, view: ViewRow | None) -> Iterator[str]:
    """Yield a message if a pair's camera pose or intrinsics differ from views.json."""
    for name in ("T_world_camera", "K"):
        stated_value = None if view is None else getattr(view, name)
        if stated_value is not None and not np.array_equal(stated_value, getattr(pair, name)):
            yield f"{name} is not that of {ViewsFile.FILE}"


def _pair_lines(
    contents: Contents, name: str, metadata: ReleaseInfo, stated: _StatedPair, objects: TruthCheck
) -> list[str]:
    """Read and check the pair file `name`; `objects` checks its truth. Return a message for each fault."""
    rules = {"framing": metadata.framing, "partial_rule": metadata.partial_rule}
    try:
        values = pair_values(contents.read(name), name)
        recording = name.split("/")[1]
        objects.keys.setdefault(recording, {})[name] = frozenset(values)
        truth = checked_pair(Pair, values, name) if metadata.has_solid(recording) else None
        pair, problems = truth or checked_pair(PairInput, values, name), list[str]()
        seen_from = pair.partial_256.tobytes() + pair.T_world_camera.tobytes()
        objects.inputs[name] = hashlib.blake2b(seen_from).hexdigest()
        if truth is not None:
            info = metadata.recordings.get(recording)
            problems += pair_problems(
                truth,
                min_containment=metadata.settings.pairs.min_containment,
                unknown_shares=stated.unknown_shares,
                surface_sigma_m=None if info is None else info.quality.surface_sigma_m,
                **rules,
            )
        else:
            why = "is held back" if metadata.hides(recording) else "an open mesh does not have"
            held_back = [key for key in values if key in TRUTH_KEYS]
            problems += [f"holds {', '.join(held_back)}, which {why}"] if held_back else []
            problems += input_problems(pair, **rules)
        problems += _view_problems(pair, stated.shown.row)
        lines = [f"{name}: {problem}" for problem in problems]
        if _is_placed(pair):
            lines += view_lines(contents, name, pair, stated.shown, objects.whole)
            lines += [] if truth is None else objects.lines(recording, name, truth)
        return lines
    except (PairError, ReleaseError) as error:
        return [str(error)]


def _is_placed(pair: Pair | PairInput) -> bool:
    """Return whether a pair's matrices are rigid and its cell size is positive, as further checks require."""
    rigid = is_rigid(pair.T_world_grid) and is_rigid(pair.T_world_camera)
    return rigid and 0 < pair.voxel_size_m < np.inf


def _identity(
    contents: Contents, sums_text: str, damaged: Mapping[str, str]
) -> tuple[ReleaseInfo | None, list[str]]:
    """Read benchmark.json and check its `benchmark_sha256`, a hash of SHA256SUMS and of its own content.

    Return benchmark.json (None if unreadable), and a message if it is unreadable or its hash is wrong. If it
    is in `damaged`, {file: message} of files that are reported already, there is no message.
    """
    try:
        stated = contents.text(BENCHMARK_JSON)
        metadata = ReleaseInfo.parse(stated, BENCHMARK_JSON)
    except ReleaseError as error:
        return None, [] if BENCHMARK_JSON in damaged else [str(error)]
    if metadata.benchmark_sha256 != benchmark_sha256(sums_text, stated) and BENCHMARK_JSON not in damaged:
        if metadata.benchmark_sha256_version is None:
            return metadata, [f"{SHA256SUMS}: not the list that {BENCHMARK_JSON} names"]
        return metadata, [
            f"{BENCHMARK_JSON}: its benchmark_sha256 is not of {SHA256SUMS} and of what it says"
        ]
    return metadata, []


def _small_file_problems(
    contents: Contents, sums_text: str, sums: Mapping[str, str], damaged: Mapping[str, str]
) -> tuple[ReleaseInfo | None, tuple[Target, ...], list[str]]:
    """Check the small files (JSON, tables, texts); return benchmark.json or None, the targets, and messages.

    Damaged files are read if possible. They are reported already, so their faults are not reported again,
    except for the lines of targets.csv. benchmark.json is None if it is unreadable.
    """
    metadata, lines = _identity(contents, sums_text, damaged)
    targets: tuple[Target, ...] = ()
    try:
        targets = parse_targets(contents.text(TARGETS_CSV), TARGETS_CSV)
        check_names(targets, TARGETS_CSV)
    except ReleaseError as error:
        known = TARGETS_CSV in damaged and TARGETS_CSV not in contents.entries
        lines += [] if known else [str(error)]
    if not targets:
        return metadata, targets, lines
    has_images = metadata is not None and metadata.of_this_version
    lines += sum_problems(targets, sums)
    lines += _file_problems(targets, sums, has_images)
    if metadata and BENCHMARK_JSON not in damaged:
        lines += recording_problems(targets, metadata)
    if metadata:
        lines += [*missing_files(metadata, targets, sums), *_undeclared_recordings(metadata, sums)]
    if SPLITS_JSON not in damaged and TARGETS_CSV not in damaged:
        lines += _split_problems(contents, targets)
    if metadata and not {BENCHMARK_JSON, TARGETS_CSV} & set(damaged):
        lines += agreement_problems(contents, Stated(targets, metadata, sums), damaged)
    return metadata, targets, lines


def _undeclared_recordings(metadata: ReleaseInfo, sums: Mapping[str, str]) -> Iterator[str]:
    """Yield a message for each recording that has files in the release but no entry in benchmark.json."""
    owners = {name: recording_of(name) for name in sums if name.startswith("objects/")}
    owners |= {name: name.split("/")[1] for name in sums if name.startswith("views/")}
    owners |= {name: PurePosixPath(name).stem for name in sums if name.startswith(f"{SURFACES}/")}
    for owner in sorted(set(owners.values()) - metadata.recordings.keys()):
        name = next(name for name, of in owners.items() if of == owner)
        yield f"{printable(name, 200)}: of a recording that {BENCHMARK_JSON} does not have"


def _file_problems(targets: tuple[Target, ...], sums: Mapping[str, str], has_images: bool) -> Iterator[str]:
    """Yield a message for each missing image of a pair, and each pair file that targets.csv does not list.

    Unless `has_images`, a recording may lack all images, as synthesised views do.
    """
    folders = {name.rpartition("/")[0] for name in sums if name.endswith(".png")}
    for line, target in enumerate(targets, start=FIRST_LINE):
        if has_images or f"views/{target.recording}" in folders:
            for suffix in VIEW_IMAGES:
                image = f"views/{target.recording}/{target.view}{suffix}"
                if image not in sums:
                    yield f"{image}: missing, {TARGETS_CSV} has its pair in line {line}"
    listed = {target.file for target in targets}
    for name in sums:
        if name.startswith("pairs/") and name not in listed:
            yield f"{TARGETS_CSV}: no line for {name}"


def _split_problems(contents: Contents, targets: tuple[Target, ...]) -> Iterator[str]:
    try:
        splits = Splits.parse(contents.text(SPLITS_JSON), SPLITS_JSON)
    except ReleaseError as error:
        yield str(error)
        return
    if splits.json_value() != Splits.of(targets).json_value():
        yield f"{SPLITS_JSON}: does not agree with {TARGETS_CSV}"
