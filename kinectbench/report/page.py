"""The page of a whole benchmark: one file that opens from disk, with every picture inside."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import yaml
from markupsafe import Markup

from kinectbench._version import __version__
from kinectbench.core.artefacts.benchmark import ReleaseInfo
from kinectbench.core.artefacts.gallery import Gallery
from kinectbench.core.artefacts.scores import Extremes, ScoreTable
from kinectbench.core.pages import render_page
from kinectbench.core.storage import replaced_file
from kinectbench.core.types import NamedProgress
from kinectbench.report import charts, tables
from kinectbench.report.gallery import PairTruth, gallery_json
from kinectbench.report.recording import RecordingPart, collect
from kinectbench.scoring.compare import method_names
from kinectbench.scoring.references import PUBLISHED_IN
from kinectbench.settings.models import BenchmarkSettings


@dataclass(frozen=True)
class Ranking:
    """Ranks by mean IoU over all categories.

    Attributes:
        of: {protocol: {index of the table: rank}}; incomplete methods have none.
        notes: one line each.
    """

    of: Mapping[str, Mapping[int, int]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Beside:
    """What is shown with score tables but is not in them.

    Attributes:
        ranking: of the tables.
        galleries: of each table, or none at all.
        truths: what is shown of the pairs, by name.
    """

    ranking: Ranking = field(default_factory=Ranking)
    galleries: Sequence[Gallery | None] = ()
    truths: Mapping[str, PairTruth] = field(default_factory=dict)


@dataclass(frozen=True)
class ScoresPart:
    """The scores' section of a page.

    Attributes:
        hashes: SHA-256 of the benchmark that the predictions were scored against; one, if all is well.
        score_tables: one for each protocol, the primary first.
        rank_notes: what to know of the ranks.
        published: the paper's own figures.
        details: every other figure.
        methods: their tables, the best first.
        protocol: the one that the charts and the gallery show; "" without scores.
        legend: (style, method) of the charts' lines.
        bars: IoU by category.
        threshold_charts: IoU against the threshold, by category.
        visible_charts: IoU against the share of the shape that the view saw, by category.
        extremes: best and worst pairs by method.
        gallery: its data for the browser, or None.
        gallery_left_out: pairs that there was no room for.
    """

    hashes: tuple[str, ...]
    score_tables: tuple[tables.Table, ...]
    rank_notes: tuple[str, ...]
    published: tables.Table
    details: tuple[tables.Detail, ...]
    methods: tuple[ScoreTable, ...]
    protocol: str
    legend: tuple[tuple[str, str], ...]
    bars: tuple[charts.Bars, ...]
    threshold_charts: tuple[charts.Chart, ...]
    visible_charts: tuple[charts.Chart, ...]
    extremes: Mapping[str, Extremes]
    gallery: Markup | None
    gallery_left_out: int

    @property
    def detail_names(self) -> tuple[str, ...]:
        """Headings of the table of details."""
        return tuple(tables.DETAILS)


def scores_part(scores: Sequence[ScoreTable], beside: Beside) -> ScoresPart:
    """Lay out the scores.

    Args:
        scores: a table for each method; methods of one name are told apart as `net`, `net #2`.
        beside: ranks and galleries, in the same order.
    """
    names = method_names(scores)
    parsed = [t.model_copy(update={"method": name}) for t, name in zip(scores, names, strict=True)]
    protocols = tables.protocols(parsed)
    primary = protocols[0] if protocols else next((r.protocol for t in parsed for r in t.rows), "")
    ordered = tables.best_first(parsed, primary)
    galleries = {table.method: gallery for table, gallery in zip(parsed, beside.galleries, strict=False)}
    in_order = [galleries.get(table.method) for table in ordered]
    gallery, left_out = gallery_json(ordered, in_order, beside.truths, primary)
    ranks = {
        protocol: {parsed[index].method: rank for index, rank in of.items()}
        for protocol, of in beside.ranking.of.items()
    }
    return ScoresPart(
        hashes=tuple(sorted({table.benchmark_sha256 for table in parsed if table.benchmark_sha256})),
        score_tables=tuple(tables.score_table(parsed, p, ranks.get(p)) for p in protocols),
        rank_notes=beside.ranking.notes,
        published=tables.published_table(),
        details=tables.details(ordered),
        methods=tuple(ordered),
        protocol=primary,
        legend=tuple((charts.series_class(i), table.method) for i, table in enumerate(ordered)),
        bars=charts.iou_bars(ordered, primary),
        threshold_charts=charts.threshold_charts(ordered, primary),
        visible_charts=charts.visible_charts(ordered, primary),
        extremes=tables.best_and_worst(ordered, primary),
        gallery=gallery,
        gallery_left_out=left_out,
    )


NOTHING_BESIDE = Beside()


@dataclass(frozen=True)
class Page:
    """Everything that the template shows.

    Attributes:
        settings: the benchmark's settings; `settings_yaml` is their text.
        package_version: of this package.
        recordings: a section each.
        scores: tables, charts, gallery.
        published_source: the paper whose own figures are shown.
        released: benchmark.json of a release whose build is not here; None where the page shows a build.
    """

    settings: BenchmarkSettings
    settings_yaml: str
    package_version: str
    recordings: tuple[RecordingPart, ...]
    scores: ScoresPart
    published_source: str
    released: ReleaseInfo | None = None

    @property
    def n_pairs(self) -> int:
        """Pairs of all recordings."""
        if self.released:
            return sum(recording.pairs for recording in self.released.recordings.values())
        return sum(len(part.tiles) for part in self.recordings)


def make_page(
    settings: BenchmarkSettings,
    recordings: Sequence[RecordingPart],
    scores: Sequence[ScoreTable],
    beside: Beside = NOTHING_BESIDE,
    released: ReleaseInfo | None = None,
) -> str:
    """Lay out the page from its parts: HTML text, the same for the same input.

    Of a release alone (`released`) the settings shown are those that it was built with.
    """
    shown = released.settings if released else settings
    plain = shown.model_dump(mode="json", exclude_none=True)
    page = Page(
        settings=settings,
        settings_yaml=yaml.safe_dump(plain, sort_keys=False, allow_unicode=True),
        package_version=__version__,
        recordings=tuple(recordings),
        scores=scores_part(scores, beside),
        published_source=PUBLISHED_IN,
        released=released,
    )
    return render_page("report/page.html", {"page": page})


def write_report(
    settings: BenchmarkSettings,
    build: Path,
    scores: Sequence[ScoreTable],
    out: Path,
    progress: NamedProgress | None = None,
    beside: Beside = NOTHING_BESIDE,
) -> Path:
    """Write the page of a benchmark.

    Args:
        settings: the benchmark.
        build: folder that holds a folder for each recording; what is not built yet is noted on the page.
        scores: a table for each method; may be empty.
        out: the HTML file to write, in whole or not at all.
        progress: told (recording, done, total) before each recording, and ("", total, total) at the end.
        beside: ranks and galleries of the score tables.

    Returns:
        The file written: `out`.

    Raises:
        StorageError: a file in `build` is damaged, or `out` cannot be written.
        PairError: a pair file is missing or damaged.
    """
    report = progress or (lambda _recording, _done, _total: None)
    total = len(settings.recordings)
    parts = []
    for done, recording in enumerate(settings.recordings):
        report(recording.id, done, total)
        parts.append(collect(recording, build / recording.id))
    report("", total, total)
    text = make_page(settings, parts, scores, beside)
    with replaced_file(out) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return out
