"""Whole simulated recordings: their files, their truth, and that the same spec gives the same bytes."""

import json
import re
import shutil
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import open3d as o3d
import pytest
import trimesh
import yaml
from ingest_writers import whole_frames
from object_checks import closed
from raising import raises
from typed import present

from kinectbench.core.errors import KinectBenchError, RecordingError, SettingsError
from kinectbench.core.geometry import Grid, invert_rigid, rigid, transform_points
from kinectbench.core.geometry import rotation_from_quaternion_xyzw as rotation_of
from kinectbench.lab.simulate import presets
from kinectbench.lab.simulate.simulate import prepare, record_frame, simulate
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.lab.simulate.truth import added_files, mesh_occupancy, read_truth, truth_folder
from kinectbench.lab.simulate.writers import formats
from kinectbench.settings.models import BenchmarkSettings, CameraSettings
from kinectbench.stages.ingest.readers import open_recording

ROOT = Path(__file__).resolve().parents[3]
tensor = o3d.core.Tensor.from_numpy


def spec_of(**values: Any) -> SimulationSpec:
    small: dict[str, dict[str, Any]] = {
        "path": {"frames": 3, "rate_hz": 5.0},
        "sensor": {"width": 160, "height": 120},
    }
    for section in ("path", "sensor"):
        small[section] |= values.pop(section, {})
    return SimulationSpec.model_validate(small | values)


def files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture(scope="module")
def ideal(tmp_path_factory: pytest.TempPathFactory) -> tuple[SimulationSpec, Path]:
    out = tmp_path_factory.mktemp("tum") / "chair"
    spec = spec_of(object="chair:seed=7", sensor={"model": "ideal"}, world="random")
    simulate(spec, out)
    return spec, out


@pytest.mark.parametrize("form", formats())
def test_same_spec_same_bytes(tmp_path: Path, form: str) -> None:
    full = {"exposure_s": 0.02, "exposure_drift": 0.2, "color_registered": False, "color_delay_s": 0.01}
    spec = spec_of(object="table:seed=2", format=form, world="first_camera", sensor=full)
    name = f"r{formats()[form].suffix}"
    told = []
    for place in ("a", "b"):
        simulate(spec, tmp_path / place / name, lambda done, total: told.append((done, total)))
    assert told[:3] == [(1, 3), (2, 3), (3, 3)]
    first, second = files(tmp_path / "a"), files(tmp_path / "b")
    assert first == second
    folder = truth_folder(tmp_path / "a" / name)
    beside = {f"{folder.name}/{file}" for file in ("truth.json", "surface.npz", "masks/000002.png")}
    assert beside <= set(first)
    assert all(".part" not in path.name for path in tmp_path.rglob("*"))
    truth = read_truth(folder)
    # They do not say their intrinsics.
    settings = CameraSettings(**asdict(truth.camera)) if form in ("klg", "redwood_zip") else None
    recording = open_recording(tmp_path / "a" / name, settings)
    assert [frame.stamp_ns for frame in whole_frames(recording)] == truth.stamps_ns.tolist()
    assert asdict(recording.camera) == pytest.approx(asdict(truth.camera), rel=1e-7)
    if form in ("klg", "realsense", "realsense_old", "redwood_zip", "azure_kinect"):
        assert recording.given_trajectory is None
        return
    assert np.abs(present(recording.given_trajectory).T_world_camera - truth.T_world_camera).max() < 1e-6


def test_an_ideal_recording_is_exact(ideal: tuple[SimulationSpec, Path]) -> None:
    _, out = ideal
    truth = read_truth(truth_folder(out))
    recording = open_recording(out, None)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        tensor(truth.mesh_world.vertices.astype(np.float32)),
        tensor(truth.mesh_world.faces.astype(np.uint32)),
    )
    for index, frame in enumerate(whole_frames(recording)):
        depth_m = frame.depth / recording.depth_scale
        assert np.abs(depth_m - present(truth.depth_m(index))).max() < 1e-6
        points_world = transform_points(truth.T_world_camera[index], truth.camera.backproject(depth_m))
        on_object = points_world[truth.mask(index) & (depth_m > 0)]
        assert len(on_object) > 1000
        assert scene.compute_distance(tensor(on_object.astype(np.float32))).numpy().max() < 3e-4
        height_m = points_world[depth_m > 0] @ truth.floor_plane_world[:3] + truth.floor_plane_world[3]
        assert height_m.min() > -1e-3
        assert (np.abs(height_m) < 1e-3).mean() > 0.2


