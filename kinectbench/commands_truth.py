"""The commands around known truth: simulated recordings, synthetic pairs, builds against the truth."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from kinectbench.commands import (
    DEFAULT_CONFIG,
    Config,
    Jobs,
    Json,
    Set,
    build_jobs,
    exit_for,
    tell_table,
    tell_written,
    workers,
)
from kinectbench.errors import SettingsError

# Those of `simulate.spec.Format`, which takes too long to import for a help text.
FORMATS = (
    "tum", "7scenes", "folder", "redwood", "bag", "bag_compressed", "ros2_sqlite", "ros2_mcap", "realsense",
    "realsense_old", "klg", "sens", "stray", "scanner_app", "bop",
)  # fmt: skip


def simulate(
    out: Annotated[Path | None, typer.Argument(help="the recording: a folder, or a .bag")] = None,
    object_name: Annotated[str | None, typer.Option("--object", help="such as chair:seed=3")] = None,
    mesh: Annotated[Path | None, typer.Option(help="a mesh file in metres, instead of an object")] = None,
    preset: Annotated[str, typer.Option(help="see --presets")] = "orbit-v1",
    frames: Annotated[int | None, typer.Option(min=1, help="number of frames")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="draws everything but the object")] = None,
    form: Annotated[str | None, typer.Option("--format", help=", ".join(FORMATS))] = None,
    overrides: Set = None,
    presets: Annotated[bool, typer.Option("--presets", help="list the presets")] = False,
    contact_sheets: Annotated[
        Path | None, typer.Option(help="draw twelve objects of each family into this folder")
    ] = None,
    samples: Annotated[Path | None, typer.Option(help="write the sample recordings here")] = None,
    demo: Annotated[Path | None, typer.Option(help="write the demo's further recordings here")] = None,
    as_json: Json = False,
) -> None:
    """Write a simulated recording, with the exact truth beside it in <name>.truth/."""
    from kinectbench import console
    from kinectbench.simulate.presets import PRESETS
    from kinectbench.simulate.run import simulate_named
    from kinectbench.simulate.truth import is_truth, read_truth, truth_folder

    if presets:
        tell_table({name: text for name, (text, _) in PRESETS.items()}, as_json)
        return
    if mesh is not None and object_name is not None:
        raise SettingsError("simulate: give --object or --mesh, not both")
    if contact_sheets is not None:
        from kinectbench.simulate.objects.contact_sheet import write_contact_sheets

        tell_written(write_contact_sheets(contact_sheets), as_json)
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
            overrides or (),
            samples,
            demo,
            lambda name, *done: progress(name, "simulate", *done),
        )
    if mesh is not None:
        console.lines(
            "note", [f"{mesh}: {read_truth(truth_folder(path)).origin}" for path in written], "yellow"
        )
    tell_written(written, as_json)


def evaluate(
    recording: Annotated[
        str, typer.Argument(help="a recording's id, a simulated recording, or the folder one was built in")
    ],
    truth: Annotated[
        Path | None, typer.Argument(help="its truth; default: <recording>.truth beside the recording")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="default: evaluation/<recording>/ beside build/")] = None,
    align: Annotated[bool, typer.Option(help="lay the build onto the truth by the trajectories")] = True,
    config: Config = DEFAULT_CONFIG,
    overrides: Set = None,
    as_json: Json = False,
) -> None:
    """Measure what is built of a simulated recording against its truth: a table, JSON, pictures, a page."""
    from kinectbench import console
    from kinectbench.evaluate.evaluation import evaluation_json
    from kinectbench.evaluate.find import find_built
    from kinectbench.evaluate.run import evaluate_recording
    from kinectbench.evaluate.table import evaluation_table

    found = find_built(recording, truth, config, overrides or ())
    rows = build_jobs([found.job], "pairs", 1) if found.job else []
    if not (found.build / "sequence").is_dir():
        exit_for(rows)
    target = out or found.root / "evaluation" / found.name
    with console.bar("evaluate") as progress:
        result = evaluate_recording(found.build, found.truth, target, align=align, progress=progress)
    if as_json:
        typer.echo(json.dumps(evaluation_json(result)))
    else:
        console.out.print(evaluation_table(result))
        typer.echo(f"page: {(target / 'index.html').resolve()}")
    exit_for(rows)


def synthesize(
    out: Annotated[Path, typer.Argument(help="a new folder")],
    models: Annotated[
        Path | None, typer.Option(help="CAD meshes in the ShapeNet layout; default: parametric furniture")
    ] = None,
    category: Annotated[list[str] | None, typer.Option(help="only this; default: all there are")] = None,
    train: Annotated[int | None, typer.Option(help="training models per category; default: 220")] = None,
    validation: Annotated[int | None, typer.Option(help="validation models; default: 12")] = None,
    test: Annotated[int | None, typer.Option(help="test models; default: 40")] = None,
    layout: Annotated[str | None, typer.Option(help="release, or recgan: the paper authors' files")] = None,
    overrides: Set = None,
    jobs: Jobs = None,
    as_json: Json = False,
) -> None:
    """Write the paper's synthetic pairs, from CAD meshes or from parametric furniture."""
    from kinectbench import console
    from kinectbench.options import settings_from_options
    from kinectbench.synthesize.settings import SynthesisSettings
    from kinectbench.synthesize.synthesize import synthesize as make_all

    given = {
        "models": None if models is None else str(models),
        "categories": category,
        "train": train,
        "validation": validation,
        "test": test,
        "layout": layout,
    }
    values = {key: value for key, value in given.items() if value is not None}
    settings = settings_from_options(SynthesisSettings, values, overrides or (), "synthesis")
    with console.recording_bars() as progress:
        report = make_all(
            settings, out, workers(jobs), lambda what, done, total: progress(str(out), what, done, total)
        )
    if as_json:
        content = {**asdict(report), "folder": str(report.folder)}
        typer.echo(json.dumps(content))
    else:
        for line in report.lines:
            typer.echo(line)
