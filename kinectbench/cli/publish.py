"""The command `publish`."""

import shlex
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinectbench.cli import console
from kinectbench.cli.build import build_recordings, chosen_jobs, exit_status, need_some
from kinectbench.cli.build_warnings import tell_unknown_categories, tell_warnings
from kinectbench.cli.common import SOME_FAILED, Common, Ids, takes
from kinectbench.cli.progress_bars import progress_bar
from kinectbench.core import IN_USE, ReleaseError, SettingsError, printable, read_plain_text
from kinectbench.core.store.address import is_web, require_usable, shown, unusable, url_of

if TYPE_CHECKING:
    from kinectbench.core.artefacts.benchmark import PublishOptions, ReleaseInfo
    from kinectbench.core.store.store import Store
    from kinectbench.engine.summary import BuiltRecording
    from kinectbench.release.publish.publish import PublishSummary
    from kinectbench.release.put import PutSummary
    from kinectbench.settings.models import BenchmarkSettings


@takes("config", "overrides", "jobs", "force", "wait", "as_json", at_url=True)
def publish_command(
    common: Common,
    ids: Ids = None,
    hold_back: Annotated[
        list[str] | None,
        typer.Option(help="a split: benchmark/ has its inputs only, benchmark-private/ scores"),
    ] = None,
    thresholds: Annotated[
        Path | None, typer.Option(help="a threshold file (of score --save-thresholds) to publish with it")
    ] = None,
    isolate: Annotated[
        bool, typer.Option("--isolate", help="with --hold-back: of each object one view and nothing else")
    ] = False,
    allow_poor: Annotated[
        bool, typer.Option("--allow-poor", help="publish recordings that do not keep `publish.gate`, too")
    ] = False,
    archives: Annotated[bool, typer.Option("--archives", help="pack each part as a zip file too")] = False,
    archives_to: Annotated[
        Path | None, typer.Option(help="folder of the zip files; default: beside the release")
    ] = None,
    to: Annotated[
        str | None,
        typer.Option(
            metavar="URL", help="put the release, but no private part, there too; hf://user/name: a data set"
        ),
    ] = None,
) -> int:
    """Build what is not up to date, and write the release to benchmark/ from all that could be built."""
    from kinectbench.release.publish.archive import refuse_unstated

    settings = common.settings
    options = publish_options(settings, hold_back or (), thresholds, allow_poor, isolate)
    packed = archives or archives_to is not None
    stored = url_of(common.place) is not None
    if stored and (packed or to is not None):
        raise SettingsError(
            "publish: --archives and --to are for a benchmark on this machine; fetch it first"
        )
    put_there = None if to is None else _putting(to)
    if packed or to is not None:
        refuse_unstated(settings, ids)
    rows = _built(common, ids, stored=stored)
    summary = _published(common, rows, options, stored=stored)
    if stored:
        _tell(common, summary, [])
        return _status(rows, summary)
    put = None if put_there is None else put_there(summary.folder)
    parts = [part for part in (summary.folder, summary.private) if part is not None]
    written = [_packed(part, archives_to or common.root) for part in parts] if packed else []
    _tell(common, summary, written, put)
    return _status(rows, summary)


def _built(common: Common, ids: list[str] | None, *, stored: bool) -> "list[BuiltRecording]":
    """Build recordings for `publish`, which prints their warnings itself.

    With `--no-wait`, nothing is built if another run uses a recording, and nothing is published: a release
    without that recording would replace one that has it.
    """
    from kinectbench.engine.locks import refuse_in_use

    tell_unknown_categories(chosen_jobs(common, ids))
    if not common.wait and not stored:
        refuse_in_use([common.root / "build", *(job.build for job in chosen_jobs(common, ids))])
    rows = build_recordings(common, ids, "pairs", brief=True, warn=False)
    if any(row.code == IN_USE for row in rows):
        raise typer.Exit(exit_status(rows))
    return rows


def _published(
    common: Common, rows: "list[BuiltRecording]", options: "PublishOptions", *, stored: bool
) -> "PublishSummary":
    """Publish what was built; of each recording that is left out, print what to do first."""
    try:
        summary = (_publish_there if stored else _publish_here)(common, need_some(rows), options)
    except (ReleaseError, typer.Exit):
        _tell_left_out(common, rows)
        raise
    _tell_left_out(common, to_mend(rows, summary, isolated=bool(options.isolate)))
    return summary


def to_mend(
    rows: "list[BuiltRecording]", summary: "PublishSummary", *, isolated: bool
) -> "list[BuiltRecording]":
    """Return the left-out recordings, without those to which `--isolate` preferred another of their object.

    Nothing is to be done about the latter: a warning of the summary names them.
    """
    left_out = [row for row in rows if row.recording not in summary.recordings]
    return [
        row for row in left_out if not (isolated and row.summary.pairs) or row.recording in summary.refused
    ]


