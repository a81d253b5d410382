"""The command line: parse, call, show. Every algorithm lives in the rooms below."""

import gc
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, cast

import typer

from kinectbench import __version__
from kinectbench.commands import (
    DEFAULT_CONFIG,
    SOME_FAILED,
    Baselines,
    BenchmarkDir,
    Config,
    Force,
    Ids,
    Jobs,
    Json,
    Predictions,
    Set,
    Wait,
    build_recordings,
    exit_for,
    find_release,
    open_benchmark,
    release_page,
    run_stage,
    tell_problems,
    tell_written,
    workers,
    write_page,
)
from kinectbench.commands_compare import compare
from kinectbench.commands_exchange import export, import_
from kinectbench.commands_formats import formats
from kinectbench.commands_inspect import inspect
from kinectbench.commands_publish import publish
from kinectbench.commands_score import score
from kinectbench.commands_segment import segment
from kinectbench.commands_track import track
from kinectbench.commands_truth import evaluate, simulate, synthesize
from kinectbench.commands_verify import verify
from kinectbench.errors import KinectBenchError, SettingsError, internal_error
from kinectbench.interrupts import (
    check_interrupt,
    ignore_interrupts,
    interrupted_status,
    interrupts_remembered,
)

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Turn RGB-D recordings of real objects into a benchmark for single-view shape completion, and score "
    "predictions against it.",
)

# What typer makes of KeyboardInterrupt.
INTERRUPTED = 130

STAGES = {
    "build": "Run every stage up to the pairs; what is current is not made again.",
    "ingest": "Read recordings of any known format.",
    "track": "Give every frame a camera pose, and leave out frames that disagree with it.",
    "fuse": "Fuse the good frames into one surface.",
    "segment": "Find floor and object, and make the object solid.",
    "sample-views": "Draw the views, with the object's mask in each.",
    "pairs": "Write a pair for each view: partial and full shape.",
}
# Stages with options of their own.
OWN_COMMANDS: Mapping[str, Callable[..., None]] = {"track": track, "segment": segment}


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"kinectbench {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="print the version")
    ] = False,
) -> None:
    pass


def _add_stage(name: str, text: str) -> None:
    @app.command(name, help=text)
    def stage(
        ids: Ids = None,
        config: Config = DEFAULT_CONFIG,
        overrides: Set = None,
        jobs: Jobs = None,
        force: Force = False,
        wait: Wait = True,
        as_json: Json = False,
    ) -> None:
        """Run one stage, after bringing up to date what it stands on."""
        run_stage(name, ids, config, overrides, jobs, force, as_json, wait)


for _name, _text in STAGES.items():
    if _name in OWN_COMMANDS:
        app.command(_name, help=_text)(OWN_COMMANDS[_name])
    else:
        _add_stage(_name, _text)


@app.command()
def check(
    predictions: Predictions,
    benchmark: BenchmarkDir = None,
    config: Config = DEFAULT_CONFIG,
    overrides: Set = None,
    jobs: Jobs = None,
    as_json: Json = False,
) -> None:
    """Say everything that is wrong with a folder of predictions, without scoring."""
    from kinectbench import console
    from kinectbench.scoring.check import check as find_problems
    from kinectbench.scoring.predictions import split_methods

    release, rows = find_release(benchmark, config, overrides, jobs)
    methods = split_methods(predictions, release.targets)
    problems = []
    for name, folder in methods.items():
        with console.bar(f"check {name}") as progress:
            found = find_problems(release, folder, progress)
        problems += [f"{name}: {line}" if len(methods) > 1 else line for line in found]
    tell_problems(problems, as_json, f"{predictions}: all well", SOME_FAILED)
    exit_for(rows)


@app.command()
def baseline(
    names: Annotated[list[str] | None, typer.Argument(metavar="[NAME]...", help="default: all")] = None,
    out: Annotated[
        Path | None, typer.Option(help="folder of methods; default: predictions/ beside the benchmark")
    ] = None,
    benchmark: BenchmarkDir = None,
    config: Config = DEFAULT_CONFIG,
    overrides: Set = None,
    jobs: Jobs = None,
    as_json: Json = False,
) -> None:
    """Write predictions of simple methods: empty, base-rate, partial, hull, mirror, silhouette.

    Where there are training pairs of every category, mean-shape and nearest too.
    """
    from kinectbench import console
    from kinectbench.baselines.write import check_names, write_baselines

    check_names(names or ())
    release, rows = find_release(benchmark, config, overrides, jobs)
    folder = out or (Path("predictions") if benchmark else config.parent / "predictions")
    with console.bar("baseline") as progress:
        written = write_baselines(release, folder, names, workers(jobs), progress)
    tell_written([folder / name for name in written], as_json)
    exit_for(rows)


