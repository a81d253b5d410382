"""The largest cheap input of each reader: N units that cost a stranger next to nothing, and must cost us N.

Damage at random (the other modules) keeps inputs small. What multiplies is found here: keys by frames,
rows by pages, messages by chunks. Each function of `AMPLIFIERS` writes an input of `units` and gives what
reads it.
"""

import bz2
import gc
import io
import json
import os
import signal
import sqlite3
import struct
import time
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fuzz.worker import forget_peak, memory_kb
from kinectbench.core.errors import KinectBenchError

# Of one run at 2N units, seconds of the processor: half of what a command may take.
MOST_SECONDS = 5.0
# What a command may take, with its libraries.
MOST_MB = 500
# Twice the input may take three times as long, and what a clock cannot tell.
MOST_TIMES, ALWAYS_SECONDS = 3.0, 0.2

Run = Callable[[], Any]
CAMERA = {"fl_x": 60, "fl_y": 60, "cx": 32, "cy": 24, "w": 64, "h": 48}
PLAIN = "60 0 32\n0 60 24\n0 0 1\n"


class Amplifier(NamedTuple):
    """What writes an input of so many units into a folder and gives what reads it; and N."""

    make: Callable[[Path, int], Run]
    units: int


class Cost(NamedTuple):
    """What a run took: seconds of the processor; the most memory that it added, MB; what it ended with."""

    seconds: float
    megabytes: int
    end: str


def cost(run: Run) -> Cost:
    """Run in a process of its own, which has what is imported here; a line of ours is a good end."""
    read, write = os.pipe()
    child = os.fork()
    if not child:
        gc.freeze()  # else a collection copies every page of the parent: .5 s within a long run of tests
        signal.alarm(int(20 * MOST_SECONDS))
        end, before_kb, started = "done", forget_peak(), time.process_time()
        try:
            run()
        except KinectBenchError as error:
            end = "refused" if "\n" not in error.lines[0] and len(error.lines[0]) < 1000 else "a long line"
        except BaseException as error:
            end = f"{type(error).__name__}: {error}"[:500]
        seconds, used_kb = time.process_time() - started, memory_kb("VmHWM") - before_kb
        os.write(write, json.dumps([seconds, used_kb >> 10, end]).encode())
        os._exit(0)
    os.close(write)
    with os.fdopen(read, "rb") as told:
        said = told.read()
    _, status = os.waitpid(child, 0)
    return Cost(*json.loads(said)) if said else Cost(float("inf"), 0, f"ended by {status}")


def _png() -> bytes:
    import cv2

    return bytes(cv2.imencode(".png", np.full((48, 64), 1000, np.uint16))[1].tobytes())


def _read(path: Path) -> Run:
    """Open a recording and read its frames, as far as they can be read."""

    def run() -> None:
        from kinectbench.stages.ingest.images import DamagedImageError
        from kinectbench.stages.ingest.readers import open_recording

        recording = open_recording(path)
        for index in range(len(recording)):
            with suppress(DamagedImageError):
                recording.frame(index)

    return run


def _open(path: Path) -> Run:
    def run() -> None:
        from kinectbench.stages.ingest.readers import open_recording

        open_recording(path)

    return run


def keys_by_frames(folder: Path, units: int) -> Run:
    """A transforms.json with as many keys of all frames as frames."""
    (folder / "d.png").write_bytes(_png())
    said = {**CAMERA, **{f"k{n}": 0 for n in range(units)}, "frames": [{"depth_file_path": "d.png"}] * units}
    (folder / "transforms.json").write_text(json.dumps(said))
    return _open(folder)


def files_of_a_folder(folder: Path, units: int) -> Run:
    """A folder of depth of which all files but the first are empty."""
    (folder / "depth").mkdir()
    (folder / "intrinsics.txt").write_text(PLAIN)
    for number in range(units):
        (folder / f"depth/{number}.png").touch()
    (folder / "depth/0.png").write_bytes(_png())
    return _open(folder)


def lines_of_a_trajectory(folder: Path, units: int) -> Run:
    """A depth.txt and a groundtruth.txt of many lines that name one image."""
    (folder / "depth").mkdir()
    (folder / "depth/0.png").write_bytes(_png())
    said = {"fx": 60, "fy": 60, "cx": 32, "cy": 24, "width": 64, "height": 48}
    (folder / "camera.json").write_text(json.dumps(said))
    (folder / "depth.txt").write_text("".join(f"{n / 30:.4f} depth/0.png\n" for n in range(units)))
    poses = "".join(f"{n / 30:.4f} 0 0 0 0 0 0 1\n" for n in range(units))
    (folder / "groundtruth.txt").write_text(poses)
    return _open(folder)


