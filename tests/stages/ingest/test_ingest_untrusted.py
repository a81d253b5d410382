"""Recordings of strangers: no links, pipes or devices, nothing outside of them, and what costs too much.

Each case ends with one line; each would read elsewhere, hang, or take gigabytes without the bound.
"""

import os
import re
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path, PosixPath
from typing import Any

import pytest
from bounds import within
from ingest_writers import color_image, every_frame, png, write_folder, write_seven_scenes, write_tum
from raising import raises
from test_ingest_fuzzed_folders import MAKERS
from typed import noted

from kinectbench.core import untrusted
from kinectbench.core.errors import RecordingError
from kinectbench.engine.artefact import content_hash
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest import sources
from kinectbench.stages.ingest.images import DamagedImageError, image_header
from kinectbench.stages.ingest.readers import find_recordings, open_recording, source_files
from kinectbench.stages.ingest.recording import FileRecording


def refused(path: Path, match: str, **options: bool) -> None:
    """Both ways in say so, in one line and at once."""
    ways: tuple[Callable[..., object], ...] = (open_recording, source_files)
    for ask in ways:
        with within(10):
            with pytest.raises(RecordingError, match=match) as error:
                ask(path, **options)
            assert "\n" not in str(error.value) and len(str(error.value)) < 1000


def pipe(path: Path) -> None:
    os.mkfifo(path)


def device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def root(path: Path) -> None:
    path.symlink_to("/")


def elsewhere(path: Path) -> None:
    (path.parents[1] / "elsewhere.png").write_bytes(b"secret")
    path.symlink_to(path.parents[1] / "elsewhere.png")


def dangling(path: Path) -> None:
    path.symlink_to("nowhere")


@pytest.mark.parametrize("place", ["x.bin", "depth/x.png", "deep/er/x"])
@pytest.mark.parametrize("make", [pipe, device, root, elsewhere, dangling])
def test_what_is_no_plain_file_of_its_own_is_refused(
    tmp_path: Path, make: Callable[[Path], None], place: str
) -> None:
    folder = write_tum(tmp_path / "r")
    (folder / place).parent.mkdir(parents=True, exist_ok=True)
    make(folder / place)
    said = "is no plain file but a pipe" if make is pipe else "is a link, .*write `follow_links: true`"
    refused(folder, f"r/{place}: {said}")


@pytest.mark.parametrize("make", [pipe, device, dangling])
def test_with_links_followed_they_must_end_at_plain_files(
    tmp_path: Path, make: Callable[[Path], None]
) -> None:
    make(write_tum(tmp_path / "r") / "x")
    refused(tmp_path / "r", "r/x: is no plain file but a", follow_links=True)


@pytest.mark.parametrize("name", ["depth/1.png", "rgb/1.jpg", "camera.json", "groundtruth.txt", "depth.txt"])
def test_a_pipe_in_the_place_of_a_file_that_is_read(tmp_path: Path, name: str) -> None:
    folder = write_tum(tmp_path / "r")
    (folder / name).unlink()
    os.mkfifo(folder / name)
    with within(5), pytest.raises(RecordingError):
        open_recording(folder)


