"""Check that score tables can be compared by a metric under a protocol; errors state the remedy."""

from collections.abc import Mapping, Sequence

import numpy as np

from kinectbench.core import SettingsError, printable
from kinectbench.core.artefacts.score_figures import AVERAGED, IN_SPACE, METRICS, ScoreRow, any_in_space
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.scoring.averages import ObjectMeans, object_means
from kinectbench.scoring.protocols import check_protocols

Tables = Mapping[str, ScoreTable]
# {heading (protocol, with its part and kind): {category: means of its objects}}.
Means = Mapping[str, Mapping[str, ObjectMeans]]


def complete_ones(tables: Tables) -> dict[str, ScoreTable]:
    """Return the tables in which every pair is scored; in others, a mean over some pairs could be too high.

    Raises:
        SettingsError: fewer than two tables are complete.
    """
    if len(tables) < 2:
        raise SettingsError(
            "compare: give the scores of at least two methods: the scores.json of each, or the folder with a "
            "folder of each; those of baselines lie in scores/baselines"
        )
    complete = {name: table for name, table in tables.items() if table.complete}
    if len(complete) < 2:
        lines = "; ".join(left_out_lines(tables))
        raise SettingsError(f"{lines}; fewer than two methods are left to compare", what="other-scores")
    return complete


def left_out_lines(tables: Tables) -> list[str]:
    """Return a line for each method that is not compared because some of its pairs are not scored."""
    return [_left_out_line(name, table) for name, table in tables.items() if not table.complete]


def _left_out_line(name: str, table: ScoreTable) -> str:
    reasons = {failure.reason for failure in table.failures}
    if not table.rows and len(reasons) == 1:
        # Such as a method that the protocols do not fit, for which `--missing empty` would not help.
        return f"{name}: left out, none of its pairs is scored: {reasons.pop()}"
    return (
        f"{name}: left out, some of its pairs are not scored ({len(table.failures)} failed): complete it, or "
        "score it with `--missing empty`"
    )


def comparable_means(tables: Tables, metric: str, protocol: str) -> list[dict[str, ObjectMeans]]:
    """Return {category: means of its objects} for each table, in the order of `tables`.

    Args:
        tables: {method's name: its complete table}.
        metric: one of `METRICS`.
        protocol: the protocol, with kind of registration and part if any, such as `aligned-t+s-visible`.

    Raises:
        SettingsError: the tables are of different releases, or one lacks the protocol, a counted pair or the
            metric. The message lists the protocols or metrics that all tables have.
    """
    _check_truth(tables)
    of = {name: object_means(table.rows) for name, table in tables.items()}
    if lacking := [name for name, means in of.items() if protocol not in means]:
        raise SettingsError(_other_protocol(tables, of, lacking, protocol), what="other-scores")
    means = {name: headings[protocol] for name, headings in of.items()}
    for name, found in means.items():
        if not found:
            raise SettingsError(
                f"{tables[name].left_out_line(protocol)}; there is nothing to compare by", what="other-scores"
            )
    metrics = {name: _scored_metrics(found) for name, found in means.items()}
    if without := [name for name, scored in metrics.items() if metric not in scored]:
        shared = [name for name in METRICS if all(name in scored for scored in metrics.values())]
        remedy = f"all have {', '.join(shared)}: name one by --metric" if shared else "score it again with it"
        raise SettingsError(
            f"{', '.join(without)}: no '{metric}' under '{protocol}'; {remedy}", what="other-scores"
        )
    return [*means.values()]


def _scored_metrics(means: Mapping[str, ObjectMeans]) -> list[str]:
    """Return the metrics that are known for every object of every category."""
    columns = [np.isnan(of.values).any(axis=0) for of in means.values()]
    without = dict(zip(AVERAGED, np.any(columns, axis=0).tolist(), strict=True))
    return [name for name in METRICS if not without[name]]


def _other_protocol(tables: Tables, of: Mapping[str, Means], lacking: Sequence[str], protocol: str) -> str:
    """Return the message that the methods `lacking` were not scored under a protocol, and how to proceed."""
    if not protocol.startswith(IN_SPACE):
        check_protocols([protocol])
    line = f"{', '.join(lacking)}: not scored under '{protocol}'"
    if shared := [name for name in next(iter(of.values())) if all(name in means for means in of.values())]:
        return f"{line}; all are under {', '.join(shared)}: compare with `--protocol {shared[0]}`"
    spatial = [name for name, table in tables.items() if any_in_space(table.settings.protocols)]
    cells = [name for name in tables if name not in spatial]
    both = [name for name in of[spatial[0]] if all(name in of[other] for other in spatial)] if spatial else []
    if not cells or not both:
        return f"{line}; score it again with `--protocol {protocol}`"
    common = "camera" if "camera" in both else both[0]
    return (
        f"{line}: {', '.join(spatial)} in the camera frame and {', '.join(cells)} in cells can stand under "
        f"'{common}': `kinectbench score PREDICTIONS --protocol {common.split('-')[0]} --out FOLDER` of "
        f"{', '.join(cells)}, then compare with `--protocol {common}`"
    )


def _check_truth(tables: Tables) -> None:
    """Refuse tables that were scored against different releases, or state other hashes of their truth."""
    first, other = next(iter(tables)), next(iter(tables.values()))
    for name, table in tables.items():
        if table.benchmark_sha256 != other.benchmark_sha256:
            raise SettingsError(
                f"{name}: scored against benchmark {table.benchmark_sha256[:12]}, {first} against "
                f"{other.benchmark_sha256[:12]}; score both against one",
                what="other-scores",
            )
        for pair in table.hashes.keys() & other.hashes.keys():
            if table.hashes[pair].truth != other.hashes[pair].truth:
                raise SettingsError(
                    f"{name}: scored against another truth of {printable(pair)} than {first}, though both "
                    "name one benchmark; score both again",
                    what="other-scores",
                )


def check_same(tables: Tables, protocol: str) -> None:
    """Refuse tables of different score versions, upsamplings or pairs, or with different truth values.

    All tables were scored under the protocol.

    Raises:
        SettingsError: the tables cannot be compared.
    """
    first, other = next(iter(tables)), next(iter(tables.values()))
    truth, left_out = _truths(other, protocol), set(other.all_unknown_pairs.get(protocol, ()))
    for name, table in tables.items():
        if table.counted_by != other.counted_by:
            raise SettingsError(
                f"{name}: counted by {table.counted_by}, {first} by {other.counted_by}; score both again "
                "with one version and one `--upsampling`",
                what="other-scores",
            )
        pairs, problem = _truths(table, protocol), ""
        if table.base_rate != other.base_rate:
            problem = f"other base rates than {first}; score both again"
        elif pairs.keys() != truth.keys():
            problem = f"other pairs than {first}; score both against one benchmark"
        elif differs := next((pair for pair, of in pairs.items() if of != truth[pair]), None):
            problem = f"states other truth of {differs} than {first}; score both again"
        elif set(table.all_unknown_pairs.get(protocol, ())) != left_out:  # this depends only on the truth
            problem = f"leaves out other pairs than {first}; score both again"
        if problem:
            raise SettingsError(f"{name}: {problem}", what="other-scores")


def _truths(table: ScoreTable, protocol: str) -> dict[str, tuple[object, ...]]:
    """Return {pair: the values of its row that depend only on the truth} under a protocol."""
    return {row.pair: _of_truth(row) for row in table.pairs(protocol)}


def _of_truth(row: ScoreRow) -> tuple[object, ...]:
    of = row.object, row.category, row.coverage_voxels, row.coverage_shape, row.unknown_share
    return (*of, row.base_rate_ce)
