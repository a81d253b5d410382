"""The commands `score` and `compare`."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinectbench.cli import console
from kinectbench.cli.build import exit_status, find_release, release_here
from kinectbench.cli.common import SOME_FAILED, Baselines, Common, takes
from kinectbench.cli.progress_bars import progress_bar
from kinectbench.cli.report import write_page
from kinectbench.core import SettingsError

if TYPE_CHECKING:
    from kinectbench.core.artefacts.scores import ScoreTable
    from kinectbench.release.release import Release


PROTOCOLS = "paper, known, occluded, measured, known-unsaid, shell, or of the camera frame camera, aligned"
CLOSE = "make open meshes in the camera frame solid: winding, or poisson (also points with normals)"
UPSAMPLING = "of other sides than 256: half-pixel, or corner-aligned (the paper's SciPy call)"
SHOWN_FAILURES = 20
ERROR_IF_MISSING = "error"
# Options that `--recheck` reads from the table, or whose files it does not write.
FROM_THE_TABLE = (
    *("method", "protocol", "save_thresholds", "missing", "upsampling", "surface"),
    *("close", "baselines", "gallery", "out"),
)


@takes("benchmark", "config", "overrides", "jobs", "cluster", "shard", "as_json")
def score_command(
    common: Common,
    context: typer.Context,
    predictions: Annotated[
        Path | None,
        typer.Argument(
            help="one method's folder, or a folder of methods; without it, the baselines are scored"
        ),
    ] = None,
    method: Annotated[str | None, typer.Option(help="name of the method; default: its folder's")] = None,
    protocol: Annotated[list[str] | None, typer.Option(help=f"{PROTOCOLS}; default: all but shell")] = None,
    thresholds: Annotated[Path | None, typer.Option(help="a threshold file")] = None,
    save_thresholds: Annotated[
        Path | None, typer.Option(help="freeze the thresholds found on validation in this file")
    ] = None,
    missing: Annotated[str, typer.Option(help="error, or empty: score an empty grid")] = ERROR_IF_MISSING,
    upsampling: Annotated[str, typer.Option(help=UPSAMPLING)] = "half-pixel",
    surface: Annotated[bool, typer.Option(help="Chamfer distance, F-score, surface Dice, normals")] = True,
    close: Annotated[str | None, typer.Option(help=CLOSE)] = None,
    baselines: Baselines = True,
    gallery: Annotated[bool, typer.Option(help="keep some predictions for the page, small")] = True,
    out: Annotated[Path | None, typer.Option(help="default: scores/ beside the benchmark")] = None,
    recheck: Annotated[
        Path | None,
        typer.Option(
            metavar="SCORES.JSON", help="score again, compare with this table, and mark it verified"
        ),
    ] = None,
) -> int:
    """Score predictions; thresholds come from the validation split or a file.

    Without a folder of predictions, all baselines are scored as methods; no prediction is written.
    """
    if recheck is not None:
        return _recheck(common, context, recheck, predictions, thresholds)
    known: dict[str, Any] = {"protocols": protocol, "thresholds_file": thresholds, "upsampling": upsampling}
    known["surface"] = surface
    of_one = {"method": method, "save_thresholds": save_thresholds, "missing": missing, "close": close}
    if common.part is not None:
        return _score_part(common, predictions, out, known | of_one)
    from kinectbench.report.run import write_galleries
    from kinectbench.scoring.request import Request, check_request

    if predictions is None:
        _refuse(common, of_one)
    if common.benchmark is None:  # before the benchmark is built
        options = {name: value for name, value in (known | of_one).items() if name != "method"}
        check_request(Request(**options, jobs=common.cluster or 1), predictions)
    release, rows = find_release(common)
    folder = out or common.beside("scores")
    tables = _tables(common, release, predictions, folder, known, of_one)
    if gallery and not (predictions is None and in_space(tables)):
        with progress_bar("gallery") as progress:
            write_galleries(release, predictions, tables, folder, upsampling, common.workers, progress)
    beside = baselines_of(release, folder, tables, upsampling, common.workers) if baselines else []
    page = write_page(common, release if common.benchmark else None, folder, baselines=baselines)
    tell_scores(common, tables, beside, page)
    return exit_status(rows) if all(table.complete for table in tables) else SOME_FAILED


def _score_part(
    common: Common, predictions: Path | None, out: Path | None, options: Mapping[str, Any]
) -> int:
    """Do the work of `score --shard`: count the pairs of one part, and print how to combine all parts."""
    from kinectbench.release.release import open_release
    from kinectbench.scoring.score import count_methods

    if predictions is None or common.benchmark is None or common.part is None:
        missing = "the folder of predictions" if predictions is None else "the release, by --benchmark"
        raise SettingsError(f"score --shard {common.shard}: name {missing}; a part does not make it")
    if options["save_thresholds"] is not None:
        raise SettingsError("score --shard: not with --save-thresholds, which needs all parts")
    if options["close"] is not None:
        raise SettingsError("score --shard: not with --close: predictions in the camera frame have no parts")
    folder = out or common.beside("scores")
    with common.executor() as executor, progress_bar("count") as progress:
        release, jobs = open_release(release_here(common.benchmark)), executor or common.workers
        failed = count_methods(
            release, predictions, folder, common.part, jobs=jobs, progress=progress, **options
        )
    message = f"part {common.part} is counted; when all are, the same command without --shard makes the table"
    common.tell({"shard": common.shard, "failed": failed}, [message])
    return SOME_FAILED if failed else 0


def in_space(tables: "Sequence[ScoreTable]") -> "list[ScoreTable]":
    """Return the tables of predictions in the camera frame."""
    from kinectbench.core.artefacts.score_figures import any_in_space

    return [table for table in tables if any_in_space(table.settings.protocols)]


def tell_scores(
    common: Common, tables: "Sequence[ScoreTable]", beside: "Sequence[ScoreTable]", page: Path
) -> None:
    """Print scores as tables, with the baselines `beside` and the path of the page, or as JSON.

    The JSON has each method's means over all categories, and no baselines.
    """
    from kinectbench.cli.score_tables import score_table, space_lines

    spatial = in_space(tables)
    of_voxels, cells = ([one for one in of if one not in in_space(of)] for of in (tables, beside))
    if common.as_json:
        console.say_json([{"method": t.method, "overall": t.json_value()["overall"]} for t in tables])
    else:
        if of_voxels:
            console.out.print(score_table([*of_voxels, *cells], published=True))
        if spatial:
            console.out.print(space_lines([*spatial, *in_space(beside)]))
        console.say(f"page: {page.resolve()}")


def _recheck(
    common: Common, context: typer.Context, scores: Path, predictions: Path | None, thresholds: Path | None
) -> int:
    """Do the work of `score --recheck`: score again with the settings in `scores`, and print differences.

    Other options that change scores are refused; only `--thresholds` may be given.
    """
    from kinectbench.scoring.compare import find_scores
    from kinectbench.scoring.read_table import read_table
    from kinectbench.scoring.recheck import recheck

    given = [
        ("--no-" if context.params[name] is False else "--") + name.replace("_", "-")
        for name in FROM_THE_TABLE
        if (source := context.get_parameter_source(name)) and source.name == "COMMANDLINE"
    ]
    if given:
        raise SettingsError(f"{', '.join(given)}: not with --recheck, which takes it from the table")
    if elsewhere := [f"--{name}" for name in ("shard", "cluster") if getattr(common, name) is not None]:
        raise SettingsError(f"{', '.join(elsewhere)}: not with --recheck, which counts all pairs here")
    if predictions is None:
        raise SettingsError(f"--recheck {scores}: name the folder of the predictions, too")
    paths = find_scores([scores])
    if len(paths) != 1:
        raise SettingsError(f"--recheck {scores}: holds {len(paths)} tables; name one")
    read_table(paths[0])  # before the benchmark is built
    release, rows = find_release(common)
    with progress_bar("recheck") as progress:
        differences = recheck(
            release, paths[0], predictions, thresholds_file=thresholds, jobs=common.workers, progress=progress
        )
    table = read_table(paths[0])
    shown = differences[:SHOWN_FAILURES]
    more = [f"and {len(differences) - len(shown)} more differences"] * (len(differences) > len(shown))
    # A table that differs keeps its mark, if any: the file is not written.
    standing = "not verified" if differences else table.standing
    common.tell({"standing": standing, "differences": differences}, [f"{paths[0]}: {standing}"])
    console.lines("error", [*shown, *more], "red")
    return SOME_FAILED if differences else exit_status(rows)


def _tables(
    common: Common,
    release: "Release",
    predictions: Path | None,
    folder: Path,
    known: Mapping[str, Any],
    of_one: Mapping[str, Any],
) -> "list[ScoreTable]":
    """Score the predictions, or the baselines if there are none; print problems, and return the score tables.

    `known` are options for predictions and baselines, `of_one` options only for predictions. Scores are
    written to `folder`.
    """
    from kinectbench.scoring.baselines.in_grids import score_baselines
    from kinectbench.scoring.predictions import lines_without, misplaced, split_methods
    from kinectbench.scoring.score import score_methods

    with common.executor() as executor, progress_bar("score") as progress:
        if predictions is None:
            tables = score_baselines(release, folder, jobs=common.workers, progress=progress, **known)
        else:
            options: dict[str, Any] = {"jobs": executor or common.workers, **known, **of_one}
            tables = score_methods(release, predictions, folder, progress=progress, **options)
    if predictions is not None:
        methods = split_methods(predictions, release.targets)
        console.lines("warning", lines_without(predictions, methods, release.targets), "yellow")
        for name, method in methods.items():
            if line := misplaced(release, method):
                console.lines(f"{name}: warning", [line], "yellow")
    tell_problems(tables)
    return tables


def _refuse(common: Common, of_one: Mapping[str, Any]) -> None:
    """Raise an error if an option that needs predictions is given: `--cluster`, or one of `of_one`.

    It is called only if no predictions are named.
    """
    options = {**of_one, "cluster": common.cluster}
    given = [
        f"--{name.replace('_', '-')}"
        for name, value in options.items()
        if value not in (None, ERROR_IF_MISSING)
    ]
    if given:
        verb = "applies" if len(given) == 1 else "apply"
        raise SettingsError(
            f"score: {', '.join(given)} {verb} to predictions, and no folder of them is named: "
            "`kinectbench score PREDICTIONS ...`; without one, only baselines are scored"
        )


def baselines_of(
    release: "Release", folder: Path, tables: "Sequence[ScoreTable]", upsampling: str, jobs: int
) -> "list[ScoreTable]":
    """Score those baselines that are not among the methods, to show them beside the methods.

    For predictions in the camera frame, baselines are scored as solids in that frame. No baseline is scored
    if the scale of all these predictions is unknown, or if the first table has more than `ROWS_IN_JSON` rows.
    """
    from kinectbench.core.artefacts.score_columns import ROWS_IN_JSON
    from kinectbench.report.space_table import is_baseline
    from kinectbench.scoring.baselines.in_grids import comparison_baselines

    spatial = in_space(tables)
    if spatial and not any("camera" in table.settings.protocols for table in spatial):
        return []
    if len(tables[0].rows) > ROWS_IN_JSON:  # scoring all at once would take gigabytes
        line = (
            f"none beside more than {ROWS_IN_JSON} rows; `kinectbench baseline NAME` writes one to be scored"
        )
        console.lines("baselines: note", [line], "cyan")
        return []
    protocols, names = (spatial or tables)[0].settings.protocols, [t.method for t in tables if is_baseline(t)]
    with progress_bar("baselines") as progress:
        return comparison_baselines(
            release,
            folder,
            protocols=protocols,
            upsampling=upsampling,
            without=names,
            jobs=jobs,
            progress=progress,
        )


def tell_problems(tables: "Sequence[ScoreTable]") -> None:
    """Print each method's warnings and failures, one line for each mistake; at most 20 lines of failures."""
    from kinectbench.scoring.predictions import NO_PREDICTION

    for table in tables:
        console.lines(f"{table.method}: warning", console.by_mistake(table.warnings), "yellow")
        reasons = console.by_mistake(failure.reason for failure in table.failures)
        if len(reasons) > SHOWN_FAILURES:
            more = f"and {len(reasons) - SHOWN_FAILURES} more; `kinectbench check --json` lists up to 1,000"
            reasons = [*reasons[:SHOWN_FAILURES], more]
        console.lines(f"{table.method}: error", reasons, "red")
        missing = sum(NO_PREDICTION in failure.reason for failure in table.failures)
        if missing and table.rows:
            line = f"{missing} predictions are missing: add them, or score empty grids there: --missing empty"
            console.lines(f"{table.method}: note", [line], "cyan")


@takes("as_json")
def compare_command(
    common: Common,
    scores: Annotated[list[Path], typer.Argument(help="scores.json files, or folders that hold them")],
    metric: Annotated[str, typer.Option(help="such as iou, ce, f1, chamfer_mm, surface_dice")] = "iou",
    protocol: Annotated[
        str, typer.Option(help=f"{PROTOCOLS}; also camera-occluded, aligned-t+s-visible, …")
    ] = "known",
) -> int:
    """Say which methods are better: paired tests over objects, ranks, or that the test set is too small."""
    from kinectbench.cli.score_tables import comparison_tables
    from kinectbench.scoring.compare import compare as compare_tables
    from kinectbench.scoring.compare import find_methods, method_names
    from kinectbench.scoring.read_table import read_table

    tables = [read_table(path) for path in find_methods(scores)]
    comparison = compare_tables(tables, metric, protocol)
    if common.as_json:
        console.say_json(asdict(comparison))
    else:
        names = zip(method_names(tables), tables, strict=True)
        for table in comparison_tables(comparison, {name for name, one in names if one.baseline}):
            console.out.print(table)
        console.lines("note", comparison.notes, "yellow")
    return SOME_FAILED if comparison.left_out else 0
