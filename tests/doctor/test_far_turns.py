"""The pose convention of a camera that turns far between frames, and then stands while depth is repeated."""

import json
from pathlib import Path

import numpy as np
import pytest
from ingest_writers import png

from kinectbench.core.geometry import Camera, invert_rigid, rigid, rigid_from_twist
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.pose_convention import AXES
from kinectbench.core.trajectory.trajectory_file import trajectory_text
from kinectbench.core.types import Float64
from kinectbench.doctor import inspect
from kinectbench.doctor.probe import probe_recording
from kinectbench.doctor.still import NO_MOTION
from kinectbench.doctor.trajectory import fit_trajectory, fits_no_better
from kinectbench.stages.ingest.readers import open_recording

CAMERA = Camera(160, 120, 140.0, 140.0, 79.5, 59.5)
MOVING, STANDING = 30, 100
# Half sides of the room around the camera, metres: one in which it turns, and a low one in which it moves
# along a wall.
ROOMS_M = {"turns": np.array([0.55, 0.45, 0.6]), "wall": np.array([1.5, 1.5, 0.4])}
# A floor that the camera looks down at, from so far, and balls on it: (centre, radius), metres.
FLOOR_M = 0.8
BALLS_M = ((np.array([0.1, 0.05, 0.65]), 0.15), (np.array([-0.3, -0.1, 0.7]), 0.1))


def walk(kind: str) -> Float64:
    """(30, 4, 4): the camera turns by 32 degrees a frame, or moves by some 0.3 m and turns before a wall."""
    poses: list[Float64] = []
    for i in range(MOVING):
        a, b = np.radians(32 * i), 0.3 * np.sin(1.1 * i)
        at = 0.12 * np.array([np.cos(0.9 * i), np.sin(0.7 * i), np.sin(1.3 * i)])
        if kind == "wall":
            a, b = 0.3 * np.sin(2.1 * i), 0.3 * np.cos(1.7 * i)
            at = np.array([0.4 * np.sin(0.8 * i), 0.4 * np.cos(0.7 * i), 0.05 * np.sin(i)])
        yaw = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
        pitch = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
        poses.append(rigid(yaw @ pitch, at))
    return np.stack(poses)


