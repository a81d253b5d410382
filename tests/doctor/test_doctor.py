"""The doctor on the sample recordings, which are right, and on copies of them with one thing wrong."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from ingest_writers import BagWriter
from numpy.typing import NDArray
from raising import raises
from read_pictures import read_picture
from ruamel.yaml import YAML
from slow import slow
from small_benchmark import Run, small_spec
from wrong_recordings import FURTHER, WRONG, make_wrong, rows_of, shortened

from kinectbench.core.errors import RecordingError
from kinectbench.core.geometry import invert_rigid
from kinectbench.doctor import Finding, inspect
from kinectbench.doctor.during_build import likely_cause, refuse_hopeless
from kinectbench.doctor.finding import Diagnosis, gravest_first
from kinectbench.doctor.probe import frames_to_read
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.settings.models import CameraSettings, FusionSettings
from kinectbench.stages.ingest.readers import open_recording, recordings_inside

RECORDINGS = Path(__file__).parents[2] / "recordings"
CHAIR = RECORDINGS / "chair_01"


# Of the 72: enough for all that is wrong but a colour that is late.
FRAMES = {"colour three frames late": 40}


def names(diagnosis: Diagnosis) -> list[str]:
    return [found.name for found in diagnosis.findings]


def heights_m() -> NDArray[np.float64]:
    """Of the chair's cameras over the floor, by the truth."""
    rows = np.array([[float(word) for word in row] for row in rows_of(CHAIR, "groundtruth")])
    plane = np.array(json.loads((RECORDINGS / "chair_01.truth/floor.json").read_text())["plane_world"])
    heights_m: NDArray[np.float64] = rows[:, 1:4] @ plane[:3] + plane[3]
    return heights_m


@pytest.mark.parametrize("name", ["chair_01", "table_01.bag"])
def test_no_alarm_on_the_samples(name: str) -> None:
    diagnosis, look = inspect(RECORDINGS / name)
    assert diagnosis.findings == () and diagnosis.verdict == "usable"
    assert look is not None and len(look.frames) == diagnosis.facts["frames"] == 72
    assert diagnosis.facts["rate_hz"] == pytest.approx(5.0, abs=0.01)
    assert diagnosis.facts["poses_read_as"] == "as given"
    assert diagnosis.facts["arc_deg"] > 300  # type: ignore[operator]
    assert diagnosis.facts["pose_residual_mm"] < 5  # type: ignore[operator]
    assert diagnosis.facts["max_depth_m"] == 3.0 and 0 < diagnosis.facts["beyond_share"] < 0.3  # type: ignore[operator]
    if name == CHAIR.name:
        assert diagnosis.facts["camera_height_m"] == pytest.approx(np.median(heights_m()), abs=0.15)


def test_depth_of_the_object_that_would_make_no_surface_is_told() -> None:
    """The chair's middle is 1.5 m away: of what is in the middle of the images much lies beyond 1.4 m."""
    diagnosis, _ = inspect(CHAIR, fusion=FusionSettings(max_depth_m=1.4))
    (found,) = diagnosis.findings
    assert (found.name, found.severity) == ("far_depth", "warning")
    assert "beyond 1.4 m" in found.what and "fusion.max_depth_m" in found.advice


@pytest.mark.parametrize("name", [slow(name) if name in FURTHER else name for name in WRONG])
def test_what_is_wrong_is_named(name: str, tmp_path: Path) -> None:
    _, finding, words = WRONG[name]
    diagnosis, _ = inspect(make_wrong(CHAIR, name, tmp_path / "wrong", FRAMES.get(name, 24)))
    said = [f"{found.what}; {found.advice}" for found in diagnosis.findings if found.name == finding]
    assert said and any(words in text for text in said), diagnosis.findings
    assert diagnosis.verdict != "usable"
    assert all("\n" not in found.what for found in diagnosis.findings)


STORED = ("poses in millimetres", "inverse trajectory", "OpenGL axes", "wxyz quaternions")


