"""The odometry that begins while one records: a build goes on from it, and makes the same bytes."""

import os
import pickle
import shutil
import signal
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from made_once import made_once
from small_runs import make_small
from typed import noted

from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.engine.parallel import build
from kinectbench.engine.stages import Job
from kinectbench.record.odometry_process import MAY_CHANGE, GrowingOdometry, OdometryProcess
from kinectbench.settings.file import load_benchmark
from kinectbench.settings.models import TrackingSettings
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence
from kinectbench.stages.track import track, tracker
from kinectbench.stages.track.odometry import Follower
from kinectbench.stages.track.partial_odometry import (
    PartialOdometry,
    partial_odometry_of,
    using_partial_odometry,
)

FRAMES = 16


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`out`, 16 frames of a chair, and `sequence`, what `ingest` makes of it."""

    def make(to: Path) -> None:
        (make_small(to, ("chair",)) / "recordings/chair").rename(to / "out")
        write_sequence(open_recording(to / "out"), to / "sequence")

    return made_once(tmp_path_factory, "partial", make)


def taken_of(folder: Path, *, whole: bool) -> PartialOdometry:
    """All that can be taken of a folder."""
    growing = GrowingOdometry(folder)
    growing.read_again()
    while growing.take(whole=whole):
        pass
    made = growing.so_far()
    assert made is not None
    return made


def tracked(sequence: Sequence) -> Trajectory:
    return track(sequence, "ignore", TrackingSettings())


@pytest.mark.parametrize("whole", [False, True])
def test_tracking_goes_on_with_the_same_result(
    recorded: Path, whole: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Poses, figures and warnings are equal to the last bit, and no frame is followed twice."""
    sequence = read_sequence(recorded / "sequence")
    alone = tracked(sequence)
    partial: PartialOdometry = pickle.loads(pickle.dumps(taken_of(recorded / "out", whole=whole)))
    count = FRAMES - (0 if whole else MAY_CHANGE)
    assert len(partial.digests) == len(partial.follower.frames) == count
    fresh: list[object] = []
    monkeypatch.setattr(tracker, "Follower", noted(Follower, fresh))
    with using_partial_odometry(lambda: partial):
        after = tracked(sequence)
    assert not fresh and len(partial.follower.frames) == FRAMES
    assert np.array_equal(after.T_world_camera, alone.T_world_camera, equal_nan=True)
    assert after.health == alone.health
    found, wanted = (each.depth_calibration.coefficients_per_m for each in (after, alone))
    assert np.array_equal(found, wanted)


def test_what_was_taken_of_other_frames_is_not_used(recorded: Path, tmp_path: Path) -> None:
    """One pixel, one stamp or the depth's scale differs; nor is it given out twice."""
    sequence = read_sequence(recorded / "sequence")
    with using_partial_odometry(lambda: taken_of(recorded / "out", whole=True)):
        assert partial_odometry_of(sequence) is not None and partial_odometry_of(sequence) is None
    source = open_recording(recorded / "out")
    for change in ("pixel", "scale"):
        write_sequence(source, tmp_path / change)
        partial = taken_of(recorded / "out", whole=True)
        if change == "pixel":
            frame = next((tmp_path / change / "depth").iterdir())
            frame.write_bytes(frame.read_bytes()[:-1] + b"?")
        else:
            maps = partial.follower.maps
            maps.sequence = Sequence(source.camera, 1.0, source.stamps_ns, True, None, maps.sequence.frames)
        with using_partial_odometry(lambda partial=partial: partial):  # type: ignore[misc]
            assert partial_odometry_of(read_sequence(tmp_path / change)) is None


def test_a_process_takes_the_frames_as_they_come(recorded: Path, tmp_path: Path) -> None:
    """It waits for the folder, and gives what it has taken when it is asked."""
    process = OdometryProcess(tmp_path / "out")
    shutil.copytree(recorded / "out", tmp_path / "out")
    process.ended()
    partial = process.so_far()
    process.close()
    assert partial is not None and 1 <= len(partial.digests) == len(partial.follower.frames) <= FRAMES


def test_a_process_that_dies_costs_nothing(tmp_path: Path) -> None:
    process = OdometryProcess(tmp_path / "out")
    assert process.pid is not None
    os.kill(process.pid, signal.SIGKILL)
    process.ended()
    assert process.so_far() is None
    process.close()


def test_a_build_goes_on_from_it(tmp_path: Path) -> None:
    """The stage asks for it, and its files are the same bytes as without."""
    root = make_small(tmp_path, ("chair",))
    file = root / "benchmark.yaml"
    file.write_text(file.read_text().replace("category: chair}", "category: chair, trajectory: ignore}"))
    settings = load_benchmark(file)
    job, asked = Job(settings, settings.recordings[0], root), list[int]()

    def ask() -> PartialOdometry:
        asked.append(1)
        return taken_of(root / "recordings/chair", whole=True)

    made = []
    for given in (using_partial_odometry(ask), nullcontext()):
        with given:
            assert build([job], "track", ("track",))[0].error is None
        files = sorted((job.build / "trajectory").iterdir())
        made.append({file.name: file.read_bytes() for file in files if file.name != "timing.json"})
    assert asked == [1] and len(made[0]) > 2 and made[0] == made[1]
