"""Open a published benchmark: its targets and what `benchmark.json` says. See layout.py for the files."""

import csv
import hashlib
import io
import re
from collections.abc import Iterable
from dataclasses import astuple, dataclass, fields
from functools import cached_property
from pathlib import Path

from kinectbench.config import NAME
from kinectbench.errors import ReleaseError
from kinectbench.release.layout import (
    BENCHMARK_JSON,
    SHA256SUMS,
    SPLITS_JSON,
    TARGETS_CSV,
    benchmark_sha256,
    read_sums,
)
from kinectbench.release.metadata import ReleaseInfo, read_metadata, read_text
from kinectbench.workspace import sha256_file

SPLITS = ("train", "validation", "test")
_VIEW = re.compile(r"[0-9]{3,6}")
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, order=True)
class Target:
    """One line of targets.csv: a pair to be predicted.

    Attributes:
        recording: id of the recording.
        object: the thing recorded; it belongs to one split.
        view: zero-padded index such as "007".
        category: such as "chair".
        split: "train", "validation" or "test".
        file: the pair file, relative to the release, `pairs/<recording>/<view>.npz`.
        sha256: of the pair file, hex.
    """

    recording: str
    object: str
    view: str
    category: str
    split: str
    file: str
    sha256: str

    @property
    def name(self) -> str:
        """`<recording>/<view>`, what messages call it."""
        return f"{self.recording}/{self.view}"


COLUMNS = tuple(field.name for field in fields(Target))


@dataclass(frozen=True)
class Release:
    """A published benchmark that was opened.

    Attributes:
        folder: where it lies.
        targets: every line of targets.csv, in its order.
        metadata: benchmark.json.
    """

    folder: Path
    targets: tuple[Target, ...]
    metadata: ReleaseInfo

    @property
    def benchmark_sha256(self) -> str:
        """Identifies the published bytes (see layout.py)."""
        return self.metadata.benchmark_sha256

    @property
    def categories(self) -> tuple[str, ...]:
        """The categories, sorted."""
        return tuple(sorted({target.category for target in self.targets}))

    def split(self, name: str) -> tuple[Target, ...]:
        """The targets of one split, in the order of targets.csv."""
        return tuple(target for target in self.targets if target.split == name)

    def open_split(self, name: str) -> tuple[Target, ...]:
        """The targets of one split whose truth is here; none of a split that is held back."""
        return () if name in self.metadata.held_back else self.split(name)

    def require_truth(self, splits: Iterable[str]) -> None:
        """Refuse to go on where the truth of a split is needed that is held back.

        Raises:
            ReleaseError: it says where the truth is.
        """
        hidden = [split for split in splits if split in self.metadata.held_back and self.split(split)]
        if hidden:
            raise ReleaseError(
                f"{self.folder}: the truth of the {' and '.join(hidden)} split is held back; have the "
                "predictions scored by whoever published it, or use the private part "
                f"(benchmark_sha256 {str(self.metadata.private_benchmark_sha256)[:8]}…)"
            )

    def pair_path(self, target: Target) -> Path:
        """The target's pair file."""
        return self.folder / target.file

    @cached_property
    def sums(self) -> dict[str, str]:
        """SHA256SUMS: the hash of every file by its path."""
        path = self.folder / SHA256SUMS
        return read_sums(read_text(path), str(path))

    def content(self, name: str) -> bytes:
        """The bytes of a file of the release.

        Args:
            name: its path, relative to the release.

        Raises:
            ReleaseError: it is missing, or not the published one.
        """
        path = self.folder / name
        try:
            content = path.read_bytes()
        except OSError as error:
            raise ReleaseError(f"{path}: cannot be read ({error.strerror}); download it again") from error
        if hashlib.sha256(content).hexdigest() != self.sums.get(name):
            raise ReleaseError(f"{path}: changed since it was published (SHA-256 differs); download it again")
        return content