@pytest.mark.parametrize("name", [*STORED, pytest.param("inverse and OpenGL", marks=pytest.mark.slow)])
def test_poses_in_another_convention_are_read_by_the_setting_offered(name: str, tmp_path: Path) -> None:
    path = make_wrong(CHAIR, name, tmp_path / "stored", 24)
    (stops,) = (found for found in inspect(path)[0].findings if found.severity == "stops")
    offered = YAML(typ="safe").load(stops.advice.split("`")[1])["camera"]
    camera = CameraSettings.model_validate(offered)
    diagnosis, look = inspect(path, camera)
    assert look is not None and not diagnosis.stops, diagnosis.findings
    right, given = open_recording(CHAIR).given_trajectory, look.recording.given_trajectory
    assert right is not None and given is not None
    here = np.isin(right.stamps_ns, given.stamps_ns)
    # A world that begins at another camera is the same up to one motion.
    a, b = right.T_world_camera[here], given.T_world_camera[np.isin(given.stamps_ns, right.stamps_ns)]
    np.testing.assert_allclose(invert_rigid(a[0]) @ a, invert_rigid(b[0]) @ b, atol=1e-4)


def test_a_reading_of_poses_that_does_not_fit_is_to_be_taken_out(tmp_path: Path) -> None:
    settings = CameraSettings.model_validate({"trajectory_reading": {"inverse": True}})
    path = make_wrong(CHAIR, "OpenGL axes", tmp_path / "stored", 24)
    advice = {found.name: found.advice for found in inspect(path, settings)[0].findings}
    assert "take `trajectory_reading` out" in advice["trajectory_reading"]


def write_bag(path: Path, cameras: tuple[str, ...], info: bool) -> Path:
    said = json.loads((CHAIR / "camera.json").read_text())
    with BagWriter(path) as bag:
        for index, (stamp, file) in enumerate(rows_of(CHAIR, "depth")[:12]):
            stamp_ns = int(stamp.replace(".", "")) * 1000
            depth = read_picture(CHAIR / file, cv2.IMREAD_UNCHANGED) // 5
            for place, name in enumerate(cameras):
                if index < 12 - place:
                    bag.image(f"/{name}/depth/image_raw", stamp_ns, depth, "16UC1", frame_id=name)
                    if info:
                        bag.info(f"/{name}/depth/camera_info", stamp_ns, said, frame_id=name)
    return path


def test_two_cameras_in_one_bag(tmp_path: Path) -> None:
    diagnosis, _ = inspect(write_bag(tmp_path / "two.bag", ("left", "right"), info=True))
    said = [found.what for found in diagnosis.findings if found.name == "reader"]
    assert any("depth is read from /left/depth/image_raw, not from /right/depth" in text for text in said)


def test_no_camera_info(tmp_path: Path) -> None:
    diagnosis, look = inspect(write_bag(tmp_path / "bare.bag", ("camera",), info=False))
    assert names(diagnosis)[0] == "intrinsics" and "does not say" in diagnosis.findings[0].what
    # All else is judged all the same.
    assert look is not None and diagnosis.facts["frames"] == 12
    settings = CameraSettings(fx=262.5, fy=262.5, cx=159.5, cy=119.5)
    assert "intrinsics" not in names(inspect(tmp_path / "bare.bag", settings)[0])


@pytest.mark.parametrize("content", [b"", b"\x00" * 100, b"#ROSBAG V2.0\n" + b"\xff" * 200, b"text\n"])
def test_what_is_no_recording_is_said_in_one_line(content: bytes, tmp_path: Path) -> None:
    for path in (tmp_path / "missing", tmp_path / "file.bag", tmp_path):
        (tmp_path / "file.bag").write_bytes(content)
        diagnosis, look = inspect(path)
        assert look is None and names(diagnosis) == ["unreadable"] and diagnosis.stops


def test_a_recording_inside_another_is_noted(small_chair: Path, tmp_path: Path) -> None:
    """Its frames are not read; without it nothing is noted."""
    outer = Path(shutil.copytree(small_chair, tmp_path / "outer"))
    assert "recording_inside" not in names(inspect(outer, CameraSettings())[0])
    shutil.copytree(small_chair, outer / "more" / "extra")
    found = inspect(outer, CameraSettings())[0].findings
    (finding,) = (each for each in found if each.name == "recording_inside")
    assert finding.severity == "note"
    assert finding.what.startswith("another recording lies inside: more/extra (")
    shutil.copytree(small_chair, outer / "second")
    found = inspect(outer, CameraSettings())[0].findings
    assert [each.what.endswith(" and 1 more") for each in found if each.name == "recording_inside"] == [True]