def rendered(T: Float64, kind: str) -> np.ndarray:
    """Depth of the room from inside, mm (120, 160) uint16."""
    rays = CAMERA.rays() @ T[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        hits = np.where(rays == 0, np.inf, (np.sign(rays) * ROOMS_M[kind] - T[:3, 3]) / rays)
    return np.asarray(np.rint(1000 * hits.min(axis=-1)), np.uint16)


def write(folder: Path, kind: str, axes: str, standing: int, *, other: bool = False) -> Path:
    """A folder without times; `axes` are those of the given poses, `other`: they are of another walk."""
    (folder / "depth").mkdir(parents=True)
    poses = walk(kind)
    for i, T in enumerate([*poses, *[poses[-1]] * standing]):
        (folder / f"depth/{i:04d}.png").write_bytes(png(rendered(T, kind)))
    given = poses @ invert_rigid(rigid(AXES[axes], np.zeros(3)))
    given = given[np.random.default_rng(0).permutation(MOVING)] if other else given
    given = np.concatenate([given, np.repeat(given[-1:], standing, axis=0)])
    names = ("width", "height", "fx", "fy", "cx", "cy")
    stated = {name: getattr(CAMERA, name) for name in names} | {"depth_scale": 1000}
    (folder / "intrinsics.json").write_text(json.dumps(stated))
    rows = trajectory_text(GivenTrajectory(np.arange(len(given)) * 10**9, given))
    (folder / "trajectory.txt").write_text(rows)
    return folder


@pytest.mark.parametrize("kind", ROOMS_M)
@pytest.mark.parametrize("standing", [0, STANDING])
@pytest.mark.parametrize(
    ("axes", "reading"),
    [("robot", "robot axes (x forward, z up)"), ("opengl", "OpenGL axes (y up, z backward)")],
)
def test_other_axes_are_found(tmp_path: Path, kind: str, axes: str, reading: str, standing: int) -> None:
    diagnosis, _ = inspect(write(tmp_path / "r", kind, axes, standing))
    assert diagnosis.facts["poses_read_as"] == reading
    names = {found.name for found in diagnosis.findings}
    assert "trajectory_reading" in names and not names & {"trajectory_delay", "trajectory_wrong"}


@pytest.mark.parametrize("kind", ROOMS_M)
@pytest.mark.parametrize("standing", [0, STANDING])
def test_right_poses_are_not_refused(tmp_path: Path, kind: str, standing: int) -> None:
    diagnosis, _ = inspect(write(tmp_path / "r", kind, "optical", standing))
    assert diagnosis.facts["poses_read_as"] == "as given"
    names = {found.name for found in diagnosis.findings}
    assert not names & {"trajectory_delay", "trajectory_wrong", "trajectory_reading", "trajectory_scale"}


@pytest.mark.parametrize("far_m", [0.8, 1.5, 2.2])
def test_right_poses_above_a_floor_stay_as_given(tmp_path: Path, far_m: float) -> None:
    """Nearly static cameras fit a floor, too, and keep more of it in view: they show nothing."""
    folder, noise = write(tmp_path / "r", "wall", "optical", 0), np.random.default_rng(0)
    poses = np.stack([rigid(np.eye(3), at) for at in np.linspace([-far_m, 0, 0], [far_m, 0, 0], 60)])
    rays = CAMERA.rays()
    for i, T in enumerate(poses):
        z = np.full(rays.shape[:2], FLOOR_M)
        for middle, radius in BALLS_M:
            a, b = (rays**2).sum(axis=-1), rays @ (middle - T[:3, 3])
            root = b**2 - a * (((middle - T[:3, 3]) ** 2).sum() - radius**2)
            z = np.where(root > 0, np.minimum(z, (b - np.sqrt(np.maximum(root, 0))) / a), z)
        seen_mm = 1000 * z + noise.normal(0, 1, z.shape)
        (folder / f"depth/{i:04d}.png").write_bytes(png(np.rint(seen_mm).astype(np.uint16)))
    off = noise.normal(0, [0.1 * np.pi / 180] * 3 + [0.002] * 3, (len(poses), 6))
    given = np.stack([T @ rigid_from_twist(twist) for T, twist in zip(poses, off, strict=True)])
    rows = trajectory_text(GivenTrajectory(np.arange(len(given)) * 10**9, given))
    (folder / "trajectory.txt").write_text(rows)
    fit = fit_trajectory(probe_recording(open_recording(folder)))
    assert fit is not None and fit.convention.changes == 0


@pytest.mark.parametrize("turn_rad", [0.0, 0.02, 0.3])
def test_right_poses_along_an_exact_wall_stay_as_given(tmp_path: Path, turn_rad: float) -> None:
    """A wall shows no motion along it: shorter steps fit it, too, and the noise of poses is less in them."""
    folder, noise = write(tmp_path / "r", "wall", "optical", 0), np.random.default_rng(0)
    far_m, count = 1.0 if turn_rad == 0.02 else 0.8, 60
    poses = np.empty((count, 4, 4))
    for i, x in enumerate(np.linspace(-1.5, 1.5, count)):
        a = turn_rad * np.sin(6.2 * i / count)
        yaw = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
        poses[i] = rigid(yaw, np.array([x, 0, 0]))
        z_mm = 1000 * far_m / (CAMERA.rays() @ yaw.T)[..., 2]
        (folder / f"depth/{i:04d}.png").write_bytes(png(np.rint(z_mm).astype(np.uint16)))
    off = noise.normal(0, [0.1 * np.pi / 180] * 3 + [0.002] * 3, (count, 6))
    given = np.stack([T @ rigid_from_twist(twist) for T, twist in zip(poses, off, strict=True)])
    rows = trajectory_text(GivenTrajectory(np.arange(count) * 10**9, given))
    (folder / "trajectory.txt").write_text(rows)
    fit = fit_trajectory(probe_recording(open_recording(folder)))
    assert fit is None or fit.convention.changes == 0
    diagnosis, _ = inspect(folder)
    assert {found.name for found in diagnosis.findings if found.severity == "stops"} <= NO_MOTION


@pytest.mark.parametrize("kind", ROOMS_M)
def test_only_frames_of_new_depth_are_compared(tmp_path: Path, kind: str) -> None:
    fit = fit_trajectory(probe_recording(open_recording(write(tmp_path / "r", kind, "optical", STANDING))))
    assert fit is not None and fit.fits and not fits_no_better(fit)
    assert all(max(pair.first, pair.second) < MOVING for pair in fit.pairs)


@pytest.mark.parametrize("kind", ROOMS_M)
@pytest.mark.parametrize("standing", [0, STANDING])
def test_poses_of_another_walk_are_no_fit(tmp_path: Path, kind: str, standing: int) -> None:
    diagnosis, _ = inspect(write(tmp_path / "r", kind, "optical", standing, other=True))
    names = {found.name for found in diagnosis.findings}
    assert not names & {"trajectory_delay", "trajectory_reading", "trajectory_scale"}