def open_release(path: Path) -> Release:
    """Open a release, checking that its small files are the published ones (pairs: when they are read).

    Raises:
        ReleaseError: no release there, another format version, targets or benchmark.json changed, an object
            in two splits, or a path that leaves the release.
    """
    if path.is_file():
        raise ReleaseError(f"{path}: a file; unpack the release and give its folder")
    if not (path / BENCHMARK_JSON).is_file():
        raise ReleaseError(
            f"{path}: no release there ({BENCHMARK_JSON} is missing); run publish or download one"
        )
    metadata = read_metadata(path)
    sums_text = read_text(path / SHA256SUMS)
    if benchmark_sha256(sums_text) != metadata.benchmark_sha256:
        raise ReleaseError(f"{path / SHA256SUMS}: not the published list; download the release again")
    sums = read_sums(sums_text, str(path / SHA256SUMS))
    for name in (BENCHMARK_JSON, SPLITS_JSON, TARGETS_CSV):
        if not (path / name).is_file() or sums.get(name) != sha256_file(path / name):
            raise ReleaseError(f"{path / name}: missing or changed since it was published; download it again")
    targets = parse_targets(read_text(path / TARGETS_CSV), str(path / TARGETS_CSV))
    check_splits(targets, str(path / TARGETS_CSV))
    return Release(path, targets, metadata)


def parse_targets(text: str, where: str) -> tuple[Target, ...]:
    """Parse targets.csv; every name and path is safe to join to a folder.

    Raises:
        ReleaseError: a malformed, repeated or unsafe line; it names the line.
    """
    rows = list(csv.reader(io.StringIO(text)))
    if not rows or tuple(rows[0]) != COLUMNS:
        raise ReleaseError(f"{where}, line 1: the columns must be {','.join(COLUMNS)}")
    targets = []
    seen: set[str] = set()
    for line, row in enumerate(rows[1:], start=2):
        problem = _row_problem(row)
        if problem is None and row[COLUMNS.index("file")] in seen:
            problem = f"{row[COLUMNS.index('file')]} is listed twice"
        if problem is not None:
            raise ReleaseError(f"{where}, line {line}: {problem}; download the release again")
        targets.append(Target(*row))
        seen.add(targets[-1].file)
    return tuple(targets)


def _row_problem(row: list[str]) -> str | None:
    """What is wrong with a line of targets.csv, or None."""
    if len(row) != len(COLUMNS):
        return f"{len(row)} columns instead of {len(COLUMNS)}"
    target = Target(*row)
    if not all(NAME.fullmatch(name) for name in (target.recording, target.object, target.category)):
        return "a name with other characters than letters, digits, '.', '_' and '-'"
    if not _VIEW.fullmatch(target.view):
        return f"view '{target.view}' is not a zero-padded index"
    if target.split not in SPLITS:
        return f"split '{target.split}' is none of {', '.join(SPLITS)}"
    if target.file != f"pairs/{target.recording}/{target.view}.npz":
        return f"file '{target.file}' is not pairs/{target.recording}/{target.view}.npz"
    return None if _SHA256.fullmatch(target.sha256) else "its SHA-256 is not 64 hex digits"


def targets_text(targets: tuple[Target, ...]) -> str:
    """targets.csv as text."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(astuple(target) for target in targets)
    return buffer.getvalue()


def recordings_by_split(targets: tuple[Target, ...]) -> dict[str, list[str]]:
    """splits.json: the recordings of each split, sorted."""
    return {split: sorted({t.recording for t in targets if t.split == split}) for split in SPLITS}


def check_splits(targets: tuple[Target, ...], where: str) -> None:
    """Refuse an object that is in two splits.

    Raises:
        ReleaseError: it names the object.
    """
    split_of: dict[str, str] = {}
    for target in targets:
        if split_of.setdefault(target.object, target.split) != target.split:
            raise ReleaseError(
                f"{where}: object '{target.object}' is in two splits, {split_of[target.object]} and "
                f"{target.split}; scores would not be honest"
            )
