"""Shared content of croissant.json and datacite.json, such as the date of a release."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from kinectbench.core.artefacts.provenance import Lineage
from kinectbench.settings.publishing import CitationSettings, DatasheetSettings

SUBJECTS = ("3-D shape completion", "RGB-D", "voxel grids", "benchmark")
# From this day on a stamp is a calendar time; smaller stamps count from the start of a recording or a
# machine.
FIRST_DAY_NS = 946_684_800 * 10**9  # 1 January 2000
# The day in every archive of a release where no date is known.
NO_DAY = "1980-01-01"
NS_PER_S = 10**9


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
    if citation.date_released:
        return citation.date_released
    lineage = Lineage.read_if_there(folder)
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
