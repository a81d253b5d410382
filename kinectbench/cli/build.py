"""The command `kinectbench build`, and builds that other commands start."""

import shlex
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinectbench.cli import console
from kinectbench.cli.build_warnings import tell_unknown_categories, tell_warnings, unused_inputs
from kinectbench.cli.common import CANNOT_BE_USED, SOME_FAILED, Command, Common, Ids, takes
from kinectbench.cli.progress_bars import progress_bar, recording_bars
from kinectbench.core import SettingsError, listed, printable, require_extra
from kinectbench.core.store.address import url_of

if TYPE_CHECKING:
    from kinectbench.engine.executor import Executor
    from kinectbench.engine.pipeline import Outcome
    from kinectbench.engine.stages import Job
    from kinectbench.engine.status import RecordingStatus
    from kinectbench.engine.summary import BuiltRecording, RecordingSummary
    from kinectbench.release.release import Release

# Largest number of rows in the table of `build` and of `build --status`; nobody reads more.
SHOWN_RECORDINGS = 100
STILL_FAILS = (
    "left out: it failed before, and nothing it depends on has changed since; `kinectbench build {id}` says "
    "why, and `kinectbench build {id} --force` tries again"
)


# {what is built: its command}, where the command has another name.
COMMANDS = {"pairs": ("build",), "suggest": ("segment", "--suggest")}
OPTIONS = (
    *("config", "overrides", "jobs", "cluster", "shard", "time_limit", "force", "wait", "verbose", "as_json"),
)


@takes(*OPTIONS, at_url=True)
def build_command(
    common: Common,
    ids: Ids = None,
    status: Annotated[
        bool, typer.Option("--status", help="build nothing: list what failed and what is missing")
    ] = False,
) -> int:
    """Run every stage up to the pairs; skip current ones."""
    return tell_status(common, ids) if status else run_stage(common, "build", ids)


def _command(name: str, text: str) -> Command:
    def stage(common: Common, ids: Ids = None) -> int:
        return run_stage(common, name, ids)

    stage.__doc__ = text
    return takes(*OPTIONS, at_url=True)(stage)


STAGE_COMMANDS: Mapping[str, Command] = {
    name: _command(name, text)
    for name, text in {
        "ingest": "Read recordings of any known format.",
        "fuse": "Fuse the good frames into one surface.",
        "sample-views": "Draw the views, with the object's mask in each.",
        "pairs": "Write a pair for each view: partial and full shape.",
    }.items()
}


def run_stage(common: Common, name: str, ids: list[str] | None, executor: "Executor | None" = None) -> int:
    """Build recordings up to a stage (`build`: all stages) and print the outcome; return the exit status.

    If `executor` is given, it runs the builds; otherwise they run as the options say.
    """
    from kinectbench.engine.pipeline import STAGE_NAMES

    upto, stages = ("pairs", STAGE_NAMES) if name == "build" else (name, (name,))
    if name == "build":
        tell_unknown_categories(chosen_jobs(common, ids))
    chosen, force = shard_jobs(common, ids), stages if common.force else ()
    with nullcontext(executor) if executor else common.executor() as executor:
        rows = build_jobs(
            chosen,
            upto,
            common,
            force,
            executor=executor,
            # With --json, or for more recordings, the warnings of current artefacts are not repeated.
            again=name == "build" and not common.as_json and len(chosen) <= SHOWN_RECORDINGS,
        )
    release = common if name == "build" else None
    if common.as_json:
        common.tell([row.json_value() for row in _judged([row.summary for row in rows], release)], ())
    elif rows:
        show_rows(rows, upto, release)
    return exit_status(rows)


def _judged(rows: "list[RecordingSummary]", common: Common | None) -> "list[RecordingSummary]":
    """Return summaries that also say why `publish` would leave out recordings of a benchmark here."""
    if common is None or url_of(common.place) is not None:
        return rows
    from kinectbench.release.publish.gate import would_be_left_out

    pairs = {row.recording: row.pairs or 0 for row in rows if row.error is None}
    why = would_be_left_out(common.settings, common.root / "build", pairs)
    found = ({"left_out_of_release": why[row.recording]} if row.recording in why else {} for row in rows)
    return [row.model_copy(update=update) for row, update in zip(rows, found, strict=True)]


def shard_jobs(common: Common, ids: list[str] | None) -> "list[Job]":
    """Return jobs for the requested recordings in the part `--shard`; print a note if there are none."""
    chosen, part = chosen_jobs(common, ids), common.part
    if part is None:
        return chosen
    mine = [job for job in chosen if part.holds(job.recording.id)]
    if not mine:
        console.lines("note", [f"no recording belongs to part {part}: nothing to do"], "yellow")
    return mine


