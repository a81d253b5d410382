"""Scales and codes of depth are offered where the given poses fit by them, and nowhere else."""

import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from ingest_writers import png
from kinectbench_plugins.formats.scene_folders import rotated
from numpy.typing import NDArray
from read_pictures import read_picture

from kinectbench.doctor import inspect
from kinectbench.doctor.codes import solve_scale
from kinectbench.doctor.during_build import likely_cause
from kinectbench.doctor.probe import probe_recording
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.settings.models import CameraSettings, TrackingSettings
from kinectbench.stages.ingest.depth_codes import ray_lengths
from kinectbench.stages.ingest.readers import open_recording

SAMPLES = Path(__file__).parents[2] / "recordings"
Metres = NDArray[np.float64]
pytestmark = pytest.mark.xdist_group("depth codes")


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A chair in a room, 24 frames of 160 x 120 with exact poses: a plain folder, depth in mm."""
    folder = tmp_path_factory.mktemp("codes") / "tum"
    spec = {
        "object": "chair:seed=1",
        "path": {"frames": 24, "arc_rad": 2.0, "distance_m": 1.6},
        "sensor": {"model": "phone_lidar", "width": 160, "height": 120},
        "save_depth": False,
    }
    simulate(SimulationSpec.model_validate(spec), folder)
    return folder


def recoded(base: Path, folder: Path, encode: Callable[[Metres], NDArray[np.uint16]]) -> Path:
    """The same as a plain folder, with its depth stored otherwise."""
    recording = open_recording(base)
    for name in ("depth", "color"):
        (folder / name).mkdir(parents=True)
    rows = []
    given = recording.given_trajectory
    assert given is not None
    for index in range(len(recording)):
        frame = recording.frame(index)
        metres = frame.depth / recording.depth_scale
        (folder / f"depth/{index:06d}.png").write_bytes(png(encode(metres)))
        assert frame.color is not None
        (folder / f"color/{index:06d}{frame.color[0]}").write_bytes(frame.color[1])
        T = given.T_world_camera[np.abs(given.stamps_ns - frame.stamp_ns).argmin()]
        rows.append(" ".join(repr(float(value)) for value in T.ravel()))
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")
    camera = recording.camera
    (folder / "cam_K.txt").write_text(f"{camera.fx} 0 {camera.cx}\n0 {camera.fy} {camera.cy}\n0 0 1\n")
    return folder


def mm(metres: Metres) -> NDArray[np.uint16]:
    return np.rint(1000 * metres).astype(np.uint16)


def units(scale: float) -> Callable[[Metres], NDArray[np.uint16]]:
    return lambda metres: np.rint(scale * metres).clip(0, 65535).astype(np.uint16)


def z_buffer(metres: Metres) -> NDArray[np.uint16]:
    z = np.maximum(metres, 0.1)
    return np.where(metres > 0, np.rint(65535 * 10 / 9.9 * (1 - 0.1 / z)), 0).astype(np.uint16)


def disparity(metres: Metres) -> NDArray[np.uint16]:
    """The raw disparity of a Kinect v1; 2047: none."""
    raw = (3.3309495161 - 1 / np.maximum(metres, 0.01)) / 0.0030711016
    return np.where(metres > 0.35, np.rint(raw), 2047).astype(np.uint16)


@pytest.mark.parametrize(
    ("encode", "name", "advice"),
    [
        (mm, None, ""),
        (units(10000), "depth_scale", "depth_scale: 10000"),
        (units(256), "depth_scale", "depth_scale: 256"),
        (units(1250), "depth_scale", "if 1000 is right, multiply the poses' positions by 1.2"),
        (units(2000), "depth_scale", "if 1000 is right, multiply the poses' positions by 2;"),
        (units(4000), "depth_scale", "depth_scale: 4000"),
        (units(6553.5), "depth_scale", "depth_scale: 6553.5"),
        (lambda metres: metres.astype(np.float16).view(np.uint16), "depth_code", "depth_code: float16"),
        (
            lambda metres: rotated(np.rint(10000 * metres).astype(np.uint16)),
            "depth_code",
            "depth_code: rotated, depth_scale: 10000",
        ),
        (z_buffer, "depth_code", "n = 0.1, f = 10"),
        (disparity, "depth_code", "write 1000 / (-0.0030711016 * raw + 3.3309495161) mm"),
        (lambda metres: disparity(metres) % 2047, "depth_code", "FREENECT_DEPTH_REGISTERED"),
    ],
)
def test_what_the_poses_prove_is_offered_and_then_fits(
    base: Path, tmp_path: Path, encode: Callable[[Metres], NDArray[np.uint16]], name: str | None, advice: str
) -> None:
    folder = recoded(base, tmp_path / "r", encode)
    offered = [found for found in inspect(folder)[0].findings if found.name in ("depth_scale", "depth_code")]
    assert [found.name for found in offered] == [name] * (name is not None)
    if name is None:
        return
    assert advice in offered[0].advice and offered[0].severity == "stops"
    written = re.search(r"camera: \{(.+)\}", offered[0].advice)
    if written is None:  # a z-buffer is to be written again
        return
    followed = CameraSettings.model_validate(yaml.safe_load("{" + written[1] + "}"))
    after, _ = inspect(folder, followed)
    assert not after.stops and after.facts["poses_read_as"] == "as given"
    depth, scale = (
        open_recording(folder, followed).frame(0).depth,
        open_recording(folder, followed).depth_scale,
    )
    plain = open_recording(base)
    np.testing.assert_allclose(depth / scale, plain.frame(0).depth / plain.depth_scale, atol=0.003)


@pytest.mark.parametrize("name", ["chair_01", "table_01.bag"])
def test_no_scale_is_better_than_the_right_one(name: str) -> None:
    assert solve_scale(probe_recording(open_recording(SAMPLES / name))) is None


def test_depth_along_the_ray(base: Path, tmp_path: Path) -> None:
    lengths = ray_lengths(open_recording(base).camera)
    folder = recoded(base, tmp_path / "r", lambda metres: mm(metres * lengths))
    (offered,) = [found for found in inspect(folder)[0].findings if found.name == "depth_code"]
    assert offered.advice == "`camera: {depth_code: ray_distance}`"
    followed = CameraSettings(depth_code="ray_distance")
    assert not inspect(folder, followed)[0].stops
    depth, plain = open_recording(folder, followed).frame(0).depth, open_recording(base)
    np.testing.assert_allclose(depth / 1000, plain.frame(0).depth / plain.depth_scale, atol=0.0015)


def test_without_poses_nothing_is_offered_as_right(base: Path, tmp_path: Path) -> None:
    folder = recoded(base, tmp_path / "r", lambda metres: np.rint(10000 * metres).astype(np.uint16))
    (folder / "poses.txt").unlink()
    (found,) = [found for found in inspect(folder)[0].findings if found.name == "depth_scale"]
    assert "find out its unit" in found.advice and "which nothing here proves" in found.advice


def test_the_scale_that_depth_has_already_is_not_offered(base: Path, tmp_path: Path) -> None:
    """The left eighth is far away, which is unlikely; the median is as usual."""
    far = np.arange(160) < 20
    folder = recoded(base, tmp_path / "r", lambda m: np.where((m > 0) & far, mm(4 * m + 10), mm(m)))
    (folder / "poses.txt").unlink()
    (found,) = [found for found in inspect(folder)[0].findings if found.name == "depth_scale"]
    assert (
        "at 1000 units per metre, which is unlikely" in found.what and "median would be" not in found.advice
    )


def test_poses_of_another_recording_offer_nothing(base: Path, tmp_path: Path) -> None:
    """By no scale and no code do they fit."""
    folder = recoded(base, tmp_path / "r", mm)
    rows = (folder / "poses.txt").read_text().splitlines()
    np.random.default_rng(0).shuffle(rows)
    (folder / "poses.txt").write_text("\n".join(rows) + "\n")
    assert not [f for f in inspect(folder)[0].findings if f.name in ("depth_scale", "depth_code")]
    assert read_picture(folder / "depth/000000.png", cv2.IMREAD_UNCHANGED).dtype == np.uint16


def test_a_build_that_fails_names_the_code(base: Path, tmp_path: Path) -> None:
    """Where depth along the ray leaves no floor, say: not a line about the recording."""
    lengths = ray_lengths(open_recording(base).camera)
    folder = recoded(base, tmp_path / "r", lambda metres: mm(metres * lengths))
    assert (
        "depth may be coded: the given poses fit if depth is the distance along the ray"
        in likely_cause(open_recording(folder))[0]
    )
    assert likely_cause(open_recording(base))[0] == ""


def test_holes_of_65535_are_no_exchanged_bytes(base: Path, tmp_path: Path) -> None:
    def with_holes(metres: Metres) -> NDArray[np.uint16]:
        holes = np.random.default_rng(0).random(metres.shape) < 0.15
        return np.where(holes, 65535, mm(metres)).astype(np.uint16)

    said = {found.name for found in inspect(recoded(base, tmp_path / "r", with_holes))[0].findings}
    assert "invalid_code" in said and "byte_order" not in said


def test_raw_disparity_is_told_from_mm_with_the_same_code(base: Path, tmp_path: Path) -> None:
    """By freenect's code alone, without poses; depth in mm that reaches farther only has a code."""

    def with_code(metres: Metres) -> NDArray[np.uint16]:
        return np.where((metres > 1.4) | (metres == 0), 2047, mm(metres)).astype(np.uint16)

    found = {}
    for encode in (disparity, with_code):
        folder = recoded(base, tmp_path / encode.__name__, encode)
        (folder / "poses.txt").unlink()
        (found[encode],) = [each for each in inspect(folder)[0].findings if each.name == "invalid_code"]
    assert "raw disparity" in found[disparity].what and "write 1000 / (-0.003" in found[disparity].advice
    assert "disparity" not in found[with_code].what


