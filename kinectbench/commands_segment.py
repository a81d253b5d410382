"""The command `segment`: the object, or boxes to choose it from."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinectbench.commands import (
    DEFAULT_CONFIG,
    Config,
    Force,
    Ids,
    Jobs,
    Json,
    Set,
    build_recordings,
    exit_for,
    open_benchmark,
    run_stage,
)
from kinectbench.errors import SettingsError

if TYPE_CHECKING:
    from kinectbench.config import BenchmarkSettings


def segment(
    ids: Ids = None,
    config: Config = DEFAULT_CONFIG,
    overrides: Set = None,
    jobs: Jobs = None,
    force: Force = False,
    suggest: Annotated[
        bool, typer.Option("--suggest", help="list boxes to choose the object from, with a picture each")
    ] = False,
    pick: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="NUMBER", help="write this box of --suggest to benchmark.yaml; name one recording"
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Find floor and object, and make the object solid; or list what it could be."""
    if suggest and pick is not None:
        raise SettingsError("segment: --suggest lists boxes, --pick takes one: give one of them")
    if suggest:
        _suggest(ids, config, overrides, jobs, force, as_json)
        return
    if pick is not None:
        _pick(ids, config, overrides, pick)
    run_stage("segment", ids, config, overrides, jobs, force, as_json)


def _suggest(
    ids: list[str] | None,
    config: Path,
    overrides: list[str] | None,
    jobs: int | None,
    force: bool,
    as_json: bool,
) -> None:
    from kinectbench.stages import SUGGEST

    settings, root = open_benchmark(config, overrides)
    rows = build_recordings(settings, root, ids, SUGGEST.name, jobs, (SUGGEST.name,) if force else ())
    for row in rows:
        row["candidates"] = None if row["error"] else _candidates(root, row["recording"])
    if as_json:
        typer.echo(json.dumps(rows))
    else:
        for row in rows:
            if row["candidates"] is not None:
                _show(row["recording"], row["candidates"])
    exit_for(rows)


def _candidates(root: Path, recording: str) -> dict[str, Any]:
    """What candidates.json says, pictures as paths from here."""
    from kinectbench.segmentation.candidates_folder import CANDIDATES, read_candidates

    folder = root / "build" / recording / CANDIDATES
    content = read_candidates(folder)
    for each in (content, *content["candidates"]):
        key = "plan" if each is content else "picture"
        each[key] = str(folder / each[key])
    return content


def _show(recording: str, content: dict[str, Any]) -> None:
    from kinectbench.segmentation.candidates_folder import box_line

    typer.echo(f"{recording}: from above {content['plan']}")
    if not content["floor_found"]:
        typer.echo(
            "  no floor was found: z = 0 is the lowest surface in view, level as the cameras were held"
        )
    for each in content["candidates"]:
        size = " x ".join(f"{edge:.2f}" for edge in each["box"]["size_m"])
        chosen = ", chosen without a box" if each["automatic"] else ""
        typer.echo(f"  {each['number']}: {size} m{chosen}, {each['picture']}")
        typer.echo(f"     {box_line(each['box'])}")
    typer.echo(f"`kinectbench segment {recording} --pick NUMBER` writes one to benchmark.yaml")


def _pick(ids: list[str] | None, config: Path, overrides: list[str] | None, number: int) -> None:
    """Write the box of a candidate that was listed before to benchmark.yaml."""
    from kinectbench.benchmark_edit import with_box
    from kinectbench.workspace import replaced_file

    settings, root = open_benchmark(config, overrides)
    if not ids or len(ids) != 1:
        raise SettingsError("segment --pick: name the one recording that the box is of")
    box = _listed_box(settings, root, ids[0], number)
    text = with_box(config.read_text(encoding="utf-8-sig"), str(config), ids[0], box)
    with replaced_file(config) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _listed_box(settings: "BenchmarkSettings", root: Path, recording: str, number: int) -> dict[str, Any]:
    """The box of that number, as it was listed for the recording as it is now."""
    from kinectbench.commands import chosen_jobs
    from kinectbench.pipeline import is_current
    from kinectbench.stages import SUGGEST

    (job,) = chosen_jobs(settings, root, [recording])
    if not is_current(job, SUGGEST.name):
        raise SettingsError(
            f"segment --pick: {recording} has no list of boxes, or an old one; "
            f"run `kinectbench segment {recording} --suggest` and look at the pictures first"
        )
    boxes = {each["number"]: each["box"] for each in _candidates(root, recording)["candidates"]}
    if number not in boxes:
        raise SettingsError(
            f"segment --pick: {recording} has boxes 1 to {len(boxes)}, none of number {number}"
        )
    return dict(boxes[number])
