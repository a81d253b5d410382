"""The commands on predictions and other layouts: `baseline`, `check`, `adapt`, `export` and `import`."""

from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import typer

from kinectbench.cli import console
from kinectbench.cli.build import exit_status, find_release
from kinectbench.cli.common import SOME_FAILED, Common, Predictions, takes
from kinectbench.cli.progress_bars import progress_bar
from kinectbench.core import SettingsError


def _known_baselines(incomplete: str) -> list[str]:
    """Return the baselines whose names begin with `incomplete`, for completion in the shell."""
    from kinectbench.scoring.baselines.registry import BASELINES

    return [name for name in BASELINES if name.startswith(incomplete)]


@takes("benchmark", "config", "overrides", "jobs", "as_json")
def baseline_command(
    common: Common,
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]...", help="default: all", autocompletion=_known_baselines),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="folder of methods; default: predictions/ beside the benchmark")
    ] = None,
) -> int:
    """Write predictions of simple methods: empty, base-rate, partial, hull, mirror, silhouette.

    If every category has training pairs, mean-shape and nearest are written, too.
    """
    from kinectbench.scoring.baselines.predict import check_baseline_names, write_baselines

    check_baseline_names(names or ())
    release, rows = find_release(common)
    folder = out or common.beside("predictions")
    with progress_bar("baseline") as progress:
        written = write_baselines(release, folder, names, common.workers, progress)
    common.tell_written(*(folder / name for name in written))
    return exit_status(rows)


@takes("benchmark", "config", "overrides", "jobs", "as_json")
def check_command(common: Common, predictions: Predictions) -> int:
    """Report all faults of folders of predictions, without scoring.

    For predictions in the camera frame and in metres, the median and the largest distance to the views' depth
    are stated. It is a fault if a prediction fits its view's depth only after a change of unit or axes. A
    note says how many predictions are constant, or the same for several views.
    """
    from kinectbench.scoring.camera_predictions import check_camera
    from kinectbench.scoring.method_json import read_in_camera
    from kinectbench.scoring.predictions import check_folder, check_grids, lines_without, split_methods

    if common.benchmark is None:
        for folder in predictions:
            check_folder(folder)  # before the benchmark is built
    release, rows = find_release(common)
    found = {folder: split_methods(folder, release.targets) for folder in predictions}
    several = sum(map(len, found.values())) > 1
    problems, notes, shown = list[str](), list[str](), list[str]()
    for given, methods in found.items():
        for name, folder in methods.items():
            method = read_in_camera(folder)
            with progress_bar(f"check {name}") as progress:
                if method is None:
                    faults, lines = check_grids(release, folder, progress)
                else:
                    faults, lines = check_camera(release, folder, method, progress)
            begin = f"{name}: " if several else ""
            problems += [begin + line for line in faults]
            shown += [begin + line for line in console.by_mistake(faults)]
            notes += [begin + line for line in lines]
        without = lines_without(given, methods, release.targets)
        problems, shown = problems + without, shown + without
    console.lines("note", notes, "cyan")
    common.tell_problems(problems, f"{', '.join(map(str, predictions))}: all well", shown)
    return SOME_FAILED if problems else exit_status(rows)


# Each layout is a module `release/exchange/<layout>.py` with a function `export_<layout>`.
Layout = Literal["recgan", "bop", "webdataset", "parquet", "rgbd"]
# The keys of `ADAPTERS` in scoring/adapters/registry.py, which is imported only when needed.
Method = Literal["rayst3r", "octmae", "sam3d", "pointr", "patchcomplete"]


