"""What a stranger does wrong with predictions in the camera frame is said, and spoils nothing."""

import json
import os
from pathlib import Path

import analytic_release
import numpy as np
import pytest
import trimesh
from raising import raises
from small_benchmark import run_here

from kinectbench.core.errors import PredictionError, ReleaseError
from kinectbench.release.release import Release, open_release
from kinectbench.scoring import camera_predictions
from kinectbench.scoring.camera import score_camera_method as camera_score
from kinectbench.scoring.camera import surface
from kinectbench.scoring.camera_predictions import check_camera
from kinectbench.scoring.camera_shape import CameraShape, write_shape
from kinectbench.scoring.method_json import read_in_camera
from kinectbench.scoring.predictions import check
from kinectbench.scoring.read_table import read_table
from kinectbench.scoring.score import score, score_methods

NO_FACES = np.zeros((0, 3), np.int64)


@pytest.fixture(scope="module")
def published(analytic: Path) -> Release:
    """Two test pairs."""
    release = open_release(analytic / "benchmark")
    return Release(release.folder, release.split("test")[:2], release.metadata)


def written(published: Release, folder: Path, factor: float = 1.0, declared: bool = True) -> Path:
    """The true shapes, scaled."""
    folder.mkdir(parents=True)
    if declared:
        (folder / "method.json").write_text(json.dumps({"name": "net", "frame": "camera"}))
    for target in published.targets:
        shape = analytic_release.true_in_camera(target.recording, target.category, target.view)
        write_shape(CameraShape("mesh", shape.points_m * factor, shape.faces), folder / target.name)
    return folder


def test_a_run_without_any_score_keeps_the_earlier_ones(published: Release, tmp_path: Path) -> None:
    folder, out = written(published, tmp_path / "net"), tmp_path / "scores"
    score_methods(published, folder, out, protocols=["camera"])
    before = (out / "scores.json").read_bytes()
    for target in published.targets:
        (folder / f"{target.name}.ply").write_bytes(b"no mesh")
    with pytest.raises(PredictionError) as caught:
        score_methods(published, folder, out, protocols=["camera"])
    line = str(caught.value)
    assert "nothing could be scored: 2 views failed, the first: " in line and "\n" not in line
    assert line.endswith(f"the earlier scores in {out} are kept") and "threshold" not in line
    assert (out / "scores.json").read_bytes() == before
    # The same of predictions in cells.
    (folder / "method.json").unlink()
    with pytest.raises(PredictionError, match="nothing could be scored"):
        score_methods(published, folder, out, protocols=["known"])
    assert (out / "scores.json").read_bytes() == before


