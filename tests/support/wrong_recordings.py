"""Right TUM folders made wrong, each in one way, and what the doctor should call it."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from read_pictures import read_picture

from kinectbench.core.geometry import invert_rigid, quaternion_xyzw_from_rotation, rigid
from kinectbench.core.geometry import rotation_from_quaternion_xyzw as rotation

Rows = list[list[str]]
FLIP = np.diag([1.0, -1.0, -1.0])


def rows_of(folder: Path, name: str) -> Rows:
    text = (folder / f"{name}.txt").read_text().splitlines()
    return [line.split() for line in text if line.strip() and not line.startswith("#")]


def write_rows(folder: Path, name: str, rows: Rows) -> None:
    (folder / f"{name}.txt").write_text("".join(" ".join(row) + "\n" for row in rows))


def change_rows(name: str, change: Callable[[Rows], Rows]) -> Callable[[Path], None]:
    return lambda folder: write_rows(folder, name, change(rows_of(folder, name)))


def change_images(
    name: str, change: Callable[[NDArray[np.generic]], NDArray[np.generic]]
) -> Callable[[Path], None]:
    def mutate(folder: Path) -> None:
        for _, file in rows_of(folder, name):
            image = read_picture(folder / file, cv2.IMREAD_UNCHANGED)
            (folder / file).unlink()  # it may be a link to the right one
            cv2.imwrite(str(folder / file), change(image))

    return mutate


def change_camera(**factors: float) -> Callable[[Path], None]:
    def mutate(folder: Path) -> None:
        file = folder / "camera.json"
        said = json.loads(file.read_text())
        if "depth_factor" in said:
            said["depth_scale"] = said.pop("depth_factor")
        file.write_text(
            json.dumps({k: v * factors.get(k, 1) for k, v in said.items() if not isinstance(v, bool)})
        )

    return mutate


def change_poses(change: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Callable[[Path], None]:
    """`change` maps (4, 4) to (4, 4)."""

    def pose(row: list[str]) -> list[str]:
        values = [float(word) for word in row[1:]]
        T = change(rigid(rotation(values[3:]), values[:3]))
        numbers = [*T[:3, 3], *quaternion_xyzw_from_rotation(T[:3, :3])]
        return [row[0], *(repr(float(number)) for number in numbers)]

    return change_rows("groundtruth", lambda rows: [pose(row) for row in rows])


def stamps(name: str, change: Callable[[float], float | int]) -> Callable[[Path], None]:
    return change_rows(name, lambda rows: [[repr(change(float(row[0]))), *row[1:]] for row in rows])


def _scaled(T: NDArray[np.float64], factor: float) -> NDArray[np.float64]:
    return rigid(T[:3, :3], factor * T[:3, 3])


def _all(*changes: Callable[[Path], None]) -> Callable[[Path], None]:
    def mutate(folder: Path) -> None:
        for change in changes:
            change(folder)

    return mutate


def _to_8_bit(depth: NDArray[np.generic]) -> NDArray[np.generic]:
    return np.rint(depth.astype(float) / 100).clip(0, 255).astype(np.uint8)


def _doubled_values(depth: NDArray[np.generic]) -> NDArray[np.generic]:
    """10000 units a metre; farther than 6.5 m there is none."""
    twice = depth.astype(np.uint32) * 2
    return np.where(twice > 65000, 0, twice).astype(np.uint16)


def _other_scene(folder: Path) -> None:
    _, file = rows_of(folder, "depth")[20]
    depth = read_picture(folder / file, cv2.IMREAD_UNCHANGED)
    (folder / file).unlink()
    slope = np.linspace(0.8, 3.5, depth.shape[1]) * 5000
    cv2.imwrite(str(folder / file), np.broadcast_to(slope, depth.shape).astype(np.uint16))


def _doubled(rows: Rows) -> Rows:
    """Every third image is the one before once more, under its own stamp."""
    return [[row[0], rows[i - (i % 3 == 2)][1]] for i, row in enumerate(rows)]


def _moved_colour(image: NDArray[np.generic]) -> NDArray[np.generic]:
    return np.roll(image, image.shape[1] // 16, axis=1)


def _wxyz(row: list[str]) -> list[str]:
    return [*row[:4], row[7], *row[4:7]]


def _frames_late(rows: Rows, by: int) -> Rows:
    """Each stamp gets the image of some frames before: colour is late."""
    return [[row[0], rows[max(i - by, 0)][1]] for i, row in enumerate(rows)]


def _reset(rows: Rows) -> Rows:
    half = len(rows) // 2
    return [*rows[:half], *([repr(float(row[0]) - 1000), *row[1:]] for row in rows[half:])]


def _cut_off(folder: Path) -> None:
    for _, file in rows_of(folder, "depth")[::4]:
        data = (folder / file).read_bytes()
        (folder / file).unlink()
        (folder / file).write_bytes(data[:-100])


def _every(rows: Rows, keep: Callable[[int], bool]) -> Rows:
    return [row for i, row in enumerate(rows) if keep(i)]


def stamps_shuffled(folder: Path) -> None:
    """Each image gets the stamp of another, depth and colour alike."""
    for name in ("depth", "rgb"):
        rows = rows_of(folder, name)
        order = np.random.default_rng(0).permutation(len(rows))
        write_rows(folder, name, [[row[0], rows[k][1]] for row, k in zip(rows, order, strict=True)])


DROP = change_rows("depth", lambda rows: _every(rows, lambda i: i % 3 != 2))
# name -> (what makes it wrong, the finding that names it, words of that finding)
WRONG: dict[str, tuple[Callable[[Path], None], str, str]] = {
    "millimetres x 10 in the images": (
        _all(change_images("depth", _doubled_values), change_camera(depth_scale=0.2)),
        "depth_scale",
        "depth_scale: 10000",
    ),
    "scale x 10": (change_camera(depth_scale=0.1), "depth_scale", "depth_scale: 5000"),
    "scale / 10": (change_camera(depth_scale=10), "depth_scale", "depth_scale: 5000"),
    "millimetres read as 1/5000 m": (change_camera(depth_scale=5), "depth_scale", "depth_scale: 5000"),
    "poses in millimetres": (change_poses(lambda T: _scaled(T, 1000)), "trajectory_scale", "0.001 times"),
    "inverse trajectory": (change_poses(invert_rigid), "trajectory_reading", "inverse"),
    "OpenGL axes": (change_poses(lambda T: T @ rigid(FLIP, np.zeros(3))), "trajectory_reading", "OpenGL"),
    "inverse and OpenGL": (
        change_poses(lambda T: invert_rigid(T @ rigid(FLIP, np.zeros(3)))),
        "trajectory_reading",
        "inverse), OpenGL",
    ),
    "wxyz quaternions": (
        change_rows("groundtruth", lambda rows: [_wxyz(row) for row in rows]),
        "trajectory_reading",
        "w x y z",
    ),
    "half-resolution intrinsics": (
        change_camera(fx=0.5, fy=0.5, cx=0.5, cy=0.5, width=1),
        "intrinsics_resolution",
        "multiply them by 2",
    ),
    "intrinsics of twice the size": (
        change_camera(fx=2, fy=2, cx=2, cy=2),
        "intrinsics_resolution",
        "multiply them by 0.5",
    ),
    "intrinsics with their own other size": (
        change_camera(width=2, height=2),
        "intrinsics",
        "the intrinsics are for",
    ),
    "no intrinsics": (lambda folder: (folder / "camera.json").unlink(), "intrinsics", "does not say"),
    "poses 200 ms late": (stamps("groundtruth", lambda t: t + 0.2), "trajectory_delay", "late"),
    "poses 150 ms early": (stamps("groundtruth", lambda t: t - 0.15), "trajectory_delay", "early"),
    "colour three frames late": (
        change_rows("rgb", lambda rows: _frames_late(rows, 3)),
        "color_delay",
        "late",
    ),
    "poses of an hour ago": (stamps("groundtruth", lambda t: t - 3600), "trajectory_time", "share no time"),
    "poses' seconds taken as nanoseconds": (
        stamps("groundtruth", lambda t: t * 1e-9),
        "trajectory_time_unit",
        "seconds read as nanoseconds",
    ),
    "swapped byte order": (
        change_images("depth", lambda d: d.astype(np.uint16).byteswap()),
        "byte_order",
        "",
    ),
    "8-bit depth": (change_images("depth", _to_8_bit), "depth_format", "8-bit"),
    "8 bits in 16": (
        change_images("depth", lambda d: _to_8_bit(d).astype(np.uint16) * 100),
        "depth_8_bit",
        "different values",
    ),
    "65535 for none": (
        change_images("depth", lambda d: np.where(d == 0, 65535, d).astype(np.uint16)),
        "invalid_code",
        "65535",
    ),
    "every third frame dropped": (DROP, "dropped_frames", "one after every 2"),
    "doubled frames": (change_rows("depth", _doubled), "doubled_frames", "the frame before"),
    "a frame of another scene": (_other_scene, "odd_frames", "frame 20"),
    "frames in no order, without poses": (
        _all(stamps_shuffled, lambda folder: (folder / "groundtruth.txt").unlink()),
        "frame_order",
        "no order of time",
    ),
    "mirrored images": (
        _all(change_images("depth", lambda d: d[:, ::-1]), change_images("rgb", lambda c: c[:, ::-1])),
        "mirrored_images",
        "mirrored",
    ),
    "mirrored colour": (change_images("rgb", lambda c: c[:, ::-1]), "color_mirrored", ""),
    "colour top to bottom": (change_images("rgb", lambda c: c[::-1]), "color_mirrored", ""),
    "colour upside down": (change_images("rgb", lambda c: c[::-1, ::-1]), "color_mirrored", ""),
    "colour beside depth": (change_images("rgb", _moved_colour), "color_not_registered", "right"),
    "colour of another clock": (stamps("rgb", lambda t: t + 5000), "color_unpaired", "5000"),
    "stamps of poses in nanoseconds": (
        stamps("groundtruth", lambda t: round(t * 1e9)),
        "trajectory_unreadable",
        "looks like nanoseconds",
    ),
    "stamps of poses in milliseconds": (
        stamps("groundtruth", lambda t: round(t * 1e3)),
        "trajectory_unreadable",
        "looks like milliseconds",
    ),
    "NaN in the poses": (
        change_rows("groundtruth", lambda rows: [[*rows[0][:3], "nan", *rows[0][4:]], *rows[1:]]),
        "trajectory_unreadable",
        "the pose holds NaN",
    ),
    "stamps of images in milliseconds": (
        _all(*(stamps(n, lambda t: round(t * 1e3)) for n in ("depth", "rgb", "groundtruth"))),
        "unreadable",
        "looks like milliseconds",
    ),
    "time running backwards": (
        change_rows("depth", lambda rows: [*rows[:9], rows[10], rows[9], *rows[11:]]),
        "time_backwards",
        "1 depth",
    ),
    "a clock that begins anew": (change_rows("depth", _reset), "clock_reset", "restarts"),
    "an empty list": (change_rows("depth", lambda rows: []), "unreadable", "lists no images"),
    "empty depth": (change_images("depth", lambda d: d * 0), "no_depth", ""),
    "quarter of the depth images cut off": (_cut_off, "damaged_frames", "cut off"),
}


# A further case of a finding that another one has already, by the same code.
FURTHER = {"scale / 10", "millimetres read as 1/5000 m", "inverse and OpenGL", "poses 150 ms early"}


def shortened(right: Path, folder: Path, frames: int) -> Path:
    """A copy of the first frames of a TUM folder that has a pose for each."""
    folder.mkdir(parents=True)
    shutil.copy(right / "camera.json", folder)
    for name in ("depth", "rgb", "groundtruth"):
        rows = rows_of(right, name)[:frames]
        write_rows(folder, name, rows)
        if name != "groundtruth":
            (folder / name).mkdir()
            for _, file in rows:
                shutil.copy(right / file, folder / file)
    return folder


def make_wrong(right: Path, name: str, folder: Path, frames: int | None = None) -> Path:
    """A copy of a right TUM folder, or of its first frames, with one thing wrong."""
    if frames is None:
        shutil.copytree(right, folder)
    else:
        shortened(right, folder, frames)
    WRONG[name][0](folder)
    return folder