app.command()(score)


@app.command()
def report(
    ids: Ids = None,
    config: Config = DEFAULT_CONFIG,
    overrides: Set = None,
    scores: Annotated[
        list[Path] | None,
        typer.Option(help="scores.json, or a folder of them; repeat to merge; default: scores/"),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="default: index.html in the folder of scores")] = None,
    benchmark: BenchmarkDir = None,
    baselines: Baselines = True,
    jobs: Jobs = None,
    as_json: Json = False,
) -> None:
    """Write the benchmark's page, scores/index.html: recordings, pairs, scores. It opens from disk."""
    if benchmark is not None:
        from kinectbench.release.release import open_release

        page = release_page(open_release(benchmark), scores or Path("scores"), out, baselines)
        tell_written([page.resolve()], as_json)
        return
    settings, root = open_benchmark(config, overrides)
    rows = build_recordings(settings, root, ids, "pairs", jobs)
    page = write_page(config, overrides, scores or config.parent / "scores", out, baselines)
    tell_written([page.resolve()], as_json)
    exit_for(rows)


@app.command()
def init(
    folder: Annotated[Path, typer.Argument(help="recordings are looked for here and below")],
    force: Annotated[bool, typer.Option("--force", help="replace a benchmark.yaml that is there")] = False,
    as_json: Json = False,
) -> None:
    """Write a commented benchmark.yaml for the recordings found in a folder."""
    from kinectbench.benchmark_file import init_benchmark
    from kinectbench.ingest.registry import find_recordings
    from kinectbench.workspace import replaced_file

    target = folder / "benchmark.yaml"
    if not folder.is_dir():
        raise SettingsError(f"{folder}: no such folder; give the folder that holds the recordings")
    if target.exists() and not force:
        raise SettingsError(f"{target}: is there already; edit it, or use --force to replace it")
    found = [(path.relative_to(folder).as_posix(), name) for path, name in find_recordings(folder)]
    text = init_benchmark(folder, found)
    with replaced_file(target) as temporary:
        temporary.write_text(text)
    tell_written([target], as_json)
    if not as_json:
        count = f"{len(found)} recording{'s' * (len(found) != 1)}"
        typer.echo(f"{count}: fill in categories, license and source, then run `kinectbench build`")


for _command in (compare, simulate, synthesize, evaluate, export, formats, inspect, publish, verify):
    app.command()(_command)
app.command("import")(import_)

# UsageError, wherever typer has it from.
USAGE_ERRORS = cast(tuple[type[Exception], ...], typer.BadParameter.__bases__)


def main() -> None:
    """Run the command line; every error becomes one line and an exit status."""
    with interrupts_remembered():
        status, message = _run()
    if status == INTERRUPTED:
        ignore_interrupts()  # a second one would interrupt the end
    if message:
        from kinectbench import console

        console.lines("error", [message], "red")
    if status == INTERRUPTED:
        # Libraries that were interrupted while they were imported complain at the end of Python, or end it
        # with a status of their own.
        gc.collect()
        if "kinectbench.processes" in sys.modules:
            from kinectbench.processes import give_back_shared

            give_back_shared()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(interrupted_status())
    sys.exit(status)


def _run() -> tuple[int, str]:
    """Exit status and error line, if any."""
    try:
        try:
            status = app(standalone_mode=False) or 0
            if status == INTERRUPTED:
                raise KeyboardInterrupt
            if status:
                check_interrupt()
            return status, ""
        except Exception:
            check_interrupt()
            raise
    except KeyboardInterrupt:
        return INTERRUPTED, "stopped; run the same command again to go on from here"
    except USAGE_ERRORS as error:
        return 2, _usage(error)
    except KinectBenchError as error:
        return error.exit_status, str(error)
    except Exception as error:
        if os.environ.get("KINECTBENCH_DEBUG"):
            raise
        return 1, internal_error(error)


def _usage(error: Any) -> str:
    """One line about wrong usage; nothing but the help where no command was given."""
    if type(error).__name__ == "NoArgsIsHelpError":
        return ""
    command = error.ctx.command_path if error.ctx else "kinectbench"
    return f"{error.format_message().rstrip('.')}; see `{command} --help`"


if __name__ == "__main__":
    main()
