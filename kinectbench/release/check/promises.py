"""Check which files, keys and facts a release may and must have, as `publish` of this version keeps them."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import fields
from fnmatch import fnmatchcase

import numpy as np

from kinectbench.core import KinectBenchError, printable
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, ReleaseInfo
from kinectbench.core.artefacts.object import FloorFile, QualityFile
from kinectbench.core.artefacts.object_grids import ObjectVolume
from kinectbench.core.artefacts.provenance import (
    LINEAGE_JSON,
    PRIVACY_JSON,
    THRESHOLDS_JSON,
    Lineage,
    LineageRecording,
    Privacy,
    Removed,
    ThresholdsFile,
    nearest_step,
)
from kinectbench.core.artefacts.targets import SHA256SUMS, SPLITS_JSON, TARGETS_CSV, Target, columns_of
from kinectbench.core.artefacts.views import ViewsFile
from kinectbench.core.geometry import parse_ply
from kinectbench.core.jpeg_metadata import without_metadata
from kinectbench.core.voxels.npz import NPY, open_npz
from kinectbench.core.voxels.pair_file import INPUT_KEYS, VERSION_KEY, Pair
from kinectbench.engine.artefact import VERSIONS
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
    VOLUME_BYTES,
    Contents,
)
from kinectbench.release.publish.object_glb import glb_bytes
from kinectbench.release.publish.previews import row_picture
from kinectbench.release.publish.privacy import privacy, scrubbed
from kinectbench.release.publish.schemas import JSON_FILES, schema_texts

MISSING = "{}: missing, a release of recordings has it"
TEXTS = (CARD, DATASHEET, READING, CHANGELOG, LICENSE, CITATION, PREVIEW, CROISSANT, DATACITE)
# Which release has a file: every one of recordings, as pairs are checked by it; every one of this version; or
# it is reported elsewhere if it is missing.
EVERY, NEW, OTHER = range(3)


def missing_files(metadata: ReleaseInfo, targets: Sequence[Target], names: Collection[str]) -> Iterator[str]:
    """Yield a message for each file that every release of recordings has, and SHA256SUMS (`names`) lacks.

    Earlier versions may have written fewer files. Their releases need only the meshes and volumes, by which
    pairs are checked. Images are checked with the tables that list them.
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

    A schema is stored only of files that are there, `names`.
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


PAIR_KEYS = frozenset((*(field.name for field in fields(Pair)), VERSION_KEY))
VOLUME_KEYS = frozenset((*(field.name for field in fields(ObjectVolume)), *ObjectVolume.VERSION))
VOLUME_KEYS = VOLUME_KEYS - {"grid"} | {"voxel_size_m", "T_world_grid"}
# Figures that every fused truth has, and a reference mesh that is the truth, by which it is judged.
OF_TRUTH = ("doubts", "surface_sigma_m", "unknown_share", "volume_m3", "labels")
OF_FUSED = ("estimated_known_iou", "estimated_iou", "repeatability_iou", "underside")
ESTIMATES = ("estimated_iou", "estimated_known_iou")
# Words of people, and names of the recordings' files: published as they are.
SAID = ("source", "license", "publish", "files", "left_out", "poor", "accepted")
# Chunks of a PNG file that hold texts, times or EXIF: PNG (third edition), section 11.3.
PNG_HEAD_BYTES, PNG_TEXTS, PNG_END = 8, (b"tEXt", b"zTXt", b"iTXt", b"eXIf", b"tIME"), b"IEND"


def promise_problems(
    contents: Contents,
    metadata: ReleaseInfo,
    targets: Sequence[Target],
    pair_keys: Mapping[str, Mapping[str, Collection[str]]],
) -> Iterator[str]:
    """Yield a message for each file or key of a release that must not be there, or is missing.

    The release's other files have passed all checks. `pair_keys` is {recording: {pair file: its keys}}.
    """
    try:
        stated = Privacy.parse(contents.text(PRIVACY_JSON), PRIVACY_JSON)
        lineage = Lineage.parse(contents.text(LINEAGE_JSON), LINEAGE_JSON).recordings
        known = own_files(metadata, targets, contents.entries, stated.color == "published")
        for name in sorted(contents.entries.keys() - set(known)):
            yield f"{printable(name, 200)}: no file of a release; take it out"
        for target in targets:
            if target.unknown_share is None and metadata.has_solid(target.recording):
                yield f"{TARGETS_CSV}: no unknown_share of {target.name}"
        for name, files in pair_keys.items():
            wanted = PAIR_KEYS if metadata.has_solid(name) else {*INPUT_KEYS, VERSION_KEY}
            needed = wanted if _made_by(lineage, name, "pairs") else ()
            for file, keys in files.items():
                yield from _other_keys(file, keys, wanted, needed)
        for name in filter(metadata.has_solid, metadata.recordings):
            quality, is_new = metadata.recordings[name].quality, _made_by(lineage, name, "segment")
            yield from _quality_problems(f"objects/{name}/{QualityFile.FILE}", quality, is_new)
            yield from _volume_keys(contents, f"objects/{name}/{ObjectVolume.FILE}", is_new)
            if f"objects/{name}{GLB}" not in contents.entries:
                mesh = parse_ply(contents.read(f"objects/{name}/{OBJECT_FILES[0]}"))
                if glb_bytes(mesh, np.eye(4)) is not None:  # some meshes have none
                    yield MISSING.format(f"objects/{name}{GLB}")
        yield from _privacy_problems(contents, metadata, stated)
        if THRESHOLDS_JSON in contents.entries:
            yield from _threshold_problems(contents, targets)
    except KinectBenchError as error:
        yield str(error)


