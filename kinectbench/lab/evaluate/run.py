"""`kinectbench evaluate`: find a build and its truth, and write evaluation.json, pictures and a page."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from kinectbench._version import __version__
from kinectbench.core import RecordingError, SettingsError, StorageError, pretty_json, replaced_folder
from kinectbench.core.geometry import invert_rigid, transform_points
from kinectbench.core.pages import png_uri, render_page
from kinectbench.core.trajectory.compare import has_pose
from kinectbench.core.types import Progress, no_progress
from kinectbench.engine.stages import Job
from kinectbench.lab.evaluate import charts
from kinectbench.lab.evaluate.build import Build, read_build, register_build
from kinectbench.lab.evaluate.evaluation import Evaluation, evaluate, evaluation_json
from kinectbench.lab.evaluate.solid import canonical_cube, compare_on
from kinectbench.lab.evaluate.surface import surface_errors
from kinectbench.lab.evaluate.table import sections
from kinectbench.lab.simulate.truth import Truth, read_truth, truth_folder
from kinectbench.settings.file import load_benchmark, parse_benchmark
from kinectbench.settings.words import suggestion

CAPTIONS = {
    "path": "Cameras from above, the true object's axes. Grey: true path. Dots: built positions, aligned.",
    "meshes": "Above: the built mesh, red where it is too far out, blue where too far in. Below: the true "
    "mesh, dark where the built one is far away. The last look is from below.",
    "errors": "Left: signed distances of the built surface from the true one. Right: shares of the built "
    "(precision) and true (recall) surface within a distance; dashed: of what the camera saw.",
    "slices": "Slices of the upright cube, 256 cells a side, through the true solid's centre of mass.",
}
FIGURES = "evaluation.json"
PAGE = "index.html"


@dataclass(frozen=True)
class FoundRecording:
    """A recording to evaluate: where its build and its truth are.

    Attributes:
        build: the folder `build/<recording>/`.
        truth: the folder of the simulator's truth.
        job: the job that brings the build up to date; None if only a build folder is known.
    """

    build: Path
    truth: Path
    job: Job | None


def find_built(recording: str, truth: Path | None, config: Path, overrides: Sequence[str]) -> FoundRecording:
    """Find a recording and its truth, before anything is built.

    Args:
        recording: an id of the benchmark at `config`, or the folder of a build, or a recording's path. If the
            benchmark lists this path, the job has the benchmark's settings. Else the job has default settings
            and builds into `build/` in the working folder.
        truth: the truth's folder; None: the folder `<recording>.truth` beside the recording.
        config: a benchmark.yaml, which need not exist.
        overrides: settings that replace the file's, each `SECTION.KEY=VALUE`.

    Raises:
        SettingsError: there is no such recording, the settings are wrong, the truth is not known, or a build
            of the benchmark would be replaced.
        RecordingError: the folder holds no truth.
    """
    build = _find(recording, truth, config, overrides)
    if not (build.truth / "truth.json").is_file():
        raise RecordingError(
            f"{build.truth}: no truth there; name its folder, or simulate the recording again",
            what="no-truth",
        )
    return build


def folder_beside(build: Path) -> Path:
    """Return `evaluation/<recording>/` beside the `build/` that holds a build's folder.

    The folder may be relative, such as `.` or `chair`.
    """
    whole = build.absolute()
    return whole.parent.parent / "evaluation" / whole.name


def _find(recording: str, truth: Path | None, config: Path, overrides: Sequence[str]) -> FoundRecording:
    settings = load_benchmark(config, overrides) if config.is_file() else None
    jobs = [Job(settings, each, config.parent) for each in settings.recordings] if settings else []
    known = {job.recording.id: job for job in jobs}
    path = Path(recording)
    if recording in known:
        job = known[recording]
        return FoundRecording(job.build, truth or truth_folder(job.source), job)
    if (path / "sequence").is_dir():
        return FoundRecording(path, truth or _truth_of_build(path, jobs), None)
    if path.exists():
        listed = [job for job in jobs if job.source.resolve() == path.resolve()]
        job = listed[0] if listed else _job_of(path, overrides)
        if len(listed) > 1 or (not listed and job.build.resolve() in {each.build.resolve() for each in jobs}):
            raise SettingsError(f"{recording}: {config} has other settings for it; name one of its ids")
        return FoundRecording(job.build, truth or truth_folder(path), job)
    hint = "give a simulated recording's path, or an id and --config"
    raise SettingsError(
        f"no recording '{recording}'; {suggestion(recording, [*known]) if known else hint}",
        what="no-recording",
    )


def _truth_of_build(build: Path, jobs: Sequence[Job]) -> Path:
    """Return the truth's folder of a build: the one beside the recording from which it was built."""
    for job in jobs:
        if job.build.resolve() == build.resolve():
            return truth_folder(job.source)
    raise SettingsError(
        f"{build}: its truth is not known; name the folder: kinectbench evaluate {build} TRUTH"
    )


