"""`kinectbench segment`: find the object, or suggest boxes to choose it from."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinectbench.cli import console
from kinectbench.cli.build import build_recordings, chosen_jobs, exit_status, run_stage
from kinectbench.cli.common import SOME_FAILED, Common, Ids, takes
from kinectbench.core import SettingsError, read_plain_text

if TYPE_CHECKING:
    from kinectbench.core.artefacts.object import CandidatesFile


@takes("config", "overrides", "jobs", "force", "wait", "verbose", "as_json")
def segment_command(
    common: Common,
    ids: Ids = None,
    suggest: Annotated[
        bool, typer.Option("--suggest", help="list boxes to choose the object from, with a picture each")
    ] = False,
    pick: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="NUMBER",
            help="only write this box of --suggest to benchmark.yaml; name one recording",
        ),
    ] = None,
    carry_masks: Annotated[
        bool,
        typer.Option("--carry-masks", help="name hand-drawn masks by the frames that they were drawn on"),
    ] = False,
) -> int:
    """Find floor and object, and make the object solid."""
    if suggest + (pick is not None) + carry_masks > 1:
        raise SettingsError(
            "segment: --suggest lists boxes, --pick takes one, --carry-masks renames masks: give one of them"
        )
    if carry_masks:
        return _carry_masks(common, ids)
    if suggest:
        return _suggest(common, ids)
    if pick is not None:
        return _pick(common, ids, pick)
    return run_stage(common, "segment", ids)


def _suggest(common: Common, ids: list[str] | None) -> int:
    from kinectbench.engine.stages import SUGGEST

    rows = build_recordings(common, ids, SUGGEST.name, (SUGGEST.name,) if common.force else ())
    listed = [None if row.error else _candidates(common.root, row.recording) for row in rows]
    if common.as_json:
        values = [None if each is None else each.json_value() for each in listed]
        both = zip(rows, values, strict=True)
        console.say_json([{**row.summary.json_value(), "candidates": boxes} for row, boxes in both])
    else:
        for row, each in zip(rows, listed, strict=True):
            if each is not None:
                _show(row.recording, each)
    return exit_status(rows)


def _carry_masks(common: Common, ids: list[str] | None) -> int:
    """Do the work of `--carry-masks`: rename hand-drawn masks after the frames that they were drawn on."""
    from kinectbench.engine.drawn_masks import carry_masks

    root = common.root  # masks in a store are not renamed
    rows = build_recordings(common, ids, "ingest", ("ingest",) if common.force else ())
    failed = {row.recording for row in rows if row.error}
    entries = []
    for job in chosen_jobs(common, ids):
        name = job.recording.id
        if name in failed:
            continue
        moved, left = carry_masks(replace(job, root=root))
        entries.append({"recording": name, "moved": dict(moved), "left": left})
        if not common.as_json:
            lines = [f"{name}: {old} is now {new}" for old, new in moved]
            console.say(*lines or [f"{name}: no mask has another name now"])
        console.recording_lines(name, "error", left, "red")
    if common.as_json:
        console.say_json(entries)
    return exit_status(rows) or (SOME_FAILED if any(each["left"] for each in entries) else 0)


def _candidates(root: Path, recording: str) -> "CandidatesFile":
    """Read a recording's candidates.json; make paths of pictures relative to the working folder."""
    from kinectbench.core.artefacts.object import CandidatesFile
    from kinectbench.engine.stages import SUGGEST

    folder = root / "build" / recording / SUGGEST.folder
    listed = CandidatesFile.read(folder)
    rows = [row.model_copy(update={"picture": str(folder / row.picture)}) for row in listed.candidates]
    return listed.model_copy(update={"plan": str(folder / listed.plan), "candidates": tuple(rows)})


def _show(recording: str, listed: "CandidatesFile") -> None:
    from kinectbench.settings.edit import box_line
    from kinectbench.stages.segment.find.object import NO_FLOOR

    console.say(f"{recording}: from above {listed.plan}")
    if not listed.floor_found:
        console.say(f"  {NO_FLOOR}")
    for each in listed.candidates:
        size = " x ".join(f"{edge:.2f}" for edge in each.box.size_m)
        chosen = ", chosen without a box" if each.automatic else ""
        console.say(f"  {each.number}: {size} m{chosen}, {each.picture}")
        console.say(f"     {box_line(each.box)}")
    console.say(f"`kinectbench segment {recording} --pick NUMBER` writes one to benchmark.yaml")


def _pick(common: Common, ids: list[str] | None, number: int) -> int:
    """Do the work of `--pick`: write a candidate's box into benchmark.yaml, or into a file that it includes.

    Nothing is built here: run `build` afterwards.
    """
    from kinectbench.core import replaced_file
    from kinectbench.engine.pipeline import listed_box
    from kinectbench.settings.edit import file_of, with_box

    if not ids or len(ids) != 1:
        raise SettingsError("segment --pick: name the one recording that the box is of")
    (job,) = chosen_jobs(common, ids)
    box = listed_box(job, number)
    path = file_of(common.config, ids[0], box)
    text = with_box(read_plain_text(path), str(path), ids[0], box)
    with replaced_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    message = f"wrote box {number} of {ids[0]} to {path}; `kinectbench build {ids[0]}` uses it"
    common.tell({"recording": ids[0], "box": box.json_value(), "file": str(path)}, [message])
    return 0