def test_depth_images_of_two_sizes_end_in_one_line(base: Path, tmp_path: Path) -> None:
    folder = recoded(base, tmp_path / "r", mm)
    for number in (7, 8):  # of 24: one alone is left out
        (folder / f"depth/{number:06d}.png").write_bytes(png(np.full((60, 40), 900, np.uint16)))
    diagnosis, _ = inspect(folder, tracking=TrackingSettings())
    assert "depth_sizes" in {found.name for found in diagnosis.findings}


def test_of_floats_no_scale_of_what_they_became_is_offered(base: Path, tmp_path: Path) -> None:
    """In centimetres they are a hundred a metre, which inspect does not try; it must not name another."""
    folder = recoded(base, tmp_path / "r", mm)
    for image in sorted((folder / "depth").iterdir()):
        depth = read_picture(image, cv2.IMREAD_UNCHANGED)
        np.save(image.with_suffix(".npy"), (depth / 10).astype(np.float32))
        image.unlink()
    said = [found.advice for found in inspect(folder)[0].findings if "poses fit if depth is" in found.what]
    assert said == []
    (scale,) = [found.advice for found in inspect(folder)[0].findings if "`depth_scale: " in found.advice]
    assert "`depth_scale: 100`" in scale
    right, _ = inspect(folder, CameraSettings(depth_scale=100.0))
    assert not right.stops and right.facts["poses_read_as"] == "as given"


