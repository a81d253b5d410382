"""Exact depth with its true poses, where much is hidden in other frames or looks alike from all sides."""

import json
from pathlib import Path

import numpy as np
import pytest
from ingest_writers import png

from kinectbench.core.geometry import Camera, invert_rigid
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.trajectory_file import trajectory_text
from kinectbench.core.types import Float64
from kinectbench.doctor import inspect
from kinectbench.doctor.fit import FramePair, disagreements
from kinectbench.doctor.lengths import LENGTHS, fit_lengths
from kinectbench.doctor.probe import probe_recording
from kinectbench.doctor.still import NO_MOTION
from kinectbench.doctor.trajectory import fit_trajectory
from kinectbench.stages.ingest.readers import open_recording

CAMERA = Camera(160, 120, 150.0, 150.0, 79.5, 59.5)
SCALE = 5000.0
FLOOR_M = -0.2


def orbit(height_m: float) -> list[Float64]:
    """Camera to world, once around z at a distance of 1.2 m, towards the origin."""
    poses = []
    for angle in np.linspace(0, 2 * np.pi, 24, endpoint=False):
        T = np.eye(4)
        T[:3, 3] = 1.2 * np.cos(angle), 1.2 * np.sin(angle), height_m
        z = -T[:3, 3] / np.linalg.norm(T[:3, 3])
        x = np.cross(z, [0, 0, 1]) / np.linalg.norm(np.cross(z, [0, 0, 1]))
        T[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
        poses.append(T)
    return poses


def ellipsoid(axes_m: tuple[float, float, float], eye: Float64, rays: Float64) -> Float64:
    """Depth of its surface at each ray; infinite beside it."""
    p, q = eye / axes_m, rays / axes_m
    a, b = (q * q).sum(axis=-1), (q @ p)
    inside = b * b - a * (p @ p - 1)
    return np.where(inside > 0, (-b - np.sqrt(np.maximum(inside, 0))) / a, np.inf)


def box(half_m: tuple[float, float, float], eye: Float64, rays: Float64) -> Float64:
    """Depth of a box that stands at the origin, on the floor."""
    centre = np.array([0, 0, FLOOR_M + half_m[2]])
    one, other = (centre - half_m - eye) / rays, (centre + half_m - eye) / rays
    first, last = np.minimum(one, other).max(axis=-1), np.maximum(one, other).min(axis=-1)
    return np.where(first < last, first, np.inf)


def floor(eye: Float64, rays: Float64) -> Float64:
    depth_m = (FLOOR_M - eye[2]) / rays[..., 2]
    return np.where(depth_m > 0, depth_m, np.inf)


def write(folder: Path, scene: str, *, inverse: bool = False) -> Path:
    poses = orbit(0.6 if "floor" in scene else 0.5)
    (folder / "depth").mkdir(parents=True)
    for i, T in enumerate(poses):
        eye, rays = T[:3, 3], CAMERA.rays() @ T[:3, :3].T
        seen = [
            ellipsoid((0.3, 0.28, 0.3), eye, rays) if "round" in scene else box((0.15, 0.1, 0.1), eye, rays),
            *([floor(eye, rays)] if "floor" in scene else []),
        ]
        depth_m = np.min(seen, axis=0)
        native = np.rint(np.where(np.isfinite(depth_m), depth_m, 0) * SCALE).astype(np.uint16)
        (folder / f"depth/{i:02d}.png").write_bytes(png(native))
    names = ("width", "height", "fx", "fy", "cx", "cy")
    said = {name: getattr(CAMERA, name) for name in names} | {"depth_scale": SCALE}
    (folder / "intrinsics.json").write_text(json.dumps(said))
    T_given = np.stack([invert_rigid(T) if inverse else T for T in poses])
    given = GivenTrajectory(np.arange(len(poses)) * 10**9, T_given)
    (folder / "trajectory.txt").write_text(trajectory_text(given))
    return folder


@pytest.mark.parametrize("scene", ["round", "a box on a floor"])
def test_true_poses_are_not_doubted(tmp_path: Path, scene: str) -> None:
    folder = write(tmp_path / "r", scene)
    fit = fit_trajectory(probe_recording(open_recording(folder)))
    assert fit is not None and fit.convention.changes == 0 and fit.fits and fit.residual_m < 0.0002
    assert (fit.lengths.depth, fit.lengths.focal, fit.lengths.left) == (1, 1, 1)
    names = {finding.name for finding in inspect(folder)[0].findings if finding.severity != "note"}
    assert not names & (NO_MOTION | {LENGTHS, "trajectory_reading", "trajectory_wrong"})


def test_poses_the_wrong_way_round_are_found_on_a_bare_floor(tmp_path: Path) -> None:
    findings = inspect(write(tmp_path / "r", "a box on a floor", inverse=True))[0].findings
    (found,) = (finding for finding in findings if finding.name == "trajectory_reading")
    assert "world to camera (inverse)" in found.what


def test_without_any_disagreement_no_lengths_are_better() -> None:
    wall = FramePair(
        0, 1, 1.5 * CAMERA.rays()[30:-30, 30:-30].reshape(-1, 3), np.full((120, 160), 1.5, np.float32), CAMERA
    )
    same = np.stack([np.eye(4)] * 2)
    assert disagreements([wall], same[None]).max() == 0
    lengths = fit_lengths([wall], same)
    assert (lengths.depth, lengths.focal, lengths.left) == (1, 1, 1) and not lengths.implausible
