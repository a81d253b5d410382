"""Layouts of public data sets and tools that users have: each is read, or one line says what to do."""

import json
import re
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from ingest_writers import CX, CY, FX, FY, HEIGHT, WIDTH, color_image, depth_image, jpeg, png, write_folder
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.image_names import several_series
from kinectbench.stages.ingest.readers import open_recording, source_files
from kinectbench.stages.ingest.readers.seven_scenes import SevenScenesRecording
from kinectbench.stages.ingest.recording import FileRecording

K = np.array([[FX, 0, CX], [0, FY, CY], [0, 0, 1]])
MATRIX = " ".join(map(str, np.pad(K, (0, 1)).ravel()[:15])) + " 1"
IDENTITY = " ".join(map(str, np.eye(4).ravel()))
CAMERA = CameraSettings(fx=FX, fy=FY, cx=CX, cy=CY)


def pose(index: int) -> np.ndarray:
    T = np.eye(4)
    T[0, 3] = 0.1 * index
    return T


def pgm(depth: np.ndarray) -> bytes:
    return b"P5\n%d %d\n65535\n" % (WIDTH, HEIGHT) + depth.astype(">u2").tobytes()


def frames(folder: Path, depth: str, color: str, count: int = 6, scale: float = 1000.0) -> Path:
    for i in range(count):
        image = depth_image(i, scale)
        data = pgm(image) if depth.endswith(".pgm") else png(image)
        for name, content in ((depth, data), (color, jpeg(color_image(i)))):
            file = folder / name.format(i)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
    return folder


def opened(folder: Path, settings: CameraSettings | None = None) -> FileRecording:
    recording = open_recording(folder, settings)
    assert isinstance(recording, FileRecording)
    return recording


def refused(path: Path) -> str:
    with pytest.raises(RecordingError) as error:
        open_recording(path)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("kind", ["depth.pgm", "rendered.depth.png"])
def test_3rscan_and_rio10(tmp_path: Path, kind: str) -> None:
    folder = frames(tmp_path / "r", f"frame-{{:06d}}.{kind}", "frame-{:06d}.color.jpg")
    for i in range(6):
        np.savetxt(folder / f"frame-{i:06d}.pose.txt", pose(i))
    (folder / "_info.txt").write_text(
        f"m_depthWidth = {WIDTH}\nm_depthHeight = {HEIGHT}\nm_depthShift = 1000\n"
        f"m_calibrationDepthIntrinsic = {MATRIX}\nm_calibrationDepthExtrinsic = {IDENTITY}\n"
    )
    recording = opened(folder)
    assert (recording.format, len(recording), recording.camera.fx) == ("7scenes", 6, FX)
    np.testing.assert_array_equal(recording.frame(3).depth, depth_image(3, 1000.0))
    assert recording.given_trajectory is not None
    np.testing.assert_allclose(recording.given_trajectory.T_world_camera[5], pose(5))
    assert recording.frame(2).color is not None


@pytest.mark.parametrize("measured", ["depth.png", "depth.pgm"])
def test_measured_depth_comes_before_rendered_depth(tmp_path: Path, measured: str) -> None:
    folder = tmp_path / "r"
    for kind in (measured, "rendered.depth.png"):
        frames(folder, f"frame-{{:06d}}.{kind}", "frame-{:06d}.color.jpg", count=40)
    (folder / "camera-intrinsics.txt").write_text("\n".join(" ".join(map(str, row)) for row in K))
    recording = opened(folder)
    names = [frame.depth.name for frame in recording.places]
    assert names == [f"frame-{i:06d}.{measured}" for i in range(40)]
    assert not any("not read" in line for line in recording.warnings)
    for i in range(3, 40):
        (folder / f"frame-{i:06d}.{measured}").unlink()
    recording = opened(folder)
    assert len(recording) == 3
    assert f"37 frames have depth of another kind than {measured}, such as" in recording.warnings[0]


def test_frames_that_are_gone_are_no_crash(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="there is no image"):
        SevenScenesRecording.open(tmp_path, CAMERA)


def replica(scene: Path) -> Path:
    frames(scene, "results/depth{:06d}.png", "results/frame{:06d}.jpg", scale=6553.5)
    np.savetxt(scene / "traj.txt", [pose(i).ravel() for i in range(6)])
    camera = {"w": WIDTH, "h": HEIGHT, "fx": FX, "fy": FY, "cx": CX, "cy": CY, "scale": 6553.5}
    (scene.parent / "cam_params.json").write_text(json.dumps({"camera": camera}))
    return scene