def test_the_truth_is_whole(ideal: tuple[SimulationSpec, Path]) -> None:
    spec, out = ideal
    truth = read_truth(truth_folder(out))
    simulation = prepare(spec)
    shell = closed(trimesh.load(truth_folder(out) / "object.ply", process=False))
    assert shell.volume == pytest.approx(simulation.subject.mesh.volume_m3, rel=1e-5)
    assert (truth.subject, truth.T_world_camera.shape) == ("chair:seed=7", (3, 4, 4))
    assert np.array_equal(truth.T_world_camera, simulation.T_world_camera)
    plane = np.array(json.loads((truth_folder(out) / "floor.json").read_text())["plane_world"])
    assert np.allclose(plane, truth.floor_plane_world)
    assert np.linalg.norm(plane[:3]) == pytest.approx(1)
    lowest = truth.mesh_world.vertices @ plane[:3] + plane[3]
    assert lowest.min() == pytest.approx(0, abs=1e-6)
    # What was seen lies on the silhouette; of what was never seen there is some: the underside.
    surface = truth.surface
    assert 0.2 < (surface.frames_seen > 0).mean() < 0.9
    assert surface.frames_seen.max() <= 3
    seen_always = surface.points_world[surface.frames_seen == 3]
    for index in range(3):
        at = transform_points(invert_rigid(truth.T_world_camera[index]), seen_always)
        u, v = np.round(truth.camera.project(at)).astype(int).T
        mask = cv2.dilate(truth.mask(index).astype(np.uint8), np.ones((3, 3), np.uint8))
        assert mask[v, u].all()
    rows = np.loadtxt(truth_folder(out) / "trajectory.txt")
    assert np.allclose(rows[:, 1:4], truth.T_world_camera[:, :3, 3])


def test_the_truths_occupancy_is_the_meshs(ideal: tuple[SimulationSpec, Path]) -> None:
    _, out = ideal
    truth = read_truth(truth_folder(out))
    T_world_grid = truth.T_world_object @ rigid(rotation_of([0.2, 0.1, 0.3, 0.9]), [-0.4, -0.5, 0.1])
    grid = Grid((40, 48, 56), 0.02, T_world_grid)
    occupied = mesh_occupancy(truth.mesh_world, grid)
    centres = transform_points(T_world_grid, (np.moveaxis(np.indices(grid.shape), 0, -1) + 0.5) * 0.02)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        tensor(truth.mesh_world.vertices.astype(np.float32)),
        tensor(truth.mesh_world.faces.astype(np.uint32)),
    )
    inside = scene.compute_occupancy(tensor(centres.astype(np.float32)), nsamples=5).numpy() > 0
    assert occupied.sum() > 200
    assert (occupied != inside).sum() <= 2


@pytest.mark.parametrize("world", ["first_camera", "random"])
def test_the_world_offset_moves_everything_alike(world: str) -> None:
    upright, other = prepare(spec_of()), prepare(spec_of(world=world))
    assert np.allclose(
        invert_rigid(other.T_world_object) @ other.T_world_camera,
        invert_rigid(upright.T_world_object) @ upright.T_world_camera,
    )
    assert np.allclose(other.T_world_camera[0], np.eye(4)) == (world == "first_camera")
    assert np.allclose(upright.T_world_object[2], [0, 0, 1, 0])


def test_foreign_frames_show_something_else_and_have_no_truth(tmp_path: Path) -> None:
    spec = spec_of(path={"frames": 5}, faults={"foreign_frames": 1}, sensor={"model": "ideal"})
    simulate(spec, tmp_path / "r")
    truth = read_truth(tmp_path / "r.truth")
    assert np.isnan(truth.T_world_camera[2]).all()
    assert np.isfinite(truth.T_world_camera[[0, 1, 3, 4]]).all()
    assert not truth.mask(2).any()
    own = record_frame(prepare(spec_of(path={"frames": 5}, sensor={"model": "ideal"})), 2)
    assert np.abs(present(truth.depth_m(2)) - own.depth_m).mean() > 0.05
    assert len(present(open_recording(tmp_path / "r", None).given_trajectory).stamps_ns) == 5


def test_unregistered_colour_is_shifted_and_mis_scaled_depth_is_scaled() -> None:
    registered, beside = (
        record_frame(prepare(spec_of(sensor={"model": "ideal", "color_registered": flag})), 0)
        for flag in (True, False)
    )
    assert np.array_equal(registered.frame.depth_m, beside.frame.depth_m)
    assert not np.array_equal(registered.frame.color_rgb, beside.frame.color_rgb)
    scaled = record_frame(prepare(spec_of(sensor={"model": "ideal"}, faults={"scale_error": 1.1})), 0)
    assert np.allclose(scaled.frame.depth_m, registered.frame.depth_m * 1.1)
    assert np.array_equal(scaled.depth_m, registered.depth_m)


