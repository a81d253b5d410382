"""The command `synthesize`."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from kinectbench.cli.common import Common, takes
from kinectbench.cli.progress_bars import recording_bars


@takes("overrides", "jobs", "as_json", makes_release=True)
def synthesize_command(
    common: Common,
    out: Annotated[Path, typer.Argument(help="a new folder; a release that it wrote before is replaced")],
    models: Annotated[
        Path | None, typer.Option(help="CAD meshes in the ShapeNet layout; default: parametric furniture")
    ] = None,
    category: Annotated[list[str] | None, typer.Option(help="only this; default: all there are")] = None,
    train: Annotated[int | None, typer.Option(help="training models per category; default: 220")] = None,
    validation: Annotated[int | None, typer.Option(help="validation models; default: 12")] = None,
    test: Annotated[int | None, typer.Option(help="test models; default: 40")] = None,
    framing: Annotated[
        str | None, typer.Option(help="object: cube around the full shape; view: the view's")
    ] = None,
    layout: Annotated[str | None, typer.Option(help="release, or recgan: the paper authors' files")] = None,
) -> None:
    """Write the paper's synthetic pairs, from CAD meshes or from parametric furniture."""
    from kinectbench.lab.synthesize.models import SynthesisSettings
    from kinectbench.lab.synthesize.synthesize import synthesize as make_all
    from kinectbench.settings.overrides import settings_from_options

    given = {
        "models": None if models is None else str(models),
        "categories": category,
        "train": train,
        "validation": validation,
        "test": test,
        "framing": framing,
        "layout": layout,
    }
    values = {key: value for key, value in given.items() if value is not None}
    settings = settings_from_options(SynthesisSettings, values, common.overrides or (), "synthesis")
    with recording_bars() as progress:
        report = make_all(
            settings, out, common.workers, lambda what, done, total: progress(str(out), what, done, total)
        )
    common.tell({**asdict(report), "folder": str(report.folder)}, report.lines)