def test_replica_as_nice_slam_renders_it(tmp_path: Path) -> None:
    recording = opened(replica(tmp_path / "room0"))
    assert (recording.camera.fx, recording.depth_scale, recording.warnings) == (FX, 6553.5, ())
    names = [(frame.depth.name, frame.color and frame.color.name) for frame in recording.places]
    assert names[3] == ("depth000003.png", "frame000003.jpg")
    assert recording.given_trajectory is not None and len(recording.given_trajectory.stamps_ns) == 6
    assert source_files(tmp_path / "room0")[-1] == tmp_path / "cam_params.json"


def test_an_own_camera_comes_before_that_of_all_scenes(tmp_path: Path) -> None:
    scene = replica(tmp_path / "room0")
    (scene / "intrinsics.json").write_text(json.dumps({"fx": 70, "fy": 70, "cx": CX, "cy": CY}))
    assert opened(scene).camera.fx == 70
    assert tmp_path / "cam_params.json" not in source_files(scene)


def test_colour_that_is_named_by_its_number_alone(tmp_path: Path) -> None:
    folder = frames(tmp_path / "r", "chair_1_1_{}_depth.png", "chair_1_1_{}.png", count=12)
    for i in range(12):
        (folder / f"chair_1_1_{i}_mask.png").write_bytes(png(np.ones((HEIGHT, WIDTH), np.uint8)))
    recording = opened(folder, CAMERA)
    names = [(frame.depth.name, frame.color and frame.color.name) for frame in recording.places]
    assert names == [(f"chair_1_1_{i}_depth.png", f"chair_1_1_{i}.png") for i in range(12)]


MASK = np.full((HEIGHT, WIDTH), 255, np.uint8)


@pytest.mark.parametrize("color", ["{:04d}.jpg", "frame_{:04d}.png"])
@pytest.mark.parametrize("other", [png(MASK), png(depth_image(0)), png(depth_image(0))[:40]])
def test_a_mask_named_by_its_number_is_no_colour(tmp_path: Path, color: str, other: bytes) -> None:
    folder = frames(tmp_path / "r", "depth_{:04d}.png", color)
    for i in range(6):
        (folder / f"{i:04d}.png").write_bytes(other)
    names = [frame.color and frame.color.name for frame in opened(folder, CAMERA).places]
    assert names == [color.format(i) for i in range(6)]
    for i in range(6):
        (folder / color.format(i)).unlink()
    assert "put depth alone into a folder depth/ and colour into color/" in refused(folder)


def test_a_grey_jpeg_is_no_colour(tmp_path: Path) -> None:
    folder = frames(tmp_path / "r", "depth_{:04d}.png", "{:04d}.png")
    for i in range(6):
        (folder / f"{i:04d}.jpg").write_bytes(jpeg(MASK))
    names = [frame.color and frame.color.name for frame in opened(folder, CAMERA).places]
    assert names == [f"{i:04d}.png" for i in range(6)]
    for i in range(6):
        (folder / f"{i:04d}.jpg").write_bytes(jpeg(color_image(i)))
    frame = opened(folder, CAMERA).places[3]
    assert frame.color and frame.color.name == "0003.jpg"


@pytest.mark.parametrize("further", [True, False])
@pytest.mark.parametrize("by_file", [True, False])
def test_one_npz_of_all_frames_has_a_line_that_writes_a_recording(
    tmp_path: Path, further: bool, by_file: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "r"
    folder.mkdir()
    arrays: dict[str, np.ndarray] = {"depths": np.stack([depth_image(i, 1000.0) for i in range(6)])}
    if further:
        arrays["rgb"] = np.stack([color_image(i)[..., ::-1] for i in range(6)])
        arrays["c2w"] = np.stack([pose(i) for i in range(6)])
        arrays["K"] = K
    np.savez_compressed(folder / "scan.npz", allow_pickle=False, **arrays)
    said = refused(folder / "scan.npz" if by_file else folder)
    assert "scan.npz holds 6 images in one array, which is not read" in said
    assert ("intrinsics.json beside" in said) != further
    (line,) = re.findall(r"such as by `([^`]*)`", said)
    monkeypatch.chdir(folder)
    exec(line, {})
    recording = opened(folder, None if further else CAMERA)
    np.testing.assert_array_equal(recording.frame(3).depth, depth_image(3, 1000.0))
    assert recording.camera.fx == FX
    if further:
        color, given = recording.frame(2).color, recording.given_trajectory
        assert color is not None and given is not None
        np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(color[1], np.uint8), 1), color_image(2))
        np.testing.assert_allclose(given.T_world_camera[4], pose(4))