def _made_by(lineage: Mapping[str, LineageRecording], recording: str, stage: str) -> bool:
    """Return whether this version of a stage made its part of a recording."""
    row = lineage[recording].stages.get(stage) if recording in lineage else None
    return row is not None and row.stage_version == VERSIONS[stage]


def _other_keys(
    name: str, keys: Collection[str], may: Collection[str], must: Collection[str]
) -> Iterator[str]:
    if more := sorted(set(keys) - set(may)):
        yield f"{name}: holds the unknown key '{printable(more[0])}'"
    if less := sorted(set(must) - set(keys)):
        yield f"{name}: lacks the key '{less[0]}'"


def _volume_keys(contents: Contents, name: str, is_new: bool) -> Iterator[str]:
    with contents.stream(name) as file, open_npz(file, VOLUME_BYTES) as archive:
        keys = {entry.removesuffix(NPY) for entry in archive.namelist()}
    yield from _other_keys(name, keys, VOLUME_KEYS, VOLUME_KEYS if is_new else ())


def _quality_problems(name: str, quality: QualityFile, is_new: bool) -> Iterator[str]:
    """Yield a message for figures that are absent, and for an estimate outside its own interval."""
    needed = (*OF_TRUTH, *(OF_FUSED if quality.truth is None else ())) if is_new else ()
    if absent := [key for key in needed if getattr(quality, key) is None]:
        yield f"{name}: does not state {', '.join(absent)}"
    for key in ESTIMATES:
        ends = [getattr(quality, f"{key}{end}") for end in ("_low", "", "_high")]
        if None not in ends and ends != sorted(ends):
            yield f"{name}: {key} is not between its ends"


def _privacy_problems(contents: Contents, metadata: ReleaseInfo, stated: Privacy) -> Iterator[str]:
    """Yield a message for each private fact in a file, and if privacy.json says otherwise than `publish`."""
    for key, value in privacy(stated.color, []).json_value().items():
        if key != "removed" and stated.json_value().get(key) != value:
            yield f"{PRIVACY_JSON}: {key} is not what `publish` says"
    wanted = bool((metadata.settings.publish or {}).get("color"))
    if stated.color == ("left out" if wanted else "published"):
        yield f"{PRIVACY_JSON}: color is '{stated.color}', the settings say otherwise"
    for name in sorted(contents.entries):
        for what in _private_facts(contents, name):
            yield f"{name}: holds {printable(what)}, which `publish` removes; publish again"


def _private_facts(contents: Contents, name: str) -> list[str]:
    if name.endswith(".jpg"):
        try:
            return without_metadata(contents.read(name))[1]
        except ValueError as error:
            return [f"no picture ({error})"]
    if name.endswith(".png"):
        return list(_png_texts(contents.read(name)))
    model = next((of for files, of in JSON_FILES.values() if fnmatchcase(name, files)), None)
    if model is None:
        return []
    stored, removals = model.parse(contents.text(name), name), list[Removed]()
    scrubbed(_unsaid(stored.json_value()), name, removals, stored)
    return [row.what for row in removals]


def _unsaid(value: object) -> object:
    """Return a JSON value without the keys in `SAID`."""
    if isinstance(value, dict):
        return {key: _unsaid(child) for key, child in value.items() if key not in SAID}
    return [_unsaid(child) for child in value] if isinstance(value, list) else value


def _png_texts(data: bytes) -> Iterator[str]:
    """Yield the names of a PNG's chunks of texts, and of what follows its end."""
    at, kind = PNG_HEAD_BYTES, b""
    while kind != PNG_END and at < len(data):
        kind = data[at + 4 : at + 8]
        if kind in PNG_TEXTS:
            yield f"a {kind.decode()} chunk"
        at += int.from_bytes(data[at : at + 4], "big") + 12
    if data[at:]:
        yield "data after the picture"


def _threshold_problems(contents: Contents, targets: Sequence[Target]) -> Iterator[str]:
    """Yield a message for each fault of thresholds.json, by which `publish` would refuse it."""
    file = ThresholdsFile.parse(contents.text(THRESHOLDS_JSON), THRESHOLDS_JSON)
    test = [target for target in targets if target.split == "test"]
    tested = {target.object.casefold() for target in test}
    if shared := sorted(name for name in file.objects if name.strip().casefold() in tested):
        yield f"{THRESHOLDS_JSON}: found on objects of the test split ({printable(', '.join(shared), 120)})"
    for category in sorted({target.category for target in test} - file.thresholds.keys()):
        yield f"{THRESHOLDS_JSON}: no threshold for {category}"
    for category, value in file.thresholds.items():
        if nearest_step(value) is None:
            yield f"{THRESHOLDS_JSON}: {value:g} of {printable(category)} is not one of 0.1, 0.15, … 0.9"
