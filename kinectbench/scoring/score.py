"""Score the predictions of one or several methods against a release."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from kinectbench.core import PredictionError, SettingsError, replaced_file
from kinectbench.core.artefacts.counted import PairResult
from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.artefacts.provenance import ThresholdsFile
from kinectbench.core.artefacts.score_columns import MOST_ROWS
from kinectbench.core.artefacts.scores import ScoreSettings, ScoreTable
from kinectbench.engine.shards import Shard
from kinectbench.release.release import Release, Target
from kinectbench.scoring.assemble import as_of_baseline, describe, make_table
from kinectbench.scoring.base_rates import base_rates
from kinectbench.scoring.baselines.recognized import is_of_baseline, made_table
from kinectbench.scoring.camera.score_camera_method import left_out_table, score_in_camera
from kinectbench.scoring.camera.score_grid_view import score_grid_in_space
from kinectbench.scoring.caveats import marks_of
from kinectbench.scoring.method_json import changed_files, changed_line, method_lines, read_in_camera
from kinectbench.scoring.pair_result import Journal, counting_of
from kinectbench.scoring.predictions import check_method, find_predictions, split_methods, strays_of
from kinectbench.scoring.protocols import protocols_in_space, space_alone, unfit
from kinectbench.scoring.request import Request, check_declared, check_missing, check_request
from kinectbench.scoring.rounds import Missing, Plan, Rounds, plan
from kinectbench.scoring.strays import NO_TARGET
from kinectbench.scoring.thresholds import SEARCHED

NOT_FROM_VALIDATION = "the thresholds are not from validation; predict it too"


def score(
    release: Release, predictions: Path, *, method: str, resume_in: Path | None = None, **options: Any
) -> ScoreTable:
    """Score the test split; predictions of the validation split serve only to choose the thresholds.

    `predictions` is one method's folder, untrusted, with a file `<recording>/<view>` for each view. Counts
    are kept in `resume_in`, if given, until all pairs are counted. `options` are the attributes of `Request`.

    Returns:
        The table. A prediction that cannot be scored is listed in `failures`; all others are scored.

    Raises:
        PredictionError: the folder is missing, or its method.json is refused (`read_method`).
        ReleaseError: no test pair, an object in two splits, a pair file missing or changed, truth held back.
        SettingsError: an option is unknown, unusable or does not fit the pairs or method.json; too many rows.
    """
    request = Request(**options)
    missing = check_missing(request.missing)
    check_declared(request, predictions)
    if (file := read_in_camera(predictions)) is not None:
        space = protocols_in_space(request.protocols, file)
        return score_in_camera(release, predictions, file, method, space, request)
    asked = plan(release, predictions, request.thresholds_file, missing)
    if space := space_alone(request.protocols, request.upsampling, request.close):
        table = score_grid_in_space(release, asked, method, space, request)
        if is_of_baseline(release, table, space, request.here):
            table = table.model_copy(update={"settings": as_of_baseline(table.settings)})
            table = table.model_copy(update={"marks": marks_of(table)})
        return _with_warnings(table, predictions, asked, release)
    journal = Journal(resume_in)
    rounds = _rounds(release, request, journal)
    table = _counted_table(release, asked, method, rounds, describe(rounds.counting, missing), request.here)
    if table.complete:
        journal.remove()
    return _with_warnings(table, predictions, asked, release)


def _counted_table(
    release: Release, asked: Plan, method: str, rounds: Rounds, how: ScoreSettings, jobs: int
) -> ScoreTable:
    outcomes, thresholds = rounds.count(asked.files, asked.fixed, asked.own)
    failures = asked.failures | {t: result for t, result in outcomes.items() if isinstance(result, str)}
    results = {target: result for target, result in outcomes.items() if isinstance(result, PairResult)}
    rates = base_rates(release, jobs, {target: result.tally for target, result in results.items()})
    empty = [t for t, file in asked.files.items() if file is None]
    make = partial(make_table, release, method, results, thresholds, rates, failures, empty=empty)
    return made_table(release, make, how, rounds.counting, jobs)


def _with_warnings(table: ScoreTable, predictions: Path, asked: Plan, release: Release) -> ScoreTable:
    """Add warnings about method.json and the folder to a table, and the run's hash if method.json has it."""
    method = asked.found.method
    more = (
        *method_lines(predictions, method, release),
        *_changed(method, asked.files, table),
        *strays_of(release, asked.found),
    )
    update: dict[str, object] = {"warnings": (*table.warnings, *more)}
    if method is not None and method.run_sha256 is not None:
        update["run_sha256"] = method.run_sha256
    return table.model_copy(update=update)


