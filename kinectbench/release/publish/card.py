"""Texts of a release: the card README.md, and READING.md on how to read it without this package."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import get_args

import numpy as np
import yaml

from kinectbench.core.artefacts.benchmark import UNSPECIFIED, RecordingInfo, ReleaseInfo
from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.targets import SPLITS, Target
from kinectbench.core.medians import known_median
from kinectbench.core.types import CLOSED_MEANS, Float64, Underside
from kinectbench.core.voxels.pair_file import TRUTH_KEYS
from kinectbench.release.contents import LICENSE, PREVIEWS, SPLIT_TARGETS
from kinectbench.release.publish.attribution import HUGGING_FACE, markdown_line
from kinectbench.release.publish.held_back import isolated_line

# Key of quality.json -> label, format, factor.
QUALITY = {
    "estimated_iou": ("estimated IoU", "{:.3f}", 1.0),
    "estimated_known_iou": ("estimated IoU on known voxels", "{:.3f}", 1.0),
    "repeatability_iou": ("repeatability IoU", "{:.3f}", 1.0),
    "surface_sigma_m": ("σ of the surface", "{:.1f} mm", 1000.0),
    "unknown_share": ("never seen, of the solid", "{:.1f} %", 100.0),
    "unknown_air_share": ("never seen, taken for air, by its volume", "{:.1f} %", 100.0),
    "doubtful_share": ("perhaps a hollow, of the solid", "{:.1f} %", 100.0),
    "underside_share": ("seen from below only, of the solid", "{:.1f} %", 100.0),
    "volume_m3": ("volume", "{:.1f} l", 1000.0),
    "good_frames": ("frames fused", "{:.0f}", 1.0),
}
# Key of a recording's reference -> label.
REFERENCE = {
    "f_score_5mm": "F at 5 mm to its reference",
    "f_score_10mm": "F at 10 mm to its reference",
    "iou": "IoU with its reference",
}
SIZE, VISIBLE = "longer side x shorter side x height, m", "seen by a view, of the surface"
ESTIMATES = ("estimated_iou", "estimated_iou_low", "estimated_iou_high")
PASSED_OVER = (
    "Passed over: frames that did not do as a view, for which others were tried, and views without a pair."
)
# Label of a statement by a person.
UNDERSIDE = "underside, as stated"
# Label of the truth's kind, where the truth was not fused.
KIND = "truth"
SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"), (10**12, "n>1M"))
TRUTH_LINES = """\
full = np.unpackbits(pair["full"], axis=-1).astype(bool)  # (256, 256, 256), the truth
known = np.unpackbits(pair["known"], axis=-1).astype(bool)  # the truth is trusted there"""
INPUT_LINES = """\
partial_256 = np.unpackbits(pair["partial_256"], axis=-1).astype(bool)  # (256, 256, 256), the same, finer"""
TEMPLATE = Path(__file__).with_name("card.md")
READING_TEMPLATE = Path(__file__).with_name("reading.md")
TRUTH = 'surface = points_world("shell")  # the surface of the true shape, in the same world'
NO_TRUTH = "# No pair of this part has its truth."


def quality_words(quality: QualityFile) -> dict[str, str]:
    """Return {label: value with unit} of the known quality values, in a fixed order.

    The stated underside and the kind of truth come last.

    Args:
        quality: a recording's quality; it has no values if the truth is held back or the pairs are imported.
    """
    words = {
        label: form.format(factor * value)
        for key, (label, form, factor) in QUALITY.items()
        if (value := getattr(quality, key)) is not None
    }
    estimate = quality.estimated_iou_words(3)
    # The estimate with its interval replaces the estimate, in the same place.
    words |= {QUALITY["estimated_iou"][0]: estimate} if estimate else {}
    words |= {UNDERSIDE: quality.underside} if quality.underside else {}
    return words | ({KIND: quality.truth.kind} if quality.truth else {})


def _reference_words(info: RecordingInfo) -> dict[str, str]:
    """Return {label: value} on how well a reference mesh agrees; empty if it does not fit or is the truth."""
    if info.reference is None or info.reference.refused is not None or info.reference.itself:
        return {}
    figures = {label: getattr(info.reference, key) for key, label in REFERENCE.items()}
    return {label: f"{value:.3f}" for label, value in figures.items() if value is not None}


