"""The card of a release: README.md from the template card.md."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any

from kinectbench.release.metadata import ReleaseInfo
from kinectbench.release.release import SPLITS, Target

TEMPLATE = Path(__file__).with_name("card.md")


@dataclass(frozen=True)
class CardTexts:
    """What a card says that depends on where the pairs come from.

    Attributes:
        source: end of the first sentence: "A benchmark for ... shape completion from".
        beside: what the folders beside `pairs/` hold.
    """

    source: str
    beside: str


RECORDED = CardTexts(
    "real RGB-D recordings",
    "Depth and\nmask of each view are in `views/`, the floor, the closed mesh and the labelled volume of "
    "each object in `objects/`.",
)


def card(
    info: ReleaseInfo, targets: Sequence[Target], warnings: Sequence[str], texts: CardTexts = RECORDED
) -> str:
    """The card as Markdown.

    Args:
        info: benchmark.json.
        targets: every pair.
        warnings: one line each.
        texts: what depends on where the pairs come from.
    """
    return Template(TEMPLATE.read_text()).substitute(
        name=info.name,
        source=texts.source,
        beside=texts.beside,
        license=info.license,
        framing=info.framing,
        partial_rule=info.partial_rule,
        package_version=info.package_version,
        counts=_counts(targets),
        example=targets[0].file,
        quality=_quality(info),
        warnings="\n".join(f"- {line}" for line in warnings) or "None.",
    )


def _counts(targets: Sequence[Target]) -> str:
    """Pairs and objects per category and split."""
    rows = []
    for category in sorted({target.category for target in targets}):
        here = [target for target in targets if target.category == category]
        objects = len({target.object for target in here})
        per_split = [str(sum(target.split == split for target in here)) for split in SPLITS]
        rows.append([category, str(objects), *per_split])
    return _markdown(["category", "objects", *(f"{split} pairs" for split in SPLITS)], rows)


def _quality(info: ReleaseInfo) -> str:
    """Every number of each recording's quality.json."""
    keys = sorted({key for recording in info.recordings.values() for key in _numbers(recording.quality)})
    rows = [
        [name, recording.object, str(recording.pairs), str(recording.refused)]
        + [_numbers(recording.quality).get(key, "") for key in keys]
        for name, recording in sorted(info.recordings.items())
    ]
    return _markdown(["recording", "object", "pairs", "refused", *keys], rows)


def _numbers(quality: Mapping[str, Any]) -> dict[str, str]:
    """The plain numbers of a quality.json, as text."""
    return {key: f"{value:.4g}" for key, value in quality.items() if type(value) in (int, float)}


def _markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
