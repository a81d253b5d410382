"""Write the page of a whole benchmark: one HTML file that opens from disk and contains every picture."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from kinectbench._version import __version__
from kinectbench.core import replaced_file, turntable
from kinectbench.core.artefacts.benchmark import ReleaseInfo
from kinectbench.core.artefacts.gallery import Gallery
from kinectbench.core.artefacts.score_figures import any_in_space
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.even_choice import spread
from kinectbench.core.listing import SHOWN, Listing
from kinectbench.core.pages import render_page
from kinectbench.core.types import NamedProgress, no_progress
from kinectbench.engine.stages import Job
from kinectbench.report import charts, recording_list, tables
from kinectbench.report.gallery import PairTruth, gallery_json
from kinectbench.report.recording import RecordingPart, collect
from kinectbench.report.space_table import space_table
from kinectbench.scoring.compare import method_names
from kinectbench.scoring.published import PARAMETERS_LINE, PUBLISHED_IN, PublishedTable, published_beside
from kinectbench.settings.models import BenchmarkSettings


@dataclass(frozen=True)
class Groups:
    """Groups of methods whose scores do not differ significantly; a letter stands for each group.

    Attributes:
        letters: {protocol: {index of a method's score table: its letters}}; incomplete methods have none.
        notes: notes on the letters, one line each.
        too_small: a sentence if the test set is too small to distinguish any two methods; else "".
    """

    letters: Mapping[str, Mapping[int, str]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    too_small: str = ""


@dataclass(frozen=True)
class ScoreExtras:
    """What a page shows with the score tables: groups of equal methods, and galleries of predictions.

    Attributes:
        groups: groups of methods that cannot be distinguished.
        galleries: a gallery (or None) for each table; empty: no galleries.
        truths: {pair: its truth, as the galleries show it}.
    """

    groups: Groups = field(default_factory=Groups)
    galleries: Sequence[Gallery | None] = ()
    truths: Mapping[str, PairTruth] = field(default_factory=dict)


NO_EXTRAS = ScoreExtras()


def write_report(
    settings: BenchmarkSettings,
    build: Path | None,
    scores: Sequence[ScoreTable],
    out: Path,
    progress: NamedProgress = no_progress,
    extras: ScoreExtras = NO_EXTRAS,
    released: ReleaseInfo | None = None,
) -> Path:
    """Write the page of a benchmark to `out`, and return `out`; the same input gives the same bytes.

    Args:
        settings: the benchmark's settings.
        build: the folder with a subfolder for each recording; the page states which stages are not built, or
            were built with other settings. None: no recordings are shown.
        scores: a table for each method; may be empty. Methods of the same name are called `net`, `net #2`.
        out: the HTML file to write, in whole or not at all.
        progress: called with (recording, done, total) before each recording, and finally ("", total, total).
        extras: groups and galleries of the score tables, in the same order.
        released: benchmark.json of a release without a local build; its settings are shown. None: `settings`
            are shown.

    Raises:
        StorageError: a file in `build` is damaged, or `out` cannot be written.
        PairError: a pair file is missing or damaged.
    """
    recordings = [] if build is None else _recordings(settings, build, progress)
    listed = None if build is None else _listed(settings, build, recordings)
    plain, left_out = recording_list.shortened(
        (released.settings if released else settings).model_dump(mode="json", exclude_none=True)
    )
    pairs = [len(r.tiles) for r in recordings]
    if released:
        pairs = [r.pairs for r in released.recordings.values()]
    elif listed:
        pairs = [int(row[recording_list.PAIRS]) for row in listed.rows]
    published = _published(scores)
    shown = {
        "settings": settings,
        "recordings_left_out": left_out,
        "settings_yaml": yaml.safe_dump(plain, sort_keys=False, allow_unicode=True),
        "package_version": __version__,
        "n_pairs": sum(pairs),
        "recordings": recordings,
        "turntable_frames": turntable.FRAMES,
        "listed": listed,
        "scores": _scores(scores, extras, many_recordings=max(len(settings.recordings), len(pairs)) > SHOWN),
        "published": [tables.published_table(of) for of in published],
        "synthetic": bool(published) and published[0].views is not None,
        "published_source": f"{PUBLISHED_IN}. {PARAMETERS_LINE}",
        "released": released,
    }
    text = render_page("report/page.html", shown)
    with replaced_file(out) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return out


def _published(scores: Sequence[ScoreTable]) -> tuple[PublishedTable, ...]:
    """Return the paper's tables that match the scored pairs; none if all scores are in the camera frame."""
    in_cells = [table for table in scores if not any_in_space(table.settings.protocols)]
    if scores and not in_cells:
        return ()
    rows = [row for table in in_cells for row in table.rows]
    return published_beside({row.recording for row in rows}, {row.category for row in rows})


def _recordings(settings: BenchmarkSettings, build: Path, progress: NamedProgress) -> list[RecordingPart]:
    chosen = spread(settings.recordings, SHOWN)
    total, parts = len(chosen), []
    for done, recording in enumerate(chosen):
        progress(recording.id, done, total)
        parts.append(collect(Job(settings, recording, build.parent), build / recording.id))
    progress("", total, total)
    return parts


def _listed(settings: BenchmarkSettings, build: Path, shown: Sequence[RecordingPart]) -> Listing | None:
    """Return the list of all recordings if the page shows only some in detail, else None."""
    if len(shown) == len(settings.recordings):
        return None
    rows = [
        recording_list.recording_row(Job(settings, r, build.parent), build / r.id)
        for r in settings.recordings
    ]
    return recording_list.listing(rows, [part.settings.id for part in shown])


def _scores(scores: Sequence[ScoreTable], extras: ScoreExtras, *, many_recordings: bool) -> dict[str, object]:
    """Return the values for the page's section on scores."""
    names = method_names(scores)
    parsed = [t.model_copy(update={"method": name}) for t, name in zip(scores, names, strict=True)]
    protocols = tables.protocols(parsed)
    # Protocol of the charts and the gallery; "" without scores.
    primary = protocols[0] if protocols else next((r.heading for t in parsed for r in t.rows), "")
    objects = tables.truth_of_objects(parsed, primary)
    ordered = tables.best_first(parsed, primary)
    galleries = {table.method: gallery for table, gallery in zip(parsed, extras.galleries, strict=False)}
    in_order = [galleries.get(table.method) for table in ordered]
    gallery, left_out = gallery_json(ordered, in_order, extras.truths, primary, many=many_recordings)
    groups = {
        protocol: {names[index]: letters for index, letters in of.items()}
        for protocol, of in extras.groups.letters.items()
    }
    return {
        # Hashes of the benchmarks that the predictions were scored against; normally one.
        "hashes": sorted({table.benchmark_sha256 for table in parsed if table.benchmark_sha256}),
        "tables": [tables.protocol_table(parsed, p, groups.get(p)) for p in protocols],
        "groups": extras.groups,
        "details": tables.details(ordered),
        "space": space_table(ordered),
        "detail_names": list(tables.DETAILS),
        "more_is_better": tables.MORE_IS_BETTER,
        "objects": objects,
        "listed_objects": recording_list.object_listing(objects),
        "methods": ordered,
        "protocol": primary,
        "legend": [(charts.series_class(i), table.method) for i, table in enumerate(ordered)],
        "bars": charts.iou_bars(ordered, primary),
        "threshold_charts": charts.threshold_charts(ordered, primary),
        "visible_charts": charts.visible_charts(ordered, primary),
        "calibration_charts": charts.calibration_charts(ordered, primary),
        "extremes": tables.best_and_worst(ordered, primary),
        "gallery": gallery,
        "gallery_left_out": left_out,
    }
