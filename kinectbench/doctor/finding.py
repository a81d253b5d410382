"""What the doctor says: findings, facts, and the verdict that follows from them."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Severity = Literal["stops", "warning", "note"]
SEVERITIES: tuple[Severity, ...] = ("stops", "warning", "note")


@dataclass(frozen=True)
class Finding:
    """One thing that was found.

    Attributes:
        name: of the kind of finding, a word for machines.
        severity: "stops": a build can only end badly; "warning": it may; "note": good to know.
        what: what is found, one line.
        where: the file, topic or frames.
        advice: what to do; "" where there is nothing to do.
    """

    name: str
    severity: Severity
    what: str
    where: str
    advice: str = ""


@dataclass(frozen=True)
class Diagnosis:
    """All that is said of a recording.

    Attributes:
        facts: figures by name, plain JSON values.
        findings: the gravest first.
    """

    facts: dict[str, object]
    findings: tuple[Finding, ...]

    @property
    def stops(self) -> bool:
        """Whether a build can only end badly."""
        return any(found.severity == "stops" for found in self.findings)

    @property
    def verdict(self) -> str:
        """One line."""
        stops, warnings = (
            [f.name for f in self.findings if f.severity == severity] for severity in SEVERITIES[:2]
        )
        if stops:
            return f"not usable as it is: {', '.join(stops)}"
        if warnings:
            return f"usable with care: {', '.join(warnings)}"
        return "usable"


def camera_line(key: str, value: float) -> str:
    """What to write into benchmark.yaml for a setting of the camera."""
    return f"put `camera: {{{key}: {value:.3f}}}` into benchmark.yaml"


def gravest_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The findings by severity, otherwise in their order, none twice."""
    return tuple(sorted(dict.fromkeys(findings), key=lambda found: SEVERITIES.index(found.severity)))