def tell_status(common: Common, ids: list[str] | None) -> int:
    """Print which recordings are built, failed or missing; return 3 unless all are built."""
    from kinectbench.engine.status import in_words, statuses

    rows = statuses(shard_jobs(common, ids))
    left = [row for row in rows if row.state != "done"]
    if common.as_json:
        console.say_json([row.json_value() for row in rows])
    else:
        if left:
            columns = {"recording": "recording", "state": "status", "next": "next stage", "error": "why"}
            shown = [_in_words(row) for row in left[:SHOWN_RECORDINGS]]
            console.out.print(console.text_table(shown, columns, {}))
        if len(left) > SHOWN_RECORDINGS:
            console.say(f"and {len(left) - SHOWN_RECORDINGS} more; --json lists all")
        console.say(in_words(rows))
        if left:
            built = "nothing is built yet" if not any(row.current for row in rows) else "not all is built"
            line = f"{built}, so the exit status is {SOME_FAILED}; `kinectbench build` builds what is left"
            console.lines("note", [line], "cyan")
    return SOME_FAILED if left else 0


def _in_words(row: "RecordingStatus") -> dict[str, object]:
    """Return a row of the table of `build --status`."""
    state = row.state_in_words
    other = {} if state == row.state else {"state": state, "error": f"{row.differs} is changed"}
    return {**row.json_value(), **other}


def show_rows(rows: "list[BuiltRecording]", upto: str, release: Common | None = None) -> None:
    """Print a table of results up to a stage, for at most 100 recordings, and details of their objects."""
    from kinectbench.engine.pipeline import STAGE_NAMES

    stages = STAGE_NAMES[: STAGE_NAMES.index(upto) + 1]
    first = rows
    if len(rows) > SHOWN_RECORDINGS:  # drawing all takes longer than the check of whether they are current
        first = sorted(rows, key=lambda row: 0 if row.error else 1 if row.made else 2)[:SHOWN_RECORDINGS]
    shown = _judged([row.summary for row in first], release)
    console.out.print(console.summary_table(shown, stages))
    if "segment" in stages:
        # `build` has already printed what to record again (`do this first`).
        console.object_lines(shown, frontiers=upto == "segment")
    if more := len(rows) - len(shown):
        current = sum(row.error is None and not row.made for row in rows)
        console.say(f"and {more} more; {current} of all {len(rows)} were up to date; --json lists all")


def chosen_jobs(common: Common, ids: list[str] | None) -> "list[Job]":
    """Return jobs for the requested recordings; an unknown id is an error that suggests a similar one."""
    from kinectbench.engine.stages import Job

    settings = common.settings
    known = {recording.id: recording for recording in settings.recordings}
    for name in ids or []:
        if name not in known:
            near = get_close_matches(name, known, 1)
            hint = f"did you mean '{near[0]}'?" if near else f"there are {listed(known)}"
            raise SettingsError(f"{common.config}: no recording '{name}'; {hint}", what="no-recording")
    wanted = set(ids) if ids else known.keys()
    return [Job(settings, r, common.place) for r in settings.recordings if r.id in wanted]


def build_recordings(
    common: Common,
    ids: list[str] | None,
    upto: str,
    force: Sequence[str] = (),
    *,
    brief: bool = False,
    warn: bool = True,
) -> "list[BuiltRecording]":
    """Build recordings up to a stage, print warnings and errors, and return each recording's result.

    The `error` of a result is None on success. A build that failed before is not tried again while nothing
    has changed; with `brief`, its error is printed without the reason. Without `warn`, warnings of stages are
    not printed: the caller prints them.
    """
    require_extra("build")
    chosen = chosen_jobs(common, ids)
    if brief:
        _tell_changed_settings(chosen, upto)
    return build_jobs(chosen, upto, common, force, brief=brief, warn=warn)


def _tell_changed_settings(chosen: "Sequence[Job]", upto: str) -> None:
    """Print a note if recordings will be built again because settings have changed, such as by `--set`."""
    from kinectbench.engine.pipeline import changed_settings

    found: dict[str, list[str]] = {}
    for job in chosen:
        if changed := changed_settings(job, upto):
            changes = [f"{key} was {then}, now {now}" for key, (then, now) in changed.items()]
            found.setdefault(printable("; ".join(changes), 200), []).append(job.recording.id)
    lines = [
        f"{listed(names)}: built with other settings ({changes}); made again by benchmark.yaml and --set"
        for changes, names in found.items()
    ]
    console.lines("note", lines, "cyan")


