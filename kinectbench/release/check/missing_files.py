"""Check that a release of recordings has every file that its readers and its checks need."""

from collections.abc import Collection, Iterator, Sequence

from kinectbench.core import printable
from kinectbench.core.artefacts.benchmark import ReleaseInfo
from kinectbench.core.artefacts.object import FloorFile, QualityFile
from kinectbench.core.artefacts.provenance import LINEAGE_JSON, PRIVACY_JSON
from kinectbench.core.artefacts.targets import SPLITS_JSON, Target, columns_of
from kinectbench.core.artefacts.views import ViewsFile
from kinectbench.release.contents import (
    CARD,
    CATEGORIES,
    CHANGELOG,
    CITATION,
    CROISSANT,
    DATACITE,
    DATASHEET,
    LICENSE,
    OBJECT_FILES,
    PREVIEW,
    PREVIEWS,
    READING,
    ROWS,
    SPLIT_TARGETS,
)
from kinectbench.release.publish.schemas import schema_texts

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
            yield f"{printable(name, 200)}: missing, a release of recordings has it"


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
