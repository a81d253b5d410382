"""Format a stage's statistics for the page: its verdict, and each other key of its file with its unit."""

from collections.abc import Mapping
from dataclasses import dataclass

from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.core.artefacts.stored import StoredPart
from kinectbench.core.artefacts.trajectory import Grade, TrajectoryHealth

UNITS = {"_mm": "mm", "_m": "m", "_s": "s", "_ns": "ns", "_px": "px", "_rad": "rad", "_deg": "deg"}
MAX_LISTED = 6
HIDDEN = ("verdict", "warnings", "format_version")
# Keys that are shown as one text, apart from the object's other statistics.
OF_THE_ESTIMATE = ("estimated_iou", "estimated_iou_low", "estimated_iou_high", "estimated_iou_reasons")
# Names of shares whose keys do not say what they are a share of.
NAMES: Mapping[str, str] = {
    "unknown_share": "never seen, share of the solid",
    "unknown_air_share": "never seen and taken for air, by the solid's volume",
    "doubtful_share": "perhaps a hollow, share of the solid",
    "underside": "underside, as stated by a person",
    "underside_share": "seen from below only, share of the solid: the word about the underside decides it",
}
# Colour of each grade of health.json; a "good" with warnings becomes "warn".
TONES: Mapping[Grade, str] = {"good": "good", "fair": "good", "not good": "bad"}


@dataclass(frozen=True)
class StageFigures:
    """The statistics of one stage, formatted for the page.

    Attributes:
        verdict: the verdict that the stage gives, or "".
        tone: the class that colours the verdict: "good", "warn", "bad" or "plain".
        grade: the grade of a trajectory, such as "fair"; "" for an object.
        warnings: the stage's warnings.
        rows: (name, value) of the other statistics, as texts; lists of objects are left out.
        estimate: the estimated IoU with its interval, or "".
        reasons: what widens the interval, one line each.
        advice: what to record again, one line for each unobserved opening.
        word: a sentence on what the user stated about the object, or "".
    """

    verdict: str
    tone: str
    grade: str
    warnings: tuple[str, ...]
    rows: tuple[tuple[str, str], ...]
    estimate: str = ""
    reasons: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    word: str = ""


def health_figures(health: TrajectoryHealth, sequence: CameraFile | None = None) -> StageFigures:
    """Return a trajectory's statistics for the page.

    The colour of the verdict follows the grade: "bad" if the grade is "not good", else "warn" if there are
    warnings, else "good". With `sequence`, the recording's camera file, the first row gives the number of
    damaged frames.
    """
    tone = TONES[health.grade]
    if health.warnings and tone != "bad":
        tone = "warn"
    unread = () if sequence is None else (("damaged frames", str(sequence.damaged)),)
    rows = (*unread, *_shown(health, HIDDEN))
    return StageFigures(health.verdict, tone, health.grade, health.warnings, rows)


def quality_figures(quality: QualityFile) -> StageFigures:
    """Return an object's statistics for the page.

    The colour of the verdict is "warn" if there are warnings, "good" if there are none, and "plain" if the
    file has no list of warnings.
    """
    tone = "plain" if "warnings" not in quality.model_fields_set else "warn" if quality.warnings else "good"
    return StageFigures(
        quality.verdict or "",
        tone,
        "",
        tuple(line for line in quality.warnings if line not in quality.advice),
        _shown(quality, (*HIDDEN, *OF_THE_ESTIMATE, "frontiers")),
        quality.estimated_iou_words() or "",
        quality.estimated_iou_reasons,
        quality.advice,
        quality.rests_on_word or "",
    )


def _shown(part: StoredPart, hidden: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    values = part.json_value()
    return tuple(_rows({key: value for key, value in values.items() if key not in hidden}, ""))


def text_of(value: object) -> str:
    """Return a JSON value as a short text, such as "yes", "0.1234" or "12 entries"."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        plain = not any(isinstance(item, list | tuple | Mapping) for item in value)
        if plain and len(value) <= MAX_LISTED:
            return ", ".join(text_of(item) for item in value) or "none"
        return f"{len(value)} entries"
    return str(value)


def per_cent(value: float | None) -> str:
    """Return a share as text in per cent, or "–" for None."""
    return "–" if value is None else f"{100 * value:.1f} %"


def _rows(values: Mapping[str, object], prefix: str) -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            rows += _rows(value, f"{prefix}{key} · ")
        elif key == "rejected" and isinstance(value, list):
            rows.append((f"{prefix}rejected", str(len(value))))
        elif not (isinstance(value, list) and any(isinstance(item, Mapping) for item in value)):
            # Lists of objects, such as one for each frame, are for programs.
            rows.append((prefix + _name(str(key)), text_of(value)))
    return rows


def _name(key: str) -> str:
    """Return a readable key: `median_residual_m` becomes `median residual (m)`."""
    if key in NAMES:
        return NAMES[key]
    for suffix, unit in UNITS.items():
        if key.endswith(suffix) and len(key) > len(suffix):
            return f"{key[: -len(suffix)].replace('_', ' ')} ({unit})"
    return key.replace("_", " ")
