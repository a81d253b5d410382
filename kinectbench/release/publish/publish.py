"""Publish a build as a release: a self-contained folder to predict, score and check."""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from kinectbench._version import __version__
from kinectbench.core import ReleaseError, replaced_folder
from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON, PublishOptions, ReleaseInfo
from kinectbench.core.artefacts.provenance import (
    THRESHOLDS_JSON,
    ColorPublished,
    Lineage,
    Removed,
    ThresholdsFile,
)
from kinectbench.core.artefacts.views import PairsFile
from kinectbench.release.contents import MOST_FILES, VIEW_IMAGES, refuse_large
from kinectbench.release.own_folder import refuse_other_content
from kinectbench.release.publish.datasheet import unanswered
from kinectbench.release.publish.gate import Gate, first_lines, gate
from kinectbench.release.publish.held_back import (
    SAID_OF_TRUTH,
    SETTINGS_KEYS,
    Isolated,
    isolate,
    refuse_framing,
)
from kinectbench.release.publish.previews import write_view_pictures
from kinectbench.release.publish.privacy import privacy, removed_lines, scrubbed, scrubbed_file
from kinectbench.release.publish.publish_recording import Built, Published, publish_recording
from kinectbench.release.publish.small_files import note_in_benchmark_json, release_info, write_small_files
from kinectbench.release.publish.texts import gives_away, release_texts, release_warnings
from kinectbench.settings.models import BenchmarkSettings

PRIVATE = "-private"


@dataclass(frozen=True)
class PublishSummary:
    """The result of publishing.

    Attributes:
        folder: the release, or its public part.
        benchmark_sha256: the hash that identifies the release in `folder`.
        pairs: number of pairs.
        recordings: ids of the published recordings, in the given order.
        warnings: one line each. The card has the same lines, except reasons that reveal held-back truth.
        private: folder of the private part, which has the truth for scoring; None if no truth is held back.
        private_sha256: the hash that identifies the private part.
        removed: removed private facts, one line each.
        unanswered: keys of the datasheet's unanswered questions.
        refused: ids of recordings left out because they violate limits of `publish.gate`.
        shortened: whether `warnings` have only the first of several quality warnings of a recording.
    """

    folder: Path
    benchmark_sha256: str
    pairs: int
    recordings: tuple[str, ...]
    warnings: tuple[str, ...]
    private: Path | None = None
    private_sha256: str | None = None
    removed: tuple[str, ...] = ()
    unanswered: tuple[str, ...] = ()
    refused: tuple[str, ...] = ()
    shortened: bool = False

    @property
    def scoring(self) -> Path:
        """The folder that has the truth: the private part if there is one."""
        return self.private or self.folder


# Largest number of files of recordings that lineage.json lists one by one: 100,000 take 11 MB there, and
# count as many JSON keys; a JSON file may have three times as many.
MOST_NAMED_FILES = 100_000
# Files and folders of a recording in a release, besides its pairs' files: three folders, mesh, volume, GLB,
# floor, quality and views.json.
FILES_OF_RECORDING = 9
NO_OPTIONS = PublishOptions(hold_back=(), thresholds=None)


