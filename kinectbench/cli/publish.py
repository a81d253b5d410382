"""The commands around releases: published, checked, made again, and exchanged with other layouts."""

import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from kinectbench.cli.build import build_jobs, build_recordings, exit_status, find_release, need_some
from kinectbench.cli.common import CANNOT_BE_USED, Common, Ids, takes
from kinectbench.core.errors import SettingsError

if TYPE_CHECKING:
    from kinectbench.core.artefacts.benchmark import PublishOptions
    from kinectbench.release.publish.publish import PublishSummary
    from kinectbench.settings.models import BenchmarkSettings

# Each is a room `release/exchange/<layout>.py` with a function `export_<layout>`.
Layout = Literal["recgan", "bop", "webdataset"]


@takes("config", "overrides", "jobs", "force", "wait", "as_json")
def publish(
    common: Common,
    ids: Ids = None,
    hold_back: Annotated[
        list[str] | None,
        typer.Option(help="a split: benchmark/ has its inputs only, benchmark-private/ scores"),
    ] = None,
    thresholds: Annotated[
        Path | None, typer.Option(help="a threshold file (of score --save-thresholds) to publish with it")
    ] = None,
    archives: Annotated[bool, typer.Option("--archives", help="pack each part as a zip file too")] = False,
    archives_to: Annotated[
        Path | None, typer.Option(help="folder of the zip files; default: beside the release")
    ] = None,
) -> int:
    """Write the release to benchmark/, from everything that can be built."""
    from kinectbench.cli import console
    from kinectbench.release.publish.archive import refuse_unstated, write_archive
    from kinectbench.release.publish.current import publish_if_stale

    settings, root = common.settings, common.root
    options = publish_options(settings, hold_back or (), thresholds)
    packed = archives or archives_to is not None
    if packed:
        refuse_unstated(settings, ids)
    rows = build_recordings(common, ids, "pairs")
    tell = partial(console.waiting, "publish")
    summary = publish_if_stale(
        settings, root, need_some(rows), common.force, options, wait=common.wait, waiting=tell
    )
    parts = [part for part in (summary.folder, summary.private) if part is not None]
    written = [write_archive(part, archives_to or root) for part in parts] if packed else []
    _tell(common, summary, written)
    return exit_status(rows)


def publish_options(
    settings: "BenchmarkSettings", hold_back: Sequence[str], thresholds: Path | None
) -> "PublishOptions":
    """The options as a value.

    Args:
        settings: the benchmark's.
        hold_back: splits.
        thresholds: a threshold file, or None.

    Raises:
        SettingsError: no such split, or an unusable threshold file.
    """
    from kinectbench.core.artefacts.benchmark import PublishOptions
    from kinectbench.core.artefacts.targets import SPLITS
    from kinectbench.scoring.thresholds import read_thresholds

    for split in hold_back:
        if split not in SPLITS:
            raise SettingsError(f"--hold-back {split}: choose among {', '.join(SPLITS)}")
    hidden = tuple(sorted(split for split in SPLITS if split in hold_back))
    if thresholds is None:
        return PublishOptions(hold_back=hidden, thresholds=None)
    test = [recording for recording in settings.recordings if recording.split == "test"]
    categories = sorted({recording.category for recording in test})
    read_thresholds(thresholds, categories, frozenset(recording.object_name for recording in test))
    return PublishOptions(hold_back=hidden, thresholds=thresholds.read_text())


