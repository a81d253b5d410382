"""Scoring in the camera frame: one view of a mesh of 100,000 faces, and a thousand views on two cores.

A release of balls and boxes is published. Each test view has a prediction: the true mesh, shifted and dented,
closed, and once more without one of its faces. One view is scored alone, under all four protocols; then all
views of the closed meshes, again and again, until there are `--views`. The load of the machine stands beside
the wall clock, which others at work make longer.

    python benchmarks/run.py score_camera --views 1000 --jobs 2
"""

import os
import time
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path

import fast_simplification
import numpy as np
import trimesh
from analytic_release import publish_analytic, true_in_camera
from builds import build_root
from figures import Figure, arguments, at_most, run, stated

from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.artefacts.score_figures import CLOSINGS, IN_SPACE
from kinectbench.release.release import Release, open_release
from kinectbench.scoring.camera.score_view import ViewJob, ViewResult, score_view
from kinectbench.scoring.camera.truth import files_of
from kinectbench.scoring.camera_predictions import CameraPredictionFile, find_files
from kinectbench.scoring.camera_shape import CameraShape, write_shape
from kinectbench.scoring.workers import run_tasks

FACES = 100_000
METHOD = MethodFile(name="m", frame="camera", form="mesh")
# The bars: seconds of one core for a view, and of two for a thousand views.
MAX_VIEW_S, MAX_THOUSAND_S = 0.5, 300.0
# A view is scored so often; the fastest counts, as others are at work on the machine. Closing takes longer.
TIMES, TIMES_CLOSED = 5, 2
# What is predicted: not the truth, so that the registrations have their steps to do. Metres, and 1 / m.
SHIFT_M, DENTS_M, WAVES = (0.01, 0.005, -0.01), 0.008, 11.0


def predict(root: Path) -> Release:
    """Publish the release, and write the predictions."""
    publish_analytic(root)
    release = open_release(root / "benchmark")
    for target in release.split("test"):
        true = true_in_camera(target.recording, target.category, target.view)
        mesh = trimesh.Trimesh(true.points_m, true.faces)
        while len(mesh.faces) < FACES:
            mesh = mesh.subdivide()
        dented = mesh.vertices + DENTS_M * np.sin(WAVES * mesh.vertices[:, [1, 2, 0]]) + SHIFT_M
        vertices, faces = fast_simplification.simplify(dented, mesh.faces, target_count=FACES)
        for name, kept in (("closed", faces), ("open", faces[1:])):
            write_shape(CameraShape("mesh", vertices, kept.astype(np.int64)), root / name / target.name)
    return release


def jobs_of(release: Release, folder: Path) -> list[ViewJob]:
    """One for each test view."""
    return [
        ViewJob(target, files_of(release, target), (file,), METHOD, IN_SPACE)
        for target, _, file in find_files(folder, release.split("test"), METHOD)
        if isinstance(file, CameraPredictionFile)
    ]


def view_s(job: ViewJob, solid: bool, times: int) -> float:
    """Seconds of the processor for one view: the fastest of some runs, of which the first compiles."""
    taken = []
    for _ in range(times):
        started = time.process_time()
        found = score_view(job)
        taken.append(time.process_time() - started)
        assert isinstance(found, ViewResult) and (found.rows[0].figures.voxels.iou is not None) == solid
    return min(taken)


def measure(root: Path, views: int, jobs: int) -> list[Figure]:
    release = predict(root)
    closed, opened = (jobs_of(release, root / name)[0] for name in ("closed", "open"))
    figures = [
        at_most("cpu of a view, closed mesh, s", view_s(closed, True, TIMES), MAX_VIEW_S),
        at_most("cpu of a view, open mesh, s", view_s(opened, False, TIMES), MAX_VIEW_S),
        *(
            stated(
                f"the same with --close {close}, s", view_s(replace(opened, close=close), True, TIMES_CLOSED)
            )
            for close in CLOSINGS
        ),
    ]
    tasks = list(islice(cycle(jobs_of(release, root / "closed")), views))
    before, used, started = os.getloadavg()[0], _cpu_s(), time.monotonic()
    found = run_tasks(score_view, tasks, jobs)
    wall_s, cpu_s = time.monotonic() - started, _cpu_s() - used
    assert all(isinstance(one, ViewResult) for one in found)
    return [
        *figures,
        stated("views, processes", [views, jobs]),
        at_most("wall clock, s", wall_s, MAX_THOUSAND_S * views / 1000),
        stated("load of the machine before, and after", [before, os.getloadavg()[0]]),
        stated("cpu of all processes, s; of a view", [cpu_s, cpu_s / views]),
    ]


def _cpu_s() -> float:
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--views", type=int, default=1000, help="of the run of many (default: 1000)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: 2)")
    options = parser.parse_args()
    with build_root(None) as root:
        run(options, lambda: measure(root, options.views, options.jobs))


if __name__ == "__main__":
    main()