def _job_of(path: Path, overrides: Sequence[str]) -> Job:
    """Return a job that builds the recording at a path with default settings and overrides."""
    plain = re.sub(r"[^A-Za-z0-9._-]", "_", path.resolve().name.removesuffix(".bag"))
    name = (plain.lstrip("._-") or "recording")[:80]
    recording = {"id": name, "path": str(path), "category": "object"}
    settings = parse_benchmark(json.dumps({"name": name, "recordings": [recording]}), "settings", overrides)
    return Job(settings, settings.recordings[0], Path())


def make_page(name: str, evaluation: Evaluation, pictures: Mapping[str, bytes]) -> str:
    """Return the evaluation's page as HTML text; the same input gives the same text.

    `pictures` are {key of `CAPTIONS`: PNG file}; some may be missing.
    """
    shown = {
        "name": name,
        "evaluation": evaluation,
        "sections": sections(evaluation),
        "pictures": [(png_uri(pictures[key]), CAPTIONS[key]) for key in CAPTIONS if key in pictures],
        "version": __version__,
    }
    return render_page("lab/evaluate/page.html", shown)


def evaluate_recording(
    build: Path, truth: Path, out: Path, *, align: bool = True, progress: Progress = no_progress
) -> Evaluation:
    """Compare a recording's build with its truth, and write metrics, pictures and a page.

    Args:
        build: `build/<recording>/`; any later stage may be missing.
        truth: the folder of the simulator's truth.
        out: the folder for evaluation.json, index.html and its pictures; an earlier evaluation is replaced,
            as a whole or not at all.
        align: whether to align the build's world with the truth's by the trajectories.
        progress: called with (pairs done, pairs in all).

    Raises:
        StorageError: nothing is built, an artefact is damaged, or `out` holds something else.
        RecordingError: there is no readable truth, or it is of another recording.
        PairError: a pair is damaged.
    """
    if out.exists() and not _replaceable(out):
        raise StorageError(
            f"{out}: holds something else than an evaluation; choose a new or empty folder",
            what="other-content",
        )
    built = read_build(build)
    true = replace(read_truth(truth), limits=built.limits)
    evaluation = evaluate(built, true, align=align, progress=progress)
    pictures = _make_pictures(built, true, evaluation, align)
    page = make_page(build.resolve().name, evaluation, pictures)
    with replaced_folder(out) as temporary:
        (temporary / FIGURES).write_text(pretty_json(evaluation_json(evaluation)), encoding="utf-8")
        (temporary / PAGE).write_text(page, encoding="utf-8")
        for name, png in pictures.items():
            (temporary / f"{name}.png").write_bytes(png)
    return evaluation


def _make_pictures(build: Build, truth: Truth, evaluation: Evaluation, align: bool) -> dict[str, bytes]:
    """Return {key of `CAPTIONS`: PNG file}, without pictures of stages that were not built."""
    registration = register_build(build, truth, align)
    T_object_world = invert_rigid(truth.T_world_object)
    true_object = truth.mesh_world.transformed(T_object_world)
    pictures = {}
    error = evaluation.trajectory.error if evaluation.trajectory else None
    if build.trajectory is not None and error is not None:
        common = has_pose(build.trajectory.T_world_camera) & registration.shown
        aligned = T_object_world @ error.T_reference_estimate @ build.trajectory.T_world_camera[common]
        pictures["path"] = charts.path_chart(
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
    ours = {FIGURES, PAGE, *(f"{name}.png" for name in CAPTIONS)}
    return out.is_dir() and all(path.name in ours for path in out.iterdir())
