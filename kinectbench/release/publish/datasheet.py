"""Make datasheet.md: purpose, making and known faults of a release's data."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from string import Template

from kinectbench._version import __version__
from kinectbench.core.artefacts.benchmark import RecordingInfo, ReleaseInfo
from kinectbench.core.artefacts.object import INTERVAL_HIGH, INTERVAL_LOW
from kinectbench.core.artefacts.targets import Target
from kinectbench.release.publish.attribution import (
    citation_line,
    common_license,
    markdown_line,
    reasons_against_distribution,
    without_tags,
)
from kinectbench.release.publish.card import counts_table, underside_line
from kinectbench.release.publish.held_back import isolated_line
from kinectbench.settings.models import BenchmarkSettings

TEMPLATE = Path(__file__).with_name("datasheet.md")
NOT_STATED = "Not stated."
# Key of quality.json -> label, unit, factor.
FIGURES = {
    "estimated_iou": ("estimated IoU of the solid to the unknown truth", "", 1.0),
    "estimated_iou_low": (INTERVAL_LOW, "", 1.0),
    "estimated_iou_high": (INTERVAL_HIGH, "", 1.0),
    "estimated_known_iou": ("the same over known voxels alone", "", 1.0),
    "repeatability_iou": ("IoU of solids made of odd and of even frames", "", 1.0),
    "surface_sigma_m": ("standard deviation of the surface", " mm", 1000.0),
    "unknown_share": ("share of the solid that no frame saw", " %", 100.0),
    "unknown_air_share": ("space beside it that no frame saw, taken for air, by its volume", " %", 100.0),
    "doubtful_share": ("share of the solid that may be a hollow", " %", 100.0),
    "underside_share": ("share of the solid that could be seen from below only", " %", 100.0),
}


def unanswered(settings: BenchmarkSettings) -> list[str]:
    """Return the keys of `publish.datasheet` that have no answer."""
    return [key for key, value in settings.publish.datasheet.model_dump().items() if not value]


def datasheet(
    info: ReleaseInfo,
    settings: BenchmarkSettings,
    targets: Sequence[Target],
    warnings: Sequence[str],
    color: str,
) -> str:
    """Return the datasheet as Markdown.

    Held-back recordings have no quality. Colour images are "left out", "published" or do not exist ("none").
    """
    infos, held_back = info.recordings, "Nothing is held back."
    if info.held_back:
        held_back = f"The truth of the split {', '.join(info.held_back)} is held back."
        held_back += f" {isolated_line(info.isolated)}" if info.isolated else ""
    given = settings.publish.datasheet.model_dump()
    answers = {key: without_tags(value or NOT_STATED) for key, value in given.items()}
    refused = sum(info.refused for info in infos.values())
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        answers,
        name=settings.name,
        package_version=__version__,
        counts=counts_table(targets),
        held_back=held_back,
        sensors=_sources(infos),
        strategy=settings.views.strategy,
        seed=str(settings.views.seed),
        refused=str(refused),
        pairs=str(len(targets)),
        framing=settings.pairs.framing,
        partial_rule=settings.pairs.partial_rule,
        color=color,
        figures=datasheet_figures(infos),
        quality_warnings=_listed(
            [f"{name}: {line}" for name, info in sorted(infos.items()) for line in info.quality.warnings]
        ),
        warnings=_listed(warnings),
        license=markdown_line(common_license(infos, settings.license)),
        distribution=" ".join(
            f"**Not for distribution**: {reason}." for reason in reasons_against_distribution(infos)
        ),
        citation=markdown_line(citation_line(settings.publish.citation, settings.name)),
    )


def _sources(infos: Mapping[str, RecordingInfo]) -> str:
    """Return a Markdown list of the sources, each with the recordings that come from it."""
    by_source: dict[str, list[str]] = {}
    for name, info in sorted(infos.items()):
        by_source.setdefault(markdown_line(info.source), []).append(name)
    return _listed([f"{', '.join(names)}: {source}" for source, names in by_source.items()])


def datasheet_figures(infos: Mapping[str, RecordingInfo]) -> str:
    """Return a Markdown list: median and range over recordings of each known value, and `underside_line`."""
    lines = []
    for key, (text, unit, factor) in FIGURES.items():
        of_key = [getattr(info.quality, key) for info in infos.values()]
        values = [factor * value for value in of_key if value is not None]
        if values:
            low, middle, high = (f"{value:.3g}" for value in (min(values), median(values), max(values)))
            spread = f" ({low} to {high})" if len(values) > 1 else ""
            count = f"{len(values)} recording{'s' * (len(values) > 1)}"
            lines.append(f"{text}: {middle}{spread}{unit}, of {count}")
    lines += filter(None, [underside_line(infos)])
    return _listed(lines) if lines else "- nothing"


def _listed(lines: Sequence[str]) -> str:
    return "\n".join(f"- {line}" for line in lines) or "- none"
