"""Depth scales and focal lengths that are wrong, under poses that are right."""

import re
from pathlib import Path

import pytest
from wrong_recordings import make_wrong

from kinectbench.core.artefacts.sequence import CameraFile
from kinectbench.doctor import inspect
from kinectbench.doctor.during_build import OffsetWatch
from kinectbench.doctor.finding import Finding
from kinectbench.doctor.lengths import LENGTHS
from kinectbench.doctor.probe import probe_recording
from kinectbench.doctor.trajectory import fit_trajectory
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import write_sequence

SAMPLES = Path(__file__).parents[2] / "recordings"
CHAIR = SAMPLES / "chair_01"


def wrong(depth: float = 1.0, focal: float = 1.0) -> CameraSettings:
    """As if the chair's depth were so many times as far, and its focal lengths so many times as long."""
    right = open_recording(CHAIR)
    camera = right.camera
    said = {"depth_scale": right.depth_scale / depth, "cx": camera.cx, "cy": camera.cy}
    return CameraSettings.model_validate(said | {"fx": camera.fx * focal, "fy": camera.fy * focal})


def doubted(settings: CameraSettings) -> list[Finding]:
    return [found for found in inspect(CHAIR, settings)[0].findings if found.name == LENGTHS]


@pytest.mark.parametrize("name", ["chair_01", "table_01.bag"])
def test_right_lengths_are_proven(name: str) -> None:
    fit = fit_trajectory(probe_recording(open_recording(SAMPLES / name)))
    assert fit is not None and fit.proven and not fit.lengths.implausible
    assert (fit.lengths.depth, fit.lengths.focal) == pytest.approx((1, 1), abs=0.06)


@pytest.mark.parametrize("depth", [0.9, 1.1])
def test_a_wrong_scale_is_told_with_one_that_fits(depth: float) -> None:
    (found,) = doubted(wrong(depth=depth))
    assert found.severity == "warning" and "the object's size or shape may be wrong" in found.what
    right = open_recording(CHAIR).depth_scale
    value = float(re.findall(r"depth_scale: ([\d.]+)", found.advice)[0])
    assert value == pytest.approx(right, rel=0.05)


@pytest.mark.parametrize("focal", [0.9, 1.1])
def test_wrong_focal_lengths_are_told(focal: float) -> None:
    (found,) = doubted(wrong(focal=focal))
    assert "focal lengths" in found.what and "fx: " in found.advice
    fit = fit_trajectory(probe_recording(open_recording(CHAIR, wrong(focal=focal))))
    assert fit is not None and not fit.proven
    assert fit.lengths.focal * focal == pytest.approx(1, abs=0.08)


def test_a_build_stores_the_doubt(tmp_path: Path) -> None:
    recording = open_recording(CHAIR, wrong(depth=1.1))
    warnings = write_sequence(recording, tmp_path / "wrong", watch=OffsetWatch(recording))
    (doubt,) = CameraFile.read(tmp_path / "wrong").doubts
    assert f"{CHAIR}: {doubt}" in warnings and "`camera: {depth_scale: " in doubt
    assert str(CHAIR) not in doubt
    recording = open_recording(CHAIR)
    write_sequence(recording, tmp_path / "right", watch=OffsetWatch(recording))
    assert CameraFile.read(tmp_path / "right").doubts == ()
    assert "doubts" not in (tmp_path / "right/camera.json").read_text()


def test_poses_of_another_time_are_told_as_that(tmp_path: Path) -> None:
    folder = make_wrong(CHAIR, "poses 200 ms late", tmp_path / "r")
    names = [found.name for found in inspect(folder)[0].findings]
    assert "trajectory_delay" in names and LENGTHS not in names
