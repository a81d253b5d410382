"""The commands around known truth: simulated recordings, synthetic pairs, builds against the truth."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, get_args

import typer

from kinectbench.cli.build import build_jobs, exit_status
from kinectbench.cli.common import Common, takes
from kinectbench.core.errors import SettingsError
from kinectbench.lab.simulate import Format


@takes("overrides", "as_json")
def simulate(
    common: Common,
    out: Annotated[Path | None, typer.Argument(help="the recording: a folder, or a .bag")] = None,
    object_name: Annotated[str | None, typer.Option("--object", help="such as chair:seed=3")] = None,
    mesh: Annotated[Path | None, typer.Option(help="a mesh file in metres, instead of an object")] = None,
    preset: Annotated[str, typer.Option(help="see --presets")] = "orbit-v1",
    frames: Annotated[int | None, typer.Option(min=1, help="number of frames")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="draws everything but the object")] = None,
    form: Annotated[str | None, typer.Option("--format", help=", ".join(get_args(Format)))] = None,
    presets: Annotated[bool, typer.Option("--presets", help="list the presets")] = False,
    contact_sheets: Annotated[
        Path | None, typer.Option(help="draw twelve objects of each family into this folder")
    ] = None,
    samples: Annotated[Path | None, typer.Option(help="write the sample recordings here")] = None,
    demo: Annotated[Path | None, typer.Option(help="write the demo's further recordings here")] = None,
) -> None:
    """Write a simulated recording, with the exact truth beside it in <name>.truth/."""
    from kinectbench.cli import console
    from kinectbench.lab.simulate.presets import PRESETS, simulate_named
    from kinectbench.lab.simulate.truth import is_truth, read_truth, truth_folder

    if presets:
        width = max(map(len, PRESETS))
        rows = {name: text for name, (text, _) in PRESETS.items()}
        common.tell(rows, (f"{name:<{width}}  {text}" for name, text in rows.items()))
        return
    if mesh is not None and object_name is not None:
        raise SettingsError("simulate: give --object or --mesh, not both")
    if contact_sheets is not None:
        from kinectbench.lab.simulate.objects.furniture import write_contact_sheets

        common.tell_written(*write_contact_sheets(contact_sheets))
        return
    given = {"object": object_name, "mesh": None if mesh is None else str(mesh), "seed": seed, "format": form}
    changes: dict[str, Any] = {key: value for key, value in given.items() if value is not None}
    if frames is not None:
        changes["path"] = {"frames": frames}
    if out is not None and is_truth(truth_folder(out)):
        console.lines("note", [f"{out}: replaces the simulated recording that is there"], "yellow")
    with console.recording_bars() as progress:
        written = simulate_named(
            out,
            preset,
            changes,
            common.overrides or (),
            samples,
            demo,
            lambda name, *done: progress(name, "simulate", *done),
        )
    if mesh is not None:
        console.lines(
            "note", [f"{mesh}: {read_truth(truth_folder(path)).origin}" for path in written], "yellow"
        )
    common.tell_written(*written)


@takes("config", "overrides", "as_json")
def evaluate(
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
    """Measure what is built of a simulated recording against its truth: a table, JSON, pictures, a page."""
    from kinectbench.cli import console
    from kinectbench.lab.evaluate.evaluation import evaluation_json
    from kinectbench.lab.evaluate.run import evaluate_recording, find_built
    from kinectbench.lab.evaluate.table import evaluation_table

    found = find_built(recording, truth, common.config, common.overrides or ())
    rows = build_jobs([found.job], "pairs", 1) if found.job else []
    status = exit_status(rows)
    if status and not (found.build / "sequence").is_dir():
        return status
    target = out or found.build.parent.parent / "evaluation" / found.build.name
    with console.bar("evaluate") as progress:
        result = evaluate_recording(found.build, found.truth, target, align=align, progress=progress)
    if common.as_json:
        typer.echo(json.dumps(evaluation_json(result)))
    else:
        console.out.print(evaluation_table(result))
        typer.echo(f"page: {(target / 'index.html').resolve()}")
    return status


@takes("overrides", "jobs", "as_json")
def synthesize(
    common: Common,
    out: Annotated[Path, typer.Argument(help="a new folder")],
    models: Annotated[
        Path | None, typer.Option(help="CAD meshes in the ShapeNet layout; default: parametric furniture")
    ] = None,
    category: Annotated[list[str] | None, typer.Option(help="only this; default: all there are")] = None,
    train: Annotated[int | None, typer.Option(help="training models per category; default: 220")] = None,
    validation: Annotated[int | None, typer.Option(help="validation models; default: 12")] = None,
    test: Annotated[int | None, typer.Option(help="test models; default: 40")] = None,
    layout: Annotated[str | None, typer.Option(help="release, or recgan: the paper authors' files")] = None,
) -> None:
    """Write the paper's synthetic pairs, from CAD meshes or from parametric furniture."""
    from kinectbench.cli import console
    from kinectbench.lab.synthesize.models import SynthesisSettings
    from kinectbench.lab.synthesize.synthesize import synthesize as make_all
    from kinectbench.settings.overrides import settings_from_options

    given = {
        "models": None if models is None else str(models),
        "categories": category,
        "train": train,
        "validation": validation,
        "test": test,
        "layout": layout,
    }
    values = {key: value for key, value in given.items() if value is not None}
    settings = settings_from_options(SynthesisSettings, values, common.overrides or (), "synthesis")
    with console.recording_bars() as progress:
        report = make_all(
            settings, out, common.workers, lambda what, done, total: progress(str(out), what, done, total)
        )
    common.tell({**asdict(report), "folder": str(report.folder)}, report.lines)
