"""Compare methods: paired differences per object, sign-flip tests, Holm's correction, ranks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from kinectbench.core import SettingsError
from kinectbench.core.artefacts.score_figures import AVERAGED, METRICS, SHARES
from kinectbench.core.artefacts.score_marks import BASELINE
from kinectbench.core.artefacts.scores import OVERALL, SCORES_JSON, ScoreTable
from kinectbench.scoring.averages import ObjectMeans
from kinectbench.scoring.comparable import check_same, comparable_means, complete_ones, left_out_lines
from kinectbench.scoring.protocols import PRIMARY
from kinectbench.scoring.uncertainty import (
    MAX_EXACT,
    MOST_GROUPS,
    bootstrap_interval,
    holm,
    samples,
    sign_flip_ps,
    significance_letters,
    smallest_p,
    student_interval,
)

ALPHA = 0.05
ALL = "all"
# Maximum number of folders named in an error message.
MOST_NAMED = 6
GROUPS_NOTE = (
    "group: methods that share a letter cannot be distinguished; of methods that share none a difference is "
    "shown (paired sign-flip test over objects, 5 %, Holm)"
)


@dataclass(frozen=True)
class Difference:
    """The difference between two methods on the same objects.

    Attributes:
        first: name of one method.
        second: name of the other method.
        scope: a category, or "all" for the mean over the categories.
        mean: mean of first minus second.
        interval: lower and upper end of the 95 % confidence interval of the mean, over objects. Unlike
            `p_holm`, it is not corrected for the number of pairs of methods. None if there are fewer than
            three objects (for "all": in any category).
        by_object: {object: first minus second}.
        p: p value of the two-sided sign-flip test.
        p_holm: p, corrected for all pairs of methods compared in this scope.
        smallest_p: the smallest p that the test can give with this number of objects, times the number of
            pairs of methods, at most 1.
        verdict: one sentence.
    """

    first: str
    second: str
    scope: str
    mean: float
    interval: tuple[float, float] | None
    by_object: Mapping[str, float]
    p: float
    p_holm: float
    smallest_p: float
    verdict: str


@dataclass(frozen=True)
class Comparison:
    """Several methods compared by one metric under one protocol.

    Attributes:
        metric: such as "iou".
        protocol: such as "known".
        methods: names of the methods.
        means: {scope: {method: mean}}.
        ranks: {scope: {method: 1 + the number of methods that are significantly better}}.
        groups: {scope: {method: its letters}}; methods that share a letter do not differ significantly.
        differences: one for every pair of methods in every scope.
        notes: one line each: which methods are left out, which scopes are too small to distinguish methods,
            how many pairs are left out, and the caveats of each method's scores.
        too_small: {scope: a sentence}, for scopes with too few objects to distinguish any two methods.
        standings: {method: "reported", or "verified" with date and version}.
        left_out: names of methods that are not compared because some of their pairs are not scored.
        truth_unknown_share: {scope: share of the true shapes that is not known}; the share is None for older
            tables.
        unknown_by_object: {object: share of its true shape that is not known}, including objects that are
            left out.
    """

    metric: str
    protocol: str
    methods: tuple[str, ...]
    means: Mapping[str, Mapping[str, float]]
    ranks: Mapping[str, Mapping[str, int]]
    groups: Mapping[str, Mapping[str, str]]
    differences: tuple[Difference, ...]
    notes: tuple[str, ...]
    truth_unknown_share: Mapping[str, float | None]
    unknown_by_object: Mapping[str, float]
    too_small: Mapping[str, str]
    standings: Mapping[str, str]
    left_out: tuple[str, ...]


def compare(tables: Sequence[ScoreTable], metric: str = "iou", protocol: str = PRIMARY) -> Comparison:
    """Compare methods that were scored on the same truth.

    Args:
        tables: at least two complete tables; incomplete tables are left out, with a note.
        metric: one of `METRICS`, such as "iou".
        protocol: one under which all tables were scored.

    Raises:
        SettingsError: fewer than two tables are complete; their truth, version, upsampling or pairs differ;
            or the metric or the protocol was not scored.
    """
    if metric not in METRICS:
        raise SettingsError(f"no metric '{metric}': choose among {', '.join(METRICS)}")
    all_of = dict(zip(method_names(tables), tables, strict=True))
    complete = complete_ones(all_of)
    names, tables = tuple(complete), tuple(complete.values())
    means = comparable_means(complete, metric, protocol)
    check_same(complete, protocol)
    scopes = [*means[0], *([ALL] if len(means[0]) > 1 else [])]
    columns = [{scope: _values(of, metric, scope) for scope in scopes} for of in means]
    rows, notes, small = list[Difference](), left_out_lines(all_of), dict[str, str]()
    for scope in scopes:
        of_scope = [column[scope] for column in columns]
        rows += _differences(names, of_scope, scope, metric, _intervals(means, metric, scope))
        count, pairs = len(of_scope[0]), len(names) * (len(names) - 1) // 2
        if pairs * smallest_p(count) > ALPHA:
            small[scope] = too_small(count, pairs)
            notes.append(f"{scope}: {small[scope]}")
        if count > MAX_EXACT:
            notes.append(f"{scope}: {count} objects; {samples(count):,} sign flips drawn, not all")
    averages = {
        scope: {name: _mean(column[scope]) for name, column in zip(names, columns, strict=True)}
        for scope in scopes
    }
    ranks = {scope: _ranks(names, [d for d in rows if d.scope == scope], metric) for scope in scopes}
    groups = {name: _groups(averages[name], [d for d in rows if d.scope == name], metric) for name in scopes}
    notes += [
        f"{scope}: more than {MOST_GROUPS} groups, so no letters are given; the differences say more"
        for scope, of in groups.items()
        if not any(of.values())
    ]
    notes += [*filter(None, [tables[0].left_out_line(protocol)]), *_qualified(complete)]
    of_truth = tables[0].averages(protocol)
    unknown = {scope: of_truth.get(OVERALL if scope == ALL else scope) for scope in scopes}
    return Comparison(
        metric,
        protocol,
        names,
        averages,
        ranks,
        groups,
        tuple(rows),
        tuple(notes),
        {scope: None if of is None else of.truth_unknown_share for scope, of in unknown.items()},
        tables[0].truth_unknown_share,
        small,
        {name: table.standing for name, table in complete.items()},
        tuple(sorted(all_of.keys() - complete.keys())),
    )


def _qualified(tables: Mapping[str, ScoreTable]) -> list[str]:
    """Return a line for each method that has caveats: the marks of its table, except "baseline"."""
    marks = {name: [m.words for m in table.marks if m.kind != BASELINE] for name, table in tables.items()}
    return [f"{name}: {'; '.join(words)}" for name, words in marks.items() if words]


def find_scores(paths: Sequence[Path]) -> list[Path]:
    """Return the scores.json files at paths; a path is a file, a method's folder, or a folder of methods.

    A file that is named twice counts once.

    Raises:
        SettingsError: a path does not exist, or has no scores.json.
    """
    files = list[Path]()
    for path in paths:
        if path.is_dir():
            own = [path / SCORES_JSON] if (path / SCORES_JSON).is_file() else []
            below = own or sorted(path.glob(f"*/{SCORES_JSON}"))
            if not below:
                raise SettingsError(
                    f"{path}: no scores.json there; run `kinectbench score` first", what="no-file"
                )
            files += below
        elif path.exists():
            files.append(path)
        else:
            raise SettingsError(f"{path}: no such file or folder", what="no-file")
    return [*{file.resolve(): file for file in files}.values()]


def find_methods(paths: Sequence[Path]) -> list[Path]:
    """Return the scores.json files for a comparison, as `find_scores` does.

    Raises:
        SettingsError: as in `find_scores`; or the only file found is in a folder that also has subfolders
            with a scores.json. This happens if one method was scored into the folder of all methods.
    """
    files = find_scores(paths)
    below = [file.parent for path in paths if path.is_dir() for file in sorted(path.glob(f"*/{SCORES_JSON}"))]
    if len(files) == 1 and below and files[0].parent in paths:
        raise SettingsError(
            f"compare: {files[0]} has the scores of one method, and hides those in subfolders: delete it if "
            "it is old, or move it into a folder of its own; or name "
            f"{' '.join(map(str, below[:MOST_NAMED]))}"
        )
    return files


def method_names(tables: Sequence[ScoreTable]) -> tuple[str, ...]:
    """Return the methods' names, made unique: the second method named `net` becomes `net #2`."""
    given = [table.method for table in tables]
    again = [given[:index].count(name) for index, name in enumerate(given)]
    return tuple(f"{name} #{n + 1}" if n else name for name, n in zip(given, again, strict=True))


