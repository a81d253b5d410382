"""The doctor's report: findings of checks, facts about the recording, and the verdict."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

Severity = Literal["stops", "warning", "note"]
SEVERITIES: tuple[Severity, ...] = ("stops", "warning", "note")
# Suffix of a fact's name → the unit behind its value.
UNITS = {"_hz": " Hz", "_px": " px", "_mm": " mm", "_deg": "°", "_m": " m", "_s": " s"}
# Meaning of the value of a fact without a unit.
NOTES = {"pose_disagreement": " (0: all depth fits the given poses, 1: none does)"}
SIZE = ("width", "height")
# What edges show about the registration of colour, and the text that is printed instead of "yes".
Registration = Literal["seen", "unclear", "contradicted"]
REGISTERED: dict[object, str] = {
    "unclear": "assumed: nothing shows it",
    "contradicted": "assumed, but its edges lie elsewhere",
}


@dataclass(frozen=True)
class Finding:
    """One result of a check.

    Attributes:
        name: the kind of finding, for programs.
        severity: "stops": a build would fail or be wrong; "warning": it may fail or be wrong; "note":
            information.
        what: the finding in words, one line.
        where: the file, topic or frames that it is about.
        advice: what to do; "" where there is nothing to do.
    """

    name: str
    severity: Severity
    what: str
    where: str
    advice: str = ""


@dataclass(frozen=True)
class Diagnosis:
    """The result of all checks of a recording.

    Attributes:
        facts: {name: value}: measured properties of the recording, plain JSON values.
        findings: the findings, most severe first.
    """

    facts: dict[str, object]
    findings: tuple[Finding, ...]

    @property
    def stops(self) -> bool:
        """Whether any finding has the severity "stops": a build would fail or be wrong."""
        return any(finding.severity == "stops" for finding in self.findings)

    @property
    def verdict(self) -> str:
        """The verdict in one line, with the names of the gravest findings, each once."""
        stops, warnings = (
            list(dict.fromkeys(f.name for f in self.findings if f.severity == severity))
            for severity in SEVERITIES[:2]
        )
        if stops:
            return f"not usable as it is: {', '.join(stops)}"
        if warnings:
            return f"usable with care: {', '.join(warnings)}"
        return "usable"


def camera_line(key: str, value: float) -> str:
    """Return a finding's advice: a camera setting to put into benchmark.yaml."""
    return f"put `camera: {{{key}: {value:.3f}}}` into benchmark.yaml"


def gravest_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings without duplicates, most severe first; equally severe ones keep their order."""
    return tuple(sorted(dict.fromkeys(findings), key=lambda finding: SEVERITIES.index(finding.severity)))


def fact_lines(facts: Mapping[str, object]) -> list[tuple[str, str]]:
    """Return the facts that are not None as printable pairs (name, value with unit), in their order.

    `color_registration` has no line of its own: it changes the text of `color_registered`.

    Args:
        facts: facts of a `Diagnosis`: {name: plain JSON value}. Names of values with a unit end in the unit,
            such as duration_s.
    """
    shown = {name: value for name, value in facts.items() if value is not None}
    registration = REGISTERED.get(shown.pop("color_registration", None))
    if registration and shown.get("color_registered") and shown.get("color_size_px"):
        shown["color_registered"] = registration
    return [_in_words(name, value) for name, value in shown.items()]


def _in_words(name: str, value: object) -> tuple[str, str]:
    suffix = next((suffix for suffix in UNITS if name.endswith(suffix)), "")
    label = name.removesuffix(suffix).replace("_", " ").replace("color", "colour")
    if name.endswith("_share") and isinstance(value, float):
        return label, f"{100 * value:.1f} %"
    return label, _value(name, value, UNITS.get(suffix, "")) + NOTES.get(name, "")


def _value(name: str, value: object, unit: str) -> str:
    """Format a fact's value as text with its unit: a camera, quantiles, a size, a bool or a number."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        size = " x ".join(f"{value[key]}" for key in SIZE if key in value)
        known = [(key, number) for key, number in value.items() if key not in SIZE and number is not None]
        parts = [f"{key} {_number(number)}{unit}" for key, number in known]
        return ", ".join([f"{size} px", *parts] if size else parts)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return (" x " if "size" in name else ", ").join(map(_number, value)) + unit
    return _number(value) + unit


def _number(value: object) -> str:
    return f"{round(value, 3):g}" if isinstance(value, float) and abs(value) < 1e5 else str(value)
