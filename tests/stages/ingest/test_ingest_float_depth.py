"""Depth in floats, in formats whose own unit is one of whole numbers, and in formats that have no floats."""

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ingest_writers import depth_image, write_folder, write_seven_scenes, write_tum
from raising import raises
from test_ingest_record3d import expected, r3d
from test_ingest_transforms import transforms

from kinectbench.core.errors import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.depth_codes import ray_lengths
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import write_sequence


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def floats(unit_m: float = 1.0) -> bytes:
    """The depth image 1 as float32."""
    return npy((depth_image(1, 5000.0) / 5000 / unit_m).astype(np.float32))


def in_arrays(folder: Path, listing: str, data: bytes) -> Path:
    """Put this array in place of each depth image, also in the file that lists them."""
    for image in sorted((folder / "depth").iterdir()):
        image.with_suffix(".npy").write_bytes(data)
        image.unlink()
    file = folder / listing
    text = file.read_text()
    for image in sorted((folder / "depth").iterdir()):
        text = text.replace(f"depth/{image.stem}.png", f"depth/{image.name}")
    file.write_text(text)
    return folder


def check_metres(folder: Path, settings: CameraSettings | None = None) -> None:
    recording = open_recording(folder, settings)
    assert (recording.depth_scale, recording.float_scale is None) == (5000.0, False)
    np.testing.assert_array_equal(recording.frame(1).depth, depth_image(1, 5000.0))


@pytest.mark.parametrize(
    ("shared", "unit_m", "given"),
    [
        ({}, 1.0, None),
        ({}, 0.001, None),
        ({"depth_unit_scale_factor": 1.0}, 1.0, None),
        ({"depth_unit_scale_factor": 0.01}, 0.01, None),
        ({"depth_unit_scale_factor": 1.0}, 0.01, 100.0),
    ],
)
def test_floats_beside_a_transforms_json(
    tmp_path: Path, shared: dict[str, Any], unit_m: float, given: float | None
) -> None:
    folder = in_arrays(transforms(tmp_path / "r", shared), "transforms.json", floats(unit_m))
    check_metres(folder, CameraSettings(depth_scale=given))


def test_floats_in_the_lists_of_tum_have_their_own_unit(tmp_path: Path) -> None:
    folder = in_arrays(write_tum(tmp_path / "r"), "depth.txt", floats())
    check_metres(folder)
    said = json.loads((folder / "camera.json").read_text())
    (folder / "camera.json").write_text(json.dumps(said | {"depth_scale": 1000}))
    check_metres(folder)


@pytest.mark.parametrize("given", [1.0, 2.0])
def test_a_given_scale_is_that_of_the_floats_of_record3d(tmp_path: Path, given: float) -> None:
    recording = open_recording(r3d(tmp_path / "r.r3d"), CameraSettings(depth_scale=given))
    found = recording.frame(1).depth / recording.depth_scale
    np.testing.assert_allclose(found, expected(1) / 5000 / given, atol=0.0001)


def test_floats_where_a_format_has_whole_numbers_are_refused(tmp_path: Path) -> None:
    folder = write_seven_scenes(tmp_path / "r")
    for image in folder.glob("*depth.png"):
        image.write_bytes(floats())
    with raises(RecordingError, "recording.other-image", match="floats, but depth of the format 7scenes"):
        open_recording(folder).frame(1)


@pytest.mark.parametrize("write", [write_folder, write_tum])
def test_codes_of_bits_are_refused_for_floats(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    folder = write(tmp_path / "r")
    listing = "depth.txt" if write is write_tum else "camera_intrinsic.json"
    in_arrays(folder, listing, floats())
    for code in ("rotated", "float16"):
        with raises(RecordingError, "recording.unused-setting", match=code):
            open_recording(folder, CameraSettings(depth_code=code))
    check_metres(folder, CameraSettings(depth_code="plain"))
    recording = open_recording(folder, CameraSettings(depth_code="ray_distance"))
    right = np.rint(depth_image(1, 5000.0) / ray_lengths(recording.camera))
    np.testing.assert_array_equal(recording.frame(1).depth, right)


def test_no_scale_is_suggested_for_floats_that_no_room_has(tmp_path: Path) -> None:
    folder = in_arrays(write_folder(tmp_path / "r"), "camera_intrinsic.json", floats(100.0))
    with raises(RecordingError, "recording.bad-depth-scale", match=r"\(units a metre\); where it has poses"):
        write_sequence(open_recording(folder), tmp_path / "sequence")
