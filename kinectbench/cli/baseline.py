"""The commands `baseline` and `check`: predictions before they are scored."""

from pathlib import Path
from typing import Annotated

import typer

from kinectbench.cli import console
from kinectbench.cli.build import exit_status, find_release
from kinectbench.cli.common import SOME_FAILED, Common, Predictions, takes
from kinectbench.cli.progress_bars import progress_bar


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
