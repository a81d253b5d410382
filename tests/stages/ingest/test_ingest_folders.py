"""The folder formats: TUM, 7-Scenes and plain colour + depth."""

import json
from pathlib import Path

import numpy as np
import pytest
from ingest_writers import (
    CAMERA,
    START_NS,
    STEP_NS,
    color_image,
    depth_image,
    every_frame,
    jpeg,
    png,
    translation,
    write_bag,
    write_folder,
    write_seven_scenes,
    write_tum,
)
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.core.geometry import Camera
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.readers import (
    FORMATS,
    find_recordings,
    name_suffixes,
    open_recording,
    reader_of,
    source_files,
)
from kinectbench.stages.ingest.recording import RawFrame, Recording

SMALL = Camera(**CAMERA)


def raw_frames(recording: Recording) -> list[RawFrame]:
    frames = list(every_frame(recording))
    assert all(isinstance(frame, RawFrame) for frame in frames)
    return [frame for frame in frames if isinstance(frame, RawFrame)]


def test_tum(tmp_path: Path) -> None:
    recording = open_recording(write_tum(tmp_path / "r"))
    frames = raw_frames(recording)
    assert (recording.format, recording.camera, recording.depth_scale) == ("tum", SMALL, 5000.0)
    assert recording.color_registered
    assert recording.warnings == ()
    assert [frame.stamp_ns for frame in frames] == [START_NS + i * STEP_NS for i in range(5)]
    for i, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.depth, depth_image(i))
        assert frame.color == (".jpg", jpeg(color_image(i)))
    assert recording.given_trajectory is not None
    np.testing.assert_array_equal(recording.given_trajectory.T_world_camera[3, :3, 3], translation(3))


