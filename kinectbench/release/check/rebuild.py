"""Rebuild a release's pairs from its recordings: plan the build, then compare the files with the release."""

import hashlib
import io
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import cast

import numpy as np

from kinectbench._version import __version__
from kinectbench.core import (
    PairError,
    ReleaseError,
    SettingsError,
    listed,
    printable,
    read_plain,
    sha256_file,
)
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, UNSPECIFIED, ReleaseInfo
from kinectbench.core.artefacts.manifest import Sources
from kinectbench.core.artefacts.provenance import LINEAGE_JSON, Lineage, LineageRecording, files_hash
from kinectbench.core.artefacts.targets import TARGETS_CSV, Target, by_recording, parse_targets
from kinectbench.core.types import FileArray
from kinectbench.core.voxels.pair_file import PACKED_SHAPES, packed_count, pair_values
from kinectbench.engine.artefact import VERSIONS
from kinectbench.release.check.republish_check import AGAIN, republished_differences
from kinectbench.release.check.text_check import release_settings
from kinectbench.release.contents import OBJECT_FILES, VIEW_IMAGES, Contents, most_bytes
from kinectbench.release.publish.small_files import data_package_versions
from kinectbench.settings.file import load_benchmark
from kinectbench.settings.models import BenchmarkSettings, RecordingSettings

# At most this many files of a recording are named in a line.
SHOWN = 3


@dataclass(frozen=True)
class LocalRecording:
    """The paths of a recording on this machine.

    Attributes:
        path: the recording's file or folder.
        masks: folder of the user's masks; None if there is none.
        reference: the mesh that is the recording's truth; None if there is none.
        stated: what a benchmark.yaml states of it: licence, source, object, category and split, by key.
    """

    path: Path
    masks: Path | None = None
    reference: Path | None = None
    stated: Mapping[str, str] = field(default_factory=dict)

    @property
    def paths(self) -> dict[str, Path | None]:
        """{key of the recording's settings: its path here}."""
        return {"path": self.path, "masks": self.masks, "reference": self.reference}


@dataclass(frozen=True)
class RebuildPlan:
    """The plan of a rebuild and of its comparison with the release.

    Attributes:
        settings: the release's settings for the recordings to rebuild, with this machine's paths.
        targets: the pairs to compare.
        notes: one line for each version that differs here, and each reason why pairs are not compared.
        other_terms: one line for each statement that differs in the benchmark.yaml on this machine.
    """

    settings: BenchmarkSettings
    targets: tuple[Target, ...]
    notes: tuple[str, ...]
    other_terms: tuple[str, ...] = ()


def find_sources(path: Path, suffixes: Sequence[str] = ()) -> dict[str, LocalRecording]:
    """Return {recording id: its paths}, read from a benchmark.yaml or from the names in a folder.

    Args:
        path: a benchmark.yaml, a folder with one, or a folder of recordings (`<id>/`, `<id>.bag`, ...).
        suffixes: endings of recordings, such as ".bag". Of several files `<id>.*`, one with such an ending is
            taken; a folder `<id>/` is preferred to files.

    Raises:
        SettingsError: the folder does not exist, or benchmark.yaml is wrong.
    """
    config = path / "benchmark.yaml" if path.is_dir() else path
    if config.is_file():
        settings = load_benchmark(config, ())
        root = config.parent
        return {
            r.id: LocalRecording(
                root / r.path,
                None if r.masks is None else root / r.masks,
                None if r.reference is None else root / r.reference,
                _stated(settings, r),
            )
            for r in settings.recordings
        }
    if not path.is_dir():
        raise SettingsError(f"{path}: no such benchmark.yaml or folder of recordings", what="no-file")
    entries = sorted(path.iterdir(), key=lambda each: (each.name.lower().endswith(tuple(suffixes)), each))
    by_id = {each.stem: LocalRecording(each) for each in entries if not each.name.startswith(".")}
    return by_id | {each.name: LocalRecording(each) for each in entries if each.is_dir()}


def _stated(settings: BenchmarkSettings, recording: RecordingSettings) -> dict[str, str]:
    """Return {key: value} of what benchmark.yaml states of a recording, without defaults."""
    terms = {"license": settings.license_of(recording), "source": settings.source_of(recording)}
    own = {"object": recording.object, "category": recording.category}
    own |= {"split": recording.split} if "split" in recording.model_fields_set else {}
    return {key: value for key, value in (terms | own).items() if value not in (None, UNSPECIFIED)}