def tenths(metres: Metres) -> NDArray[np.uint16]:
    """Rotated bits, 0.1 mm, at 0.3 times the distance: nearly all is below 0.8192 m, as on a shelf."""
    near = np.rint(3000 * metres)
    depth = np.where(near < 8192, near, np.where(np.arange(160) % 30 == 0, near, 0)).astype(np.uint16)
    depth[0, :12], depth[1, :4] = 10000, 20000
    return rotated(depth)


def on_a_shelf(base: Path, folder: Path) -> Path:
    """The recording with positions and depth 0.3 times as long, its depth in `tenths`."""
    recoded(base, folder, tenths)
    rows = np.loadtxt(folder / "poses.txt").reshape(-1, 4, 4)
    rows[:, :3, 3] *= 0.3
    np.savetxt(folder / "poses.txt", rows.reshape(-1, 16), fmt="%.12f")
    return folder


@pytest.mark.parametrize("scale", [1000.0, 10000.0, 5000.0])
def test_rotated_bits_are_offered_before_a_plain_scale(base: Path, tmp_path: Path, scale: float) -> None:
    folder = on_a_shelf(base, tmp_path / "r")
    diagnosis, _ = inspect(folder, CameraSettings(depth_scale=scale))
    (offered,) = [found for found in diagnosis.findings if "poses fit if depth is" in found.what]
    assert offered.advice == "`camera: {depth_code: rotated, depth_scale: 10000}`"


def test_rotated_depth_in_mm_by_mistake_does_not_blame_the_poses(base: Path, tmp_path: Path) -> None:
    folder = on_a_shelf(base, tmp_path / "r")
    wrong, _ = inspect(folder, CameraSettings(depth_code="rotated", depth_scale=1000.0))
    assert "trajectory_scale" not in {found.name for found in wrong.findings}
    (found,) = [each for each in wrong.findings if each.name == "depth_scale" and "poses" in each.what]
    assert "`depth_scale: 10000`" in found.advice
    for settings in (None, CameraSettings(depth_code="rotated")):
        right, look = inspect(folder, settings)
        assert look is not None and look.recording.depth_scale == 10000.0
        assert right.facts["poses_read_as"] == "as given" and not right.stops


def test_without_poses_the_hint_names_rotated_bits(base: Path, tmp_path: Path) -> None:
    folder = on_a_shelf(base, tmp_path / "r")
    (folder / "poses.txt").unlink()
    diagnosis, _ = inspect(folder, CameraSettings(depth_scale=1000.0))
    (found,) = [each for each in diagnosis.findings if each.name == "depth_scale"]
    assert "`depth_code: rotated, depth_scale: 10000`" in found.advice and "proves" in found.advice