def _changed(method: MethodFile | None, files: Mapping[Target, Path | None], table: ScoreTable) -> list[str]:
    """Return a line on scored files whose digests differ from those in method.json; [] if all agree."""
    digests = {
        target.name + file.suffix: of.prediction
        for target, file in files.items()
        if file is not None and (of := table.hashes.get(target.name)) and of.prediction is not None
    }
    changed = changed_files(method, digests)
    return [changed_line(changed, len(digests))] if changed else []


def _rounds(release: Release, request: Request, journal: Journal) -> Rounds:
    """Return how to count the pairs; refuse a table that would have too many rows to be read again."""
    counting = counting_of(release, request.protocols, request.upsampling, request.surface)
    pairs, protocols = len(release.split("test")), counting.protocols
    if pairs * len(protocols) > MOST_ROWS:
        most = MOST_ROWS // len(protocols)
        raise SettingsError(
            f"{pairs} pairs under {len(protocols)} protocols are more rows than the {MOST_ROWS} that a score "
            f"table may have: ask for one --protocol, or score a release of at most {most} pairs",
            what="too-large",
        )
    assert not isinstance(request.jobs, str)  # an address is for `check_request` alone
    return Rounds(release, counting, journal, request.jobs, request.progress)


def score_methods(
    release: Release, predictions: Path, out: Path, *, method: str | None = None, **options: Any
) -> list[ScoreTable]:
    """Score every method in a folder; write `out/scores.json`, or `out/<method>/scores.json` of several.

    Args:
        release: the release that was predicted.
        predictions: one method's folder, whose subfolders are recordings, or a folder of methods.
        out: folder for the results.
        method: name of a single method; default: its folder's name.
        options: the attributes of `Request`. Tables of methods that the protocols do not fit are returned
            last, without scores.

    Raises:
        SettingsError: an option contradicts another option, a method.json, or the number of methods.
        PredictionError, ReleaseError: as in `score`, or no prediction of a single method can be scored.
    """
    request = Request(**options)
    rule = check_request(request, predictions)
    methods, tables = _methods(release, predictions, method, request), list[ScoreTable]()
    left_out = _left_out(release, methods, request.protocols, rule, out)
    for name, folder in ((name, folder) for name, folder in methods.items() if name not in left_out):
        target = out if len(methods) == 1 else out / name
        table = score(release, folder, method=name, resume_in=target, **options)
        tables.append(_written(table, folder, target, alone=len(methods) == 1))
        _freeze(release, table, request.save_thresholds)
    return [*tables, *left_out.values()]


def _left_out(
    release: Release,
    methods: Mapping[str, Path],
    protocols: Sequence[str] | None,
    missing: Missing,
    out: Path,
) -> dict[str, ScoreTable]:
    """Return tables without scores for the methods that the protocols do not fit.

    A table is written unless there are earlier scores of the method, which are kept. If the protocols fit no
    method, an error is raised.
    """
    declared = {name: read_in_camera(folder) for name, folder in methods.items()}
    reasons = {name: unfit(protocols, of) for name, of in declared.items() if of is not None}
    found = {name: reason for name, reason in reasons.items() if reason is not None}
    if len(found) == len(methods):
        raise SettingsError(next(iter(found.values())))
    asked = tuple(protocols or ())
    tables = {name: left_out_table(release, name, asked, missing, reason) for name, reason in found.items()}
    for name, table in tables.items():
        if not (out / name / ScoreTable.FILE).is_file():
            table.write(out / name)
    return tables