def test_the_command_says_it_in_one_line(
    analytic: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    release = open_release(analytic / "benchmark")
    folder = written(release, tmp_path / "net")
    for path in folder.glob("*/*.ply"):
        path.write_bytes(b"no mesh")
    arguments = ["score", str(folder), "--benchmark", str(analytic / "benchmark"), "--out", str(tmp_path)]
    done = run_here(monkeypatch, capsys, tmp_path, *arguments, "--jobs", "1")
    assert done.status != 0 and "nothing could be scored" in done.err and "Traceback" not in done.err


def test_score_says_what_check_would_say(published: Release, tmp_path: Path) -> None:
    right = score(published, written(published, tmp_path / "right"), method="n", protocols=["camera"])
    assert not right.warnings
    folder = written(published, tmp_path / "mm", 1000.0)
    found = score(published, folder, method="n", protocols=["camera"])
    (line,) = (line for line in found.warnings if "1000 times too far" in line)
    assert line.endswith("declare 'unit': 'mm' in method.json; `kinectbench check` looks at all")
    method = read_in_camera(folder)
    assert method is not None
    problems, _ = check_camera(published, folder, method)
    assert sum("declare 'unit': 'mm' in method.json" in line for line in problems) == 2


def test_check_and_score_doubt_a_whole_room(published: Release, tmp_path: Path) -> None:
    folder = written(published, tmp_path / "room")
    target = published.targets[0]
    shape = analytic_release.true_in_camera(target.recording, target.category, target.view)
    walls = np.random.default_rng(0).uniform(-3, 3, (50_000, 3)) + shape.points_m.mean(axis=0)
    (folder / f"{target.name}.ply").unlink()
    write_shape(
        CameraShape("points", np.concatenate([walls, shape.points_m]), NO_FACES), folder / target.name
    )
    method = read_in_camera(folder)
    assert method is not None
    problems, notes = check_camera(published, folder, method)
    said = "of it (bound 20%) lies far beyond the object: the whole scene? Keep the object alone"
    assert not problems
    assert notes[1].startswith(f"{target.name}: 8") and notes[1].endswith(said)
    assert notes[0].endswith("of the size of what it measured; up to 1% is well, beyond 10% is named")
    warned = score(published, folder, method="n", protocols=["camera"]).warnings
    assert f"{notes[1]}; `kinectbench check` looks at all" in warned


def test_check_names_a_closed_mesh_whose_solid_score_refuses(published: Release, tmp_path: Path) -> None:
    """The right shape, and a ball 50 m away: no slip of unit or axes explains it."""
    folder = written(published, tmp_path / "stray")
    target = published.targets[0]
    own = analytic_release.true_in_camera(target.recording, target.category, target.view)
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    points = np.concatenate([own.points_m, np.add(ball.vertices, [0, 0, 50.0])])
    faces = np.concatenate([own.faces, ball.faces + len(own.points_m)])
    (folder / f"{target.name}.ply").unlink()
    write_shape(CameraShape("mesh", points, faces.astype(np.int64)), folder / target.name)
    method = read_in_camera(folder)
    assert method is not None
    problems, notes = check_camera(published, folder, method)
    (line,) = problems
    assert line.startswith(f"{target.name}: lies more than ") and line.endswith("keep the object alone")
    assert not any(target.name in note for note in notes)
    failures = score(published, folder, method="n", protocols=["camera"]).failures
    assert [f"{one.recording}/{one.view}" for one in failures] == [target.name]


def test_what_refuses_all_does_so_before_hours_of_scoring(
    published: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A damaged depth image, and a subfolder that cannot be listed."""
    folder, scandir, scored = written(published, tmp_path / "net"), os.scandir, list[str]()

    def damaged(*_: object) -> None:
        raise ReleaseError("views/a/000.depth.png: damaged")

    def locked(path: Path) -> object:
        if Path(path).name == "locked":
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(camera_score, "run_tasks", lambda *_: scored.append("all"))
    with monkeypatch.context() as patched, raises(ReleaseError, "release.damaged"):
        patched.setattr(camera_predictions, "view_agreement", damaged)
        score(published, folder, method="n", protocols=["camera"])
    (folder / "locked").mkdir()
    monkeypatch.setattr(os, "scandir", locked)
    with raises(PredictionError, "prediction.unreadable", match="locked: cannot be looked into"):
        score(published, folder, method="n", protocols=["camera"])
    assert not scored


def test_a_truth_with_too_many_faces_is_named(
    published: Release, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = written(published, tmp_path / "net")
    monkeypatch.setattr(surface, "MOST_SAMPLES", 10)
    with raises(ReleaseError, "release.too-large", match=f"{published.targets[0].name}.npz: the truth has"):
        score(published, folder, method="n", protocols=["camera"])


def test_a_mesh_in_the_camera_frame_without_a_declaration_is_answered(
    published: Release, tmp_path: Path
) -> None:
    folder = written(published, tmp_path / "net", declared=False)
    problems = check(published, folder)
    assert len(problems) == 2
    assert all("declare 'frame': 'camera' in method.json" in line for line in problems)


def test_views_of_which_nothing_is_predicted_are_counted(
    analytic: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the page has no table of the paper, which scores cells alone."""
    release = open_release(analytic / "benchmark")
    folder = written(release, tmp_path / "net")
    target = release.split("test")[0]
    (folder / f"{target.name}.ply").unlink()
    arguments = ["score", str(folder), "--benchmark", str(analytic / "benchmark"), "--protocol", "camera"]
    arguments += ["--out", str(tmp_path / "s"), "--jobs", "1", "--missing", "empty", "--no-baselines"]
    done = run_here(monkeypatch, capsys, tmp_path, *arguments)
    assert done.status == 0, done.err
    assert "net (1 empty)" in " ".join(done.out.split()) and "(n empty): views" in done.out
    assert read_table(tmp_path / "s" / "scores.json").missing_as_empty == (target.name,)
    assert "published, not comparable" not in (tmp_path / "s" / "index.html").read_text()