def _tell(common: Common, summary: "PublishSummary", archives: list[Path]) -> None:
    """What was published, removed, packed, and asked for."""
    from kinectbench.cli import console

    console.lines("warning", summary.warnings, "yellow")
    if summary.unanswered:
        keys = ", ".join(summary.unanswered)
        line = f"not stated in datasheet.md: {keys}; answer under `publish: datasheet:` in benchmark.yaml"
        console.lines("note", [line], "cyan")
    result = {
        "release": str(summary.folder),
        "recordings": summary.recordings,
        "pairs": summary.pairs,
        "benchmark_sha256": summary.benchmark_sha256,
        "private": None if summary.private is None else str(summary.private),
        "private_benchmark_sha256": summary.private_sha256,
        "removed": summary.removed,
        "unanswered": summary.unanswered,
        "archives": [str(path) for path in archives],
    }
    count = f"{len(summary.recordings)} recording{'s' * (len(summary.recordings) != 1)}"
    lines = [f"published {summary.pairs} pairs of {count}: {summary.folder}"]
    lines += [f"benchmark_sha256 {summary.benchmark_sha256}"]
    if summary.private is not None:
        lines += [f"private part, which scores: {summary.private}"]
        lines += [f"private_benchmark_sha256 {summary.private_sha256}"]
    lines += summary.removed
    lines += [f"wrote {path}, {path.stat().st_size / 1e6:.1f} MB, and its .sha256" for path in archives]
    common.tell(result, lines)


@takes("jobs", "as_json")
def verify(
    common: Common,
    release: Annotated[
        Path, typer.Argument(help="the release's folder, or its .zip, .tar or .tar.gz")
    ] = Path("benchmark"),
    rebuild: Annotated[
        Path | None,
        typer.Option(help="make the pairs again from here: a benchmark.yaml, or a folder of recordings"),
    ] = None,
    work: Annotated[
        Path | None, typer.Option(help="with --rebuild: build here and keep it; default: a temporary folder")
    ] = None,
) -> int:
    """Re-check every byte and every pair of a release; with --rebuild make the pairs again and compare."""
    from kinectbench.cli import console
    from kinectbench.release.check.verify import verify as find_problems

    with console.bar("verify") as progress:
        problems = find_problems(release, progress)
    if rebuild is not None and not problems:
        problems = _rebuild(release, rebuild, work, common.workers)
    common.tell_problems(problems, f"{release}: all well")
    return CANNOT_BE_USED if problems else 0


def _rebuild(release: Path, recordings: Path, work: Path | None, processes: int) -> list[str]:
    """Build the release's recordings anew and say what differs; only a sound release comes here."""
    from kinectbench.cli import console
    from kinectbench.engine.stages import Job
    from kinectbench.release.check.rebuild import differences, find_sources, rebuild_plan
    from kinectbench.release.opening import open_contents

    sources = find_sources(recordings)
    with ExitStack() as stack:
        contents = stack.enter_context(open_contents(release))
        plan = rebuild_plan(contents, sources)
        console.lines("note", plan.notes, "yellow")
        root = work or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="kinectbench-rebuild-")))
        chosen = [Job(plan.settings, recording, root) for recording in plan.settings.recordings]
        build_jobs(chosen, "pairs", processes)
        return list(differences(contents, plan, root / "build"))


@takes("benchmark", "config", "overrides", "jobs", "as_json")
def export(
    common: Common,
    out: Annotated[Path, typer.Argument(help="a new folder")],
    layout: Annotated[Layout, typer.Option(help="the paper's authors', BOP's, or WebDataset's")] = "recgan",
) -> int:
    """Write a release in another layout: `recgan`, the paper authors' files and axes; `bop`; `webdataset`."""
    from importlib import import_module

    from kinectbench.cli import console

    write = getattr(import_module(f"kinectbench.release.exchange.{layout}"), f"export_{layout}")
    release, rows = find_release(common)
    with console.bar("export") as progress:
        pairs = write(release, out, progress)
    common.tell({"folder": str(out), "pairs": pairs}, [f"exported {pairs} pairs: {out}"])
    return exit_status(rows)


@takes("as_json")
def import_(
    common: Common,
    folder: Annotated[Path, typer.Argument(help="holds P1_<synset>_<category>/")],
    out: Annotated[Path, typer.Argument(help="the release: a new folder")],
) -> None:
    """Make a release of files in the layout of the paper's authors."""
    from kinectbench.cli import console
    from kinectbench.release.exchange.recgan import import_recgan

    with console.bar("import") as progress:
        pairs = import_recgan(folder, out, progress)
    common.tell({"folder": str(out), "pairs": pairs}, [f"imported {pairs} pairs: {out}"])
