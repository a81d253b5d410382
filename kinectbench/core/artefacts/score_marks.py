"""Caveats of a score table: marks, and whether its predictions were scored again with the same result."""

from typing import Annotated, Final, Literal

from pydantic import Field

from kinectbench.core.artefacts.stored import StoredPart

Sha256 = Annotated[str, Field(json_schema_extra={"pattern": "^[0-9a-f]{64}$"})]

BASELINE: Final = "baseline"
OLDER_VERSION: Final = "older-version"
MISSING_AS_EMPTY: Final = "missing-as-empty"
THRESHOLDS_FIXED: Final = "thresholds-fixed"
THRESHOLDS_POOLED: Final = "thresholds-pooled"
THRESHOLDS_OWN: Final = "thresholds-own"
THRESHOLDS_UNCHECKED: Final = "thresholds-unchecked"
VALIDATION_PARTIAL: Final = "validation-partial"
CLOSED: Final = "closed"
Kind = Literal[
    "baseline",
    "older-version",
    "missing-as-empty",
    "thresholds-fixed",
    "thresholds-pooled",
    "thresholds-own",
    "thresholds-unchecked",
    "validation-partial",
    "closed",
]
# From this version of `score` on a table accounts for its thresholds and for what is missing.
ACCOUNTED = 4
REPORTED = "reported"


class Mark(StoredPart):
    """A reason why a method's scores differ from those of a complete submission."""

    kind: Kind = Field(description="kind of reason")
    words: str = Field(description="the reason in a few words, with counts")


class ValidationUse(StoredPart):
    """How many validation pairs were used to choose the thresholds."""

    pairs: int = Field(description="pairs of the validation split", json_schema_extra={"minimum": 0})
    predicted: int = Field(description="predicted pairs among them", json_schema_extra={"minimum": 0})


class Verified(StoredPart):
    """`score --recheck` scored the predictions again and found the same rows."""

    date: str = Field(
        description="day, in UTC", json_schema_extra={"pattern": "^[0-9]{4}-[0-9]{2}-[0-9]{2}$"}
    )
    package_version: str = Field(description="version of the kinectbench that rechecked")
    table_sha256: Sha256 = Field(description="SHA-256 of all that was found equal")
    predictions_sha256: Sha256 = Field(
        description="SHA-256 of the names and hashes of the predictions' files"
    )

    @property
    def words(self) -> str:
        """Date and version in words, such as `verified 2026-11-25, kinectbench 0.1.0`."""
        return f"verified {self.date}, kinectbench {self.package_version}"
