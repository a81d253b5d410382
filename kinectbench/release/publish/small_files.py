"""Write a release's small files: targets, splits, licence, citation, schemas, metadata, card, checksums."""

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from kinectbench._version import __version__
from kinectbench.core import package_version, pretty_json, read_plain_text, sha256_file
from kinectbench.core.artefacts.benchmark import (
    BENCHMARK_JSON,
    FORMAT_VERSION,
    PUBLISH_VERSION,
    SHA256_VERSION,
    UNSPECIFIED,
    Distribution,
    Flow,
    RecordingInfo,
    ReleaseInfo,
    SettingsInfo,
)
from kinectbench.core.artefacts.targets import (
    SHA256SUMS,
    SPLITS,
    TARGETS_CSV,
    Splits,
    Target,
    benchmark_sha256,
    columns_of,
    parse_sums,
    sums_text,
    targets_text,
)
from kinectbench.core.types import Framing, PartialRule, Split
from kinectbench.release.contents import (
    CARD,
    CITATION,
    CROISSANT,
    DATACITE,
    LICENSE,
    READING,
    SPLIT_TARGETS,
    release_files,
)
from kinectbench.release.publish.attribution import (
    citation_text,
    common_license,
    license_text,
    reasons_against_distribution,
)
from kinectbench.release.publish.card import RECORDED, CardTexts, card, reading
from kinectbench.release.publish.croissant import croissant
from kinectbench.release.publish.datacite import About, datacite, day_of
from kinectbench.release.publish.object_glb import write_glbs
from kinectbench.release.publish.schemas import write_schemas
from kinectbench.settings.publishing import CitationSettings, PublishSettings

PACKAGES = (
    *("numpy", "scipy", "numba", "open3d", "opencv-python-headless", "trimesh", "manifold3d", "zlib-ng"),
    "fast-simplification",
)


@dataclass(frozen=True)
class Head:
    """Facts about a release as a whole, for benchmark.json and the other small files.

    Attributes:
        name: the benchmark's name.
        license: licence of the data.
        framing: framing of every pair.
        partial_rule: partial rule of every pair.
        settings: the settings that made the release, as plain JSON values, without paths of the machine.
        texts: the parts of the card's text that depend on the origin of the pairs.
        citation: authors, title, version and address for citing the release.
        held_back: splits of which only inputs are published.
        left_out: {recording: why it is not published}, for built and failed recordings.
        flow: number of recordings tried, and their outcomes; None: the pairs are not made from recordings.
        isolated: recordings of which a single view is published.
        surface_truth: splits whose truth is an open mesh.
    """

    name: str
    license: str
    framing: Framing
    partial_rule: PartialRule
    settings: Mapping[str, object]
    texts: CardTexts = RECORDED
    citation: CitationSettings = field(default_factory=CitationSettings)
    held_back: tuple[Split, ...] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)
    flow: Flow | None = None
    isolated: tuple[str, ...] = ()
    surface_truth: tuple[Split, ...] = ()


def write_small_files(
    head: Head,
    folder: Path,
    targets: tuple[Target, ...],
    infos: Mapping[str, RecordingInfo],
    warnings: Sequence[str],
    scenes: Path | None = None,
) -> str:
    """Write the small files, and the objects' GLBs, of an otherwise complete release folder.

    Return the release's benchmark_sha256.

    Args:
        head: facts about the release as a whole.
        folder: the release's folder.
        targets: every pair, sorted.
        infos: {recording: its entry in benchmark.json}.
        warnings: the release's warnings, one line each, for the card.
        scenes: `build/`, where scene meshes give the GLBs' colours; None if no colour is published.
    """
    licensed = {"license": head.license or UNSPECIFIED}  # in place of a missing one
    infos = {
        name: info if info.license != UNSPECIFIED else info.model_copy(update=licensed)
        for name, info in infos.items()
    }
    info = _info(head, infos)
    license = common_license(infos, head.license)
    _write_targets(folder, targets)
    why = "an open mesh, `surfaces/<recording>.ply`" if head.surface_truth else "held back"
    words = reading(targets, (*head.held_back, *head.surface_truth), why)
    (folder / READING).write_text(words, encoding="utf-8")
    (folder / LICENSE).write_text(license_text(head.name, license, infos), encoding="utf-8")
    (folder / CITATION).write_text(citation_text(head.citation, head.name, license), encoding="utf-8")
    columns = columns_of(targets)
    write_schemas(folder, columns)
    write_glbs(folder, infos, scenes)
    about = about_release(head, license, day_of(head.citation, folder), warnings)
    (folder / DATACITE).write_text(pretty_json(datacite(about)), encoding="utf-8")
    (folder / CROISSANT).write_text(pretty_json(croissant(about, folder, columns)), encoding="utf-8")
    (folder / CARD).write_text(card(info, targets, warnings, license, head.texts), encoding="utf-8")
    return _seal(folder, info)


