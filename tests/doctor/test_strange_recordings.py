"""`inspect` says what to do about poses of a mount, colour on its side, and depth in another code."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from ingest_writers import png
from read_pictures import read_picture

from kinectbench.doctor import inspect
from kinectbench.doctor.finding import Finding
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.settings.models import TrackingSettings

pytestmark = pytest.mark.xdist_group("strange recordings")


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A chair in a room, 24 frames of 160 x 120: a plain folder, depth in mm, without poses."""
    folder = tmp_path_factory.mktemp("strange") / "r"
    spec = {
        "object": "chair:seed=1",
        "format": "folder",
        "path": {"frames": 24, "arc_rad": 5.5, "distance_m": 1.6},
        "sensor": {"width": 160, "height": 120},
        "given": {"trajectory": "none"},
    }
    simulate(SimulationSpec.model_validate(spec), folder)
    return folder


@pytest.fixture
def folder(base: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(base, tmp_path / "r"))


def findings(folder: Path) -> dict[str, Finding]:
    diagnosis, _ = inspect(folder, tracking=TrackingSettings())
    return {finding.name: finding for finding in diagnosis.findings}


@pytest.mark.parametrize("turns", [0.0, 5.5])
def test_poses_of_one_position_are_those_of_a_mount(folder: Path, turns: float) -> None:
    poses = np.tile(np.eye(4), (24, 1, 1))
    poses[:, 2, 3] = 0.8
    for i, pose in enumerate(poses):
        pose[:3, :3] = cv2.Rodrigues(np.array([0.0, turns * i / 24, 0.0]))[0]
    np.savetxt(folder / "poses.txt", poses.reshape(24, 16))
    found = findings(folder)["trajectory_wrong"]
    assert found.severity == "stops" and "all have one position, as a turntable's or a mount's" in found.what
    assert "`trajectory: ignore`" in found.advice and "`segment_by: turntable`" in found.advice


def test_colour_on_its_side_is_said(folder: Path) -> None:
    assert "color_mirrored" not in findings(folder)
    camera = json.loads((folder / "camera_intrinsic.json").read_text())
    (folder / "camera_intrinsic.json").write_text(json.dumps({**camera, "color_registered": None}))
    for file in (folder / "color").iterdir():
        cv2.imwrite(str(file), np.rot90(read_picture(file)))
    found = findings(folder)
    assert "color_mirrored" not in found
    assert "colour is upright and depth on its side" in found["color_not_registered"].what
    assert "turn one by 90 degrees" in found["color_not_registered"].advice


@pytest.mark.parametrize("square", ["color", "depth"])
def test_square_images_are_not_on_their_side(folder: Path, square: str) -> None:
    camera = json.loads((folder / "camera_intrinsic.json").read_text())
    if square == "depth":
        camera = {**camera, "width": 120, "height": 120}
    (folder / "camera_intrinsic.json").write_text(json.dumps({**camera, "color_registered": None}))
    for file in (folder / "color").iterdir():
        image = read_picture(file)
        cv2.imwrite(str(file), image[:, :120] if square == "color" else np.rot90(image))
    for file in (folder / "depth").iterdir():
        if square == "depth":
            cv2.imwrite(str(file), read_picture(file, cv2.IMREAD_UNCHANGED)[:, :120])
    assert not any("on its side" in found.what for found in findings(folder).values())


@pytest.mark.parametrize("swapped", [False, True])
def test_raw_disparity_is_known_in_either_order_of_bytes(folder: Path, swapped: bool) -> None:
    for file in (folder / "depth").iterdir():
        m = read_picture(file, cv2.IMREAD_UNCHANGED) / 1000
        raw = np.where(m > 0, np.rint((1 / np.maximum(m, 0.3) - 3.3309495161) / -0.0030711016), 2047)
        stored = raw.astype(np.uint16)
        file.write_bytes(png(stored.byteswap() if swapped else stored))
    found = findings(folder)
    assert "depth_scale" not in found and "raw disparity" in found["invalid_code"].what
    assert found["invalid_code"].advice.startswith("exchange the two bytes") == swapped


@pytest.mark.parametrize("scale", [None, 10000.0])
def test_the_bits_of_a_float16_are_named_without_poses(folder: Path, scale: float | None) -> None:
    for file in (folder / "depth").iterdir():
        mm = read_picture(file, cv2.IMREAD_UNCHANGED)
        bits = (mm / 1000).astype(np.float16).view(np.uint16)
        file.write_bytes(png(bits if scale is None else (mm * 10.0).clip(0, 65535).astype(np.uint16)))
    found = findings(folder)["depth_scale"]
    assert ("as the bits of a float16 (of CO3D: `depth_code: float16`)" in found.advice) == (scale is None)
    assert "at 10000 the median would be" in found.advice
