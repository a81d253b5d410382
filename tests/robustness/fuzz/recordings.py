"""Recordings of every format, as the simulator's writers make them: three small frames of a wall."""

import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from random import Random

import numpy as np

from fuzz.damage import of_content
from fuzz.engine import Command, Damaged, Fuzzer
from fuzz.places import of_folder
from kinectbench.core.geometry import Camera, rigid, rotation_from_quaternion_xyzw
from kinectbench.lab.simulate.writers import RecordedFrame, Rig, formats

CAMERA = Camera(64, 48, 60.0, 61.0, 31.5, 23.5)
FRAMES = 3
STEP_NS = 33_333_333
START_NS = 1_305_031_107_000_000_000
RECORDING = "recording"
YAML = "name: fuzz\nrecordings:\n  - {{id: r, path: {name}, category: chair, camera: {camera}}}\n"
# What these formats do not say: their recordings are as large as a Kinect's, and have its intrinsics.
SAID = {"klg": CAMERA, "redwood_zip": CAMERA}


INGEST = ("ingest", "--jobs", "1")


def frames() -> Iterator[RecordedFrame]:
    """A slanted wall 1 to 2 m away; colour of noise; a camera that moves sideways."""
    for index in range(FRAMES):
        u, v = np.arange(CAMERA.width), np.arange(CAMERA.height)[:, None]
        depth_m = (1 + (u + 0.5 * v + index) / 100).astype(np.float32)
        color = np.random.default_rng(index).integers(0, 255, (CAMERA.height, CAMERA.width, 3), np.uint8)
        pose = rigid(rotation_from_quaternion_xyzw([0, 0, 0.01 * index, 1]), [0.02 * index, 0, 0])
        stamp_ns = START_NS + index * STEP_NS
        yield RecordedFrame(stamp_ns, depth_m, stamp_ns, color, pose, mask=depth_m < 1.4)


def make(folder: Path) -> None:
    rig = Rig(CAMERA, CAMERA, color_registered=True, T_color_depth=np.eye(4))
    for name, file_format in formats().items():
        (folder / name).mkdir()
        path = file_format.write_new(folder / name / RECORDING, rig, frames())
        said = asdict(SAID[name]) if name in SAID else {}
        text = YAML.format(name=path.name, camera=json.dumps(said))
        (path.parent / "benchmark.yaml").write_text(text, encoding="utf-8")
    _packed(folder / "ros2_sqlite", folder / "ros2_zstd")


def _packed(bag: Path, to: Path) -> None:
    """A ROS 2 bag whose file is packed by zstd."""
    import zstandard

    to.mkdir()
    file = next(bag.rglob("*.db3"))
    (to / f"{RECORDING}.db3.zstd").write_bytes(zstandard.compress(file.read_bytes()))
    text = YAML.format(name=f"{RECORDING}.db3.zstd", camera="{}")
    (to / "benchmark.yaml").write_text(text, encoding="utf-8")


def _recording(case: Path) -> Path:
    return next(path for path in sorted(case.iterdir()) if path.name.startswith(RECORDING))


def whole(case: Path) -> list[Command]:
    # So few frames are no good recording.
    return [Command(("inspect", "r"), (0, 1)), Command(INGEST, (0,))]


def damage(draw: Random, case: Path) -> Damaged:
    path = _recording(case)
    name = path.name
    if path.is_dir():
        story = of_folder(draw, path)
    else:
        content, said = path.read_bytes(), []
        for _ in range(draw.choice((1, 1, 2, 4))):
            content, how = of_content(draw, name, content)
            said.append(how)
        path.unlink()
        path.write_bytes(content)
        story = [f"{name}: {how}" for how in said]
    inspect, ingest = Command(("inspect", "r")), Command(INGEST)
    init = Command(("init", "--force", "."))
    return story, draw.choice(([inspect], [inspect, ingest], [ingest], [ingest], [init, inspect]))


RECORDINGS = Fuzzer("recordings", make, whole, damage)
