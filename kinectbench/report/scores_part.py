"""Everything the page shows of the scores."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from markupsafe import Markup

from kinectbench.report import charts, tables
from kinectbench.report.extremes import Extremes, extremes
from kinectbench.report.gallery import PairTruth, gallery_json
from kinectbench.report.gallery_file import Gallery
from kinectbench.report.ranks import Ranking
from kinectbench.report.score_model import parse_scores


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
        methods: how each method was scored.
        protocol: the one that the charts and the gallery show; "" without scores.
        legend: (style, method) of the charts' lines.
        bars: IoU by category.
        threshold_charts: IoU against the threshold, by category.
        visible_charts: IoU against the share of the shape that the view saw, by category.
        extremes: best and worst pairs.
        gallery: its data for the browser, or None.
        gallery_left_out: pairs that there was no room for.
    """

    hashes: tuple[str, ...]
    score_tables: tuple[tables.Table, ...]
    rank_notes: tuple[str, ...]
    published: tables.Table
    details: tuple[tables.Detail, ...]
    methods: tuple[tables.Method, ...]
    protocol: str
    legend: tuple[tuple[str, str], ...]
    bars: tuple[charts.Bars, ...]
    threshold_charts: tuple[charts.Chart, ...]
    visible_charts: tuple[charts.Chart, ...]
    extremes: tuple[Extremes, ...]
    gallery: Markup | None
    gallery_left_out: int

    @property
    def detail_names(self) -> tuple[str, ...]:
        """Headings of the table of details."""
        return tables.DETAIL_NAMES


def scores_part(scores: Sequence[Mapping[str, Any]], beside: Beside) -> ScoresPart:
    """Lay out the scores.

    Args:
        scores: tables as in scores.json, one for each method.
        beside: ranks and galleries, in the same order.

    Raises:
        StorageError: a score table is not what scores.json should hold.
    """
    parsed = parse_scores(scores)
    protocols = tables.protocols(parsed)
    primary = protocols[0] if protocols else next((r.protocol for t in parsed for r in t.rows or []), "")
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
        methods=tables.methods(ordered),
        protocol=primary,
        legend=tuple((charts.series_class(i), table.method) for i, table in enumerate(ordered)),
        bars=charts.iou_bars(ordered, primary),
        threshold_charts=charts.threshold_charts(ordered, primary),
        visible_charts=charts.visible_charts(ordered, primary),
        extremes=extremes(ordered, primary),
        gallery=gallery,
        gallery_left_out=left_out,
    )
