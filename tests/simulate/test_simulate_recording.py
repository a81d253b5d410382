"""Whole simulated recordings: their files, their truth, and that the same spec gives the same bytes."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from kinectbench.config import BenchmarkSettings
from kinectbench.errors import KinectBenchError, RecordingError, SettingsError
from kinectbench.geometry import Camera, Grid, invert_rigid, rigid, transform_points
from kinectbench.geometry import rotation_from_quaternion_xyzw as rotation_of
from kinectbench.simulate import samples
from kinectbench.simulate.simulate import SimulationSpec, prepare, record, simulate
from kinectbench.simulate.solid import Part, Solid
from kinectbench.simulate.truth import (
    ObjectTruth,
    read_object_truth,
    solid_occupancy,
    truth_folder,
    truth_occupancy,
    write_object_truth,
)

ROOT = Path(__file__).resolve().parents[2]
SMALL = {"frames": 3, "width": 160, "height": 120}


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture(scope="module")
def tum(tmp_path_factory):
    out = tmp_path_factory.mktemp("tum") / "chair"
    spec = SimulationSpec("chair", 10, noise=False, save_depth=True, world="random", **SMALL)
    simulate(spec, out)
    return spec, out


@pytest.mark.parametrize("kind", ["tum", "bag"])
def test_same_spec_same_bytes(tmp_path, kind):
    spec = SimulationSpec("table", 2, format=kind, world="first_camera", **SMALL)
    name = "r.bag" if kind == "bag" else "r"
    told = []
    for place in ("a", "b"):
        simulate(spec, tmp_path / place / name, lambda done, total: told.append((done, total)))
    assert told[:3] == [(1, 3), (2, 3), (3, 3)]
    first, second = files(tmp_path / "a"), files(tmp_path / "b")
    assert first == second
    assert len(first) >= 8
    assert all(".part" not in path.name for path in tmp_path.rglob("*"))


def test_tum_folder_has_what_the_format_says(tum):
    spec, out = tum
    names = [line.split() for line in (out / "depth.txt").read_text().splitlines() if line[0] != "#"]
    assert [name[0] for name in names] == ["1400000000.000000", "1400000000.200000", "1400000000.400000"]
    _, exact_m, _ = record(prepare(spec), 1)
    depth = cv2.imread(str(out / names[1][1]), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.uint16
    assert np.abs(depth / 5000.0 - exact_m).max() <= 1.001e-4
    exact_mm = cv2.imread(str(truth_folder(out) / "depth" / "000001.png"), cv2.IMREAD_UNCHANGED)
    assert np.abs(exact_mm / 1000.0 - exact_m).max() <= 5.01e-4
    color = cv2.imread(str(out / "rgb" / "1400000000.200000.jpg"))
    assert color.shape == (120, 160, 3)
    assert (out / "groundtruth.txt").read_text().splitlines()[1:] == (
        (truth_folder(out) / "trajectory.txt").read_text().splitlines()
    )
    assert json.loads((out / "camera.json").read_text()) == {
        "width": 160, "height": 120, "fx": 131.25, "fy": 131.25, "cx": 79.5, "cy": 59.5, "depth_scale": 5000.0
    }  # fmt: skip


def test_depth_lies_on_the_object_and_on_the_floor_of_the_truth(tum):
    _, out = tum
    folder = truth_folder(out)
    truth = read_object_truth(folder)
    plane = np.array(json.loads((folder / "floor.json").read_text())["plane_world"])
    assert np.linalg.norm(plane[:3]) == pytest.approx(1)
    camera = Camera(**{k: v for k, v in json.loads((out / "camera.json").read_text()).items() if k[0] != "d"})
    rows = np.loadtxt(folder / "trajectory.txt")
    for index, row in enumerate(rows):
        T_world_camera = rigid(rotation_of(row[4:]), row[1:4])
        depth_m = cv2.imread(str(out / "depth" / f"{row[0]:.6f}.png"), cv2.IMREAD_UNCHANGED) / 5000.0
        mask = cv2.imread(str(folder / "masks" / f"{index:06d}.png"), cv2.IMREAD_UNCHANGED)
        assert set(np.unique(mask)) == {0, 255}
        points_world = transform_points(T_world_camera, camera.backproject(depth_m))
        on_object = points_world[(mask == 255) & (depth_m > 0)]
        assert len(on_object) > 1000
        points = transform_points(invert_rigid(truth.T_world_object), on_object)
        faces = [part.planes() for part in truth.solid.parts]
        distance_m = [np.max(points @ p[:, :3].T + p[:, 3], axis=1) for p in faces]
        assert np.abs(np.min(distance_m, axis=0)).max() < 3e-4
        height_m = points_world[depth_m > 0] @ plane[:3] + plane[3]
        assert height_m.min() > -1e-3
        assert (np.abs(height_m) < 1e-3).mean() > 0.2


def test_the_bag_reads_back(tmp_path):
    from rosbags.rosbag1 import Reader
    from rosbags.typesys import Stores, get_typestore

    spec = SimulationSpec("table", 2, format="bag", world="first_camera", **SMALL)
    simulate(spec, tmp_path / "t.bag")
    store = get_typestore(Stores.ROS1_NOETIC)
    with Reader(tmp_path / "t.bag") as bag:
        messages = [
            (c.topic, stamp, store.deserialize_ros1(raw, c.msgtype)) for c, stamp, raw in bag.messages()
        ]
    assert len(messages) == 4 * 3
    frame, _, _ = record(prepare(spec), 0)
    first = {topic: message for topic, stamp, message in messages if stamp == spec.stamp_ns(0)}
    depth = first["/camera/depth_registered/image_raw"]
    assert (depth.encoding, depth.step, depth.is_bigendian) == ("16UC1", 320, 0)
    native = depth.data.view("<u2").reshape(120, 160)
    assert np.array_equal(native, np.round(frame.depth_m.astype(float) * 1000))
    assert first["/camera/depth_registered/camera_info"].K[0] == 131.25
    color = first["/camera/rgb/image_color/compressed"]
    assert color.header.frame_id == depth.header.frame_id
    decoded = cv2.imdecode(color.data, cv2.IMREAD_COLOR)[..., ::-1]
    assert np.abs(decoded.astype(float) - frame.color_rgb).mean() < 8
    pose = first["/camera/pose"].pose
    assert abs(pose.orientation.w) == pytest.approx(1)
    assert abs(pose.position.x) < 1e-9


def test_every_frame_shows_the_subject():
    for spec in {**samples.SAMPLES, **samples.DEMO}.values():
        simulation = prepare(spec)
        for index in range(0, spec.frames, 15):
            frame, _, mask = record(simulation, index)
            assert mask.sum() > 1500
            # A table top seen edge-on loses most.
            assert (frame.depth_m[mask] > 0).mean() > 0.5


@pytest.mark.parametrize("world", ["first_camera", "random"])
def test_the_world_offset_moves_everything_alike(world):
    upright = prepare(SimulationSpec("chair", 3, frames=3))
    other = prepare(SimulationSpec("chair", 3, frames=3, world=world))
    assert np.array_equal(upright.truth.floor_plane_world(), [0, 0, 1, 0])
    T_room_object = upright.truth.T_world_object
    assert np.allclose(other.T_world_room @ T_room_object, other.truth.T_world_object)
    assert np.allclose(
        invert_rigid(other.truth.T_world_object) @ other.T_world_camera,
        invert_rigid(T_room_object) @ upright.T_world_camera,
    )
    assert np.allclose(other.T_world_camera[0], np.eye(4)) == (world == "first_camera")
    plane = other.truth.floor_plane_world()
    heights = other.T_world_camera[:, :3, 3] @ plane[:3] + plane[3]
    assert np.allclose(heights, upright.T_world_camera[:, 2, 3])


def test_truth_occupancy_of_a_box_is_exact(tmp_path):
    # 8 x 4 x 10 cells of 5 cm, from grid cell (3, 2, 1) on; the grid is turned and moved in the world.
    box = Part("box", "rectangle", (0.4, 0.2), (0, 0, 0), (0, 0, 0.5))
    T_world_grid = rigid(rotation_of([0.1, -0.4, 0.2, 0.7]), [1.0, -2.0, 0.5])
    T_world_object = T_world_grid @ rigid(np.eye(3), [0.35, 0.2, 0.05])
    write_object_truth(tmp_path, ObjectTruth(Solid((box,)), T_world_object), {})
    expected = np.zeros((16, 9, 12), bool)
    expected[3:11, 2:6, 1:11] = True
    assert np.array_equal(truth_occupancy(tmp_path, Grid((16, 9, 12), 0.05, T_world_grid)), expected)


def test_occupancy_agrees_with_the_point_test_and_cuts_at_the_grid():
    truth = prepare(SimulationSpec("chair", 9, frames=2, world="random")).truth
    for offset in ([-0.4, -0.4, -0.1], [0.0, 0.0, 0.2]):
        T_world_grid = truth.T_world_object @ rigid(rotation_of([0.2, 0.1, 0.3, 0.9]), offset)
        grid = Grid((48, 50, 52), 0.02, T_world_grid)
        centres = (np.stack(np.indices(grid.shape), axis=-1) + 0.5) * grid.voxel_size_m
        T_object_grid = invert_rigid(truth.T_world_object) @ T_world_grid
        expected = truth.solid.contains(transform_points(T_object_grid, centres))
        assert expected.any()
        assert np.array_equal(solid_occupancy(truth.solid, truth.T_world_object, grid), expected)


def test_truth_survives_its_file(tum):
    spec, out = tum
    read, made = read_object_truth(truth_folder(out)), prepare(spec).truth
    assert read.solid == made.solid
    assert np.array_equal(read.T_world_object, made.T_world_object)


def test_the_truth_mesh_opens(tum):
    import open3d as o3d

    _, out = tum
    mesh = o3d.io.read_triangle_mesh(str(truth_folder(out) / "object.ply"))
    expected = read_object_truth(truth_folder(out)).mesh_world()
    assert np.allclose(np.asarray(mesh.vertices), expected.vertices, atol=1e-6)
    assert np.array_equal(np.asarray(mesh.triangles), expected.triangles)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "no readable truth"),
        ("{", "no readable truth"),
        ("[]", "no readable truth"),
        ('{"format_version": 2}', "format version 2"),
        ('{"format_version": 1}', "no readable truth"),
        ('{"format_version": 1, "parts": [], "T_world_object": [[1]]}', "no parts"),
    ],
)
def test_damaged_truth_gives_one_line(tmp_path, text, says):
    if text is not None:
        (tmp_path / "truth.json").write_text(text)
    with pytest.raises(RecordingError, match=says) as caught:
        read_object_truth(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "wrong",
    [
        {"family": "chiar"}, {"frames": 1}, {"width": 8}, {"seed": -1}, {"format": "mcap"}, {"world": "up"},
        {"arc_rad": float("nan")}, {"rate_hz": 0.0},
    ],
)  # fmt: skip
def test_wrong_specs_are_refused(wrong):
    with pytest.raises(SettingsError):
        SimulationSpec(**{"family": "chair", **wrong})


def test_what_is_no_simulated_recording_is_not_overwritten(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "photo.jpg").write_text("dear")
    spec = SimulationSpec("chair", 1, **SMALL)
    for out in (tmp_path / "mine", tmp_path / "x.bag", Path()):
        with pytest.raises(KinectBenchError):
            simulate(spec, out)
    assert (tmp_path / "mine" / "photo.jpg").read_text() == "dear"


@pytest.mark.parametrize("name", ["benchmark.yaml", "demo/benchmark.yaml"])
def test_the_benchmarks_name_recordings_that_are_made(name):
    path = ROOT / name
    settings = BenchmarkSettings.model_validate(yaml.safe_load(path.read_text()))
    made = {ROOT / "recordings" / n for n in samples.SAMPLES} | {
        ROOT / "demo" / "recordings" / n for n in samples.DEMO
    }
    paths = {(path.parent / recording.path).resolve() for recording in settings.recordings}
    assert paths <= made
    assert len(paths) == len(settings.recordings)


@pytest.mark.parametrize("name", samples.SAMPLES)
def test_the_stored_samples_are_the_ones_that_are_made(name):
    spec = samples.SAMPLES[name]
    truth = read_object_truth(truth_folder(ROOT / "recordings" / name))
    made = prepare(spec).truth
    assert truth.solid == made.solid
    assert np.allclose(truth.T_world_object, made.T_world_object)
    assert len(list((truth_folder(ROOT / "recordings" / name) / "masks").iterdir())) == spec.frames