def test_a_cut_recording_is_cut_and_its_truth_is_whole(tmp_path: Path) -> None:
    simulate(spec_of(format="bag_compressed"), tmp_path / "whole.bag")
    simulate(spec_of(format="bag_compressed", faults={"cut_share": 0.4}), tmp_path / "cut.bag")
    whole, short = (tmp_path / "whole.bag").read_bytes(), (tmp_path / "cut.bag").read_bytes()
    assert whole.startswith(short)
    assert len(short) == pytest.approx(0.6 * len(whole), rel=0.01)
    assert len(read_truth(tmp_path / "cut.truth").stamps_ns) == 3


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (("truth.json", None), "no readable truth"),
        (("truth.json", "{"), "no readable truth"),
        (("truth.json", "[]"), "no readable truth"),
        (("truth.json", '{"format_version": 1}'), "format version 1"),
        (("truth.json", '{"format_version": 2}'), "no readable truth"),
        (("frames.npz", "x"), "no readable truth"),
        (("object.ply", "ply"), "no readable truth"),
        (("surface.npz", None), "no readable truth"),
    ],
)
def test_damaged_truth_gives_one_line(
    ideal: tuple[SimulationSpec, Path], tmp_path: Path, damage: tuple[str, str | None], says: str
) -> None:
    folder = tmp_path / "damaged"
    folder.mkdir()
    for name, data in files(truth_folder(ideal[1])).items():
        if "/" not in name:
            (folder / name).write_bytes(data)
    name, text = damage
    (folder / name).unlink()
    if text is not None:
        (folder / name).write_text(text)
    with pytest.raises(RecordingError, match=says) as caught:
        read_truth(folder)
    assert "\n" not in str(caught.value)


def test_what_is_no_simulated_recording_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "photo.jpg").write_text("dear")
    (tmp_path / "theirs.truth").mkdir()
    (tmp_path / "theirs.truth" / "notes.txt").write_text("mine")
    (tmp_path / "fake").mkdir()
    (tmp_path / "fake" / "data").write_text("dear")
    (tmp_path / "fake.truth").mkdir()
    (tmp_path / "fake.truth" / "truth.json").write_text("{}")
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "data").write_text("dear")
    (tmp_path / "deep.truth").mkdir()
    (tmp_path / "deep.truth" / "truth.json").write_text("[" * 100_000)
    (tmp_path / "dangling").symlink_to("nowhere")
    (tmp_path / "twin.bag").write_text("a bag")
    names = ("mine", "x.bag", "x.BAG", "x.truth", "theirs", "fake", "deep", "dangling", "twin")
    before = files(tmp_path)
    for out in (*(tmp_path / name for name in names), Path()):
        with pytest.raises(KinectBenchError) as caught:
            simulate(spec_of(), out)
        assert "\n" not in str(caught.value)
    assert files(tmp_path) == before


def test_an_empty_folder_and_an_earlier_simulation_are_filled(tmp_path: Path) -> None:
    (tmp_path / "r").mkdir()
    (tmp_path / ".r.12.part").write_text("left by a run that was killed")
    simulate(spec_of(), tmp_path / "r")
    simulate(spec_of(object="table:seed=1"), tmp_path / "r")
    assert read_truth(tmp_path / "r.truth").subject == "table:seed=1"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r", "r.truth"]


@pytest.mark.parametrize(
    ("added", "earlier"),
    [
        *(
            (name, earlier)
            for name in ("benchmark.yaml", "build/object.ply", "masks/0.png")
            for earlier in (0, 2)
        ),
        *((name, earlier) for name in ("notes.md", "rgb more/0.png") for earlier in (0, 1)),
        ("depth/notes.txt", 0),
        ("depth/9.5.png", 0),
    ],
)
def test_what_was_added_to_a_recording_is_not_replaced_with_it(
    added: str, earlier: int, ideal: tuple[SimulationSpec, Path], tmp_path: Path
) -> None:
    """Earlier versions name the files at the top, still earlier ones none: what the commands add is known."""
    out, truth = tmp_path / "r", tmp_path / "r.truth"
    shutil.copytree(ideal[1], out)
    shutil.copytree(truth_folder(ideal[1]), truth)
    record = json.loads((truth / "truth.json").read_text())
    top = ["camera.json", "depth", "depth.txt", "groundtruth.txt", "rgb", "rgb.txt"]
    assert list(record["files"]) == sorted([*top, "depth/#.#.png", "rgb/#.#.jpg"])
    assert record["files"]["depth/#.#.png"] == len(list(out.glob("depth/*.png"))) > 1
    del record["files"]
    if earlier:
        (truth / "truth.json").write_text(json.dumps(record | ({"files": top} if earlier == 1 else {})))
    for name in (".DS_Store", "depth/.DS_Store", ".cache/rgb"):
        (out / name).parent.mkdir(exist_ok=True)
        (out / name).write_text("of the system")
    assert added_files(truth, out) == []
    (out / added).parent.mkdir(exist_ok=True)
    (out / added).write_text("by hand")
    before = files(tmp_path)
    named = re.sub(r"\d", "#", added) if added.startswith("depth") else added.partition("/")[0]
    with raises(SettingsError, "settings.other-content", match=named):
        simulate(spec_of(), out)
    assert files(tmp_path) == before