def test_folders_that_are_read_and_results_are_no_recordings_inside(
    small_chair: Path, tmp_path: Path
) -> None:
    """Apps keep images in a folder that is a recording by itself; results lie where `init` was run."""
    outer = Path(shutil.copytree(small_chair, tmp_path / "outer"))
    shutil.copytree(small_chair, outer / "benchmark")
    assert "recording_inside" not in names(inspect(outer, CameraSettings())[0])
    shutil.copytree(small_chair, outer / "keyframes")
    assert recordings_inside(outer, {outer / "keyframes" / "depth"}) == []
    assert len(recordings_inside(outer, ())) == 1


@pytest.mark.parametrize("size", [(1024, 64), (640, 96), (640, 98), (2048, 2), (64, 512)])
def test_flat_and_tall_images_are_inspected(size: tuple[int, int], tmp_path: Path) -> None:
    """As of a spinning lidar; no shift of colour is looked for in fewer rows than are tried."""
    width, height = size
    rng = np.random.default_rng(0)
    for number in range(4):
        across = 1500 + 400 * np.sin((np.arange(width) + 7 * number) / 60)
        depth = across + rng.normal(0, 3, (height, width))
        color = rng.integers(0, 255, (height, width, 3))
        for name, image in (("depth", depth.astype(np.uint16)), ("rgb", color.astype(np.uint8))):
            (tmp_path / name).mkdir(exist_ok=True)
            cv2.imwrite(str(tmp_path / name / f"{number:04d}.png"), image)
    camera = {"fx": 900, "fy": 900, "cx": width / 2, "cy": height / 2, "depth_scale": 1000}
    (tmp_path / "camera.json").write_text(json.dumps(camera | {"color_registered": True}))
    diagnosis, _ = inspect(tmp_path)
    assert diagnosis.facts["frames"] == 4
    assert "color_not_registered" not in {found.name for found in diagnosis.findings}


def test_frames_are_read_evenly() -> None:
    assert frames_to_read(7).tolist() == list(range(7))
    for count in (251, 1000, 30_000):
        indices = frames_to_read(count)
        assert len(indices) <= 342 and (np.diff(indices) > 0).all()
        assert indices[0] == 0 and indices[-1] == count - 1
        runs = np.split(indices, np.flatnonzero(np.diff(indices) != 1) + 1)
        assert max(map(len, runs)) >= 150  # long enough to find delays


def test_the_gravest_comes_first_and_decides() -> None:
    found = [Finding("a", "note", "", ""), Finding("b", "warning", "", ""), Finding("c", "stops", "", "")]
    assert [f.name for f in gravest_first([*found, found[0]])] == ["c", "b", "a"]
    assert Diagnosis({}, gravest_first(found)).verdict == "not usable as it is: c"
    assert Diagnosis({}, tuple(found[:2])).verdict == "usable with care: b"
    assert Diagnosis({}, tuple(found[:1])).verdict == "usable"


@pytest.mark.parametrize(("frames", "few"), [(3, True), (9, True), (10, False)])
def test_few_frames_are_told(frames: int, few: bool, tmp_path: Path) -> None:
    """So few that a build would warn of them, too."""
    shortened(CHAIR, tmp_path / "short", frames)
    diagnosis, _ = inspect(tmp_path / "short")
    found = [each for each in diagnosis.findings if each.name == "few_frames"]
    assert len(found) == few and ("few_frames" in diagnosis.verdict) == few and not diagnosis.stops
    assert all(each.severity == "warning" and f"{frames} frames only" in each.what for each in found)