Weighted = Mapping[str, tuple[float, float]]


def _mean(values: Weighted) -> float:
    return sum(value * weight for value, weight in values.values())


def _values(means: Mapping[str, ObjectMeans], metric: str, scope: str) -> dict[str, tuple[float, float]]:
    """Return {object: (its value of the metric, its weight in the mean of the scope)}; weights sum to 1."""
    column = AVERAGED.index(metric)
    categories = means if scope == ALL else {scope: means[scope]}
    return {
        name: (float(value), float(weight / group.weights.sum()) / len(categories))
        for group in categories.values()
        for name, value, weight in zip(group.names, group.values[:, column], group.weights, strict=True)
    }


def _differences(
    names: Sequence[str],
    values: Sequence[Weighted],
    scope: str,
    metric: str,
    intervals: Sequence[tuple[float, float] | None],
) -> list[Difference]:
    """Return the difference of every pair of methods in one scope.

    `values` are for each method {object: (value, weight in the scope's mean)}, `intervals` for each pair.
    """
    pairs = list(combinations(range(len(names)), 2))
    raw = [{o: values[a][o][0] - values[b][o][0] for o in values[a]} for a, b in pairs]
    weights = np.array([weight for _, weight in values[0].values()])
    weighted = np.array([[*differences.values()] for differences in raw]) * weights
    p_values = sign_flip_ps(weighted)
    count = len(values[0])
    smallest = min(1.0, len(pairs) * smallest_p(count))
    differences = []
    for n, ((a, b), p, corrected) in enumerate(zip(pairs, p_values, holm(p_values), strict=True)):
        mean = float(weighted[n].sum())
        better = names[a] if (mean > 0) == (metric in SHARES) else names[b]
        verdict = f"{better} is better (p = {corrected:.2g})"
        if corrected > ALPHA:
            verdict = "no difference shown" if smallest <= ALPHA else "too few objects to tell"
        differences.append(
            Difference(
                *(names[a], names[b], scope, mean, intervals[n]), *(raw[n], p, corrected, smallest, verdict)
            )
        )
    return differences