def underside_line(recordings: Mapping[str, RecordingInfo]) -> str:
    """Return a line on how many recordings have an underside that the user stated as closed, or as open.

    Args:
        recordings: {id: entry in benchmark.json}. If none of them states its underside, the line is empty.
    """
    by_word = Counter(info.quality.underside for info in recordings.values() if info.quality.underside)
    if not by_word:
        return ""
    counts = ", ".join(f"{word} {by_word[word]}" for word in get_args(Underside))
    line = f"Underside, as stated of {by_word.total()} recording{'s' * (by_word.total() > 1)}: {counts}."
    if by_word["closed"]:
        line += (
            f" It is `closed` ({CLOSED_MEANS}) by the word of whoever recorded it, no measurement, and the "
            "ground truth rests on it: what could be seen from below only counts as known and solid."
        )
    return line


@dataclass(frozen=True)
class CardTexts:
    """The parts of a card's text that depend on the origin of the pairs.

    Attributes:
        source: the end of the card's first sentence, "A benchmark for ... shape completion from ...".
        beside: text on what the folders beside `pairs/` contain.
        pictured: whether previews/ has a picture of each pair.
    """

    source: str
    beside: str
    pictured: bool = False


RECORDED = CardTexts(
    "real RGB-D recordings",
    "Depth and\nmask of each view are in `views/`, the floor, the closed mesh and the labelled volume of "
    "each object in `objects/`. `datasheet.md` says what the benchmark is for and what is wrong with it,\n"
    "`lineage.json` where every pair comes from, `schemas/` what every file holds; `index.html` shows every "
    "object.",
    pictured=True,
)


def card(
    info: ReleaseInfo,
    targets: Sequence[Target],
    warnings: Sequence[str],
    license: str,
    texts: CardTexts = RECORDED,
) -> str:
    """Return README.md, the card, as Markdown with the YAML head that Hugging Face reads.

    `license` is that of all recordings; `texts` depend on the origin of the pairs.
    """
    example = next((t for t in targets if t.split not in info.inputs_only), targets[0])
    hidden = example.split in info.inputs_only
    body = Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        name=info.name,
        source=texts.source,
        beside=texts.beside,
        license=markdown_line(license),
        framing=info.framing,
        partial_rule=info.partial_rule,
        package_version=info.package_version,
        notice=_notice(info),
        counts="\n\n".join(filter(None, (counts_table(targets), _category_table(info, targets)))),
        example=example.file,
        truth=INPUT_LINES if hidden else TRUTH_LINES,
        shown="partial_256" if hidden else "full",
        flow=flow_section(info),
        quality=card_figures(info),
        origins=origins_table(info.recordings),
        warnings="\n".join(f"- {line}" for line in warnings) or "None.",
    )
    return f"---\n{_head(info, targets, license, texts.pictured)}---\n\n{body}"


def _head(info: ReleaseInfo, targets: Sequence[Target], license: str, pictured: bool) -> str:
    """Return the card's YAML head, as https://huggingface.co/docs/hub/datasets-cards defines it."""
    known = HUGGING_FACE.get(license)
    content: dict[str, object] = {"license": known or ("unknown" if license == UNSPECIFIED else "other")}
    if content["license"] == "other":
        content |= {"license_name": re.sub(r"[^a-z0-9.-]+", "-", license.lower()).strip("-")}
        content |= {"license_link": LICENSE}
    categories = sorted({target.category for target in targets})
    # An isolated recording has no pictures. A release without any picture shows the tables of the splits.
    shown = [t for t in targets if not info.isolates(t.recording)] if pictured else []
    path = f"{PREVIEWS}/{{}}/**" if shown else f"{SPLIT_TARGETS}/{{}}.csv"
    present = [split for split in SPLITS if any(t.split == split for t in shown or targets)]
    content |= {
        "pretty_name": info.name,
        "task_categories": ["image-to-3d"],
        "tags": ["3d", "shape-completion", "rgb-d", "voxels", "benchmark", *categories],
        "size_categories": [next(name for limit, name in SIZES if len(targets) < limit)],
        # Only one table: `datasets` reads all tables of a card like the first.
        "configs": [
            {
                "config_name": "targets",
                "default": True,
                "data_files": [{"split": s, "path": path.format(s)} for s in present],
            }
        ],
    }
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=10**9)