def about_release(head: Head, license: str, date: str, warnings: Sequence[str]) -> About:
    """Return the description of a release from which croissant.json and datacite.json are made.

    Args:
        head: facts about the release as a whole.
        license: the licence of all recordings.
        date: the day of publication, year-month-day.
        warnings: the release's warnings, one line each.
    """
    published = head.settings.get("publish")
    options = PublishSettings() if published is None else PublishSettings.model_validate(published)
    return About(
        name=head.name,
        license=license,
        description=f"A benchmark for single-depth-view shape completion from {head.texts.source}.",
        citation=head.citation,
        date=date,
        answers=options.datasheet,
        warnings=warnings,
        color=options.color,
        recorded=published is not None,
    )


def note_in_benchmark_json(folder: Path, **more: str) -> None:
    """Set keys of benchmark.json in a finished release; its benchmark_sha256 must not depend on them."""
    ReleaseInfo.read(folder).model_copy(update=more).write(folder)
    path = folder / SHA256SUMS
    sums = parse_sums(read_plain_text(path), str(path)) | {
        BENCHMARK_JSON: sha256_file(folder / BENCHMARK_JSON)
    }
    path.write_text(sums_text(sums), encoding="utf-8")


def _info(head: Head, infos: Mapping[str, RecordingInfo]) -> ReleaseInfo:
    """Return benchmark.json with zeros as benchmark_sha256; empty optional keys are not set."""
    reasons = reasons_against_distribution(infos)
    info = ReleaseInfo(
        name=head.name,
        license=head.license,
        format_version=FORMAT_VERSION,
        package_version=__version__,
        publish_version=PUBLISH_VERSION,
        benchmark_sha256="0" * 64,
        benchmark_sha256_version=SHA256_VERSION,
        framing=head.framing,
        partial_rule=head.partial_rule,
        distribution=Distribution(allowed=not reasons, reasons=reasons),
        settings=SettingsInfo.model_validate(head.settings),
        packages=data_package_versions(),
        recordings=dict(infos),
    )
    present = {
        "version": head.citation.version,
        "held_back": head.held_back,
        "left_out": dict(head.left_out),
        "flow": head.flow,
        "isolated": head.isolated,
        "surface_truth": head.surface_truth,
    }
    return info.model_copy(update={key: value for key, value in present.items() if value})


def _write_targets(folder: Path, targets: tuple[Target, ...]) -> None:
    """Write targets.csv, targets/<split>.csv for each split with pairs, and splits.json."""
    (folder / TARGETS_CSV).write_text(targets_text(targets), encoding="utf-8")
    (folder / SPLIT_TARGETS).mkdir()
    for split in SPLITS:
        of_split = tuple(target for target in targets if target.split == split)
        if of_split:
            (folder / SPLIT_TARGETS / f"{split}.csv").write_text(targets_text(of_split), encoding="utf-8")
    Splits.of(targets).write(folder)


def _seal(folder: Path, info: ReleaseInfo) -> str:
    """Compute benchmark_sha256, write benchmark.json and SHA256SUMS, and return benchmark_sha256."""
    sums = {path.relative_to(folder).as_posix(): sha256_file(path) for path in release_files(folder)}
    identity = benchmark_sha256(sums_text(sums), info.text())
    info.model_copy(update={"benchmark_sha256": identity}).write(folder)
    sums[BENCHMARK_JSON] = sha256_file(folder / BENCHMARK_JSON)
    (folder / SHA256SUMS).write_text(sums_text(sums), encoding="utf-8")
    return identity


def data_package_versions() -> dict[str, str]:
    """Return {package: version} of Python and the packages that compute data; "unknown" if not installed."""
    versions = {name: package_version(name) or "unknown" for name in PACKAGES}
    return {"python": platform.python_version(), **versions}
