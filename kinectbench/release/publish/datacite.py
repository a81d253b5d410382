"""Make datacite.json, and the content that croissant.json shares with it, such as the release's date.

datacite.json is metadata in DataCite's schema 4, for registries of DOIs: it can be sent as `attributes` to
`POST https://api.datacite.org/dois`; Zenodo and others export the same.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from kinectbench.core.artefacts.benchmark import UNSPECIFIED
from kinectbench.core.artefacts.provenance import Lineage
from kinectbench.release.publish.attribution import HUGGING_FACE, authors, license_url
from kinectbench.settings.publishing import CitationSettings, DatasheetSettings

SUBJECTS = ("3-D shape completion", "RGB-D", "voxel grids", "benchmark")
# Earlier timestamps are no calendar times: they count from the start of a recording or a machine.
FIRST_DAY_NS = 946_684_800 * 10**9  # 1 January 2000
# Stands for an unknown date.
NO_DAY = "1980-01-01"
NS_PER_S = 10**9
SCHEMA = "http://datacite.org/schema/kernel-4"
FORMATS = ("application/x-npz", "image/png", "application/json", "model/gltf-binary")


@dataclass(frozen=True)
class About:
    """The description of a release.

    Attributes:
        name: the benchmark's name.
        license: the licence of all recordings.
        description: a sentence on what the release is.
        citation: authors, title, version and address for citing the release.
        date: the day of publication, year-month-day.
        answers: the publisher's answers to the questions of the datasheet.
        warnings: known faults of the release, one line each.
        color: whether colour images are published.
        recorded: whether the release was made from recordings instead of models.
    """

    name: str
    license: str
    description: str
    citation: CitationSettings
    date: str
    answers: DatasheetSettings = field(default_factory=DatasheetSettings)
    warnings: Sequence[str] = ()
    color: bool = False
    recorded: bool = True


def day_of(citation: CitationSettings, folder: Path) -> str:
    """Return the date of a release, year-month-day; it does not depend on the clock, so it is reproducible.

    The date is `date_released` if stated, else the day (UTC) of the latest view in lineage.json. It is
    `NO_DAY` if lineage.json has no view, or the timestamp is not a calendar time.

    Args:
        citation: the citation, which may state `date_released`.
        folder: the release's folder; lineage.json may be missing.
    """
    return day_by(citation, Lineage.read_if_there(folder))


def day_by(citation: CitationSettings, lineage: Lineage | None) -> str:
    """Return the date of a release as `day_of` does, from the content of its lineage.json."""
    if citation.date_released:
        return citation.date_released
    views = [row.views or () for row in lineage.recordings.values()] if lineage else []
    last_ns = max((view.stamp_ns for some in views for view in some), default=0)
    if last_ns < FIRST_DAY_NS:
        return NO_DAY
    try:
        return datetime.fromtimestamp(last_ns // NS_PER_S, UTC).date().isoformat()
    except (OverflowError, ValueError, OSError):  # a year beyond the calendar
        return NO_DAY


def responsible_use(about: About) -> Mapping[str, str | list[str]]:
    """Return the fields of Croissant's RAI (responsible AI) vocabulary, {name without `rai:`: text}."""
    answers = about.answers
    people = [answers.consent] if answers.consent else []
    if about.recorded:
        shown = "published" if about.color else "not published"
        people.append(f"Colour images are {shown}; privacy.json says what was looked for and removed.")
    fields: dict[str, str | list[str] | None] = {
        "dataCollection": answers.collection,
        "dataCollectionType": ["Direct measurement" if about.recorded else "Software collection"],
        "dataCollectionMissingData": (
            "Depth is 0 where the sensor measured nothing; `known` is not set where nobody knows the truth."
        ),
        "dataPreprocessingProtocol": [
            "Every setting is in benchmark.json, every stage and file of each recording in lineage.json."
            if about.recorded
            else "Every setting is in benchmark.json."
        ],
        "dataUseCases": ["Training and testing of single-view shape completion."],
        "dataLimitations": [
            "Scores belong to one framing, one partial rule and one benchmark_sha256.",
            *([answers.uses_to_avoid] if answers.uses_to_avoid else []),
            *about.warnings,
        ],
        "dataBiases": [
            "Objects, rooms and sensors are those that their makers had at hand; the card counts them."
        ],
        "personalSensitiveInformation": people or None,
        "dataReleaseMaintenancePlan": answers.maintenance,
    }
    return {key: value for key, value in fields.items() if value}


def datacite(about: About) -> dict[str, object]:
    """Return the content of datacite.json.

    Source: DataCite Metadata Schema 4.5, https://datacite-metadata-schema.readthedocs.io/en/4.5/
    """
    citation = about.citation
    content: dict[str, object] = {
        "schemaVersion": SCHEMA,
        "creators": [_creator(author) for author in authors(citation, about.name)],
        "titles": [{"title": citation.title or about.name}],
        "publisher": {"name": f"The makers of {about.name}"},
        "publicationYear": about.date[:4],
        "types": {"resourceTypeGeneral": "Dataset", "resourceType": "benchmark"},
        "subjects": [{"subject": subject} for subject in SUBJECTS],
        "dates": [{"date": about.date, "dateType": "Issued"}],
        "formats": list(FORMATS),
        "descriptions": [{"description": about.description, "descriptionType": "Abstract"}],
    }
    for key in ("doi", "version", "url"):
        if value := getattr(citation, key):
            content[key] = value
    if about.license != UNSPECIFIED:
        content["rightsList"] = [_rights(about.license)]
    return content


def _rights(license: str) -> dict[str, str]:
    rights = {"rights": license}
    if license in HUGGING_FACE:
        rights |= {"rightsIdentifier": license, "rightsIdentifierScheme": "SPDX"}
        rights |= {"schemeUri": "https://spdx.org/licenses/", "rightsUri": str(license_url(license))}
    return rights


def _creator(author: str) -> dict[str, str]:
    """Return an author's DataCite entry: `Family, Given` is a person, any other name is a group."""
    family, comma, given = author.partition(", ")
    if not comma:
        return {"name": author, "nameType": "Organizational"}
    return {"name": author, "nameType": "Personal", "familyName": family, "givenName": given}