def _notice(info: ReleaseInfo) -> str:
    """Return the card's notice on forbidden distribution, held-back truth and open meshes; else ""."""
    lines = []
    if info.distribution is not None and not info.distribution.allowed:
        lines += ["**Not for distribution.**", *(f"- {reason}" for reason in info.distribution.reasons), ""]
    if info.held_back:
        lines += [
            f"**The truth of the split {', '.join(info.held_back)} is held back**: its pair files hold the "
            "input only. Send your predictions to whoever published the benchmark to have them scored.",
            *([isolated_line(info.isolated)] if info.isolated else []),
            "",
        ]
    if info.surface_truth:
        lines += [
            f"**The truth of the split {', '.join(info.surface_truth)} is open meshes**, `surfaces/`: they "
            "have no inside, so there is no `full`, and metrics of voxels stay empty.",
            "",
        ]
    return "\n".join(lines) + "\n" if lines else ""


def counts_table(targets: Sequence[Target]) -> str:
    """Return a Markdown table of categories: numbers of objects, and of pairs in each split."""
    pairs = Counter((target.category, target.split) for target in targets)
    objects = Counter(category for category, _ in {(target.category, target.object) for target in targets})
    rows = [
        [category, str(objects[category]), *(str(pairs[category, split]) for split in SPLITS)]
        for category in sorted(objects)
    ]
    return _markdown(["category", "objects", *(f"{split} pairs" for split in SPLITS)], rows)


def _category_table(info: ReleaseInfo, targets: Sequence[Target]) -> str:
    """Return a Markdown table of categories: object sizes, medians of visible share, unknown share and IoU.

    The text is empty if none of these values is known.
    """
    category_of = {target.recording: target.category for target in targets}
    rows = []
    for category in sorted(set(category_of.values())):
        found = [each for name, each in info.recordings.items() if category_of.get(name) == category]
        qualities = [each.quality for each in found]
        sizes_m = np.array([quality.box.size_m for quality in qualities if quality.box is not None])
        unknown, *estimates = (
            known_median(getattr(quality, key) for quality in qualities)
            for key in ("unknown_share", *ESTIMATES)
        )
        visible = known_median(each.visible_share for each in found)
        rows.append([category, _ranges(sizes_m), *_words((visible, unknown, *estimates))])
    if not any(any(row[1:]) for row in rows):
        return ""
    header = ["category", SIZE, VISIBLE, *(QUALITY[key][0] for key in ("unknown_share", "estimated_iou"))]
    note = "`categories/` has a page of each category with a picture of every object."
    return f"{_markdown(header, rows)}\n\nMedians over recordings, but for the sizes. {note}"


def category_words(info: RecordingInfo) -> dict[str, str]:
    """Return {label: text} of one recording's known values, with the labels of the table by category."""
    of = info.quality
    size = _ranges(np.array([of.box.size_m])) if of.box else ""
    rest = _words((info.visible_share, of.unknown_share, *(getattr(of, key) for key in ESTIMATES)))
    labels = (SIZE, VISIBLE, *(QUALITY[key][0] for key in ("unknown_share", "estimated_iou")))
    return {label: text for label, text in zip(labels, (size, *rest), strict=True) if text}


def _ranges(sizes_m: Float64) -> str:
    """Return the ranges of longer side, shorter side and height over boxes (n, 3), metres, as a text."""
    if not len(sizes_m):
        return ""
    sides_m = np.column_stack([sizes_m[:, :2].max(axis=1), sizes_m[:, :2].min(axis=1), sizes_m[:, 2]])
    ends = [{f"{value:.2f}": None for value in (side.min(), side.max())} for side in sides_m.T]
    return " x ".join(" to ".join(side) for side in ends)