def test_an_npz_of_no_or_several_stacks_is_named_as_such(tmp_path: Path) -> None:
    many = np.zeros((6, HEIGHT, WIDTH), np.uint16)
    for name, arrays in (("a", {"x": many, "y": many}), ("b", {"x": many[:2]})):
        np.savez(tmp_path / f"{name}.npz", **arrays)
        assert "is a file of NumPy arrays (.npz); write the depth of each frame" in refused(
            tmp_path / f"{name}.npz"
        )


def test_an_npz_of_arrays_of_one_shape_writes_none_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    images, poses = np.zeros((6, 1, HEIGHT, WIDTH, 3), np.uint8), np.tile(np.eye(4), (6, 1, 1))
    depth = np.stack([depth_image(i) for i in range(6)])
    arrays: dict[str, np.ndarray] = {"depth": depth, "rgb": images, "c2w": poses, "K": K}
    more = {"normals": images, "imu": poses, "R": np.tile(np.eye(3), (6, 1, 1))}
    for name, held in (("alone", arrays), ("several", {**arrays, **more})):
        folder = tmp_path / name
        folder.mkdir()
        np.savez_compressed(folder / "scan.npz", allow_pickle=False, **held)
        said = refused(folder)
        (line,) = re.findall(r"such as by `([^`]*)`", said)
        monkeypatch.chdir(folder)
        exec(line, {})
        written = {"color", "poses.txt", "intrinsics.txt"} if name == "alone" else set()
        assert {file.name for file in folder.iterdir()} == {"scan.npz", "depth", *written}
        which = "; write the right one of rgb, normals to color/, of c2w, imu to poses.txt, of K, R to intri"
        assert (which in said) == ("intrinsics.json beside" in said) == (name == "several")


@pytest.mark.parametrize("long", ["depth", "poses"])
def test_names_of_arrays_do_not_make_a_message_long(tmp_path: Path, long: str) -> None:
    depth, poses = np.zeros((6, HEIGHT, WIDTH), np.uint16), np.tile(np.eye(4), (6, 1, 1))
    arrays: dict[str, np.ndarray] = {"depth": depth, "poses": poses}
    arrays[long + "x" * 20_000] = arrays.pop(long)
    np.savez_compressed(tmp_path / "scan.npz", allow_pickle=False, **arrays)
    assert len(refused(tmp_path)) < 2000 and len(refused(tmp_path / "scan.npz")) < 2000
    many: dict[str, np.ndarray] = {"depth": depth, **{f"poses{i}": poses for i in range(2000)}}
    np.savez_compressed(tmp_path / "scan.npz", allow_pickle=False, **many)
    assert len(refused(tmp_path / "scan.npz")) < 2000


def test_the_line_for_hdf5_reads_an_array_of_any_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    h5py = pytest.importorskip("h5py")
    for key in ("dataset", "depth"):
        folder = tmp_path / key
        (folder / "geometry").mkdir(parents=True)
        for i in range(5):
            with h5py.File(folder / f"geometry/frame.{i:04d}.depth_meters.hdf5", "w") as file:
                file["another" if key == "depth" else "dataset"] = np.zeros((2, 2))
                if key == "depth":
                    file[key] = depth_image(i)
        said = refused(folder)
        assert said.endswith("; of Hypersim, give `depth_code: ray_distance`")
        (line,) = re.findall(r"such as by `([^`]*)`", said)
        (folder / "depth").mkdir()
        monkeypatch.chdir(folder)
        exec(line, {})
        (written,) = (folder / "depth").iterdir()
        assert np.load(written).shape == ((HEIGHT, WIDTH) if key == "depth" else (2, 2))


