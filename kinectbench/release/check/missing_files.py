"""The files of a release: which it must have, which it may have, and which it must not have."""

from collections.abc import Collection, Iterator, Sequence

from kinectbench.core import printable
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, ReleaseInfo
from kinectbench.core.artefacts.object import FloorFile, QualityFile
from kinectbench.core.artefacts.provenance import LINEAGE_JSON, PRIVACY_JSON, THRESHOLDS_JSON
from kinectbench.core.artefacts.targets import SHA256SUMS, SPLITS_JSON, TARGETS_CSV, Target, columns_of
from kinectbench.core.artefacts.views import ViewsFile
from kinectbench.release.check.object_check import recording_of
from kinectbench.release.contents import (
    CARD,
    CATEGORIES,
    CHANGELOG,
    CITATION,
    COLOR,
    CROISSANT,
    DATACITE,
    DATASHEET,
    GLB,
    LICENSE,
    OBJECT_FILES,
    PREVIEW,
    PREVIEWS,
    READING,
    ROWS,
    SPLIT_TARGETS,
    VIEW_IMAGES,
)
from kinectbench.release.publish.previews import row_picture
from kinectbench.release.publish.schemas import schema_texts

MISSING = "{}: missing, a release of recordings has it"
TEXTS = (CARD, DATASHEET, READING, CHANGELOG, LICENSE, CITATION, PREVIEW, CROISSANT, DATACITE)


def missing_files(metadata: ReleaseInfo, targets: Sequence[Target], names: Collection[str]) -> Iterator[str]:
    """Yield a message for each missing file that every release of recordings has.

    Earlier versions may have written fewer files. Their releases need only the meshes and volumes, by which
    pairs are checked. Images are checked with the tables that list them.

    Args:
        metadata: content of benchmark.json.
        targets: the lines of targets.csv.
        names: the names in SHA256SUMS.
    """
    if metadata.benchmark_sha256_version is None:
        return
    stated = metadata.settings.recordings or metadata.settings.views
    if not stated and not any(name.startswith("views/") and name.endswith(".png") for name in names):
        return  # models and imported pairs have no recorded object
    wanted = list(_of_objects(metadata))
    if metadata.of_this_version:
        wanted += _of_this_version(metadata, targets, names)
    for name in wanted:
        if name not in names:
            yield MISSING.format(printable(name, 200))


def own_files(
    metadata: ReleaseInfo, targets: Sequence[Target], names: Collection[str], color: bool
) -> set[str]:
    """Return the names of all files that a release of this version may have.

    Args:
        metadata: content of benchmark.json.
        targets: the lines of targets.csv.
        names: the names of the release's files; a schema is stored only of files that are there.
        color: whether the views' colour images are published.
    """
    own = {*_of_objects(metadata), *_of_this_version(metadata, targets, names)}
    own |= {BENCHMARK_JSON, SHA256SUMS, TARGETS_CSV, THRESHOLDS_JSON}
    own |= {f"objects/{name}{GLB}" for name in metadata.recordings if metadata.has_solid(name)}
    for target in targets:
        view = f"views/{target.recording}/{target.view}"
        own |= {target.file, *(f"{view}{end}" for end in (*VIEW_IMAGES, *([COLOR] if color else ())))}
        own.add(f"{PREVIEWS}/{target.split}/{row_picture(target)}")
    return own


def hidden_files(metadata: ReleaseInfo, names: Collection[str]) -> Iterator[str]:
    """Yield a message for each file that must not be in the release, because it reveals held-back truth."""
    for name in names:
        parts = name.split("/")
        owner, is_floor = recording_of(name), parts[2:] == [FloorFile.FILE]
        if parts[0] == "objects" and not is_floor and metadata.hides(owner):
            yield f"{name}: truth of a split that is held back"
        pictured = parts[2] if parts[0] == PREVIEWS and len(parts) > 2 else ""
        if metadata.isolates(owner if is_floor and parts[0] == "objects" else pictured):
            yield f"{name}: of a recording of which one view alone is published"


def _of_objects(metadata: ReleaseInfo) -> Iterator[str]:
    """Yield the meshes and volumes of the objects whose truth is a published solid."""
    for recording in metadata.recordings:
        if metadata.has_solid(recording):
            yield from (f"objects/{recording}/{file}" for file in OBJECT_FILES)


def _of_this_version(
    metadata: ReleaseInfo, targets: Sequence[Target], names: Collection[str]
) -> Iterator[str]:
    """Yield the other files of a release that this version published."""
    yield from (*TEXTS, LINEAGE_JSON, PRIVACY_JSON, SPLITS_JSON)
    yield from (name for name, _ in schema_texts(names, columns_of(targets)))
    infos = metadata.recordings.values()
    yield from sorted({f"{CATEGORIES}/{info.category}.html" for info in infos})
    yield from sorted({f"{SPLIT_TARGETS}/{info.split}.csv" for info in infos})
    shown = {info.split for name, info in metadata.recordings.items() if not metadata.isolates(name)}
    yield from (f"{PREVIEWS}/{split}/{ROWS}" for split in sorted(shown))
    for recording in metadata.recordings:
        yield f"views/{recording}/{ViewsFile.FILE}"
        if not metadata.isolates(recording):
            yield f"objects/{recording}/{FloorFile.FILE}"
        if not metadata.hides(recording):
            yield f"objects/{recording}/{QualityFile.FILE}"