def publish(
    settings: BenchmarkSettings,
    build: Path,
    out: Path,
    recordings: Sequence[str],
    options: PublishOptions = NO_OPTIONS,
) -> PublishSummary:
    """Write a release from the build folders of some recordings, replacing an earlier release.

    Args:
        settings: the benchmark's settings.
        build: the folder with a subfolder for each recording.
        out: the release's folder. With `hold_back`, its public part; the private part is `<out>-private`.
        recordings: ids of built recordings. A recording that has no pair, or that the gate refuses, is left
            out with a warning.
        options: thresholds, held-back splits and their isolation, whether poor recordings pass the gate.

    Raises:
        ReleaseError: a built file is missing; a pair has another framing or partial rule than the benchmark;
            no recording passes the gate; the same frames are in two splits; no pair exists; a split to hold
            back has no recording; a file is larger than `verify` accepts; or a folder holds something else.
        SettingsError: views are isolated, but the framing is `object`.
        StorageError: a built file is damaged, or the disk is full or read-only.
    """
    if options.isolate:
        refuse_framing(settings)
    private = out.with_name(out.name + PRIVATE)
    for folder in (out, private) if options.hold_back else (out,):
        refuse_other_content(folder)
    _refuse_empty_split(settings, recordings, options.hold_back)
    passed = gate(settings, build, recordings, bool(options.allow_poor))
    if not passed.published:
        raise ReleaseError(f"{build}: no recording to publish; {passed.first_reasons()}", what="no-pairs")
    _refuse_empty_split(settings, passed.published, options.hold_back)
    _refuse_many_files(settings, build, passed.published)
    hidden_ids = _held_back_ids(settings, options)
    isolated = isolate(settings, build, hidden_ids & set(passed.published)) if options.isolate else Isolated()
    passed = replace(
        passed,
        published=tuple(n for n in passed.published if n not in isolated.left_out),
        of_one_object=isolated.left_out,
    )
    complete = options.model_copy(update={"hold_back": ()})
    if not options.hold_back:
        with replaced_folder(out) as folder:
            return replace(_write(settings, build, folder, passed, complete, isolated), folder=out)
    with contextlib.ExitStack() as folders:
        hidden = folders.enter_context(replaced_folder(private))
        folder = folders.enter_context(replaced_folder(out))
        whole = _write(settings, build, hidden, passed, complete, isolated)
        public = _write(settings, build, folder, passed.for_everybody(hidden_ids), options, isolated)
        note_in_benchmark_json(hidden, public_benchmark_sha256=public.benchmark_sha256)
        note_in_benchmark_json(folder, private_benchmark_sha256=whole.benchmark_sha256)
        info = ReleaseInfo.read(folder)
    # The publisher also gets the reasons that reveal held-back truth.
    away = gives_away(info, settings)
    warnings = tuple(dict.fromkeys((*whole.warnings, *away, *isolated.lines())))
    return replace(
        public, folder=out, warnings=warnings, private=private, private_sha256=whole.benchmark_sha256
    )


def _held_back_ids(settings: BenchmarkSettings, options: PublishOptions) -> frozenset[str]:
    return frozenset(each.id for each in settings.recordings if each.split in options.hold_back)


def _refuse_many_files(settings: BenchmarkSettings, build: Path, recordings: Sequence[str]) -> None:
    """Raise an error if the release would have too many files, before hours are spent on writing it."""
    pairs = sum(len(PairsFile.read(build / name / "pairs").pairs) for name in recordings)
    of_pair = 2 + len(VIEW_IMAGES) + settings.publish.color
    total = of_pair * pairs + FILES_OF_RECORDING * len(recordings)
    if total > MOST_FILES:
        raise ReleaseError(
            f"{pairs} pairs of {len(recordings)} recordings would be {total} files, and a release may have "
            f"{MOST_FILES}: publish the recordings as several benchmarks, or set a smaller views.count",
            what="too-large",
        )


def _refuse_empty_split(
    settings: BenchmarkSettings, recordings: Sequence[str], hold_back: Sequence[str]
) -> None:
    """Raise an error if a split whose truth is to be held back has no recording."""
    by_id = settings.by_id()
    splits = {by_id[name].split for name in recordings}
    for split in hold_back:
        if split not in splits:
            raise ReleaseError(
                f"--hold-back {split}: no recording of this split was built; check the splits",
                what="no-pairs",
            )


def _write(
    settings: BenchmarkSettings,
    build: Path,
    folder: Path,
    passed: Gate,
    options: PublishOptions,
    isolated: Isolated,
) -> PublishSummary:
    """Write the recordings that `passed` the gate as one release into an empty folder; return its summary."""
    removals = list[Removed]()
    passed = passed.said(lambda line: scrubbed({"left_out": line}, BENCHMARK_JSON, removals)["left_out"])
    made = _pairs(settings, build, folder, passed, options, isolated, removals)
    passed = passed.with_pairs(made)
    if not made:
        raise ReleaseError(f"{build}: no pair to publish; {first_lines([*passed.lines()])}", what="no-pairs")
    targets = tuple(sorted(target for published in made.values() for target in published.targets))
    of_settings = list[Removed]()
    info = release_info(
        settings.name,
        settings.license,
        settings.pairs.framing,
        settings.pairs.partial_rule,
        _public_settings(settings, options.hold_back, of_settings, bool(options.isolate)),
        {name: published.info for name, published in made.items()},
        version=settings.publish.citation.version,
        held_back=options.hold_back,
        left_out=passed.left_out,
        flow=passed.flow,
        isolated=tuple(sorted(isolated.views)),
    )
    warnings = release_warnings(info, settings, targets, [*passed.lines()])
    _write_provenance(folder, made, options, removals)
    color = _color(settings, made)
    privacy(color, removals).write(folder)
    refuse_large(folder)  # before other files are made of these
    write_view_pictures(folder, [target for target in targets if not info.isolates(target.recording)])
    texts = release_texts(info, settings, targets, warnings, color, folder, build)
    scenes, citation = build if settings.publish.color else None, settings.publish.citation
    identity = write_small_files(
        info, folder, targets, warnings, citation=citation, texts=texts, scenes=scenes
    )
    refuse_large(folder)
    return PublishSummary(
        folder,
        identity,
        len(targets),
        tuple(made),
        tuple(warnings),
        removed=tuple(removed_lines([*removals, *of_settings])),
        unanswered=tuple(unanswered(settings)),
        refused=tuple(passed.refused),
        shortened=any(len(each.quality.warnings) > 1 for each in info.recordings.values()),
    )


