"""Which of several CameraInfo of a bag is that of the depth, and what is said where two contradict."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ingest_writers import CAMERA, START_NS, BagWriter, color_image, depth_image

from kinectbench.core.geometry import rigid
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.bags.ros_recording import RosRecording
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import Recording

OTHER = {**CAMERA, "fx": 42.5, "cx": 30.0}
COLOR = "/camera/color/image_raw"
DEPTH = "/camera/depth/image_raw"
BESIDE = "/camera/aligned_depth_to_color"
ALIGNED = f"{BESIDE}/image_raw"
WIDE = {**OTHER, "width": 128}


def opened(
    root: Path,
    depth: str,
    infos: dict[str, tuple[dict[str, Any], str]],
    frame_ids: tuple[str, str] = ("color", "color"),
    settings: CameraSettings | None = None,
    other_images: str = "",
) -> Recording:
    """A bag with these CameraInfo: {folder: (values, frame)}; frames of depth and of colour; other images."""
    with BagWriter(root / "r.bag") as bag:
        for folder, (values, frame_id) in infos.items():
            bag.info(f"{folder}/camera_info", START_NS, values, frame_id=frame_id)
        bag.image(depth, START_NS, depth_image(0), "16UC1", frame_ids[0])
        bag.image(COLOR, START_NS, color_image(0), "bgr8", frame_ids[1])
        if other_images:
            bag.image(other_images, START_NS, color_image(0), "bgr8", "other")
    return open_recording(root / "r.bag", settings)


def test_aligned_depth_is_seen_by_the_colour_camera(tmp_path: Path) -> None:
    """A driver that writes the depth camera's own values beside depth that it has aligned to colour."""
    infos = {
        BESIDE: (OTHER, "color"),
        "/camera/color": (CAMERA, "color"),
    }
    recording = opened(tmp_path, ALIGNED, infos)
    assert (recording.camera.fx, recording.camera.cx) == (60.0, 31.5)
    (warning,) = recording.warnings
    assert "\n" not in warning
    for part in (
        "/camera/color/camera_info (fx: 60, fy: 61, cx: 31.5, cy: 23.5)",
        "/camera/aligned_depth_to_color/camera_info (fx: 42.5, fy: 61, cx: 30, cy: 23.5)",
        "put `camera: {fx: 42.5, fy: 61, cx: 30, cy: 23.5}` into benchmark.yaml",
    ):
        assert part in warning


def test_settings_end_the_doubt(tmp_path: Path) -> None:
    infos = {
        BESIDE: (OTHER, "color"),
        "/camera/color": (CAMERA, "color"),
    }
    settings = CameraSettings(fx=42.5, fy=61.0, cx=30.0, cy=23.5)
    recording = opened(tmp_path, ALIGNED, infos, settings=settings)
    assert (recording.camera.fx, recording.warnings) == (42.5, ())


@pytest.mark.parametrize("beside_first", [True, False])
def test_the_one_beside_the_images_wins(tmp_path: Path, beside_first: bool) -> None:
    """Depth that by its name is not aligned; two drivers give both cameras one frame."""
    infos = {"/camera/depth": (CAMERA, "camera"), "/camera/color": (OTHER, "camera")}
    order = infos if beside_first else dict(reversed(infos.items()))
    recording = opened(tmp_path, DEPTH, order, ("camera", "camera"))
    assert recording.camera.fx == 60.0
    assert "contradict each other" in recording.warnings[0] and "fx: 42.5" in recording.warnings[0]


def test_beside_comes_before_the_frame(tmp_path: Path) -> None:
    """A frame_id that the driver got wrong: the other camera's lies elsewhere."""
    infos = {"/camera/depth": (CAMERA, "typo"), "/other/depth": (OTHER, "depth")}
    recording = opened(tmp_path, DEPTH, infos, ("depth", "color"))
    assert (recording.camera.fx, recording.warnings) == (60.0, ())


@pytest.mark.parametrize(
    ("depth", "infos", "frame_ids"),
    [
        # The same camera twice.
        (ALIGNED, {BESIDE: (CAMERA, "color"), "/camera/color": (CAMERA, "color")}, None),
        # Two cameras of one size, each with its own frame.
        (DEPTH, {"/camera/depth": (CAMERA, "d"), "/camera/color": (OTHER, "c")}, ("d", "c")),
        # Another size is another image's.
        (ALIGNED, {BESIDE: (CAMERA, "color"), "/camera/color": (WIDE, "color")}, None),
        # Aligned depth without any of its own.
        (ALIGNED, {"/camera/color": (CAMERA, "c")}, ("d", "c")),
    ],
)
def test_nothing_is_said_where_nothing_contradicts(
    tmp_path: Path,
    depth: str,
    infos: dict[str, tuple[dict[str, Any], str]],
    frame_ids: tuple[str, str] | None,
) -> None:
    recording = opened(tmp_path, depth, infos, frame_ids or ("color", "color"))
    assert recording.camera.fx == 60.0
    assert not any("contradict" in warning for warning in recording.warnings)


@pytest.mark.parametrize("other", ["/left/depth", "/camera/depth_registered", "/calibrated"])
def test_another_of_one_size_and_frame_is_told_wherever_it_lies(tmp_path: Path, other: str) -> None:
    infos = {"/camera/depth": (CAMERA, "d"), other: (OTHER, "d")}
    recording = opened(tmp_path, DEPTH, infos, ("d", "c"))
    assert recording.camera.fx == 60.0
    assert any("contradict" in said and f"{other}/camera_info" in said for said in recording.warnings)


def test_a_camera_info_beside_images_of_its_own_contradicts_nothing(tmp_path: Path) -> None:
    """Two devices whose drivers call their frames alike."""
    infos = {"/camera/depth": (CAMERA, "d"), "/left/depth": (OTHER, "d")}
    recording = opened(tmp_path, DEPTH, infos, ("d", "c"), other_images="/left/depth/image_rect")
    assert recording.camera.fx == 60.0
    assert not any("contradict" in warning for warning in recording.warnings)


@pytest.mark.parametrize("placed", [True, False])
@pytest.mark.parametrize("other", ["/camera/rgb", "/driver/settings"])
def test_two_of_colour_that_differ_are_told_where_colour_is_brought_to_depth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, placed: bool, other: str
) -> None:
    T_color_depth = rigid(np.eye(3), [0.05, 0.0, 0.0]) if placed else None
    monkeypatch.setattr(RosRecording, "color_place", lambda *_: T_color_depth)
    infos = {"/camera/depth": (CAMERA, "d"), "/camera/color": (CAMERA, "c"), other: (OTHER, "c")}
    recording = opened(tmp_path, DEPTH, infos, ("d", "c"))
    assert (recording.color_calibration is not None) == placed
    told = [said for said in recording.warnings if "contradict" in said]
    assert len(told) == placed
    for said in told:
        assert (
            f"{COLOR}: /camera/color/camera_info (fx: 60" in said and f"{other}/camera_info (fx: 42.5" in said
        )
        assert "leave the topic of the first out of the bag" in said and "\n" not in said
