"""The command `compare-truth`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinectbench.cli import console
from kinectbench.cli.build import build_recordings, chosen_jobs, exit_status
from kinectbench.cli.common import CANNOT_BE_USED, SOME_FAILED, Common, Ids, takes
from kinectbench.cli.progress_bars import progress_bar
from kinectbench.core import KinectBenchError, SettingsError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from kinectbench.core.artefacts.reference import ComparedMesh, ReferenceFile

COLUMNS = {
    "recording": "recording",
    "reference": "reference",
    "f_score_5mm": "F at 5 mm",
    "f_score_10mm": "F at 10 mm",
    "iou": "IoU",
    "residual": "off by",
    "pose": "pose",
}
LEGEND = (
    "F: of the surface that both saw; IoU: of the solids, where the truth is known; "
    "off by: the mean distance, both ways"
)
# Keys of this run's mesh that --json prints; a refused mesh is among the `others`.
COMPARED = ("reference", "sha256", "refused")
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
    """Compare built objects with meshes that a scanner measured or somebody drew; write reference.json."""
    from kinectbench.lab.evaluate.reference import compare_reference

    paths = _references(common, ids, reference, references)
    without = [job.recording.id for job in chosen_jobs(common, ids) if job.recording.id not in paths]
    console.lines("note", [f"{name}: no mesh of it in {references}" for name in without], "yellow")
    rows = build_recordings(common, list(paths), "segment")
    built = [row.recording for row in rows if not row.error]
    found: dict[str, tuple[ComparedMesh, ReferenceFile]] = {}
    failed = []
    with progress_bar("compare-truth") as progress:
        for done, name in enumerate(built, 1):
            try:
                found[name] = compare_reference(common.root / "build" / name, paths[name])
            except KinectBenchError as error:
                failed += [f"{name}: {line}" for line in error.lines]
            progress(done, len(built))
    if common.as_json:
        console.say_json({name: _in_json(new, whole) for name, (new, whole) in found.items()})
    else:
        _say_table(found)
    refused = [_refusal(name, new) for name, (new, _) in found.items() if new.refused]
    same = [
        f"{name}: {new.reference} is this very truth: it is compared with itself, which proves nothing"
        for name, (new, _) in found.items()
        if new.itself
    ]
    earlier = [
        f"{_refusal(name, each)}; to forget that, delete build/{name}/reference.json and compare again"
        for name, (new, whole) in found.items()
        for each in whole.all
        if each.refused and each.sha256 != new.sha256
    ]
    console.lines("note", [*same, *earlier], "yellow")
    console.lines("error", [*refused, *failed], "red")
    status = exit_status(rows)
    if not refused and not failed:
        return status
    return SOME_FAILED if len(found) > len(refused) else CANNOT_BE_USED


def _in_json(new: "ComparedMesh", whole: "ReferenceFile") -> dict[str, object]:
    """Return as JSON the comparison with all meshes so far, and which mesh this run compared."""
    return {**whole.json_value(), "compared": {key: getattr(new, key) for key in COMPARED}}


def _refusal(name: str, of: "ComparedMesh") -> str:
    return f"{name}: {of.reference} is refused: {of.refused}"


def _say_table(found: "Mapping[str, tuple[ComparedMesh, ReferenceFile]]") -> None:
    """Print a table of all comparisons, from this run and earlier ones, whose mesh fits the object."""
    shown = [_row(name, each) for name, (_, whole) in found.items() for each in whole.all if not each.refused]
    if shown:
        console.out.print(console.text_table(shown, COLUMNS, FORMS))
        console.say(LEGEND)


def _references(
    common: Common, ids: list[str] | None, reference: Path | None, references: Path | None
) -> dict[str, Path]:
    """Return {recording id: path of its reference mesh}, from --reference or --references.

    Raises:
        SettingsError: not exactly one of the two is given, or --reference is given for several recordings.
    """
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


def _row(name: str, found: "ComparedMesh") -> dict[str, object]:
    """Return a row of the printed table as {column key: value}."""
    other, pose = found.runner_up, "one"
    if found.symmetric_axis_floor is not None:
        pose = "any turn about its axis of symmetry"
    elif other is not None and other.fits_as_well:
        pose = f"or turned by {other.json_value()['turn_deg']:.0f}°, which fits as well"
    if found.mirror_fits_as_well:
        pose += "; its mirror image fits as well"
    return {
        "recording": name,
        "reference": found.reference,
        "f_score_5mm": found.f_score_5mm,
        "f_score_10mm": found.f_score_10mm,
        "iou": found.iou,
        "residual": f"{1000 * (found.residual_m or 0.0):.1f} mm",
        "pose": pose,
    }
