"""The command that looks a recording over."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinectbench.commands import CANNOT_BE_USED, Json

if TYPE_CHECKING:
    from kinectbench.doctor import Diagnosis

STYLES = {"stops": "red", "warning": "yellow", "note": "dim"}


def inspect(
    recording: Annotated[Path, typer.Argument(help="folder or file")],
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

    camera = settings_from_options(CameraSettings, {}, overrides or [], "camera")
    diagnosis, look = look_over(recording, camera if overrides else None)
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


def _show(diagnosis: "Diagnosis") -> None:
    from rich.text import Text

    from kinectbench import console

    for name, value in diagnosis.facts.items():
        if value is not None:
            text = " ".join(f"{k} {v}" for k, v in value.items()) if isinstance(value, dict) else value
            typer.echo(f"{name.replace('_', ' ')}: {text}")
    for found in diagnosis.findings:
        head = Text(f"{found.severity}: {found.name}: ", style=STYLES[found.severity])
        advice = f"; {found.advice}" if found.advice else ""
        # What recordings say of themselves comes from strangers: never markup.
        console.out.print(Text.assemble(head, found.what, advice), highlight=False, soft_wrap=True)
    typer.echo(f"verdict: {diagnosis.verdict}")
