"""Score a method whose predictions are in the camera frame, and make its table."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import get_args

from kinectbench.core import SettingsError
from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.artefacts.score_columns import MOST_ROWS_IN_SPACE
from kinectbench.core.artefacts.score_figures import InSpace, ScoreRow, ShapePart, fields_of
from kinectbench.core.artefacts.scores import ScoreSettings, ScoreTable
from kinectbench.core.artefacts.targets import check_names
from kinectbench.engine.artefact import VERSIONS
from kinectbench.release.release import Release, Target
from kinectbench.scoring.assemble import table_of
from kinectbench.scoring.camera.score_view import Asked, ViewJob, ViewResult, asked_rows, score_view
from kinectbench.scoring.camera.truth import files_of
from kinectbench.scoring.camera_predictions import (
    CameraPredictionFile,
    depth_warnings,
    find_files,
    missing_in_camera,
    strays_in_camera,
)
from kinectbench.scoring.method_json import method_lines
from kinectbench.scoring.request import Request, check_missing
from kinectbench.scoring.rounds import Missing, pairs_to_score
from kinectbench.scoring.thresholds import FIXED, FIXED_SOURCE, Thresholds
from kinectbench.scoring.uncertainty import LEVEL, MIN_OBJECTS, RESAMPLES, SEED
from kinectbench.scoring.workers import run_tasks

F_SCORE_MM = (5.0, 10.0, 20.0)
OF_SPACE = tuple(fields_of(InSpace))


def score_in_camera(
    release: Release,
    folder: Path,
    declared: MethodFile,
    method: str,
    protocols: tuple[str, ...],
    request: Request,
) -> ScoreTable:
    """Score the test split of a method whose predictions are in the camera frame.

    The predictions in `folder` are untrusted; an empty one has the worst value of each metric. `protocols`
    are camera, aligned or both.

    Returns:
        The table. A prediction that cannot be scored is listed in `failures`; all others are scored.

    Raises:
        PredictionError: the folder cannot be read.
        ReleaseError: there is no test pair, an object is in two splits, a file is missing or changed, or a
            truth is held back or too large (`read_space_truth`).
        SettingsError: the table would have too many rows.
    """
    missing, close = check_missing(request.missing), request.close
    check_names(release.targets, str(release.folder))
    test = pairs_to_score(release, validation=False, solid=False)
    refuse_many_rows(len(test), asked_rows(protocols, declared.scale), declared.hypotheses)
    files, failures = _files(folder, test, declared, missing)
    # Checks that may refuse the release or the folder come first: scoring may take hours.
    looked_at = [found for target in sorted(files) for found in files[target][:1]]
    first = (*method_lines(folder, declared, release), *depth_warnings(release, looked_at, declared))
    strays = strays_in_camera(release, folder, declared)
    tasks = [
        ViewJob(target, files_of(release, target), files[target], declared, protocols, close)
        for target in sorted(files)
    ]
    scored = run_tasks(score_view, tasks, request.here, request.progress)
    outcomes = dict(zip(sorted(files), scored, strict=True))
    failures |= {target: result for target, result in outcomes.items() if isinstance(result, str)}
    results = {target: result for target, result in outcomes.items() if isinstance(result, ViewResult)}
    empty = [target for target in files if not files[target]]
    fixed = _fixed_thresholds({target.category for target in results})
    settings = settings_in_space(protocols, missing).model_copy(update={"close": close})
    table = table_in_space(release, method, results, failures, settings, empty, fixed)
    said = (*first, *_without_inside(results, close), *_open_truth(release, test), *table.warnings, *strays)
    return table.model_copy(update={"warnings": said})


def refuse_many_rows(views: int, asked: Sequence[Asked], hypotheses: int = 1) -> None:
    """Refuse a table that would have too many rows, before computing it, which may take hours.

    With several hypotheses per view there are three times as many rows: of the first, the best, and the mean.

    Raises:
        SettingsError: the table would have more than `MOST_ROWS_IN_SPACE` rows.
    """
    of_view = len(asked) * len(get_args(ShapePart)) * (3 if hypotheses > 1 else 1)
    if views * of_view > MOST_ROWS_IN_SPACE:
        fewer = "ask for one --protocol, or " if len({name for name, _ in asked}) > 1 else ""
        raise SettingsError(
            f"{views} views with {of_view} rows each are more than the {MOST_ROWS_IN_SPACE} rows of a score "
            f"table in space: {fewer}score a release of at most "
            f"{MOST_ROWS_IN_SPACE // of_view} views",
            what="too-large",
        )


def left_out_table(
    release: Release, method: str, protocols: tuple[str, ...], missing: Missing, reason: str
) -> ScoreTable:
    """Return the table of a method that cannot be scored under the protocols: all views fail for one reason.

    Args:
        release: the release that was predicted.
        method: the method's name.
        protocols: the requested protocols.
        missing: "error" or "empty"; only stated in the table's settings.
        reason: why the protocols do not fit, as `unfit` returns it.
    """
    test = pairs_to_score(release, validation=False, solid=False)
    failures, settings = dict.fromkeys(test, reason), settings_in_space(protocols, missing)
    fixed = _fixed_thresholds({target.category for target in test})
    return table_in_space(release, method, {}, failures, settings, (), fixed)


def _files(
    folder: Path, test: Sequence[Target], declared: MethodFile, missing: Missing
) -> tuple[dict[Target, tuple[CameraPredictionFile, ...]], dict[Target, str]]:
    """Return {view: its prediction files, () if empty}, and {other view: why it cannot be scored}."""
    files: dict[Target, tuple[CameraPredictionFile, ...]] = dict.fromkeys(test, ())
    failures: dict[Target, str] = {}
    absent: dict[Target, str] = {}  # the line of the first file that is missing
    for target, name, found in find_files(folder, test, declared):
        if isinstance(found, CameraPredictionFile):
            files[target] = (*files[target], found)
        elif found is not None:
            failures.setdefault(target, found)
        else:
            line = absent.setdefault(target, missing_in_camera(name))
            # A view is not empty if some of its hypotheses are there.
            if missing == "error" or declared.hypotheses > 1:
                failures.setdefault(target, line)
    for target, line in absent.items() if missing == "empty" else ():
        if not files[target] and failures.get(target) == line:
            del failures[target]
    return {target: found for target, found in files.items() if target not in failures}, failures


def _fixed_thresholds(categories: Iterable[str]) -> Thresholds:
    """Return placeholder thresholds for predictions without probabilities: each row needs a threshold."""
    of = dict.fromkeys(sorted(categories), FIXED)
    return Thresholds(of, FIXED_SOURCE, (), dict.fromkeys(of, FIXED_SOURCE))


def table_in_space(
    release: Release,
    method: str,
    results: Mapping[Target, ViewResult],
    failures: Mapping[Target, str],
    settings: ScoreSettings,
    empty: Collection[Target],
    thresholds: Thresholds,
    validation: Mapping[Target, str | None] = MappingProxyType({}),
) -> ScoreTable:
    """Make a method's table from its views' results (`table_of`).

    Args:
        release: the release that was predicted.
        method: the method's name.
        results: result of every view that was scored.
        failures: the reason for every view that could not be scored.
        settings: see `settings_in_space`.
        empty: views without a prediction that were scored as empty.
        thresholds: threshold of every category.
        validation: {validation pair that the thresholds were chosen on: digest of its prediction's file, None
            without a file}.
    """
    rows = tuple(
        row
        for target in sorted(results)
        for row in rows_of_view(target, results[target], thresholds.of[target.category])
    )
    digests = {target: result.digest for target, result in results.items()} | dict(validation)
    warnings = [f"{len(empty)} predictions are missing and were scored as empty"] * bool(empty)
    if failures:
        warnings.append(f"incomplete: {len(failures)} views could not be scored, so there are no averages")
    return table_of(
        release, method, rows, digests, thresholds, failures, settings, empty, warnings=warnings, rates={}
    )


def rows_of_view(target: Target, result: ViewResult, threshold: float) -> list[ScoreRow]:
    """Return the table's rows for one view; `threshold` is that of its category."""
    return [
        ScoreRow(
            recording=target.recording,
            object=target.object,
            view=target.view,
            category=target.category,
            protocol=one.protocol,
            threshold=threshold,
            **asdict(one.figures.voxels),
            **asdict(one.figures.surface),
            coverage_voxels=one.figures.coverage_voxels,
            coverage_shape=one.figures.coverage_shape,
            cells=result.cells,
            unknown_share=result.unknown_share,
            **{name: getattr(one if hasattr(one, name) else one.figures, name) for name in OF_SPACE},
        )
        for one in result.rows
    ]


