"""`kinectbench track --compare FILE`, as a user gives it."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from read_pictures import read_picture
from small_benchmark import Run, copied, hashes, small_spec

from kinectbench.core.geometry import rigid, rotation_from_quaternion_xyzw
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.trajectory_file import read_trajectory_file, trajectory_text
from kinectbench.engine.pipeline import build_recording
from kinectbench.engine.stages import Job
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.truth import read_truth
from kinectbench.settings.file import load_benchmark

Command = Callable[..., Run]
FRAMES = 12
YAML = """\
name: small
recordings:
  - {id: chair, path: recordings/chair, category: chair}
  - {id: table, path: recordings/table, category: table}
tracking: {check_stride_px: 4, max_disagreement_m: 0.2}
"""
OTHER_WORLD = rigid(rotation_from_quaternion_xyzw([0.3, -0.2, 0.5, 0.7]), [1.0, -2.0, 0.5])


@pytest.fixture(scope="module")
def tracked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings, of which the chair is tracked; not to be changed."""
    root = tmp_path_factory.mktemp("tracked")
    for family in ("chair", "table"):
        spec = small_spec(family, frames=FRAMES)
        near = spec.model_copy(update={"path": spec.path.model_copy(update={"arc_rad": 1.5})})
        simulate(near, root / "recordings" / family)
    (root / "benchmark.yaml").write_text(YAML)
    settings = load_benchmark(root / "benchmark.yaml")
    assert build_recording(Job(settings, settings.recordings[0], root), "track").error is None
    return root


@pytest.fixture
def here(tracked: Path, tmp_path: Path) -> Path:
    return copied(tracked, tmp_path / "here")


@pytest.fixture
def given(here: Path) -> GivenTrajectory:
    return read_trajectory_file(here / "recordings/chair/groundtruth.txt")[0]


def write(path: Path, stamps_ns: np.ndarray, T_world_camera: np.ndarray) -> None:
    path.write_text(trajectory_text(GivenTrajectory(stamps_ns, T_world_camera)), encoding="utf-8")


def test_the_same_path_in_another_world(command: Command, here: Path, given: GivenTrajectory) -> None:
    shutil.rmtree(here / "build")
    write(here / "other.txt", given.stamps_ns, OTHER_WORLD @ given.T_world_camera)
    run = command(here, "track", "chair", "--compare", "other.txt", "--json")
    assert run.status == 0, run.err
    (row,) = json.loads(run.out)
    found = row["comparison"]
    assert row["recording"] == found["recording"] == "chair" and row["made"] == ["ingest", "track"]
    assert (found["matched"], found["frames"], found["tracked"]) == (FRAMES, FRAMES, FRAMES)
    assert found["tracked_share"] == 1
    for key in ("ate_rmse_mm", "ate_max_mm", "rpe_frame_mm", "rpe_metre_mm"):
        assert found[key] < 1e-6
    assert found["rpe_frame_deg"] < 1e-6
    image = read_picture(here / "build/chair/compare.png")
    assert found["picture"] == "build/chair/compare.png" and image.shape[1] > 500
    assert (here / "build/chair/compare.png").stat().st_size < 150_000


def test_a_path_that_is_too_large_has_the_error_of_its_size(
    command: Command, here: Path, given: GivenTrajectory
) -> None:
    """Positions 2 % farther from their mean: aligned they are off by 2 % of their distance from it."""
    poses = given.T_world_camera.copy()
    centred = poses[:, :3, 3] - poses[:, :3, 3].mean(axis=0)
    poses[:, :3, 3] += 0.02 * centred
    write(here / "large.txt", given.stamps_ns, poses)
    found = json.loads(command(here, "track", "chair", "--compare", "large.txt", "--json").out)[0][
        "comparison"
    ]
    distance_m = np.linalg.norm(centred, axis=1)
    assert found["ate_rmse_mm"] == pytest.approx(20 * np.sqrt(np.mean(distance_m**2)), rel=1e-6)
    assert found["ate_median_mm"] == pytest.approx(20 * np.median(distance_m), rel=1e-6)
    assert found["ate_max_mm"] == pytest.approx(20 * distance_m.max(), rel=1e-6)
    steps_m = np.linalg.norm(np.diff(centred, axis=0), axis=1)
    assert found["rpe_frame_mm"] == pytest.approx(20 * np.sqrt(np.mean(steps_m**2)), rel=1e-6)


