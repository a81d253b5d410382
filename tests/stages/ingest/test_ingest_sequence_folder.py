"""Writing and reading the sequence folder, and every recording that must be refused on the way."""

import json
import re
import struct
import zlib
from dataclasses import replace as replaced
from pathlib import Path

import numpy as np
import pytest
from ingest_writers import (
    CAMERA,
    START_NS,
    STEP_NS,
    color_image,
    depth_image,
    jpeg,
    png,
    quaternion,
    seconds,
    translation,
    write_folder,
    write_seven_scenes,
    write_tum,
)
from raising import raises

from kinectbench.core.errors import RecordingError, StorageError, TrackingError
from kinectbench.core.geometry import rotation_from_quaternion_xyzw
from kinectbench.core.threads import using_threads
from kinectbench.doctor.during_build import OffsetWatch
from kinectbench.settings.models import CameraSettings, TrackingSettings
from kinectbench.stages.ingest.depth_code import encode_depth
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import ColorCalibration, Recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence
from kinectbench.stages.track import track


def ingest(path: Path, settings: CameraSettings | None = None) -> list[str]:
    return write_sequence(open_recording(path, settings), path.parent / "sequence")


def test_round_trip(tmp_path: Path) -> None:
    calls: list[tuple[int, int]] = []
    recording = open_recording(write_tum(tmp_path / "r"))
    warnings = write_sequence(recording, tmp_path / "s", lambda done, of: calls.append((done, of)))
    assert (warnings, calls) == ([], [(i, 5) for i in range(1, 6)])
    sequence = read_sequence(tmp_path / "s")
    assert (len(sequence), sequence.depth_scale, sequence.color_registered) == (5, 5000.0, True)
    assert sequence.camera == recording.camera
    assert sequence.stamps_ns.tolist() == [START_NS + i * STEP_NS for i in range(5)]
    for i in range(5):
        np.testing.assert_array_equal(sequence.frames.depth_native(i), depth_image(i))
        assert sequence.frames.color_encoded(i) == (".jpg", jpeg(color_image(i)))
        assert (tmp_path / f"s/depth/{i:06d}.kbd").read_bytes() == encode_depth(depth_image(i))
    assert sequence.depth_m(1)[0, 6] == np.float32(depth_image(1)[0, 6] / 5000)
    trajectory = sequence.given_trajectory
    assert trajectory is not None
    rotation = rotation_from_quaternion_xyzw(quaternion(2))
    np.testing.assert_allclose(trajectory.T_world_camera[2, :3, :3], rotation, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(trajectory.T_world_camera[2, :3, 3], translation(2))
    head = json.loads((tmp_path / "s/camera.json").read_text())
    assert len(head.pop("depth_sketch")) == 5
    assert head == {
        "format_version": 2,
        **CAMERA,
        "depth_scale": 5000.0,
        "color_registered": True,
        "registered_by": "recording",
        "source_format": "tum",
        "frames": 5,
        "warnings": [],
        "trajectory_error": "",
    }
    rows = json.loads((tmp_path / "s/frames.json").read_text())
    row = {
        "index": 1,
        "recorded": 1,
        "stamp_ns": START_NS + STEP_NS,
        "depth": "depth/000001.kbd",
        "color": "color/000001.jpg",
        "mask": None,
    }
    assert rows[1] == row


def test_without_colour_and_trajectory(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    for image in (folder / "color").iterdir():
        image.unlink()
    ingest(folder)
    sequence = read_sequence(tmp_path / "sequence")
    assert sequence.given_trajectory is None
    assert sequence.frames.color_encoded(0) is None
    assert sequence.color_rgb(0) is None


def test_cleaned_depth_is_what_is_stored(tmp_path: Path) -> None:
    ingest(write_seven_scenes(tmp_path / "r"))
    depth = read_sequence(tmp_path / "sequence").frames.depth_native(2)
    expected = depth_image(2, 1000.0)
    expected[10:12, 10:12] = 0
    np.testing.assert_array_equal(depth, expected)


@pytest.mark.parametrize(
    ("file", "damage", "message"),
    [
        ("camera.json", "{}", "camera.json: 'format_version': Field required"),
        ("camera.json", '{"format_version": 99}', "written in format version 99"),
        ("frames.json", "[{}]", r"frames\.json: '0\.index': Field required"),
        ("frames.json", "[", r"frames\.json: not valid JSON"),
        ("given_trajectory.txt", "1 2 3", "given_trajectory.*line 1"),
    ],
)
def test_damaged_sequence_folder(tmp_path: Path, file: str, damage: str, message: str) -> None:
    ingest(write_tum(tmp_path / "r"))
    (tmp_path / "sequence" / file).write_text(damage)
    with raises(StorageError, "storage.damaged", match=f"(?s){message}.*run `kinectbench ingest`"):
        read_sequence(tmp_path / "sequence")


def test_damaged_images_in_a_sequence_folder(tmp_path: Path) -> None:
    ingest(write_tum(tmp_path / "r"))
    sequence = read_sequence(tmp_path / "sequence")
    (tmp_path / "sequence/depth/000000.kbd").write_bytes(b"")
    (tmp_path / "sequence/depth/000001.kbd").unlink()
    with raises(StorageError, "storage.damaged", match=r"000000\.kbd"):
        sequence.frames.depth_native(0)
    with raises(StorageError, "storage.damaged", match=r"000001\.kbd"):
        sequence.frames.depth_native(1)


def cut_in_half(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


def flip_a_byte(file: Path) -> None:
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0x10
    file.write_bytes(data)


@pytest.mark.parametrize(
    "damage", [cut_in_half, flip_a_byte, Path.unlink, lambda file: file.write_bytes(b"")]
)
def test_one_damaged_frame_among_many_is_left_out(tmp_path: Path, damage: object) -> None:
    folder = write_tum(tmp_path / "r", frames=21)
    assert callable(damage)
    damage(folder / "depth/7.png")
    warnings = ingest(folder)
    assert len(warnings) == 1
    assert warnings[0].startswith(f"frame left out: {folder / 'depth/7.png'}: ")
    sequence = read_sequence(tmp_path / "sequence")
    assert len(sequence) == 20
    np.testing.assert_array_equal(sequence.frames.depth_native(7), depth_image(8))
    assert sequence.stamps_ns[7] == START_NS + 8 * STEP_NS


def test_damaged_colour_counts_as_a_damaged_frame(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r", frames=41)
    cut_in_half(folder / "rgb/7.jpg")
    (folder / "rgb/0.jpg").unlink()
    warnings = ingest(folder)
    assert [warning.split(": ")[0] for warning in warnings] == ["frame left out"] * 2
    assert "rgb/0.jpg" in warnings[0]
    assert "the JPEG is cut off" in warnings[1]


def undecodable_png(image: np.ndarray) -> bytes:
    """A PNG whose header and checksums are right, and whose pixels are none."""
    whole = png(image)
    junk = b"no stream of zlib's"
    chunk = b"IDAT" + junk
    return (
        whole[: whole.index(b"IDAT") - 4]
        + struct.pack(">I", len(junk))
        + chunk
        + struct.pack(">I", zlib.crc32(chunk))
        + struct.pack(">I", 0)
        + b"IEND"
        + struct.pack(">I", zlib.crc32(b"IEND"))
    )


def test_colour_that_is_damaged_behind_its_header_is_left_out(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r", frames=41)
    broken = bytearray(jpeg(color_image(7)))
    table = broken.index(b"\xff\xc4") + 4
    broken[table : table + 18] = b"\xff" * 18
    (folder / "rgb/7.jpg").write_bytes(broken)
    recording = open_recording(folder)
    (warning,) = write_sequence(recording, tmp_path / "sequence", watch=OffsetWatch(recording))
    assert "colour" in warning and "7.png: cannot be decoded" in warning
    sequence = read_sequence(tmp_path / "sequence")
    assert (len(sequence), sequence.color_rgb(7) is None) == (40, False)
    (tmp_path / "sequence/color/000003.jpg").write_bytes(broken)
    with raises(StorageError, "storage.damaged", match="colour of frame 3 cannot be decoded"):
        sequence.color_rgb(3)


def beside(recording: Recording) -> Recording:
    """The recording, its colour by a camera a little beside that of depth."""
    T_color_depth = np.eye(4)
    T_color_depth[0, 3] = 0.025
    calibration = ColorCalibration(recording.camera, (), T_color_depth)
    return replaced(recording, color_registered=False, color_calibration=calibration)


def test_the_order_of_damage_is_that_of_the_frames(tmp_path: Path) -> None:
    """However many threads: colour that cannot be registered, then depth, then a file that is missing."""
    folder = write_tum(tmp_path / "r", frames=81)
    (folder / "rgb/3.jpg").write_bytes(undecodable_png(color_image(3)))
    cut_in_half(folder / "depth/5.png")
    (folder / "rgb/6.jpg").unlink()
    found = []
    for threads in (1, 4):
        target = tmp_path / f"by {threads}"
        with using_threads(threads):
            warnings = write_sequence(beside(open_recording(folder)), target)
        numbers = [re.findall(r"/(\d+)\.(?:png|jpg)", warning)[0] for warning in warnings]
        assert numbers == ["3", "5", "6"]
        files = sorted(path for path in target.rglob("*") if path.is_file())
        found.append({path.relative_to(target): path.read_bytes() for path in files})
    assert found[0] == found[1]


@pytest.mark.parametrize("threads", [1, 4])
def test_the_first_error_is_told(tmp_path: Path, threads: int) -> None:
    """Colour of another size is found when it is registered; depth of another size, before."""
    folder = write_tum(tmp_path / "r", frames=12)
    (folder / "rgb/3.jpg").write_bytes(jpeg(color_image(3)[::2, ::2]))
    (folder / "depth/5.png").write_bytes(png(depth_image(5)[:, :32]))
    with using_threads(threads), raises(RecordingError, "recording.malformed", match="32x24"):
        write_sequence(beside(open_recording(folder)), tmp_path / "s")


def test_many_damaged_frames_are_refused(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r", frames=20)
    cut_in_half(folder / "depth/7.png")
    with raises(RecordingError, "recording.too-many-damaged", match=r"depth/7\.png.*\(1.*20"):
        ingest(folder)


def replace(folder: Path, index: int, data: bytes) -> Path:
    (folder / f"depth/{index}.png").write_bytes(data)
    return folder


def test_depth_that_is_not_16_bit_grey(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    picture = (depth_image(0) // 256).astype(np.uint8)
    with raises(RecordingError, "recording.too-many-damaged", match=r"depth/2\.png.*8-bit.*1"):
        ingest(replace(folder, 2, png(picture)))
    with raises(RecordingError, "recording.too-many-damaged", match=r"depth/2\.png.*16-bit.*\(uint16\)"):
        ingest(replace(folder, 2, png(np.dstack([depth_image(0)] * 3))))
    for i in range(5):
        replace(folder, i, jpeg(picture))
    with raises(RecordingError, "recording.too-many-damaged", match=r"depth/0\.png.*16-bit"):
        ingest(folder)


def test_sizes_that_do_not_agree(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    with raises(RecordingError, "recording.too-many-damaged", match=r"3\.png.*32x48.*64x48"):
        ingest(replace(folder, 3, png(depth_image(3)[:, :32])))
    replace(folder, 3, png(depth_image(3)))
    (folder / "rgb/1.jpg").write_bytes(jpeg(np.zeros((96, 128, 3), np.uint8)))
    with raises(RecordingError, "recording.too-many-damaged", match=r"128x96.*64x48.*registered"):
        ingest(folder)


def test_colour_of_another_size_where_it_is_not_registered(tmp_path: Path) -> None:
    folder = write_seven_scenes(tmp_path / "a/r")
    (folder / "frame-000001.color.png").write_bytes(png(np.zeros((96, 128, 3), np.uint8)))
    assert ingest(folder) == []
    folder = write_folder(tmp_path / "b/r")
    for i in range(4):
        (folder / f"color/{i}.jpg").write_bytes(jpeg(np.zeros((96, 128, 3), np.uint8)))
    ingest(folder)
    assert not read_sequence(tmp_path / "b/sequence").color_registered


@pytest.mark.parametrize(("wrong", "median"), [(100.0, "58.6"), (100_000.0, "0.0586")])
def test_absurd_depth_scale(tmp_path: Path, wrong: float, median: str) -> None:
    folder = write_tum(tmp_path / "r")
    message = (
        rf"r: the median depth is {median} m at {wrong:g} native .*units a metre; at 5000 it would be 1\.17 m"
    )
    with raises(RecordingError, "recording.bad-depth-scale", match=message):
        ingest(folder, CameraSettings(depth_scale=wrong))


def test_empty_depth(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    empty = png(np.zeros((48, 64), np.uint16))
    assert ingest(replace(folder, 1, empty)) == [
        f"1 depth images are empty, the first is {folder}/depth/1.png"
    ]
    for i in range(5):
        replace(folder, i, empty)
    with raises(RecordingError, "recording.empty-depth", match=r"depth/0\.png.*5"):
        ingest(folder)


def test_too_few_frames(tmp_path: Path) -> None:
    with raises(RecordingError, "recording.too-few-frames", match="2; at least 3"):
        ingest(write_tum(tmp_path / "r", frames=2))


def test_trajectory_of_another_time(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    (folder / "groundtruth.txt").write_text("10 0 0 0 0 0 0 1\n12.5 0 0 0 0 0 0 1\n")
    first, last = seconds(START_NS), seconds(START_NS + 4 * STEP_NS)
    message = rf"\(10\.000000000 to 12\.500000000 s\) shares no time with the frames \({first} to {last} s\)"
    with raises(RecordingError, "recording.bad-poses", match=message):
        ingest(folder)


@pytest.mark.parametrize("row", ["1 2 3", "1 0 0 0 nan 0 0 1", "9 0 0 0 0 0 0 1"])
def test_a_broken_trajectory_can_be_ignored(tmp_path: Path, row: str) -> None:
    folder = write_tum(tmp_path / "r")
    (folder / "groundtruth.txt").write_text(row + "\n")
    recording = open_recording(folder)
    with raises(RecordingError, "recording.bad-poses", match="`trajectory: ignore`"):
        write_sequence(recording, tmp_path / "strict")
    (warning,) = write_sequence(recording, tmp_path / "s", needs_trajectory=False)
    assert (warning.endswith("it is ignored") and "trajectory" in warning) or "groundtruth" in warning
    sequence = read_sequence(tmp_path / "s")
    assert sequence.given_trajectory is None
    # It was ignored because that was asked for; whoever now asks for it is told.
    for mode in (None, "trust", "refine"):
        with raises(TrackingError, "tracking.bad-given", match=re.escape(sequence.trajectory_error)):
            track(sequence, mode, TrackingSettings())


@pytest.mark.parametrize(("said", "given"), [(5000, 5000.0), (5000, 1000.0), (None, 1000.0)])
def test_a_depth_scale_that_contradicts_the_recordings_is_told(
    tmp_path: Path, said: float | None, given: float
) -> None:
    folder = write_tum(tmp_path / "r")
    (folder / "camera.json").write_text(json.dumps({**CAMERA, "depth_scale": said}))
    recording = open_recording(folder, CameraSettings(depth_scale=given))
    assert recording.depth_scale == given
    told = [text for text in recording.warnings if "5000 units of depth, but `depth_scale: 1000`" in text]
    assert len(told) == (said is not None and said != given)


def test_a_folder_of_version_1_holds_png(tmp_path: Path) -> None:
    ingest(write_tum(tmp_path / "r"))
    folder = tmp_path / "sequence"
    rows = json.loads((folder / "frames.json").read_text())
    for i, row in enumerate(rows):
        row["depth"] = f"depth/{i:06d}.png"
        del row["mask"]
        (folder / row["depth"]).write_bytes(png(depth_image(i)))
    (folder / "frames.json").write_text(json.dumps(rows))
    head = json.loads((folder / "camera.json").read_text())
    (folder / "camera.json").write_text(json.dumps({**head, "format_version": 1}))
    sequence = read_sequence(folder)
    np.testing.assert_array_equal(sequence.frames.depth_native(3), depth_image(3))
    assert sequence.masks is None


def test_masks_come_along(tmp_path: Path) -> None:
    from test_ingest_phones_bop import bop

    write_sequence(open_recording(bop(tmp_path / "r")), tmp_path / "s")
    sequence = read_sequence(tmp_path / "s")
    assert sequence.masks is not None
    mask = sequence.masks(1)
    assert mask is not None
    assert mask.dtype == np.bool_ and mask.sum() == 5 * 64 and mask[:5].all()


def test_colour_with_a_calibration_is_registered(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    # The same camera, moved by 10 cm: at 1 m by 6 pixels.
    T = np.eye(4)
    T[0, 3] = -0.1
    said = {**CAMERA, "depth_scale": 5000, "color_registered": False}
    for file in (folder / "depth").iterdir():
        file.write_bytes(png(np.full((48, 64), 5000, np.uint16)))
    for file in (folder / "rgb").iterdir():
        ramp = np.tile(3 * np.arange(64, dtype=np.uint8) + 10, (48, 1))
        file.write_bytes(png(np.dstack([ramp] * 3)))
    (folder / "camera.json").write_text(
        json.dumps({**said, "color_camera": CAMERA, "T_color_depth": T.tolist()})
    )
    assert write_sequence(open_recording(folder), tmp_path / "s") == []
    sequence = read_sequence(tmp_path / "s")
    assert sequence.color_registered
    assert json.loads((tmp_path / "s/camera.json").read_text())["registered_by"] == "calibration"
    rgb = sequence.color_rgb(2)
    assert rgb is not None
    np.testing.assert_array_equal(rgb[20, 6:, 0], 3 * np.arange(58) + 10)
    assert not rgb[:, :5].any()
