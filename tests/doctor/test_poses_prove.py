"""Poses that fit settle scale and intrinsics; what fits nothing is not called a fit."""

import re
from dataclasses import replace
from pathlib import Path
from shutil import copytree, ignore_patterns

import numpy as np
import pytest

from kinectbench.core.trajectory.pose_convention import PoseConvention
from kinectbench.doctor import Diagnosis, inspect
from kinectbench.doctor.during_build import likely_cause
from kinectbench.doctor.fit import fits
from kinectbench.doctor.probe import probe_recording
from kinectbench.doctor.trajectory import check_trajectory, fit_trajectory
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.readers import open_recording

# Three times what the noise of depth makes of it, at .5 m, and some.
FIT_MM = 8.0


def small_thing(folder: Path, **path: float) -> Path:
    """A small thing from .3 m away on, in no order of time, with exact poses."""
    spec = {
        "object": "mug:seed=0",
        "path": {"order": "shuffled", "frames": 40, "swing_rad": 0.3, "lowest_m": 0.1, **path},
        "scene": {"walls": 0, "clutter": 0},
        "sensor": {"model": "phone_lidar", "width": 160, "height": 120},
        "save_depth": False,
    }
    simulate(SimulationSpec.model_validate(spec), folder)
    return folder


@pytest.fixture(scope="module")
def near(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_thing(tmp_path_factory.mktemp("near") / "mug", distance_m=0.32, elevation_rad=1.0)


def with_poses(recording: Path, folder: Path, change: object) -> Path:
    """A copy of a recording in TUM's layout whose rows of poses (n, 8) are others."""
    copytree(recording, folder, ignore=ignore_patterns("groundtruth.txt"))
    rows = np.loadtxt(recording / "groundtruth.txt")
    np.savetxt(folder / "groundtruth.txt", change(rows), fmt="%.9f")  # type: ignore[operator]
    return folder


def advice(diagnosis: Diagnosis) -> list[str]:
    return [found.name for found in diagnosis.findings if found.severity != "note"]


def test_exact_poses_of_a_near_thing_are_proof(near: Path, tmp_path: Path) -> None:
    """The scene is made smaller, so that its median depth is 0.18 m."""
    depth_m = inspect(near, mode="ignore")[0].facts["depth_m"]
    smaller = 0.18 / depth_m["median"]  # type: ignore[index]
    folder = with_poses(near, tmp_path / "r", lambda rows: rows * [1, *[smaller] * 3, 1, 1, 1, 1])
    settings = CameraSettings(depth_scale=open_recording(near).depth_scale / smaller)
    diagnosis, _ = inspect(folder, settings)
    # Without poses half of it is unlikely near, and another scale is advised.
    without, _ = inspect(folder, settings, mode="ignore")
    assert "depth_scale" in advice(without)
    assert [name for name in advice(diagnosis) if name != "reader"] == []  # of the scale in camera.json
    assert diagnosis.facts["pose_residual_mm"] < FIT_MM  # type: ignore[operator]
    assert likely_cause(open_recording(folder, settings))[0] == ""


def test_exact_poses_settle_how_high_the_camera_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some 20 cm above the table: an unlikely height, of which nothing is to be said where poses prove it."""
    low = small_thing(tmp_path / "mug", distance_m=0.3, elevation_rad=0.6)
    diagnosis, look = inspect(low)
    assert look is not None and advice(diagnosis) == []
    assert diagnosis.facts["camera_height_m"] < 0.25  # type: ignore[operator]
    fit = fit_trajectory(look)
    assert fit is not None and fit.proven
    monkeypatch.setattr("kinectbench.doctor.examine.fit_trajectory", lambda _: replace(fit, proven=False))
    assert "camera_height" in advice(inspect(low)[0])


def test_a_wrong_scale_is_still_told(near: Path) -> None:
    scale = float(inspect(near)[0].facts["depth_scale"])  # type: ignore[arg-type]
    wrong, _ = inspect(near, CameraSettings(depth_scale=scale / 5))
    assert "depth_scale" in advice(wrong) or "trajectory_scale" in advice(wrong)


def inverse(rows: np.ndarray) -> np.ndarray:
    from kinectbench.core.geometry import rotation_from_quaternion_xyzw

    out = rows.copy()
    turned = rotation_from_quaternion_xyzw(rows[:, 4:8])
    out[:, 1:4] = -np.einsum("nji,nj->ni", turned, rows[:, 1:4])
    out[:, 4:7] *= -1
    return out


def test_poses_that_are_meant_otherwise_are_named_with_a_small_residual(near: Path, tmp_path: Path) -> None:
    diagnosis, _ = inspect(with_poses(near, tmp_path / "inverse", inverse))
    (found,) = (each for each in diagnosis.findings if each.name == "trajectory_reading")
    assert "world to camera" in found.what
    (residual,) = re.findall(r"residual ([0-9.]+) mm", found.what)
    assert float(residual) < FIT_MM


@pytest.mark.parametrize("seed", range(4))
def test_poses_of_another_recording_are_never_called_a_fit(near: Path, tmp_path: Path, seed: int) -> None:
    def exchanged(rows: np.ndarray) -> np.ndarray:
        rng = np.random.default_rng(seed)
        out = rows.copy()
        out[:, 1:] = rows[rng.permutation(len(rows)), 1:]
        out[:, 1:4] *= rng.uniform(0.5, 2, (len(rows), 1))
        return out

    diagnosis, _ = inspect(with_poses(near, tmp_path / "other", exchanged))
    assert not any("do fit" in found.what for found in diagnosis.findings)
    assert "trajectory_scale" not in advice(diagnosis)


@pytest.mark.parametrize("residual_m", [0.0501, 0.6991, np.nan])
@pytest.mark.parametrize(
    "convention",
    [PoseConvention(inverse=True), PoseConvention(unit_m=1000.0), PoseConvention(images="mirrored")],
)
def test_no_convention_that_leaves_over_50_mm_is_called_a_fit(
    near: Path, residual_m: float, convention: PoseConvention
) -> None:
    look = probe_recording(open_recording(near))
    fit = fit_trajectory(look)
    assert fit is not None
    # However far the things are, and so however much noise there is.
    far = [replace(pair, points=1000 * pair.points) for pair in fit.pairs]
    assert not fits(residual_m, far) and fits(0.0499, far)
    bad = replace(fit, convention=convention, residual_m=residual_m, fits=fits(residual_m, far), proven=False)
    said = [found for found in check_trajectory(look, bad) if found.severity != "note"]
    assert [found.name for found in said] == ["trajectory_wrong"]
    assert "the nearest being" in said[0].what
    assert "in no convention" in said[0].what and "nan" not in said[0].what and "do fit" not in said[0].what


def test_a_convention_that_nearly_fits_is_reported_with_its_residual(near: Path) -> None:
    """As of a noisy sensor: below 50 mm, but more than noise."""
    look = probe_recording(open_recording(near))
    fit = fit_trajectory(look)
    assert fit is not None
    nearly = replace(fit, convention=PoseConvention(inverse=True), residual_m=0.012, fits=False, proven=False)
    (said,) = (found for found in check_trajectory(look, nearly) if found.severity == "stops")
    assert "nearest being: world to camera (inverse) (12 mm off, more than noise explains)" in said.what
    assert "write them again" in said.advice