def test_links_are_followed_where_that_is_wanted(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    (folder / "depth").rename(tmp_path / "depth")
    (folder / "depth").symlink_to(tmp_path / "depth")
    (folder / "loop").symlink_to(folder)
    refused(folder, r"r/(depth|loop): is a link")
    assert len(open_recording(folder, follow_links=True)) == 5
    files = source_files(folder, follow_links=True)
    assert folder / "depth/0.png" in files and len(files) == 2 * 5 + 4
    # The recording itself may be a link.
    (folder / "depth").unlink()
    (folder / "loop").unlink()
    (tmp_path / "depth").rename(folder / "depth")
    (tmp_path / "named").symlink_to(folder)
    assert len(open_recording(tmp_path / "named")) == 5


def test_another_folder_behind_a_link_is_another_recording(tmp_path: Path) -> None:
    """Both folders are listed before and after, but the frames are of another."""
    folder = write_tum(tmp_path / "r")
    (folder / "a").mkdir()
    (folder / "depth").rename(folder / "a/0")
    (folder / "a/1").mkdir()
    for number in range(5):
        (folder / f"a/1/{number}.png").write_bytes(png(color_image(number)))
    hashes = set()
    for which in "01":
        (folder / "depth").unlink(missing_ok=True)
        (folder / "depth").symlink_to(f"a/{which}")
        hashes.add(content_hash(source_files(folder, follow_links=True), folder))
    assert len(hashes) == 2


def test_folders_that_link_to_each_other_and_deep_ones_are_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_tum(tmp_path / "r")
    for a in range(9):
        (folder / f"f{a}").mkdir()
        for b in range(9):
            (folder / f"f{a}/{b}").symlink_to(f"../f{b}")
    refused(folder, "holds more than 1000 links to folders", follow_links=True)
    monkeypatch.setattr(sources, "MOST_FILES", 500)
    refused(folder, "holds more than 500 files and folders", follow_links=True)
    deep = write_tum(tmp_path / "deep")
    (deep / "/".join("d" * 200)).mkdir(parents=True)
    refused(deep, "lies too deep")


@pytest.mark.parametrize("path", ["/", "/proc", "/dev", "/proc/self", "/dev/zero", "/dev/tty"])
def test_nothing_is_listed_before_the_format_is_known(path: str) -> None:
    # Below "/" there may be pictures.
    said = (
        "not a recording of a known format|cannot be read|neither a folder nor a plain|no depth that is read"
    )
    refused(Path(path), said)


@pytest.mark.parametrize("name", ["x" * 300, "x/" * 2500, "loop"])
def test_a_path_that_cannot_be(tmp_path: Path, name: str) -> None:
    (tmp_path / "loop").symlink_to("loop")
    refused(tmp_path / name, "cannot be read|no such file")


def test_recordings_are_looked_for_in_no_more_than_so_many_folders(tmp_path: Path) -> None:
    for number in range(5):
        write_folder(tmp_path / f"r{number}")
    assert len(find_recordings(tmp_path)) == 5
    assert len(find_recordings(tmp_path, most=3)) == 2  # the folder is the first


@pytest.mark.parametrize("name", ["/etc/passwd", "../secret.png", "depth/../../x.png", ".hidden/0.png"])
@pytest.mark.parametrize("index", ["depth.txt", "rgb.txt"])
def test_an_index_names_only_files_of_the_recording(tmp_path: Path, index: str, name: str) -> None:
    folder = write_tum(tmp_path / "r")
    text = (folder / index).read_text()
    (folder / index).write_text(re.sub(r"(depth|rgb)/1\.\w+", name, text))
    with raises(RecordingError, "recording.malformed", match=f"{index}, line 3: '{name}'"):
        open_recording(folder)


def test_a_mask_beside_the_recording_is_not_its_own(tmp_path: Path) -> None:
    folder = write_tum(tmp_path / "r")
    for file in (folder / "depth").iterdir():
        file.rename(folder / file.name)
    text = (folder / "depth.txt").read_text()
    (folder / "depth.txt").write_text(text.replace("depth/", ""))
    (tmp_path / "masks").mkdir()
    (tmp_path / "masks/0.png").write_bytes(png(color_image(0)))
    recording = open_recording(folder)
    assert isinstance(recording, FileRecording)
    assert all(place.mask is None for place in recording.places)


@pytest.mark.parametrize("name", MAKERS)
def test_every_file_that_is_read_is_in_the_content_hash(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = MAKERS[name](tmp_path / "r")
    # Files that look as if they were the recording's.
    for beside in (".1.png", ".1.log", "depth/.9.png", "extrinsics/.9.txt", "../masks/0.png", "../x.log"):
        path = folder / beside
        if path.parent.is_dir() or beside.startswith(".."):
            path.parent.mkdir(exist_ok=True)
            path.write_bytes(b"x")
    calls: list[tuple[str, int]] = []
    monkeypatch.setattr(os, "open", noted(os.open, calls))
    settings = CameraSettings(fx=60, fy=60, cx=31, cy=23) if name == "7scenes" else None
    assert list(every_frame(open_recording(folder, settings)))
    monkeypatch.undo()
    opened = [Path(path) for path, *_ in calls]
    assert len(opened) > 5
    assert {path.resolve() for path in opened} <= {path.resolve() for path in source_files(folder)}


def test_the_intrinsics_above_a_folder_are_no_link_either(tmp_path: Path) -> None:
    folder = write_seven_scenes(tmp_path / "all/r")
    (folder / "camera-intrinsics.txt").rename(tmp_path / "K.txt")
    (tmp_path / "all/camera-intrinsics.txt").symlink_to(tmp_path / "K.txt")
    refused(folder, "camera-intrinsics.txt: is a link")


def repr_start(text: str) -> str:
    return repr(text[:4])


def sized_png(width: int, height: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")


def sized_jpeg(width: int, height: int, frame: int = 0xC0, scans: int = 1, before: bytes = b"") -> bytes:
    size = height.to_bytes(2, "big") + width.to_bytes(2, "big")
    sof = b"\xff" + bytes([frame]) + b"\0\x11\x08" + size + b"\x03" + bytes(9)
    return b"\xff\xd8" + before + sof + b"\xff\xda\0\x08\x01\x01\0\0\x3f\0" * scans + b"\xff\xd9"


@pytest.mark.parametrize(
    "data",
    [
        sized_png(8193, 16),
        sized_png(30_000, 30_000),
        sized_png(8192, 2049),
        sized_jpeg(4097, 4096),
        sized_jpeg(16, 8193),
        sized_jpeg(30_000, 30_000),
        sized_jpeg(30_000, 30_000, before=b"\xff\x01\xff\xd0\xff\xff"),
        sized_jpeg(4097, 4096, frame=0xC2),
        sized_jpeg(4096, 4096, scans=33),
        sized_jpeg(64, 48, frame=0xC2, scans=100),
        sized_png(64, 48)[:33] + b"\0\0\0\x08acTL" + bytes(8) + b"\x99\x4b\xd1\xae" + sized_png(64, 48)[33:],
    ],
)
def test_an_image_that_costs_too_much_is_damaged(data: bytes) -> None:
    with pytest.raises(DamagedImageError):
        image_header(data, "x")


def test_an_image_of_too_many_bytes_or_parts_is_damaged() -> None:
    chunk = bytes(4) + b"tESt" + zlib.crc32(b"tESt").to_bytes(4, "big")
    for data in (bytes(untrusted.IMAGE_BYTES), chunk * 1_000_000, b""):
        with within(2), pytest.raises(DamagedImageError):
            image_header(sized_png(64, 48)[:33] + data + sized_png(64, 48)[33 : -12 if data else -20], "x")


def test_the_largest_images_are_read() -> None:
    assert image_header(sized_png(8192, 2048), "x") == (".png", 8192, 2048)
    assert image_header(sized_jpeg(4096, 4096), "x") == (".jpg", 4096, 4096)
    assert image_header(sized_jpeg(1920, 1080, frame=0xC2, scans=10), "x") == (".jpg", 1920, 1080)


@pytest.mark.parametrize(
    "line", ["1\n" * 1_100_000, "1 " * 6000 + "\n", "\u2028" * 1_100_000], ids=repr_start
)
@pytest.mark.parametrize("name", ["groundtruth.txt", "depth.txt"])
def test_text_is_bounded(tmp_path: Path, name: str, line: str) -> None:
    folder = write_tum(tmp_path / "r")
    (folder / name).write_text(line, encoding="utf-8")
    try:
        said = open_recording(folder).trajectory_error  # a trajectory can be done without
    except RecordingError as error:
        said = str(error)
    assert "more than the 500000 lines" in said or "longer than the 10000 characters" in said


@pytest.mark.parametrize("name", ["camera.json", "groundtruth.txt", "depth.txt", "depth/1.png"])
def test_a_file_without_end_is_not_read(tmp_path: Path, name: str) -> None:
    folder = write_tum(tmp_path / "r")
    with (folder / name).open("wb") as file:
        file.truncate(1 << 40)  # takes no room on the disk
    try:
        recording = open_recording(folder)
        said = recording.trajectory_error or str(
            next(f for f in every_frame(recording) if not hasattr(f, "depth"))
        )
    except RecordingError as error:
        said = str(error)
    assert "larger than the" in said


@pytest.mark.parametrize(
    "said", ['"fx": 1e-300', '"fx": 1e300', '"depth_scale": 1e-300', '"depth_scale": 1e300']
)
def test_numbers_that_no_camera_has(tmp_path: Path, said: str) -> None:
    folder = write_tum(tmp_path / "r")
    camera = '{"width": 64, "height": 48, "fx": 60, "fy": 61, "cx": 31.5, "cy": 23.5, '
    (folder / "camera.json").write_text(f"{camera}{said}}}")
    with pytest.raises(RecordingError, match=r"are no camera's|units of 16-bit depth"):
        open_recording(folder)
    key, value = said.replace('"', "").split(": ")
    with pytest.raises(RecordingError, match=r"are no camera's|units of 16-bit depth"):
        open_recording(write_tum(tmp_path / "s"), CameraSettings.model_validate({key: float(value)}))


def test_a_file_that_is_mostly_a_hole_is_not_read(tmp_path: Path) -> None:
    """To hash a terabyte of zeros that no disk holds takes half an hour."""
    folder = write_tum(tmp_path / "r")
    os.truncate(folder / "rgb" / "0.jpg", 1 << 40)
    refusal = r"0\.jpg: a sparse file, of whose 1099511627776 bytes only"
    with within(5), raises(RecordingError, "recording.malformed", match=refusal):
        content_hash(source_files(folder), folder)


@pytest.mark.parametrize("maker", ["folder", "tum", "7scenes"])
def test_what_lies_beside_the_frames_is_listed_a_few_times_and_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, maker: str
) -> None:
    """Each reader that looks for its files lists the folder, and the format is looked for once."""
    folder = MAKERS[maker](tmp_path / "r")
    strays = [folder / f"x{number:04d}" for number in range(1000)]
    for stray in strays:
        stray.touch()
    entries: list[str] = []
    paths: list[Path] = []
    scanned, joined = untrusted.scanned, PosixPath.__truediv__

    def counted(*arguments: Any) -> Iterator["os.DirEntry[str]"]:
        for entry in scanned(*arguments):
            entries.append(entry.name)
            yield entry

    def made(self: PosixPath, key: str) -> PosixPath:
        path = joined(self, key)
        paths.append(path)
        return path

    for module in (untrusted, sources):
        monkeypatch.setattr(module, "scanned", counted)
    monkeypatch.setattr(PosixPath, "__truediv__", made)
    open_recording(folder)
    assert sum(name.startswith("x") for name in entries) <= 7 * len(strays)  # 9 with the format twice
    # Once for the frames, once for names like those of intrinsics or poses.
    assert sum(path.name.startswith("x") for path in paths) <= 2 * len(strays)


READ = """
import sys
from pathlib import Path
from kinectbench.stages.ingest.readers import open_recording
print(open_recording(Path(sys.argv[1])).warnings)
"""


@pytest.mark.parametrize(
    "data",
    [
        b"\0\0\0\x18ftypisom" + bytes(2000),
        b"#EXTM3U\nfile:///etc/passwd\n",
        b"ffconcat version 1.0\nfile x\n",
    ],
)
def test_of_a_video_that_is_none_no_library_says_a_word(tmp_path: Path, data: bytes) -> None:
    folder = MAKERS["stray"](tmp_path / "r")
    (folder / "rgb.mp4").write_bytes(data)
    done = subprocess.run(
        [sys.executable, "-c", READ, str(folder)], capture_output=True, text=True, timeout=60
    )
    assert "rgb.mp4 is missing or cannot be read" in done.stdout
    assert (done.stderr, done.returncode) == ("", 0)
