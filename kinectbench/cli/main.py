"""The entry point of the command line: all commands in one typer app, and the handling of their errors."""

import gc as garbage
import io
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import wraps
from itertools import pairwise
from typing import Annotated, Any, NoReturn, cast

import typer

from kinectbench._version import __version__
from kinectbench.cli import console
from kinectbench.cli.build import STAGE_COMMANDS, build_command
from kinectbench.cli.common import Command, on_interrupt
from kinectbench.cli.exchange import (
    adapt_command,
    baseline_command,
    check_command,
    export_command,
    import_command,
)
from kinectbench.cli.fetch import fetch_command, gc_command, verify_command
from kinectbench.cli.known_truth import (
    compare_truth_command,
    evaluate_command,
    simulate_command,
    synthesize_command,
)
from kinectbench.cli.methods import convert_command, predict_command, reproduce_command, train_command
from kinectbench.cli.publish import publish_command
from kinectbench.cli.record import record_command
from kinectbench.cli.recordings import formats_command, init_command, inspect_command
from kinectbench.cli.report import report_command, triage_command
from kinectbench.cli.score import compare_command, score_command
from kinectbench.cli.segment import segment_command
from kinectbench.cli.track import track_command
from kinectbench.core import (
    KinectBenchError,
    SettingsError,
    internal_error,
    missing_module,
    printable,
    remove_half_filled,
    require_extra,
)
from kinectbench.core.store.address import unusable
from kinectbench.engine.interrupts import (
    check_interrupt,
    ignore_interrupts,
    interrupted_status,
    interrupts_remembered,
)

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Turn RGB-D recordings of real objects into a benchmark for single-view shape completion, and score "
    "predictions against it.",
)

# Typer's exit status after KeyboardInterrupt.
INTERRUPTED = 130
STDERR = 2

# The commands as `kinectbench --help` shows them, in the order of their use.
PANELS: Mapping[str, Mapping[str, Command]] = {
    "Record": {"record": record_command},
    "Make a benchmark": {
        "init": init_command,
        "inspect": inspect_command,
        "build": build_command,
        "ingest": STAGE_COMMANDS["ingest"],
        "track": track_command,
        "fuse": STAGE_COMMANDS["fuse"],
        "segment": segment_command,
        "sample-views": STAGE_COMMANDS["sample-views"],
        "pairs": STAGE_COMMANDS["pairs"],
        "formats": formats_command,
        "gc": gc_command,
    },
    "Look at what was made": {"report": report_command, "triage": triage_command},
    "Publish it": {
        "publish": publish_command,
        "verify": verify_command,
        "fetch": fetch_command,
        "export": export_command,
        "import": import_command,
    },
    "Score predictions": {
        "baseline": baseline_command,
        "adapt": adapt_command,
        "check": check_command,
        "score": score_command,
        "compare": compare_command,
    },
    "Train and run networks": {
        "train": train_command,
        "predict": predict_command,
        "convert": convert_command,
        "reproduce": reproduce_command,
    },
    "Work with known truth": {
        "simulate": simulate_command,
        "synthesize": synthesize_command,
        "evaluate": evaluate_command,
        "compare-truth": compare_truth_command,
    },
}


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


# Commands on recordings need an extra; the other commands report a missing package where they need it.
ON_RECORDINGS = (
    *("record", "build", "inspect", *STAGE_COMMANDS, "track", "segment", "triage", "publish"),
    "compare-truth",
)


def _with_build(command: Command) -> Command:
    """Wrap a command so that it ends with a one-line error if the extra `build` is not installed."""

    @wraps(command)
    def checked(*args: object, **options: object) -> None:
        require_extra("build")
        return command(*args, **options)

    return checked


for _panel, _commands in PANELS.items():
    for _name, _command in _commands.items():
        _checked = _with_build(_command) if _name in ON_RECORDINGS else _command
        app.command(_name, rich_help_panel=_panel)(_checked)

# UsageError, wherever typer imports it from.
USAGE_ERRORS = cast(tuple[type[Exception], ...], typer.BadParameter.__bases__)


def main() -> None:
    """Run the command line and exit; every error is reported as a short message and an exit status."""
    _show_what_can_be_shown()
    with interrupts_remembered(_end_unanswered):
        with _own_words_only():
            status, messages = _run()
        if messages:
            console.lines("error", messages, "red")
        if status == INTERRUPTED:
            # Inside the block: after it, another SIGTERM would end the process with its own status.
            _exit_interrupted()
    sys.exit(status)