def _words(figures: Sequence[float | None]) -> tuple[str, str, str]:
    """Return texts for visible share, unknown share, and estimated IoU with its interval; "" if not known.

    `figures` are the two shares, the estimated IoU, and the lower and upper end of its interval.
    """
    visible, unknown, estimate, low, high = figures
    shares = ["" if share is None else f"{share:.1%}" for share in (visible, unknown)]
    interval = "" if low is None or high is None else f" ({low:.2f} to {high:.2f})"
    return shares[0], shares[1], "" if estimate is None else f"{estimate:.2f}{interval}"


def card_figures(info: ReleaseInfo) -> str:
    """Return a Markdown table of recordings (pairs, refused views, quality), followed by `underside_line`."""
    words = {}
    for name, recording in info.recordings.items():
        words[name] = quality_words(recording.quality) | _reference_words(recording)
        if recording.visible_share is not None:
            words[name][VISIBLE] = f"{recording.visible_share:.1%}"
    every = [*(label for label, _, _ in QUALITY.values()), VISIBLE, *REFERENCE.values(), UNDERSIDE, KIND]
    labels = [label for label in every if any(label in row for row in words.values())]
    rows = [
        [name, recording.object, str(recording.pairs), str(recording.refused)]
        + [words[name].get(label, "") for label in labels]
        for name, recording in sorted(info.recordings.items())
    ]
    table = _markdown(["recording", "object", "pairs", "passed over", *labels], rows)
    return "\n\n".join(filter(None, (table, PASSED_OVER, underside_line(info.recordings))))


def flow_section(info: ReleaseInfo) -> str:
    """Return the card's section on how many recordings were left out at each step; "" if `flow` is None."""
    flow = info.flow
    if flow is None:
        return ""
    left, rows = flow.tried, [["tried", str(flow.tried), ""]]
    for step, count, why in (
        ("built", flow.failed + flow.not_built, f"{flow.failed} failed, {flow.not_built} not built"),
        ("not rejected by a person", flow.rejected, ""),
        ("within the limits of `publish.gate`, or let pass", flow.below_limits, ""),
        ("with a pair", flow.without_pair, ""),
        ("the one recording of its object (`--isolate`)", flow.of_one_object, ""),
    ):
        left -= count
        if count or step == "built":
            rows.append([step, str(left), f"{count}{f': {why}' if why and count else ''}"])
    rows.append(["**published**", str(flow.published), ""])
    reasons = [
        f"Of these, {flow.poor} do not keep the limits and were let pass. A person should look at "
        f"{flow.look}, and nobody has. The warnings say why, and why each of the others is left out."
    ]
    lines = [
        "## From recordings to this release",
        _markdown(["step", "recordings", "left out"], rows),
        *reasons,
    ]
    return "\n\n".join(lines) + "\n\n"


def origins_table(recordings: Mapping[str, RecordingInfo]) -> str:
    """Return a Markdown table of recordings, with a row for each combination of licence and source."""
    sharing: dict[tuple[str, str], list[str]] = {}
    for name, info in sorted(recordings.items()):
        sharing.setdefault((markdown_line(info.source), markdown_line(info.license)), []).append(name)
    rows = [[", ".join(names), license, source] for (source, license), names in sharing.items()]
    return _markdown(["recordings", "licence", "source"], rows)


def _markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table of these headings and rows of cells; the cells are not escaped."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def reading(targets: Sequence[Target], held_back: Sequence[str], why: str = "held back") -> str:
    """Return the text of READING.md; its example is the first pair with truth, or else the first pair.

    Args:
        targets: every pair.
        held_back: splits of which only inputs are published.
        why: why they lack truth; it ends the sentence "their truth is ...".
    """
    open_targets = [target for target in targets if target.split not in held_back]
    keys = ", ".join(f"`{key}`" for key in (*TRUTH_KEYS, "occupancy_rule"))
    hidden = f"\nPairs of the split {', '.join(held_back)} do not have {keys}: their truth is {why}.\n"
    return Template(READING_TEMPLATE.read_text(encoding="utf-8")).substitute(
        example=(open_targets or targets)[0].file,
        truth=TRUTH if open_targets else NO_TRUTH,
        held_back=hidden if held_back else "",
    )