def rebuild_plan(
    contents: Contents, sources: Mapping[str, LocalRecording], objects: int | None = None
) -> RebuildPlan:
    """Return the plan for rebuilding a release's pairs.

    Args:
        contents: the release.
        sources: {recording id: its paths}.
        objects: number of objects to rebuild, drawn reproducibly by the release's hash; None: all objects.

    Raises:
        ReleaseError: the release was not made from recordings, or by a version with other settings; or all
            its truth is held back, or all its views are isolated; or benchmark.json lacks a recording.
        SettingsError: recordings are missing (the message names all), or a recording's truth is a reference
            mesh that `sources` lacks.
    """
    metadata = ReleaseInfo.parse(contents.text(BENCHMARK_JSON), BENCHMARK_JSON)
    targets = parse_targets(contents.text(TARGETS_CSV), TARGETS_CSV)
    held_back = metadata.held_back
    isolated = sorted({t.recording for t in targets} & set(metadata.isolated))
    kept = tuple(t for t in targets if t.split not in held_back and t.recording not in isolated)
    every = {target.object for target in kept}
    drawn = set(sorted(every, key=partial(_draw, metadata.benchmark_sha256))[:objects])
    kept = tuple(target for target in kept if target.object in drawn)
    wanted = {target.recording for target in kept}
    missing = sorted(name for name in wanted if name not in sources or not sources[name].path.exists())
    if missing:
        raise SettingsError(
            f"no recording here for {', '.join(missing)}; give the folder that holds them",
            what="no-recording",
        )
    for name in sorted(wanted):
        if name not in metadata.recordings:
            raise ReleaseError(f"{BENCHMARK_JSON}: lacks the recording {name}; make or download it again")
        if metadata.recordings[name].quality.truth is not None and sources[name].reference is None:
            raise SettingsError(
                f"{name}: its truth is a reference mesh; give a benchmark.yaml that names it as `reference`",
                what="no-file",
            )
    if not wanted:
        raise ReleaseError(
            "all views are isolated: `kinectbench publish` without --isolate makes a release to be made again"
            if isolated
            else "all truth is held back: only the private part can be made again",
            what="not-rebuildable",
        )
    notes = [*version_notes(metadata), *_stage_notes(contents, wanted)]
    if drawn != every:
        notes.append(f"{len(drawn)} of {len(every)} objects are made again: {', '.join(sorted(drawn))}")
    if held_back:
        notes.append(f"the truth of {', '.join(held_back)} is held back: its pairs are not compared")
    if isolated:
        notes.append(f"of {', '.join(isolated)} one view is published, isolated: its pair is not compared")
    terms = tuple(_other_terms(metadata, sources, wanted))
    return RebuildPlan(_settings(metadata, sources, wanted), kept, tuple(notes), terms)


def _draw(identity: str, name: str) -> str:
    """Return object `name`'s sort key in a reproducible draw: a hash of the name and the release's hash."""
    return hashlib.sha256(f"{identity} {name}".encode()).hexdigest()


def _settings(
    metadata: ReleaseInfo, sources: Mapping[str, LocalRecording], wanted: set[str]
) -> BenchmarkSettings:
    """Return the release's settings, reduced to the `wanted` recordings, with their paths on this machine."""
    stated = release_settings(metadata)
    rows = [
        each.model_copy(
            update={key: path and str(path.resolve()) for key, path in sources[each.id].paths.items()}
        )
        for each in stated.recordings
        if each.id in wanted
    ]
    return stated.model_copy(update={"recordings": tuple(rows)})


def _other_terms(
    metadata: ReleaseInfo, sources: Mapping[str, LocalRecording], wanted: set[str]
) -> Iterator[str]:
    """Yield a line for each statement that differs in the benchmark.yaml on this machine."""
    for name in sorted(wanted):
        for key, here in sources[name].stated.items():
            stated = getattr(metadata.recordings[name], key)
            if here != stated:
                said = f"{key} of {name} is '{printable(stated)}'"
                yield f"{BENCHMARK_JSON}: {said}, which benchmark.yaml states as '{printable(here)}'"


def version_notes(metadata: ReleaseInfo) -> list[str]:
    """Return a line for each package whose version here differs from the version that made the release."""
    made = {"kinectbench": metadata.package_version, **metadata.packages}
    installed = {"kinectbench": __version__, **data_package_versions()}
    return [
        f"made with {name} {version}, here is {installed.get(name, 'none')}: results may differ"
        for name, version in made.items()
        if installed.get(name) != version
    ]


def _stage_notes(contents: Contents, recordings: Collection[str]) -> list[str]:
    """Return a line for each stage whose version here differs from the one that built these recordings."""
    lineage = _lineage(contents)
    made = {
        (stage, row.stage_version)
        for name in recordings
        if name in lineage
        for stage, row in lineage[name].stages.items()
        if row.stage_version is not None  # older releases lack it
    }
    return [
        f"made with version {version} of {stage}, here is {VERSIONS.get(stage, 'none')}: results will differ"
        for stage, version in sorted(made)
        if VERSIONS.get(stage) != version
    ]


def _lineage(contents: Contents) -> Mapping[str, LineageRecording]:
    if LINEAGE_JSON not in contents.entries:
        return {}
    return Lineage.parse(contents.text(LINEAGE_JSON), LINEAGE_JSON).recordings


