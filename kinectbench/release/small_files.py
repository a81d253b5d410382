"""The small files of a release: targets, splits, card, benchmark.json and the checksums."""

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from kinectbench import __version__
from kinectbench.release.card import RECORDED, CardTexts, card
from kinectbench.release.layout import (
    BENCHMARK_JSON,
    CARD,
    FORMAT_VERSION,
    SHA256SUMS,
    SPLITS_JSON,
    TARGETS_CSV,
    benchmark_sha256,
    release_files,
    sums_text,
)
from kinectbench.release.metadata import RecordingInfo, ReleaseInfo
from kinectbench.release.release import Target, recordings_by_split, targets_text
from kinectbench.workspace import pretty_json, sha256_file

PACKAGES = ("numpy", "scipy", "numba", "open3d", "opencv-python-headless", "trimesh")


@dataclass(frozen=True)
class Head:
    """What benchmark.json begins with.

    Attributes:
        name: of the benchmark.
        license: of the data.
        framing: of every pair.
        partial_rule: of every pair.
        settings: what it was made with, as plain JSON values, without paths of the machine.
        texts: what the card says of it.
    """

    name: str
    license: str
    framing: str
    partial_rule: str
    settings: Mapping[str, Any]
    texts: CardTexts = RECORDED


def write_small_files(
    head: Head,
    folder: Path,
    targets: tuple[Target, ...],
    infos: Mapping[str, RecordingInfo],
    warnings: Sequence[str],
) -> str:
    """Complete a folder that holds everything else of a release; returns the release's identity.

    Args:
        head: what benchmark.json begins with.
        folder: of the release.
        targets: every pair, sorted.
        infos: recording -> what benchmark.json says of it.
        warnings: one line each, for the card.
    """
    content: dict[str, Any] = {
        "name": head.name,
        "license": head.license,
        "format_version": FORMAT_VERSION,
        "package_version": __version__,
        "benchmark_sha256": "0" * 64,
        "framing": head.framing,
        "partial_rule": head.partial_rule,
        "settings": head.settings,
        "packages": _packages(),
        "recordings": {name: info.model_dump() for name, info in infos.items()},
    }
    (folder / TARGETS_CSV).write_text(targets_text(targets))
    (folder / SPLITS_JSON).write_text(pretty_json(recordings_by_split(targets)))
    (folder / CARD).write_text(card(ReleaseInfo.model_validate(content), targets, warnings, head.texts))
    sums = {path.relative_to(folder).as_posix(): sha256_file(path) for path in release_files(folder)}
    content["benchmark_sha256"] = benchmark_sha256(sums_text(sums))
    (folder / BENCHMARK_JSON).write_text(pretty_json(content))
    sums[BENCHMARK_JSON] = sha256_file(folder / BENCHMARK_JSON)
    (folder / SHA256SUMS).write_text(sums_text(sums))
    return str(content["benchmark_sha256"])


def _packages() -> dict[str, str]:
    """Versions of Python and of the packages that the data was computed with."""
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:  # another distribution of the same package
            versions[name] = "unknown"
    return versions