def test_the_table_and_the_artefact(command: Command, here: Path, given: GivenTrajectory) -> None:
    assert command(here, "track", "chair").status == 0
    before = hashes(here / "build")
    write(here / "part.txt", given.stamps_ns[2:6], given.T_world_camera[2:6])
    run = command(here, "track", "chair", "--compare", "part.txt")
    assert run.status == 0, run.err
    assert "against part.txt" in run.out and "ATE rmse mm" in run.out
    assert "picture: build/chair/compare.png" in run.out
    _, line = [line for line in run.out.splitlines() if "chair" in line and "│" in line]
    assert line.split("│")[1:5] == [" chair     ", f"{4:>8} ", f"{'100.0':>10} ", f"{'0.00':>12} "]
    assert "left out ┃ lost ┃" in run.out and "\nchair: good for ground truth: " in run.out
    after = hashes(here / "build")
    assert after.pop("chair/compare.png") and after == before
    # What was compared is still up to date.
    again = json.loads(command(here, "track", "chair", "--json").out)
    assert again[0]["made"] == [] and "comparison" not in again[0]


def test_frames_without_a_pose_are_counted(command: Command, here: Path, given: GivenTrajectory) -> None:
    truth = read_truth(here / "recordings/chair.truth")
    write(here / "truth.txt", truth.stamps_ns, truth.T_world_camera)
    write(here / "recordings/chair/groundtruth.txt", given.stamps_ns[:9], given.T_world_camera[:9])
    run = command(here, "track", "chair", "--compare", "truth.txt", "--json")
    found = json.loads(run.out)[0]["comparison"]
    assert (found["tracked"], found["matched"], found["tracked_share"]) == (9, 9, 0.75)
    assert found["ate_rmse_mm"] < 1e-3


def test_a_file_that_is_missing_or_no_trajectory(command: Command, here: Path) -> None:
    shutil.rmtree(here / "build")
    run = command(here, "track", "--compare", "nothing.txt")
    assert run.status == 1 and not (here / "build").exists()  # before anything is built
    assert run.err == "error: nothing.txt: cannot be read (No such file or directory)\n"
    (here / "notes.txt").write_text("hello\n")
    run = command(here, "track", "--compare", "notes.txt")
    assert run.status == 1 and run.err.startswith("error: notes.txt, line 1: holds 1 values, not the 8")


def test_stamps_of_another_clock_and_too_few(command: Command, here: Path, given: GivenTrajectory) -> None:
    write(here / "late.txt", given.stamps_ns + 10**12, given.T_world_camera)
    run = command(here, "track", "chair", "--compare", "late.txt")
    assert run.status == 1 and run.err.count("\n") == 1
    assert run.err.startswith("chair: error: late.txt: no stamp is a frame's: the frames are of 14")
    write(here / "two.txt", given.stamps_ns[:2], given.T_world_camera[:2])
    run = command(here, "track", "chair", "--compare", "two.txt", "--json")
    assert run.status == 1 and "only 2 poses of the two trajectories match" in run.err
    (row,) = json.loads(run.out)
    assert row["comparison"] is None and "only 2 poses" in row["error"] and row["status"] == "failed"
    assert row["code"] == "tracking.no-match"
    assert not (here / "build/chair/compare.png").exists()


def test_one_recording_that_fails_does_not_stop_the_other(
    command: Command, here: Path, given: GivenTrajectory
) -> None:
    write(here / "good.txt", given.stamps_ns, given.T_world_camera)
    for path in (here / "recordings/table/depth").iterdir():
        path.write_bytes(b"")
    run = command(here, "track", "--compare", "good.txt", "--json", "--jobs", "1")
    rows = {row["recording"]: row for row in json.loads(run.out)}
    assert run.status == 3
    assert rows["chair"]["comparison"]["matched"] == FRAMES and rows["table"]["comparison"] is None
    assert rows["table"]["error"] and "table: error" in run.err


def test_the_help_names_it(command: Command, tmp_path: Path) -> None:
    shown = " ".join(command(tmp_path, "track", "--help").out.replace("│", " ").split())
    assert "--compare" in shown and "TUM" in shown and "camera pose" in shown
    assert "one file for every recording named" in shown


