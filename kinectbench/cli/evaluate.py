"""The command `evaluate`."""

from pathlib import Path
from typing import Annotated

import typer

from kinectbench.cli import console
from kinectbench.cli.build import build_jobs, exit_status
from kinectbench.cli.common import Common, takes
from kinectbench.cli.progress_bars import progress_bar


@takes("config", "overrides", "as_json")
def evaluate_command(
    common: Common,
    recording: Annotated[
        str, typer.Argument(help="a recording's id, a simulated recording, or the folder one was built in")
    ],
    truth: Annotated[
        Path | None, typer.Argument(help="its truth; default: <recording>.truth beside the recording")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="default: evaluation/<recording>/ beside build/")] = None,
    align: Annotated[bool, typer.Option(help="lay the build onto the truth by the trajectories")] = True,
) -> int:
    """Measure the build of a simulated recording against its truth: a table, JSON, pictures, a page."""
    from kinectbench.lab.evaluate.evaluation import evaluation_json
    from kinectbench.lab.evaluate.run import evaluate_recording, find_built, folder_beside
    from kinectbench.lab.evaluate.table import evaluation_table

    build = find_built(recording, truth, common.config, common.overrides or ())
    rows = build_jobs([build.job], "pairs", 1) if build.job else []
    status = exit_status(rows)
    if status and not (build.build / "sequence").is_dir():
        return status
    target = out or folder_beside(build.build)
    with progress_bar("evaluate") as progress:
        result = evaluate_recording(build.build, build.truth, target, align=align, progress=progress)
    if common.as_json:
        console.say_json(evaluation_json(result))
    else:
        console.out.print(evaluation_table(result))
        console.say(f"page: {(target / 'index.html').resolve()}")
    return status
