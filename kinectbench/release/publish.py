"""Publish what was built as a release: one folder that is enough to predict, to score and to check."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinectbench.config import BenchmarkSettings, RecordingSettings
from kinectbench.errors import PairError, ReleaseError
from kinectbench.release.metadata import RecordingInfo, read_text, strict_json
from kinectbench.release.release import Target
from kinectbench.release.small_files import Head, write_small_files
from kinectbench.voxels.pair_file import read_pair
from kinectbench.workspace import replaced_folder, sha256_file

OBJECT_FILES = ("floor.json", "mesh.ply", "volume.npz", "quality.json")


@dataclass(frozen=True)
class PublishSummary:
    """What was published.

    Attributes:
        folder: the release.
        benchmark_sha256: its identity.
        pairs: number of pairs.
        recordings: those published, in the order given.
        warnings: one line each; they are on the card too.
    """

    folder: Path
    benchmark_sha256: str
    pairs: int
    recordings: tuple[str, ...]
    warnings: tuple[str, ...]


def publish(settings: BenchmarkSettings, build: Path, out: Path, recordings: Sequence[str]) -> PublishSummary:
    """Write a release from the build folders of some recordings; it takes the place of what `out` held.

    Args:
        settings: the benchmark's.
        build: holds a folder per recording.
        out: the release's folder.
        recordings: ids, all of them built; one without a single pair is left out with a warning.

    Raises:
        ReleaseError: a built file is missing, a pair is not of the benchmark's framing and partial rule, or
            there is no pair at all.
        StorageError: the disk is full or read-only.
    """
    with replaced_folder(out) as folder:
        targets: list[Target] = []
        infos: dict[str, RecordingInfo] = {}
        warnings = _warnings(settings)
        for name in recordings:
            recording = settings.recording(name)
            here = _publish_pairs(settings, recording, build / name, folder)
            if not here:
                warnings.append(f"{name}: not a single view passed the checks of the pairs; it is left out")
                continue
            targets += here
            infos[name] = _recording_info(recording, build / name, len(here))
            _copy_views(build / name, folder / "views" / name, here, color=settings.publish.color)
            for file in OBJECT_FILES:
                _copy(build / name / "object" / file, folder / "objects" / name / file)
        if not targets:
            raise ReleaseError(f"{build}: no pair to publish; run pairs and see what it refused")
        targets.sort()
        identity = _write_small_files(settings, folder, tuple(targets), infos, warnings)
    return PublishSummary(out, identity, len(targets), tuple(infos), tuple(warnings))


def _warnings(settings: BenchmarkSettings) -> list[str]:
    """What a user of the release should know from the settings alone."""
    warnings = []
    if settings.license == "unspecified":
        warnings.append("no licence is stated: set `license` in benchmark.yaml before giving the data away")
    if settings.publish.color:
        warnings.append("colour images are included: look through them for faces and people")
    if not any(recording.split == "validation" for recording in settings.recordings):
        warnings.append("no validation split: thresholds are fixed at 0.5 unless a threshold file is given")
    return warnings


def _publish_pairs(
    settings: BenchmarkSettings, recording: RecordingSettings, build: Path, folder: Path
) -> list[Target]:
    """Copy the pairs of one recording."""
    listed = _json(build / "pairs" / "pairs.json").get("pairs", [])
    targets = []
    for view in sorted(f"{int(entry['view']):03d}" for entry in listed):
        source = build / "pairs" / f"{view}.npz"
        _check_pair(settings, source)
        file = f"pairs/{recording.id}/{view}.npz"
        _copy(source, folder / file)
        targets.append(
            Target(
                recording=recording.id,
                object=recording.object_name,
                view=view,
                category=recording.category,
                split=recording.split,
                file=file,
                sha256=sha256_file(folder / file),
            )
        )
    return targets


def _check_pair(settings: BenchmarkSettings, path: Path) -> None:
    """One benchmark has one framing and one partial rule."""
    try:
        pair = read_pair(path)
    except PairError as error:
        raise ReleaseError(str(error)) from error
    for key in ("framing", "partial_rule"):
        found, wanted = getattr(pair, key), getattr(settings.pairs, key)
        if found != wanted:
            raise ReleaseError(f"{path}: {key} is '{found}', the settings say '{wanted}'; run pairs again")


def _recording_info(recording: RecordingSettings, build: Path, pairs: int) -> RecordingInfo:
    """What benchmark.json says of a recording."""
    return RecordingInfo(
        object=recording.object_name,
        category=recording.category,
        split=recording.split,
        pairs=pairs,
        refused=sum(
            len(_json(build / file).get("refused", [])) for file in ("views/views.json", "pairs/pairs.json")
        ),
        quality=_json(build / "object" / "quality.json"),
    )


def _copy_views(build: Path, out: Path, targets: Sequence[Target], color: bool) -> None:
    """Copy depth and mask of every view that has a pair, and colour where it is wanted and there is any."""
    views = build / "views"
    _copy(views / "views.json", out / "views.json")
    for target in targets:
        for suffix in (".depth.png", ".mask.png"):
            _copy(views / f"{target.view}{suffix}", out / f"{target.view}{suffix}")
        image = f"{target.view}.color.jpg"
        if color and (views / image).is_file():
            _copy(views / image, out / image)


def _write_small_files(
    settings: BenchmarkSettings,
    folder: Path,
    targets: tuple[Target, ...],
    infos: dict[str, RecordingInfo],
    warnings: Sequence[str],
) -> str:
    """Write targets, splits, card, benchmark.json and the checksums; return the release's identity."""
    pairs = settings.pairs
    head = Head(
        settings.name, settings.license, pairs.framing, pairs.partial_rule, _public_settings(settings)
    )
    return write_small_files(head, folder, targets, infos, warnings)


def _public_settings(settings: BenchmarkSettings) -> dict[str, Any]:
    """The settings without the paths of the machine they were used on."""
    public = settings.model_dump(mode="json", exclude={"name", "license"})
    for recording in public["recordings"]:
        recording.pop("path")
        recording.pop("masks")
    return public


def _json(path: Path) -> dict[str, Any]:
    """A JSON object that a stage wrote."""
    content = strict_json(read_text(path), str(path))
    if not isinstance(content, dict):
        raise ReleaseError(f"{path}: not a JSON object; run the build again")
    return content


def _copy(source: Path, target: Path) -> None:
    """Copy one built file's bytes."""
    if not source.is_file():
        raise ReleaseError(f"{source}: missing; run the build again")
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)
