"""The command that looks a recording over."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinectbench.commands import CANNOT_BE_USED, DEFAULT_CONFIG, Json, open_benchmark

if TYPE_CHECKING:
    from kinectbench.config import RecordingSettings
    from kinectbench.doctor import Diagnosis

STYLES = {"stops": "red", "warning": "yellow", "note": "dim"}


def inspect(
    recording: Annotated[str, typer.Argument(help="folder or file, or an id of the benchmark.yaml here")],
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="of its camera, such as fx=525; as under `camera:`"),
    ] = None,
    page: Annotated[Path | None, typer.Option(help="write a page with a contact sheet to this file")] = None,
    as_json: Json = False,
) -> None:
    """Say in seconds what is wrong with a recording, and what to do about it; nothing is built."""
    from kinectbench.config import CameraSettings
    from kinectbench.doctor import inspect as look_over
    from kinectbench.options import settings_from_options

    known = _of_benchmark(recording)
    said = known.camera.model_dump(exclude_unset=True) if known and known.camera else {}
    camera = settings_from_options(CameraSettings, said, overrides or [], "camera")
    path = DEFAULT_CONFIG.parent / known.path if known else Path(recording)
    ignored = known is not None and known.trajectory == "ignore"
    diagnosis, look = look_over(path, camera if said or overrides else None, without_trajectory=ignored)
    if page is not None:
        from kinectbench.doctor.page import write_page

        write_page(diagnosis, look, page)
    if as_json:
        findings = [asdict(found) for found in diagnosis.findings]
        typer.echo(json.dumps({"verdict": diagnosis.verdict, **diagnosis.facts, "findings": findings}))
    else:
        _show(diagnosis)
        if page is not None:
            typer.echo(f"page: {page.resolve()}")
    if diagnosis.stops:
        raise typer.Exit(CANNOT_BE_USED)


def _of_benchmark(name: str) -> "RecordingSettings | None":
    """The recording of that id of the benchmark here; None if there is none, or another path of that name."""
    if not DEFAULT_CONFIG.is_file():
        return None
    if Path(name).exists() or "/" in name:
        return None
    settings, _ = open_benchmark(DEFAULT_CONFIG, None)
    return next((known for known in settings.recordings if known.id == name), None)


def _show(diagnosis: "Diagnosis") -> None:
    from rich.text import Text

    from kinectbench import console
    from kinectbench.doctor.figures import figures

    for name, value in figures(diagnosis.facts):
        typer.echo(f"{name}: {value}")
    for found in diagnosis.findings:
        head = Text(f"{found.severity}: {found.name}: ", style=STYLES[found.severity])
        advice = f"; {found.advice}" if found.advice else ""
        # What recordings say of themselves comes from strangers: never markup.
        console.out.print(Text.assemble(head, found.what, advice), highlight=False, soft_wrap=True)
    typer.echo(f"verdict: {diagnosis.verdict}")
