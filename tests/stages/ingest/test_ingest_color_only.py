"""What is said where there is no depth, or depth in a layout that nobody knows."""

import io
from pathlib import Path

import numpy as np
import pytest
from ingest_writers import color_image, depth_image, jpeg, png, write_folder
from raising import raises

from kinectbench.core.errors import RecordingError
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.images import OddImageError, decode_depth_png
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import FileRecording


def images(folder: Path, count: int, suffix: str = ".jpg") -> None:
    folder.mkdir(parents=True)
    for i in range(count):
        data = jpeg(color_image(i)) if suffix == ".jpg" else png(color_image(i))
        (folder / f"{i:04d}{suffix}").write_bytes(data)


def refusal(path: Path) -> str:
    with pytest.raises(RecordingError) as error:
        open_recording(path)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("inside", ["", "rgb", "images", "left"])
@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_folders_of_colour(tmp_path: Path, inside: str, suffix: str) -> None:
    images(tmp_path / "r" / inside, 6, suffix)
    said = refusal(tmp_path / "r")
    assert "no depth that is read (16-bit PNG, .npy, .npz, TIFF): record with a camera that" in said
    assert "holds 6 colour images" in said


@pytest.mark.parametrize("suffix", [".mp4", ".MOV", ".avi", ".webm"])
def test_videos(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"chair{suffix}"
    path.write_bytes(b"\0\0\0\x20ftypisom")
    assert "is a video, which holds colour only: record with a camera that measures depth" in refusal(path)


OTHERS = {
    "a.oni": (b"NI10\0\0", "OpenNI.*`kinectbench record`.*depth/"),
    "a.bin": (b"\x89HDF\r\n\x1a\n\0", "HDF5.*depth/"),
    "a.npz": (b"PK\x03\x04\0", r"NumPy arrays \(.npz\).*depth/"),
    "a.zip": (b"PK\x03\x04\0", "zip.*unpack it"),
    "a.tgz": (b"\x1f\x8b\x08", "archive; unpack it"),
    "a.tar": (b"r/".ljust(257, b"\0") + b"ustar\0", "archive; unpack it"),
    "a.SVO2": (b"SVO", "ZED"),
    "a.png": (b"\x89PNG\r\n\x1a\n", "one image; give the folder"),
    "a.txt": (b"", "the file is empty"),
    "b.txt": (b"nothing known\n", "`kinectbench formats`"),
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_files_are_named_with_what_to_do(tmp_path: Path, name: str) -> None:
    content, words = OTHERS[name]
    (tmp_path / name).write_bytes(content)
    with raises(RecordingError, "recording.unknown-format", match=rf"{name}: .*{words}"):
        open_recording(tmp_path / name)


def test_a_file_of_a_recording_leads_to_its_folder(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "r", ("0", "1", "2"))
    for file in (folder / "depth/1.png", folder / "notes.txt"):
        file.touch()
        with raises(RecordingError, "recording.unknown-format", match=f"give its folder, {folder}$"):
            open_recording(file)


def test_a_stray_picture_is_no_recording(tmp_path: Path) -> None:
    images(tmp_path / "r", 1)
    assert "not a recording of a known format" in refusal(tmp_path / "r")


def test_depth_in_a_folder_of_another_name_is_pointed_at(tmp_path: Path) -> None:
    images(tmp_path / "r/rgb", 6)
    (tmp_path / "r/depth_raw").mkdir()
    (tmp_path / "r/depth_raw/0000.png").write_bytes(png(depth_image(0)))
    said = refusal(tmp_path / "r")
    assert (
        "depth_raw/ holds 16-bit PNG images that look like depth" in said
        and "alone into a folder depth/" in said
    )


def test_a_tum_folder_without_its_depth(tmp_path: Path) -> None:
    images(tmp_path / "r/rgb", 6)
    (tmp_path / "r/rgb.txt").write_text("0 rgb/0000.jpg\n")
    assert "but no depth" in refusal(tmp_path / "r")


ALONE = "put depth alone into a folder depth/ and colour into color/"
BYTES = "its 6 images named depth, such as {}, are pictures in 8 bits (false colours?): export the raw 16-bit"
NPY = io.BytesIO()
np.save(NPY, np.ones((4, 4), np.float32))


@pytest.mark.parametrize(
    ("pattern", "data", "words"),
    [
        # 16-bit PNG after colour in the order of names.
        (
            "{:04d}_depthcrop.png",
            png(depth_image(0)),
            ("16-bit PNG images that look like depth (0000_depthcrop", ALONE),
        ),
        ("depth_left/{:04d}.npy", NPY.getvalue(), ("6 .npy files, such as depth_left/0000.npy, look", ALONE)),
        ("distance_to_plane_{:04d}.npy", NPY.getvalue(), ("such as distance_to_plane_0000.npy", ALONE)),
        ("f-{:04d}.depth.pgm", b"P5", ("6 .pgm files, such as f-0000.depth.pgm, look", ALONE)),
        ("maps/{:04d}.pfm", b"Pf", ("such as maps/0000.pfm, look like depth", ALONE)),
        ("f-{:04d}.depth.jp2", b"", ("6 .jp2 files", ".jp2 is not read: write it as 16-bit PNG", ALONE)),
        (
            "front_depth/{:04d}.png",
            png(color_image(0)),
            (BYTES.format("front_depth/0000.png"), "channels are bytes of depth, as those of RLBench"),
        ),
        ("front_depth/{:04d}.jpg", jpeg(color_image(0)), (BYTES.format("front_depth/0000.jpg"),)),
    ],
)
def test_depth_that_is_not_read_is_named(
    tmp_path: Path, pattern: str, data: bytes, words: tuple[str, ...]
) -> None:
    images(tmp_path / "r", 6)
    for i in range(6):
        file = tmp_path / "r" / pattern.format(i)
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(data)
    said = refusal(tmp_path / "r")
    assert all(word in said for word in words) and "record with a camera" not in said
    assert ("bytes of depth" in said) == (len(words) == 2 and "RLBench" in words[1])


def test_files_of_other_names_are_not_taken_for_depth(tmp_path: Path) -> None:
    images(tmp_path / "r", 6)
    for i in range(6):
        (tmp_path / "r" / f"features_{i}.npy").write_bytes(NPY.getvalue())
    assert "holds 6 colour images, but no depth" in refusal(tmp_path / "r")


@pytest.mark.parametrize(
    ("depth", "color"),
    [
        ("aligned_depth_to_color_{:06d}.png", "color_{:06d}.jpg"),
        ("depth_{:06d}.png", "color_to_depth_{:06d}.png"),
        ("rgb_depth_{:06d}.png", "rgb_{:06d}.png"),
    ],
)
def test_a_name_with_the_words_of_both_streams_is_of_one(tmp_path: Path, depth: str, color: str) -> None:
    (tmp_path / "r").mkdir()
    for i in range(6):
        (tmp_path / "r" / depth.format(i)).write_bytes(png(depth_image(i)))
        of_png = color.endswith(".png")
        (tmp_path / "r" / color.format(i)).write_bytes((png if of_png else jpeg)(color_image(i)))
    recording = open_recording(tmp_path / "r", CameraSettings(fx=60, fy=61, cx=31.5, cy=23.5))
    assert isinstance(recording, FileRecording)
    names = [(frame.depth.name, frame.color and frame.color.name) for frame in recording.places]
    assert names == [(depth.format(i), color.format(i)) for i in range(6)]


def test_bytes_of_depth_in_channels_are_no_picture_for_certain(tmp_path: Path) -> None:
    with pytest.raises(OddImageError, match="not a picture of it; or, if its channels are bytes of depth"):
        decode_depth_png(png(color_image(0)), "0.png")
