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
# Which release has a file: every one of recordings, as pairs are checked by it; every one of this version; or
# it is reported elsewhere if it is missing.
EVERY, NEW, OTHER = range(3)


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
    needed = NEW if metadata.of_this_version else EVERY
    for name, kind in sorted(own_files(metadata, targets, names).items(), key=lambda item: item[1]):
        if kind <= needed and name not in names:
            yield MISSING.format(printable(name, 200))


def own_files(
    metadata: ReleaseInfo, targets: Sequence[Target], names: Collection[str], color: bool = False
) -> dict[str, int]:
    """Return {file: EVERY, NEW or OTHER} of all files that a release of this version may have.

    Args:
        metadata: content of benchmark.json.
        targets: the lines of targets.csv.
        names: the names of the release's files; a schema is stored only of files that are there.
        color: whether the views' colour images are published.
    """
    schemas = (name for name, _ in schema_texts(names, columns_of(targets)))
    files = dict.fromkeys((*TEXTS, LINEAGE_JSON, PRIVACY_JSON, SPLITS_JSON, *schemas), NEW)
    files |= dict.fromkeys((BENCHMARK_JSON, SHA256SUMS, TARGETS_CSV, THRESHOLDS_JSON), OTHER)
    for name, info in metadata.recordings.items():
        folder, isolates = f"objects/{name}", metadata.isolates(name)
        if metadata.has_solid(name):
            files |= {**{f"{folder}/{file}": EVERY for file in OBJECT_FILES}, f"{folder}{GLB}": OTHER}
        new = [f"{CATEGORIES}/{info.category}.html", f"{SPLIT_TARGETS}/{info.split}.csv"]
        new += [] if isolates else [f"{PREVIEWS}/{info.split}/{ROWS}", f"{folder}/{FloorFile.FILE}"]
        new += [] if metadata.hides(name) else [f"{folder}/{QualityFile.FILE}"]
        files |= dict.fromkeys([*new, f"views/{name}/{ViewsFile.FILE}"], NEW)
    for target in targets:
        view = f"views/{target.recording}/{target.view}"
        images = [f"{view}{end}" for end in (*VIEW_IMAGES, *([COLOR] if color else ()))]
        picture = f"{PREVIEWS}/{target.split}/{row_picture(target)}"
        files |= dict.fromkeys([target.file, picture, *images], OTHER)
    return files


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