def _written(table: ScoreTable, folder: Path, out: Path, *, alone: bool) -> ScoreTable:
    """Write a method's table and return it; if it has no rows, keep earlier scores instead.

    Raises:
        PredictionError: the table has no rows, and the method is the only one (`alone`).
    """
    if table.rows:
        table.write(out)
    if table.rows or not alone:  # the caller reports its failures with the other methods' tables
        return table
    kept = f"; the earlier scores in {out} are kept" if (out / ScoreTable.FILE).is_file() else ""
    reason = table.failures[0].reason if table.failures else "no view"
    stray = next((f"; {line}" for line in table.warnings if NO_TARGET in line), "")
    raise PredictionError(
        f"{folder}: nothing could be scored: {len(table.failures)} views failed, the first: {reason}{stray}"
        f"{kept}"
    )


def count_methods(
    release: Release, predictions: Path, out: Path, shard: Shard, *, method: str | None = None, **options: Any
) -> int:
    """Count one part of the pairs; a later `score_methods` uses the counts in `out`.

    Several machines that share a disk can count parts at the same time; each part writes a file of its own.
    `shard` is the part; other arguments and errors are those of `score_methods`.

    Returns:
        The number of pairs of this part without a result, because the prediction is missing or cannot be
        scored.
    """
    request = Request(**options, in_parts=True)
    rule = check_request(request, predictions)
    methods = _methods(release, predictions, method, request)
    failed = 0
    for name, folder in methods.items():
        asked = plan(release, folder, request.thresholds_file, rule)
        rounds = _rounds(release, request, Journal(out if len(methods) == 1 else out / name, shard))
        outcomes, _ = rounds.count(asked.part(shard, surface=request.surface), asked.fixed, asked.own)
        without = [*asked.failures, *(each for each, result in outcomes.items() if isinstance(result, str))]
        failed += sum(shard.holds(target.recording) for target in without)
    return failed


def _methods(release: Release, predictions: Path, method: str | None, request: Request) -> dict[str, Path]:
    """Return {method: its folder}; refuse options that contradict one of the methods."""
    methods, saved = split_methods(predictions, release.targets), request.save_thresholds
    for option, value in (("--method names", method), ("--save-thresholds is of", saved)):
        if value is not None and len(methods) > 1:
            raise SettingsError(
                f"{option} one method, but {predictions} holds {len(methods)}: name the folder of one of them"
            )
    named = methods if method is None else dict(zip([method], methods.values(), strict=True))
    for name, folder in named.items():
        check_method(name)
        check_declared(request, folder, of_several=len(named) > 1)
        if saved is not None and not find_predictions(folder, release.split("validation")).files:
            raise SettingsError(f"--save-thresholds {saved}: {NOT_FROM_VALIDATION}")
    return named


def _freeze(release: Release, table: ScoreTable, path: Path | None) -> None:
    """Write a table's thresholds of all categories to the file `path`, if it is given.

    Raises:
        SettingsError: no threshold was chosen on the validation split.
    """
    if path is None:
        return
    if table.threshold_source not in SEARCHED:
        raise SettingsError(f"--save-thresholds {path}: {NOT_FROM_VALIDATION}")
    # Without `objects` the file says that they are unknown, as for the method's own thresholds.
    objects = {} if table.threshold_objects is None else {"objects": table.threshold_objects}
    frozen = ThresholdsFile(
        thresholds=table.thresholds, method=table.method, benchmark_sha256=release.benchmark_sha256, **objects
    )
    with replaced_file(path) as temporary:
        temporary.write_text(frozen.text(), encoding="utf-8")
