"""The texts of a release that follow from its other files: `publish` writes them, `verify` compares them."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from kinectbench.core.artefacts.benchmark import ReleaseInfo
from kinectbench.core.artefacts.provenance import Lineage
from kinectbench.core.artefacts.targets import Target
from kinectbench.release.contents import CHANGELOG, CROISSANT, DATACITE, DATASHEET, PREVIEW
from kinectbench.release.publish.attribution import changelog_text
from kinectbench.release.publish.card import RECORDED
from kinectbench.release.publish.category_pages import category_texts
from kinectbench.release.publish.croissant import described
from kinectbench.release.publish.datacite import datacite, day_by
from kinectbench.release.publish.datasheet import datasheet
from kinectbench.release.publish.gate import gate_lines, left_out_line
from kinectbench.release.publish.index_page import preview_text
from kinectbench.release.publish.release_warnings import release_warnings
from kinectbench.release.publish.same_frames import TWICE
from kinectbench.release.publish.small_files import about_release, small_texts
from kinectbench.settings.models import BenchmarkSettings


def stated_warnings(
    info: ReleaseInfo, settings: BenchmarkSettings, targets: Sequence[Target], card_text: str
) -> list[str]:
    """Return the warnings of a release of recordings, derived from its files, without advice.

    Lines on recordings with the same frames cannot be derived, so they are taken from the card.

    Args:
        info: content of benchmark.json.
        settings: the benchmark's settings.
        targets: every pair.
        card_text: text of the card.
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
    """Return {file: keys with their values} for croissant.json and datacite.json of a release of recordings.

    Args:
        info: content of benchmark.json.
        settings: the benchmark's settings.
        warnings: the release's warnings, one line each.
        lineage: content of lineage.json.
    """
    citation = settings.publish.citation
    about = about_release(info, RECORDED, citation, day_by(citation, lineage), warnings)
    return {CROISSANT: described(about), DATACITE: datacite(about)}
