"""The commands on recordings with known truth: `simulate`, `synthesize`, `evaluate` and `compare-truth`."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinectbench.cli import console
from kinectbench.cli.build import build_jobs, build_recordings, chosen_jobs, exit_status
from kinectbench.cli.common import CANNOT_BE_USED, SOME_FAILED, Common, Ids, takes
from kinectbench.cli.progress_bars import progress_bar, recording_bars
from kinectbench.core import KinectBenchError, SettingsError

if TYPE_CHECKING:
    from kinectbench.core.artefacts.reference import ComparedMesh, ReferenceFile


PRESET = "orbit-v1"
OBJECT = "such as chair:seed=3, of --families; default: the preset's, most chair:seed=0"
FRAMES = "number of frames; default: the preset's, most have 300"
SEED = "draws everything but the object; default: the preset's, most 0"
FORMAT = "tum (default; of a .bag: bag), folder, bag, bag_compressed, ros2_sqlite, ros2_mcap, or a plug-in's"


@takes("overrides", "jobs", "as_json")
def simulate_command(
    common: Common,
    out: Annotated[Path | None, typer.Argument(help="the recording: a folder, or a .bag")] = None,
    object_name: Annotated[str | None, typer.Option("--object", help=OBJECT)] = None,
    mesh: Annotated[Path | None, typer.Option(help="a mesh file in metres, instead of an object")] = None,
    preset: Annotated[str, typer.Option(help="see --presets")] = PRESET,
    frames: Annotated[int | None, typer.Option(min=1, help=FRAMES)] = None,
    seed: Annotated[int | None, typer.Option(min=0, help=SEED)] = None,
    form: Annotated[str | None, typer.Option("--format", help=FORMAT)] = None,
    presets: Annotated[bool, typer.Option("--presets", help="list the presets")] = False,
    families: Annotated[bool, typer.Option("--families", help="list the families of objects")] = False,
    contact_sheets: Annotated[
        Path | None, typer.Option(help="draw twelve objects of each family into this folder")
    ] = None,
    samples: Annotated[Path | None, typer.Option(help="write the sample recordings here")] = None,
    demo: Annotated[Path | None, typer.Option(help="write the demo's further recordings here")] = None,
) -> None:
    """Write a simulated recording, with the exact truth beside it in <name>.truth/."""
    from kinectbench.lab.simulate.objects import families as object_families
    from kinectbench.lab.simulate.presets import PRESETS, simulate_named
    from kinectbench.lab.simulate.truth import is_truth, read_truth, truth_folder

    if presets:
        width = max(map(len, PRESETS))
        rows = {name: text for name, (text, _) in PRESETS.items()}
        common.tell(rows, (f"{name:<{width}}  {text}" for name, text in rows.items()))
        return
    if families:
        common.tell(names := sorted(object_families()), names)
        return
    changes = _changes(object_name, mesh, frames, seed, form)
    others = bool(out or changes or common.overrides or preset != PRESET)
    _check_alone({"--contact-sheets": contact_sheets, "--samples": samples, "--demo": demo}, others)
    if contact_sheets is not None:
        from kinectbench.lab.simulate.objects.contact_sheets import write_contact_sheets

        common.tell_written(*write_contact_sheets(contact_sheets))
        return
    if out is not None and is_truth(truth_folder(out)):
        console.lines("note", [f"{out}: replaces the simulated recording that is there"], "yellow")
    with recording_bars() as progress:
        written = simulate_named(
            out,
            preset,
            changes,
            common.overrides or (),
            samples,
            demo,
            lambda name, *done: progress(name, "simulate", *done),
            common.workers,
        )
    if mesh is not None:
        console.lines(
            "note", [f"{mesh}: {read_truth(truth_folder(path)).origin}" for path in written], "yellow"
        )
    common.tell_written(*written)


def _changes(
    object_name: str | None, mesh: Path | None, frames: int | None, seed: int | None, form: str | None
) -> dict[str, object]:
    """Return the given options as {key of SimulationSpec: value}; each value replaces that of the preset."""
    if mesh is not None and object_name is not None:
        raise SettingsError("simulate: give --object or --mesh, not both")
    path = None if frames is None else {"frames": frames}
    given = {"object": object_name, "mesh": mesh and str(mesh), "path": path, "seed": seed, "format": form}
    return {key: value for key, value in given.items() if value is not None}


def _check_alone(folders: Mapping[str, Path | None], others: bool) -> None:
    """Refuse more than one of --contact-sheets, --samples and --demo, and any of them with other options.

    `folders` has the values of these three by name, None if not given. `others` tells whether any other
    option is given.
    """
    alone = [name for name, folder in folders.items() if folder is not None]
    if len(alone) > 1 or (alone and others):
        raise SettingsError(
            f"simulate: {alone[0]} stands alone: leave out OUT, the options of a recording and --set"
        )


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


@takes("config", "overrides", "as_json")
def evaluate_command(
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
    """Measure the build of a simulated recording against its truth: a table, JSON, pictures, a page."""
    from kinectbench.lab.evaluate.evaluation import evaluation_json
    from kinectbench.lab.evaluate.run import evaluate_recording, find_built, folder_beside
    from kinectbench.lab.evaluate.table import evaluation_table

    build = find_built(recording, truth, common.config, common.overrides or ())
    rows = build_jobs([build.job], "pairs", Common(jobs=1)) if build.job else []
    status = exit_status(rows)
    if status and not (build.build / "sequence").is_dir():
        return status
    target = out or folder_beside(build.build)
    with progress_bar("evaluate") as progress:
        result = evaluate_recording(build.build, build.truth, target, align=align, progress=progress)
    if common.as_json:
        console.say_json(evaluation_json(result))
    else:
        console.out.print(evaluation_table(result))
        console.say(f"page: {(target / 'index.html').resolve()}")
    return status


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
