"""The small files of a release: targets, splits, licence, citation, schemas, metadata, card, checksums."""

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from kinectbench import __version__
from kinectbench.config import CitationSettings
from kinectbench.release.card import RECORDED, CardTexts, card
from kinectbench.release.citation import citation_text
from kinectbench.release.croissant import croissant
from kinectbench.release.layout import (
    BENCHMARK_JSON,
    CARD,
    CITATION,
    CROISSANT,
    FORMAT_VERSION,
    LICENSE,
    READING,
    SHA256SUMS,
    SPLIT_TARGETS,
    SPLITS_JSON,
    TARGETS_CSV,
    benchmark_sha256,
    release_files,
    sums_text,
)
from kinectbench.release.metadata import RecordingInfo, ReleaseInfo
from kinectbench.release.origins import (
    UNSPECIFIED,
    Origin,
    common_license,
    license_text,
    reasons_against_distribution,
)
from kinectbench.release.reading import reading
from kinectbench.release.release import SPLITS, Target, recordings_by_split, targets_text
from kinectbench.release.schemas import write_schemas
from kinectbench.workspace import pretty_json, sha256_file

PACKAGES = ("numpy", "scipy", "numba", "open3d", "opencv-python-headless", "trimesh", "manifold3d", "zlib-ng")


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
        citation: how it is cited.
        held_back: splits of which only the inputs are there.
    """

    name: str
    license: str
    framing: str
    partial_rule: str
    settings: Mapping[str, Any]
    texts: CardTexts = RECORDED
    citation: CitationSettings = field(default_factory=CitationSettings)
    held_back: tuple[str, ...] = ()


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
    infos = {name: _with_origin(info, head) for name, info in infos.items()}
    origins = {name: Origin(info.license, info.source) for name, info in infos.items()}
    content = _content(head, infos, origins)
    license = common_license(origins, head.license)
    _write_targets(folder, targets)
    (folder / READING).write_text(reading(targets, head.held_back))
    (folder / LICENSE).write_text(license_text(head.name, license, origins))
    (folder / CITATION).write_text(citation_text(head.citation, head.name, license))
    info = ReleaseInfo.model_validate_json(json.dumps(content))
    write_schemas(folder)
    about = f"A benchmark for single-depth-view shape completion from {head.texts.source}."
    metadata = croissant(head.name, license, about, head.citation, folder)
    (folder / CROISSANT).write_text(pretty_json(metadata))
    (folder / CARD).write_text(card(info, targets, warnings, license, head.texts))
    return _seal(folder, content)


def note_in_benchmark_json(folder: Path, more: Mapping[str, Any]) -> None:
    """Add keys to benchmark.json of a finished release; its identity stays the same."""
    content = json.loads((folder / BENCHMARK_JSON).read_text()) | dict(more)
    (folder / BENCHMARK_JSON).write_text(pretty_json(content))
    lines = (folder / SHA256SUMS).read_text().splitlines(keepends=True)
    own = f"{sha256_file(folder / BENCHMARK_JSON)}  {BENCHMARK_JSON}\n"
    (folder / SHA256SUMS).write_text(
        "".join(own if line.endswith(f"  {BENCHMARK_JSON}\n") else line for line in lines)
    )


def _with_origin(info: RecordingInfo, head: Head) -> RecordingInfo:
    """A recording that says nothing itself is under the benchmark's licence, from where its texts say."""
    said = {"license": head.license, "source": head.texts.origin}
    update = {key: value for key, value in said.items() if value and getattr(info, key) == UNSPECIFIED}
    return info.model_copy(update=update)


def _content(head: Head, infos: Mapping[str, RecordingInfo], origins: Mapping[str, Origin]) -> dict[str, Any]:
    """benchmark.json but for the identity."""
    reasons = reasons_against_distribution(origins)
    content: dict[str, Any] = {
        "name": head.name,
        "license": head.license,
        "format_version": FORMAT_VERSION,
        "package_version": __version__,
        "benchmark_sha256": "0" * 64,
        "framing": head.framing,
        "partial_rule": head.partial_rule,
        "distribution": {"allowed": not reasons, "reasons": list(reasons)},
        "settings": head.settings,
        "packages": package_versions(),
        "recordings": {name: info.model_dump() for name, info in infos.items()},
    }
    if head.citation.version:
        content["version"] = head.citation.version
    if head.held_back:
        content["held_back"] = list(head.held_back)
    return content


def _write_targets(folder: Path, targets: tuple[Target, ...]) -> None:
    """targets.csv, a table of each split that has any, and splits.json."""
    (folder / TARGETS_CSV).write_text(targets_text(targets))
    (folder / SPLIT_TARGETS).mkdir()
    for split in SPLITS:
        here = tuple(target for target in targets if target.split == split)
        if here:
            (folder / SPLIT_TARGETS / f"{split}.csv").write_text(targets_text(here))
    (folder / SPLITS_JSON).write_text(pretty_json(recordings_by_split(targets)))


def _seal(folder: Path, content: dict[str, Any]) -> str:
    """Write benchmark.json and the checksums; returns the release's identity."""
    sums = {path.relative_to(folder).as_posix(): sha256_file(path) for path in release_files(folder)}
    content["benchmark_sha256"] = benchmark_sha256(sums_text(sums))
    (folder / BENCHMARK_JSON).write_text(pretty_json(content))
    sums[BENCHMARK_JSON] = sha256_file(folder / BENCHMARK_JSON)
    (folder / SHA256SUMS).write_text(sums_text(sums))
    return str(content["benchmark_sha256"])


def package_versions() -> dict[str, str]:
    """Versions of Python and of the packages that the data was computed with."""
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:  # another distribution of the same package
            versions[name] = "unknown"
    return versions
