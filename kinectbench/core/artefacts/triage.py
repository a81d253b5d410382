"""triage.json: which recordings of a build are trustworthy, which need a review, and why."""

from collections import Counter
from typing import ClassVar, Literal

from pydantic import Field

from kinectbench.core.artefacts.stored import Stored, StoredPart, optional
from kinectbench.core.types import Split, Underside

Decision = Literal["accept", "look", "reject"]
DECISIONS: tuple[Decision, ...] = ("reject", "look", "accept")  # the gravest first


class TriageRow(StoredPart):
    """The decision on one recording."""

    recording: str = Field(description="its id")
    object: str = Field(description="the thing recorded")
    split: Split = Field(description="train, validation or test")
    decision: Decision = Field(
        description="accept: nothing speaks against it; look: it is published, and a person should look at "
        "it; reject: it is left out of a release"
    )
    reasons: tuple[str, ...] = Field(
        description="reasons, one line each; accept: those that a person overrode"
    )
    review: str | None = optional("a person's reason for the decision; null: the rules decided")
    estimated_iou: float | None = optional("as in quality.json")
    estimated_iou_low: float | None = optional("as in quality.json")
    estimated_known_iou: float | None = optional("as in quality.json")
    underside: Underside | None = optional("as benchmark.yaml states it")
    underside_by: Literal["recording", "category"] | None = optional(
        "whose line in benchmark.yaml states it; null: nobody's"
    )
    incomplete: tuple[str, ...] = Field(
        (), description="large unseen parts, one line each: scores leave them out"
    )
    built: bool = Field(description="whether built up to the pairs")


class SameObject(StoredPart):
    """Two recordings whose built objects have the same shape, but different object names."""

    recordings: tuple[str, str] = Field(description="their ids")
    agreement: float = Field(
        description="share of one's measured surface near the other's; the smaller of the two"
    )
    splits: tuple[Split, Split] = Field(description="splits of the two")
    write: str = Field(description="what to write in benchmark.yaml at the second, if they are one")

    @property
    def line(self) -> str:
        """A sentence to print: which recordings agree, and what to write in benchmark.yaml."""
        a, b = self.recordings
        apart = self.splits[0] != self.splits[1]
        where = f", and stand in the splits {self.splits[0]} and {self.splits[1]}" if apart else ""
        return (
            f"{a} and {b} have one shape ({self.agreement:.0%} of their surfaces agree){where}: "
            f"if they are one object, write `{self.write}` to {b} in benchmark.yaml"
        )


class TriageFile(Stored):
    """triage/triage.json: the decisions of rules and people on each recording of a benchmark."""

    FILE: ClassVar[str] = "triage.json"
    ADVICE: ClassVar[str] = "`kinectbench triage` makes it again"

    format_version: Literal[1] = Field(1, description="version of this file's format")
    rows: tuple[TriageRow, ...] = Field(description="recordings, most severe first")
    same_object: tuple[SameObject, ...] = Field((), description="recordings that may show one object")

    @property
    def counts(self) -> dict[Decision, int]:
        """The number of recordings per decision, in the order of `DECISIONS`."""
        counter = Counter(row.decision for row in self.rows)
        return {decision: counter[decision] for decision in DECISIONS}
