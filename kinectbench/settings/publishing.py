"""Settings of a release: the data that it contains, and its description."""

import re
from datetime import date
from typing import Literal

from pydantic import Field, ValidationInfo, field_validator

from kinectbench.core.artefacts.trajectory import Grade
from kinectbench.settings.base import Line, Settings, Text

CITED = {
    "version": (r"[A-Za-z0-9][A-Za-z0-9.+-]{0,39}", "a version such as 1.0.0"),
    "doi": (r"10\.\S+/\S+", "a DOI such as 10.5281/zenodo.1234, without https://doi.org/"),
    "url": (r"https?://\S+", "an address that begins with https://"),
    "date_released": (r"[0-9]{4}-[0-9]{2}-[0-9]{2}", "a date as year-month-day"),
}


class ReviewSettings(Settings):
    """A person's decision after a review of a recording's build."""

    decision: Literal["accept", "reject"] = Field(
        description="accept: publish it, whatever `triage` says against it; reject: leave it out"
    )
    reason: Line = Field(description="reason for the decision, which the release states")


class CitationSettings(Settings):
    """How to cite the benchmark."""

    title: Line | None = Field(None, description="title to cite; default: the benchmark's name")
    authors: list[Line] | None = Field(
        None, min_length=1, description="names of authors: 'Family, Given', or a group's name"
    )
    version: str | None = Field(None, description="version of the data, such as 1.0.0")
    doi: str | None = Field(None, description="DOI of the data, such as 10.5281/zenodo.1234")
    url: str | None = Field(None, description="address where the data can be had")
    date_released: str | None = Field(None, description="date of the release, year-month-day")

    @field_validator("version", "doi", "url", "date_released")
    @classmethod
    def _formed(cls, value: str | None, info: ValidationInfo) -> str | None:
        pattern, wanted = CITED[str(info.field_name)]
        if value is not None and not re.fullmatch(pattern, value):
            raise ValueError(f"wanted {wanted}")
        if value is not None and info.field_name == "date_released":
            date.fromisoformat(value)  # ValueError if there is no such day
        return value


class DatasheetSettings(Settings):
    """Facts about the data that only a person knows; each a sentence or more."""

    motivation: Text | None = Field(None, description="why was it made, and for which task?")
    creators: Text | None = Field(None, description="who made it, for whom, and who paid for it?")
    collection: Text | None = Field(None, description="who recorded what, where and when, with which camera?")
    consent: Text | None = Field(None, description="can people be seen or identified, and did they agree?")
    uses_to_avoid: Text | None = Field(None, description="what should it not be used for?")
    maintenance: Text | None = Field(None, description="who keeps it, and where are faults reported?")


class ChangeSettings(Settings):
    """What changed in one version of the data."""

    version: Line = Field(description="version of the data, such as 1.0.0")
    changes: list[Line] = Field(min_length=1, description="what changed, a line each")


class GateSettings(Settings):
    """Limits that a recording must keep to be published, unless its `review` accepts it.

    Warnings, which only point to problems, have stricter limits. Data beyond the limits here would mislead.
    """

    # The IoU of the paper's networks is 0.5 to 0.7: a ground truth that is less like the object than
    # predictions are cannot rank them.
    min_estimated_iou: float = Field(
        0.7,
        ge=0,
        le=1,
        description="least estimated IoU on known voxels (of the whole solid in files without it); with a "
        "trajectory that is not good, of its lower end",
    )
    min_grade: Grade = Field("not good", description="least grade of the trajectory: not good, fair or good")
    # Above one half most of the truth is a guess. Good recordings have 0.08 to 0.3.
    max_unknown_share: float = Field(
        0.5,
        ge=0,
        le=1,
        description="largest share of the solid that is unknown: never seen, and some camera could see it",
    )
    max_doubts: int = Field(
        0,
        ge=0,
        le=100,
        description="most warnings about what was measured: several things, cut off, in pieces, without its "
        "support, another floor, another size, unlikely intrinsics",
    )


class PublishSettings(Settings):
    """The release."""

    gate: GateSettings = Field(
        GateSettings(), description="limits that a recording must keep to be published"
    )
    color: bool = Field(
        False, description="whether to publish colour images (faces and people cannot be ruled out)"
    )
    citation: CitationSettings = Field(CitationSettings(), description="how to cite the benchmark")
    datasheet: DatasheetSettings = Field(DatasheetSettings(), description="facts that only a person knows")
    changelog: list[ChangeSettings] | None = Field(
        None, description="versions of the data, newest first, each {version: …, changes: […]}"
    )
