"""Open a published benchmark: its targets and benchmark.json. See contents.py for the files."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from kinectbench.core import ReleaseError, SettingsError, StorageError, decoded, printable
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, ReleaseInfo
from kinectbench.core.artefacts.object import FloorFile
from kinectbench.core.artefacts.targets import (
    SHA256SUMS,
    SPLITS_JSON,
    TARGETS_CSV,
    benchmark_sha256,
    check_names,
    parse_sums,
    parse_targets,
)
from kinectbench.core.artefacts.targets import Target as Target
from kinectbench.core.store.address import other_scheme, shown
from kinectbench.release.contents import MAX_READ_BYTES, OBJECT_FILES, no_release
from kinectbench.release.published import is_there, published_bytes, release_text

FIRST_LINE = 2  # first line of targets.csv with a target


@dataclass(frozen=True)
class Release:
    """An opened release (a published benchmark).

    Attributes:
        folder: the release's folder, archive or URL; file paths may lead into an archive (see published.py).
        targets: the lines of targets.csv, in the same order; each describes one pair.
        metadata: content of benchmark.json.
    """

    folder: Path
    targets: tuple[Target, ...]
    metadata: ReleaseInfo = field(hash=False)  # holds dicts

    @property
    def benchmark_sha256(self) -> str:
        """Hash that identifies the published bytes (see core/artefacts/targets.py)."""
        return self.metadata.benchmark_sha256

    @property
    def categories(self) -> tuple[str, ...]:
        """The sorted names of the targets' categories."""
        return tuple(sorted({target.category for target in self.targets}))

    def split(self, name: str) -> tuple[Target, ...]:
        """Return the targets of one split, in the order of targets.csv."""
        return tuple(target for target in self.targets if target.split == name)

    def of_splits(self, names: Sequence[str]) -> tuple[Target, ...]:
        """Return the targets of some splits: one split after the other, each in the order of targets.csv.

        Raises:
            SettingsError: none of these splits has a pair.
        """
        targets = tuple(target for name in names for target in self.split(name))
        if not targets:
            splits = " and ".join(sorted({target.split for target in self.targets})) or "no split"
            raise SettingsError(
                f"{shown(self.folder)}: no pair of the {' or '.join(names)} split; its pairs are of {splits}",
                what="no-pairs",
            )
        return targets

    def open_split(self, name: str) -> tuple[Target, ...]:
        """Return the targets of one split; empty if its truth is held back or consists of open meshes."""
        return () if name in self.metadata.inputs_only else self.split(name)

    def require_truth(self, splits: Iterable[str], *, solid: bool = True) -> None:
        """Raise an error if one of the splits has pairs without the required truth.

        Args:
            splits: names of splits.
            solid: whether the truth must be a solid; an open mesh has no inside.

        Raises:
            ReleaseError: the truth is held back, or (with `solid`) consists of open meshes.
        """
        splits = tuple(splits)
        if solid and any(split in self.metadata.surface_truth and self.split(split) for split in splits):
            raise ReleaseError(
                f"{shown(self.folder)}: its truth is open meshes without an inside: predict meshes or "
                "points in the camera frame, and declare 'frame': 'camera' in method.json",
                what="surface-truth",
            )
        hidden = [split for split in splits if split in self.metadata.held_back and self.split(split)]
        if hidden:
            raise ReleaseError(
                f"{shown(self.folder)}: the truth of the {' and '.join(hidden)} split is held back; have the "
                "predictions scored by whoever published it, or use the private part "
                f"(benchmark_sha256 {str(self.metadata.private_benchmark_sha256)[:8]}…)",
                what="truth-held-back",
            )

    def pair_path(self, target: Target) -> Path:
        """Return the path of the target's pair file."""
        return self.folder / target.file

    @cached_property
    def sums(self) -> dict[str, str]:
        """The content of SHA256SUMS: {file: hash}."""
        path = self.folder / SHA256SUMS
        return parse_sums(release_text(path), shown(path))

    def content(self, name: str) -> bytes:
        """Return the bytes of a file of the release, named by its path in it.

        Raises:
            ReleaseError: the file is missing, or not the published one.
        """
        return published_bytes(self.folder / name, self.sums.get(name))

    def text(self, name: str) -> str:
        """Return the content of a UTF-8 text file, whose path `name` is relative to the release.

        Raises:
            ReleaseError: as in `content`, or the file is not UTF-8.
        """
        try:
            return decoded(self.content(name), MAX_READ_BYTES, name)
        except (OSError, UnicodeDecodeError) as error:
            raise ReleaseError(f"{shown(self.folder / name)}: not a readable text ({error})") from error

    def floor(self, recording: str) -> FloorFile | None:
        """Read a recording's floor.json; None if there is none, as for synthetic objects.

        Raises:
            ReleaseError: the floor's file is missing, damaged or not the published one.
        """
        name = f"objects/{recording}/{FloorFile.FILE}"
        if name not in self.sums:
            return None
        try:
            return FloorFile.parse(self.text(name), shown(self.folder / name))
        except StorageError as error:
            raise ReleaseError(f"{error}, or download the release again") from error

    @cached_property
    def by_recording(self) -> dict[str, list[Target]]:
        """{recording: its targets}, sorted by the recordings' ids."""
        groups: dict[str, list[Target]] = {}
        for target in sorted(self.targets, key=lambda target: target.recording):
            groups.setdefault(target.recording, []).append(target)
        return groups

    def pair_content(self, target: Target) -> bytes:
        """Return the bytes of a target's pair file.

        Raises:
            ReleaseError: the file is missing, or not the published one.
        """
        return published_bytes(self.pair_path(target), target.sha256)


