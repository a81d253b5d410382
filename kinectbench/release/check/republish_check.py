"""Publish rebuilt recordings again, and compare the figures and pictures with those of the release."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from kinectbench._version import __version__
from kinectbench.core import read_plain
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, ReleaseInfo
from kinectbench.core.artefacts.provenance import LINEAGE_JSON, Lineage, Removed
from kinectbench.core.artefacts.targets import Target
from kinectbench.engine.scratch import scratch_folder
from kinectbench.release.check.text_check import (
    release_settings,
    said_without_advice,
    text_difference,
    value_differences,
)
from kinectbench.release.contents import (
    CARD,
    GLB,
    OBJECT_FILES,
    PREVIEW,
    PREVIEWS,
    ROWS,
    VIEW_IMAGES,
    Contents,
    most_bytes,
    release_files,
    release_json,
)
from kinectbench.release.publish.gate import gate
from kinectbench.release.publish.index_page import category_texts, preview_text
from kinectbench.release.publish.object_glb import write_glbs
from kinectbench.release.publish.previews import write_view_pictures
from kinectbench.release.publish.privacy import scrubbed
from kinectbench.release.publish.publish import MOST_NAMED_FILES
from kinectbench.release.publish.publish_recording import Built, Published, publish_recording
from kinectbench.release.publish.texts import stated_warnings
from kinectbench.settings.models import BenchmarkSettings

AGAIN = "differs when made again"
# Endings of files that `rebuild` has already compared with the rebuilt ones.
AS_BUILT = (*OBJECT_FILES, *VIEW_IMAGES, ".npz", ROWS)
# Keys of lineage.json that `rebuild` has already compared with the recording's files.
OF_FILES = ("files", "files_sha256")


def republished_differences(
    contents: Contents, settings: BenchmarkSettings, targets: Sequence[Target], build: Path
) -> Iterator[str]:
    """Yield a line for each figure, picture or page that differs when recordings are published again.

    Pages are compared only if the release has no other recordings, and was made by this version. The
    release's objects, images and pairs equal the rebuilt ones; settings and targets are of the rebuilt
    recordings only.
    """
    info = ReleaseInfo.parse(contents.text(BENCHMARK_JSON), BENCHMARK_JSON)
    scenes = build if settings.publish.color else None
    with scratch_folder() as folder:
        made = dict[str, Published]()
        for recording in settings.recordings:
            built = Built(settings, recording, build / recording.id, False, MOST_NAMED_FILES)
            published = publish_recording(built, folder, [])
            if published is not None:
                made[recording.id] = published
        write_view_pictures(folder, targets)
        write_glbs(folder, made, scenes)
        yield from _file_differences(contents, folder, made)
        yield from _entry_differences(contents, info, settings, build, made)
        if made.keys() == info.recordings.keys() and info.package_version == __version__:
            every = release_settings(info)  # pages speak of recordings that are left out, too
            warnings = stated_warnings(info, every, targets, contents.text(CARD))
            pages = {PREVIEW: preview_text(info, every, targets, warnings, folder, build)}
            pages |= category_texts(info, every, targets, folder)
            for name, text in pages.items():
                if name in contents.entries:
                    stated = said_without_advice(contents.text(name))
                    yield from text_difference(name, stated, said_without_advice(text))


def _file_differences(contents: Contents, folder: Path, made: dict[str, Published]) -> Iterator[str]:
    """Yield a line for each release file of the recordings `made` that differs in `folder` or is missing."""
    again = {path.relative_to(folder).as_posix(): path for path in release_files(folder)}
    for name in sorted(contents.entries):
        parts = name.split("/")
        owner = parts[2] if parts[0] == PREVIEWS and len(parts) > 2 else parts[1] if len(parts) > 1 else ""
        if owner.removesuffix(GLB) not in made or name.endswith(AS_BUILT):
            continue
        if name not in again:
            yield f"{name}: was not made again"
        elif name.endswith(".json"):
            text = read_plain(again[name], most_bytes(name)).decode()
            yield from value_differences(
                name, release_json(contents.text(name), name), release_json(text, name)
            )
        elif contents.read(name) != read_plain(again[name], most_bytes(name)):
            yield f"{name}: {AGAIN}"


def _entry_differences(
    contents: Contents,
    info: ReleaseInfo,
    settings: BenchmarkSettings,
    build: Path,
    made: dict[str, Published],
) -> Iterator[str]:
    """Yield a line for each key in the recordings' entries in benchmark.json and lineage.json that differs.

    A build does not contain the results of `compare-truth`. So `reference`, and `look` of a recording that
    has it, are not compared.
    """
    removals = list[Removed]()
    passed = gate(settings, build, tuple(made), allow_poor=True)
    passed = passed.said(lambda line: scrubbed({"look": line}, BENCHMARK_JSON, removals)["look"])
    lineage = {}
    if LINEAGE_JSON in contents.entries:
        lineage = dict(Lineage.parse(contents.text(LINEAGE_JSON), LINEAGE_JSON).recordings)
    for name, published in made.items():
        stated = info.recordings[name]
        believed = ("reference",) if stated.reference is None else ("reference", "look")
        old, new = (
            {key: value for key, value in entry.json_value().items() if key not in believed}
            for entry in (stated, passed.noted(name, published.info))
        )
        yield from value_differences(BENCHMARK_JSON, old, new, f"recordings.{name}")
        if name in lineage:
            old, new = (
                {key: value for key, value in row.json_value().items() if key not in OF_FILES}
                for row in (lineage[name], published.lineage)
            )
            yield from value_differences(LINEAGE_JSON, old, new, f"recordings.{name}")