def differences(contents: Contents, plan: RebuildPlan, build: Path) -> Iterator[str]:
    """Yield a line for each rebuilt file or pair that differs from the published one, or is missing.

    If all objects, images and pairs are equal, the other files that `publish` makes are compared, too.
    `build` has a subfolder for each built recording.
    """
    yield from plan.other_terms
    differs = False
    for line in _built_differences(contents, plan, build):
        differs = True
        yield line
    if not differs:
        yield from republished_differences(contents, plan.settings, plan.targets, build)


def _built_differences(contents: Contents, plan: RebuildPlan, build: Path) -> Iterator[str]:
    """Yield a line for each object, image or pair that differs; the arguments are those of `differences`."""
    lineage = _lineage(contents)
    for recording, targets in sorted(by_recording(plan.targets).items()):
        folder = build / recording
        if not (folder / "pairs" / "pairs.json").is_file():
            yield f"{recording}: could not be built again, so none of its {len(targets)} pairs was compared"
            continue
        # In the order of making: the first difference shows where it begins.
        if recording in lineage:
            yield from _source_difference(lineage[recording], recording, folder)
        for file in OBJECT_FILES:
            yield from _file_difference(contents, f"objects/{recording}/{file}", folder / "object" / file)
        for target in targets:
            for suffix in VIEW_IMAGES:
                image = f"{target.view}{suffix}"
                yield from _file_difference(contents, f"views/{recording}/{image}", folder / "views" / image)
            yield from _pair_difference(contents, target, folder / "pairs" / f"{target.view}.npz")
        published = {target.view for target in targets}
        for made in sorted((folder / "pairs").glob("*.npz")):
            if made.stem not in published:
                yield f"{recording}/{made.stem}: made again, but there is no such pair in the release"


def _source_difference(row: LineageRecording, recording: str, build: Path) -> Iterator[str]:
    """Yield a line if the hashes of the recording's files on this machine differ from lineage.json.

    `row` is the recording's entry in lineage.json; `build` is its folder here, with the hashes of its files.
    """
    made = Sources.read_if_there(build)
    if made is None:
        return
    published, hashes = row.files, made.sha256
    if set(hashes) == {""}:  # a recording of one file, whose name may differ here
        hashes = dict.fromkeys(published, hashes[""])
    names = [name for name in {**published, **hashes} if published.get(name) != hashes.get(name)]
    if published and names:
        yield f"{recording}: not the recording that was published: {listed(names, SHOWN)} differ"
    if row.files_sha256 not in (None, files_hash(hashes)):
        yield f"{recording}: not the recording that was published: its {len(hashes)} files are others"


def _file_difference(contents: Contents, name: str, made: Path) -> Iterator[str]:
    if name not in contents.entries:
        return  # pairs from elsewhere have no such files
    if not made.is_file():
        yield f"{name}: was not made again"
        return
    try:
        with contents.stream(name) as published:
            digest = hashlib.file_digest(cast(io.BufferedIOBase, published), "sha256").hexdigest()
        if digest != sha256_file(made):
            yield f"{name}: {AGAIN}"
    except OSError as error:
        yield f"{name}: {_unreadable(made, error)}"


def _pair_difference(contents: Contents, target: Target, made: Path) -> Iterator[str]:
    """Yield a line if a rebuilt pair differs from the published one; the line names the keys that differ."""
    if not made.is_file():
        yield f"{target.file}: was not made again: its view was refused, or another was drawn"
        return
    published = contents.read(target.file)
    try:
        again = read_plain(made, most_bytes(target.file))
        if published == again:
            return
        old, new = pair_values(published, target.file), pair_values(again, str(made))
    except OSError as error:
        yield f"{target.file}: {_unreadable(made, error)}"
        return
    except PairError as error:
        yield str(error)
        return
    words = [
        word
        for key in dict.fromkeys((*old, *new))
        if (word := _key_difference(key, old.get(key), new.get(key)))
    ]
    yield f"{target.file}: {AGAIN}: {', '.join(words) or 'the same values, but packed otherwise'}"


def _unreadable(made: Path, error: OSError) -> str:
    return f"what was made again cannot be read ({made}: {error.strerror or error})"


def _key_difference(key: str, old: FileArray | None, new: FileArray | None) -> str | None:
    """Return a short text on how a key's published and rebuilt values differ; None if they are equal."""
    if old is None or new is None:
        return f"{key} only in {'the release' if new is None else 'the new one'}"
    # Texts of different lengths have different dtypes.
    if old.shape != new.shape or (old.dtype != new.dtype and old.dtype.kind != "U"):
        return f"{key} has another shape or type"
    if np.array_equal(old, new):
        return None
    if key in PACKED_SHAPES:
        return f"{key} in {packed_count(np.ascontiguousarray(old ^ new))} cells"
    if old.dtype.kind == "f":
        return f"{key} by {np.abs(old - new).max():.3g}"
    return f"{key} ({old} there, {new} here)"
