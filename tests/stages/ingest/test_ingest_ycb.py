"""YCB's Berkeley RGB-D layout: one camera of five, its calibration, and the turntable's poses."""

import builtins
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from ingest_writers import CX, CY, FX, FY, color_image, depth_image, jpeg
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.depth_files import hdf5_arrays
from kinectbench.stages.ingest.images import DamagedImageError
from kinectbench.stages.ingest.readers import format_of, open_recording

h5py = pytest.importorskip("h5py", reason="needs kinectbench[ycb]")
ANGLES = (0, 3, 6, 357)
K = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1.0]])
# Colour has twice the pixels and lies 25 mm beside depth; NP3 lies 0.5 m beside NP5.
COLOR_K = np.array([[2 * FX, 0, 2 * CX + 0.5], [0, 2 * FY, 2 * CY + 0.5], [0, 0, 1.0]])
SCALE = 1.0017


def moved(x_m: float, turned_deg: float = 0.0) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.radians([0, turned_deg, 0]))[0]
    T[0, 3] = x_m
    return T


def on_table(angle: int) -> np.ndarray:
    """The place of NP5's colour camera on the turntable."""
    table: np.ndarray = moved(0, angle) @ moved(0.7)
    return table


def ycb(folder: Path, sensors: tuple[str, ...] = ("NP3", "NP5")) -> Path:
    (folder / "poses").mkdir(parents=True)
    with h5py.File(folder / "calibration.h5", "w") as file:
        for sensor in sensors:
            from_np5 = moved(0.5 if sensor == "NP3" else 0)
            file[f"{sensor}_depth_K"], file[f"{sensor}_rgb_K"] = K, COLOR_K
            file[f"{sensor}_rgb_d"] = np.array([0.1, -0.2, 0.001, 0.002, 0.05])
            file[f"{sensor}_ir_depth_scale"] = np.array([SCALE])
            file[f"H_{sensor}_from_NP5"], file[f"H_{sensor}_ir_from_NP5"] = from_np5, moved(-0.025) @ from_np5
    for angle in ANGLES:
        for sensor in sensors:
            with h5py.File(folder / f"{sensor}_{angle}.h5", "w") as file:
                file.create_dataset("depth", data=depth_image(angle, 10_000.0), compression="gzip")
            color = np.repeat(np.repeat(color_image(angle), 2, 0), 2, 1)
            (folder / f"{sensor}_{angle}.jpg").write_bytes(jpeg(color))
        with h5py.File(folder / f"poses/NP5_{angle}_pose.h5", "w") as file:
            file["H_table_from_reference_camera"] = on_table(angle)
            file["board_frame_offset"] = np.zeros(3)
    return folder


def change(file: Path, key: str, value: object) -> None:
    with h5py.File(file, "a") as opened:
        del opened[key]
        if value is not None:
            opened[key] = value


def test_one_camera_of_the_five(tmp_path: Path) -> None:
    folder = ycb(tmp_path / "r")
    assert format_of(folder) == "ycb"
    recording = open_recording(folder, CameraSettings(sensor="NP3"))
    assert (len(recording), recording.camera.fx, recording.camera.cx) == (len(ANGLES), FX, CX)
    assert recording.depth_scale == pytest.approx(10_000 / SCALE) and recording.warnings == ()
    assert recording.stamps_ns.tolist() == [angle * 10**9 for angle in ANGLES]
    np.testing.assert_array_equal(recording.frame(2).depth, depth_image(6, 10_000.0))
    calibration = recording.color_calibration
    assert calibration is not None and not recording.color_registered
    assert calibration.camera.fx == 2 * FX and calibration.distortion[:2] == (0.1, -0.2)
    np.testing.assert_allclose(calibration.T_color_depth, moved(0.025), atol=1e-12)


def test_its_poses_are_of_its_depth_camera_on_the_table(tmp_path: Path) -> None:
    folder = ycb(tmp_path / "r")
    for sensor, x_m in (("NP3", 0.475), ("NP5", -0.025)):
        given = open_recording(folder, CameraSettings(sensor=sensor)).given_trajectory
        assert given is not None
        for angle, T in zip(ANGLES, given.T_world_camera, strict=True):
            np.testing.assert_allclose(T, on_table(angle) @ np.linalg.inv(moved(x_m)), atol=1e-9)


def test_the_first_camera_is_read_and_the_others_are_named(tmp_path: Path) -> None:
    folder = ycb(tmp_path / "r")
    (line,) = open_recording(folder).warnings
    assert "NP3 is read" in line and "NP5" in line
    with raises(RecordingError, "recording.no-depth", match="name one of NP3, NP5"):
        open_recording(folder, CameraSettings(sensor="NP1"))