def test_wrong_stamps_leave_the_given_trajectory_alone(tmp_path: Path) -> None:
    spec = spec_of(path={"frames": 4}, faults={"swapped_stamps": 1})
    simulate(spec, tmp_path / "r")
    rows = np.loadtxt(tmp_path / "r" / "groundtruth.txt")
    assert np.allclose(rows[:, 0] * 1e9, [spec.stamp_ns(index) for index in range(4)], atol=1e3)
    assert (np.diff(read_truth(tmp_path / "r.truth").stamps_ns) < 0).sum() == 1


@pytest.mark.parametrize("name", ["benchmark.yaml", "demo/benchmark.yaml"])
def test_the_benchmarks_name_the_real_recording_first_and_then_those_that_are_made(name: str) -> None:
    path = ROOT / name
    settings = BenchmarkSettings.model_validate(yaml.safe_load(path.read_text()))
    made = {ROOT / "recordings" / n for n in presets.SAMPLES} | {
        ROOT / "demo" / "recordings" / n for n in presets.DEMO
    }
    first, *others = ((path.parent / recording.path).resolve() for recording in settings.recordings)
    assert first == ROOT / "recordings" / "cabinet_01"
    assert {*others} <= made
    assert len({*others}) == len(others)


@pytest.mark.parametrize("name", presets.SAMPLES)
def test_the_stored_samples_are_the_ones_that_are_made(name: str) -> None:
    truth = read_truth(truth_folder(ROOT / "recordings" / name))
    simulation = prepare(presets.SAMPLES[name])
    mesh = simulation.subject.mesh.transformed(simulation.T_world_object)
    assert np.array_equal(truth.mesh_world.faces, mesh.faces)
    assert np.allclose(truth.mesh_world.vertices, mesh.vertices, atol=1e-6)
    assert np.allclose(truth.T_world_camera, simulation.T_world_camera)


def test_every_frame_of_the_samples_shows_the_subject() -> None:
    for spec in {**presets.SAMPLES, **presets.DEMO}.values():
        simulation = prepare(spec)
        for index in range(0, spec.path.frames, 15):
            recorded = record_frame(simulation, index)
            assert recorded.mask.sum() > 1500
            # A table top seen edge-on loses most.
            assert (recorded.frame.depth_m[recorded.mask] > 0).mean() > 0.5


@pytest.mark.parametrize("registered", [True, False])
def test_a_rolling_shutter_takes_each_row_when_it_is_read(registered: bool) -> None:
    """Row k of the depth is that of a frame taken at once when row k is read; the colour's, 20 ms later."""
    turning = {"turn_rad": 0.5, "turn_rad_per_s": 2.5, "shake_m": 0.0, "frames": 8, "rate_hz": 30.0}
    sensor = {"model": "ideal", "color_delay_s": 0.02, "color_registered": registered, "readout_s": 0.03}
    rolled = prepare(spec_of(object="chair:seed=7", path=turning, sensor=sensor))
    at_once = prepare(spec_of(object="chair:seed=7", path=turning, sensor={**sensor, "readout_s": 0.0}))
    found, middle = record_frame(rolled, 5), record_frame(at_once, 5)
    assert not np.array_equal(found.depth_m, middle.depth_m)
    plan = at_once.frames[5]
    for row in (0, 40, 119):
        time_s = plan.time_s + 0.03 * (row / 119 - 0.5)
        then = record_frame(replace(at_once, frames=(replace(plan, time_s=time_s),)), 0)
        np.testing.assert_allclose(found.depth_m[row], then.depth_m[row], atol=1e-5)
        assert np.abs(found.frame.color_rgb[row].astype(int) - then.frame.color_rgb[row]).max() <= 2
        assert not np.array_equal(found.depth_m[row], middle.depth_m[row])