def test_the_command(small_chair: Path, command: Callable[..., Run], tmp_path: Path) -> None:
    right = command(tmp_path, "inspect", str(small_chair), "--page", "sheet.html")
    assert right.status == 0 and right.out.splitlines()[-2] == "verdict: usable"
    page = (tmp_path / "sheet.html").read_text()
    assert page.count("data:image/jpeg") == 24 and '<div class="sheet triples">' in page
    assert "http" not in page.replace("http-equiv", "")
    wrong = command(tmp_path, "inspect", str(small_chair), "--json", "--set", "depth_scale=500")
    said = json.loads(wrong.out)
    assert wrong.status == 1 and said["verdict"].startswith("not usable") and said["depth_scale"] == 500
    assert said["findings"][0]["name"] == "depth_scale" and "5000" in said["findings"][0]["advice"]
    unknown = command(tmp_path, "inspect", str(small_chair), "--set", "fz=1")
    assert unknown.status == 2 and "in --set fz=1: unknown" in unknown.err


def test_guessed_intrinsics_give_no_number_to_write_down(tmp_path: Path) -> None:
    wrong = make_wrong(CHAIR, "poses 200 ms late", tmp_path / "wrong", 40)
    known = next(f for f in inspect(wrong)[0].findings if f.name == "trajectory_delay")
    assert "`camera: {trajectory_delay_s: " in known.advice
    (wrong / "camera.json").unlink()
    found = {f.name: f for f in inspect(wrong)[0].findings}
    assert found["intrinsics"].severity == "stops"
    assert found["trajectory_delay"].advice.startswith("give the intrinsics, and inspect again")
    assert not any("_s: " in f.advice for f in found.values())


def test_a_recording_of_the_benchmark_is_inspected_by_its_id(
    command: Callable[..., Run], tmp_path: Path
) -> None:
    wrong = make_wrong(CHAIR, "NaN in the poses", tmp_path / "recordings/one", 24)
    (wrong / "camera.json").unlink()
    yaml = "name: x\nrecordings:\n  - {id: a, path: recordings/one, category: chair, trajectory: trust}\n"
    (tmp_path / "benchmark.yaml").write_text(yaml)
    said = command(tmp_path, "inspect", "a")
    assert said.status == 1 and "stops: intrinsics" in said.out and "the pose holds NaN" in said.out
    camera = ", ".join(f"{k}: {v}" for k, v in json.loads((CHAIR / "camera.json").read_text()).items()
                       if k in ("width", "height", "fx", "fy", "cx", "cy"))  # fmt: skip
    rows = f"  - {{id: a, path: recordings/one, category: chair, trajectory: ignore, camera: {{{camera}}}}}\n"
    (tmp_path / "benchmark.yaml").write_text(f"name: x\nrecordings:\n{rows}")
    right = command(tmp_path, "inspect", "a")
    assert right.status == 0 and "stops" not in right.out and "no_trajectory" in right.out
    unknown = command(tmp_path, "inspect", "b")
    assert unknown.status == 1 and "there is no such file or folder" in unknown.out


@pytest.mark.parametrize("name", ["swapped byte order", "65535 for none", "half-resolution intrinsics"])
def test_a_build_does_not_begin_with_it(name: str, tmp_path: Path, command: Callable[..., Run]) -> None:
    refuse_hopeless(open_recording(CHAIR))
    with raises(RecordingError, "recording.implausible", match=f"{WRONG[name][2]}.*kinectbench"):
        refuse_hopeless(open_recording(make_wrong(CHAIR, name, tmp_path / "wrong", 24)))
    yaml = "name: x\nrecordings: [{id: a, path: wrong, category: chair}]\n"
    (tmp_path / "benchmark.yaml").write_text(yaml)
    built = command(tmp_path, "build", "--jobs", "1")
    assert built.status == 1 and len(built.err.splitlines()) == 1 and "kinectbench inspect" in built.err


@pytest.fixture(scope="module")
def small_chair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("small") / "chair"
    simulate(small_spec("chair"), folder)
    return folder


