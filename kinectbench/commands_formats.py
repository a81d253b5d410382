"""The command that lists what can be read."""

import json

import typer

from kinectbench.commands import Json


def formats(as_json: Json = False) -> None:
    """List the formats of recordings that are read, what tells each, and on what it was verified."""
    from kinectbench.ingest.registry import FORMATS, reader_of

    rows = [
        {"format": name, "is": reader_of(name).looks_for, "verified": reader_of(name).verified or None}
        for name in FORMATS
    ]
    if as_json:
        typer.echo(json.dumps(rows))
        return
    for row in rows:
        typer.echo(f"{row['format']}: {row['is']}")
        typer.echo(f"    verified on: {row['verified'] or 'nothing real; written from documents only'}")