def open_release(path: Path) -> Release:
    """Open a release, and check the hashes of benchmark.json, splits.json and targets.csv.

    Other files are checked when they are read.

    Args:
        path: the release's folder or URL, or a .zip, .tar or .tar.gz of it, which is read in place.

    Raises:
        ReleaseError: there is no release; it has another format version; one of the three files was changed;
            an object is in two splits; a path leads out of the release; or files contradict each other.
        SettingsError: the URL's scheme is not supported.
        StorageError: the store at the URL fails.
    """
    if not is_there(path / BENCHMARK_JSON):
        if refusal := other_scheme(path):
            raise SettingsError(refusal, what="bad-url")
        raise no_release(path)
    stated = release_text(path / BENCHMARK_JSON)
    metadata = ReleaseInfo.parse(stated, shown(path / BENCHMARK_JSON))
    sums_text = release_text(path / SHA256SUMS)
    if benchmark_sha256(sums_text, stated) != metadata.benchmark_sha256:
        raise ReleaseError(
            f"{shown(path)}: {BENCHMARK_JSON} and {SHA256SUMS} are not the published ones; download the "
            "release again",
            what="changed",
        )
    sums = parse_sums(sums_text, shown(path / SHA256SUMS))
    # Parse the bytes that were hashed: a file may change between two reads.
    published = {BENCHMARK_JSON: b"", SPLITS_JSON: b"", TARGETS_CSV: b""}
    for name in published:
        if not is_there(path / name):
            raise ReleaseError(
                f"{shown(path / name)}: missing; download the release again", what="missing-file"
            )
        published[name] = published_bytes(path / name, sums.get(name))
    if published[BENCHMARK_JSON] != stated.encode():
        raise ReleaseError(
            f"{shown(path / BENCHMARK_JSON)}: changed while it was read; try again", what="being-written"
        )
    targets = parse_targets(_text(path / TARGETS_CSV, published[TARGETS_CSV]), shown(path / TARGETS_CSV))
    check_names(targets, shown(path / TARGETS_CSV))
    for problem in (*recording_problems(targets, metadata), *sum_problems(targets, sums)):
        raise ReleaseError(f"{shown(path)}: {problem}; download the release again, `verify` says more")
    return Release(path, targets, metadata)


