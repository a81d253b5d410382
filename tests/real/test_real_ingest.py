"""Real recordings: the right number of frames, and a bag of the same frames gives the same sequence."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from ingest_writers import BagWriter
from read_pictures import read_picture

from kinectbench.core.errors import RecordingError
from kinectbench.core.geometry import Camera
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.stamps import parse_stamp_ns
from kinectbench.core.trajectory.text_rows import text_rows
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.readers import find_recordings, open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence

DATA = os.environ.get("KINECTBENCH_DATA")
pytestmark = pytest.mark.skipif(not DATA, reason="KINECTBENCH_DATA does not name a folder of real recordings")
ROOT = Path(DATA or ".")
CABINET = Camera(640, 480, 535.4, 539.2, 320.1, 247.6)
FREIBURG1 = CameraSettings(fx=517.3, fy=516.5, cx=318.6, cy=255.3)


def ingest(path: Path, folder: Path, settings: CameraSettings | None = None) -> tuple[Sequence, list[str]]:
    warnings = write_sequence(open_recording(path, settings), folder)
    return read_sequence(folder), warnings


def colored(sequence: Sequence) -> int:
    return sum(sequence.frames.color_encoded(i) is not None for i in range(len(sequence)))


def test_kitchen(tmp_path: Path) -> None:
    sequence, warnings = ingest(ROOT / "7scenes_redkitchen_000-149", tmp_path / "s")
    assert (len(sequence), colored(sequence), warnings) == (150, 150, [])
    assert sequence.camera == Camera(640, 480, 585.0, 585.0, 320.0, 240.0)
    assert sequence.given_trajectory is not None
    assert len(sequence.given_trajectory.stamps_ns) == 150
    depth = sequence.depth_m(75)
    assert 1 < np.median(depth[depth > 0]) < 4
    assert depth.max() < 20


def test_phone_looking_down() -> None:
    recording = open_recording(ROOT / "phone_looking_down")
    assert (recording.format, len(recording), recording.warnings) == ("scanner_app", 92, ())
    assert recording.given_trajectory is not None and len(recording.given_trajectory.stamps_ns) == 92
    depth_m = recording.frame(40).depth / recording.depth_scale
    assert 0.2 < np.median(depth_m[depth_m > 0]) < 0.9


def test_unsynchronised_stamps(tmp_path: Path) -> None:
    sequence, warnings = ingest(ROOT / "tum_fr1_xyz_150-179", tmp_path / "s", FREIBURG1)
    assert (len(sequence), colored(sequence)) == (32, 30)
    assert warnings == [
        f"{ROOT / 'tum_fr1_xyz_150-179'}: 2 of 32 depth frames have no colour frame within 18 ms"
    ]
    assert sequence.stamps_ns[0] == 1_305_031_107_130_308_000
    assert sequence.given_trajectory is not None
    assert len(sequence.given_trajectory.stamps_ns) == 147


def wrap_cabinet(bag_file: Path) -> None:
    folder = ROOT / "tum_fr3_cabinet"
    camera = {name: getattr(CABINET, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    with BagWriter(bag_file, "LZ4", chunk_bytes=1 << 20) as bag:
        for _, row in text_rows(folder / "depth.txt"):
            stamp, name = row.split()
            depth = read_picture(folder / name, cv2.IMREAD_UNCHANGED)
            stamp_ns = parse_stamp_ns(stamp, name)
            bag.image("/camera/depth_registered/image_raw", stamp_ns, depth, "16UC1")
            bag.info("/camera/depth_registered/camera_info", stamp_ns, camera)
        for _, row in text_rows(folder / "rgb.txt"):
            stamp, name = row.split()
            data = (folder / name).read_bytes()
            bag.compressed("/camera/rgb/image_color/compressed", parse_stamp_ns(stamp, name), data, "jpeg")
        for _, row in text_rows(folder / "groundtruth.txt"):
            stamp, *numbers = row.split()
            values = [float(number) for number in numbers]
            bag.pose("/camera/pose", parse_stamp_ns(stamp, "row"), values[:3], values[3:])


def test_cabinet_as_a_folder_and_as_a_bag(tmp_path: Path) -> None:
    wrap_cabinet(tmp_path / "cabinet.bag")
    a, a_warnings = ingest(ROOT / "tum_fr3_cabinet", tmp_path / "a")
    b, b_warnings = ingest(tmp_path / "cabinet.bag", tmp_path / "b", CameraSettings(depth_scale=5000.0))
    assert (a_warnings, b_warnings) == ([], [])
    assert (len(a), colored(a), a.camera) == (58, 58, CABINET)
    assert (a.camera, a.depth_scale, a.color_registered) == (b.camera, b.depth_scale, b.color_registered)
    for name in ("frames.json", "given_trajectory.txt"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    for i in range(58):
        np.testing.assert_array_equal(a.frames.depth_native(i), b.frames.depth_native(i))
        assert a.frames.color_encoded(i) == b.frames.color_encoded(i)


def test_find_recordings() -> None:
    found = {path.name: name for path, name in find_recordings(ROOT)}
    assert found["tum_fr3_cabinet"] == found["tum_fr1_xyz_150-179"] == "tum"
    assert found["7scenes_redkitchen_000-149"] == "7scenes"
    assert found["tf_example.bag"] == "rosbag1"


def test_a_bag_without_images() -> None:
    with pytest.raises(RecordingError, match=r"tf_example\.bag: no topic holds depth images.*are: none"):
        open_recording(ROOT / "evo_trajectories/tf_example.bag")
