"""Bad input of every kind: the exit status, one clear line, and nothing lost that was made before."""

import json
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_lines import ONE, Command, check_line
from ingest_writers import write_tum
from read_pictures import read_picture
from slow import slow
from small_benchmark import STAGE_FOLDERS, copied, hashes, leftovers, run, small_spec

from kinectbench.lab.simulate.simulate import simulate

pytestmark = pytest.mark.xdist_group("commands")

# --- recordings ---------------------------------------------------------------------------------------


def depth_files(recording: Path) -> list[Path]:
    return sorted((recording / "depth").glob("*.png"))


def read(path: Path) -> np.ndarray:
    return read_picture(path, cv2.IMREAD_UNCHANGED)


def write(path: Path, image: np.ndarray) -> None:
    assert cv2.imwrite(str(path), image)


def lost(recording: Path) -> None:
    shutil.rmtree(recording)


def empty_folder(recording: Path) -> None:
    lost(recording)
    recording.mkdir()


def unknown_layout(recording: Path) -> None:
    empty_folder(recording)
    (recording / "video.mp4").write_bytes(b"not a recording")


def color_of_another_size(recording: Path) -> None:
    for path in (recording / "rgb").iterdir():
        write(path, cv2.resize(read(path), (320, 240)))


def depth_of_8_bits(recording: Path) -> None:
    for path in depth_files(recording):
        write(path, (read(path) // 256).astype(np.uint8))


def depth_of_another_size(recording: Path) -> None:
    for path in depth_files(recording)[5:7]:  # one alone is left out
        write(path, cv2.resize(read(path), (80, 60), interpolation=cv2.INTER_NEAREST))


def no_intrinsics(recording: Path) -> None:
    (recording / "camera.json").unlink()


def with_depth_scale(scale: float) -> Callable[[Path], None]:
    def spoil(recording: Path) -> None:
        path = recording / "camera.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), "depth_scale": scale}))

    return spoil


def halved_images(recording: Path) -> None:
    for path in depth_files(recording)[3:6]:
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def edit_trajectory(edit: Callable[[list[str]], list[str]]) -> Callable[[Path], None]:
    def spoil(recording: Path) -> None:
        path = recording / "groundtruth.txt"
        rows = [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]
        path.write_text("\n".join(" ".join(edit(row)) for row in rows) + "\n")

    return spoil


def in_front_of(
    depth_m: Callable[[np.ndarray, np.ndarray], np.ndarray], quaternion: str
) -> Callable[[Path], None]:
    """Every frame from one still camera, 1.2 m above the world's origin."""

    def spoil(recording: Path) -> None:
        K = json.loads((recording / "camera.json").read_text())
        v, u = np.mgrid[:120, :160]
        depth = depth_m((u - K["cx"]) / K["fx"], (v - K["cy"]) / K["fy"])
        for path in depth_files(recording):
            write(path, np.round(np.clip(depth, 0, 10) * 5000).astype(np.uint16))
        edit_trajectory(lambda row: [row[0], "0", "0", "1.2", *quaternion.split()])(recording)

    return spoil


# Looks along the world's x, z up; and from there 45 degrees down.
LEVEL, DOWN = "-0.5 0.5 -0.5 0.5", "-0.653281 0.653281 -0.270598 0.270598"
wall_only = in_front_of(lambda x, y: np.full(x.shape, 1.5), LEVEL)
floor_only = in_front_of(lambda x, y: 1.2 * np.sqrt(2) / np.maximum(1 + y, 0.2), DOWN)

LAYOUTS = "rosbag1, |tum, |7scenes, |, folder|kinectbench formats"
BAD_RECORDINGS = {
    "no such recording": (lost, "recordings/chair: no such recording|correct `path`|'chair'"),
    "empty folder": (empty_folder, "recordings/chair: the folder is empty"),
    "unknown layout": (unknown_layout, f"recordings/chair: not a recording of a known format|{LAYOUTS}"),
    "colour of another size": (color_of_another_size, "colour is 320x240|depth is 160x120"),
    "depth of 8 bits": (depth_of_8_bits, "/depth/|.png: depth is 8-bit|16-bit|export"),
    "depth of another size": (depth_of_another_size, "/depth/|80x60|160x120|2 of 24 frames cannot be used"),
    "a room of 60 m": (with_depth_scale(200), "m at 200 native units per metre|at 5000 it would be"),
    "a room of 6 cm": (with_depth_scale(200_000), "m at 200000 native units per metre|at 5000 it would be"),
    "no intrinsics": (no_intrinsics, "recordings/chair: |fx, fy, cx, cy|camera: {fx"),
    "images cut in half": (halved_images, "/depth/|cut off after|3 of 24 frames"),
    "trajectory of another time": (
        edit_trajectory(lambda row: [str(float(row[0]) + 5000), *row[1:]]),
        "shares no time with the frames|1400000000",
    ),
    "NaN in the trajectory": (
        edit_trajectory(lambda row: [row[0], "nan", *row[2:]]),
        "groundtruth.txt, line 1: the pose holds NaN or infinity|remove",
    ),
    "no floor": (wall_only, "no floor found"),
    "no object": (floor_only, "no object"),
}


@pytest.mark.parametrize("name", BAD_RECORDINGS)
def test_bad_recording(command: Command, one: Path, name: str) -> None:
    spoil, words = BAD_RECORDINGS[name]
    # The later stages' artefacts must outlive a failure of an earlier one.
    later = {f: hashes(one / "build" / "chair" / f) for f in ("object", "views", "pairs")}
    spoil(one / "recordings" / "chair")
    line = check_line(command(one, "build"), 1, words)
    assert line.startswith("chair: error: ")
    assert {f: hashes(one / "build" / "chair" / f) for f in later} == later
    assert leftovers(one) == []
    assert check_line(command(one, "build"), 1, words) == line


def test_a_trajectory_that_shakes(command: Command, one: Path) -> None:
    def shaken(row: list[str]) -> list[str]:
        step = round(float(row[0]) * 5) % 3
        return [*row[:3], str(float(row[3]) + 0.1 * step), *row[4:]]

    edit_trajectory(shaken)(one / "recordings" / "chair")
    strict = ["--set", "tracking.check_stride_px=1", "--set", "tracking.max_disagreement_m=0.005"]
    check_line(command(one, "build", *strict), 1, "does not fit the depth|`trajectory: ignore`")


def test_one_damaged_image_is_left_out_with_a_warning(command: Command, one: Path) -> None:
    path = depth_files(one / "recordings" / "chair")[7]
    path.write_bytes(path.read_bytes()[:1000])
    run = command(one, "ingest")
    assert run.status == 0
    assert [line for line in run.err.splitlines() if path.name in line and "frame left out" in line]
    assert run.out.split("damaged")[1].split("│")[2:4] == ["     23 ", "       1 "]
    (row,) = json.loads(command(one, "ingest", "--json").out)
    assert (row["frames"], row["damaged"]) == (23, 1)


def test_a_recording_that_fails_does_not_stop_the_others(
    command: Command, small: Path, tmp_path: Path
) -> None:
    root = copied(small, tmp_path / "two")
    halved_images(root / "recordings" / "chair")
    run = command(root, "publish", "--set", "views.seed=3", "--json", "--jobs", "1")
    assert check_line(run, 3, "chair: error: |cut off after")
    assert json.loads(run.out)["recordings"] == ["table"]
    there = command(root, "baseline", "empty", "--set", "views.seed=3", "--jobs", "1")
    assert (there.status, there.err) == (0, ""), "the release is what can be published"
    (root / "benchmark").rename(root / "elsewhere")
    score = command(root, "baseline", "empty", "--set", "views.seed=3", "--jobs", "1")
    assert check_line(score, 3, "chair: error: left out: it failed before|`kinectbench build chair --force`")
    build = command(root, "build", "chair", "--set", "views.seed=3", "--jobs", "1")
    assert check_line(build, 1, "chair: error: |cut off after")


def test_both_recordings_fail(command: Command, small: Path, tmp_path: Path) -> None:
    root = copied(small, tmp_path / "two", "benchmark.yaml", "recordings")
    for name in ("chair", "table"):
        depth_of_8_bits(root / "recordings" / name)
    for arguments in (["build", "--jobs", "2"], ["publish", "--jobs", "1"], ["baseline", "--jobs", "1"]):
        run = command(root, *arguments)
        assert run.status == 1
        assert [line.split(": ")[0] for line in run.err.splitlines()] == ["chair", "table", "failed"]


@pytest.mark.parametrize("damage", ["no index", "half"])
def test_damaged_bag(command: Command, tmp_path: Path, damage: str) -> None:
    bag = tmp_path / "recordings" / "chair.bag"
    simulate(small_spec("chair", "bag"), bag)
    data = bag.read_bytes()
    at = data.index(b"index_pos=") + len(b"index_pos=")
    index_at = struct.unpack_from("<Q", data, at)[0]
    bag.write_bytes(data[: index_at if damage == "no index" else len(data) // 2])
    (tmp_path / "benchmark.yaml").write_text(ONE.replace("recordings/chair", "recordings/chair.bag"))
    run = command(tmp_path, "ingest")
    if damage == "half":  # and so its only chunk of messages
        check_line(run, 1, "chair.bag: is cut off or has no index|nothing in it can be saved")
    else:
        assert run.status == 0
        assert "chair: warning: " in run.err and "is cut off or has no index" in run.err


# --- stored artefacts ---------------------------------------------------------------------------------

ARTEFACTS = {
    "sequence/frames.json": "track",
    "sequence/camera.json": "track",
    "trajectory/trajectory.txt": "fuse",
    "trajectory/health.json": "fuse",
    "reconstruction/mesh.ply": "segment",
    "object/mesh.ply": "sample-views",
    "object/volume.npz": "sample-views",
    "object/surround.npz": "sample-views",
    "object/floor.json": "sample-views",
    "object/quality.json": "sample-views",
    "views/views.json": "pairs",
    "views/000.mask.png": "pairs",
}


@pytest.mark.parametrize(
    ("file", "truncate"),
    [
        slow("object/mesh.ply", False),
        slow("object/volume.npz", True),
        ("object/mesh.ply", True),
        ("object/volume.npz", False),
        ("pairs/001.npz", True),
        ("pairs/001.npz", False),
        ("sequence/camera.json", True),
        ("sequence/camera.json", False),
    ],
)
def test_truncated_or_lost_artefact_is_made_again(
    command: Command, one: Path, file: str, truncate: bool
) -> None:
    before = hashes(one / "build")
    path = one / "build" / "chair" / file
    if truncate:
        path.write_bytes(path.read_bytes()[:-7])
    else:
        path.unlink()
    run = command(one, "build", "--json")
    assert run.status == 0
    assert [STAGE_FOLDERS[stage] for stage in json.loads(run.out)[0]["made"]] == [file.split("/")[0]]
    assert hashes(one / "build") == before


@pytest.mark.parametrize("garbage", [b"\xff", b"1 "])
@pytest.mark.parametrize("file", ARTEFACTS)
def test_garbage_of_the_same_size_is_named(command: Command, one: Path, file: str, garbage: bytes) -> None:
    path = one / "build" / "chair" / file
    size = path.stat().st_size
    path.write_bytes((garbage * size)[:size])
    stage = ARTEFACTS[file]
    shutil.rmtree(one / "build" / "chair" / STAGE_FOLDERS[stage])
    check_line(command(one, stage), 1, f"build/chair/{file.split('/')[0]}|kinectbench ")


def test_force_makes_garbage_good_again(command: Command, one: Path) -> None:
    before = hashes(one / "build")
    path = one / "build" / "chair" / "object" / "mesh.ply"
    path.write_bytes(b"\xff" * path.stat().st_size)
    shutil.rmtree(one / "build" / "chair" / "pairs")
    check_line(command(one, "build"), 1, "object/mesh.ply|`kinectbench build --force`")
    assert command(one, "build", "--force").status == 0
    assert hashes(one / "build") == before


# --- masks --------------------------------------------------------------------------------------------


def masks_lost(folder: Path) -> None:
    folder.rmdir()


def mask_of_another_size(folder: Path) -> None:
    write(folder / "000.png", np.zeros((240, 320), np.uint8))


def mask_no_image(folder: Path) -> None:
    (folder / "001.png").write_bytes(b"no image")


def mask_empty_file(folder: Path) -> None:
    (folder / "001.png").touch()


BAD_MASKS = {
    "folder lost": (masks_lost, "no such folder of masks|masks/chair"),
    "another size": (mask_of_another_size, "masks/chair/000.png|320x240|160x120"),
    "no image": (mask_no_image, "masks/chair/001.png: not a readable PNG"),
    "empty file": (mask_empty_file, "masks/chair/001.png: not a readable PNG"),
}


@pytest.mark.parametrize("name", BAD_MASKS)
def test_bad_masks(command: Command, one: Path, name: str) -> None:
    spoil, words = BAD_MASKS[name]
    before = hashes(one / "build")
    (one / "masks" / "chair").mkdir(parents=True)
    spoil(one / "masks" / "chair")
    check_line(command(one, "build", "--set", "recordings.chair.masks=masks/chair"), 1, words)
    assert hashes(one / "build") == before


def test_a_lost_folder_of_masks_stops_a_build_at_its_start(command: Command, one: Path) -> None:
    shutil.rmtree(one / "build")
    lost = ("build", "--set", "recordings.chair.masks=masks/none")
    line = check_line(command(one, *lost), 1, "no such folder of masks")
    assert check_line(command(one, *lost, "-v"), 1, "") == f"{line} (recording.not-found)"
    assert not list((one / "build").glob("chair/*/"))


def test_the_code_of_an_error_is_shown_to_whoever_looks_for_its_cause(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    line = check_line(command(tmp_path, "build"), 2, "no such file")
    monkeypatch.setenv("KINECTBENCH_DEBUG", "1")
    assert check_line(command(tmp_path, "build"), 2, "") == f"{line} (settings.no-file)"


LONG = "x" * 300


@pytest.mark.parametrize(
    "words",
    [
        ("simulate", LONG),
        ("simulate", f"a/{LONG}", "--frames", "3"),
        ("inspect", LONG),
        ("init", LONG),
        ("build", "-c", LONG),
        ("verify", LONG),
        ("report", "--out", LONG),
    ],
)
def test_a_name_that_is_too_long_is_said_in_one_line(
    command: Command, one: Path, words: tuple[str, ...]
) -> None:
    line = command(one, *words).err.splitlines()[-1]
    assert "longer than a file's name can be here: choose a shorter one" in line, line
    assert "internal error" not in line and "stopped" not in line


def test_what_libraries_say_of_a_damaged_image_is_not_shown(tmp_path: Path) -> None:
    """libjpeg complains on standard error by itself; only in a process of its own is that the command's."""
    folder = write_tum(tmp_path / "r")
    image = folder / "rgb" / "1.jpg"
    data = bytearray(image.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 64] = b"\xff\xd0" * 32
    image.write_bytes(data)
    alone = [sys.executable, "-c", "import cv2, sys; cv2.imread(sys.argv[1])", str(image)]
    assert "Corrupt JPEG" in subprocess.run(alone, capture_output=True, text=True, check=True).stderr
    found = run(tmp_path, "inspect", "r")
    assert "Corrupt" not in found.err and found.out