def _pairs(
    settings: BenchmarkSettings,
    build: Path,
    folder: Path,
    passed: Gate,
    options: PublishOptions,
    isolated: Isolated,
    removals: list[Removed],
) -> dict[str, Published]:
    """Write the files of each recording that passed; return {id: published part} for those with a pair."""
    made = dict[str, Published]()
    by_id, recordings, hidden_ids = settings.by_id(), passed.published, _held_back_ids(settings, options)
    most_named = max(1, MOST_NAMED_FILES // max(1, len(recordings)))
    for name in recordings:
        hidden, only = name in hidden_ids, isolated.views.get(name)
        built = Built(settings, by_id[name], build / name, hidden, most_named, only)
        published = publish_recording(built, folder, removals)
        if published is not None:
            made[name] = replace(published, info=passed.noted(name, published.info))
    return made


def _write_provenance(
    folder: Path, made: Mapping[str, Published], options: PublishOptions, removals: list[Removed]
) -> None:
    """Write lineage.json, and thresholds.json if given; append removed facts to `removals`."""
    Lineage(
        format_version=1,
        package_version=__version__,
        packages=f"{BENCHMARK_JSON}: packages",
        recordings={name: published.lineage for name, published in made.items()},
    ).write(folder)
    if options.thresholds is not None:
        given = ThresholdsFile.parse(options.thresholds, THRESHOLDS_JSON)
        scrubbed_file(given, THRESHOLDS_JSON, removals).write(folder)


def _color(settings: BenchmarkSettings, made: Mapping[str, Published]) -> ColorPublished:
    """Return "none" if no recording has colour images, else whether they are "published" or "left out"."""
    if not any(published.has_color for published in made.values()):
        return "none"
    return "published" if settings.publish.color else "left out"


def _public_settings(
    settings: BenchmarkSettings, hold_back: Sequence[str], removals: list[Removed], isolate: bool = False
) -> dict[str, Any]:
    """Return the settings for benchmark.json, without private facts and without paths of this machine.

    Each recording whose truth is published states its underside (closed or open), because the category that
    may set it is not published. Recordings of the splits `hold_back` lack all keys that reveal their truth,
    including `underside`. With `isolate`, these recordings keep only `SETTINGS_KEYS`. Each private fact that
    is removed is appended to `removals`.
    """
    public = settings.model_dump(mode="json", exclude={"name", "license", "publish", "categories"})
    for recording, own in zip(public["recordings"], settings.recordings, strict=True):
        recording.pop("path")
        recording.pop("masks")
        recording.pop("reference")
        recording["underside"] = settings.underside_of(own)
        if recording["split"] in hold_back:
            hidden_keys = set(recording) - set(SETTINGS_KEYS) if isolate else SAID_OF_TRUTH
            for key in hidden_keys:
                recording.pop(key)
    # These statements of people are meant to be public, and stand in `recordings`, too.
    said = [_set_apart(row) for row in (public, *public["recordings"])]
    clean: dict[str, Any] = scrubbed(public, BENCHMARK_JSON, removals, settings)
    for row, words in zip((clean, *clean["recordings"]), said, strict=True):
        row.update(words)
    return clean | {"publish": settings.publish.model_dump(mode="json")}


def _set_apart(row: dict[str, Any]) -> dict[str, Any]:
    """Return {key: value} of `source` and `license` in `row`; in `row` itself, set both to None."""
    said: dict[str, Any] = {key: row[key] for key in ("source", "license") if key in row}
    row.update(dict.fromkeys(said))
    return said
