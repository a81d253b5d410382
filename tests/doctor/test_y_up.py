"""A camera whose y axis points up, as ICL-NUIM's with its negative fy: what is read, and what is said."""

import json
from pathlib import Path

import numpy as np
import pytest
from analytic_scenes import box, depth_of, plane, ring, sphere
from ingest_writers import png

from kinectbench.core import IntrinsicsError
from kinectbench.core.geometry import Camera
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.trajectory_file import trajectory_text
from kinectbench.core.types import Float64
from kinectbench.doctor import inspect
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.readers import open_recording

CAMERA = Camera(160, 120, 130.0, 130.0, 80.0, 59.0)
SCENE = [plane((0, 0, 1), 0), box((-0.4, -0.2, 0), (0.3, 0.3, 0.3)), sphere((0.1, -0.5, 0.2), 0.2)]
POSES = ring(16, 1.6, elevations_rad=(0.4, 0.55, 0.7))
Y_UP = np.diag([1.0, -1.0, 1.0, 1.0])


def write(
    folder: Path, given: Float64, fy: float, trajectory: str = "trajectory.txt", tum: bool = False
) -> Path:
    """Depth of the scene; the given poses, as written, in a file of that name."""
    (folder / "depth").mkdir(parents=True)
    for i, T in enumerate(POSES):
        depth_mm = np.rint(1000 * depth_of(SCENE, CAMERA, T)).astype(np.uint16)
        (folder / f"depth/{i}.png").write_bytes(png(depth_mm * (5 if tum else 1)))
    stamps_ns = np.arange(len(POSES)) * 10**9
    (folder / trajectory).write_text(trajectory_text(GivenTrajectory(stamps_ns, given)))
    (folder / "intrinsics.txt").write_text(f"{CAMERA.fx} {fy} {CAMERA.cx} {CAMERA.cy}")
    if tum:
        (folder / "depth.txt").write_text("".join(f"{i} depth/{i}.png\n" for i in range(len(POSES))))
    return folder


@pytest.mark.parametrize(
    ("trajectory", "tum"),
    [("trajectory.txt", False), ("livingRoom2n.gt.freiburg", False), ("groundtruth.txt", True)],
)
def test_poses_beside_a_negative_fy_are_read_with_y_down(tmp_path: Path, trajectory: str, tum: bool) -> None:
    folder = write(tmp_path / "r", Y_UP @ POSES @ Y_UP, -CAMERA.fy, trajectory, tum)
    recording = open_recording(folder)
    assert recording.camera == CAMERA and recording.given_trajectory is not None
    assert np.allclose(recording.given_trajectory.T_world_camera, POSES, atol=1e-6)
    assert len([line for line in recording.warnings if "fy is negative: the camera's y axis" in line]) == 1
    diagnosis, _ = inspect(folder)
    assert diagnosis.facts["poses_read_as"] == "as given" and not diagnosis.stops


def test_such_poses_beside_a_positive_fy_are_explained(tmp_path: Path) -> None:
    diagnosis, _ = inspect(write(tmp_path / "r", Y_UP @ POSES @ Y_UP, CAMERA.fy))
    (found,) = (each for each in diagnosis.findings if each.severity == "stops")
    assert found.name == "trajectory_reading" and "y up, as in ICL-NUIM" in found.what
    assert "give fy the other sign in intrinsics.json" in found.advice


def test_right_poses_are_as_given(tmp_path: Path) -> None:
    diagnosis, _ = inspect(write(tmp_path / "r", POSES, CAMERA.fy))
    assert diagnosis.facts["poses_read_as"] == "as given" and not diagnosis.stops


def test_other_poses_beside_a_negative_fy_are_not_taken_as_they_are(tmp_path: Path) -> None:
    diagnosis, _ = inspect(write(tmp_path / "r", POSES, -CAMERA.fy))
    (found,) = (each for each in diagnosis.findings if each.severity == "stops")
    assert found.name == "trajectory_reading" and "give fy the other sign" in found.advice


def test_two_negative_focal_lengths_are_refused(tmp_path: Path) -> None:
    folder = write(tmp_path / "r", POSES, -CAMERA.fy)
    (folder / "intrinsics.txt").write_text(f"{-CAMERA.fx} {-CAMERA.fy} {CAMERA.cx} {CAMERA.cy}")
    (found,) = (each for each in inspect(folder)[0].findings if each.severity == "stops")
    assert "are not positive numbers" in found.what


def test_fy_of_the_settings_means_that_y_points_down(tmp_path: Path) -> None:
    folder = write(tmp_path / "r", POSES, -CAMERA.fy)
    given = CameraSettings(fx=CAMERA.fx, fy=CAMERA.fy, cx=CAMERA.cx, cy=CAMERA.cy)
    recording = open_recording(folder, given)
    assert recording.camera == CAMERA and recording.given_trajectory is not None
    assert np.allclose(recording.given_trajectory.T_world_camera, POSES, atol=1e-6)
    assert not [line for line in recording.warnings if "points up" in line]


def test_without_poses_nothing_is_mirrored_and_nothing_said(tmp_path: Path) -> None:
    folder = write(tmp_path / "r", POSES, -CAMERA.fy)
    (folder / "trajectory.txt").unlink()
    recording = open_recording(folder)
    assert recording.camera == CAMERA and not [line for line in recording.warnings if "points up" in line]


def test_colour_calibrated_to_a_camera_with_y_up_is_refused(tmp_path: Path) -> None:
    folder = write(tmp_path / "r", POSES, -CAMERA.fy)
    (folder / "intrinsics.txt").unlink()
    pixels = {name: getattr(CAMERA, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    color = {"color_camera": pixels, "T_color_depth": np.eye(4).tolist()}
    (folder / "camera.json").write_text(json.dumps(pixels | color | {"fy": -CAMERA.fy}))
    with pytest.raises(IntrinsicsError, match="'T_color_depth' beside an fy of -130"):
        open_recording(folder)
    (folder / "camera.json").write_text(json.dumps(pixels | color))
    assert open_recording(folder).color_calibration is not None