def _intervals(
    means: Sequence[Mapping[str, ObjectMeans]], metric: str, scope: str
) -> list[tuple[float, float] | None]:
    """Return the confidence interval of the mean difference of every pair of methods.

    It is computed from the difference of each object, because both methods were scored on the same objects.
    """
    column, pairs = AVERAGED.index(metric), list(combinations(range(len(means)), 2))
    groups = []
    for category in means[0] if scope == ALL else [scope]:
        values = np.stack([of[category].values[:, column] for of in means], axis=1)
        differences = np.stack([values[:, a] - values[:, b] for a, b in pairs], axis=1)
        groups.append((differences, means[0][category].weights))
    interval = bootstrap_interval(groups) if scope == ALL else student_interval(*groups[0])
    return [None] * len(pairs) if interval is None else [(float(low), float(high)) for low, high in interval]


def _ranks(names: Sequence[str], differences: Sequence[Difference], metric: str) -> dict[str, int]:
    """Return each method's rank: 1 + the number of methods that are significantly better."""
    ranks = dict.fromkeys(names, 1)
    for difference in differences:
        if difference.p_holm <= ALPHA:
            ranks[difference.second if (difference.mean > 0) == (metric in SHARES) else difference.first] += 1
    return ranks


def _groups(means: Mapping[str, float], differences: Sequence[Difference], metric: str) -> dict[str, str]:
    """Return {method: its letters}, in the order of `means`."""
    best_first = sorted(means, key=lambda name: means[name], reverse=metric in SHARES)
    by_name = significance_letters(
        best_first, {frozenset((d.first, d.second)) for d in differences if d.p_holm <= ALPHA}
    )
    return {name: by_name[name] for name in means}


def too_small(count: int, pairs: int) -> str:
    """Return the sentence that the test set is too small to distinguish any two methods.

    Args:
        count: number of objects, or of other compared units.
        pairs: number of pairs of compared methods.
    """
    objects = "1 object" if count == 1 else f"{count} objects"
    corrected = f", {min(1.0, pairs * smallest_p(count)):.2g} for {pairs} comparisons" if pairs > 1 else ""
    return (
        f"the test set is too small to tell: with {objects} the smallest possible p is "
        f"{smallest_p(count):.2g}{corrected}"
    )