def build_jobs(
    chosen: "Sequence[Job]",
    upto: str,
    common: Common,
    force: Sequence[str] = (),
    *,
    brief: bool = False,
    executor: "Executor | None" = None,
    again: bool = False,
    warn: bool = True,
) -> "list[BuiltRecording]":
    """Build jobs with the shared options, in processes or an executor; return what `build_recordings` does.

    With `again`, warnings of stages that were current are printed, too; without `warn`, no stage's are. The
    printed advice includes a command that shows all warnings, with the same settings.
    """
    from kinectbench.engine.parallel import build as build_all
    from kinectbench.engine.summary import BuiltRecording

    slots = executor.slots if executor else lambda: min(common.workers, len(chosen))
    with recording_bars(len(chosen), slots) as watcher:
        outcomes = build_all(
            chosen,
            upto,
            force,
            common.workers,
            watcher,
            wait_for_others=common.wait,
            limit_s=common.time_limit,
            executor=executor,
        )
    rows, failed = list[BuiltRecording](), 0
    for job, outcome in zip(chosen, outcomes, strict=True):
        # Warn even if all is current: somebody who has just drawn a mask expects it to be used.
        unused = unused_inputs(job, upto)
        name = job.recording.id
        read = partial(_summary, job, outcome, unused)
        row = BuiltRecording(name, outcome.error, outcome.made, read, outcome.code)
        rows.append(row)
        failed += row.error is not None
        if row.error is not None and failed > console.MOST_LINES:
            continue
        stated = warn and (row.made or common.verbose or again)
        own = row.summary.warnings if stated else (*outcome.warnings, *unused)
        first = row.summary.first if len(own) > 1 and not common.verbose else None
        command = shlex.join([*COMMANDS.get(upto, (upto,)), name, *common.options, "-v"])
        tell_warnings(name, own, first, command)
        code = f" ({outcome.code})" if common.verbose and outcome.code else ""
        reason = STILL_FAILS.format(id=name) if brief and outcome.repeated else row.error
        console.recording_lines(name, "error", [f"{reason}{code}"] if reason else [], "red")
    if (more := failed - console.MOST_LINES) > 0:
        text = f"{more} more recordings failed: `kinectbench build --status --json` lists all"
        console.lines("error", [text], "red")
    return rows


def _summary(job: "Job", outcome: "Outcome", unused: tuple[str, ...]) -> "RecordingSummary":
    """Return a recording's summary, with warnings about input that has no effect (`unused`) added."""
    from kinectbench.engine.summary import summary

    figures = summary(job, outcome)
    return figures.model_copy(update={"warnings": (*figures.warnings, *unused)})


def built(rows: "list[BuiltRecording]") -> list[str]:
    """Return the ids of the successful recordings."""
    return [row.recording for row in rows if row.error is None]


def exit_status(rows: "list[BuiltRecording]") -> int:
    """Return 1 if all recordings failed, 3 if some failed, else 0; print the ids of those that failed."""
    failed = len(rows) - len(built(rows))
    if not failed:
        return 0
    console.failures(rows)
    return CANNOT_BE_USED if failed == len(rows) else SOME_FAILED


def need_some(rows: "list[BuiltRecording]") -> list[str]:
    """Return the ids of the successful recordings; end the command if there are none."""
    if not built(rows):
        raise typer.Exit(exit_status(rows))
    return built(rows)


def find_release(common: Common) -> "tuple[Release, list[BuiltRecording]]":
    """Open the release of `--benchmark` or else the local one, which is built and published if missing.

    An existing release is never changed here: only `publish` replaces it.

    Returns:
        The release, and the results of `build_recordings`; these are empty if the release existed.
    """
    from kinectbench.core.artefacts.benchmark import BENCHMARK_JSON
    from kinectbench.engine.status import statuses
    from kinectbench.release.publish.publish_if_stale import (
        already_published,
        publish_if_stale,
        scoring_folder,
    )
    from kinectbench.release.release import open_release

    if common.benchmark is not None:
        return open_release(release_here(common.benchmark)), []
    settings, folder = common.settings, common.root / "benchmark"
    if (folder / BENCHMARK_JSON).is_file():
        release = open_release(scoring_folder(common.root))
        done = [row.recording for row in statuses(chosen_jobs(common, None)) if row.state == "done"]
        if already_published(settings, common.root, done, None) is None:
            _tell_used(release)
        return release, []
    rows = build_recordings(common, None, "pairs", brief=True)
    published = publish_if_stale(
        settings, common.root, need_some(rows), waiting=partial(console.waiting, "publish")
    )
    return open_release(published.scoring), rows


def _tell_used(release: "Release") -> None:
    """Print a note that the existing release is used, although settings or builds have changed since."""
    numbers = {"pair": len(release.targets), "recording": len(release.metadata.recordings)}
    counted = " of ".join(f"{number} {word}{'s' * (number != 1)}" for word, number in numbers.items())
    line = (
        f"{release.folder}: used as it was published, {counted}; settings or what is built differ from it: "
        "`kinectbench publish` publishes it again"
    )
    console.lines("note", [line], "cyan")


def release_here(benchmark: Path) -> Path:
    """Return a release's local path; a release given by its URL is downloaded into the cache first."""
    url = url_of(benchmark)
    if url is None:
        return benchmark
    from kinectbench.release.fetch import cached_release

    with progress_bar("fetch") as progress:
        return cached_release(url, progress)