def _tell_left_out(common: Common, rows: "list[BuiltRecording]") -> None:
    """Print the most important warning of each recording that is left out, unless a person rejected it."""
    reviews = {each.id: each.review for each in common.settings.recordings if each.review is not None}
    for row in rows[: console.MOST_LINES]:
        review = reviews.get(row.recording)
        if row.summary.first and (review is None or review.decision != "reject"):
            show_all = shlex.join(["build", row.recording, *common.options, "-v"])
            # Those on input that has no effect are printed already.
            own = [line for line in row.summary.warnings if ": not used" not in line]
            tell_warnings(row.recording, own, row.summary.first, show_all)


def _publish_here(common: Common, recordings: list[str], options: "PublishOptions") -> "PublishSummary":
    """Publish to this machine; print a note if another release was replaced."""
    from kinectbench.core.artefacts.benchmark import ReleaseInfo
    from kinectbench.release.publish.publish_if_stale import publish_if_stale

    try:
        before = ReleaseInfo.read_if_there(common.root / "benchmark")
    except ReleaseError:  # it is damaged
        before = None
    tell = partial(console.waiting, "publish")
    summary = publish_if_stale(
        common.settings, common.root, recordings, common.force, options, wait=common.wait, waiting=tell
    )
    if before is not None and before.benchmark_sha256 != summary.benchmark_sha256:
        version = common.settings.publish.citation.version
        again = f"; both have version {version}: raise `publish.citation.version`" if before.version else ""
        _tell_replaced(summary.folder, before, again if version == before.version else "")
    return summary


def _putting(to: str) -> "Callable[[Path], tuple[str, PutSummary]]":
    """Return a function that uploads a release's folder to the URL `to`, and returns (URL, summary)."""
    from kinectbench.release.put import SCHEME, hub_name, put_release

    if to.startswith(SCHEME):
        name = hub_name(to)
        return lambda folder: (f"{SCHEME}{name}", _put_on_hub(folder, name))
    target = store_at(to)

    def put(folder: Path) -> "tuple[str, PutSummary]":
        with progress_bar("put") as progress:
            return target.url, put_release(folder, target, progress)

    return put


def _put_on_hub(folder: Path, name: str) -> "PutSummary":
    """Upload a release to the dataset `name` of the hub, with a progress bar for the check before the upload.

    The hub's client shows its own progress.
    """
    from kinectbench.release.published import listed_files
    from kinectbench.release.put import put_on_hub

    with progress_bar("check") as progress:
        sums = listed_files(folder, progress)
    return put_on_hub(folder, name, sums)


def _packed(release: Path, out: Path) -> Path:
    """Pack a release as a zip file in the folder `out`, with a progress bar; return the file's path."""
    from kinectbench.release.publish.archive import write_archive

    with progress_bar("pack") as progress:
        return write_archive(release, out, progress)


def _status(rows: "list[BuiltRecording]", summary: "PublishSummary") -> int:
    """Return the exit status: 1 if all recordings failed, 3 if some failed or violate `publish.gate`, else 0.

    Recordings that a review rejected do not count as failures.
    """
    return exit_status(rows) or (SOME_FAILED if summary.refused else 0)


def _publish_there(common: Common, recordings: list[str], options: "PublishOptions") -> "PublishSummary":
    """Publish a benchmark whose build is in a store to the same store, with a progress bar."""
    from kinectbench.release.publish.publish_stored import publish_stored

    with progress_bar("publish") as progress:
        return publish_stored(chosen_jobs(common, recordings), common.force, options, progress)


def store_at(url: str) -> "Store":
    """Return the store at the URL of `--to`, to which a release is uploaded.

    Raises:
        SettingsError: `url` is no URL, does not allow uploads, or obstore is not installed.
    """
    from kinectbench.core.store.store import Store

    if problem := unusable(url):
        raise SettingsError(f"--to: {printable(problem, 300)}", what="bad-url")
    store_url = url_of(url)
    if store_url is None or is_web(store_url):
        raise SettingsError(
            f"--to {shown(url)}: wanted a URL of a store: s3://, gs://, az:// or file://; or hf://user/name",
            what="bad-url",
        )
    require_usable(store_url, f"--to {shown(store_url)}")
    return Store(store_url)


