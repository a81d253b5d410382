"""Units that nobody says: `inspect` fails where a build does, and in its words."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from small_benchmark import Run, small_spec
from wrong_recordings import change_camera, change_poses, rows_of, stamps, write_rows

from kinectbench.core.geometry import rigid
from kinectbench.doctor import grade, inspect
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.settings.models import TrackingSettings

FIRST_S = 1.4e9


def in_units(unit: float, t: float) -> float:
    return round((t - FIRST_S) * unit, 6)


def from_zero(folder: Path, frames_unit: float, poses_unit: float) -> None:
    """Stamps that begin at 0, in so many units a second."""
    for name, unit in (("depth", frames_unit), ("rgb", frames_unit), ("groundtruth", poses_unit)):
        stamps(name, partial(in_units, unit))(folder)


@pytest.fixture
def chair(tmp_path: Path) -> Path:
    simulate(small_spec("chair"), tmp_path / "r")
    return tmp_path / "r"


@pytest.mark.parametrize(("frames_unit", "poses_unit", "factor"), [(1, 1e3, "0.001"), (1e3, 1, "1000")])
def test_stamps_of_poses_in_another_unit(
    chair: Path, frames_unit: float, poses_unit: float, factor: str, command: Callable[..., Run]
) -> None:
    from_zero(chair, frames_unit, poses_unit)
    diagnosis, _ = inspect(chair)
    (found,) = (each for each in diagnosis.findings if each.name == "trajectory_time_unit")
    assert diagnosis.stops and found.advice == f"multiply them by {factor}"
    yaml = "name: x\nrecordings: [{id: a, path: r, category: chair}]\n"
    (chair.parent / "benchmark.yaml").write_text(yaml)
    built = command(chair.parent, "track", "--jobs", "1")
    assert built.status == 1 and f"{found.what}; {found.advice}. What failed: " in built.err


def test_a_long_recording_with_hardly_any_pose_stops(chair: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is looked at in part, but that its frames have no pose is certain."""
    rows = rows_of(chair, "groundtruth")
    write_rows(chair, "groundtruth", [[str(float(r[0]) + 0.0005), *r[1:]] for r in rows])
    monkeypatch.setattr(grade, "MOST_FRAMES", 6)
    strict = TrackingSettings(max_stamp_gap_s=0.05)  # frames are 0.2 s apart, as stamps in a slow unit are
    (found,) = (each for each in inspect(chair, tracking=strict)[0].findings if each.severity == "stops")
    assert found.name == "trajectory_wrong" and "has no pose close to the time of any frame" in found.what


def test_depth_and_poses_in_one_wrong_unit(chair: Path, command: Callable[..., Run]) -> None:
    """Poses prove their own unit only."""
    change_camera(depth_scale=0.1)(chair)
    change_poses(lambda T: rigid(T[:3, :3], 10 * T[:3, 3]))(chair)
    diagnosis, _ = inspect(chair)
    (found,) = (each for each in diagnosis.findings if each.severity == "stops")
    assert found.name == "depth_scale" and found.advice.startswith("the given poses fit by this unit")
    yaml = "name: x\nrecordings: [{id: a, path: r, category: chair}]\n"
    (chair.parent / "benchmark.yaml").write_text(yaml)
    built = command(chair.parent, "ingest", "--jobs", "1")
    said = found.what.partition(" m at ")[2]
    assert built.status == 1 and said in built.err and "which no room has" in said


def test_a_camera_that_stands_still_does_not_hide_a_trajectory_that_stops_a_build(chair: Path) -> None:
    _, *rows = rows_of(chair, "depth")
    first = rows[0][1]
    write_rows(chair, "depth", [[row[0], first] for row in rows])
    (chair / "groundtruth.txt").write_text("1.0 nan 0 0 0 0 0 1\n")
    diagnosis, _ = inspect(chair)
    assert "trajectory_unreadable" in {
        found.name for found in diagnosis.findings if found.severity == "stops"
    }
