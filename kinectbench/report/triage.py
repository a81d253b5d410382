"""Write the page of a triage, one file: pictures of each recording, its decision and the reasons."""

from dataclasses import dataclass
from pathlib import Path

from kinectbench.core import StorageError, images, replaced_file
from kinectbench.core.artefacts.object import QualityFile, with_interval
from kinectbench.core.artefacts.triage import TriageFile, TriageRow
from kinectbench.core.artefacts.views import ViewsFile
from kinectbench.core.pages import render_page
from kinectbench.core.types import Progress, no_progress
from kinectbench.report.page_pictures import FRAME_PX, frame_pictures
from kinectbench.stages.ingest.sequence_folder import read_sequence

TONES = {"accept": "good", "look": "warn", "reject": "bad"}
# Views of a recording, side by side. With more, the page of a thousand recordings would be too large to open.
VIEWS = 2
KNOWN_IOU = "IoU on known voxels"


@dataclass(frozen=True)
class Card:
    """The page's contents about one recording.

    Attributes:
        row: its row of the triage.
        tone: the CSS class that colours the decision: "good", "warn" or "bad".
        figures: estimated IoUs and underside in one line.
        incomplete: its large unseen parts, one line each, without those that `row.reasons` already states.
        pictures: pictures of views as `data:` URLs.
    """

    row: TriageRow
    tone: str
    figures: str
    incomplete: tuple[str, ...]
    pictures: tuple[str, ...]


def write_triage_page(
    name: str, triage: TriageFile, build: Path, out: Path, progress: Progress = no_progress
) -> None:
    """Write the page of a triage.

    Args:
        name: the benchmark's name.
        triage: the triage, in the order of the page.
        build: the folder with a subfolder for each recording.
        out: the page's file.
        progress: called with (recordings drawn, recordings in all).

    Raises:
        StorageError: the page cannot be written, or quality.json of a built recording is damaged.
    """
    cards = []
    for number, row in enumerate(triage.rows, start=1):
        cards.append(_card(row, build / row.recording))
        progress(number, len(triage.rows))
    shown = {
        "name": name,
        "cards": cards,
        "counts": triage.counts,
        "same_object": triage.same_object,
        "tones": TONES,
    }
    with replaced_file(out) as temporary:
        temporary.write_text(render_page("report/triage.html", shown), encoding="utf-8")


def _card(row: TriageRow, folder: Path) -> Card:
    try:
        pictures = tuple(_pictures(folder))
    except StorageError:  # a failed build may have damaged files
        pictures = ()
    quality = QualityFile.read_if_there(folder / "object") if row.built else None
    # Leave out lines that a violated limit repeats.
    incomplete = [line for line in row.incomplete if not any(each.startswith(line) for each in row.reasons)]
    return Card(row, TONES[row.decision], _figures(row, quality), tuple(incomplete), pictures)


def _figures(row: TriageRow, quality: QualityFile | None) -> str:
    """Return one line: the estimated IoUs, the underside, and who stated it.

    The estimated IoU on known voxels is left out if the row's reasons state it.
    """
    high = quality.estimated_iou_high if quality else None
    words = with_interval(row.estimated_iou, row.estimated_iou_low, high, 2)
    parts = [f"estimated IoU {words}"] if words else []
    known = row.estimated_known_iou
    if known is not None and not any(KNOWN_IOU in line and f"{known:.2f}" in line for line in row.reasons):
        parts.append(f"{KNOWN_IOU} {known:.2f}")
    if row.underside is not None:
        by = f"as its {row.underside_by} says" if row.underside_by else "as nobody said more"
        parts.append(f"underside {row.underside}, {by}")
    if quality is not None and quality.rests_on_word:
        parts.append(quality.rests_on_word)
    return "; ".join(parts)


def _pictures(folder: Path) -> list[str]:
    """Return pictures (`data:` URLs) of views with the object's mask, or else of the middle frame.

    If there are neither views nor frames, the result is empty.
    """
    views = ViewsFile.read_if_there(folder / "views")
    if views is not None and views.views:
        return [frame.masked for frame in frame_pictures(folder / "views", views, VIEWS)]
    if not (folder / "sequence").is_dir():
        return []
    sequence = read_sequence(folder / "sequence")
    if not len(sequence):
        return []
    middle = len(sequence) // 2
    picture = sequence.color_rgb(middle)
    if picture is None:
        picture = images.depth_picture(sequence.frames.depth_native(middle))
    return [images.data_uri(images.shrunk(picture, FRAME_PX))]