@pytest.mark.parametrize(
    ("scale", "trajectory", "advice"),
    [
        (1000, "trust", "`camera: {depth_scale: 5000}`"),
        (50000, "ignore", "find out its unit, and give `depth_scale`"),
        slow(1000, "ignore", "at 5000 the median would be"),
        slow(50000, "trust", "`camera: {depth_scale: 5000}`"),
    ],
)
def test_a_build_that_fails_names_the_scale(
    scale: int, trajectory: str, advice: str, small_chair: Path, command: Callable[..., Run], tmp_path: Path
) -> None:
    """First if the poses prove it; after the failure if only depth makes it likely."""
    camera = f"camera: {{depth_scale: {scale}}}"
    yaml = f"{{id: a, path: '{small_chair}', category: chair, trajectory: {trajectory}, {camera}}}"
    (tmp_path / "benchmark.yaml").write_text(f"name: x\nrecordings:\n  - {yaml}\n")
    built = command(tmp_path, "build", "--jobs", "1")
    (error,) = (line for line in built.err.splitlines() if line.startswith("a: error:"))
    assert built.status == 1 and f"{small_chair}: the depth's scale may be wrong: " in error
    first = "What failed: " in error and error.index("scale") < error.index("What failed: ")
    assert advice in error and first == (trajectory == "trust") and first != (". Perhaps why: " in error)


def test_a_build_that_fails_does_not_blame_a_right_scale(
    small_chair: Path, command: Callable[..., Run], tmp_path: Path
) -> None:
    assert likely_cause(open_recording(small_chair))[0] == ""
    yaml = f"name: x\nrecordings: [{{id: a, path: '{small_chair}', category: chair}}]\n"
    (tmp_path / "benchmark.yaml").write_text(yaml)
    built = command(tmp_path, "build", "--jobs", "1", "--set", "fusion.max_depth_m=0.35")
    assert built.status == 1 and "a: error: no object found: the fused scene is empty" in built.err
    assert "depth_scale" not in built.err


@pytest.mark.parametrize("median_m", [0.25, 5.0])
def test_near_and_far_scans_are_not_refused(
    median_m: float, small_chair: Path, command: Callable[..., Run], tmp_path: Path
) -> None:
    diagnosis, _ = inspect(small_chair)
    scale = 5000 * diagnosis.facts["depth_m"]["median"] / median_m  # type: ignore[index]
    yaml = f"name: x\nrecordings: [{{id: a, path: '{small_chair}', category: chair, trajectory: ignore}}]\n"
    (tmp_path / "benchmark.yaml").write_text(yaml)
    said = command(tmp_path, "ingest", "--set", f"recordings.a.camera={{depth_scale: {scale:g}}}")
    assert said.status == 0 and "may be wrong" not in said.err
    found = inspect(small_chair, CameraSettings(depth_scale=scale), mode="ignore")[0].findings
    assert "depth_scale" not in {each.name for each in found}


def test_depth_out_of_reach_is_not_called_missing(
    small_chair: Path, command: Callable[..., Run], tmp_path: Path
) -> None:
    yaml = f"{{id: a, path: '{small_chair}', category: chair, camera: {{depth_scale: 600}}}}"
    (tmp_path / "benchmark.yaml").write_text(f"name: x\nrecordings:\n  - {yaml}\n")
    built = command(tmp_path, "build", "--jobs", "1")
    assert "it has no depth between 0.3 and 4.5 m; correct the poses or the depth" in built.err


def test_poses_in_millimetres_end_a_build_before_it_fuses(
    small_chair: Path, command: Callable[..., Run], tmp_path: Path
) -> None:
    shutil.copytree(small_chair, tmp_path / "r")
    WRONG["poses in millimetres"][0](tmp_path / "r")
    yaml = "name: x\nrecordings: [{id: a, path: r, category: chair}]\n"
    (tmp_path / "benchmark.yaml").write_text(yaml)
    built = command(tmp_path, "build", "--jobs", "1")
    (error,) = (line for line in built.err.splitlines() if line.startswith("a: error:"))
    assert built.status == 1 and not (tmp_path / "build/a/reconstruction").exists()
    assert (
        "lengths 0.001 times as long" in error and "`camera: {trajectory_reading: {unit_m: 0.001}}`" in error
    )
    assert error.index("into benchmark.yaml. What failed") < error.index("reaches to 1000 m")
