"""What reading and recording cost: CPU a frame, memory on a big bag, seconds of the doctor, frames lost.

FOLDER is a recording with PNG depth and JPEG colour. Its frames are read as they lie, and wrapped in ROS 1
bags with raw depth and JPEG colour: chunks plain, lz4, bz2. The big bags repeat them up to so many GB.
A camera that gives them as pixels, 1,000 at 30 Hz, is recorded alone, and with an observer that never rests.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
from figures import Figure, arguments, at_least, at_most, equals, run, stated
from guide_replay import guide_figures
from ingest_writers import BagWriter, every_frame
from memory import peak_mb

from kinectbench.record.devices.replay import KEPT
from kinectbench.record.interface import Device, Frame, Setup
from kinectbench.record.recorder import record
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import decode_color_bgr, decode_depth_png
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import RawFrame, Recording
from kinectbench.stages.ingest.sequence_folder import write_sequence

SETTINGS = CameraSettings(fx=525.0, fy=525.0, cx=319.5, cy=239.5)
START_NS, STEP_NS = 1_400_000_000 * 10**9, 33_333_333
LIMIT_MB, FOLDER_MS, BAG_FPS, DOCTOR_S, DOCTOR_FRAMES = 500.0, 5.0, 100.0, 10.0, 1000
ROUNDS = 3
RECORDED, RECORD_HZ, RECORD_MB, PICTURES = 1000, 30.0, 1500.0, 30


def raw_frames(source: Recording) -> list[RawFrame]:
    return [frame for frame in every_frame(source) if isinstance(frame, RawFrame) and frame.color]


def write_bag(path: Path, frames: list[RawFrame], count: int, compression: str | None) -> None:
    """A bag of so many frames in chunks of 768 KB, as `rosbag record` makes them."""
    camera = {"width": frames[0].depth.shape[1], "height": frames[0].depth.shape[0]}
    camera |= {"fx": 525.0, "fy": 525.0, "cx": 319.5, "cy": 239.5}
    with BagWriter(path, compression, chunk_bytes=768 << 10) as bag:
        for index in range(count):
            frame, stamp_ns = frames[index % len(frames)], START_NS + index * STEP_NS
            assert frame.color is not None
            bag.info("/camera/depth/camera_info", stamp_ns, camera)
            bag.image("/camera/depth/image_raw", stamp_ns, frame.depth, "16UC1")
            bag.compressed("/camera/rgb/image/compressed", stamp_ns, frame.color[1], "jpeg")


def ingest_one(path: Path, rounds: int) -> None:
    """In a process of its own: ingest, and print frames, CPU seconds and peak memory in MB.

    Of several rounds the fastest counts: the first also loads libraries and compiled functions.
    """
    cv2.setNumThreads(1)
    seconds = []
    for _ in range(rounds):
        with tempfile.TemporaryDirectory() as folder:
            started = time.process_time()
            recording = open_recording(path, SETTINGS)
            write_sequence(recording, Path(folder) / "sequence")
            seconds.append(time.process_time() - started)
    print(json.dumps([len(recording), min(seconds), peak_mb()]))


def ingested(path: Path, rounds: int = ROUNDS) -> tuple[int, float, float]:
    """Frames, CPU seconds and peak memory in MB of `ingest_one`."""
    command = [sys.executable, __file__, "--one", str(path), str(rounds)]
    frames, seconds, peak = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    return frames, seconds, peak


def decoding_ms(source: Recording, paths: list[Path]) -> float:
    """CPU to read the files of frames and decode their depth, a frame; the least of several rounds."""
    times = []
    for _ in range(ROUNDS):
        started = time.process_time()
        for path in paths:
            decode_depth_png(path.read_bytes(), str(path))
        times.append(time.process_time() - started)
    return 1000 * min(times) / len(paths)


def folder_figures(folder: Path) -> list[Figure]:
    source = open_recording(folder, SETTINGS)
    paths = [Path(frame.name) for frame in raw_frames(source)]
    decode_ms = decoding_ms(source, paths)
    frames, seconds, _ = ingested(folder)
    frame_ms = 1000 * seconds / frames
    return [
        stated("folder: decoding a depth PNG, ms CPU", decode_ms),
        stated("folder: ingest a frame, ms CPU", frame_ms),
        at_most("folder: ingest beyond decoding, ms CPU a frame", frame_ms - decode_ms, FOLDER_MS),
    ]


def bag_figures(frames: list[RawFrame], root: Path) -> list[Figure]:
    found = []
    for name, compression in (("plain", None), ("lz4", "LZ4"), ("bz2", "BZ2")):
        bag = root / f"{name}.bag"
        write_bag(bag, frames, 300 if compression != "BZ2" else 60, compression)
        count, seconds, _ = ingested(bag)
        words = f"bag, raw depth + JPEG, {name} chunks: frames a second of CPU"
        # bz2 itself unpacks some 20 MB a second.
        found.append(
            stated(words, count / seconds) if name == "bz2" else at_least(words, count / seconds, BAG_FPS)
        )
        bag.unlink()
    return found


def memory_figures(frames: list[RawFrame], root: Path, sizes_gb: list[float]) -> list[Figure]:
    each = frames[0].depth.nbytes + len(frames[0].color[1] if frames[0].color else b"")
    found = []
    for size_gb in sizes_gb:
        for name, compression in (("plain", None), ("lz4", "LZ4")):
            bag = root / "big.bag"
            write_bag(bag, frames, round(size_gb * 1e9 / each), compression)
            count, seconds, peak = ingested(bag, rounds=1)
            file_gb = bag.stat().st_size / 1e9
            words = f"{size_gb:g} GB of images, {name} chunks ({count} frames, file {file_gb:.2f} GB)"
            found.append(at_most(f"{words}: peak memory, MB", peak, LIMIT_MB))
            found.append(stated(f"{words}: CPU s", round(seconds, 1)))
            bag.unlink()
    return found


def doctor_figures(frames: list[RawFrame], root: Path) -> list[Figure]:
    bag = root / "doctor.bag"
    write_bag(bag, frames, DOCTOR_FRAMES, None)
    command = [sys.executable, "-m", "kinectbench", "inspect", str(bag), "--json"]
    started, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
    said = json.loads(subprocess.run(command, capture_output=True, check=False).stdout)
    after, seconds = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic() - started
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return [
        stated("inspect: frames, by the clock (s)", [said["frames"], round(seconds, 1)]),
        # Others may have this machine's cores, too.
        at_most(f"inspect, {DOCTOR_FRAMES} frames of a bag, CPU s", cpu_s, DOCTOR_S),
    ]


class Pixels(Device):
    """A camera of 30 Hz that gives pixels; a frame that is taken later than its driver keeps it is missed."""

    name, cameras = "pixels", "none"

    def __init__(self, source: Recording) -> None:
        self.source, self.pictures = source, raw_frames(source)[:PICTURES]

    def plugged_in(self) -> tuple[str, ...]:
        return ()

    def open(self) -> Setup:
        return Setup(self.source.camera, self.source.depth_scale, True)

    def frames(self) -> Iterator[Frame]:
        pixels = [(raw.depth, decode_color_bgr(raw.color[1], raw.name)) for raw in self.pictures if raw.color]
        begun = time.monotonic()
        for index in range(RECORDED):
            late_s = time.monotonic() - begun - index / RECORD_HZ
            time.sleep(max(-late_s, 0))
            if late_s * RECORD_HZ > KEPT:
                self.missed += 1
            else:
                depth, color = pixels[index % len(pixels)]
                yield Frame(START_NS + index * STEP_NS, depth, color)

    def close(self) -> None: ...


class Busy:
    """An observer that keeps Python's own lock for as long as it can, for 200 ms a frame."""

    def see(self, number: int, frame: Frame, setup: Setup) -> None:
        end = time.monotonic() + 0.2
        while time.monotonic() < end:
            sum(range(1000))


