"""Open a published benchmark: its targets and what `benchmark.json` says. See layout.py for the files."""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, ReleaseInfo
from kinectbench.core.artefacts.targets import (
    SHA256SUMS,
    SPLITS_JSON,
    TARGETS_CSV,
    benchmark_sha256,
    check_splits,
    parse_sums,
    parse_targets,
)
from kinectbench.core.artefacts.targets import Target as Target
from kinectbench.core.errors import ReleaseError
from kinectbench.core.storage import sha256_file
from kinectbench.release.contents import read_text


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
    metadata: ReleaseInfo = field(hash=False)  # it holds dicts

    @property
    def benchmark_sha256(self) -> str:
        """Identifies the published bytes (see core/artefacts/targets.py)."""
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
        return parse_sums(read_text(path), str(path))

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
    metadata = ReleaseInfo.read(path)
    sums_text = read_text(path / SHA256SUMS)
    if benchmark_sha256(sums_text) != metadata.benchmark_sha256:
        raise ReleaseError(f"{path / SHA256SUMS}: not the published list; download the release again")
    sums = parse_sums(sums_text, str(path / SHA256SUMS))
    for name in (BENCHMARK_JSON, SPLITS_JSON, TARGETS_CSV):
        if not (path / name).is_file() or sums.get(name) != sha256_file(path / name):
            raise ReleaseError(f"{path / name}: missing or changed since it was published; download it again")
    targets = parse_targets(read_text(path / TARGETS_CSV), str(path / TARGETS_CSV))
    check_splits(targets, str(path / TARGETS_CSV))
    return Release(path, targets, metadata)