def _text(path: Path, content: bytes) -> str:
    try:
        return decoded(content, MAX_READ_BYTES, shown(path))
    except (OSError, UnicodeDecodeError) as error:
        raise ReleaseError(f"{shown(path)}: cannot be read ({error}); download the release again") from error


def recording_problems(targets: Iterable[Target], metadata: ReleaseInfo) -> Iterator[str]:
    """Yield a message for each fact about a recording on which targets.csv and benchmark.json disagree."""
    pairs = Counter[str]()
    for line, target in enumerate(targets, start=FIRST_LINE):
        pairs[target.recording] += 1
        info = metadata.recordings.get(target.recording)
        if info is None:
            yield f"{TARGETS_CSV}, line {line}: {BENCHMARK_JSON} has no recording {target.recording}"
            continue
        for key in ("object", "category", "split"):
            stated, wanted = getattr(target, key), getattr(info, key)
            if stated != wanted:
                yield (
                    f"{TARGETS_CSV}, line {line}: {key} '{stated}' where {BENCHMARK_JSON} has "
                    f"'{printable(wanted)}'"
                )
        kind = "" if info.quality.truth is None else info.quality.truth.kind
        if target.truth != kind:
            yield f"{TARGETS_CSV}, line {line}: truth '{target.truth}' where {BENCHMARK_JSON} has '{kind}'"
        if target.unknown_share is not None and metadata.hides(target.recording):
            yield f"{TARGETS_CSV}, line {line}: holds unknown_share, which is held back"
    for name, info in metadata.recordings.items():
        if pairs[name] != info.pairs:
            stated = f"{pairs[name]} pairs of {printable(name)}"
            yield f"{TARGETS_CSV}: {stated} where {BENCHMARK_JSON} has {info.pairs}"


def sum_problems(targets: Iterable[Target], sums: Mapping[str, str]) -> Iterator[str]:
    """Yield a message for each pair whose hash in targets.csv is not that in SHA256SUMS."""
    for line, target in enumerate(targets, start=FIRST_LINE):
        if target.file not in sums:
            yield f"{TARGETS_CSV}, line {line}: {target.file} is not part of the release"
        elif sums[target.file] != target.sha256:
            yield f"{TARGETS_CSV}, line {line}: another SHA-256 for {target.file} than in {SHA256SUMS}"


def copy_problems(
    targets: Iterable[Target], sums: Mapping[str, str], inputs: Mapping[str, str] = {}
) -> Iterator[str]:
    """Yield a message for each copied pair or mesh: the same content under two names.

    A copy in another split would be trained on before it is scored, and no two real views or recordings give
    the same content. Within a recording pairs are compared, between objects of different splits pairs and
    meshes. Recordings without images are not checked, because collections of CAD models contain copies.

    Args:
        targets: the lines of targets.csv.
        sums: {file: hash} of SHA256SUMS.
        inputs: {pair file: hash of its unpacked `partial_256`}; of others the file's hash is taken.
    """
    folders = {name.rpartition("/")[0] for name in sums if name.endswith(".png")}
    first, lines = dict[object, Target](), dict[tuple[str, str], str]()
    for target in targets:
        if f"views/{target.recording}" not in folders:
            continue
        content = inputs.get(target.file, target.sha256)
        copied = first.setdefault((target.recording, content), target)
        if copied.file != target.file:
            lines[target.file, ""] = f"{target.file}: a copy of {copied.file}; no camera gives one view twice"
        for key in (sums.get(f"objects/{target.recording}/{OBJECT_FILES[0]}"), content):
            other = target if key is None else first.setdefault(key, target)
            if other.object != target.object and other.split != target.split:
                lines[target.recording, other.recording] = (
                    f"{TARGETS_CSV}: {target.recording} ({target.split}) is a copy of {other.recording} "
                    f"({other.split}), though its object is '{target.object}' and not '{other.object}'; name "
                    "one object, in one split"
                )
    yield from lines.values()