def test_the_verdict_is_said_and_no_column_is_empty(command: Command, here: Path) -> None:
    run = command(here, "track", "chair")
    health = json.loads((here / "build/chair/trajectory/health.json").read_text())
    assert health["source"] == health["recommended"] == "trust"
    assert run.out.splitlines()[-1] == f"chair: {health['verdict']}"
    (head,) = [line for line in run.out.splitlines() if "recording" in line]
    assert [title.strip() for title in head.split("┃")[1:-1]] == [
        "recording",
        "frames",
        "left out",
        "lost",
        "status",
    ]
    # Up to date, it is said again.
    assert command(here, "track", "chair").out.splitlines()[-1] == f"chair: {health['verdict']}"
    (row,) = json.loads(command(here, "track", "chair", "--json").out)
    assert {key: row[key] for key in ("source", "grade", "verdict", "recommended")} == {
        key: health[key] for key in ("source", "grade", "verdict", "recommended")
    }
    assert {"frames", "left_out", "lost", "repeatability_iou", "views", "pairs", "warnings"} <= set(row)
    # The table of the stages before it, and no verdict.
    ingested = command(here, "ingest", "chair").out
    assert "frames" in ingested and "lost" not in ingested and health["verdict"] not in ingested


@pytest.mark.parametrize(
    ("done", "recommended", "advice"),
    [
        ("trust", "trust", ""),
        ("trust", "refine", "; recommended is `trajectory: refine`"),
        ("refine", "trust", "; recommended is `trajectory: trust`"),
        ("tracked", "ignore", ""),
        ("tracked", None, ""),
    ],
)
def test_what_is_recommended_is_said_if_it_was_not_done(
    command: Command, here: Path, done: str, recommended: str | None, advice: str
) -> None:
    assert command(here, "track", "chair").status == 0
    path = here / "build/chair/trajectory/health.json"
    figures = {**json.loads(path.read_text()), "source": done, "recommended": recommended, "verdict": "fair"}
    size = path.stat().st_size
    path.write_text(json.dumps(figures).ljust(size))
    run = command(here, "track", "chair")
    assert path.stat().st_size == size and run.out.splitlines()[-1] == f"chair: fair{advice}"


def test_a_failed_run_says_no_verdict(command: Command, here: Path) -> None:
    assert "chair: good" in command(here, "track", "chair").out
    (here / "recordings/chair/groundtruth.txt").unlink()
    run = command(here, "track", "chair", "--set", "recordings.chair.trajectory=trust")
    assert run.status == 1 and "the recording has none" in run.err
    assert not [line for line in run.out.splitlines() if line.startswith("chair: ")]
    # What lies there of the run before is not this run's.
    failed = command(here, "track", "chair", "--json", "--set", "recordings.chair.trajectory=trust")
    (row,) = json.loads(failed.out)
    assert row["error"] and row["frames"] and row["verdict"] is None and row["lost"] is None


def test_given_poses_against_themselves(command: Command, here: Path, given: GivenTrajectory) -> None:
    themselves = "chair: these are the given poses themselves"
    run = command(here, "track", "chair", "--compare", "recordings/chair/groundtruth.txt")
    assert themselves in run.out
    moved = given.T_world_camera.copy()
    moved[3, 0, 3] += 1e-4
    write(here / "moved.txt", given.stamps_ns, moved)
    run = command(here, "track", "chair", "--compare", "moved.txt")
    assert run.status == 0 and themselves not in run.out
    # Stamps between those of the frames: the poses that were interpolated are off a little.
    write(here / "recordings/chair/groundtruth.txt", given.stamps_ns + 5 * 10**7, given.T_world_camera)
    path, gap = "recordings/chair/groundtruth.txt", "tracking.max_stamp_gap_s=1"
    run = command(here, "track", "chair", "--compare", path, "--set", gap, "--json")
    (row,) = json.loads(run.out)
    assert row["comparison"]["ate_rmse_mm"] > 0.1 and row["comparison"]["with_itself"] is True


def test_a_picture_of_an_older_trajectory_goes(command: Command, here: Path, given: GivenTrajectory) -> None:
    write(here / "truth.txt", given.stamps_ns, given.T_world_camera)
    picture = here / "build/chair/compare.png"
    command(here, "track", "chair", "--compare", "truth.txt")
    command(here, "track", "chair")
    assert picture.exists()  # it is still of this trajectory
    command(here, "track", "chair", "--force")
    assert not picture.exists()


def test_a_warning_names_the_recording_once(command: Command, here: Path) -> None:
    """A recording whose path is its id."""
    (here / "recordings/chair").rename(here / "chair")
    (here / "benchmark.yaml").write_text(YAML.replace("recordings/chair", "chair"))
    colors = here / "chair/rgb.txt"
    rows = colors.read_text().splitlines()
    colors.write_text("\n".join(rows[:-2]) + "\n")
    run = command(here, "track", "chair")
    assert run.err == f"chair: warning: 2 of {FRAMES} depth frames have no colour frame within 20 ms\n"
