"""Score the predictions of one or several methods against a release."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from kinectbench.core import PredictionError, SettingsError, replaced_file
from kinectbench.core.artefacts.counted import PairResult
from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.artefacts.provenance import ThresholdsFile
from kinectbench.core.artefacts.score_columns import MOST_ROWS
from kinectbench.core.artefacts.scores import ScoreSettings, ScoreTable
from kinectbench.core.types import Progress, no_progress
from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.engine.executor import Executor
from kinectbench.engine.shards import Shard
from kinectbench.release.release import Release, Target
from kinectbench.scoring.assemble import as_of_baseline, describe, make_table
from kinectbench.scoring.base_rates import base_rates
from kinectbench.scoring.baselines.recognized import is_of_baseline, made_table
from kinectbench.scoring.camera.score_camera_method import left_out_table, score_in_camera
from kinectbench.scoring.camera.score_grid_method import score_grid_in_space
from kinectbench.scoring.caveats import marks_of
from kinectbench.scoring.method_json import (
    changed_files,
    changed_line,
    method_lines,
    read_in_camera,
)
from kinectbench.scoring.pair_result import Journal, counting_of
from kinectbench.scoring.predictions import (
    check_method,
    find_predictions,
    split_methods,
    strays_of,
)
from kinectbench.scoring.protocols import protocols_in_space, space_alone, unfit
from kinectbench.scoring.request import Request, check_declared, check_request
from kinectbench.scoring.rounds import Missing, Plan, Rounds, plan
from kinectbench.scoring.strays import NO_TARGET
from kinectbench.scoring.thresholds import SEARCHED

NOT_FROM_VALIDATION = "the thresholds are not from validation; predict it too"


def score(
    release: Release,
    predictions: Path,
    *,
    method: str,
    protocols: Sequence[str] | None = None,
    thresholds_file: Path | None = None,
    missing: Missing = "error",
    upsampling: str = HALF_PIXEL,
    surface: bool = True,
    jobs: int | Executor = 1,
    progress: Progress = no_progress,
    resume_in: Path | None = None,
    close: str | None = None,
) -> ScoreTable:
    """Score the test split; predictions of the validation split serve only to choose the thresholds.

    Args:
        release: the release that was predicted.
        predictions: one method's folder, with a file `<recording>/<view>` for each view; untrusted.
        method: the method's name.
        protocols: names of `PROTOCOLS`, or camera, aligned or both; default: all that apply, except shell.
        thresholds_file: a threshold file (`read_thresholds`); then nothing is chosen on the validation split.
        missing: "error" lists a missing prediction as a failure; "empty" scores an empty grid in its place.
        upsampling: "half-pixel" or "corner-aligned" (see `upsampled_planes`).
        surface: whether surface metrics are computed; they take most of the time.
        jobs: number of processes, or an executor for other machines; the result does not depend on it.
        progress: called with (pairs done, pairs in all).
        resume_in: a folder where counts are kept until all pairs are counted; None keeps nothing.
        close: one of `CLOSINGS`, to make open meshes and points in the camera frame solid; None: not at all.

    Returns:
        The table. A prediction that cannot be scored is listed in `failures`; all others are scored.

    Raises:
        PredictionError: the folder is missing, or its method.json is refused (`read_method`).
        ReleaseError: no test pair, an object in two splits, a pair file missing or changed, truth held back.
        SettingsError: an option is unknown, unusable or does not fit the pairs or method.json; too many rows.
    """
    here = jobs if isinstance(jobs, int) else 1
    check_declared(Request(protocols, thresholds_file, None, missing, upsampling, close, jobs), predictions)
    if (file := read_in_camera(predictions)) is not None:
        space = protocols_in_space(protocols, file)
        return score_in_camera(release, predictions, file, method, space, missing, here, progress, close)
    asked = plan(release, predictions, thresholds_file, missing)
    if space := space_alone(protocols, upsampling, close):
        table = score_grid_in_space(release, asked, method, space, missing, here, progress)
        if is_of_baseline(release, table, space, here):
            table = table.model_copy(update={"settings": as_of_baseline(table.settings)})
            table = table.model_copy(update={"marks": marks_of(table)})
        return _with_warnings(table, predictions, asked, release)
    counting, journal = counting_of(release, protocols, upsampling, surface), Journal(resume_in)
    _refuse_many_rows(len(release.split("test")), counting.protocols)
    rounds = Rounds(release, counting, journal, jobs, progress)
    table = _counted_table(release, asked, method, rounds, describe(counting, missing), here)
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


def _with_warnings(
    table: ScoreTable,
    predictions: Path,
    asked: Plan,
    release: Release,
) -> ScoreTable:
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


def _refuse_many_rows(pairs: int, protocols: Sequence[str]) -> None:
    """Refuse a table that would have too many rows to be read again, before counting."""
    if pairs * len(protocols) > MOST_ROWS:
        most = MOST_ROWS // len(protocols)
        raise SettingsError(
            f"{pairs} pairs under {len(protocols)} protocols are more rows than the {MOST_ROWS} that a score "
            f"table may have: ask for one --protocol, or score a release of at most {most} pairs",
            what="too-large",
        )


def score_methods(
    release: Release,
    predictions: Path,
    out: Path,
    *,
    method: str | None = None,
    protocols: Sequence[str] | None = None,
    thresholds_file: Path | None = None,
    save_thresholds: Path | None = None,
    missing: str = "error",
    upsampling: str = HALF_PIXEL,
    surface: bool = True,
    jobs: int | Executor = 1,
    progress: Progress = no_progress,
    close: str | None = None,
) -> list[ScoreTable]:
    """Score every method in a folder; write `out/scores.json`, or `out/<method>/scores.json` of several.

    Args:
        release: the release that was predicted.
        predictions: one method's folder, whose subfolders are recordings, or a folder of methods.
        out: folder for the results.
        method: name of a single method; default: its folder's name.
        protocols: see `score`; tables of methods that they do not fit are returned last, without scores.
        thresholds_file: a threshold file (`read_thresholds`).
        save_thresholds: a file for the thresholds; at least one must be chosen on the validation split.
        missing: "error" or "empty".
        upsampling: "half-pixel" or "corner-aligned".
        surface: see `score`.
        jobs: see `score`.
        progress: called with (pairs done, pairs in all) for each method in turn.
        close: see `score`.

    Raises:
        SettingsError: an option contradicts another option, a method.json, or the number of methods.
        PredictionError, ReleaseError: as in `score`, or no prediction of a single method can be scored.
    """
    request = Request(protocols, thresholds_file, save_thresholds, missing, upsampling, close, jobs)
    rule = check_request(request, predictions)
    methods, tables = _methods(release, predictions, method, request), list[ScoreTable]()
    left_out = _left_out(release, methods, protocols, rule, out)
    for name, folder in ((name, folder) for name, folder in methods.items() if name not in left_out):
        target = out if len(methods) == 1 else out / name
        table = score(
            release,
            folder,
            method=name,
            protocols=protocols,
            thresholds_file=thresholds_file,
            missing=rule,
            upsampling=upsampling,
            surface=surface,
            jobs=jobs,
            progress=progress,
            resume_in=target,
            close=close,
        )
        tables.append(_written(table, folder, target, alone=len(methods) == 1))
        _freeze(release, table, save_thresholds)
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
    release: Release,
    predictions: Path,
    out: Path,
    shard: Shard,
    *,
    method: str | None = None,
    protocols: Sequence[str] | None = None,
    thresholds_file: Path | None = None,
    missing: str = "error",
    upsampling: str = HALF_PIXEL,
    surface: bool = True,
    jobs: int | Executor = 1,
    progress: Progress = no_progress,
) -> int:
    """Count one part of the pairs; a later `score_methods` uses the counts in `out`.

    Several machines that share a disk can count parts at the same time; each part writes a file of its own.
    `shard` is the part; other arguments and errors are those of `score_methods`.

    Returns:
        The number of pairs of this part without a result, because the prediction is missing or cannot be
        scored.
    """
    request = Request(protocols, thresholds_file, None, missing, upsampling, None, jobs, in_parts=True)
    rule = check_request(request, predictions)
    methods = _methods(release, predictions, method, request)
    failed = 0
    for name, folder in methods.items():
        asked = plan(release, folder, thresholds_file, rule)
        counting = counting_of(release, protocols, upsampling, surface)
        _refuse_many_rows(len(release.split("test")), counting.protocols)
        journal = Journal(out if len(methods) == 1 else out / name, shard)
        rounds = Rounds(release, counting, journal, jobs, progress)
        outcomes, _ = rounds.count(asked.part(shard, surface=surface), asked.fixed, asked.own)
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
        thresholds=table.thresholds,
        method=table.method,
        benchmark_sha256=release.benchmark_sha256,
        **objects,
    )
    with replaced_file(path) as temporary:
        temporary.write_text(frozen.text(), encoding="utf-8")
