"""The texts of a release that follow from its other files: `publish` writes them, `verify` compares them."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from kinectbench.core.artefacts.benchmark import ReleaseInfo
from kinectbench.core.artefacts.provenance import Lineage
from kinectbench.core.artefacts.targets import Target
from kinectbench.release.contents import (
    CARD,
    CHANGELOG,
    CITATION,
    CROISSANT,
    DATACITE,
    DATASHEET,
    LICENSE,
    PREVIEW,
    READING,
)
from kinectbench.release.publish.attribution import (
    changelog_text,
    citation_text,
    common_license,
    license_text,
)
from kinectbench.release.publish.card import card, reading
from kinectbench.release.publish.category_pages import category_texts
from kinectbench.release.publish.croissant import described
from kinectbench.release.publish.datacite import datacite, day_by
from kinectbench.release.publish.datasheet import datasheet
from kinectbench.release.publish.gate import gate_lines, left_out_line
from kinectbench.release.publish.index_page import preview_text
from kinectbench.release.publish.release_warnings import release_warnings
from kinectbench.release.publish.same_frames import TWICE
from kinectbench.release.publish.small_files import Head, about_release
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
    return release_warnings(
        settings, info.recordings, targets, [*lines, *twice], info.held_back, bool(info.isolated)
    )


def release_texts(
    info: ReleaseInfo,
    settings: BenchmarkSettings,
    targets: Sequence[Target],
    warnings: Sequence[str],
    color: str,
) -> Iterator[tuple[str, str]]:
    """Yield (file, text) of the texts of a release of recordings; `NO_PICTURE` stands for each picture.

    Args:
        info: content of benchmark.json.
        settings: the benchmark's settings.
        targets: every pair.
        warnings: the release's warnings, one line each.
        color: whether colour images are "left out", "published" or do not exist ("none").
    """
    infos, hold_back = info.recordings, info.held_back
    license, bare = common_license(infos, info.license), info.isolated if hold_back else ()
    yield CARD, card(info, targets, warnings, license)
    yield DATASHEET, datasheet(settings, targets, infos, color, warnings, hold_back, info.isolated)
    yield READING, reading(targets, hold_back)
    yield CHANGELOG, changelog_text(settings.publish.changelog, info.name)
    yield LICENSE, license_text(info.name, license, infos)
    yield CITATION, citation_text(settings.publish.citation, info.name, license)
    yield PREVIEW, preview_text(None, settings, targets, infos, warnings, hold_back, isolated=bare)
    yield from category_texts(None, settings, targets, infos, hold_back, bare)


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
    stated = info.settings.json_value()
    head = Head(info.name, info.license, info.framing, info.partial_rule, stated, citation=citation)
    license = common_license(info.recordings, info.license)
    about = about_release(head, license, day_by(citation, lineage), warnings)
    return {CROISSANT: described(about), DATACITE: datacite(about)}
