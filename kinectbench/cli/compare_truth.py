"""The command `compare-truth`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinectbench.cli.build import build_recordings, chosen_jobs, exit_status
from kinectbench.cli.common import SOME_FAILED, Common, Ids, takes
from kinectbench.core.errors import KinectBenchError, SettingsError

if TYPE_CHECKING:
    from kinectbench.core.artefacts.reference import ReferenceFile

COLUMNS = {
    "recording": "recording",
    "reference": "reference",
    "f_score_5mm": "F at 5 mm",
    "f_score_10mm": "F at 10 mm",
    "iou": "IoU",
    "residual": "off by",
    "pose": "pose",
}
FORMS = {"f_score_5mm": ".3f", "f_score_10mm": ".3f", "iou": ".3f"}


@takes("config", "overrides", "jobs", "as_json")
def compare_truth_command(
    common: Common,
    ids: Ids = None,
    reference: Annotated[
        Path | None, typer.Option(metavar="MESH", help="the mesh of the one recording that is named, metres")
    ] = None,
    references: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="meshes named as the recordings or their objects")
    ] = None,
) -> int:
    """Hold what was built against meshes that a scanner measured or somebody drew: reference.json."""
    from kinectbench.cli import console
    from kinectbench.lab.evaluate.reference import compare_reference

    paths = _references(common, ids, reference, references)
    without = [job.recording.id for job in chosen_jobs(common, ids) if job.recording.id not in paths]
    console.lines("note", [f"{name}: no mesh of it in {references}" for name in without], "yellow")
    rows = build_recordings(common, list(paths), "segment")
    built = [row.recording for row in rows if not row.error]
    found: dict[str, ReferenceFile] = {}
    failed = []
    with console.progress_bar("compare-truth") as progress:
        for done, name in enumerate(built, 1):
            try:
                found[name] = compare_reference(common.root / "build" / name, paths[name])
            except KinectBenchError as error:
                failed += [f"{name}: {line}" for line in error.lines]
            progress(done, len(built))
    refused = [
        f"{name}: {each.reference} is refused: {each.refused}" for name, each in found.items() if each.refused
    ]
    if common.as_json:
        console.say_json({name: each.json_value() for name, each in found.items()})
    else:
        shown = [_row(name, each) for name, each in found.items() if not each.refused]
        if shown:
            console.out.print(console.text_table(shown, COLUMNS, FORMS))
    same = [
        f"{name}: {each.reference} is this very truth: it is compared with itself, which proves nothing"
        for name, each in found.items()
        if each.itself
    ]
    console.lines("note", same, "yellow")
    console.lines("error", [*refused, *failed], "red")
    return exit_status(rows) or (SOME_FAILED if refused or failed else 0)


def _references(
    common: Common, ids: list[str] | None, reference: Path | None, references: Path | None
) -> dict[str, Path]:
    """The mesh of each recording."""
    from kinectbench.lab.evaluate.reference import find_references

    names = {job.recording.id: job.recording.object_name for job in chosen_jobs(common, ids)}
    if (reference is None) == (references is None):
        raise SettingsError("compare-truth: give --reference MESH of one recording, or --references FOLDER")
    if references is not None:
        return find_references(references, names)
    if len(names) != 1:
        raise SettingsError("compare-truth --reference: name the one recording that the mesh is of")
    assert reference is not None
    return {next(iter(names)): reference}


def _row(name: str, found: "ReferenceFile") -> dict[str, object]:
    """A recording in the table."""
    other, pose = found.runner_up, "one"
    if found.symmetric_axis_floor is not None:
        pose = "any turn about its axis of symmetry"
    elif other is not None and other.fits_as_well:
        pose = f"or turned by {other.json_value()['turn_deg']:.0f}°, which fits as well"
    return {
        "recording": name,
        "reference": found.reference,
        "f_score_5mm": found.f_score_5mm,
        "f_score_10mm": found.f_score_10mm,
        "iou": found.iou,
        "residual": f"{1000 * (found.residual_m or 0.0):.1f} mm",
        "pose": pose,
    }