@pytest.mark.parametrize(
    "name", ["disparity/{:04d}.png", "scene{}/disp0.pfm", "disp_occ_0/{:06d}_10.png", "left_disp_{}.tiff"]
)
def test_disparity_is_not_called_depth(tmp_path: Path, name: str) -> None:
    for i in range(6):
        file = tmp_path / "r" / name.format(i)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(png(depth_image(i)) if file.suffix == ".png" else b"Pf")
        file.with_name(f"im{i}.png").write_bytes(png(color_image(i)))
    said = refused(tmp_path / "r")
    assert f"{name.format(0)} is disparity by its name, not depth: write depth = fx * baseline" in said


def test_depth_of_two_cameras_in_one_folder_is_told_apart(tmp_path: Path) -> None:
    for camera in (0, 1):
        frames(tmp_path / "r", f"depth/cam{camera}/{{:04d}}.png", f"color/cam{camera}/{{:04d}}.jpg")
    said = refused(tmp_path / "r")
    assert "depth/cam0/ holds 16-bit PNG images" in said
    assert "known (also depth/cam1). Give each camera its own folder, and there put depth" in said


def test_several_recordings_in_a_folder_are_all_named(tmp_path: Path) -> None:
    for camera in (1, 2):
        write_folder(tmp_path / f"r/cam{camera}")
    assert "holds several recordings (cam1, cam2); give the path of one" in refused(tmp_path / "r")
    (tmp_path / "r/cam2").rename(tmp_path / "away")
    assert f"Did you mean {tmp_path / 'r/cam1'}?" in refused(tmp_path / "r")


def test_what_a_folder_holds_besides_a_mesh_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "r"
    folder.mkdir()
    (folder / "mesh.refined.v2.obj").write_text("v 0 0 0\n")
    (folder / "kinect.oni").write_bytes(b"NI10\0\0")
    assert "kinect.oni: is an OpenNI recording" in refused(folder)
    with zipfile.ZipFile(folder / "sequence.zip", "w") as archive:
        archive.writestr("frame-000000.depth.pgm", pgm(depth_image(0)))
    assert "sequence.zip: is a zip without a recording of a known format; unpack it" in refused(folder)


CAM = f"extrinsic\n{IDENTITY}\n\nintrinsic\n{FX} 0 {CX}\n0 {FY} {CY}\n0 0 1\n\n0.4 0.01 192 3.0\n"
SHOWN = f"`camera: {{fx: {FX:g}, fy: {FY:g}, cx: {CX:g}, cy: {CY:g}}}`"


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("intrinsics/{:04d}.txt", f"{FX} 0 {CX}\n0 {FY} {CY}\n0 0 1\n", "intrinsics/0000.txt, which holds "),
        ("cameras/{:04d}.json", json.dumps({"K": K.tolist()}), "cameras/0000.json, which holds "),
        ("cams/{:08d}_cam.txt", CAM, "cams/00000000_cam.txt holds the camera 00000000_cam: .* as "),
        ("labels2/{:04d}.txt", "1 2 3 4\n", "the files of each frame, such as labels2/0000.txt$"),
        ("planar/{:04d}.txt", "1 0 .5\n0 1 .2\n0 0 1\n", "the files of each frame, such as planar/0000.txt$"),
        ("planar/{:04d}.json", '{"K": [[1, 0, 0.5], [0, 1, 0.2], [0, 0, 1]]}', "such as planar/0000.json$"),
        ("places/{:04d}.txt", IDENTITY, "the files of each frame, such as places/0000.txt$"),
    ],
)
def test_intrinsics_of_each_frame_are_printed(tmp_path: Path, name: str, text: str, words: str) -> None:
    folder = write_folder(tmp_path / "r", [f"{i:04d}" for i in range(6)])
    (folder / "camera_intrinsic.json").unlink()
    for i in range(6):
        (folder / name.format(i)).parent.mkdir(exist_ok=True)
        (folder / name.format(i)).write_text(text)
    shown = "" if words.endswith("$") else re.escape(SHOWN)
    with raises(RecordingError, "recording.no-intrinsics", match=words + shown):
        open_recording(folder)


@pytest.mark.parametrize(
    "names",
    [
        [f"{row}_{column}" for row in range(3) for column in range(36)],
        [f"{minute:02d}_{second:02d}" for minute in range(2) for second in range(60)],
        [f"{elevation}-{angle:03d}" for elevation in range(5) for angle in range(72)],
        [f"{i // 100}_{i % 100}" for i in range(300)],
    ],
)
def test_two_bare_numbers_are_no_cameras(names: list[str]) -> None:
    assert several_series(names) == []