def packed_files_of_a_bag(folder: Path, units: int) -> Run:
    """Bag files of a few bytes that each unpack to a megabyte of nothing."""
    import zstandard

    packed = zstandard.ZstdCompressor().compress(b"\x89MCAP0\r\n" + bytes(1 << 20))
    for number in range(units):
        (folder / f"a_{number}.mcap.zstd").write_bytes(packed)
    return _open(folder)


def rows_of_a_database(folder: Path, units: int) -> Run:
    """A ROS 2 bag of small messages of a wanted type."""
    with closing(sqlite3.connect(folder / "a.db3")) as made, made:
        made.execute("CREATE TABLE topics (id INTEGER PRIMARY KEY, name, type, serialization_format)")
        made.execute("INSERT INTO topics VALUES (1, '/depth', 'sensor_msgs/msg/Image', 'cdr')")
        made.execute("CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data BLOB)")
        rows = ((n, 1, n, bytes(20)) for n in range(units))
        made.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
    return _open(folder)


def _fields(**values: bytes) -> bytes:
    pairs = (name.encode() + b"=" + value for name, value in values.items())
    return b"".join(struct.pack("<I", len(pair)) + pair for pair in pairs)


def _record(header: bytes, data: bytes) -> bytes:
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def messages_by_chunks(folder: Path, units: int) -> Run:
    """A ROS 1 bag whose messages lie in two chunks in turns, neither of which is kept beside the other."""
    from kinectbench.stages.ingest.bags import walk_limits

    def text(value: bytes) -> bytes:
        return struct.pack("<I", len(value)) + value

    def image(number: int) -> bytes:
        time_, pixels = struct.pack("<II", 1000 + number, 0), np.full((4, 4), 1000, np.uint16).tobytes()
        head = struct.pack("<I", number) + time_ + text(b"cam") + struct.pack("<II", 4, 4)
        data = head + text(b"16UC1") + b"\0" + struct.pack("<I", 8) + text(pixels)
        return _record(_fields(op=b"\2", conn=bytes(4), time=time_), data)

    said = _fields(
        topic=b"/d/image_raw", type=b"sensor_msgs/Image", md5sum=b"*" * 32, message_definition=b"x"
    )
    topic = _record(_fields(op=b"\7", conn=bytes(4), topic=b"/d/image_raw"), said)
    other = _fields(op=b"\2", conn=b"\1\0\0\0", time=bytes(8))
    bag = io.BytesIO()
    bag.write(b"#ROSBAG V2.0\n" + _record(_fields(op=b"\3", index_pos=struct.pack("<Q", 4096)), bytes(99)))
    for first in (0, 1):
        body = topic + b"".join(map(image, range(first, units, 2))) + _record(other, bytes(2 << 20))
        head = _fields(op=b"\5", compression=b"bz2", size=struct.pack("<I", len(body)))
        bag.write(_record(head, bz2.compress(body)))
    (folder / "a.bag").write_bytes(bag.getvalue())
    read = _read(folder / "a.bag")

    def run() -> None:
        usual, walk_limits.CACHED_BYTES = walk_limits.CACHED_BYTES, 1 << 20
        try:
            read()
        finally:
            walk_limits.CACHED_BYTES = usual

    return run


def scans_of_a_jpeg(folder: Path, units: int) -> Run:
    """A progressive JPEG whose last scan is repeated."""
    import cv2

    from kinectbench.core.images import read_color

    pixels = np.full((1024, 1024), 128, np.uint8)
    data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    last = data.rfind(b"\xff\xda")
    (folder / "a.jpg").write_bytes(data[:-2] + data[last:-2] * units + data[-2:])
    return lambda: read_color(folder / "a.jpg")


def settings_of(text: Callable[[int], str]) -> Callable[[Path, int], Run]:
    """A benchmark.yaml of a text of so many units."""

    def make(folder: Path, units: int) -> Run:
        from kinectbench.settings.file import load_benchmark

        (folder / "benchmark.yaml").write_text("name: a\n" + text(units))
        return lambda: load_benchmark(folder / "benchmark.yaml")

    return make


