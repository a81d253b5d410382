"""Make the list of recordings for a page of a large benchmark: one row for each, read from small files."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from kinectbench.core.artefacts.manifest import Failed
from kinectbench.core.artefacts.object import QualityFile
from kinectbench.core.artefacts.stored import Stored
from kinectbench.core.artefacts.trajectory import TrajectoryHealth
from kinectbench.core.artefacts.views import PairsFile, ViewsFile
from kinectbench.core.listing import PAGE_ROWS, SHOWN, Listing
from kinectbench.core.medians import known_median
from kinectbench.engine.stages import Job, current_stages
from kinectbench.report.figures import per_cent

File = TypeVar("File", bound=Stored)
COLUMNS = (
    "recording", "object", "category", "split", "verdict", "trajectory", "pairs", "passed over",
    "containment", "residual",
)  # fmt: skip
FILTERS = (2, 3, 4, 5)
PAIRS = COLUMNS.index("pairs")
FAILED, NOT_BUILT = "failed", "not built"
OBJECT_COLUMNS = ("object", "category", "pairs", "unknown", "pairs left out")


def recording_row(job: Job, folder: Path) -> tuple[str, ...]:
    """Return a recording's row of the list, from `build/<recording>/`: a text for each of `COLUMNS`.

    Raises:
        StorageError: a file is damaged.
    """
    current = current_stages(folder, job)

    def read(stage: str, model: type[File]) -> File | None:
        return model.read_if_there(current[stage]) if stage in current else None

    health, quality = read("track", TrajectoryHealth), read("segment", QualityFile)
    views, pairs = read("sample-views", ViewsFile), read("pairs", PairsFile)
    verdict = (quality.verdict if quality else None) or ""
    if pairs is None:
        verdict = FAILED if Failed.read_if_there(folder) else NOT_BUILT
    rows = pairs.pairs if pairs else ()
    refused = len(views.refused if views else ()) + len(pairs.refused if pairs else ())
    return (
        job.recording.id,
        job.recording.object_name,
        job.recording.category,
        job.recording.split,
        verdict,
        (health.grade if health else None) or "",
        str(len(rows)),
        str(refused),
        per_cent(known_median(row.containment for row in rows)),
        millimetres(known_median(row.residual_m for row in rows)),
    )


def listing(rows: Sequence[Sequence[str]], shown: Sequence[str]) -> Listing:
    """Return the table of all recordings; ids in `shown` link to the section that shows them in detail."""
    links = {name: f"#r{number}" for number, name in enumerate(shown, start=1)}
    return Listing(COLUMNS, FILTERS, rows, links, "`kinectbench build --status` lists all of them")


def object_listing(objects: Sequence[Sequence[object]]) -> Listing | None:
    """Return the rows of `truth_of_objects` as a searchable list; None if a plain table is enough."""
    if len(objects) <= PAGE_ROWS:
        return None
    rows = [[str(cell) for cell in row] for row in objects]
    return Listing(OBJECT_COLUMNS, (1,), rows, {}, "scores.json has all of them")


def shortened(settings: Mapping[str, Any]) -> tuple[dict[str, object], int]:
    """Return the settings with only the first recordings if there are many, and the number left out."""
    recordings = settings.get("recordings") or []
    left_out = max(0, len(recordings) - SHOWN)
    return dict(settings) | ({"recordings": recordings[:SHOWN]} if left_out else {}), left_out


def millimetres(value_m: float | None) -> str:
    """Return a length in metres as text in millimetres, or "–" for None."""
    return "–" if value_m is None else f"{1000 * value_m:.1f} mm"