def test_tum_lists_in_any_order_and_without_colour(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    rows = (folder / "depth.txt").read_text().splitlines()
    (folder / "depth.txt").write_text("\n".join([*reversed(rows), rows[2]]))
    (folder / "rgb.txt").unlink()
    (folder / "groundtruth.txt").unlink()
    recording = open_recording(folder)
    frames = raw_frames(recording)
    np.testing.assert_array_equal(frames[1].depth, depth_image(1))
    assert [frame.color for frame in frames] == [None] * 5
    assert recording.given_trajectory is None
    assert recording.warnings == (
        f"{folder / 'depth.txt'}: 1 rows repeat an earlier stamp and were left out",
    )


def test_tum_depth_frame_without_colour_is_kept(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    rows = (folder / "rgb.txt").read_text().splitlines()
    (folder / "rgb.txt").write_text("\n".join(rows[:3] + rows[4:]))
    recording = open_recording(folder)
    assert [frame.color is None for frame in raw_frames(recording)] == [False, False, True, False, False]
    assert recording.warnings == (f"{folder}: 1 of 5 depth frames have no colour frame within 17 ms",)


def test_settings_win_over_the_recording(tmp_path: Path) -> None:
    recording = open_recording(write_tum(tmp_path / "r"), CameraSettings(fx=70.0, depth_scale=1000.0))
    assert recording.camera == Camera(64, 48, 70.0, 61.0, 31.5, 23.5)
    assert recording.depth_scale == 1000.0


def test_missing_intrinsics(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    (folder / "camera.json").unlink()
    with raises(RecordingError, "recording.no-intrinsics", match=r"\(fx, fy, cx, cy\).*benchmark.yaml"):
        open_recording(folder)
    with raises(RecordingError, "recording.no-intrinsics", match=r"\(fx, cy\)"):
        open_recording(folder, CameraSettings(fy=61.0, cx=31.5))
    assert open_recording(folder, CameraSettings(fx=60.0, fy=61.0, cx=31.5, cy=23.5)).camera == SMALL


def test_intrinsics_of_another_size(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    with raises(RecordingError, "recording.bad-intrinsics", match=r"640x480.*64x48"):
        open_recording(folder, CameraSettings(width=640, height=480))
    full = CameraSettings(fx=525.0, fy=525.0, cx=319.5, cy=239.5)
    with raises(RecordingError, "recording.bad-intrinsics", match=r"\(319.5.*239.5\).*64x48"):
        open_recording(folder, full)
    (folder / "camera.json").write_text(json.dumps({**CAMERA, "width": 128}))
    with raises(RecordingError, "recording.bad-intrinsics", match="128x48"):
        open_recording(folder)
    assert open_recording(folder, CameraSettings(fx=60.0, fy=61.0, cx=31.5, cy=23.5)).camera == SMALL


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not valid JSON"),
        ("[]", "must hold an object"),
        ('{"fx": "wide"}', "'fx' must be a number, not 'wide'"),
        ('{"depth_scale": 0}', "'depth_scale' must be above 0"),
        ('{"fx": -1, "fy": 1, "cx": 1, "cy": 1}', "focal lengths -1, 1 are not positive"),
        ('{"color_registered": 1}', "'color_registered' must be true or false"),
        ('{"intrinsic_matrix": [1, 2]}', "must hold nine numbers"),
        ('{"intrinsic_matrix": [1, 0, 0, 5, 1, 0, 2, 3, 1]}', "is not a pinhole matrix"),
    ],
)
def test_bad_intrinsics_file(tmp_path: Path, text: str, message: str) -> None:
    folder = write_tum(tmp_path / "r")
    (folder / "camera.json").write_text(text)
    with pytest.raises(RecordingError, match=message):
        open_recording(folder)


@pytest.mark.parametrize("row", ["1305031107.0", "now depth/0.png"])
def test_bad_list_row(tmp_path: Path, row: str) -> None:
    folder = write_tum(tmp_path / "r")
    (folder / "depth.txt").write_text(f"# c\n{row}\n")
    with pytest.raises(RecordingError, match=r"depth\.txt, line 2: "):
        open_recording(folder)


def test_lists_with_names_of_windows(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    expected = raw_frames(open_recording(folder))
    for name in ("depth.txt", "rgb.txt"):
        (folder / name).write_text((folder / name).read_text().replace(" ", " .\\").replace("/", "\\"))
    for got, frame in zip(raw_frames(open_recording(folder)), expected, strict=True):
        np.testing.assert_array_equal(got.depth, frame.depth)
        assert got.color == frame.color
    (folder / "depth.txt").write_text("1.0 ..\\other\\0.png\n")
    with pytest.raises(RecordingError, match=r"depth\.txt, line 1: .* leads out of the folder"):
        open_recording(folder)


def test_empty_list_and_missing_images(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    for image in (folder / "depth").iterdir():
        image.unlink()
    with raises(RecordingError, "recording.no-frame", match=r"0\.png.*5"):
        open_recording(folder)
    (folder / "depth.txt").write_text("# c\n")
    with raises(RecordingError, "recording.no-depth"):
        open_recording(folder)


def test_seven_scenes(tmp_path: Path) -> None:
    folder = write_seven_scenes(tmp_path / "r", (3, 4, 7))
    recording = open_recording(folder)
    frames = raw_frames(recording)
    assert (recording.format, recording.camera, recording.depth_scale) == ("7scenes", SMALL, 1000.0)
    assert not recording.color_registered
    assert [frame.stamp_ns for frame in frames] == [3 * 10**9, 4 * 10**9, 7 * 10**9]
    expected = depth_image(3, 1000.0)
    expected[10:12, 10:12] = 0
    np.testing.assert_array_equal(frames[0].depth, expected)
    trajectory = recording.given_trajectory
    assert trajectory is not None
    np.testing.assert_allclose(np.linalg.det(trajectory.T_world_camera[:, :3, :3]), 1, atol=1e-12)
    np.testing.assert_array_equal(trajectory.T_world_camera[2, :3, 3], translation(7))


def test_seven_scenes_poses_that_are_no_poses(tmp_path: Path) -> None:
    folder = write_seven_scenes(tmp_path / "r")
    np.savetxt(folder / "frame-000001.pose.txt", np.full((4, 4), np.nan))
    np.savetxt(folder / "frame-000002.pose.txt", np.full((4, 4), -np.inf))
    (folder / "frame-000003.pose.txt").unlink()
    recording = open_recording(folder)
    assert recording.given_trajectory is not None
    assert recording.given_trajectory.stamps_ns.tolist() == [0, 4 * 10**9]
    assert len(recording.warnings) == 1
    assert "3 of 5 frames have no pose" in recording.warnings[0]
    (folder / "frame-000004.pose.txt").write_text("1 0 0\n")
    broken = open_recording(folder)
    assert broken.given_trajectory is None
    assert "frame-000004.pose.txt: holds 3 numbers, not the 4x4" in broken.trajectory_error


def test_seven_scenes_without_intrinsics(tmp_path: Path) -> None:
    folder = write_seven_scenes(tmp_path / "r")
    (folder / "camera-intrinsics.txt").unlink()
    with raises(RecordingError, "recording.no-intrinsics", match="does not say its intrinsics"):
        open_recording(folder)
    for i in range(5):
        (folder / f"frame-{i:06d}.depth.png").write_bytes(png(np.full((480, 640), 1500, np.uint16)))
    assert open_recording(folder).camera == Camera(640, 480, 585.0, 585.0, 320.0, 240.0)


@pytest.mark.parametrize("color", ["color", "rgb", "image"])
def test_plain_folder(tmp_path: Path, color: str) -> None:
    recording = open_recording(write_folder(tmp_path / "r", ("2", "10", "0033", "4"), color))
    frames = raw_frames(recording)
    assert (recording.format, recording.camera, recording.depth_scale) == ("folder", SMALL, 1000.0)
    assert recording.color_registered
    assert [frame.stamp_ns // 10**9 for frame in frames] == [2, 4, 10, 33]
    np.testing.assert_array_equal(frames[1].depth, depth_image(3, 1000.0))
    assert frames[3].color == (".jpg", jpeg(color_image(2)))


def test_plain_folder_paired_by_order(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r", ("depth_2", "depth_10", "depth_30"))
    for stem in ("2", "10", "30"):
        (folder / f"color/depth_{stem}.jpg").rename(folder / f"color/color_{stem}.jpg")
    frames = raw_frames(open_recording(folder))
    assert [frame.stamp_ns // 10**9 for frame in frames] == [0, 1, 2]
    np.testing.assert_array_equal(frames[1].depth, depth_image(1, 1000.0))
    assert frames[1].color == (".jpg", jpeg(color_image(1)))
    for stem in ("2", "10", "30"):
        (folder / f"color/color_{stem}.jpg").rename(folder / f"color/{stem}a.jpg")


def test_plain_folder_intrinsics(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "camera_intrinsic.json").unlink()
    np.savetxt(folder / "intrinsics.txt", np.array([[60.0, 0, 31.5], [0, 61.0, 23.5], [0, 0, 1]]))
    assert open_recording(folder).camera == SMALL
    text = json.dumps({**CAMERA, "depth_scale": 4000, "color_registered": False})
    (folder / "intrinsics.json").write_text(text)
    recording = open_recording(folder)
    assert (recording.depth_scale, recording.color_registered) == (4000.0, False)


def test_redwood_log_and_tum_trajectory(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r", ("1", "2", "3", "4"))
    rows = []
    for i in (0, 1, 3):
        T = np.eye(4)
        T[:3, 3] = translation(i)
        rows += [f"{i} {i} {i + 1}", *(" ".join(map(repr, row)) for row in T.tolist())]
    (folder / "trajectory.log").write_text("\n".join(rows))
    recording = open_recording(folder)
    assert recording.given_trajectory is not None
    assert recording.given_trajectory.stamps_ns.tolist() == [10**9, 2 * 10**9, 4 * 10**9]
    np.testing.assert_array_equal(recording.given_trajectory.T_world_camera[2, :3, 3], translation(3))
    assert "1 of 4 frames have no pose" in recording.warnings[0]
    (folder / "trajectory.txt").write_text("1 0 0 0 0 0 0 1\n4 1 0 0 0 0 0 1\n")
    again = open_recording(folder).given_trajectory
    assert again is not None
    assert again.stamps_ns.tolist() == [10**9, 4 * 10**9]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0 0 1\n1 0 0 0\n", "holds 2 rows, not a multiple of 5"),
        ("9 9 9\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "line 1: '9 9 9' does not name one of the 4 frames"),
        ("0 0 1\n1 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "four rows after it are not four numbers each"),
    ],
)
def test_bad_redwood_log(tmp_path: Path, text: str, message: str) -> None:
    folder = write_folder(tmp_path / "r")
    (folder / "trajectory.log").write_text(text)
    recording = open_recording(folder)
    assert recording.given_trajectory is None
    assert message in recording.trajectory_error


def test_what_is_not_there_or_not_known(tmp_path: Path) -> None:
    with raises(RecordingError, "recording.not-found"):
        open_recording(tmp_path / "nowhere")
    with raises(RecordingError, "recording.unknown-format", match="the folder"):
        open_recording(tmp_path)
    (tmp_path / "notes.txt").write_text("hello")
    with raises(RecordingError, "recording.unknown-format", match=r"rosbag1, .*tum, .*`kinectbench formats`"):
        open_recording(tmp_path)
    with raises(RecordingError, "recording.unknown-format", match=r"notes\.txt"):
        open_recording(tmp_path / "notes.txt")
    write_tum(tmp_path / "deep/er")
    with raises(RecordingError, "recording.unknown-format", match=r"deep/er\?"):
        open_recording(tmp_path)


def test_every_registered_reader_can_be_loaded() -> None:
    assert [reader_of(name).format for name in FORMATS] == list(FORMATS)


def test_find_recordings_and_source_files(tmp_path: Path) -> None:
    write_tum(tmp_path / "b/tum")
    write_seven_scenes(tmp_path / "a")
    write_folder(tmp_path / ".hidden/c")
    (tmp_path / "b/tum/.DS_Store").write_text("x")
    (tmp_path / "b/tum/loop").symlink_to(tmp_path / "b/tum", target_is_directory=True)
    assert find_recordings(tmp_path) == [(tmp_path / "a", "7scenes"), (tmp_path / "b/tum", "tum")]
    files = source_files(tmp_path / "b/tum", follow_links=True)
    assert files == sorted(files)
    assert len(files) == 2 * 5 + 4
    bag = write_bag(tmp_path / "r.bag")
    assert source_files(bag) == [bag]
    with raises(RecordingError, "recording.unknown-format", match="give its folder"):
        source_files(files[0])


def test_an_empty_folder_of_colour_hides_no_other(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r", color="rgb")
    (folder / "color").mkdir()
    assert open_recording(folder).frame(1).color == (".jpg", jpeg(color_image(1)))


@pytest.mark.parametrize("name", ["x.mcap", "x.db3", "0-depth.png"])
def test_a_folder_with_the_name_of_a_file_hides_nothing_beside_it(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    (tmp_path / "0-color.png").write_bytes(png(color_image(0)))
    write_folder(tmp_path / "scan")
    assert find_recordings(tmp_path) == [(tmp_path / "scan", "folder")]


def test_redwood_names_pair_by_number_and_give_stamps(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r", ("a", "b", "c"))
    big = np.full((480, 640), 1500, np.uint16)
    for i, stem in enumerate(("a", "b", "c")):
        (folder / f"depth/{stem}.png").unlink()
        (folder / f"depth/{i + 1:07d}-{i * 33_368:012d}.png").write_bytes(png(big))
        (folder / f"color/{stem}.jpg").rename(folder / f"color/{i + 1:07d}-{i * 33_368 + 7:012d}.jpg")
    (folder / "camera_intrinsic.json").unlink()
    rows = ["1 0 0 0.5", "0 1 0 0", "0 0 1 0", "0 0 0 1"]
    (folder / "00021.log").write_text("\n".join(["1 1 2", *rows]) + "\n")
    recording = open_recording(folder)
    assert recording.stamps_ns.tolist() == [0, 33_368_000, 66_736_000]
    assert recording.frame(2).color == (".jpg", jpeg(color_image(2)))
    assert (recording.camera.fx, recording.camera.cx) == (525.0, 319.5)
    assert "those of Redwood's PrimeSense camera are taken" in recording.warnings[0]
    assert recording.given_trajectory is not None
    assert recording.given_trajectory.stamps_ns.tolist() == [33_368_000]
    assert recording.given_trajectory.T_world_camera[0, 0, 3] == 0.5


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"color_camera": 3}, "'color_camera' must hold an object"),
        ({"color_camera": {**CAMERA, "fx": None}}, "'color_camera': 'fx' must be a number"),
        ({"color_camera": {**CAMERA, "distortion": [1]}}, "must hold 4, 5 or 8 numbers"),
        ({"T_color_depth": [[1, 2], [3]]}, "'T_color_depth' must be four rows of a rigid transform"),
        ({"T_color_depth": np.zeros((4, 4)).tolist()}, "'T_color_depth' must be four rows"),
    ],
)
def test_a_wrong_colour_calibration_is_refused(
    tmp_path: Path, values: dict[str, object], message: str
) -> None:
    folder = write_tum(tmp_path / "r")
    right = {"color_camera": CAMERA, "T_color_depth": np.eye(4).tolist(), "color_registered": False}
    (folder / "camera.json").write_text(json.dumps({**CAMERA, **right, **values}))
    with raises(RecordingError, "recording.malformed", match=message):
        open_recording(folder)


def test_stamps_of_tum_lists_in_their_order(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    header, *rows = (folder / "depth.txt").read_text().splitlines()
    (folder / "depth.txt").write_text("\n".join([header, rows[1], rows[0], rows[0], *rows[2:]]) + "\n")
    recording = open_recording(folder)
    depth_ns, color_ns = recording.recorded_stamps_ns
    assert ((depth_ns - START_NS) // STEP_NS).tolist() == [1, 0, 0, 2, 3, 4]
    assert len(color_ns) == 5
    assert ((recording.stamps_ns - START_NS) // STEP_NS).tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("delay_ms", [0, 200])
def test_a_delay_of_colour_and_of_poses_can_be_given(tmp_path: Path, delay_ms: int) -> None:
    folder = write_tum(tmp_path / "r", frames=20, color_shift_ns=200_000_000)
    settings = CameraSettings(color_delay_s=delay_ms / 1000, trajectory_delay_s=delay_ms / 1000)
    recording = open_recording(folder, settings)
    color = recording.frame(10).color
    # Late by six frames: without the delay frame 10 gets what frame 4 should have.
    assert color == (".jpg", jpeg(color_image(10 if delay_ms else 4)))
    assert recording.given_trajectory is not None
    assert recording.given_trajectory.stamps_ns[0] == START_NS - delay_ms * 1_000_000


def test_suffixes_of_every_reader_are_known_once() -> None:
    bags = (".bag", ".bag.active", ".db3", ".db3.zstd", ".mcap", ".mcap.zstd")
    assert name_suffixes() == tuple(sorted((*bags, ".klg", ".mkv", ".r3d", ".sens", ".zip")))