@takes("benchmark", "config", "overrides", "jobs", "as_json")
def export_command(
    common: Common,
    out: Annotated[Path, typer.Argument(help="a new folder, or an earlier export")],
    layout: Annotated[
        Layout,
        typer.Option(help="the paper's authors', BOP's, WebDataset's, targets as Parquet, or images by view"),
    ] = "recgan",
    method: Annotated[
        Method | None,
        typer.Option("--for", help="with `--layout rgbd`: the files of this method, in its unit and axes"),
    ] = None,
) -> int:
    """Write a release in another layout: of the paper's authors, BOP, WebDataset; Parquet; images by view."""
    from kinectbench.release.exchange.rgbd import HOW_TO_PUBLISH
    from kinectbench.release.view_images import COLOR

    if method is not None and layout != "rgbd":
        raise SettingsError(f"--for {method}: only with `--layout rgbd`")
    if layout == "rgbd":
        return _export_views(common, out, method)
    write = getattr(import_module(f"kinectbench.release.exchange.{layout}"), f"export_{layout}")
    release, rows = find_release(common)
    with progress_bar("export") as progress:
        pairs = write(release, out, progress)
    if layout == "bop" and not any(name.endswith(COLOR.suffix) for name in release.sums):
        console.lines("note", [f"the release has no colour images: {HOW_TO_PUBLISH}"], "cyan")
    common.tell({"folder": str(out), "pairs": pairs}, [f"exported {pairs} pairs: {out}"])
    return exit_status(rows)


def _export_views(common: Common, out: Path, method: str | None) -> int:
    """Do the work of `export --layout rgbd`; print notes on missing colour and on objects that are cut."""
    from kinectbench.release.exchange.rgbd import export_rgbd
    from kinectbench.scoring.adapters.registry import export_for

    release, rows = find_release(common)
    with progress_bar("export") as progress:
        if method is None:
            views, notes = export_rgbd(release, out, progress)
        else:
            views, notes = export_for(release, out, method, progress)
    console.lines("note", notes, "cyan")
    result = {"folder": str(out), "views": views, "notes": notes}
    common.tell(result, [f"exported {views} views: {out}"])
    return exit_status(rows)


@takes("benchmark", "config", "overrides", "jobs", "as_json")
def adapt_command(
    common: Common,
    method: Annotated[Method, typer.Argument(help="that wrote it")],
    output: Annotated[Path, typer.Argument(help="what it wrote, in the folders of `export --for`")],
    out: Annotated[
        Path | None, typer.Option(help="a new folder; default: predictions/<method> beside the benchmark")
    ] = None,
) -> int:
    """Convert the output of a published method into predictions in the camera frame, in metres."""
    from kinectbench.scoring.adapters.registry import adapt as write_adapted

    release, rows = find_release(common)
    folder = out or common.beside("predictions") / method
    with progress_bar("adapt") as progress:
        count, problems = write_adapted(release, method, output, folder, progress)
    result = {"folder": str(folder), "predictions": count, "problems": console.at_most(problems)}
    common.tell(result, [f"adapted {count} predictions: {folder}"])
    console.lines("error", problems, "red")
    return SOME_FAILED if problems else exit_status(rows)


@takes("as_json", makes_release=True)
def import_command(
    common: Common,
    folder: Annotated[Path, typer.Argument(help="holds P1_<synset>_<category>/, or data_processing/")],
    out: Annotated[Path, typer.Argument(help="the release: a new folder")],
    views: Annotated[
        int | None,
        typer.Option(
            help="the test set: 125 (the paper's SV, viewing angles of training) or 216 (CV, others)"
        ),
    ] = None,
    layout: Annotated[
        Literal["recgan", "redwood10"],
        typer.Option(help="the paper's authors', or the ten Redwood scans of SDS-Complete"),
    ] = "recgan",
) -> None:
    """Make a release from files in the layout of the paper's authors, or of SDS-Complete."""
    from kinectbench.release.exchange.recgan import import_recgan
    from kinectbench.release.exchange.redwood10 import import_redwood10

    if layout == "redwood10" and views is not None:
        raise SettingsError("--views: only with `--layout recgan`")
    with progress_bar("import") as progress:
        if layout == "recgan":
            pairs = import_recgan(folder, out, progress, views)
        else:
            pairs = import_redwood10(folder, out, progress)
    common.tell({"folder": str(out), "pairs": pairs}, [f"imported {pairs} pairs: {out}"])
