"""`inspect` and a build agree on whether there is a floor, with all that is known of it."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from read_pictures import read_picture
from slow import slow

from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import (
    OrientedBox,
    quaternion_xyzw_from_rotation,
    rotation_from_quaternion_xyzw,
)
from kinectbench.core.sequence import UpSample
from kinectbench.core.trajectory.association import poses_at
from kinectbench.doctor import inspect
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.settings.models import FusionSettings, SegmentationSettings, TrackingSettings
from kinectbench.stages.fuse import fuse
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.readers.tum import TumRecording
from kinectbench.stages.ingest.recording import Recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence
from kinectbench.stages.segment.find.hints import FloorHint, floor_hint
from kinectbench.stages.segment.find.object import find_floor_and_object
from kinectbench.stages.track import track

Plane = tuple[float, float, float, float]
# Of a simulated world, whose z axis is up and whose floor is at 0.
FLOOR: Plane = (0.0, 0.0, 1.0, 0.0)
FUSION = FusionSettings(voxel_size_m=0.01, scene_voxel_size_m=0.02)
BOX = OrientedBox((0.0, 0.0, 0.1), (0.6, 0.6, 0.4), 0.0)


def simulated(folder: Path, elevation_deg: float, distance_m: float = 0.6) -> Path:
    """A kettle on a floor, seen from an elevation, with exact poses: TUM's layout, 12 frames, 160 x 120."""
    spec = {
        "object": "kettle:seed=1",
        "path": {
            "frames": 12, "arc_rad": 0.5, "distance_m": distance_m, "reach_share": 0.0, "swing_rad": 0.02,
            "elevation_rad": float(np.radians(elevation_deg)), "lowest_m": 0.1, "shake_m": 0.003,
        },
        "scene": {"walls": 1, "clutter": 0},
        "sensor": {"model": "phone_lidar", "width": 160, "height": 120},
        "save_depth": False,
    }  # fmt: skip
    simulate(SimulationSpec.model_validate(spec), folder)
    return folder


def upside_down(recording: Path, folder: Path) -> Path:
    """The same as if the camera had been held upside down."""
    shutil.copytree(recording, folder)
    for image in [*folder.glob("depth/*"), *folder.glob("rgb/*")]:
        cv2.imwrite(str(image), read_picture(image, cv2.IMREAD_UNCHANGED)[::-1, ::-1])
    rows = np.loadtxt(folder / "groundtruth.txt")
    turned = rotation_from_quaternion_xyzw(rows[:, 4:]) @ np.diag([-1.0, -1.0, 1.0])
    rows[:, 4:] = [quaternion_xyzw_from_rotation(rotation) for rotation in turned]
    np.savetxt(folder / "groundtruth.txt", rows, fmt="%.9f")
    return folder


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int, bool], Path]:
    """By elevation in degrees, and whether the camera is held upside down."""

    @cache
    def made(elevation_deg: int, turned: bool) -> Path:
        folder = tmp_path_factory.mktemp("floor") / "kettle"
        if turned:
            return upside_down(made(elevation_deg, False), folder)
        return simulated(folder, elevation_deg)

    return made


def build_complaint(
    path: Path, work: Path, plane: Plane | None = None, box: OrientedBox | None = None
) -> str:
    """Why a build finds no object in a recording, or what it doubts of the floor, "" if nothing."""
    write_sequence(open_recording(path), work)
    sequence = read_sequence(work)
    trajectory = track(sequence, "trust", TrackingSettings())
    scene = fuse(sequence, trajectory, FUSION).mesh
    try:
        hint = floor_hint(sequence, trajectory, plane)
        chosen = find_floor_and_object(scene, trajectory, box, SegmentationSettings(), hint)
    except SegmentationError as error:
        return str(error)
    return " ".join(chosen.floor.warnings)


def complaints(path: Path, plane: Plane | None = None, box: OrientedBox | None = None) -> set[str]:
    """What `inspect` says of the floor, by its names."""
    diagnosis, _ = inspect(path, plane_world=plane, boxed=box is not None)
    said = {found.name for found in diagnosis.findings if found.severity != "note"}
    return said & {"no_floor", "floor_above", "floor_doubtful"}