def test_its_mask_comes_onto_the_pixels_of_depth(tmp_path: Path) -> None:
    folder = ycb(tmp_path / "r")
    with h5py.File(folder / "calibration.h5", "a") as file:
        file["NP3_rgb_d"][:] = 0
    height, width = depth_image(0, 1.0).shape
    mask = np.zeros((2 * height, 2 * width), np.uint8)
    mask[height // 2 : height, width // 2 : width] = 1  # a quarter of the image; 1 is black in a bitmap
    (folder / "masks").mkdir()
    head = f"P4\n# drawn\n{2 * width} {2 * height}\n".encode()
    (folder / "masks/NP3_3_mask.pbm").write_bytes(head + np.packbits(mask, axis=1).tobytes())
    recording = open_recording(folder, CameraSettings(sensor="NP3"))
    assert recording.frame(0).mask is None
    raw = recording.frame(1)
    assert raw.mask is not None
    # Colour lies 25 mm beside depth: on its pixels the mask moves to the left by that.
    left_px = (FX * 0.025 * recording.depth_scale / raw.depth[raw.depth > 0]).mean()
    columns, rows = np.flatnonzero(raw.mask.any(axis=0)), np.flatnonzero(raw.mask.any(axis=1))
    assert abs(columns[0] - (width / 4 - left_px)) < 3 and abs(columns[-1] - (width / 2 - left_px)) < 3
    assert abs(rows[0] - height / 4) < 2 and abs(rows[-1] - height / 2) < 2
    for bad in (b"P5\n2 2\n255\n0000", b"P4\n99999 99999\n", head):
        (folder / "masks/NP3_3_mask.pbm").write_bytes(bad)
        with raises(RecordingError, "recording.damaged-image"):
            recording.frame(1)


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    folder, np3 = ycb(tmp_path / "r"), CameraSettings(sensor="NP3")
    (folder / "poses" / "NP5_3_pose.h5").unlink()
    recording = open_recording(folder, np3)
    assert recording.given_trajectory is not None and len(recording.given_trajectory.stamps_ns) == 3
    assert "1 of 4 frames have no pose" in recording.warnings[0]
    change(folder / "calibration.h5", "H_NP3_ir_from_NP5", None)
    recording = open_recording(folder, np3)
    assert recording.given_trajectory is None and recording.color_calibration is None
    assert "lacks H_NP3_ir_from_NP5" in recording.warnings[0] and "NP5" in recording.warnings[1]
    (folder / "calibration.h5").unlink()
    with raises(RecordingError, "recording.no-intrinsics", match="fx, fy, cx, cy"):
        open_recording(folder, np3)
    recording = open_recording(folder, CameraSettings(sensor="NP3", fx=FX, fy=FY, cx=CX, cy=CY))
    assert "has no calibration.h5" in recording.warnings[0]


def test_a_bad_pose_refuses_the_poses_but_not_the_recording(tmp_path: Path) -> None:
    folder = ycb(tmp_path / "r")
    (folder / "poses/NP5_3_pose.h5").write_bytes(b"\0")
    recording = open_recording(folder, CameraSettings(sensor="NP3"))
    assert recording.given_trajectory is None and "NP5_3_pose.h5" in recording.trajectory_error
    assert len(recording) == len(ANGLES)


@pytest.mark.parametrize("value", [np.eye(3), np.full((4, 4), np.nan), np.zeros((300, 400))])
def test_a_calibration_of_another_shape_is_refused(tmp_path: Path, value: np.ndarray) -> None:
    folder = ycb(tmp_path / "r")
    change(folder / "calibration.h5", "H_NP3_ir_from_NP5", value)
    with raises(RecordingError, "recording.malformed", match="H_NP3_ir_from_NP5"):
        open_recording(folder, CameraSettings(sensor="NP3"))


def test_depth_in_another_file_is_not_followed(tmp_path: Path) -> None:
    folder = ycb(tmp_path / "r")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["depth"] = depth_image(0, 10_000.0)
    change(folder / "NP3_3.h5", "depth", h5py.ExternalLink(str(tmp_path / "other.h5"), "depth"))
    with h5py.File(folder / "NP3_6.h5", "w") as file:
        layout = h5py.VirtualLayout(depth_image(0, 1.0).shape, "u2")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "depth", layout.shape)
        file.create_virtual_dataset("depth", layout)
    recording = open_recording(folder, CameraSettings(sensor="NP3"))
    for index, said in ((1, "is a link"), (2, "is no array of this file")):
        with raises(RecordingError, "recording.damaged-image", match=said):
            recording.frame(index)


def test_cut_and_changed_bytes_end_in_one_line(tmp_path: Path) -> None:
    folder = ycb(tmp_path / "r")
    whole, draw = (folder / "NP3_3.h5").read_bytes(), np.random.default_rng(5)
    recording = open_recording(folder, CameraSettings(sensor="NP3"))
    for count in (*range(8, len(whole), 97), *([None] * 200)):
        data = bytearray(whole[:count])
        if count is None:
            data[int(draw.integers(len(data)))] ^= 1 << int(draw.integers(8))
        (folder / "NP3_3.h5").write_bytes(data)
        try:
            recording.frame(1)
        except RecordingError as error:
            assert "\n" not in str(error)


def test_an_address_beyond_all_memory(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["depth"] = np.arange(3.0)
    data = (tmp_path / "a.h5").read_bytes()
    # The address of the file's end, as its superblock states it.
    damaged = data[:41] + (1 << 62).to_bytes(8, "little") + data[49:]
    with pytest.raises(DamagedImageError, match="damaged"):
        hdf5_arrays(damaged, "a.h5", ["depth"], 10)


def test_without_the_library_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, usual = ycb(tmp_path / "r"), builtins.__import__

    def without(name: str, *rest: Any, **more: Any) -> Any:
        if name == "h5py":
            raise ImportError(name)
        return usual(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with raises(RecordingError, "recording.no-package", match=r"'kinectbench\[ycb\]'"):
        open_recording(folder)