def _without_inside(results: Mapping[Target, ViewResult], close: str | None) -> list[str]:
    """Return a line about predictions without a solid (open meshes, points), and one about those closed."""
    open_ones = {t.name: of.rows[0].closed for t, of in sorted(results.items()) if of.rows[0].solid is False}
    without = [name for name, closed in open_ones.items() if closed is None]
    closed = [name for name in open_ones if name not in without]
    lines = []
    for names, what in (
        (without, "they have no inside, so they have metrics of surfaces alone"),
        (closed, "made solid"),
    ):
        if not names:
            continue
        why = results[next(t for t in results if t.name == names[0])].rows[0].open_because
        lines.append(
            f"{len(names)} of {len(results)} predictions are open meshes or points, such as {names[0]}"
            f"{f' ({why})' if why else ''}: {what}"
        )
    if without and close == "poisson":
        lines[0] += "; --close poisson needs normals"
    if closed:
        lines[-1] += f" by --close {open_ones[closed[0]]}"
    return lines


def _open_truth(release: Release, test: Sequence[Target]) -> list[str]:
    """Return a line with the number of views whose truth is an open mesh; [] if there are none."""
    count = sum(target.split in release.metadata.surface_truth for target in test)
    what = f"the truth of {count} of {len(test)} views is an open mesh, which has no inside: "
    return [what + "metrics of voxels stay empty"] if count else []


def settings_in_space(protocols: tuple[str, ...], missing: Missing) -> ScoreSettings:
    """Return the settings that scores under camera and aligned depend on, as the table states them."""
    return ScoreSettings(
        score_version=VERSIONS["score"],
        protocols=protocols,
        primary_protocol=protocols[0],
        missing=missing,
        occupied="centre of a cell inside a closed mesh, in an occupied cell (y > threshold), "
        "or at a negative distance",
        averages="pair, object, category, macro",
        surface_metrics=True,
        f_score_mm=F_SCORE_MM,
        interval_level=LEVEL,
        interval_rule=f"category: Student t over objects; overall: bootstrap over objects, by category "
        f"({RESAMPLES} resamples, seed {SEED}); none with fewer than {MIN_OBJECTS} objects in a category",
        baseline_version=0,
    )
