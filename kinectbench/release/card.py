"""The card of a release: README.md from the template card.md."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any

import yaml

from kinectbench.release.layout import LICENSE, SPLIT_TARGETS
from kinectbench.release.metadata import ReleaseInfo
from kinectbench.release.origins import HUGGING_FACE, UNSPECIFIED
from kinectbench.release.quality_words import QUALITY, quality_words
from kinectbench.release.release import SPLITS, Target

SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"), (10**12, "n>1M"))
TRUTH_LINES = """\
full = np.unpackbits(pair["full"], axis=-1).astype(bool)  # (256, 256, 256), the truth
known = np.unpackbits(pair["known"], axis=-1).astype(bool)  # the truth is trusted there"""
INPUT_LINES = """\
partial_256 = np.unpackbits(pair["partial_256"], axis=-1).astype(bool)  # (256, 256, 256), the same, finer"""
TEMPLATE = Path(__file__).with_name("card.md")


@dataclass(frozen=True)
class CardTexts:
    """What a card says that depends on where the pairs come from.

    Attributes:
        source: end of the first sentence: "A benchmark for ... shape completion from".
        beside: what the folders beside `pairs/` hold.
        origin: source of a recording that states none; empty: it has to.
    """

    source: str
    beside: str
    origin: str = ""


RECORDED = CardTexts(
    "real RGB-D recordings",
    "Depth and\nmask of each view are in `views/`, the floor, the closed mesh and the labelled volume of "
    "each object in `objects/`. `datasheet.md` says what the benchmark is for and what is wrong with it,\n"
    "`lineage.json` where every pair comes from, `schemas/` what every file holds; `index.html` shows every "
    "object.",
)


def card(
    info: ReleaseInfo,
    targets: Sequence[Target],
    warnings: Sequence[str],
    license: str,
    texts: CardTexts = RECORDED,
) -> str:
    """The card as Markdown, with the YAML head that Hugging Face reads.

    Args:
        info: benchmark.json.
        targets: every pair.
        warnings: one line each.
        license: of all recordings.
        texts: what depends on where the pairs come from.
    """
    example = next((t for t in targets if t.split not in info.held_back), targets[0])
    hidden = example.split in info.held_back
    body = Template(TEMPLATE.read_text()).substitute(
        name=info.name,
        source=texts.source,
        beside=texts.beside,
        license=license,
        framing=info.framing,
        partial_rule=info.partial_rule,
        package_version=info.package_version,
        notice=_notice(info),
        counts=counts_table(targets),
        example=example.file,
        truth=INPUT_LINES if hidden else TRUTH_LINES,
        shown="partial_256" if hidden else "full",
        quality=_quality(info),
        warnings="\n".join(f"- {line}" for line in warnings) or "None.",
    )
    return f"---\n{_head(info, targets, license)}---\n\n{body}"


def _head(info: ReleaseInfo, targets: Sequence[Target], license: str) -> str:
    """The card's YAML: https://huggingface.co/docs/hub/datasets-cards."""
    known = HUGGING_FACE.get(license)
    content: dict[str, Any] = {"license": known or ("unknown" if license == UNSPECIFIED else "other")}
    if content["license"] == "other":
        content |= {"license_name": re.sub(r"[^a-z0-9.-]+", "-", license.lower()).strip("-")}
        content |= {"license_link": LICENSE}
    present = [split for split in SPLITS if any(target.split == split for target in targets)]
    content |= {
        "pretty_name": info.name,
        "task_categories": ["image-to-3d"],
        "tags": ["3d", "shape-completion", "rgb-d", "voxels", "benchmark", *sorted(_categories(targets))],
        "size_categories": [next(name for limit, name in SIZES if len(targets) < limit)],
        "configs": [
            {
                "config_name": "targets",
                "default": True,
                "data_files": [{"split": s, "path": f"{SPLIT_TARGETS}/{s}.csv"} for s in present],
            }
        ],
    }
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=10**9)


def _categories(targets: Sequence[Target]) -> set[str]:
    return {target.category for target in targets}


def _notice(info: ReleaseInfo) -> str:
    """What must be known before anything else; empty for a complete release that may be given away."""
    lines = []
    if info.distribution is not None and not info.distribution.allowed:
        lines += ["**Not for distribution.**", *(f"- {reason}" for reason in info.distribution.reasons), ""]
    if info.held_back:
        lines += [
            f"**The truth of the split {', '.join(info.held_back)} is held back**: its pair files hold the "
            "input only. Send your predictions to whoever published the benchmark to have them scored.",
            "",
        ]
    return "\n".join(lines) + "\n" if lines else ""


def counts_table(targets: Sequence[Target]) -> str:
    """Pairs and objects per category and split."""
    rows = []
    for category in sorted({target.category for target in targets}):
        here = [target for target in targets if target.category == category]
        objects = len({target.object for target in here})
        per_split = [str(sum(target.split == split for target in here)) for split in SPLITS]
        rows.append([category, str(objects), *per_split])
    return _markdown(["category", "objects", *(f"{split} pairs" for split in SPLITS)], rows)


def _quality(info: ReleaseInfo) -> str:
    """The figures of each recording's quality.json, in words."""
    words = {name: quality_words(recording.quality) for name, recording in info.recordings.items()}
    labels = [label for label, _, _ in QUALITY.values() if any(label in row for row in words.values())]
    rows = [
        [name, recording.object, str(recording.pairs), str(recording.refused)]
        + [words[name].get(label, "") for label in labels]
        for name, recording in sorted(info.recordings.items())
    ]
    return _markdown(["recording", "object", "pairs", "refused", *labels], rows)


def _markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
