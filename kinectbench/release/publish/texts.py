"""The texts of a release that follow from its other files: `publish` writes them, `verify` compares them."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from kinectbench.core import listed
from kinectbench.core.artefacts.benchmark import RecordingInfo, ReleaseInfo
from kinectbench.core.artefacts.provenance import Lineage
from kinectbench.core.artefacts.targets import Target, by_recording
from kinectbench.release.contents import CHANGELOG, CROISSANT, DATACITE, DATASHEET, PREVIEW
from kinectbench.release.publish.attribution import changelog_text, reasons_against_distribution
from kinectbench.release.publish.card import RECORDED
from kinectbench.release.publish.croissant import described
from kinectbench.release.publish.datacite import datacite, day_by
from kinectbench.release.publish.datasheet import datasheet
from kinectbench.release.publish.gate import gate_lines, left_out_line
from kinectbench.release.publish.index_page import category_texts, preview_text
from kinectbench.release.publish.reconstruction_attack import attack_line
from kinectbench.release.publish.same_frames import TWICE
from kinectbench.release.publish.small_files import about_release, small_texts
from kinectbench.release.triage.rules import END_OF_WARNING
from kinectbench.settings.models import BenchmarkSettings

SHOWN_VIEWS = 6  # most views of a recording in a warning


def release_warnings(
    info: ReleaseInfo, settings: BenchmarkSettings, targets: Sequence[Target], of_gate: Iterable[str]
) -> list[str]:
    """Return a release's warnings: possible harm first, then faults of the truth, then limits of its use.

    `of_gate` are the lines on recordings that are left out, poor, to review, or published twice.
    """
    infos = info.recordings
    return [
        *reasons_against_distribution(infos),
        *gives_away(info, settings),
        *of_gate,
        *_of_quality(infos),
        *_unknown(targets),
        *_without_thresholds(settings, infos),
    ]


def gives_away(info: ReleaseInfo, settings: BenchmarkSettings) -> Iterator[str]:
    """Yield warnings on what a release may reveal: people in colour images, shapes that are held back."""
    if settings.publish.color:
        yield "colour images are included: look through them for faces and people"
    if info.held_back and not info.isolated and (line := attack_line(info.recordings)):
        yield line
    if info.held_back and settings.pairs.framing == "object":
        yield (
            "with framing 'object' the cube of a held-back pair tells how long its shape is and where its "
            "middle lies: use `pairs: {framing: view}`"
        )


def _without_thresholds(settings: BenchmarkSettings, infos: Mapping[str, RecordingInfo]) -> Iterator[str]:
    """Yield a warning if the release has no validation split: methods get their thresholds from it."""
    names = [recording.id for recording in settings.recordings if recording.split == "validation"]
    if not any(name in infos for name in names):
        why = f" is published, as this release is without {listed(names)}" if names else ""
        yield f"no validation split{why}: thresholds are fixed at 0.5 unless a threshold file is given"


def _of_quality(infos: Mapping[str, RecordingInfo]) -> Iterator[str]:
    """Yield a line for each recording with quality warnings: the first warning, and how many follow.

    Warnings that the gate's lines already state are left out.
    """
    for name, info in infos.items():
        of_gate = "; ".join((*info.poor, *info.look))
        warnings = [line for line in info.quality.warnings if line.split(END_OF_WARNING, 1)[0] not in of_gate]
        more = f" (and {len(warnings) - 1} more)" if len(warnings) > 1 else ""
        if warnings:
            yield f"{name}: {warnings[0]}{more}"


def _unknown(targets: Sequence[Target]) -> Iterator[str]:
    """Yield a line for each recording that has pairs whose true shape is entirely unknown."""
    for name, pairs in by_recording(targets).items():
        views = [target.view for target in pairs if target.unknown_share == 1]
        if views:
            count = "1 pair" if len(views) == 1 else f"{len(views)} pairs"
            shown = f"{', '.join(views[:SHOWN_VIEWS])}{', …' if len(views) > SHOWN_VIEWS else ''}"
            yield (
                f"{name}: nothing of the true shape is known in {count} ({shown}); the protocol `known` "
                "leaves them out"
            )


def stated_warnings(
    info: ReleaseInfo, settings: BenchmarkSettings, targets: Sequence[Target], card_text: str
) -> list[str]:
    """Return the warnings of a release of recordings, derived from its files, without advice.

    Lines on recordings with the same frames cannot be derived, so they are taken from the card.
    """
    # In the order of the settings, as `gate` judges them.
    infos = {each.id: info.recordings[each.id] for each in settings.recordings if each.id in info.recordings}
    lines = gate_lines(
        [left_out_line(name, why) for name, why in (info.left_out or {}).items()],
        {name: (each.poor, each.accepted or "") for name, each in infos.items() if each.poor},
        {name: each.look for name, each in infos.items() if each.look},
    )
    twice = [line[2:] for line in card_text.split("\n") if line.startswith("- ") and TWICE in line]
    return release_warnings(info, settings, targets, [*lines, *twice])


def release_texts(
    info: ReleaseInfo,
    settings: BenchmarkSettings,
    targets: Sequence[Target],
    warnings: Sequence[str],
    color: str,
    folder: Path | None = None,
    build: Path | None = None,
) -> Iterator[tuple[str, str]]:
    """Yield (file, text) of the texts of a release of recordings.

    Args:
        info: content of benchmark.json.
        settings: the benchmark's settings.
        targets: every pair.
        warnings: the release's warnings, one line each.
        color: whether colour images are "left out", "published" or do not exist ("none").
        folder: the release's folder; None: `NO_PICTURE` stands for each picture.
        build: folder with scene meshes, which give objects their colours if colour is published.
    """
    yield from small_texts(info, targets, warnings, RECORDED, settings.publish.citation)
    yield DATASHEET, datasheet(info, settings, targets, warnings, color)
    yield CHANGELOG, changelog_text(settings.publish.changelog, info.name)
    yield PREVIEW, preview_text(info, settings, targets, warnings, folder, build)
    yield from category_texts(info, settings, targets, folder)


def release_facts(
    info: ReleaseInfo, settings: BenchmarkSettings, warnings: Sequence[str], lineage: Lineage | None
) -> Mapping[str, dict[str, Any]]:
    """Return {file: keys and values} for croissant.json and datacite.json of a release of recordings."""
    citation = settings.publish.citation
    about = about_release(info, RECORDED, citation, day_by(citation, lineage), warnings)
    return {CROISSANT: described(about), DATACITE: datacite(about)}