def folders_without_recordings(folder: Path, units: int) -> Run:
    """Folders right below the one that `init` is asked about."""
    from kinectbench.cli.recordings import _without_recording

    found = [folder / f"{number}" for number in range(units)]
    for path in found:
        path.mkdir()
    return lambda: _without_recording(folder, found, [])


def null_rows_of_a_table(folder: Path, units: int) -> Run:
    """A table of scores whose rows have no IoU."""
    from kinectbench.core.artefacts.scores import ScoreTable
    from kinectbench.scoring.read_table import read_table

    row = {"object": "a", "category": "c", "protocol": "known", "threshold": 0.5, "iou": None}
    rows = [{**row, "recording": f"r{number}", "view": "000"} for number in range(units)]
    table = {"method": "a", "benchmark_sha256": "0" * 64, "settings": {"protocols": ["known"]}, "rows": rows}
    (folder / ScoreTable.FILE).write_text(json.dumps({"format_version": 1, "complete": True, **table}))
    return lambda: read_table(folder / ScoreTable.FILE)


def letters_of_methods(_: Path, units: int) -> Run:
    """Methods in groups of three that differ within the group alone: 3 ^ (n / 3) groups."""
    from kinectbench.scoring.uncertainty import significance_letters

    names = [f"method_{number}" for number in range(units)]
    trios = [names[first : first + 3] for first in range(0, units, 3)]
    apart = {frozenset((a, b)) for trio in trios for a in trio for b in trio if a != b}
    return lambda: significance_letters(names, apart)


def lists_of_a_ply(_: Path, units: int) -> Run:
    """A .ply of faces with as many lists as are read, none as long as the one before it."""
    from kinectbench.core.mesh_files import MAX_LISTS, read_ply

    more = "".join(f"property list uchar int l{number}\n" for number in range(MAX_LISTS - 1))
    head = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {units}\nproperty list uchar int vertex_indices\n{more}end_header\n"
    )
    face = struct.pack("<B3i", 3, 0, 1, 2)
    faces = [face + struct.pack("<B", n % 3) + bytes(4 * (n % 3)) for n in range(units)]
    content = head.encode() + np.eye(3, dtype="<f4").tobytes() + b"".join(faces)
    return lambda: read_ply(content)


def recordings_of_a_licence(_: Path, units: int) -> Run:
    """A LICENSE that says of each recording almost what benchmark.json says."""
    from types import SimpleNamespace

    from kinectbench.release.check.agreement_check import Stated, _license_problems

    info = SimpleNamespace(license="CC-BY-4.0", source="me")
    metadata: Any = SimpleNamespace(recordings={f"r{number}": info for number in range(units)})
    text = "".join(f"r{number}\n  licence: CC-BY-4.0\n  source: m\n" for number in range(units))
    return lambda: list(_license_problems(text, Stated((), metadata, {})))


AMPLIFIERS = {
    "transforms.json: keys by frames": Amplifier(keys_by_frames, 4000),
    "a folder of files": Amplifier(files_of_a_folder, 1500),
    "tum: lines": Amplifier(lines_of_a_trajectory, 8000),
    "rosbag2: packed files": Amplifier(packed_files_of_a_bag, 60),
    "rosbag2: rows": Amplifier(rows_of_a_database, 10_000),
    "rosbag1: messages by chunks": Amplifier(messages_by_chunks, 100),
    "jpeg: scans": Amplifier(scans_of_a_jpeg, 200),
    "yaml: recordings that are numbers": Amplifier(
        settings_of(lambda n: "recordings: [" + "1," * n + "]\n"), 8000
    ),
    "yaml: unknown keys": Amplifier(settings_of(lambda n: "".join(f"k{i}: 1\n" for i in range(n))), 4000),
    "yaml: lines": Amplifier(settings_of(lambda n: "x:\n" + "- 1\n" * n + "\t- 1\n"), 8000),
    "scores: rows without an IoU": Amplifier(null_rows_of_a_table, 4000),
    "scores: letters of methods": Amplifier(letters_of_methods, 60),
    "ply: lists": Amplifier(lists_of_a_ply, 50_000),
    "release: recordings of a licence": Amplifier(recordings_of_a_licence, 20_000),
    "init: folders": Amplifier(folders_without_recordings, 1000),
}