def _exit_interrupted() -> NoReturn:
    """Exit at once, without Python's shutdown, as interrupted libraries may change the exit status in it."""
    garbage.collect()
    if "kinectbench.engine.processes" in sys.modules:
        from kinectbench.engine.processes import give_back_shared

        give_back_shared()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(interrupted_status())


def _show_what_can_be_shown() -> None:
    """Make Python print `?` instead of raising an error for characters that the terminal cannot encode."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


@contextmanager
def _own_words_only() -> Iterator[None]:
    """Silence native libraries on standard error during a `with` block; Python can still write to it.

    libjpeg, libpng and FFmpeg would print a line about every damaged image, in addition to our own message.
    Worker processes are silenced, too.
    """
    try:
        ours = sys.stderr.fileno() == STDERR
    except (AttributeError, OSError):  # closed, or replaced, by a test for example
        ours = False
    if not ours:
        yield
        return
    plain, sys.stderr = (
        sys.stderr,
        os.fdopen(os.dup(STDERR), "w", buffering=1, encoding=sys.stderr.encoding, errors=sys.stderr.errors),
    )
    kept = os.dup(STDERR)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, STDERR)
    os.close(nowhere)
    try:
        yield
    finally:
        sys.stderr.close()
        os.dup2(kept, STDERR)
        os.close(kept)
        sys.stderr = plain


def _run() -> tuple[int, tuple[str, ...]]:
    """Run the command; return exit status and error lines. A failure after Ctrl-C counts as an interrupt."""
    try:
        status, messages = _call()
        if status:
            check_interrupt()
    except KeyboardInterrupt:
        status = INTERRUPTED
    if status == INTERRUPTED:
        ignore_interrupts()  # a second one would interrupt the clean-up
        messages = (on_interrupt.words,)
    return status, messages


def _end_unanswered(number: int) -> None:
    """End the process on a signal that comes while a library computes, since Python cannot interrupt that.

    It is called on another thread; `number` is the signal's.
    """
    remove_half_filled()
    sys.stderr.write(f"error: {on_interrupt.words}\n")  # the console's lock may be held
    sys.stderr.flush()
    os._exit(128 + number)


def _call() -> tuple[int, tuple[str, ...]]:
    """Run the command; return its exit status and error lines, if any."""
    try:
        _refuse_unusable_urls(sys.argv[1:])
        return app(standalone_mode=False) or 0, ()
    except USAGE_ERRORS as error:
        return 2, _usage(error)
    except KinectBenchError as error:
        code = f" ({error.code})" if os.environ.get("KINECTBENCH_DEBUG") else ""
        return error.exit_status, (*error.lines[:-1], *(f"{line}{code}" for line in error.lines[-1:]))
    except Exception as error:
        check_interrupt()
        if os.environ.get("KINECTBENCH_DEBUG"):
            raise
        if isinstance(error, ModuleNotFoundError) and (missing := missing_module(error)):
            return 2, (missing,)
        return 1, (internal_error(error),)


def _refuse_unusable_urls(arguments: Sequence[str]) -> None:
    """Raise an error if an argument is an unusable URL; later, typer would have turned it into a path."""
    for before, argument in pairwise(("", *arguments)):
        if before == "--cluster" or argument.startswith("--cluster="):  # tcp://, tls://: the engine checks it
            continue
        # The argument may be `--config=URL`, `-cURL`, or the URL itself.
        written = re.sub(r"--[a-z-]+=|-[a-z]=?", "", argument, count=1) if argument[:1] == "-" else argument
        # `publish --to hf://user/name` is checked by the command.
        to_hub = written.startswith("hf://") and "--to" in (before, argument.partition("=")[0])
        if not to_hub and (said := unusable(written)):
            raise SettingsError(printable(said, 300), what="bad-url")


def _usage(error: Any) -> tuple[str, ...]:
    """Return one line about a usage error; nothing if no command was given, as the help is shown then."""
    if type(error).__name__ == "NoArgsIsHelpError":
        return ()
    command = error.ctx.command_path if error.ctx else "kinectbench"
    return (f"{_wrong_value(error) or error.format_message().rstrip('.')}; see `{command} --help`",)


def _wrong_value(error: Any) -> str:
    """Return what was found and wanted, if the value of an option or argument is wrong; else ""."""
    found, parameter = getattr(error.__cause__, "errors", None), getattr(error, "param", None)
    if found is None or parameter is None:
        return ""
    first = found()[0]
    wanted = first["msg"].removeprefix("Input should be ").partition(", unable to parse")[0]
    wanted = f"a value {wanted}" if wanted.startswith(("greater", "less")) else wanted
    return f"{parameter.opts[0]} {printable(str(first['input']))}: wanted {wanted}"
