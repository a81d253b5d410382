"""`kinectbench evaluate`: from two folders to evaluation.json, pictures and a page."""

from pathlib import Path

from kinectbench.errors import StorageError
from kinectbench.evaluate import charts
from kinectbench.evaluate.build import Build, read_build
from kinectbench.evaluate.evaluation import Evaluation, Progress, evaluate, evaluation_json
from kinectbench.evaluate.page import make_page
from kinectbench.evaluate.registration import register
from kinectbench.evaluate.solid import canonical_cube, compare_on
from kinectbench.evaluate.surface import surface_errors
from kinectbench.geometry import invert_rigid, transform_points
from kinectbench.simulate.truth import Truth, read_truth
from kinectbench.tracking.compare import has_pose
from kinectbench.workspace import pretty_json, replaced_folder

FIGURES = "evaluation.json"
PAGE = "index.html"


def evaluate_recording(
    build: Path, truth: Path, out: Path, *, align: bool = True, progress: Progress | None = None
) -> Evaluation:
    """Measure what was built of a recording against its truth, and write figures, pictures and a page.

    Args:
        build: `build/<recording>/`; any later stage may be missing.
        truth: folder of the simulator's truth.
        out: folder to write: evaluation.json, index.html and the pictures it shows; an earlier evaluation
            there is replaced, in whole or not at all.
        align: lay the build's world onto the truth's by the trajectories.
        progress: called with (pairs done, pairs in all).

    Raises:
        StorageError: nothing is built, an artefact is damaged, or `out` holds something else.
        RecordingError: there is no readable truth, or it is of another recording.
        PairError: a pair is damaged.
    """
    if out.exists() and not _replaceable(out):
        raise StorageError(f"{out}: holds something else than an evaluation; choose a new or empty folder")
    built, true = read_build(build), read_truth(truth)
    evaluation = evaluate(built, true, align=align, progress=progress)
    pictures = make_pictures(built, true, evaluation, align)
    page = make_page(build.resolve().name, evaluation, pictures)
    with replaced_folder(out) as temporary:
        (temporary / FIGURES).write_text(pretty_json(evaluation_json(evaluation)), encoding="utf-8")
        (temporary / PAGE).write_text(page, encoding="utf-8")
        for name, png in pictures.items():
            (temporary / f"{name}.png").write_bytes(png)
    return evaluation


def make_pictures(build: Build, truth: Truth, evaluation: Evaluation, align: bool) -> dict[str, bytes]:
    """The pictures of an evaluation as far as their stages were built: name -> PNG file."""
    registration = register(build, truth, align)
    T_object_world = invert_rigid(truth.T_world_object)
    true_object = truth.mesh_world.transformed(T_object_world)
    pictures = {}
    error = evaluation.trajectory.error if evaluation.trajectory else None
    if build.trajectory is not None and error is not None:
        common = has_pose(build.trajectory.T_world_camera) & registration.shown
        aligned = T_object_world @ error.T_reference_estimate @ build.trajectory.T_world_camera[common]
        pictures["path"] = charts.path_picture(
            transform_points(T_object_world, truth.T_world_camera[:, :3, 3]),
            aligned[:, :3, 3],
            error.position_errors_m,
            transform_points(T_object_world, truth.surface.points_world)[:, :2],
        )
    if build.model is not None:
        mesh_truth = build.model.shape.mesh.transformed(registration.T_truth_built)
        pictures["meshes"] = charts.mesh_picture(mesh_truth.transformed(T_object_world), true_object)
        pictures["errors"] = charts.error_picture(surface_errors(mesh_truth, truth))
        solids = compare_on(canonical_cube(truth), build.model, truth, registration)
        pictures["slices"] = charts.slice_picture(solids)
    return pictures


def _replaceable(out: Path) -> bool:
    return out.is_dir() and ((out / FIGURES).is_file() or not any(out.iterdir()))
