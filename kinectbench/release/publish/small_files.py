"""Write a release's small files: targets, splits, licence, citation, schemas, metadata, card, checksums."""

import platform
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from kinectbench._version import __version__
from kinectbench.core import package_version, pretty_json, read_plain_text, sha256_file, write_below
from kinectbench.core.artefacts.benchmark import (
    BENCHMARK_JSON,
    FORMAT_VERSION,
    PUBLISH_VERSION,
    SHA256_VERSION,
    UNSPECIFIED,
    Distribution,
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
from kinectbench.core.types import Framing, PartialRule
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


def release_info(
    name: str,
    license: str,
    framing: Framing,
    partial_rule: PartialRule,
    settings: Mapping[str, object],
    infos: Mapping[str, RecordingInfo],
    **more: object,
) -> ReleaseInfo:
    """Return benchmark.json of a release that this version writes, with zeros as benchmark_sha256.

    Args:
        name: the benchmark's name.
        license: licence of the data, also of recordings that state none.
        framing: framing of every pair.
        partial_rule: partial rule of every pair.
        settings: the settings that made the release, as plain JSON values, without paths of the machine.
        infos: {recording: its entry}.
        more: values of further keys; empty ones are not set.
    """
    licensed = {"license": license or UNSPECIFIED}  # in place of a missing one
    infos = {
        name: info if info.license != UNSPECIFIED else info.model_copy(update=licensed)
        for name, info in infos.items()
    }
    reasons = reasons_against_distribution(infos)
    info = ReleaseInfo(
        name=name,
        license=license,
        format_version=FORMAT_VERSION,
        package_version=__version__,
        publish_version=PUBLISH_VERSION,
        benchmark_sha256="0" * 64,
        benchmark_sha256_version=SHA256_VERSION,
        framing=framing,
        partial_rule=partial_rule,
        distribution=Distribution(allowed=not reasons, reasons=reasons),
        settings=SettingsInfo.model_validate(settings),
        packages=data_package_versions(),
        recordings=infos,
    )
    return info.model_copy(update={key: value for key, value in more.items() if value})


def small_texts(
    info: ReleaseInfo,
    targets: Sequence[Target],
    warnings: Sequence[str],
    words: CardTexts,
    citation: CitationSettings,
) -> Iterator[tuple[str, str]]:
    """Yield (file, text) of the texts that every release has: card, READING.md, licence and citation.

    `words` are those of the card that depend on the origin of the pairs.
    """
    license = common_license(info.recordings, info.license)
    why = "an open mesh, `surfaces/<recording>.ply`" if info.surface_truth else "held back"
    yield CARD, card(info, targets, warnings, license, words)
    yield READING, reading(targets, info.inputs_only, why)
    yield LICENSE, license_text(info.name, license, info.recordings)
    yield CITATION, citation_text(citation, info.name, license)


def write_small_files(
    info: ReleaseInfo,
    folder: Path,
    targets: tuple[Target, ...],
    warnings: Sequence[str],
    words: CardTexts = RECORDED,
    citation: CitationSettings | None = None,
    texts: Iterable[tuple[str, str]] | None = None,
    scenes: Path | None = None,
) -> str:
    """Write the small files, and the objects' GLBs, of an otherwise complete release folder.

    Return the release's benchmark_sha256.

    Args:
        info: content of benchmark.json, without its hash.
        folder: the release's folder.
        targets: every pair, sorted.
        warnings: as in `small_texts`, like `words` and `citation`.
        words: see there.
        citation: see there; None: nothing is stated.
        texts: (file, text) of every text; None: those of `small_texts`.
        scenes: `build/`, where scene meshes give the GLBs' colours; None if no colour is published.
    """
    citation = citation or CitationSettings()
    _write_targets(folder, targets)
    for name, text in texts or small_texts(info, targets, warnings, words, citation):
        write_below(folder / name, text.encode())
    columns = columns_of(targets)
    write_schemas(folder, columns)
    write_glbs(folder, info.recordings, scenes)
    about = about_release(info, words, citation, day_of(citation, folder), warnings)
    (folder / DATACITE).write_text(pretty_json(datacite(about)), encoding="utf-8")
    (folder / CROISSANT).write_text(pretty_json(croissant(about, folder, columns)), encoding="utf-8")
    return _seal(folder, info)


def about_release(
    info: ReleaseInfo, words: CardTexts, citation: CitationSettings, date: str, warnings: Sequence[str]
) -> About:
    """Return the description of a release from which croissant.json and datacite.json are made.

    `date` is the day of publication, year-month-day; the other arguments are those of `small_texts`.
    """
    published = info.settings.publish
    options = PublishSettings() if published is None else PublishSettings.model_validate(published)
    return About(
        name=info.name,
        license=common_license(info.recordings, info.license),
        description=f"A benchmark for single-depth-view shape completion from {words.source}.",
        citation=citation,
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