@pytest.mark.parametrize(
    ("elevation_deg", "turned", "gravity", "plane", "box", "said"),
    [
        slow(30, False, False, None, None, set()),
        slow(53, False, False, None, None, set()),
        (76, False, False, None, None, set()),
        (40, True, False, None, None, {"floor_doubtful"}),
        (40, True, True, None, None, set()),
        (40, True, False, FLOOR, None, set()),
        (40, True, False, None, BOX, {"floor_doubtful"}),
        (40, False, False, (0.0, 0.0, -1.0, 0.0), None, {"floor_above"}),
    ],
)
def test_the_same_floor_or_none(
    recordings: Callable[[int, bool], Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    elevation_deg: int,
    turned: bool,
    gravity: bool,
    plane: Plane | None,
    box: OrientedBox | None,
    said: set[str],
) -> None:
    monkeypatch.setattr(TumRecording, "up_world", (0.0, 0.0, 1.0) if gravity else None)
    path = recordings(elevation_deg, turned)
    assert complaints(path, plane, box) == said
    built = build_complaint(path, tmp_path / "work", plane, box)
    assert ("no floor found" in built) == ("no_floor" in said)
    assert ("below the plane" in built) == ("floor_above" in said)
    assert ("held upside down" in built) == ("floor_doubtful" in said)


def with_poses_off(path: Path, folder: Path, sigma_m: float) -> Path:
    """The same with each given pose moved up or down."""
    shutil.copytree(path, folder)
    rows = np.loadtxt(folder / "groundtruth.txt")
    rows[:, 3] += np.random.default_rng(0).normal(0, sigma_m, len(rows))
    np.savetxt(folder / "groundtruth.txt", rows, fmt="%.9f")
    return folder


def test_frames_that_do_not_lie_on_one_floor_are_told(tmp_path: Path) -> None:
    """By poses that are 12 mm too high or too low."""
    right = simulated(tmp_path / "right", 40)
    said = [
        [found.what for found in inspect(path)[0].findings if found.name == "floor_doubtful"]
        for path in (right, with_poses_off(right, tmp_path / "off", 0.012))
    ]
    assert said[0] == []
    assert len(said[1]) == 1 and "mm about the floor, a Kinect's depth at 0.8 m by 2" in said[1][0]


def with_accelerometer(path: Path) -> Recording:
    """A recording every third of whose frames has an up of its own."""
    recording = open_recording(path)
    assert recording.given_trajectory is not None
    stamps_ns = recording.stamps_ns[::3]
    poses = poses_at(recording.given_trajectory, stamps_ns, 1.0)
    up = np.array([0.0, 0.0, 1.0])
    samples = [
        UpSample(int(stamp_ns), tuple((T[:3, :3].T @ up).tolist()))
        for stamp_ns, T in zip(stamps_ns, poses, strict=True)
        if np.isfinite(T).all()
    ]
    return replace(recording, up_cameras=tuple(samples))


@pytest.mark.parametrize("ignored", [False, True])
def test_an_accelerometer_counts(
    recordings: Callable[[int, bool], Path], monkeypatch: pytest.MonkeyPatch, ignored: bool
) -> None:
    """In the world of the poses, or in the axes of each camera."""
    recording = with_accelerometer(recordings(76, False))
    hints: list[FloorHint] = []

    def find_floor(*args: object) -> None:
        hints.extend(each for each in args if isinstance(each, FloorHint))
        raise SegmentationError("looked at")

    monkeypatch.setattr("kinectbench.doctor.examine.open_recording", lambda *_, **__: recording)
    for module in ("doctor.floor", "stages.segment.find.floor"):
        monkeypatch.setattr(f"kinectbench.{module}.find_floor", find_floor)
    inspect(recording.path, mode="ignore" if ignored else None)
    ups = [hint.up_world for hint in hints if hint.up_world is not None]
    if not ignored:
        (up_world,) = ups
        np.testing.assert_allclose(up_world, [0, 0, 1], atol=1e-3)
        return
    own = {sample.up_camera for sample in recording.up_cameras}
    assert ups and all(any(np.allclose(up, each) for each in own) for up in ups)


def test_gravity_of_poses_that_are_ignored_counts(
    recordings: Callable[[int, bool], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a build, which takes it over frame by frame."""
    path = recordings(40, True)
    assert "floor_doubtful" in {f.name for f in inspect(path, mode="ignore")[0].findings}
    monkeypatch.setattr(TumRecording, "up_world", (0.0, 0.0, 1.0))
    said = {found.name for found in inspect(path, mode="ignore")[0].findings}
    assert not said & {"no_floor", "floor_doubtful"}


def test_a_persons_plane_beside_the_one_that_is_seen_is_told(
    recordings: Callable[[int, bool], Path],
) -> None:
    """In the words of a build."""
    path = recordings(76, False)
    said = [
        [found for found in inspect(path, plane_world=plane)[0].findings if found.name == "floor_doubtful"]
        for plane in (FLOOR, (0.0, 0.0, 1.0, 0.03))
    ]
    assert said[0] == []
    (found,) = said[1]
    assert "gives as `floor` is not one that the frames show" in found.what
    assert "above it" in found.what and "write `floor: {plane_world:" in found.advice