def record_one(path: Path, busy: bool) -> None:
    """In a process of its own: print frames, missed, dropped, CPU seconds and peak memory in MB."""
    camera = Pixels(open_recording(path, SETTINGS))
    with tempfile.TemporaryDirectory() as folder:
        started = time.process_time()
        done = record(camera, Path(folder) / "out", observers=[Busy()] if busy else [])
        cpu_s = time.process_time() - started
    print(json.dumps([done.frames, done.missed, done.dropped, cpu_s, peak_mb()]))


def record_figures(folder: Path) -> list[Figure]:
    found = []
    for words, busy in (("record", "0"), ("record, with a busy observer", "1")):
        command = [sys.executable, __file__, "--record", str(folder), busy]
        said = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
        frames, missed, dropped, cpu_s, peak = said
        found += [
            equals(f"{words}: frames written of {RECORDED} at {RECORD_HZ:g} Hz", frames, RECORDED),
            stated(f"{words}: missed, dropped", [missed, dropped]),
            stated(f"{words}: ms CPU a frame", 1000 * cpu_s / RECORDED),
            at_most(f"{words}: peak memory, MB", peak, RECORD_MB),
        ]
    return found


def measure(folder: Path, sizes_gb: list[float], parts: list[str]) -> list[Figure]:
    frames = raw_frames(open_recording(folder, SETTINGS))
    found: list[Figure] = []
    with tempfile.TemporaryDirectory(prefix="kinectbench-") as name:
        root = Path(name)
        if "folder" in parts:
            found += folder_figures(folder)
        if "bags" in parts:
            found += bag_figures(frames, root)
        if "memory" in parts:
            found += memory_figures(frames, root, sizes_gb)
        if "doctor" in parts:
            found += doctor_figures(frames, root)
        if "record" in parts:
            found += record_figures(folder)
        if "guide" in parts:
            found += guide_figures(folder, SETTINGS)
    return found


def main() -> None:
    if sys.argv[1:2] == ["--one"]:
        ingest_one(Path(sys.argv[2]), int(sys.argv[3]))
        return
    if sys.argv[1:2] == ["--record"]:
        record_one(Path(sys.argv[2]), sys.argv[3] == "1")
        return
    parser = arguments(__doc__)
    parser.add_argument(
        "folder", type=Path, metavar="FOLDER", help="a recording with PNG depth and JPEG colour"
    )
    parser.add_argument("--gb", type=float, nargs="*", default=[0.3, 3.0], help="sizes of the big bags")
    parts = ["folder", "bags", "memory", "doctor", "record"]
    parser.add_argument(
        "--parts", nargs="*", default=parts, choices=[*parts, "guide"], help="only these; guide: true poses"
    )
    options = parser.parse_args()
    run(options, lambda: measure(options.folder, options.gb, options.parts))


if __name__ == "__main__":
    main()