def publish_options(
    settings: "BenchmarkSettings",
    hold_back: Sequence[str],
    thresholds: Path | None,
    allow_poor: bool = False,
    isolate: bool = False,
) -> "PublishOptions":
    """Check the options of `publish` and return them as a value.

    Args:
        settings: the benchmark's settings.
        hold_back: splits whose truth is held back.
        thresholds: a threshold file; None if there is none.
        allow_poor: whether recordings that violate the limits `publish.gate` are published, too.
        isolate: whether only one view is published of each object with held-back truth.

    Raises:
        SettingsError: a split is unknown; the threshold file is unusable; or objects cannot be isolated,
            because nothing is held back or the framing is `object`.
    """
    from kinectbench.core.artefacts.benchmark import PublishOptions
    from kinectbench.core.artefacts.targets import SPLITS
    from kinectbench.release.publish.held_back import refuse_framing
    from kinectbench.scoring.thresholds import read_thresholds

    for split in hold_back:
        if split not in SPLITS:
            raise SettingsError(f"--hold-back {split}: choose among {', '.join(SPLITS)}")
    hidden = tuple(sorted(split for split in SPLITS if split in hold_back))
    if isolate:
        if not hidden:
            raise SettingsError("--isolate is for what is held back: add `--hold-back test`")
        refuse_framing(settings)
    asked = PublishOptions(hold_back=hidden, thresholds=None)
    more = {"allow_poor": allow_poor, "isolate": isolate}
    asked = asked.model_copy(update={key: True for key, value in more.items() if value})
    if thresholds is None:
        return asked
    test = [recording for recording in settings.recordings if recording.split == "test"]
    categories = sorted({recording.category for recording in test})
    read_thresholds(thresholds, categories, frozenset(recording.object_name for recording in test))
    return asked.model_copy(update={"thresholds": read_plain_text(thresholds)})


def _tell(
    common: Common,
    summary: "PublishSummary",
    archives: list[Path],
    put: "tuple[str, PutSummary] | None" = None,
) -> None:
    """Print what was published, removed, packed and uploaded, and JSON if requested."""
    console.lines("warning", summary.warnings, "yellow")
    if summary.shortened:
        show_all = shlex.join(["build", "ID", *common.options, "-v"])
        line = f"all warnings of a recording are shown by `kinectbench {show_all}`, and by the report"
        console.lines("note", [line], "cyan")
    if summary.unanswered:
        keys = ", ".join(summary.unanswered)
        line = f"not stated in datasheet.md: {keys}; answer under `publish: datasheet:` in benchmark.yaml"
        console.lines("note", [line], "cyan")
    result = {
        "release": shown(summary.folder),
        "recordings": summary.recordings,
        "pairs": summary.pairs,
        "benchmark_sha256": summary.benchmark_sha256,
        "private": None if summary.private is None else shown(summary.private),
        "private_benchmark_sha256": summary.private_sha256,
        "removed": summary.removed,
        "unanswered": summary.unanswered,
        "refused": summary.refused,
        "archives": [str(path) for path in archives],
        "put": None if put is None else _put_value(*put),
    }
    count = f"{len(summary.recordings)} recording{'s' * (len(summary.recordings) != 1)}"
    lines = [f"published {summary.pairs} pairs of {count}: {shown(summary.folder)}"]
    lines += [f"benchmark_sha256 {summary.benchmark_sha256}"]
    if summary.private is not None:
        lines += [f"private part, which scores: {shown(summary.private)}"]
        lines += [f"private_benchmark_sha256 {summary.private_sha256}"]
    lines += summary.removed
    lines += [f"wrote {path}, {path.stat().st_size / 1e6:.1f} MB, and its .sha256" for path in archives]
    if put is not None:
        lines += [_put_line(*put)]
    common.tell(result, lines)


def _put_line(url: str, put: "PutSummary") -> str:
    """Return a line about the upload; print a note if it has replaced another release."""
    if put.replaced is not None:
        _tell_replaced(url, put.replaced)
    return f"put to {shown(url)}: {put.put} files put, {put.kept} kept, {put.removed} removed"


def _tell_replaced(place: Path | str, before: "ReleaseInfo", more: str = "") -> None:
    """Print which release at a place was replaced."""
    name = " ".join(part for part in (before.name, before.version) if part)
    line = f"{shown(place)}: replaced {name}, benchmark_sha256 {before.benchmark_sha256}{more}"
    console.lines("note", [line], "cyan")


def _put_value(url: str, put: "PutSummary") -> dict[str, object]:
    """Return the upload as JSON values: URL, numbers of files, and the replaced release."""
    keys = ("name", "version", "benchmark_sha256")
    replaced = None if put.replaced is None else {key: getattr(put.replaced, key) for key in keys}
    return {"url": shown(url), "put": put.put, "kept": put.kept, "removed": put.removed, "replaced": replaced}
